"""Which cells of a map have to be run, where the others follow from their neighbours: index logic and no physics.

The grid is cut into blocks between every `spacing`-th cell of each axis, and these into halves, down to single cells.
A block's edges belong to it, so that what a neighbour's refinement finds on a shared edge counts too. It is halved,
and the corners of its halves are run, where

- known cells in it differ in kind (regime and initial flank), or one is doubtful: it failed, or was decided by a hair;
- known cells in it differ by two touches or more;
- a known cell is on a crest of the number of touches: there are fewer on either side of it. What is beside it is run
  as well.

The last two are for regimes thinner than a cell, single cells of OS(1)DS(1) within DS(1) on the report's map. Such a
regime is a touch more than its neighbours have, just hard or late enough to be primary: it lies on a crest, or where
touches accumulate, and these lines are much longer than it and are followed along their whole length. On the grid it is
a dashed line; so everything within a few cells of one that differs from both neighbours is run, too.

Every cell that is left then lies in a block whose known cells are of one kind. The cells run are the smallest set
closed under these rules, so that they depend neither on the order of the runs nor on where they were interrupted.

What is nowhere seen from that set is missed: an island between the cells of the coarse grid that none of these lines
meets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.jit import unowned

UNKNOWN = -1  # kind and touches of a cell that has not been run, and kind of a block in which none has
DOUBTFUL = -2  # kind of one whose neighbours must be run whatever they are
_HALVED = -3  # in the place of a block's kind

COARSE_INTERVALS = 60  # of an axis, at least: every 16th of 1001 cells
# Chosen on 34 cuttings of 9 maps, 31,000,000 cells: of the report's driveline by force and by restitution, for large,
# small and negative load ratios, with each inertia swept, and with those as printed. There, all labels are those of the
# dense sweep. With a gap of 4 cells 23 labels differ, of 5 one or two; with crests over 3 cells, lines are followed in
# many more steps. Where touches that differ by one are followed, too, twice as many cells are run.
_TOUCHES = 2  # by which cells of a block differ where something may be hidden between them
_CREST = 4  # cells to either side
_BESIDE = 2  # cells around one on a crest, so that the next one is seen
_GAP = 6  # cells between the dashes of a thin regime

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


class _Map(NamedTuple):
    """What is known, cells and blocks in C order; the blocks of all levels behind one another, coarsest first.

    shape, strides : (axes,), in cells
    position, origin : (axes,), room for a cell's indices, and for those of a block's first cell
    kinds, touches : (cells,) int32, `UNKNOWN` where they are
    crest, asked : (cells,) bool, whether a cell is known to lie on one; whether it is known or has been asked for
    shifts : (levels + 1, axes), log2 of a block's width in cells; the last row is of single cells, which are no blocks
    blocks, hops : (levels, axes), how many, and from one to the next in their numbers
    first : (levels,), where a level's blocks begin
    kind : (all blocks,) int32, of a block's known cells; `UNKNOWN` without any, `_HALVED` where it is
    fewest, most : (all blocks,) int32, touches of its known cells; without any, the most there can be and `UNKNOWN`
    directions : (n, axes), of two opposite ones one; along : (n,), a step of each in cells
    ahead, behind : (n,), room for how far the map goes on
    beside_crest, beside_thin : (n, axes), offsets of what is run around a cell on a crest, or of a thin regime
    """

    shape: Cells
    strides: Cells
    position: Cells
    origin: Cells
    kinds: Integers
    touches: Integers
    crest: Mask
    asked: Mask
    shifts: Cells
    blocks: Cells
    hops: Cells
    first: Cells
    kind: Integers
    fewest: Integers
    most: Integers
    directions: Cells
    along: Cells
    ahead: Cells
    behind: Cells
    beside_crest: Cells
    beside_thin: Cells


class Refinement:
    """What has to be run of a map, as more and more of it gets known.

    shape : length of each axis
    spacing : of the coarse grid, a power of two for each axis
    """

    def __init__(self, shape: Sequence[int], spacing: Sequence[int]) -> None:
        cells, counts = math.prod(shape), np.array(shape, np.int64)
        strides = _strides(shape)
        widest = np.array([own.bit_length() - 1 for own in spacing], np.int64)
        shifts = np.minimum.outer(np.arange(widest.max(), -1, -1), widest)
        blocks = np.maximum(1, -(-(counts - 1) >> shifts[:-1]))
        ends = np.cumsum(blocks.prod(axis=1))
        every = int(ends[-1]) if ends.size else 0
        ways = [(-1, 0, 1) if own > 1 else (0,) for own in spacing]
        half = list(product(*ways))[: math.prod(map(len, ways)) // 2]
        directions = np.array(half, np.int64).reshape(-1, len(shape))
        self._map = _Map(
            shape=counts,
            strides=strides,
            position=np.zeros(len(shape), np.int64),
            origin=np.zeros(len(shape), np.int64),
            kinds=np.full(cells, UNKNOWN, np.int32),
            touches=np.full(cells, UNKNOWN, np.int32),
            crest=np.zeros(cells, bool),
            asked=np.zeros(cells, bool),
            shifts=shifts,
            blocks=blocks,
            hops=np.array([_strides(own) for own in blocks.tolist()], np.int64).reshape(blocks.shape),
            first=np.concatenate(([0], ends))[:-1].astype(np.int64),
            kind=np.full(every, UNKNOWN, np.int32),
            fewest=np.full(every, np.iinfo(np.int32).max, np.int32),
            most=np.full(every, UNKNOWN, np.int32),
            directions=directions,
            along=directions @ strides,
            ahead=np.zeros(len(directions), np.int64),
            behind=np.zeros(len(directions), np.int64),
            beside_crest=_cube(spacing, _BESIDE),
            beside_thin=_cube(spacing, _GAP),
        )
        edges = (np.append(np.arange(0, count, own), count - 1) for count, own in zip(shape, spacing, strict=True))
        self._coarse = np.unique(np.ravel_multi_index(np.meshgrid(*edges, indexing="ij"), tuple(shape)))

    def take(self, cells: Cells, kinds: Integers, touches: Integers) -> Cells:
        """Learn what cells were found to be.

        Parameters
        ----------
        cells : (n,) int64, numbers in C order, in any order; none at first
        kinds : (n,) int32, a number from 0, equal where the kinds are; or `DOUBTFUL`
        touches : (n,) int32

        Returns
        -------
        cells : (m,) int64
            What to run besides what has been asked for already, in ascending order.
        """
        known = self._map
        known.kinds[cells], known.touches[cells], known.asked[cells] = kinds, touches, True
        coarse, self._coarse = self._coarse[~known.asked[self._coarse]], self._coarse[:0]  # once
        known.asked[coarse] = True
        found = np.empty(known.kinds.size, np.int64)  # what is not written to takes no memory
        count = _take(known, cells, found)
        return np.sort(np.concatenate((coarse, found[:count])))

    def sources(self) -> Cells:
        """For each cell one whose kind it has: itself where it is known, else a known one of its block.

        Only when all that was asked for is known.
        """
        sources = np.arange(self._map.kinds.size)
        _infer(self._map, sources)
        return sources


def _cube(spacing: Sequence[int], reach: int) -> Cells:
    """Offsets, (n, axes), to all cells within this many along each axis that is refined."""
    return np.array(list(product(*(range(-reach, reach + 1) if own > 1 else (0,) for own in spacing))), np.int64)


def _strides(counts: Sequence[int]) -> Cells:
    """From one to the next along each axis, in numbers in C order."""
    return np.array([math.prod(counts[axis + 1 :]) for axis in range(len(counts))], np.int64)


@unowned
def _take(known: _Map, cells: Cells, found: Cells) -> int:
    """Write to `found` what is to be run for the sake of these cells, which are known; returns how many."""
    count = 0
    for cell in cells:
        count = _join(known, cell, found, count)
        _look_around(known, cell)
        for way, step in enumerate(known.along):
            ahead, behind = known.ahead[way], known.behind[way]
            for k in range(-min(behind, _CREST), min(ahead, _CREST) + 1):
                own = cell + k * step
                # of the others, only what has more touches than this cell can have become a crest by it
                if (
                    (k == 0 or known.touches[own] > known.touches[cell])
                    and not known.crest[own]
                    and _has_fewer(known.touches, own, step, ahead - k)
                    and _has_fewer(known.touches, own, -step, behind + k)
                ):
                    known.crest[own] = True
                    count = _join(known, own, found, count)
                    count = _ask_around(known, own, known.beside_crest, found, count)
            for k in range(-min(behind - 1, 1), min(ahead - 1, 1) + 1):
                if _is_thin(known.kinds, cell + k * step, step):
                    count = _ask_around(known, cell + k * step, known.beside_thin, found, count)
    return count


@unowned
def _join(known: _Map, cell: int, found: Cells, count: int) -> int:
    """Let a cell count in the blocks that it is in, halving those that it makes differ; returns how many are found."""
    axes, doubtful = len(known.shape), known.crest[cell] or known.kinds[cell] == DOUBTFUL
    _unravel(known, cell)
    for level in range(len(known.first)):
        last, edges = known.first[level], 0  # of its blocks, the last; the axes on which it lies between two
        for axis in range(axes):
            own, shift = known.position[axis], known.shifts[level, axis]
            at = min(own >> shift, known.blocks[level, axis] - 1)
            last += at * known.hops[level, axis]
            if at > 0 and at << shift == own:
                edges |= 1 << axis
        for before in range(edges + 1):
            if before & ~edges:
                continue
            block = last
            for axis in range(axes):
                if before >> axis & 1:
                    block -= known.hops[level, axis]
            if known.kind[block] == _HALVED:
                continue
            known.fewest[block] = min(known.fewest[block], known.touches[cell])
            known.most[block] = max(known.most[block], known.touches[cell])
            if known.kind[block] == UNKNOWN:
                known.kind[block] = known.kinds[cell]
            if (
                doubtful
                or known.kind[block] != known.kinds[cell]
                or known.most[block] - known.fewest[block] >= _TOUCHES
            ):
                known.kind[block] = _HALVED
                count = _halve(known, level, block, found, count)
    return count


@unowned
def _halve(known: _Map, level: int, block: int, found: Cells, count: int) -> int:
    """Ask for the corners of a block's halves; returns how many are found."""
    block -= known.first[level]
    for axis in range(len(known.shape)):
        known.origin[axis] = block // known.hops[level, axis] << known.shifts[level, axis]
        block %= known.hops[level, axis]
    for corner in range(3 ** len(known.shape)):
        cell, which = 0, corner
        for axis in range(len(known.shape)):
            at = known.origin[axis]
            if which % 3:
                at += 1 << known.shifts[level + which % 3 - 1, axis]
            cell += min(at, known.shape[axis] - 1) * known.strides[axis]
            which //= 3
        count = _ask(known.asked, cell, found, count)
    return count


@unowned
def _ask_around(known: _Map, cell: int, offsets: Cells, found: Cells, count: int) -> int:
    """Ask for all cells at these offsets from one; returns how many are found."""
    _unravel(known, cell)
    for offset in offsets:
        other = 0
        for axis in range(len(known.shape)):
            at = min(max(known.position[axis] + offset[axis], 0), known.shape[axis] - 1)
            other += at * known.strides[axis]
        count = _ask(known.asked, other, found, count)
    return count


@unowned
def _ask(asked: Mask, cell: int, found: Cells, count: int) -> int:
    """Ask for a cell unless that has been done; returns how many are found."""
    if not asked[cell]:
        asked[cell] = True
        found[count] = cell
        count += 1
    return count


@unowned
def _has_fewer(touches: Integers, cell: int, step: int, reach: int) -> bool:
    """Whether one of the next known cells along a direction has fewer touches than this one."""
    found = False
    for k in range(1, min(reach, _CREST) + 1):
        found |= UNKNOWN < touches[cell + k * step] < touches[cell]
    return found


@unowned
def _is_thin(kinds: Integers, cell: int, step: int) -> bool:
    """Whether a cell differs in kind from both of its neighbours, all three known."""
    own, above, below = kinds[cell], kinds[cell + step], kinds[cell - step]
    return bool(own >= 0 and above != UNKNOWN and below != UNKNOWN and above != own and below != own)


@unowned
def _look_around(known: _Map, cell: int) -> None:
    """Put in `ahead` and `behind` how many steps the map goes on from a cell, along each direction and against it."""
    _unravel(known, cell)
    for way in range(len(known.along)):
        ahead = behind = len(known.kinds)
        for axis in range(len(known.shape)):
            before, after = known.position[axis], known.shape[axis] - 1 - known.position[axis]
            if known.directions[way, axis] > 0:
                ahead, behind = min(ahead, after), min(behind, before)
            elif known.directions[way, axis] < 0:
                ahead, behind = min(ahead, before), min(behind, after)
        known.ahead[way], known.behind[way] = ahead, behind


@unowned
def _infer(known: _Map, sources: Cells) -> None:
    """Give each unknown cell the first corner of the coarsest block with it that is not halved."""
    last = known.shape[-1]
    for row in range(0, len(sources), last):
        _unravel(known, row)
        before, coarser = 0, 0  # the first block of this row, and its width, a level before
        for level in range(len(known.first)):
            blocks, shift = known.blocks[level, -1], known.shifts[level, -1]
            first, corner = known.first[level], 0
            for axis in range(len(known.shape) - 1):
                at = min(known.position[axis] >> known.shifts[level, axis], known.blocks[level, axis] - 1)
                first += at * known.hops[level, axis]
                corner += (at << known.shifts[level, axis]) * known.strides[axis]
            for k in range(blocks):
                is_part = level == 0 or known.kind[before + (k << shift >> coarser)] == _HALVED
                if is_part and known.kind[first + k] != _HALVED:
                    begin, end = k << shift, (k + 1) << shift if k + 1 < blocks else last
                    for cell in range(row + begin, row + end):
                        if known.kinds[cell] == UNKNOWN:
                            sources[cell] = corner + begin
            before, coarser = first, shift


@unowned
def _unravel(known: _Map, cell: int) -> None:
    """Put a cell's indices in `position`."""
    for axis in range(len(known.shape)):
        known.position[axis], cell = cell // known.strides[axis], cell % known.strides[axis]
