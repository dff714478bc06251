"""Batches of drivelines of one structure, which differ in numbers only: their arrays have an axis of D in front."""

from typing import Any

import numpy as np

from clunk.core.arrays import Array, IntArray


class UnlikeError(Exception):
    """Drivelines of a batch differ in more than numbers.

    parts : for each group of drivelines that are alike, their positions in the batch, (n,)
    """

    def __init__(self, parts: list[IntArray]) -> None:
        super().__init__()
        self.parts = parts


def alike(patterns: Any, dimensions: int = 1) -> Array:
    """The pattern of one driveline, an array of `dimensions` axes, or the one that all drivelines of a batch share.

    Raises UnlikeError where the patterns of a batch, with one more axis in front, differ.
    """
    if patterns.ndim == dimensions:
        return patterns
    if (patterns != patterns[:1]).any():
        _, group_of = np.unique(patterns.reshape(len(patterns), -1), axis=0, return_inverse=True)
        raise UnlikeError([np.flatnonzero(group_of.ravel() == group) for group in range(group_of.max() + 1)])
    return patterns[0]
