"""Sums of products, and copies, of short arrays, within kernels; and a root of squares, which Python calls, too."""

import numpy as np

from clunk.core.arrays import FloatArray
from clunk.core.jit import compiled, inlined_part, part


@inlined_part
def weigh(weights: FloatArray, numbers: FloatArray) -> float:
    """The sum of the products of weights and numbers."""
    total = weights[0] * numbers[0]
    for k in range(1, weights.size):
        total += weights[k] * numbers[k]
    return total


@part
def combine(rows: FloatArray, numbers: FloatArray, to: FloatArray) -> None:
    """Set `to` to the sum of the rows, each times its number."""
    to[:] = 0.0
    for k in range(numbers.size):
        for r in range(to.size):
            to[r] += rows[k, r] * numbers[k]


@inlined_part
def copy(numbers: FloatArray, to: FloatArray) -> None:
    """Copy numbers to the beginning of `to`, which has as many elements or more."""
    for k in range(numbers.size):
        to[k] = numbers[k]


@compiled
def root_of_squares(values: FloatArray) -> float:
    """The square root of the sum of the squares of values, summed in order."""
    total = 0.0
    for i in range(values.size):
        total += values[i] ** 2
    return np.sqrt(total)
