"""Refined maps: the cells that have to be run for the rest to follow from their neighbours. No physics.

The grid is cut into blocks between every `spacing`-th cell of each axis, and these into halves, down to single cells.
A block's edges belong to it, so that what a neighbour's refinement finds on a shared edge counts too. One is halved if

- known cells in it differ in regime (label and initial flank), or one is doubtful: it failed, or was decided by a hair.
  Then its corners are run, and of the corners of its halves those beside known ones that differ, or a doubtful one;
- known cells in it differ by two touches or more. Then all corners of its halves are run.

What is beside a known cell on a crest of the number of touches, with fewer on either side of it, is run as well.

Touches are for regimes thinner than a cell, single cells of OS(1)DS(1) within DS(1) on the report's map. Such a
regime is a touch more than its neighbours have, just hard or late enough to be primary: it lies on a crest, or where
touches accumulate, and these lines are much longer than it and are followed along their whole length. On the grid it is
a dashed line; so everything within a few cells of one that differs from both neighbours is run, too.

Every cell that is left then lies in a block, or between cells, where all that are known are of one regime. The cells
run are the smallest set closed under these rules, so that they depend neither on the order of the runs nor on where
they were interrupted.

An island between the cells of the coarse grid that none of these lines meets is missed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.jit import unowned, unowned_inlined
from clunk.study.arrays import Bools, Cells, Floats
from clunk.study.designs import Design

UNKNOWN = 0  # regime of a cell that has not been run, and of a block in which none has
DOUBTFUL = -1  # regime of one whose neighbours must be run whatever they are
_HALVED = -2  # in the place of a block's regime, where known cells differ in that
_RUN = -3  # or in touches, so that there is no more to ask for

COARSE_INTERVALS = 60  # of an axis, at least: every 16th of 1001 cells
# Chosen on 34 cuttings of 9 maps, 31,000,000 cells: of the report's driveline by force and by restitution, for large,
# small and negative load ratios, with each inertia swept, and with those as printed. There, all labels are those of the
# dense sweep. With a gap of 5 cells 4 labels differ, and with crests over 2 cells 16. Where touches that differ by one
# are followed, too, twice as many cells are run.
_TOUCHES = 2  # by which cells of a block differ where something may be hidden between them
_CREST = 4  # cells to either side
_BESIDE = 2  # cells around one on a crest, so that the next one is seen
_GAP = 6  # cells between the dashes of a thin regime

Numbers = npt.NDArray[np.int32]


def spacings(axes: Sequence[Floats], intervals: int = COARSE_INTERVALS) -> tuple[int, ...]:
    """The coarse spacing of each axis: the largest power of two that leaves so many intervals, or 1.

    axes : each (count,), the values; where they neither rise nor fall throughout, neighbours tell nothing: 1
    """
    monotone = [np.all(np.diff(values) > 0.0) or np.all(np.diff(values) < 0.0) for values in axes]
    rooms = [(len(values) - 1) // intervals * int(is_so) for values, is_so in zip(axes, monotone, strict=True)]
    return tuple(1 << max(0, room.bit_length() - 1) for room in rooms)


def coarse_spacing(design: Design) -> tuple[int, ...]:
    """The spacing of a refined sweep's coarse grid; 1 along `run`, where a run tells nothing of the next."""
    spacing = spacings([axis.values for axis in design.axes])
    return tuple(1 if k == design.run else step for k, step in enumerate(spacing))


class _Map(NamedTuple):
    """The known cells and blocks, in C order; the blocks of all levels behind one another, coarsest first."""

    shape: Cells  # (axes,), in cells
    strides: Cells  # (axes,), in cells
    position: Cells  # (axes,), room for a cell's indices
    origin: Cells  # (axes,), room for those of a block's first cell
    corners: Cells  # (3**axes,), room for the corners of a block's halves
    regimes: Numbers  # (cells,), `UNKNOWN` where they are
    touches: Numbers  # (cells,), one more than there are; `UNKNOWN`
    crest: Bools  # (cells,), whether a cell is known to lie on one
    asked: Bools  # (cells,), whether it is known or has been asked for
    shifts: Cells  # (levels + 1, axes), log2 of a block's width; the last row is of single cells, which are no blocks
    blocks: Cells  # (levels, axes), number of blocks
    hops: Cells  # (levels, axes), from one to the next in their numbers
    first: Cells  # (levels,), number of a level's first block
    of_block: Numbers  # (all blocks,), regime of its known cells; `UNKNOWN` without any, `_HALVED` or `_RUN` if halved
    fewest: Numbers  # (all blocks,), touches of its known cells, if there are any
    most: Numbers  # (all blocks,)
    directions: Cells  # (n, axes), of two opposite ones one
    along: Cells  # (n,), a step of each direction in cells
    ahead: Cells  # (n,), room for the number of cells to the edge of the map
    behind: Cells  # (n,), room for the number against the direction
    beside_crest: Cells  # (n, axes), offsets of the cells to run around one on a crest
    beside_thin: Cells  # (n, axes), of those around one of a thin regime


class Refinement:
    """Chooses the cells of a map that have to be run, as more and more of it gets known.

    shape : length of each axis
    spacing : of the coarse grid, a power of two for each axis
    """

    def __init__(self, shape: Sequence[int], spacing: Sequence[int]) -> None:
        axes, cells, counts, strides = len(shape), math.prod(shape), np.array(shape, np.int64), _strides(shape)
        widest = np.array([step.bit_length() - 1 for step in spacing], np.int64)
        shifts = np.minimum.outer(np.arange(widest.max(), -1, -1), widest)
        blocks = np.maximum(1, -(-(counts - 1) >> shifts[:-1]))
        ends = np.cumsum(blocks.prod(axis=1))
        every = int(ends[-1]) if ends.size else 0
        neighbours = _cube(spacing, 1)
        directions = neighbours[: len(neighbours) // 2].reshape(-1, axes)
        regimes, touches = np.zeros((2, cells), np.int32)
        position, origin = np.zeros((2, axes), np.int64)
        ahead, behind = np.zeros((2, len(directions)), np.int64)
        self._map = _Map(
            shape=counts,
            strides=strides,
            position=position,
            origin=origin,
            corners=np.zeros(3**axes, np.int64),
            regimes=regimes,
            touches=touches,
            crest=np.zeros(cells, bool),
            asked=np.zeros(cells, bool),
            shifts=shifts,
            blocks=blocks,
            hops=np.array([_strides(row) for row in blocks.tolist()], np.int64).reshape(blocks.shape),
            first=np.concatenate(([0], ends))[:-1].astype(np.int64),
            of_block=np.zeros(every, np.int32),
            fewest=np.empty(every, np.int32),
            most=np.empty(every, np.int32),
            directions=directions,
            along=directions @ strides,
            ahead=ahead,
            behind=behind,
            beside_crest=_cube(spacing, _BESIDE),
            beside_thin=_cube(spacing, _GAP),
        )
        edges = (np.append(np.arange(0, count, step), count - 1) for count, step in zip(shape, spacing, strict=True))
        self._coarse = np.unique(np.ravel_multi_index(np.meshgrid(*edges, indexing="ij"), tuple(shape)))

    def take(self, cells: Cells, regimes: Numbers, touches: Numbers) -> Cells:
        """Take the regimes and touches of cells that have been run; returns further cells to run, in ascending order.

        cells : (n,), numbers in C order, in any order; none at first
        regimes : (n,), a number from 1, equal where the regimes are; or `DOUBTFUL`
        touches : (n,)
        """
        known = self._map
        known.regimes[cells], known.touches[cells], known.asked[cells] = regimes, touches + 1, True
        coarse, self._coarse = self._coarse[~known.asked[self._coarse]], self._coarse[:0]  # once
        known.asked[coarse] = True
        wanted = np.empty(known.regimes.size, np.int64)  # pages that are not written to take no memory
        count = _take(known, cells, wanted)
        return np.sort(np.concatenate((coarse, wanted[:count])))

    def regimes(self) -> Numbers:
        """Each cell's regime, (cells,) int32: of cells not run, that of their block or of a cell beside them.

        Only when all cells that were asked for are known; no more can be taken after that.
        """
        _infer(self._map)
        return self._map.regimes


def _cube(spacing: Sequence[int], reach: int) -> Cells:
    """Offsets, (n, axes), to all cells within this many along each axis that is refined."""
    return np.array(list(product(*(range(-reach, reach + 1) if step > 1 else (0,) for step in spacing))), np.int64)


def _strides(counts: Sequence[int]) -> Cells:
    """Differences between the numbers in C order of neighbours along each axis."""
    return np.array([math.prod(counts[axis + 1 :]) for axis in range(len(counts))], np.int64)


@unowned
def _take(known: _Map, cells: Cells, wanted: Cells) -> int:
    """Write to `wanted` the cells to run on account of these, which are known; returns their number."""
    count = 0
    for cell in cells:
        _unravel(known, cell)
        _look_around(known)
        count = _join(known, cell, wanted, count)
        for way, step in enumerate(known.along):
            ahead, behind = known.ahead[way], known.behind[way]
            for k in range(-min(behind, _CREST), min(ahead, _CREST) + 1):
                near = cell + k * step
                # only a cell with more touches than the known one can have become a crest by it
                if (
                    (k == 0 or known.touches[near] > known.touches[cell])
                    and not known.crest[near]
                    and (k < 0 or _has_fewer(known.touches, near, step, ahead - k))
                    and (k > 0 or _has_fewer(known.touches, near, -step, behind + k))
                ):
                    known.crest[near] = True
                    count = _ask_around(known, near, known.beside_crest, wanted, count)
            for k in range(-min(behind - 1, 1), min(ahead - 1, 1) + 1):
                if _is_thin(known.regimes, cell + k * step, step):
                    count = _ask_around(known, cell + k * step, known.beside_thin, wanted, count)
    return count


@unowned_inlined
def _join(known: _Map, cell: int, wanted: Cells, count: int) -> int:
    """Add a cell, whose indices are in `position`, to its blocks; returns the number of wanted cells."""
    axes, doubtful = len(known.shape), known.regimes[cell] == DOUBTFUL
    for level in range(len(known.first)):
        last, edges = known.first[level], 0  # of its blocks, the last; the axes on which it lies between two
        is_corner = True  # of halves of these blocks
        for axis in range(axes):
            index, shift = known.position[axis], known.shifts[level, axis]
            at = min(index >> shift, known.blocks[level, axis] - 1)
            last += at * known.hops[level, axis]
            if at > 0 and at << shift == index:
                edges |= 1 << axis
            half = known.shifts[level + 1, axis]
            is_corner &= index >> half << half == index or index == known.shape[axis] - 1
        for before in range(edges + 1):
            if before & ~edges:
                continue
            block = last
            for axis in range(axes):
                if before >> axis & 1:
                    block -= known.hops[level, axis]
            regime, touches = known.of_block[block], known.touches[cell]
            if regime == _RUN:
                continue
            fewest = touches if regime == UNKNOWN else min(known.fewest[block], touches)
            most = touches if regime == UNKNOWN else max(known.most[block], touches)
            known.fewest[block], known.most[block] = fewest, most
            if most - fewest >= _TOUCHES:
                known.of_block[block] = _RUN
                _find_corners(known, level, block)
                for corner in known.corners:
                    count = _ask(known.asked, corner, wanted, count)
            elif regime == UNKNOWN and not doubtful:
                known.of_block[block] = known.regimes[cell]
            elif regime != known.regimes[cell] or doubtful:
                known.of_block[block] = _HALVED
                if is_corner or regime != _HALVED:
                    count = _ask_between(known, level, block, wanted, count)
    return count


@unowned
def _ask_between(known: _Map, level: int, block: int, wanted: Cells, count: int) -> int:
    """Ask for a block's corners, and those of its halves beside known ones that differ; returns the number wanted."""
    _find_corners(known, level, block)
    for between, cell in enumerate(known.corners):
        if known.asked[cell]:
            continue
        differ, regime = _is_whole(between), UNKNOWN  # of those beside it
        for corner, beside in enumerate(known.corners):
            if differ:
                break
            another = known.regimes[beside] if _is_beside(between, corner) else UNKNOWN
            differ = another == DOUBTFUL or (another != UNKNOWN and regime not in (UNKNOWN, another))
            regime = regime if another == UNKNOWN else another
        if differ:
            count = _ask(known.asked, cell, wanted, count)
    return count


@unowned
def _find_corners(known: _Map, level: int, block: int) -> None:
    """Put in `corners` those of a block's halves: by digits of base 3, at its begin, middle or end along each axis."""
    block -= known.first[level]
    for axis in range(len(known.shape)):
        known.origin[axis] = block // known.hops[level, axis] << known.shifts[level, axis]
        block %= known.hops[level, axis]
    for number in range(len(known.corners)):
        cell, digits = 0, number
        for axis in range(len(known.shape)):
            at, which = known.origin[axis], digits % 3
            if which > 0:
                at += 1 << known.shifts[level + 2 - which, axis]
            cell += min(at, known.shape[axis] - 1) * known.strides[axis]
            digits //= 3
        known.corners[number] = cell


@unowned
def _is_whole(corner: int) -> bool:
    """Whether one of a block's `corners` is a corner of the block, and not only of its halves."""
    while corner:
        if corner % 3 == 1:
            return False
        corner //= 3
    return True


@unowned
def _is_beside(first: int, second: int) -> bool:
    """Whether two of a block's `corners` are next to each other, or the same."""
    while first != second:
        if abs(first % 3 - second % 3) > 1:
            return False
        first, second = first // 3, second // 3
    return True


@unowned
def _ask_around(known: _Map, cell: int, offsets: Cells, wanted: Cells, count: int) -> int:
    """Ask for all cells at these offsets from one; returns the number of wanted cells."""
    _unravel(known, cell)
    for offset in offsets:
        near = 0
        for axis in range(len(known.shape)):
            at = min(max(known.position[axis] + offset[axis], 0), known.shape[axis] - 1)
            near += at * known.strides[axis]
        count = _ask(known.asked, near, wanted, count)
    return count


@unowned
def _ask(asked: Bools, cell: int, wanted: Cells, count: int) -> int:
    """Ask for a cell unless that has been done; returns the number of wanted cells."""
    if not asked[cell]:
        asked[cell] = True
        wanted[count] = cell
        count += 1
    return count


@unowned
def _has_fewer(touches: Numbers, cell: int, step: int, reach: int) -> bool:
    """Whether one of the next known cells along a direction has fewer touches than this one."""
    fewer = False
    for k in range(1, min(reach, _CREST) + 1):
        fewer |= UNKNOWN < touches[cell + k * step] < touches[cell]
    return fewer


@unowned
def _is_thin(regimes: Numbers, cell: int, step: int) -> bool:
    """Whether a cell differs in regime from both of its neighbours, all three known."""
    regime, above, below = regimes[cell], regimes[cell + step], regimes[cell - step]
    return bool(regime > UNKNOWN and above != UNKNOWN and below != UNKNOWN and above != regime and below != regime)


@unowned_inlined
def _look_around(known: _Map) -> None:
    """Put in `ahead` and `behind` the numbers of cells from `position` to the map's edges, along each direction."""
    for way in range(len(known.along)):
        ahead = behind = len(known.regimes)
        for axis in range(len(known.shape)):
            before, after = known.position[axis], known.shape[axis] - 1 - known.position[axis]
            if known.directions[way, axis] > 0:
                ahead, behind = min(ahead, after), min(behind, before)
            elif known.directions[way, axis] < 0:
                ahead, behind = min(ahead, before), min(behind, after)
        known.ahead[way], known.behind[way] = ahead, behind


@unowned
def _infer(known: _Map) -> None:
    """Give each unknown cell the regime of the largest block around it that is not halved, or of a cell beside it."""
    levels, last = len(known.first), known.shape[-1] - 1
    for row in range(0, len(known.regimes), last + 1):
        _unravel(known, row)
        # of the level before, this row's first block, the number of its blocks, and log2 of their width
        before, wholes, coarser = 0, 0, known.shifts[0, -1]
        for level in range(levels):
            shift, blocks, first = known.shifts[level, -1], known.blocks[level, -1], known.first[level]
            corner = 0  # of the blocks of single cells, the one beside this row's first cell
            for axis in range(len(known.shape) - 1):
                width, at = known.shifts[level, axis], known.position[axis]
                first += min(at >> width, known.blocks[level, axis] - 1) * known.hops[level, axis]
                corner += (at if at == known.shape[axis] - 1 else at >> width << width) * known.strides[axis]
            wholes, parts = blocks if level == 0 else wholes, 1 << (coarser - shift)
            for whole in range(wholes):
                if level > 0 and known.of_block[before + whole] > _HALVED:
                    continue
                for k in range(whole * parts, (whole + 1) * parts if whole + 1 < wholes else blocks):
                    begin, end = k << shift, (k + 1) << shift if k + 1 < blocks else last + 1
                    if known.of_block[first + k] > _HALVED:
                        for cell in range(row + begin, row + end):
                            if known.regimes[cell] == UNKNOWN:
                                known.regimes[cell] = known.of_block[first + k]
                    elif level == levels - 1:
                        for at in range(begin, end):
                            if known.regimes[row + at] == UNKNOWN:
                                known.regimes[row + at] = known.regimes[corner + (at if at == last else begin)]
            before, wholes, coarser = first, blocks, shift


@unowned_inlined
def _unravel(known: _Map, cell: int) -> None:
    """Put a cell's indices in `position`."""
    for axis in range(len(known.shape)):
        known.position[axis], cell = cell // known.strides[axis], cell % known.strides[axis]
