"""Files of a run's history: comma-separated values."""

import os
from typing import BinaryIO

import numpy as np

from clunk.core.events import TOUCH
from clunk.results.files import write_whole, writing
from clunk.simulation.history import History
from clunk.simulation.trajectory import Trajectory

_ROWS = 4096  # of a CSV file, written at once


def save_csv(path: str | os.PathLike[str], history: History) -> None:
    """Write a history as comma-separated values, as `write_csv`. Raises ClunkError."""
    with writing(path) as target:
        write_whole(target, lambda stream: write_csv(stream, history))


def write_csv(stream: BinaryIO, history: History) -> None:
    """Write a history as comma-separated values, to full precision, with the units in the names of the columns.

    The last two columns are text, empty but in the row that follows an event: what it is, and its flank.
    """
    n, trajectory = history.angle.shape[1], history.trajectory
    names = ["time_s", "after_step_s"]
    for quantity, unit in (("theta", "rad"), ("theta_dot", "rad_per_s"), ("theta_ddot", "rad_per_s2")):
        names += [f"{quantity}_{inertia}_{unit}" for inertia in range(1, n + 1)]
    several = len(trajectory.lashes) > 1
    suffixes = [f"_{lash}" for lash in range(1, len(trajectory.lashes) + 1)] if several else [""]
    names += ["torque_Nm", *(f"backlash_coordinate{suffix}_m" for suffix in suffixes)]
    names += [*(f"contact{suffix}" for suffix in suffixes), "event", *(["lash"] if several else []), "flank"]
    columns = (history.time, history.after_step, history.angle, history.velocity, history.acceleration)
    numbers = np.column_stack((*columns, history.torque, history.backlash_coordinates))
    empty = "," * (1 + several)

    stream.write((",".join(names) + "\n").encode())
    for start in range(0, history.time.size, _ROWS):
        rows = slice(start, start + _ROWS)
        lines = []
        for row, contacts, event in zip(
            numbers[rows].tolist(), history.contacts[rows].tolist(), history.event[rows].tolist(), strict=True
        ):
            lash = f"{trajectory.lash_name(event)}," if several else ""
            what = f"{event_name(trajectory, event)},{lash}{trajectory.flank_name(event)}" if event >= 0 else empty
            pressing = ",".join(map(str, contacts))
            lines.append(f"{','.join(map(repr, row))},{pressing},{what}\n")  # repr: shortest that reads back equal
        stream.write("".join(lines).encode())


def event_name(trajectory: Trajectory, k: int) -> str:
    """Name of event `k`, of a touch with its rank: primary touch or secondary touch."""
    name = trajectory.kind_name(k)
    if trajectory.events["kind"][k] != TOUCH:
        return name
    is_primary = any(k in each.primaries for each in trajectory.lashes)
    return f"{'primary' if is_primary else 'secondary'} {name}"
