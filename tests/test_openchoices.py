"""What the report leaves open decides little of its map.

pytest -m slow tests/test_openchoices.py        the README's tables, from ten maps of 101 x 101 cells
"""

from pathlib import Path

import numpy as np
import pytest

from clunk.report.openchoices import base_study, by_force, contact_damping, main, markdown, measure, tension
from clunk.simulation.driveline import Driveline
from clunk.simulation.history import sample
from clunk.simulation.trajectory import simulate
from clunk.study.config import replace_values


@pytest.fixture(scope="module")
def coarse():
    return measure(21)


@pytest.mark.parametrize("ratio", [0.10, 0.196, 0.26])
def test_the_damping_is_the_one_with_that_ratio(ratio):
    damping = contact_damping(base_study(3), ratio)
    damped = replace_values(base_study(3), {"lash.contact.damping": damping})
    assert Driveline.from_study(damped).modes(closed=True).damping_ratio[-1] == pytest.approx(ratio, rel=1e-9)


def test_labels_hang_on_the_contact_s_damping_by_two_cells_in_a_hundred(coarse):
    shares = {variant.name.split(" (")[0]: variant.share for variant in coarse.variants}
    assert max(share for name, share in shares.items() if name.startswith("ζ4")) < 0.03
    assert shares["ζ4 = 0.10"] > shares["ζ4 = 0.16"]


def test_labels_do_not_hang_on_the_sticking_time_until_it_is_that_of_a_rebound(coarse):
    """Rebounds last up to 0.85 T_c and sticking 1.2 T_c at least (computed over the map)."""
    shares = {variant.name: variant.share for variant in coarse.variants}
    assert shares["sticking time 1.2 T_c"] == 0.0
    assert shares["sticking time 0.85 T_c"] < 0.002
    assert shares["sticking time 0.7 T_c"] > 0.1


def test_the_separation_rule_moves_the_severity_and_hardly_a_label(coarse):
    by_gap, forced = coarse.separations
    assert next(v.share for v in coarse.variants if v.name == "separation by force") < 0.01
    assert forced.nominal_severity / by_gap.nominal_severity == pytest.approx(0.854, abs=0.002)
    assert forced.largest_tension == 0.0
    assert by_gap.largest_tension > 2.0 * by_gap.nominal_tension


def test_the_largest_tension_is_where_the_gap_opens():
    """Against the contact torque k ξ + c ξ' sampled every 10 µs through every contact of the nominal run."""
    study = replace_values(base_study(3), {"load.ratio": 5.0, "lash.backlash_deg": 6.0})
    trajectory = simulate(study.model_copy(update={"sweep": None}))
    motion = sample(trajectory, 1e-5, 1.0)
    side = -trajectory.initial_side * motion.contact.astype(float)
    gap = motion.angle[:, 2] - motion.angle[:, 3]
    speed = motion.velocity[:, 2] - motion.velocity[:, 3]
    torque = np.where(side == 0.0, 0.0, 2618.88 * (side * gap - np.deg2rad(3.0)) + 0.6016 * side * speed)
    assert tension(study, 5.0, 6.0) == pytest.approx(-torque.min(), rel=1e-9)
    assert tension(by_force(study), 5.0, 6.0) == 0.0


def test_it_is_a_command(capsys):
    main(["--count", "3", "--workers", "1"])
    out = capsys.readouterr().out
    assert out.startswith("| changed |")
    assert "of 9, " in out


@pytest.mark.slow
def test_the_readme_has_the_tables():
    readme = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
    for table in markdown(measure()).split("\n\n"):
        assert table.strip() in readme
