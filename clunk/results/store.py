"""Conversion of maps to datasets and back, for results files and xarray.

A dataset has a variable for each axis, each quantity of the map (`clunk.results.quantities`) and each array of its
boundaries.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clunk.results.boundaries import boundaries_of, variables_of
from clunk.results.files import RESULTS, check, reason
from clunk.results.labels import FAILED_CODE
from clunk.results.maps import AnyMap, Results, ToleranceMap, quantities_of_config
from clunk.results.netcdf import (
    Dataset,
    StoreError,
    Variable,
    content_digest,
    flags,
    meanings_of,
    read,
    write,
)
from clunk.results.quantities import TOLERANCE_QUANTITIES
from clunk.study.arrays import Array
from clunk.study.axes import LASH, RUN, ResultAxis, lash_axis, run_axis
from clunk.study.document import FilePath

if TYPE_CHECKING:
    import xarray

_KIND = "kind"  # attribute of a tolerance map; a regime map has none
_TOLERANCE_MAP = "tolerance map"
_FIELDS = ("title", "config", "config_digest", _KIND)  # attributes of a dataset that are not in a map's `attributes`
_DIMENSIONS = {  # dimension behind a map's axes -> attributes of its coordinate
    "impact": {"units": "1", "long_name": "number of the primary impact"},
    "label": {"units": "1", "long_name": "sequence of impact excursions (regime label)"},
    "quantile": {"units": "1", "long_name": "quantile of the runs of the sample"},
    "draw": {"units": "1", "long_name": "number of the draw"},
}
_DRAWN = "drawn_"  # begins the names of the sample's variables


def write_results(path: FilePath, results: AnyMap, scratch: Path | None = None) -> None:
    """Write a results file so that at every moment `path` is either the old file or the complete new one.

    Missing parent directories are made. The incomplete file is in `scratch`, by default in the same directory.
    Raises ClunkError where the file cannot be written, or its name does not end in .h5.

    Examples
    --------
    >>> import clunk
    >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"))
    >>> clunk.write_results("results/copy.h5", results)
    """
    check(Path(path), RESULTS)
    write(path, dataset_of(results), scratch)


def read_results(path: FilePath) -> Results:
    """Read a regime map from a results file, whose checksum is verified. Raises StoreError.

    Examples
    --------
    >>> import clunk
    >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"), "results/smoke.h5")
    >>> clunk.read_results("results/smoke.h5").label_map[10, 6]
    np.str_('DS(1)SS(1)')
    """
    results = read_map(path)
    if not isinstance(results, Results):
        raise StoreError(
            f"{path} holds a tolerance map, where a regime map is needed: sweep without [[sweep.tolerances]], or read "
            "it by clunk.read_map."
        )
    return results


def read_map(path: FilePath) -> AnyMap:
    """Read a map of either kind from a results file, whose checksum is verified. Raises StoreError.

    Examples
    --------
    >>> import clunk
    >>> fewer = ["sweep.sampling.count=4", "sweep.axes[1].count=3", "sweep.axes[2].count=3"]
    >>> study = clunk.load_study("configs/tolerance.toml", fewer)
    >>> tolerances = clunk.tolerance_map(study, "results/tolerance.h5")
    >>> clunk.read_map("results/tolerance.h5").draws
    4
    """
    try:
        return map_of(read(path))
    except LookupError as error:  # the checksum is right: another version wrote the file
        raise StoreError(f"{path} lacks what this clunk reads ({reason(error)}): run the sweep again.") from error


# --- from maps to datasets


def dataset_of(results: AnyMap) -> Dataset:
    """Convert a map to a dataset."""
    names, sample = tuple(axis.variable for axis in results.axes), results.sample
    variables = {name: _of_axis(axis, name) for name, axis in zip(names, results.axes, strict=True)}
    variables |= {axis.variable: _of_axis(axis, RUN) for axis in results.coordinates}
    for name, entries in results.entries.items():
        of_sample = {"sample": " ".join(_DRAWN + axis.variable for axis in sample)} if name == "draw" else {}
        variables[name] = Variable((name,), entries, _DIMENSIONS[name] | of_sample)
    variables |= {_DRAWN + axis.variable: _of_axis(axis, "draw") for axis in sample}
    coordinates = " ".join(axis.variable for axis in results.coordinates)
    of_cell = names[: len(names) - bool(results.lashes)]
    for name, each in results.quantities.items():
        attributes: dict[str, str | Array] = {"units": each.unit, "long_name": each.long_name}
        attributes |= {"coordinates": coordinates} if coordinates else {}
        attributes |= flags(each.meanings(results.labels), each.dtype, masks=each.coded == "quality")
        values, dims = results.arrays[name], names
        if each.of == "cell" and results.lashes:
            values, dims = values[..., 0], of_cell
        dims = (*dims, each.dimension) if each.dimension else dims
        variables[name] = Variable(dims, values, attributes)
    if results.boundaries is not None:
        variables |= variables_of(results.boundaries)
    identity = {"title": results.title, "config": results.config, "config_digest": results.config_digest}
    return Dataset(variables, results.attributes | identity | ({_KIND: _TOLERANCE_MAP} if sample else {}))


def _of_axis(axis: ResultAxis, dim: str) -> Variable:
    values = np.array(axis.words) if axis.words else axis.values
    attributes = {"units": axis.unit, "long_name": axis.name, "symbol": axis.symbol, "parameter": axis.parameter}
    return Variable((dim,), values, attributes)


# --- from datasets to maps


def map_of(dataset: Dataset) -> AnyMap:
    """Convert a dataset to a map. Raises LookupError where the dataset lacks a variable or an attribute."""
    variables, attributes = dataset.variables, dataset.attributes
    sequence = variables["sequence"]
    along = [_axis_of(variables[name]) for name in str(sequence.attributes.get("coordinates", "")).split()]
    axes = tuple(run_axis(along) if dim == RUN else _axis_of(variables[dim]) for dim in sequence.dims)
    is_tolerance_map = attributes.get(_KIND) == _TOLERANCE_MAP
    sample = str(variables["draw"].attributes["sample"]).split() if is_tolerance_map else []
    meanings = meanings_of(sequence)
    quantities = TOLERANCE_QUANTITIES if is_tolerance_map else quantities_of_config(attributes["config"])
    lashes = axes[-1].words
    arrays = {name: variables[name].values for name in quantities}
    for name, quantity in quantities.items():
        if quantity.of == "cell" and lashes:
            arrays[name] = arrays[name][..., None].repeat(len(lashes), axis=-1)
    return (ToleranceMap if is_tolerance_map else Results)(
        title=attributes["title"],
        axes=axes,
        labels=tuple(meanings[code] for code in range(len(meanings) - 1)),
        config=attributes["config"],
        config_digest=attributes["config_digest"],
        attributes={name: text for name, text in attributes.items() if name not in _FIELDS},
        sample=tuple(_axis_of(variables[name]) for name in sample),
        boundaries=boundaries_of(variables, tuple(axis for axis in axes if axis.parameter != LASH)),
        arrays=arrays,
    )


def _axis_of(variable: Variable) -> ResultAxis:
    if variable.attributes["parameter"] == LASH:
        return lash_axis(variable.values.tolist())
    name, symbol, unit = (str(variable.attributes[key]) for key in ("long_name", "symbol", "units"))
    values = np.asarray(variable.values, np.float64)
    return ResultAxis(str(variable.attributes["parameter"]), values, name, symbol, unit)


# --- as xarray has them


def open_results(path: FilePath) -> xarray.Dataset:
    """Open a results file as an xarray Dataset.

    The file is checked, read whole into memory and closed, so that later changes of the file do not change the Dataset.
    The quantities of a regime map take 45 bytes a cell, and 25 more for each primary impact of the cell that has most;
    the labels' texts take 4 bytes a cell for each character of the longest one.

    Each variable is an array over the swept parameters, whose dotted names become ``load_ratio`` and the like; its
    ``attrs`` have units and a description. `label` is text and `sequence` its code. In a cell whose run failed these
    are ``failed`` and -1, `status` says why, and numbers are NaN. In the Dataset of a tolerance map, `label` is a
    dimension of `probability`, and the texts are in `most_likely_label`.

    Parameters
    ----------
    path : path of a results file

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    StoreError
        Where the file cannot be read, is damaged, or is no results file.
    ImportError
        Where xarray is not installed; `clunk.read_results` needs none.

    Examples
    --------
    >>> import clunk
    >>> study = clunk.load_study("configs/smoke.toml")
    >>> results = clunk.sweep(study, "results/smoke.h5", boundaries=False)
    >>> dataset = clunk.open_results("results/smoke.h5")
    >>> dict(dataset.sizes)
    {'load_ratio': 21, 'lash_backlash_deg': 21, 'impact': 6}
    >>> dataset.label.sel(load_ratio=5.0, lash_backlash_deg=6.0).item()
    'DS(1)SS(1)'
    >>> dataset.severity.where(dataset.label == "SS(1)").max().item() < dataset.severity.max().item()
    True
    """
    return _to_xarray(read(path))


def to_dataset(results: AnyMap) -> xarray.Dataset:
    """Convert results to the xarray Dataset that `open_results` makes of their file.

    Raises
    ------
    ImportError
        Where xarray is not installed.

    Examples
    --------
    >>> import clunk
    >>> dataset = clunk.to_dataset(clunk.sweep(clunk.load_study("configs/smoke.toml")))
    >>> dataset.severity.attrs["units"]
    'rad s-2'
    """
    return _to_xarray(dataset_of(results))


def _to_xarray(dataset: Dataset) -> xarray.Dataset:
    """Convert the dataset of a map to xarray, with all of its variables and with labels as text."""
    try:
        import xarray
    except ImportError as error:
        raise ImportError("A Dataset needs xarray: pip install 'clunk[xarray]'.") from error

    sequence = dataset.variables["sequence"]
    along_run = str(sequence.attributes.get("coordinates", "")).split()
    arrays = {
        name: (each.dims, dataset.padded(name), {k: v for k, v in each.attributes.items() if k != "coordinates"})
        for name, each in dataset.variables.items()
    }
    coordinates = {name: arrays.pop(name) for name, each in dataset.variables.items() if each.dims == (name,)}
    coordinates |= {name: arrays.pop(name) for name in along_run}
    labels = meanings_of(sequence)
    words = np.array([labels[code] for code in sorted(labels)])[sequence.values - FAILED_CODE]
    label = (sequence.dims, words, {"units": "1", "long_name": sequence.attributes["long_name"]})
    name = "label" if "label" not in coordinates else "most_likely_label"
    attributes = {**dataset.attributes, "content_digest": content_digest(dataset)}
    return xarray.Dataset({name: label, **arrays}, coordinates, attributes)
