"""Batches of drivelines that are alike but for numbers: arrays that have an axis of D drivelines in front."""

from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.arrays import IntArray


class UnlikeError(Exception):
    """Drivelines of a batch differ in more than numbers.

    parts : positions of those that are alike, (n,) each
    """

    def __init__(self, parts: list[IntArray]) -> None:
        super().__init__()
        self.parts = parts


def alike(patterns: Any, dimensions: int = 1) -> npt.NDArray[Any]:
    """The pattern, of so many dimensions, of one driveline, or the one that those of a batch have in common.

    Raises UnlikeError where they differ.
    """
    if patterns.ndim == dimensions:
        return patterns
    if (patterns != patterns[:1]).any():
        _, group_of = np.unique(patterns.reshape(len(patterns), -1), axis=0, return_inverse=True)
        raise UnlikeError([np.flatnonzero(group_of.ravel() == group) for group in range(group_of.max() + 1)])
    return patterns[0]
