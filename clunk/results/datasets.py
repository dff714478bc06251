"""Results as an xarray Dataset: named dimensions, coordinates with units, and each cell's label in words."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from clunk.results.labels import FAILED_CODE
from clunk.results.regimemap import Results
from clunk.results.store import map_of, opened, to_image
from clunk.results.tolerancemap import ToleranceMap

if TYPE_CHECKING:
    from xarray import Dataset


def open_results(path: str | os.PathLike[str]) -> Dataset | Results | ToleranceMap:
    """The results in a file, for looking at them: an xarray Dataset, or `Results` where xarray is not installed.

    The file is read whole, compared with its checksum and digest, and closed again: 45 bytes a cell, and 25 a primary
    impact for as many of these as the cell that has most. So nothing that happens to it later, like the next sweep into
    it, can change or break what is in hand.

    In the Dataset each variable is an array over the swept parameters, whose dotted names have become ``load_ratio``
    and the like; ``attrs`` tell units and what is meant. `label` is text and `sequence` its code; ``failed`` and -1
    stand for a failed cell, whose numbers are NaN and whose `status` tells the cause. Of a tolerance map, `label` is a
    dimension of `probability`, and `most_likely_label` the text.

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
    >>> found = clunk.open_results("results/smoke.h5")
    >>> dict(found.sizes)
    {'load_ratio': 21, 'lash_backlash_deg': 21, 'impact': 6}
    >>> found.label.sel(load_ratio=5.0, lash_backlash_deg=6.0).item()
    'DS(1)SS(1)'
    >>> found.severity.where(found.label == "SS(1)").max().item() < found.severity.max().item()
    True
    """
    with opened(path) as (file, header, source):
        return _dataset(source) if _has_xarray() else map_of(file, header)


def to_dataset(results: Results) -> Dataset:
    """The Dataset that `open_results` makes of a file with these results.

    Raises
    ------
    ImportError
        Where xarray or h5netcdf is not installed.

    Examples
    --------
    >>> import clunk
    >>> found = clunk.to_dataset(clunk.sweep(clunk.load_study("configs/smoke.toml")))
    >>> found.severity.attrs["units"]
    'rad s-2'
    """
    if not _has_xarray():
        raise ImportError("A Dataset needs xarray and h5netcdf: pip install 'clunk[xarray]'.")
    return _dataset(to_image(results))


def _dataset(source: str | os.PathLike[str] | BinaryIO) -> Dataset:
    """What xarray makes of a results file, and its labels as text; whatever else a file has comes with it."""
    import xarray

    with xarray.open_dataset(source, engine="h5netcdf") as opened:
        dataset = opened.load()
    codes = dataset["sequence"]
    words = dict(zip(codes.attrs["flag_values"].tolist(), codes.attrs["flag_meanings"].split(), strict=True))
    ordered = np.array([words[code] for code in sorted(words)])
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
