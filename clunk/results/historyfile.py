"""Files of a run's history: comma-separated values, or HDF5 laid out as netCDF-4."""

import os
from typing import BinaryIO

import h5py
import numpy as np
import numpy.typing as npt

from clunk.core.events import KIND_NAMES, TOUCH
from clunk.results.files import write_whole, writing
from clunk.results.netcdf import create_scale, create_variable, set_flags, set_heading, set_text, write_file
from clunk.simulation.history import INITIAL, NONE, OPPOSITE, History, HistoryError
from clunk.simulation.trajectory import Trajectory
from clunk.study.study import digest

SCHEMA_VERSION = 1
_ROWS = 4096  # of a CSV file, written at once


def save_csv(path: str | os.PathLike[str], history: History) -> None:
    """Write a history as comma-separated values, as `write_csv`. Raises HistoryError."""
    with writing(path, HistoryError) as target:
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


def save_hdf5(path: str | os.PathLike[str], history: History) -> None:
    """Write a history as HDF5 laid out as netCDF-4, with the run's events and its config. Raises HistoryError.

    In xarray: ``open_dataset(path, engine="h5netcdf")``. Events have two rows each, so a time need not be unique.
    """
    with writing(path, HistoryError) as target:
        write_file(target, lambda file: _write_hdf5(file, history))


def _write_hdf5(file: h5py.File, history: History) -> None:
    study, trajectory = history.study, history.trajectory
    set_heading(file, study, SCHEMA_VERSION)
    if len(trajectory.lashes) == 1:
        set_text(file, "label", trajectory.label)
        file.attrs["severity"] = trajectory.severity
    set_text(file, "config_digest", digest(study))

    def put(name: str, values: npt.NDArray[np.generic], unit: str, long_name: str, scales: list[h5py.Dataset]) -> None:
        variable = create_variable(file, name, values.dtype, {"units": unit, "long_name": long_name}, scales)
        variable[...] = values
        set_flags(variable, _FLAGS.get(name, {}))

    time = create_scale(file, "time", history.time, {"units": "s", "long_name": "time"})
    numbers = np.arange(1, history.angle.shape[1] + 1, dtype=np.int32)
    inertia = create_scale(file, "inertia", numbers, {"units": "1", "long_name": "number of the inertia"})
    if study.driveline.names:
        set_text(inertia, "names", ", ".join(study.driveline.names))
    put("after_step", history.after_step, "s", "time after the load step", [time])
    put("theta", history.angle, "rad", "angle", [time, inertia])
    put("theta_dot", history.velocity, "rad s-1", "angular velocity", [time, inertia])
    put("theta_ddot", history.acceleration, "rad s-2", "angular acceleration", [time, inertia])
    put("torque", history.torque, "N m", "load torque", [time])
    scales = [time]
    coordinates, contacts = history.backlash_coordinate, history.contact
    if len(trajectory.lashes) > 1:
        lash = create_scale(file, "lash", np.array(study.lash_names), {"long_name": "lash"})
        labels = np.array([each.label for each in trajectory.lashes], object)
        file.create_dataset("label", data=labels, dtype=h5py.string_dtype(), track_order=True).dims[0].attach_scale(
            lash
        )
        severities = np.array([each.severity for each in trajectory.lashes])
        put("severity", severities, "rad s-2", "severity Q", [lash])
        scales, coordinates, contacts = [time, lash], history.backlash_coordinates, history.contacts
    put("backlash_coordinate", coordinates, "m", "backlash coordinate: radius times gap angle", scales)
    put("contact", contacts, "1", "flank in contact", scales)

    events = trajectory.events
    numbers = np.arange(events.size, dtype=np.int32)
    event = create_scale(file, "event", numbers, {"units": "1", "long_name": "number of the event, 0 the load step"})
    initial_sides = trajectory.initial_sides[np.maximum(events["lash"], 0)]
    flank = np.where(events["side"] == initial_sides, INITIAL, OPPOSITE)
    rank, severity = np.zeros(events.size, np.int8), np.full(events.size, np.nan)
    rank[events["kind"] == TOUCH] = 2
    for each in trajectory.lashes:
        rank[each.primaries], severity[each.primaries] = 1, each.impact_severity
    put("event_time", events["time"], "s", "time of the event after the load step", [event])
    put("event_kind", events["kind"].astype(np.int8), "1", "what happens", [event])
    put("event_flank", np.where(events["side"] == 0, NONE, flank).astype(np.int8), "1", "flank of the event", [event])
    if len(trajectory.lashes) > 1:
        numbers = (events["lash"] + 1).astype(np.int8)
        put("event_lash", numbers, "1", "number of the lash concerned, 0 at the load step", [event])
    put("event_speed", events["speed"], "rad s-1", "relative velocity across the lash just before", [event])
    put("event_impact", rank, "1", "whether the event is an impact", [event])
    put("event_severity", severity, "rad s-2", "peak-to-peak acceleration until the next primary impact", [event])


_FLANKS = {INITIAL: "initial", NONE: "none", OPPOSITE: "opposite"}
_FLAGS = {
    "contact": _FLANKS,
    "event_flank": _FLANKS,
    "event_kind": {code: name.replace(" ", "_") for code, name in enumerate(KIND_NAMES)},
    "event_impact": {0: "none", 1: "primary", 2: "secondary"},
}
