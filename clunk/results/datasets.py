"""Results as an xarray Dataset: named dimensions, coordinates with units, and each cell's label in words."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from clunk.results.dataset import Dataset, meanings_of
from clunk.results.labels import FAILED_CODE
from clunk.results.netcdf import content_digest, read
from clunk.results.store import dataset_of
from clunk.results.tolerancemap import AnyMap

if TYPE_CHECKING:
    import xarray


def open_results(path: str | os.PathLike[str]) -> xarray.Dataset:
    """Open a results file as an xarray Dataset.

    The file is checked and read whole (45 bytes a cell, and 25 a primary impact for as many of these as the cell that
    has most) and closed again, so that nothing that happens to it later changes the Dataset.

    Each variable is an array over the swept parameters, whose dotted names have become ``load_ratio`` and the like; its
    ``attrs`` have units and a description. `label` is text and `sequence` its code, ``failed`` and -1 in a cell whose
    run failed for the cause in `status`; its numbers are NaN. Of a tolerance map, `label` is a dimension of
    `probability`, and `most_likely_label` the text.

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
    """Hand over a dataset of a map, whatever variables it has, with its labels as text."""
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
