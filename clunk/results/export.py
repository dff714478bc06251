"""Maps and histories for other programs: comma-separated values, or GeoJSON."""

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from typing import Any, BinaryIO

import numpy as np

from clunk.core.events import TOUCH
from clunk.results.files import write_whole, writing
from clunk.results.maps import AnyMap
from clunk.results.quantities import Quantity
from clunk.results.store import dataset_of
from clunk.simulation.history import History
from clunk.simulation.trajectory import Trajectory
from clunk.study.arrays import Array
from clunk.study.document import FilePath
from clunk.study.errors import ClunkError
from clunk.study.records import with_unit

_ROWS = 4096  # cells that are converted to text at a time


def save(path: FilePath, results: AnyMap) -> None:
    """Write a map in the format of the file name's suffix, one of `WRITERS`. Raises ClunkError."""
    with writing(path) as target:
        write_whole(target, lambda stream: WRITERS[target.suffix.lower()](stream, results))


def _write_csv(stream: BinaryIO, results: AnyMap) -> None:
    """Write a row for each cell: its parameters and its quantities, codes as words, and nothing for NaN.

    A quantity of each primary impact, label or quantile has a column for each of these.
    """
    dataset, cells = dataset_of(results), math.prod(results.shape)
    columns: list[tuple[str, Quantity | None, Array]] = []  # heading, and the value in each cell
    for axis, places in zip(results.axes, np.unravel_index(np.arange(cells), results.shape), strict=True):
        for each in (axis, *axis.along):
            values = np.array(each.words, object) if each.words else each.values
            columns.append((with_unit(each.parameter, each.unit), None, values[places]))
    for name, quantity in results.quantities.items():
        values, suffixes = results.arrays[name], [""]
        if quantity.dimension:
            values = dataset.padded(name)
            suffixes = [f"[{entry}]" for entry in dataset.variables[quantity.dimension].values.tolist()]
        for suffix, column in zip(suffixes, values.reshape(cells, -1).T, strict=True):
            columns.append((with_unit(name + suffix, quantity.unit), quantity, column))
    parts = (slice(start, start + _ROWS) for start in range(0, cells, _ROWS))
    rows = (
        row
        for part in parts
        for row in zip(*(_texts(of, column[part], results.labels) for _, of, column in columns), strict=True)
    )
    _write_rows(stream, [heading for heading, _, _ in columns], rows)


def _write_rows(stream: BinaryIO, headings: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Write comma-separated values; numbers to full precision, and nothing for None."""
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    write = csv.writer(text, lineterminator="\n")
    write.writerow(headings)
    write.writerows(rows)
    text.detach()  # flushed, and the stream stays open


def _write_geojson(stream: BinaryIO, results: AnyMap) -> None:
    """Write the boundaries of a map as GeoJSON. Raises ClunkError where the map has none."""
    if results.boundaries is None:
        adds = "" if results.sample else "; clunk sweep --boundaries adds those of a grid of two axes"
        raise ClunkError(f"The map has no boundaries{adds}.")
    stream.write((json.dumps(results.boundaries.geojson(), ensure_ascii=False) + "\n").encode())


WRITERS = {".csv": _write_csv, ".geojson": _write_geojson}


def save_history(path: FilePath, history: History) -> None:
    """Write a history as comma-separated values, with the units in the names of the columns. Raises ClunkError.

    The last columns are the event, its lash (only if there are several) and its flank as text, in the row just after
    the event; in all other rows they are empty.
    """
    trajectory = history.trajectory
    several = len(trajectory.lashes) > 1
    suffixes = [f"_{lash}" for lash in range(1, len(trajectory.lashes) + 1)] if several else [""]
    names = ["time_s", "after_step_s"]
    for quantity, unit in (("theta", "rad"), ("theta_dot", "rad_per_s"), ("theta_ddot", "rad_per_s2")):
        names += [f"{quantity}_{inertia}_{unit}" for inertia in range(1, history.angle.shape[1] + 1)]
    names += ["torque_Nm", *(f"backlash_coordinate{suffix}_m" for suffix in suffixes)]
    names += [*(f"contact{suffix}" for suffix in suffixes), "event", *["lash"] * several, "flank"]
    numbers = (history.time, history.after_step, history.angle, history.velocity, history.acceleration)
    columns = np.column_stack((*numbers, history.torque, history.backlash_coordinates)).tolist()
    events = [_event(trajectory, k) if k >= 0 else [""] * (2 + several) for k in history.event.tolist()]
    rows = ([*row, *each, *event] for row, each, event in zip(columns, history.contacts.tolist(), events, strict=True))
    with writing(path) as target:
        write_whole(target, lambda stream: _write_rows(stream, names, rows))


def _event(trajectory: Trajectory, k: int) -> list[str]:
    """Texts of event `k`: its name (a touch is primary or secondary), its lash if there are several, and its flank."""
    name = trajectory.kind_name(k)
    if trajectory.events["kind"][k] == TOUCH:
        is_primary = any(k in each.primaries for each in trajectory.lashes)
        name = f"{'primary' if is_primary else 'secondary'} {name}"
    return [name, *[trajectory.lash_name(k)] * (len(trajectory.lashes) > 1), trajectory.flank_name(k)]


def _texts(quantity: Quantity | None, values: Array, labels: tuple[str, ...]) -> list[Any]:
    """Values of a column: words for codes, the words of all bits that are set for `quality`, and None for NaN."""
    meanings = {} if quantity is None else quantity.meanings(labels)
    if quantity is not None and quantity.coded == "quality":
        return [" ".join(word for bit, word in meanings.items() if value & bit) for value in values.tolist()]
    if meanings:
        words = meanings | {code: None for code, word in meanings.items() if word == "none"}
        return [words[value] for value in values.tolist()]
    return [value if value == value else None for value in values.tolist()]  # NaN does not equal itself
