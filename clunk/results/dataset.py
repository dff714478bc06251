"""Named arrays over named dimensions, with what is said of them: what a file holds, whatever kind of map it is.

Knows neither quantities nor file formats.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clunk.study.arrays import Array

# Last dimension of a variable -> the variable that tells how many entries along it each cell has.
COUNTED_BY = {"impact": "primary_impacts"}


@dataclass(frozen=True, eq=False)
class Variable:
    """An array over named dimensions.

    dims : their names; a variable named after its only dimension is the coordinate of that
    values : in the shape of the dimensions; along one of `COUNTED_BY`, the entries of all cells in C order, flat
    attributes : texts, numbers and arrays by name; `units` and `long_name` are among them
    """

    dims: tuple[str, ...]
    values: Array
    attributes: Mapping[str, str | Array]


@dataclass(frozen=True, eq=False)
class Dataset:
    """Variables by name, those of dimensions before what lies along them, and what is said of all."""

    variables: Mapping[str, Variable]
    attributes: Mapping[str, str]

    def padded(self, name: str) -> Array:
        """Values of a variable in the shape of its dimensions; behind the last entry of a cell NaN (floats) or 0."""
        variable = self.variables[name]
        if variable.values.ndim == len(variable.dims):
            return variable.values
        counts, most = (self.variables[each].values for each in (COUNTED_BY[variable.dims[-1]], variable.dims[-1]))
        is_entry = has_entry(counts, most.size)
        padded = np.full(is_entry.shape, np.nan if variable.values.dtype.kind == "f" else 0, variable.values.dtype)
        padded[is_entry] = variable.values
        return padded


def has_entry(counts: npt.NDArray[np.int32], most: int) -> npt.NDArray[np.bool_]:
    """Mask of the places of padded values that hold an entry, shape of `counts` + (most,)."""
    return np.asarray(np.arange(most) < counts[..., None])


def flags(meanings: Mapping[int, str], dtype: npt.DTypeLike, *, masks: bool = False) -> dict[str, str | Array]:
    """CF's attributes on the meanings of a variable's integers or, with `masks`, of their bits; none without any."""
    if not meanings:
        return {}
    words = " ".join(meanings.values())
    return {"flag_masks" if masks else "flag_values": np.array(list(meanings), dtype), "flag_meanings": words}


def meanings_of(variable: Variable) -> dict[int, str]:
    """Word of each of a variable's integers, by its CF attributes. Raises KeyError, ValueError without these."""
    codes, words = np.asarray(variable.attributes["flag_values"]), str(variable.attributes["flag_meanings"]).split()
    return dict(zip(codes.tolist(), words, strict=True))
