"""Files of thresholds: comma-separated values, JSON, or HDF5 laid out as netCDF-4."""

from __future__ import annotations

import csv
import io
import json
import os

import h5py
import numpy as np

from clunk.analysis.quantiles import QUANTILE
from clunk.analysis.thresholds import DRAW, UNCERTAIN, UNCERTAIN_CODE, ThresholdError, Thresholds, Word
from clunk.results.files import write_whole, writing
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.netcdf import create_scale, create_variable, set_flags, set_heading, set_text, write_file
from clunk.study.designs import drawn_numbers
from clunk.study.study import digest
from clunk.sweeping.tolerances import sample_of

SCHEMA_VERSION = 1
NONE_CODE = -2  # of the outcome beside a threshold that a cell does not have


def save(path: str | os.PathLike[str], thresholds: Thresholds) -> None:
    """Write thresholds to a file: .csv, .json, or else HDF5. Raises ThresholdError."""
    with writing(path, ThresholdError) as target:
        if target.suffix.lower() in _TEXTS:
            text = _TEXTS[target.suffix.lower()](thresholds)
            write_whole(target, lambda stream: stream.write(text.encode()))
        else:
            write_file(target, lambda file: _write_hdf5(file, thresholds))


def _csv(thresholds: Thresholds) -> str:
    """A row for each threshold; for a cell without any a row with its outcome, and no value."""
    text = io.StringIO()
    write = csv.writer(text, lineterminator="\n").writerow
    write([axis.parameter for axis in (*thresholds.axes, thresholds.along)] + ["below", "above"])
    for cell in thresholds.cells():
        none = {"value": "", "below": cell["lowest"], "above": cell["lowest"]}
        for row in cell["thresholds"] or [none]:
            write([*cell["at"].values(), row["value"], word_text(row["below"]), word_text(row["above"])])
    return text.getvalue()


def word_text(word: Word) -> str:
    """An outcome as text: true and false for whether something holds."""
    return str(word).lower() if isinstance(word, bool) else str(word)


def _json(thresholds: Thresholds) -> str:
    return json.dumps(thresholds.cells(), ensure_ascii=False) + "\n"


_TEXTS = {".csv": _csv, ".json": _json}


def _write_hdf5(file: h5py.File, thresholds: Thresholds) -> None:
    study, along = thresholds.study, thresholds.along
    set_heading(file, study, SCHEMA_VERSION)
    set_text(file, "along", along.parameter)
    set_text(file, "outcome", thresholds.outcome.name)
    if thresholds.lash:
        set_text(file, "lash", thresholds.lash)
    set_text(file, "config_digest", digest(study))
    cells = [
        create_scale(file, axis.variable, axis.values, {"units": axis.unit, "long_name": axis.name})
        for axis in thresholds.axes
    ]
    parameters = [axis.parameter for axis in thresholds.axes]
    if DRAW in parameters:
        assert study.sweep is not None
        for each in sample_of(study, drawn_numbers(study, study.sweep.tolerances)):
            attributes = {"units": each.unit, "long_name": each.name}
            scale = [cells[parameters.index(DRAW)]]
            create_variable(file, f"drawn_{each.variable}", np.float64, attributes, scale)[...] = each.values
    counts = np.bincount(thresholds.cell, minlength=thresholds.lowest.size)
    numbers = np.arange(1, max(1, counts.max()) + 1, dtype=np.int32)
    number = create_scale(file, "threshold", numbers, {"units": "1", "long_name": "number of the threshold"})
    has = np.arange(numbers.size) < counts[:, None]
    meanings = {code: word_text(word) for code, word in enumerate(thresholds.words)}
    meanings |= {FAILED_CODE: FAILED, NONE_CODE: "none"}
    meanings |= {UNCERTAIN_CODE: UNCERTAIN} if QUANTILE in parameters else {}
    for name, values, empty, unit, long_name in (
        (along.variable, thresholds.value, np.nan, along.unit, f"threshold of the {along.name}, NaN behind the last"),
        ("below", thresholds.below, NONE_CODE, "1", "outcome at smaller values, up to the threshold before"),
        ("above", thresholds.above, NONE_CODE, "1", "outcome at greater values, up to the next threshold"),
        ("lowest", thresholds.lowest, None, "1", "outcome at the least value of the axis"),
    ):
        dtype = np.float64 if name == along.variable else np.int32
        scales = cells if empty is None else [*cells, number]
        variable = create_variable(file, name, dtype, {"units": unit, "long_name": long_name}, scales)
        padded = values
        if empty is not None:
            padded = np.full(has.shape, empty, dtype)
            padded[has] = values
        variable[...] = padded.reshape(variable.shape).astype(dtype)
        if dtype is np.int32:
            set_flags(variable, meanings)
