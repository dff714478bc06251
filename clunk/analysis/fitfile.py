"""Files of fits: HDF5 laid out as netCDF-4."""

from __future__ import annotations

import os
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from clunk.analysis.fitparts import FitError
from clunk.analysis.fitruns import MATCH, label_of, pattern_of
from clunk.analysis.fitted import Fewer, Fitted
from clunk.analysis.fitting import identity
from clunk.analysis.measurements import experiment_of
from clunk.results.files import reason, writing
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.netcdf import (
    Image,
    create_scale,
    create_variable,
    get_text,
    set_flags,
    set_heading,
    set_text,
    write_file,
)
from clunk.study.arrays import Patterns, Records
from clunk.study.config import study_from_text

SCHEMA_VERSION = 1
_CONTENT = "fit"
_NUMBERS = ("axis", "candidates", "failed")

# Names in the file -> fields of MATCH, long name; `sequence` beside them
_MATCHES = {
    "distance": ("distance", "logarithm of the change of a measured value that brings about the measured label"),
    "distance_change": ("change", "the change itself, with its sign; 0 where none brings it about"),
    "misfit": ("misfit", "minus the logarithm of the likelihood of the measured times, speeds and severities"),
    "status": ("status", "status of the run: 0 is ok"),
}


def save(path: str | os.PathLike[str], fitted: Fitted, lash: str | None, scratch: Path | None = None) -> None:
    """Write a fit to an HDF5 file, whole or not at all; lash : as `fit` took it. Raises FitError."""
    with writing(path, FitError) as target:
        write_file(target, lambda file: _fill(file, fitted, lash), scratch)


def _fill(file: Image, fitted: Fitted, lash: str | None) -> None:
    set_heading(file, fitted.study, SCHEMA_VERSION)
    set_text(file, "content", _CONTENT)
    set_text(file, "fit_digest", identity(fitted.study, fitted.experiment, lash))
    file.attrs["measurements"] = fitted.experiment.text
    set_text(file, "measurements_name", fitted.experiment.name)
    set_text(file, "lash", lash or "")
    for name in _NUMBERS:
        file.attrs[name] = np.int64(getattr(fitted, name))
    names = np.array([f"{prior.parameter} ({prior.draws})" for prior in fitted.priors])
    parameter = create_scale(file, "parameter", names, {"long_name": "fitted parameter, and what its number is"})
    scales = {
        name: create_scale(file, name, np.arange(1, count + 1, dtype=np.int32), {"units": "1", "long_name": words})
        for name, count, words in (
            ("measurement", len(fitted.points), "number of the measurement"),
            ("draw", len(fitted.coordinates), "number of the draw"),
            ("fewer", max(len(fitted.fewer), 1), "number of parameters of a fit of the first ones alone"),
        )
    }
    measurement, draw = scales["measurement"], scales["draw"]

    def write(name: str, values: npt.NDArray[np.generic], words: str, *along: h5py.Dataset) -> h5py.Dataset:
        variable = create_variable(file, name, values.dtype, {"units": "1", "long_name": words}, along)
        variable[...] = values
        return variable

    write("estimate", fitted.estimate, "number of the best candidate", parameter)
    write("number", fitted.draws, "number of a draw", draw, parameter)
    write("coordinate", fitted.coordinates, "draw where the prior is standard normal", draw, parameter)
    write("weight", fitted.weights, "weight of a draw; all add up to 1", draw)
    write("log_density", fitted.log_density, "logarithm of the density that proposed a draw, over the prior", draw)
    write("best_distance", fitted.best_distances, "least distance of any candidate", measurement)
    blocks: dict[str, tuple[Records, tuple[h5py.Dataset, ...]]] = {"draw_": (fitted.matches, (draw, measurement))}
    blocks |= {f"{name}_": (getattr(fitted, f"{name}_matches"), (measurement,)) for name in ("estimate", "nominal")}
    every = np.unique(np.concatenate([fitted.wanted, *(each["pattern"].ravel() for each, _ in blocks.values())]))
    labels = {int(pattern): label_of(int(pattern)) for pattern in every if pattern}
    codes = {
        pattern: code for code, pattern in enumerate(sorted(labels, key=lambda each: (each.bit_length(), labels[each])))
    }
    meanings = {FAILED_CODE: FAILED} | {code: labels[pattern] for pattern, code in codes.items()}
    codes[0] = FAILED_CODE

    def sequences(patterns: Patterns) -> npt.NDArray[np.int16]:
        unique, inverse = np.unique(patterns, return_inverse=True)
        return np.array([codes[int(each)] for each in unique], np.int16)[inverse.reshape(patterns.shape)]

    set_flags(write("measured_sequence", sequences(fitted.wanted), "measured label", measurement), meanings)
    for prefix, (matches, along) in blocks.items():
        set_flags(write(f"{prefix}sequence", sequences(matches["pattern"]), "label", *along), meanings)
        for name, (field, words) in _MATCHES.items():
            write(prefix + name, matches[field].astype(matches[field].dtype.newbyteorder("=")), words, *along)
    for name in ("met", "predicted", "effective"):
        values = np.array([getattr(each, name) for each in fitted.fewer] or [0], np.float64)
        write(f"fewer_{name}", values, f"{name}, of a fit of the first parameters alone", scales["fewer"])


def finished(path: Path, digest: str, force: bool) -> Fitted | None:
    """Fit of this identity that a file holds; None without a file, or where another one is to be overwritten.

    Raises FitError where the file holds something else, and is not to be overwritten.
    """
    if not path.exists():
        return None
    ways_out = "Name another file, or overwrite it with --force (in Python, force=True)."
    try:
        fitted, its_digest = load(path)
    except FitError as error:
        if force:
            return None
        raise FitError(f"{error} It is in the way of the fit. {ways_out}") from error
    if its_digest != digest and not force:
        raise FitError(f"{path} holds the fit of another config or of other measurements. {ways_out}")
    return fitted if its_digest == digest else None


def load(path: str | os.PathLike[str]) -> tuple[Fitted, str]:
    """Read a fit and the digest of everything that decided it. Raises FitError."""
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("content") is None or get_text(file, "content") != _CONTENT:
                raise FitError(f"{path} holds no fit.")
            return _loaded(file), get_text(file, "fit_digest")
    except (OSError, KeyError, ValueError) as error:
        raise FitError(f"{path} cannot be read as a fit: {reason(error)}.") from error


def _loaded(file: h5py.File) -> Fitted:
    def matches(prefix: str) -> Records:
        sequence = file[f"{prefix}sequence"]
        meanings = get_text(sequence, "flag_meanings").split()
        patterns = {
            int(code): 0 if text == FAILED else pattern_of(text)
            for code, text in zip(sequence.attrs["flag_values"], meanings, strict=True)
        }
        unique, inverse = np.unique(sequence[...], return_inverse=True)
        records = np.zeros(sequence.shape, MATCH)
        records["pattern"] = np.array([patterns[int(code)] for code in unique], np.uint64)[
            inverse.reshape(sequence.shape)
        ]
        for name, (field, _) in _MATCHES.items():
            records[field] = file[prefix + name][...]
        return records

    study = study_from_text(file.attrs["config"], source="the fit's config")
    assert study.fit is not None
    columns = zip(*(file[f"fewer_{name}"][...].tolist() for name in ("met", "predicted", "effective")), strict=True)
    fewer = [Fewer(k, int(met), int(predicted), size) for k, (met, predicted, size) in enumerate(columns, 1)]
    lash = get_text(file, "lash")
    return Fitted(
        study=study,
        experiment=experiment_of(file.attrs["measurements"], get_text(file, "measurements_name")),
        lash=lash or study.lash_names[0],
        estimate=file["estimate"][...],
        estimate_matches=matches("estimate_"),
        nominal_matches=matches("nominal_"),
        coordinates=file["coordinate"][...],
        matches=matches("draw_"),
        log_density=file["log_density"][...],
        best_distances=file["best_distance"][...],
        fewer=tuple(fewer)[: len(study.fit.parameters) - 1],
        **{name: int(file.attrs[name]) for name in _NUMBERS},
    )
