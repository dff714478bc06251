"""Two methods that share the model and nothing else: where they agree and where not, and what a person is told."""

import json
import sys

import numpy as np
import pytest
from test_store import padded

from clunk.analysis.verification import GUARDED, METHODS, by, pair_events, verify
from clunk.cli import main, phrases
from clunk.cli.verify import as_record, verdict
from clunk.core.status import QUALITY_COMPLETE
from clunk.study.config import study_from_text

NOMINAL = """
title = "Small"
[driveline]
preset = "boere-2008"
[lash]
backlash_deg = 6.0
[load]
ratio = 5.0
"""
GRID = """
[[sweep.axes]]
parameter = "load.ratio"
start = 0.0
stop = 10.0
count = 11
[[sweep.axes]]
parameter = "lash.backlash_deg"
start = 0.0
stop = 20.0
count = 9
"""
# At σr = 9 and steps this coarse RK4 damps the contact's own oscillation: it finds DS(1)SS(2) from 15° on.
NEAR_A_BOUNDARY = """
[[sweep.axes]]
parameter = "load.ratio"
values = [8.0, 9.0]
[[sweep.axes]]
parameter = "lash.backlash_deg"
values = [12.0, 15.0, 16.0]
"""
TOO_COARSE = "solver.step=1.4e-3"


def study(axes="", *overrides):
    return study_from_text(NOMINAL + axes, "test", list(overrides))


def record(found):
    """The record as JSON has it: null where something is not defined."""
    return phrases.plain(as_record(found))


@pytest.fixture(scope="module")
def grid():
    return verify(study(GRID), workers=2)


@pytest.fixture
def clunk(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("signal.signal", lambda *_: None)  # main's handler must not outlive a test

    def run(text, *arguments):
        (tmp_path / "study.toml").write_text(text)
        monkeypatch.setattr(sys, "argv", ["clunk", "verify", "study.toml", *arguments])
        with pytest.raises(SystemExit) as stopped:
            main()
        out, err = capsys.readouterr()
        return stopped.value.code, out, err

    return run


def largest(found):
    return {each.quantity: each for each in found.largest}


# --- physics


def test_both_methods_find_the_same_labels_touches_and_times_on_a_coarse_grid(grid):
    assert grid.agrees
    assert grid.equal == grid.equal_touches == grid.cells == 99
    assert grid.count("rk4", QUALITY_COMPLETE) == grid.count("exact", QUALITY_COMPLETE) == 99
    found = largest(grid)
    # RK4's error at this step: 0.13 µs, and 5e-6 of Q; an event mixed up with another would be off by milliseconds
    assert found["impact_time"].difference < 5e-7
    assert found["last_event_time"].difference < 5e-7
    assert found["severity"].of_largest < 2e-5
    assert found["impact_severity"].of_largest < 2e-5
    assert found["approach_velocity"].of_largest < 1e-6


def test_the_methods_approach_each_other_sixteenfold_when_the_step_halves():
    coarse, fine = (largest(verify(study(GRID, f"solver.step={step}"))) for step in (1e-4, 5e-5))
    for quantity in ("impact_time", "severity", "approach_velocity"):
        # RK4 is of fourth order; the next order is a tenth of it at the contact's 258 Hz
        assert 12.0 < coarse[quantity].difference / fine[quantity].difference < 20.0


@pytest.mark.parametrize("separation", ["gap", "force"])
def test_the_methods_agree_for_either_separation(separation):
    found = verify(study(GRID, f"lash.contact.separation={separation}"))
    assert found.agrees
    assert found.equal == 99


def test_restitution_agrees_and_its_severity_is_left_out():
    found = verify(study(GRID, "lash.contact.model=restitution"))
    assert found.agrees
    assert set(largest(found)) == {"impact_time", "last_event_time", "approach_velocity"}
    assert record(found)["largest_differences"][0]["quantity"] == "impact_time"
    json.dumps(record(found), allow_nan=False)


def test_a_step_that_damps_the_contact_gives_labels_that_exact_does_not_flag():
    found = verify(study(NEAR_A_BOUNDARY, TOO_COARSE))
    assert not found.agrees
    assert (found.differing_elsewhere, found.differing_flagged, found.equal) == (2, 0, 4)
    cells = list(found.disagreements(flagged=False))
    assert [cell.values for cell in cells] == [(9.0, 15.0), (9.0, 16.0)]
    assert {(cell.a, cell.b) for cell in cells} == {("DS(1)SS(2)", "DS(1)SS(1)")}
    assert all(found.exact.margin[cell.at] > found.study.solver.margin_tolerance for cell in cells)
    assert not list(found.disagreements(flagged=True))
    assert "disagree: two labels in 2 cells of 6" in verdict(found)
    assert "smaller solver.step than 0.0014 s" in verdict(found)


def test_labels_may_differ_in_flagged_cells():
    found = verify(study(NEAR_A_BOUNDARY, TOO_COARSE, "solver.margin_tolerance=0.01"))
    assert found.agrees
    assert (found.differing_elsewhere, found.differing_flagged) == (0, 2)
    assert all(abs(found.exact.margin[cell.at]) < 0.01 for cell in found.disagreements(flagged=True))
    assert "exact flags each of those" in verdict(found)


def test_differences_are_taken_where_labels_are_equal_and_impacts_correspond():
    found = verify(study(NEAR_A_BOUNDARY, TOO_COARSE))
    equal = found.rk4.sequence != -1
    for cell in np.argwhere(found.comparison.differs):
        equal[tuple(cell)] = False
    times = [padded(results, "impact_time") for results in (found.rk4, found.exact)]
    size = max(block.shape[-1] for block in times)
    mine, theirs = (np.full((*equal.shape, size), np.nan) for _ in range(2))
    for block, target in zip(times, (mine, theirs), strict=True):
        target[..., : block.shape[-1]] = block
    assert largest(found)["impact_time"].difference == np.nanmax(np.abs(mine - theirs)[equal])
    q = np.abs(found.rk4.severity - found.exact.severity)[equal].max()
    assert largest(found)["severity"].difference == q
    assert largest(found)["severity"].of_largest == q / found.exact.severity.max()


def test_a_cell_with_a_lost_rebound_tells_its_touches():
    found = verify(study(NEAR_A_BOUNDARY.replace("12.0, 15.0, 16.0", "1.3"), "solver.step=1e-3"))
    assert found.agrees
    assert found.equal_touches < found.cells
    last = largest(found)["last_event_time"]
    cell = [axis.values.tolist().index(value) for axis, value in zip(found.exact.axes, last.values, strict=True)]
    assert last.touches == (found.rk4.touches[*cell], found.exact.touches[*cell])


# --- single runs


def test_a_run_without_axes_is_compared_event_by_event():
    found = verify(study())
    assert found.cells == 1
    assert found.agrees
    assert len(found.events) == 19  # the load step, and 9 touches each with its separation
    assert max(abs(pair.rk4 - pair.exact) for pair in found.events) < 1e-6
    assert [pair.exact for pair in found.events] == sorted(pair.exact for pair in found.events)


def test_a_rebound_that_one_method_lacks_leaves_the_others_in_pairs():
    found = verify(study("", "load.ratio=8.0", "solver.step=1e-3"))
    missing = [pair for pair in found.events if np.isnan(pair.rk4)]
    assert [(pair.name, pair.flank) for pair in missing] == [("separation", "opposite"), ("touch", "opposite")]
    assert not any(np.isnan(pair.exact) for pair in found.events)
    paired = [abs(pair.rk4 - pair.exact) for pair in found.events if pair not in missing]
    assert max(paired) < 2e-3  # two of RK4's steps


def test_a_run_is_its_own_pair():
    from clunk.simulation.trajectory import simulate

    run = simulate(study())
    pairs = pair_events(run, run)
    assert [pair.rk4 for pair in pairs] == [pair.exact for pair in pairs] == run.events["time"].tolist()
    assert [pair.name for pair in pairs] == [run.kind_name(k) for k in range(len(run.events))]


# --- whatever the study


@pytest.mark.parametrize("method", METHODS)
def test_the_config_s_own_method_does_not_matter(grid, method):
    base = study(GRID)
    assert by(base, method).solver.method == method
    mine, theirs = record(grid), record(verify(by(base, method)))
    for each in (mine, theirs):
        del each["seconds"]
    assert mine == theirs


def test_any_number_of_axes_is_compared():
    axis = '[[sweep.axes]]\nparameter = "{}"\nvalues = [{}]\n'
    one = axis.format("load.ratio", "1.0, 5.0, 9.0")
    three = one + axis.format("driveline.inertias[4]", "0.002, 0.004") + axis.format("lash.backlash_deg", "2.0, 8.0")
    for axes, cells in ((one, 3), (three, 12)):
        found = verify(study(axes))
        assert (found.cells, found.equal) == (cells, cells)
        at = record(found)["largest_differences"][0]["at"]
        assert list(at) == [a.parameter for a in found.comparison.axes]


def test_progress_counts_the_cells_of_both_sweeps():
    seen = []
    verify(study(NEAR_A_BOUNDARY), progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (12, 12)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)


# --- the command


def test_verify_prints_a_table_and_a_verdict_within_80_columns(clunk):
    code, out, _ = clunk(NOMINAL + GRID)
    assert code == 0
    assert GUARDED in out
    assert "labels equal                                     99    100.00 %" in out
    assert out.splitlines()[-1] == "The methods agree: the same label in all 99 cells."
    assert max(map(len, out.splitlines())) <= 80


def test_verify_exits_4_and_names_the_cells_where_labels_differ(clunk):
    code, out, err = clunk(NOMINAL + NEAR_A_BOUNDARY, "--set", TOO_COARSE)
    assert code == 4
    assert "weak rebounds are lost" in err
    cells = out[out.index("\nlabels differ elsewhere\n") :].split("\n\n")[0]
    assert [line.split()[:4] for line in cells.splitlines()[3:]] == [
        ["9", "15", "DS(1)SS(2)", "DS(1)SS(1)"],
        ["9", "16", "DS(1)SS(2)", "DS(1)SS(1)"],
    ]
    assert "The methods disagree" in out
    code, out, _ = clunk(NOMINAL + NEAR_A_BOUNDARY, "--set", TOO_COARSE, "--set", "solver.margin_tolerance=0.01")
    assert code == 0
    assert "labels differ in flagged cells" in out


def test_verify_answers_in_json(clunk):
    code, out, _ = clunk(NOMINAL + NEAR_A_BOUNDARY, "--set", TOO_COARSE, "--json")
    assert code == 4
    printed = json.loads(out)
    assert printed["agrees"] is False
    assert (printed["cells"], printed["labels_equal"], printed["labels_differ_elsewhere"]) == (6, 4, 2)
    assert printed["differing_cells"][0]["at"] == {"load.ratio": 9.0, "lash.backlash_deg": 15.0}
    code, out, _ = clunk(NOMINAL, "--json")
    assert code == 0
    assert len(json.loads(out)["events"]) == 19


def test_verify_prints_a_run_event_by_event(clunk):
    code, out, _ = clunk(NOMINAL)
    assert code == 0
    assert out.count("touch  ") == 9
    assert "label       DS(1)SS(1)              DS(1)SS(1)" in out
    assert out.splitlines()[-1] == "The methods agree: the run has the same label."


def test_verify_of_a_run_without_events_says_so(clunk):
    code, out, _ = clunk(NOMINAL, "--set", "load.ratio=0.5")
    assert code == 0
    assert "no events" in out
    assert "label       NI                      NI" in out


def test_verify_exits_3_where_cells_failed(clunk):
    axes = GRID.replace("start = 0.0", "start = -1.0", 1).replace("stop = 10.0", "stop = 9.0")
    code, out, err = clunk(NOMINAL + axes)
    assert code == 3
    assert "in all 90 cells that did not fail" in out
    for method in METHODS:
        assert f"9 cells failed by {method}: no initial flank" in err
    nowhere = axes.replace("count = 11", "count = 1")
    code, out, _ = clunk(NOMINAL + nowhere, "--set", "sweep.axes[1].stop=-1.0")
    assert code == 3
    assert "no cell has a label by both methods" in out


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--set", "solver.step=0.01"], "unstable"),
        (["--set", "load.ratio=-1.0"], "No initial flank"),
        (["--set", "load.ratoi=1.0"], 'did you mean "ratio"'),
        (["--workers", "0"], "--workers"),
    ],
)
def test_bad_input_exits_2_with_a_sentence(clunk, arguments, named):
    code, out, err = clunk(NOMINAL, *arguments)
    assert (code, out) == (2, "")
    assert named in err
    assert "Traceback" not in err
