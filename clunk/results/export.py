"""Maps for other programs: a row for each cell as comma-separated values, or arrays in a MAT-file for MATLAB.

Their boundaries, a row for each vertex, or as GeoJSON.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from clunk.results.boundaries import Boundaries
from clunk.results.files import write_text, write_whole, writing
from clunk.results.labels import FAILED
from clunk.results.maps import Map
from clunk.results.quantities import Quantity
from clunk.results.store import dataset_of
from clunk.results.tolerancemap import AnyMap
from clunk.study.arrays import Array
from clunk.study.axes import RUN, ResultAxis
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
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    write = csv.writer(text, lineterminator="\n")
    dataset, quantities = dataset_of(results), results.quantities.values()
    names = [_with_unit(each.parameter, each.unit) for axis in results.axes for each in _along(results, axis)]
    for quantity in quantities:
        entries = dataset.variables[quantity.dimension].values.tolist() if quantity.dimension else []
        of_each = [f"[{entry}]" for entry in entries] or [""]
        names += [_with_unit(quantity.name + suffix, quantity.unit) for suffix in of_each]
    write.writerow(names)
    cells_a_row = math.prod(results.shape[1:])
    rows = max(1, _ROWS // cells_a_row)
    for start in range(0, results.shape[0], rows):
        stop = min(start + rows, results.shape[0])
        cells = np.arange(start * cells_a_row, stop * cells_a_row)
        columns: list[list[Any]] = []
        for axis, places in zip(results.axes, np.unravel_index(cells, results.shape), strict=True):
            columns += [_texts_or_numbers(each)[places].tolist() for each in _along(results, axis)]
        for quantity in quantities:
            name = quantity.name
            values = dataset.rows(name, start, stop) if quantity.dimension else results.values(name)[start:stop]
            columns += [_texts(quantity, column, results.labels) for column in values.reshape(cells.size, -1).T]
        write.writerows(zip(*columns, strict=True))
    text.detach()  # flushed, and the stream stays open


def _write_mat(stream: BinaryIO, results: AnyMap) -> None:
    """Write each variable of the results file as an array, and its unit; `labels` begins with that of the code -1."""
    from scipy.io import savemat
    from scipy.io.matlab import MatWriteError

    dataset = dataset_of(results)
    arrays: dict[str, Any] = {name: dataset.rows(name) for name in dataset.variables}
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


def _along(results: Map, axis: ResultAxis) -> Sequence[ResultAxis]:
    return [axis, *results.coordinates] if axis.parameter == RUN else [axis]


def _texts_or_numbers(axis: ResultAxis) -> Array:
    return np.array(axis.words, object) if axis.words else axis.values


def _texts(quantity: Quantity, values: Array, labels: tuple[str, ...]) -> list[Any]:
    """Values as a column: words for codes, those of its bits for the quality, and None for NaN."""
    meanings = quantity.meanings(labels)
    if quantity.coded == "quality":
        return [" ".join(word for bit, word in meanings.items() if value & bit) for value in values.tolist()]
    if meanings:
        words = meanings | {code: None for code, word in meanings.items() if word == "none"}
        return [words[value] for value in values.tolist()]
    return [value if value == value else None for value in values.tolist()]  # NaN does not equal itself


def _with_unit(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} [{unit}]"
