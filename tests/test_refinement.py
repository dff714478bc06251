"""Refinement: which cells are run, that the others are what they are taken for, and what it says it misses."""

import numpy as np
import pytest
from test_sweeping import equal, figure_3_4, regimes, study

from clunk.core.status import QUALITY_INFERRED
from clunk.results.store import read_results, write_results
from clunk.sweeping.refinement import DOUBTFUL, Refinement, spacings
from clunk.sweeping.sweep import sweep


def refined(truth, spacing, touches=None, at_once=10**9):
    """The map as refinement has it, which cells it ran, and how many times it asked.

    at_once : how many cells are run before it is interrupted, and taken up again from what has been run by then
    """
    kinds = np.where(truth == DOUBTFUL, DOUBTFUL, truth + 1)
    touches = np.zeros_like(truth) if touches is None else touches
    ran = np.zeros(truth.shape, bool)
    asked = 0
    interrupted = True
    while interrupted:
        refinement, cells, interrupted = Refinement(truth.shape, spacing), np.flatnonzero(ran), False
        while (cells := refinement.take(cells, kinds.flat[cells], touches.flat[cells])).size and not interrupted:
            assert np.all(np.diff(cells) > 0)
            assert not ran.flat[cells].any()
            interrupted, cells = cells.size > at_once, cells[:at_once]
            ran.flat[cells] = True
            asked += 1
    found = refinement.regimes().reshape(truth.shape)
    assert np.array_equal(found[ran], kinds[ran])
    assert np.isin(found, kinds[ran]).all()
    return np.where(found == DOUBTFUL, DOUBTFUL, found - 1), ran, asked


def plane(rows=101, columns=131):
    return np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")


def int32(mask):
    return np.asarray(mask).astype(np.int32)


class TestWhichCellsAreRun:
    def test_of_a_uniform_map_only_the_coarse_grid(self):
        found, ran, asked = refined(np.full((101, 131), 5, np.int32), (8, 8))
        assert np.all(found == 5)
        assert asked == 1
        assert ran.sum() == (101 // 8 + 2) * (131 // 8 + 2)  # the last row and column too

    @pytest.mark.parametrize("shape", ["half plane", "disc", "sectors"])
    def test_large_regions_come_out_as_they_are_from_a_fraction_of_the_cells(self, shape):
        i, j = plane(301, 331)
        truth = {
            "half plane": int32(3 * i + 2 * j > 700),
            "disc": int32((i - 140) ** 2 + (j - 170) ** 2 < 80**2),
            "sectors": np.floor(np.arctan2(i - 151.5, j - 60.3)).astype(np.int32) + 20,
        }[shape]
        found, ran, _ = refined(truth, (16, 16))
        assert np.array_equal(found, truth)
        assert ran.mean() < 0.12

    @pytest.mark.parametrize("angle", np.linspace(0.0, np.pi, 13))
    @pytest.mark.parametrize("shape", [(48, 65), (65, 50)])
    def test_a_straight_edge_is_found_to_the_last_row_and_column(self, shape, angle):
        """By running, besides the coarse grid, at most six cells for each row, or column, that it crosses."""
        i, j = plane(*shape)
        coarse = refined(np.zeros(shape, np.int32), (8, 8))[1].sum()
        for at in np.linspace(-30.0, 30.0, 25):
            truth = int32((i - shape[0] / 2) * np.cos(angle) + (j - shape[1] / 2) * np.sin(angle) > at)
            found, ran, _ = refined(truth, (8, 8))
            assert np.array_equal(found, truth)
            crossed = [np.count_nonzero(np.diff(truth, axis=axis).any(axis=axis)) for axis in (0, 1)]
            assert ran.sum() <= coarse + 6 * max(crossed)

    @pytest.mark.parametrize("slope", [0.0, 0.37, 1.0, 2.9])
    def test_a_tongue_one_cell_wide_is_followed_along_its_length(self, slope):
        """From the wide end, where the coarse grid sees it, to the last cell."""
        i, j = plane(161, 161)
        wide = (i < 24) & (j < 40)
        line = (np.abs(j - 20 - np.round(slope * (i - 8))) <= 0) & (i < 150) if slope <= 1.0 else np.zeros_like(wide)
        line |= (i == 8 + np.round((j - 20) / slope)) & (j >= 20) if slope > 1.0 else line
        truth = int32(wide | line)
        found, ran, _ = refined(truth, (16, 16))
        assert np.array_equal(found, truth)
        assert ran.mean() < 0.2

    def test_a_thin_regime_is_followed_over_the_gaps_that_the_grid_cuts_into_it(self):
        i, j = plane(129, 129)
        truth = int32(3 * i == 4 * (j - 20))  # every fourth row has a cell of it
        truth[:18, :21] = 1  # and a region at its end that the coarse grid sees
        found, ran, _ = refined(truth, (16, 16))
        assert truth[100, 95] == 1
        assert np.array_equal(found, truth)
        assert ran.mean() < 0.25

    def test_an_island_between_the_coarse_cells_is_missed(self):
        truth = np.zeros((65, 65), np.int32)
        truth[20:23, 20:23] = 1
        assert not refined(truth, (16, 16))[0].any()
        assert np.array_equal(refined(truth, (2, 2))[0], truth)

    def test_around_a_doubtful_cell_everything_is_run(self):
        truth = np.zeros((65, 65), np.int32)
        truth[32, 16] = DOUBTFUL
        _, ran, _ = refined(truth, (16, 16))
        assert ran[31:34, 15:18].all()
        assert ran.mean() < 0.1

    def test_a_single_cell_where_touches_accumulate_is_found(self):
        """Along the line where there are two more."""
        i, j = plane(129, 129)
        touches = int32(7 + 2 * (j > 20 + i // 2))
        truth = np.zeros((129, 129), np.int32)
        truth[75, 20 + 37] = 1
        assert not refined(truth, (16, 16), touches // 2)[0].any()
        assert np.array_equal(refined(truth, (16, 16), touches)[0], truth)

    def test_a_single_cell_on_a_crest_of_touches_is_found(self):
        """A line of one touch more, seen where it meets another regime, leads to a single cell of a third one on it."""
        i, j = plane(129, 129)
        crest = j == 16 + i // 2
        truth = int32(i > 120)
        truth[75, 16 + 37] = 2
        assert crest[75, 16 + 37]
        assert refined(truth, (16, 16))[0].max() == 1
        assert np.array_equal(refined(truth, (16, 16), int32(7 + crest))[0], truth)

    def test_the_cells_do_not_depend_on_where_it_was_interrupted(self):
        i, j = plane()
        truth = int32((i - 50) ** 2 + 2 * (j - 60) ** 2 < 900) + int32(i + j > 180)
        touches = int32(i // 9 + 3 * truth)
        whole = refined(truth, (8, 8), touches)
        for at_once in (300, 77):
            part = refined(truth, (8, 8), touches, at_once)
            assert part[2] > whole[2]
            assert np.array_equal(part[1], whole[1])
            assert np.array_equal(part[0], whole[0])

    def test_one_axis_and_three_axes_work_as_well(self):
        line = int32(np.arange(1001) > 613) + int32(np.arange(1001) > 900)
        found, ran, _ = refined(line, (16,))
        assert np.array_equal(found, line)
        assert ran.sum() < 80
        x, y, z = np.meshgrid(np.arange(65), np.arange(3), np.arange(49), indexing="ij")
        ball = int32((x - 30) ** 2 + 100 * (y - 1) ** 2 + (z - 20) ** 2 < 300)
        found, ran, _ = refined(ball, (8, 1, 8))
        assert np.array_equal(found, ball)
        assert ran.mean() < 0.4

    def test_an_axis_of_one_value_has_nothing_to_refine(self):
        truth = int32(np.arange(200) > 77)[None, :]
        assert np.array_equal(refined(truth, (1, 16))[0], truth)


def test_the_coarse_grid_is_a_share_of_the_axis_and_values_without_order_are_all_run():
    counts = {2: 1, 61: 1, 121: 2, 201: 2, 241: 4, 1001: 16, 2001: 32}
    for count, spacing in counts.items():
        assert spacings([np.linspace(0.0, 10.0, count)]) == (spacing,)
        assert spacings([np.linspace(10.0, 0.0, count)]) == (spacing,)
    assert spacings([np.random.default_rng(0).permutation(1001).astype(float), np.arange(1001.0)]) == (1, 16)


@pytest.fixture(scope="module")
def pair():
    """The report's map at 121 x 121, run whole and refined."""
    coarse = figure_3_4(121, step=2e-4)
    return sweep(coarse), sweep(coarse, refine=True)


class TestSweeps:
    def test_labels_are_those_of_the_dense_run(self, pair):
        dense, refined = pair
        assert np.array_equal(regimes(dense), regimes(refined))
        for name in ("primary_impacts", "initial_side", "impact_flank", "status"):
            assert np.array_equal(getattr(dense, name), getattr(refined, name)), name

    def test_cells_that_were_run_are_the_same_bits_and_the_others_have_no_quantities(self, pair):
        dense, refined = pair
        inferred = (refined.quality & QUALITY_INFERRED) != 0
        assert 0.4 < inferred.mean() < 0.7
        for name in ("severity", "approach_velocity", "last_event_time", "touches", "quality"):
            assert np.array_equal(getattr(dense, name)[~inferred], getattr(refined, name)[~inferred], equal_nan=True)
        for name in ("severity", "approach_velocity", "last_event_time", "margin"):
            assert np.isnan(getattr(refined, name)[inferred]).all(), name
        assert np.all(refined.touches[inferred] == -1)
        owned = np.repeat(inferred.ravel(), refined.primary_impacts.ravel())
        for name in ("impact_time", "impact_closing_speed", "impact_severity"):
            assert np.isnan(getattr(refined, name)[owned]).all(), name
            assert np.array_equal(getattr(refined, name)[~owned], getattr(dense, name)[~owned]), name

    def test_the_file_says_how_many_cells_were_run(self, pair, tmp_path):
        _, refined = pair
        write_results(tmp_path / "map.h5", refined)
        again = read_results(tmp_path / "map.h5")
        assert equal(refined, again)
        ran = np.count_nonzero(refined.quality & QUALITY_INFERRED == 0)
        assert again.attributes["refinement"].startswith(f"{ran} of 14641 cells run")
        assert "missed" in again.attributes["refinement"]

    def test_failed_cells_are_run_and_never_inferred(self):
        """σr = -1 has no initial flank; what is beside it is run."""
        results = sweep(study(("load.ratio", np.linspace(-2.0, 2.0, 241)), step=2e-4), refine=True)
        (failed,) = np.flatnonzero(results.status)
        assert results.axes[0].values[failed] == pytest.approx(-1.0)
        assert np.all(results.quality[failed - 1 : failed + 2] & QUALITY_INFERRED == 0)
        assert np.count_nonzero(results.quality & QUALITY_INFERRED) > 100

    def test_results_are_the_same_for_any_number_of_workers(self):
        one = study(("load.ratio", np.linspace(0.0, 10.0, 401)), step=2e-4)
        assert equal(sweep(one, refine=True, workers=1), sweep(one, refine=True, workers=3))

    def test_a_small_map_is_run_whole(self):
        results = sweep(figure_3_4(9, step=2e-4), refine=True)
        assert not np.any(results.quality & QUALITY_INFERRED)
        assert equal(results, sweep(figure_3_4(9, step=2e-4)))
