"""Maps for other programs: a row for each cell as comma-separated values, or arrays in a MAT-file for MATLAB.

Their boundaries, a row for each vertex, or as GeoJSON.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from clunk.results.boundaries import Boundaries
from clunk.results.files import write_text, write_whole, writing
from clunk.results.labels import FAILED
from clunk.results.quantities import Quantity
from clunk.results.store import dataset_of
from clunk.results.tolerancemap import AnyMap
from clunk.study.arrays import Array
from clunk.study.axes import RUN
from clunk.study.errors import ClunkError

_ROWS = 4096  # cells, written at once


def save(path: str | os.PathLike[str], results: AnyMap) -> None:
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
        for each in [axis, *results.coordinates] if axis.parameter == RUN else [axis]:
            values = np.array(each.words, object) if each.words else each.values
            columns.append((_with_unit(each.parameter, each.unit), None, values[places]))
    for name, quantity in results.quantities.items():
        values, suffixes = results.arrays[name], [""]
        if quantity.dimension:
            values = dataset.padded(name)
            suffixes = [f"[{entry}]" for entry in dataset.variables[quantity.dimension].values.tolist()]
        for suffix, column in zip(suffixes, values.reshape(cells, -1).T, strict=True):
            columns.append((_with_unit(name + suffix, quantity.unit), quantity, column))
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    write = csv.writer(text, lineterminator="\n")
    write.writerow(heading for heading, _, _ in columns)
    for start in range(0, cells, _ROWS):
        part = slice(start, start + _ROWS)
        write.writerows(zip(*(_texts(of, column[part], results.labels) for _, of, column in columns), strict=True))
    text.detach()  # flushed, and the stream stays open


def _write_mat(stream: BinaryIO, results: AnyMap) -> None:
    """Write each variable of the results file as an array, and its unit; `labels` begins with that of the code -1."""
    from scipy.io import savemat
    from scipy.io.matlab import MatWriteError

    dataset = dataset_of(results)
    arrays: dict[str, Any] = {name: dataset.padded(name) for name in dataset.variables}
    arrays |= {name: values.astype(object) for name, values in arrays.items() if values.dtype.kind == "U"}
    units = {name: each.attributes["units"] for name, each in dataset.variables.items() if "units" in each.attributes}
    arrays |= {"labels": np.array([FAILED, *results.labels], object), "units": units}
    arrays |= {"title": results.title, "config": results.config}
    try:
        savemat(stream, arrays, long_field_names=True, do_compression=True, oned_as="column")
    except MatWriteError as error:
        raise ClunkError("The map is too large for a MAT-file; MATLAB reads the HDF5 file itself.") from error


WRITERS = {".csv": _write_csv, ".mat": _write_mat}


def save_boundaries(path: str | os.PathLike[str], boundaries: Boundaries) -> None:
    """Write boundaries in the format of the file name's suffix, one of `OF_BOUNDARIES`. Raises ClunkError."""
    write_text(path, OF_BOUNDARIES[Path(path).suffix.lower()](boundaries))


OF_BOUNDARIES: dict[str, Callable[[Boundaries], str]] = {
    ".csv": Boundaries.csv,
    ".geojson": lambda boundaries: json.dumps(boundaries.geojson(), ensure_ascii=False) + "\n",
}


def _texts(quantity: Quantity | None, values: Array, labels: tuple[str, ...]) -> list[Any]:
    """Values as a column: words for codes, those of its bits for the quality, and None for NaN."""
    meanings = {} if quantity is None else quantity.meanings(labels)
    if quantity is not None and quantity.coded == "quality":
        return [" ".join(word for bit, word in meanings.items() if value & bit) for value in values.tolist()]
    if meanings:
        words = meanings | {code: None for code, word in meanings.items() if word == "none"}
        return [words[value] for value in values.tolist()]
    return [value if value == value else None for value in values.tolist()]  # NaN does not equal itself


def _with_unit(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} [{unit}]"
