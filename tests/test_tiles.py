"""Tiles: any cells in any order give the same results, and their bytes are believed only as they were written."""

import numpy as np
import pytest
from test_sweeping import equal, figure_3_4

from clunk.sweeping.assembly import RegimeReduction
from clunk.sweeping.cells import CELL, IMPACT, Grid
from clunk.sweeping.sweep import sweep
from clunk.sweeping.tiles import Layout, from_bytes, to_pieces

ORIGIN = bytes(range(32))
LAYOUT = Layout(CELL, IMPACT, "primary_impacts")


def assembled(study, batches):
    grid, reduction, stop = Grid(study), RegimeReduction(study), np.zeros(1, np.uint8)
    for cells in batches:
        reduction.add(grid.run(np.asarray(cells, np.int64), stop))
    return reduction.result({})


@pytest.fixture(scope="module")
def study():
    return figure_3_4(9, step=2e-4)


@pytest.fixture(scope="module")
def tile(study):
    return Grid(study).run(np.arange(40, 60), np.zeros(1, np.uint8))


def test_tiles_of_any_cells_in_any_order_give_the_same_bits(study):
    shuffled = np.random.default_rng(3).permutation(81)
    whole = sweep(study, workers=1)
    assert equal(whole, assembled(study, np.split(shuffled, [1, 7, 40])))
    assert equal(whole, assembled(study, [[k] for k in range(80, -1, -1)]))


def test_cells_that_come_twice_count_once(study):
    twice = assembled(study, [range(50), range(30, 81), range(81)])
    assert equal(twice, sweep(study))


def test_a_stopped_tile_has_the_cells_that_are_done(study):
    stopped = Grid(study).run(np.arange(20), np.ones(1, np.uint8))
    assert stopped.cells.size == stopped.records.size == stopped.details.size == 0


def test_bytes_give_the_same_tile_again(tile):
    again = from_bytes(b"".join(to_pieces([tile, tile], ORIGIN)), ORIGIN, LAYOUT)
    for name in ("cells", "records", "details"):
        one, two = getattr(tile, name), getattr(again, name)
        assert one.dtype == two.dtype
        for column in one.dtype.names or (...,):
            assert two[column].tobytes() == one[column].tobytes() * 2


def test_bytes_of_another_origin_cut_or_changed_are_refused(tile):
    raw = b"".join(to_pieces([tile], ORIGIN))
    with pytest.raises(ValueError, match="another study"):
        from_bytes(raw, ORIGIN[::-1], LAYOUT)
    for length in [*range(0, len(raw), 97), len(raw) - 1]:
        with pytest.raises(ValueError, match=r"truncated|damaged"):
            from_bytes(raw[:length], ORIGIN, LAYOUT)
    with pytest.raises(ValueError, match="damaged"):
        from_bytes(raw + b"\0", ORIGIN, LAYOUT)
    for place in np.random.default_rng(0).integers(0, 8 * len(raw), 300):
        changed = bytearray(raw)
        changed[place // 8] ^= 1 << (place % 8)
        with pytest.raises(ValueError, match=r"another study|damaged"):
            from_bytes(bytes(changed), ORIGIN, LAYOUT)
