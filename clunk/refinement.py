"""Which cells of a map have to be run, where the others follow from their neighbours: index logic and no physics.

The grid is cut into blocks between every `spacing`-th cell of each axis, and these into halves, down to single cells.
A block's edges belong to it, so that what a neighbour's refinement finds on a shared edge counts too. It is halved,
and the corners of its halves are run, where

- known cells in it differ in kind (regime and initial flank), or one is doubtful: it failed, or was decided by a hair;
- known cells differ in the number of touches; in a block of up to four cells, by two touches or more;
- a known cell is on a crest of the number of touches: there are fewer on either side of it.

The last two are for regimes thinner than a cell, single cells of OS(1)DS(1) within DS(1) on the report's map. Such a
regime is a touch more than its neighbours have, just hard or late enough to be primary: it lies on a crest, or where
touches accumulate, and these lines are much longer than it and are followed along their whole length. On the grid it is
a dashed line; so all within a few cells of a cell that differs from both neighbours is run, too.

Every cell that is left then lies in a block whose known cells are of one kind. The cells run are the smallest set
closed under these rules, so that they depend neither on the order of the runs nor on where they were interrupted.

What is nowhere seen from that set is missed: an island between the cells of the coarse grid that none of these lines
meets.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise, product

import numpy as np
import numpy.typing as npt

UNKNOWN = -1  # kind and touches of a cell that has not been run; _extremes relies on it
DOUBTFUL = -2  # kind of one whose neighbours must be run whatever they are

COARSE_INTERVALS = 60  # of an axis, at least: every 16th of 1001 cells
# With these, 63,075 cells are run, and none of that map is missed, nor of 20 cuttings of it. Crests over 2 cells only
# missed one in 4 of the 20. Following every change of touches down to single cells would run 115,000. Without the gaps,
# 20 of 78,961 were missed where an inertia is swept instead, and 12 with the inertias as printed; with them, none.
_WIDE = 4  # cells; what the number of touches does within such a block is followed only where it jumps or has a crest
_CREST = 5  # cells to either side
_GAP = 4  # cells between the dashes of a thin regime

_HIGHEST = np.iinfo(np.int32).max

Integers = npt.NDArray[np.int32]
Cells = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


def spacings(axes: Sequence[npt.NDArray[np.float64]], intervals: int = COARSE_INTERVALS) -> tuple[int, ...]:
    """The coarse spacing of each axis: the largest power of two that leaves so many intervals, or 1.

    axes : each (count,), the values; where they neither rise nor fall throughout, neighbours tell nothing: 1
    """
    found = []
    for values in axes:
        steps = np.diff(values)
        room = (len(values) - 1) // intervals if np.all(steps > 0.0) or np.all(steps < 0.0) else 0
        found.append(1 << max(0, room.bit_length() - 1))
    return tuple(found)


def wanted(kinds: Integers, touches: Integers, spacing: Sequence[int]) -> Cells:
    """The cells to run next, in ascending order; none where all others can be inferred.

    Parameters
    ----------
    kinds : shape, int32
        What a cell was found to be (a number from 0), `UNKNOWN` or `DOUBTFUL`.
    touches : shape, int32
        Its number of touches, or `UNKNOWN`.
    spacing : a power of two for each axis
    """
    levels = _levels(kinds.shape, spacing)
    mask = np.zeros(kinds.shape, bool)
    mask[np.ix_(*levels[0])] = True
    for (coarse, fine), blocks in zip(pairwise(levels), _mixed(kinds, touches, spacing), strict=True):
        halved = blocks
        for axis, (ends, points) in enumerate(zip(coarse, fine, strict=True)):
            last = max(0, len(ends) - 2)
            left = np.clip(np.searchsorted(ends, points, side="left") - 1, 0, last)
            right = np.clip(np.searchsorted(ends, points, side="right") - 1, 0, last)
            halved = halved.take(left, axis) | halved.take(right, axis)
        if halved.shape == mask.shape:
            mask |= halved
        else:
            mask[np.ix_(*fine)] |= halved
    _mark_around(mask, _thin(kinds, spacing), spacing)
    mask &= kinds == UNKNOWN
    return np.flatnonzero(mask).astype(np.int64)


def inferred(kinds: Integers, touches: Integers, spacing: Sequence[int]) -> tuple[Cells, Cells]:
    """The unknown cells, in ascending order, and for each a known one of its block, whose kind it has.

    Only where nothing is `wanted` any more.
    """
    levels = _levels(kinds.shape, spacing)
    source = np.full(kinds.shape, UNKNOWN, np.int64)
    flat = np.arange(kinds.size, dtype=np.int64).reshape(kinds.shape)
    for ends, mixed in zip(levels, _mixed(kinds, touches, spacing), strict=False):
        block = [
            np.clip(np.searchsorted(axis_ends, np.arange(count), side="right") - 1, 0, max(0, len(axis_ends) - 2))
            for axis_ends, count in zip(ends, kinds.shape, strict=True)
        ]
        agreed = (source == UNKNOWN) & ~mixed[np.ix_(*block)]
        corner = flat[np.ix_(*(axis_ends[index] for axis_ends, index in zip(ends, block, strict=True)))]
        source[agreed] = corner[agreed]
    cells = np.flatnonzero(kinds == UNKNOWN).astype(np.int64)
    return cells, source.ravel()[cells]


def _levels(shape: Sequence[int], spacing: Sequence[int]) -> list[tuple[Cells, ...]]:
    """For each level, coarsest first, each axis's positions between which its blocks lie; the last has every cell."""
    steps = [1 << k for k in range(int(math.log2(max(spacing))), -1, -1)]
    return [
        tuple(_positions(count, min(step, widest)) for count, widest in zip(shape, spacing, strict=True))
        for step in steps
    ]


def _positions(count: int, step: int) -> Cells:
    """Every `step`-th of `count` cells, and the last."""
    return np.unique(np.append(np.arange(0, count, step, dtype=np.int64), count - 1))


def _mixed(kinds: Integers, touches: Integers, spacing: Sequence[int]) -> list[Mask]:
    """For each level but the last, which of its blocks are to be halved."""
    doubtful = np.flatnonzero((kinds == DOUBTFUL) | _crest(touches, spacing))
    low, high = kinds.copy(), kinds.copy()
    low.flat[doubtful], high.flat[doubtful] = 0, _HIGHEST
    found = [low < high for low, high in _extremes(low, high, spacing)]
    for k, (low, high) in enumerate(_extremes(touches, touches, spacing)):
        found[k] |= high - low >= (2 if 2 << k <= _WIDE else 1)
    return found[::-1]


def _crest(touches: Integers, spacing: Sequence[int]) -> Mask:
    """Where a cell has more touches than some known cell on either side of it, along an axis or a diagonal."""
    padded = np.pad(touches, _CREST, constant_values=_HIGHEST)
    padded[padded == UNKNOWN] = _HIGHEST
    values, strides = padded.ravel(), [stride // padded.itemsize for stride in padded.strides]
    known = np.flatnonzero(values != _HIGHEST)
    own = values[known]
    crest = np.zeros(known.size, bool)
    for direction in product(*((-1, 0, 1) if widest > 1 else (0,) for widest in spacing)):
        offset = sum(step * stride for step, stride in zip(direction, strides, strict=True))
        if offset > 0:
            rest = np.flatnonzero(~crest)
            for sign in (1, -1):
                rest = rest[_is_lower(values, known[rest], own[rest], sign * offset)]
            crest[rest] = True
    mask = np.zeros(values.size, bool)
    mask[known[crest]] = True
    return mask.reshape(padded.shape)[(slice(_CREST, -_CREST),) * touches.ndim]


def _is_lower(values: Integers, places: Cells, own: Integers, offset: int) -> Mask:
    """Whether any of the next values along an offset is below a place's own."""
    least = values[places + offset]
    for k in range(2, _CREST + 1):
        np.minimum(least, values[places + k * offset], out=least)
    return least < own


def _thin(kinds: Integers, spacing: Sequence[int]) -> Cells:
    """Positions, (cells, axes), of cells that differ in kind from both neighbours along an axis or a diagonal."""
    padded = np.pad(kinds, 1, constant_values=UNKNOWN)
    values, strides = padded.ravel(), [stride // padded.itemsize for stride in padded.strides]
    known = np.flatnonzero(values >= 0)
    own = values[known]
    thin = np.zeros(known.size, bool)
    for direction in product(*((-1, 0, 1) if widest > 1 else (0,) for widest in spacing)):
        offset = sum(step * stride for step, stride in zip(direction, strides, strict=True))
        if offset > 0:
            above, below = values[known + offset], values[known - offset]
            thin |= (above != UNKNOWN) & (below != UNKNOWN) & (above != own) & (below != own)
    return np.stack(np.unravel_index(known[thin], padded.shape), axis=1).astype(np.int64) - 1


def _mark_around(mask: Mask, cells: Cells, spacing: Sequence[int]) -> None:
    """Set all within `_GAP` of these cells."""
    reach = (range(-_GAP, _GAP + 1) if widest > 1 else (0,) for widest in spacing)
    for offset in product(*reach):
        at = np.clip(cells + offset, 0, np.array(mask.shape) - 1)
        mask[tuple(at.T)] = True


def _extremes(low: Integers, high: Integers, spacing: Sequence[int]) -> Iterator[tuple[Integers, Integers]]:
    """The least and the greatest value in each block, edges included, from blocks two cells wide to the coarsest.

    `UNKNOWN` where a block has no other: as it is the greatest of all unsigned, and the least of all signed numbers, it
    takes part in neither.
    """
    low = low.view(np.uint32)
    for axis, count in enumerate(low.shape):
        if count > 1:  # between neighbouring cells
            low = np.minimum(_part(low, axis, slice(-1)), _part(low, axis, slice(1, None)))
            high = np.maximum(_part(high, axis, slice(-1)), _part(high, axis, slice(1, None)))
    step = 2
    while step <= max(spacing):
        for axis, widest in enumerate(spacing):
            if step <= widest:
                low, high = _joined(np.minimum, low, axis), _joined(np.maximum, high, axis)
        yield low.view(np.int32), high
        step *= 2


def _joined(extreme: np.ufunc, values: Integers, axis: int) -> Integers:
    """Each two neighbouring blocks as one; the last may be left over. (np.ufunc.reduceat takes five times as long.)"""
    first, second = _part(values, axis, slice(None, None, 2)), _part(values, axis, slice(1, None, 2))
    joined = first.copy()
    pairs = _part(joined, axis, slice(second.shape[axis]))
    extreme(pairs, second, out=pairs)
    return joined


def _part(values: Integers, axis: int, part: slice) -> Integers:
    return values[(slice(None),) * axis + (part,)]
