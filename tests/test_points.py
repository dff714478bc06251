"""Runs at arbitrary points of a study: the bits of a sweep's cells, along one axis."""

import os
import pickle

import numpy as np
import pytest

import clunk


@pytest.fixture(scope="module")
def single():
    return clunk.study_from_text('driveline.preset = "boere-2008"')


def test_runs_are_a_file_like_any_other(single, tmp_path):
    runs = clunk.run_points(single, {"load.ratio": [1.0, 5.0], "lash.backlash_deg": [6.0, 3.0]})
    clunk.write_results(tmp_path / "runs.h5", runs)
    again = clunk.read_results(tmp_path / "runs.h5")
    assert np.array_equal(again.label_map, runs.label_map)
    assert again.cell({"run": 2})["lash.backlash_deg"] == 3.0
    assert clunk.study_from_text(again.config).sweep is None


def test_a_runner_without_keys_is_refused(single):
    with pytest.raises(clunk.ConfigError, match="needs a key or more"):
        clunk.Runner(single, [])


def test_a_runner_takes_one_key_as_it_is(single):
    alone, listed = (clunk.Runner(single, keys)([[1.0], [5.0]]) for keys in ("load.ratio", ["load.ratio"]))
    assert np.array_equal(alone.severity, listed.severity)


def test_a_runner_goes_to_other_processes(single):
    """Pickled, as to the workers of an optimiser; and by a fork after its own threads have run, which would not run on.

    So many points are run by threads.
    """
    runner = clunk.Runner(single.but(solver=single.solver.but(method="exact")), ["load.ratio"])
    points = np.linspace(0.1, 10.0, 5000)[:, None]
    severity = runner(points).severity
    assert np.array_equal(pickle.loads(pickle.dumps(runner))(points).severity, severity)
    if hasattr(os, "fork"):
        child = os.fork()
        if not child:
            os._exit(0 if np.array_equal(runner(points).severity, severity) else 1)
        assert os.waitpid(child, 0)[1] == 0


def test_columns_of_a_table_are_points(single):
    pandas = pytest.importorskip("pandas")
    columns = {"load.ratio": [1.0, 5.0], "lash.backlash_deg": [6.0, 3.0]}
    tabled, plain = (clunk.run_points(single, points) for points in (pandas.DataFrame(columns), columns))
    assert np.array_equal(tabled.label_map, plain.label_map)


def test_values_are_asked_for_in_the_words_of_quantities(single):
    runs = clunk.run_points(single, {"load.ratio": [1.0, 5.0]})
    assert runs.values("severity<=8000").tolist() == [1.0, 0.0]
    assert runs.values("label=NI").tolist() == [1.0, 0.0]
    with pytest.raises(clunk.ClunkError, match="did you mean severity"):
        runs.values("severty")


@pytest.mark.parametrize(
    ("points", "sentence"),
    [
        ({"load.ration": [1.0]}, 'load.ration" .*did you mean "load.ratio"'),
        ({"solver.method": [1.0]}, '"solver.method" that can be swept'),
        ({"driveline.inertias[5]": [1.0]}, r"no number \"driveline.inertias\[5\]"),
        ({"driveline.inertias[4]": [1e-3, 1e11]}, "lost in rounding"),
        ({"load.ratio": [1.0], "solver.step": [3.0]}, "a step of 3 s is longer"),
        ({"load.ratio": [1.0, np.nan]}, "load.ratio: point 2: found nan; must be a finite number"),
        ({"lash.backlash_deg": [6.0, -1.0]}, "lash.backlash_deg: point 2: found -1.0; must be "),
        ({"load.ratio": [1.0, 2.0], "lash.backlash_deg": [6.0]}, "found 1 values, and load.ratio has 2"),
        ({"load.ratio": [[1.0]]}, "load.ratio: point 1: .*must be a finite number"),
        ({"load.ratio": []}, "load.ratio: found .*; must be a list of finite numbers"),
        ({"load.ratio": ["much"]}, 'load.ratio: point 1: found "much"; must be a finite number'),
        ({"load.on": [1.0, 1.5]}, "load.on: .*must be a number"),
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


def test_a_key_that_is_given_twice_is_refused_whatever_its_name():
    study = clunk.study_from_text('driveline.preset = "boere-2008"')
    keys = ["lash.backlash_deg", "lash[1].backlash_deg"]
    with pytest.raises(clunk.ConfigError, match="given twice"):
        clunk.run_points(study, dict.fromkeys(keys, (2.0, 6.0)))
    with pytest.raises(clunk.ConfigError, match="given twice"):
        clunk.Runner(study, keys)
