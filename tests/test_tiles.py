"""Tiles: any cells in any order give the same results, and their bytes are believed only as they were written."""

import io

import numpy as np
import pytest
from conftest import NOMINAL
from test_sweeping import equal, figure_3_4

from clunk.api import run_points
from clunk.core import tile as kernel
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.designs import design_of_points
from clunk.study.errors import ClunkError
from clunk.sweeping import cells
from clunk.sweeping.cells import Grid
from clunk.sweeping.parts import tiles_of, write_tiles
from clunk.sweeping.reduction import Reduction, in_order, regime_map
from clunk.sweeping.sweep import sweep

ORIGIN = bytes(range(32))


def assembled(study, batches):
    grid, stop = Grid(study), np.zeros(1, np.uint8)
    reduction = Reduction(grid)
    for batch in batches:
        reduction.add(grid.run(np.asarray(batch, np.int64), stop))
    return regime_map(reduction, {})


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


def test_a_stopped_tile_has_the_cells_that_are_done(study):
    stopped = Grid(study).run(np.arange(20), np.ones(1, np.uint8))
    assert stopped.cells.size == stopped.records.size == stopped.details.size == 0


@pytest.mark.parametrize("method", ["rk4", "exact"])
def test_impacts_that_find_no_room_get_it(method, monkeypatch):
    """With room for one impact a run, twice as much each time, 200 runs of up to 8 take a few calls; the same bits."""
    settings = [f"solver.method = '{method}'", "solver.max_events = 100", "lash.backlash_deg = 0.5"]
    study = study_from_text(NOMINAL, overrides=settings)
    grid = Grid(study, design_of_points(study, {"load.ratio": np.linspace(5.0, 10.0, 200)}))
    at_once = grid.run(np.arange(200), np.zeros(1, np.uint8))
    calls, run_tile = [], cells.run_tile
    monkeypatch.setattr(cells, "_IMPACTS", 1)
    monkeypatch.setattr(cells, "run_tile", lambda *arguments: calls.append(1) or run_tile(*arguments))
    tile = grid.run(np.arange(200), np.zeros(1, np.uint8))
    assert len(at_once.details) > 300
    assert 1 < len(calls) < 7
    for arrays in ((tile.records, at_once.records), (tile.details, at_once.details)):
        for name in arrays[0].dtype.names:
            np.testing.assert_array_equal(*(array[name] for array in arrays))


@pytest.mark.parametrize("method", ["rk4", "exact"])
@pytest.mark.parametrize("measured", [[], ['impacts.quantities = ["impulse"]']], ids=["plain", "measured"])
def test_a_run_may_have_as_many_events_as_are_allowed_alone_and_among_others(method, measured):
    """Of rigid flanks, for which a switch may write several events more."""
    rigid = ["lash.contact.model = 'restitution'", "lash.contact.restitution = 0.5"]
    settings = [f"solver.method = '{method}'", *rigid, *measured]
    run = simulate(study_from_text(NOMINAL, overrides=settings))
    for lacking in (0, 1):
        most = f"solver.max_events = {len(run.events) - 1 - lacking}"
        study = study_from_text(NOMINAL, overrides=[*settings, most])
        among = run_points(study, {"load.ratio": [study.load.ratio]})
        assert among.label_map[0] == ("failed" if lacking else run.label)
        if lacking:
            with pytest.raises(ClunkError, match="max_events"):
                simulate(study)
        else:
            assert simulate(study).label == run.label


@pytest.mark.parametrize("method", ["rk4", "exact"])
@pytest.mark.parametrize("measured", [[], ['impacts.quantities = ["impulse"]']], ids=["plain", "measured"])
def test_events_that_find_no_room_get_it(method, measured, monkeypatch):
    """With room for 3 events at first, then 24, runs of up to some 40 have the bits, and their order, of room for all;
    so have their events, and one run alone."""
    study = study_from_text(NOMINAL, overrides=[f"solver.method = '{method}'", *measured])
    ratios = {"load.ratio": np.linspace(0.0, 10.0, 50)}
    grid = Grid(study, design_of_points(study, ratios))

    def bits():
        reduction, run = Reduction(grid), simulate(study)
        reduction.add(grid.run(np.arange(50), np.zeros(1, np.uint8)))
        records, details = reduction.collected()
        assert not records["status"].any()
        columns = [*records.values(), *details.values()]
        columns += [array[name] for array in (*grid.logged(ratios, 50), run.phases) for name in array.dtype.names]
        return [column.tobytes() for column in (*columns, run.phase_states)]

    at_once = bits()
    for module in (cells, kernel):
        monkeypatch.setattr(module, "EVENTS", 3)
    assert bits() == at_once


def written(tiles):
    raw = io.BytesIO()
    write_tiles(raw, tiles, ORIGIN)
    return raw.getvalue()


def test_bytes_give_the_same_tiles_again(tile):
    tiles = tiles_of(written([tile, tile]), ORIGIN)
    assert len(tiles) == 2
    for again in tiles:
        for name in ("cells", "records", "details"):
            one, two = getattr(tile, name), getattr(again, name)
            assert one.dtype == two.dtype
            for column in one.dtype.names or (...,):
                assert two[column].tobytes() == one[column].tobytes()


def test_bytes_of_another_origin_cut_or_changed_are_refused(tile):
    raw = written([tile])
    flipped = [bytearray(raw) for _ in range(300)]
    for changed, place in zip(flipped, np.random.default_rng(0).integers(0, 8 * len(raw), 300), strict=True):
        changed[place // 8] ^= 1 << (place % 8)
    cut = [raw[:length] for length in [*range(0, len(raw), 97), len(raw) - 1]]
    for changed, origin in [(raw, ORIGIN[::-1]), *((each, ORIGIN) for each in [*flipped, *cut, raw + b"\0"])]:
        with pytest.raises(ValueError, match="damaged, or of another study"):
            tiles_of(bytes(changed), origin)


def test_more_labels_than_a_map_can_number_are_refused_in_a_sentence():
    words = [f"SS({count})" for count in range(32_768, 0, -1)]
    labels, numbers = in_order(words[1:])
    assert [labels[number] for number in numbers[:3]] == words[1:4]
    with pytest.raises(ClunkError, match="32,768 labels, and a map can hold 32,767"):
        in_order(words)
