"""Two methods that share the model and nothing else: where they agree and where not, and what a person is told."""

import json

import pytest
from click.testing import CliRunner
from conftest import NOMINAL as OF_REPORT, axis, values

from clunk.analysis.comparison import METHODS, verify
from clunk.cli import cli
from clunk.core.status import QUALITY_COMPLETE
from clunk.study.config import study_from_text

NOMINAL = f'title = "Small"\n{OF_REPORT}'
GRID = axis("load.ratio", 0.0, 10.0, 11) + axis("lash.backlash_deg", 0.0, 20.0, 9)
# At σr = 9 and steps this coarse RK4 damps the contact's own oscillation: it finds DS(1)SS(2) from 15° on.
NEAR_A_BOUNDARY = values("load.ratio", [8.0, 9.0]) + values("lash.backlash_deg", [12.0, 15.0, 16.0])
TOO_COARSE = "solver.step=1.4e-3"


def study(axes="", *overrides):
    return study_from_text(NOMINAL + axes, "test", list(overrides))


@pytest.fixture(scope="module")
def grid():
    return verify(study(GRID), workers=2)


@pytest.fixture
def verify_command(command, here):
    def run(text, *arguments):
        (here / "study.toml").write_text(text)
        return command("verify", "study.toml", *arguments)

    return run


def largest(found):
    return {each.quantity: each for each in found.largest_differences}


def agree(found):
    return found.cells > 0 and found.differing_elsewhere == 0


# --- physics


def test_both_methods_find_the_same_labels_touches_and_times_on_a_coarse_grid(grid):
    assert (grid.cells, grid.differing, grid.touches_equal) == (99, 0, 99)
    assert all((each.quality & QUALITY_COMPLETE).all() for each in grid.maps)
    found = largest(grid)
    # RK4's error at this step: 0.13 µs, and 5e-6 of Q; an event mixed up with another would be off by milliseconds
    assert found["impact_time"].difference < 5e-7
    assert found["last_event_time"].difference < 5e-7
    assert found["severity"].over_largest < 2e-5
    assert found["impact_severity"].over_largest < 2e-5
    assert found["approach_velocity"].over_largest < 1e-6


def test_cells_with_a_lost_rebound_are_told_by_their_touches():
    found = verify(study(NEAR_A_BOUNDARY.replace("12.0, 15.0, 16.0", "1.3"), "solver.step=1e-3"))
    assert agree(found)
    assert found.touches_equal < found.cells


# --- the command


def test_verify_prints_what_compare_does_within_80_columns_for_maps_and_single_runs(verify_command):
    code, out, _ = verify_command(NOMINAL, "--json")
    assert (code, json.loads(out)["cells_compared"]) == (0, 1)
    code, out, _ = verify_command(NOMINAL + GRID)
    assert code == 0
    assert out.startswith("The labels are the same in 99 cells.")
    assert "solver.method  rk4  exact" in out
    assert max(map(len, out.splitlines())) <= 80


def test_a_study_of_tolerances_alone_is_verified_by_its_run():
    drawn = '[[sweep.tolerances]]\nparameter = "load.ratio"\ndistribution = "uniform"\nlow = 4.0\nhigh = 6.0\n'
    assert verify(study(drawn)).cells == 1


def test_a_step_that_is_too_coarse_at_an_end_of_an_axis_is_warned_of(verify_command):
    _, _, err = verify_command(NOMINAL + values("lash.contact.stiffness", [4e5, 4e7]) + values("load.ratio", [5.0]))
    assert "rebounds are lost and labels wrong" in err


def test_a_run_is_not_warned_of_the_ends_of_axes_that_it_is_not_at(tmp_path):
    swept = tmp_path / "swept.toml"
    swept.write_text(NOMINAL + values("lash.contact.stiffness", [4e5, 4e7]), encoding="utf-8")
    at = ["simulate", str(swept), "--at", "lash.contact.stiffness="]
    told = [CliRunner().invoke(cli, [*at[:-1], at[-1] + value]).stderr for value in ("4e5", "4e7")]
    assert ["rebounds are lost" in each for each in told] == [False, True]


def test_verify_exits_4_and_names_the_cells_where_labels_differ_also_in_json(verify_command):
    code, out, err = verify_command(NOMINAL + NEAR_A_BOUNDARY, "--set", TOO_COARSE)
    assert code == 4
    assert "rebounds are lost and labels wrong" in err
    cells = out[out.index("\ncells with two labels\n") :].split("\n\n")[0]
    assert [line.split() for line in cells.splitlines()[3:]] == [
        ["9", "15", "DS(1)SS(2)", "DS(1)SS(1)", "no"],
        ["9", "16", "DS(1)SS(2)", "DS(1)SS(1)", "no"],
    ]
    code, out, _ = verify_command(NOMINAL + NEAR_A_BOUNDARY, "--set", TOO_COARSE, "--json")
    assert code == 4
    printed = json.loads(out)
    assert printed["same_regimes"] is False
    assert (printed["cells_compared"], printed["cells_differing"], printed["differing_elsewhere"]) == (6, 2, 2)
    assert printed["differing_cells"][0]["at"] == {"load.ratio": 9.0, "lash.backlash_deg": 15.0}
    code, out, _ = verify_command(
        NOMINAL + NEAR_A_BOUNDARY, "--set", TOO_COARSE, "--set", "solver.margin_tolerance=0.01"
    )
    assert code == 0
    assert "2 of 6 cells differ" in out


def test_verify_exits_3_where_cells_failed(verify_command):
    axes = GRID.replace("start = 0.0", "start = -1.0", 1).replace("stop = 10.0", "stop = 9.0")
    code, out, err = verify_command(NOMINAL + axes)
    assert code == 3
    assert "the same in 90 cells" in out
    for method in METHODS:
        assert f"9 cells failed by {method}: no initial flank" in err
    nowhere = axes.replace("count = 11", "count = 1")
    code, out, _ = verify_command(NOMINAL + nowhere, "--set", "sweep.axes[1].stop=-1.0")
    assert code == 3
    assert "No cell has a label in both maps" in out
