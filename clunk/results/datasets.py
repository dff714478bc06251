"""Results as an xarray Dataset: named dimensions, coordinates with units, and each cell's label in words."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from clunk.results.labels import FAILED_CODE
from clunk.results.regimemap import Results
from clunk.results.store import map_of, opened, to_image
from clunk.results.tolerancemap import AnyMap

if TYPE_CHECKING:
    from xarray import Dataset


def open_results(path: str | os.PathLike[str]) -> Dataset | AnyMap:
    """Open a results file as an xarray Dataset, or as `Results` or `ToleranceMap` where xarray is not installed.

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
    xarray.Dataset, or Results or ToleranceMap

    Raises
    ------
    StoreError
        Where the file cannot be read, is damaged, or is no results file.

    Examples
    --------
    >>> import clunk
    >>> study = clunk.load_study("configs/smoke.toml")
    >>> results = clunk.sweep(study, "results/smoke.h5")
    >>> dataset = clunk.open_results("results/smoke.h5")
    >>> dict(dataset.sizes)
    {'load_ratio': 21, 'lash_backlash_deg': 21, 'impact': 6}
    >>> dataset.label.sel(load_ratio=5.0, lash_backlash_deg=6.0).item()
    'DS(1)SS(1)'
    >>> dataset.severity.where(dataset.label == "SS(1)").max().item() < dataset.severity.max().item()
    True
    """
    with opened(path) as (file, header, source):
        return _dataset(source) if _has_xarray() else map_of(file, header)


def to_dataset(results: Results) -> Dataset:
    """Convert results to the xarray Dataset that `open_results` makes of their file.

    Raises
    ------
    ImportError
        Where xarray or h5netcdf is not installed.

    Examples
    --------
    >>> import clunk
    >>> dataset = clunk.to_dataset(clunk.sweep(clunk.load_study("configs/smoke.toml")))
    >>> dataset.severity.attrs["units"]
    'rad s-2'
    """
    if not _has_xarray():
        raise ImportError("A Dataset needs xarray and h5netcdf: pip install 'clunk[xarray]'.")
    return _dataset(to_image(results))


def _dataset(source: str | os.PathLike[str] | BinaryIO) -> Dataset:
    """Load a results file with xarray, whatever variables it has, and add its labels as text."""
    import xarray

    dataset = xarray.load_dataset(source, engine="h5netcdf")
    codes = dataset["sequence"]
    labels = dict(zip(codes.attrs["flag_values"].tolist(), codes.attrs["flag_meanings"].split(), strict=True))
    ordered = np.array([labels[code] for code in sorted(labels)])
    name = "label" if "label" not in dataset.dims else "most_likely_label"
    label = codes.copy(data=ordered[codes.to_numpy() - FAILED_CODE])
    label.attrs = {"units": "1", "long_name": codes.attrs["long_name"]}
    return dataset.assign({name: label})[[name, *dataset.data_vars]]


def _has_xarray() -> bool:
    try:
        import h5netcdf  # noqa: F401  # xarray opens results with it
        import xarray  # noqa: F401
    except ImportError:
        return False
    return True
