"""Runs at arbitrary points of a study: the bits of a sweep's cells, along one axis."""

import numpy as np
import pytest

import clunk
from clunk.results.quantities import CELL_QUANTITIES, IMPACT_QUANTITIES
from clunk.study.axes import RUN

CONFIG = """
driveline.preset = "boere-2008"
[[sweep.axes]]
parameter = "load.ratio"
values = [2.0, 5.0, 9.0]
[[sweep.axes]]
parameter = "{parameter}"
values = {values}
"""


@pytest.fixture(scope="module")
def single():
    return clunk.study_from_text('driveline.preset = "boere-2008"')


@pytest.mark.parametrize(
    ("parameter", "values"),
    [
        ("lash.backlash_deg", [1.0, 5.0, 10.0, 20.0]),
        ("driveline.inertias[4]", [0.001, 0.002, 0.02]),
        ("load.on", [1, 3]),
        ("solver.end_time", [0.15, 2.0]),
    ],
)
def test_points_of_a_grid_are_the_bits_of_its_cells(parameter, values):
    study = clunk.study_from_text(CONFIG.format(parameter=parameter, values=values))
    grid = clunk.sweep(study, boundaries=False)
    ratios, others = np.meshgrid([2.0, 5.0, 9.0], np.array(values, float), indexing="ij")
    runs = clunk.run_points(study, {"load.ratio": ratios.ravel(), parameter: others.ravel()}, workers=3)
    assert runs.shape == (ratios.size,)
    assert [axis.parameter for axis in runs.axes] == [RUN]
    assert [axis.parameter for axis in runs.coordinates] == ["load.ratio", parameter]
    assert runs.labels == grid.labels
    for name in CELL_QUANTITIES:
        assert getattr(runs, name).tobytes() == getattr(grid, name).tobytes(), name
    for name in IMPACT_QUANTITIES:
        assert getattr(runs, name).tobytes() == getattr(grid, name).tobytes(), name


def test_the_order_of_points_does_not_matter(single):
    rng = np.random.default_rng(2)
    ratio, gap, order = rng.uniform(0.0, 10.0, 300), rng.uniform(0.5, 20.0, 300), rng.permutation(300)
    one = clunk.run_points(single, {"load.ratio": ratio, "lash.backlash_deg": gap})
    other = clunk.run_points(single, {"lash.backlash_deg": gap[order], "load.ratio": ratio[order]}, workers=1)
    assert np.array_equal(one.label_map[order], other.label_map)
    assert np.array_equal(one.severity[order], other.severity)


def test_runs_are_a_file_like_any_other(single, tmp_path):
    runs = clunk.run_points(single, {"load.ratio": [1.0, 5.0], "lash.backlash_deg": [6.0, 3.0]})
    clunk.write_results(tmp_path / "runs.h5", runs)
    again = clunk.read_results(tmp_path / "runs.h5")
    assert np.array_equal(again.label_map, runs.label_map)
    assert again.cell({"run": 2})["lash.backlash_deg"] == 3.0
    assert clunk.study_from_text(again.config).sweep is None


def test_other_points_have_another_digest(single):
    digests = {
        clunk.run_points(single, points).config_digest
        for points in ({"load.ratio": [1.0]}, {"load.ratio": [2.0]}, {"lash.backlash_deg": [1.0]})
    }
    assert len(digests) == 3


@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        ({"load.ration": [1.0]}, 'load.ration: .*did you mean "load.ratio"'),
        ({"solver.method": [1.0]}, "solver.method: "),
        ({"driveline.inertias[5]": [1.0]}, "has 4 items"),
        ({"driveline.inertias[4]": [1e-3, 1e11]}, "lost in rounding"),
        ({"load.ratio": [1.0], "solver.step": [3.0]}, "a step of 3 s is longer"),
        ({"load.ratio": [1.0, np.nan]}, "load.ratio: point 2: found nan; must be a finite number"),
        ({"lash.backlash_deg": [6.0, -1.0]}, "lash.backlash_deg: point 2: found -1.0; must be "),
        ({"load.ratio": [1.0, 2.0], "lash.backlash_deg": [6.0]}, "found 1 values, and load.ratio has 2"),
        ({"load.ratio": [[1.0]]}, "load.ratio: point 1: .*must be a finite number"),
        ({"load.ratio": []}, "load.ratio: found .*; must be a list of finite numbers"),
        ({"load.ratio": ["much"]}, 'load.ratio: point 1: found "much"; must be a finite number'),
        ({"load.on": [1.0, 1.5]}, "load.on: .*must be an inertia's number"),
        ({"load.on": [1.0, 5.0]}, "load.on"),
        ({"load.ratio": [1.0], "load.initial_torque": [1.0]}, "load"),
        ({}, "nothing to run: points names no parameter"),
    ],
)
def test_what_cannot_be_run_is_one_sentence(single, points, sentence):
    with pytest.raises(clunk.ConfigError, match=sentence):
        clunk.run_points(single, points)


def test_times_that_decrease_in_one_point_are_refused_though_each_is_allowed():
    table = "load={profile='table', times=[0.0, 0.2, 0.4], torques=[-6.0, -3.0, -1.0]}"
    runner = clunk.Runner(clunk.load_study("configs/nominal.toml", [table]), ["load.times[2]", "load.times[3]"])
    runner([[0.1, 0.2], [0.5, 0.6]])
    with pytest.raises(clunk.ConfigError, match="times decrease"):
        runner([[0.5, 0.2]])
