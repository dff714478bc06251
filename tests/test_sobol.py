"""Sobol indices are those of functions that have known ones, and of the physics where tolerances are small."""

import re

import numpy as np
import pytest

import clunk
from clunk.analysis.sobol import first_and_total, saltelli_sample, sensitivity
from clunk.plot.analyses import sobol_bars
from clunk.plot.style import PlotError
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.errors import ClunkError
from clunk.study.parameters import nominal_value
from clunk.study.records import plain
from clunk.study.study import replace_values

POINT = """
title = "σr = 5, φθ = 6°"
[driveline]
preset = "boere-2008"
[lash]
backlash_deg = 6.0
[load]
ratio = 5.0
"""
SPREAD = {
    "lash.contact.stiffness": 'distribution = "normal"\ndraws = "factor"\nstd = 0.05',
    "load.ratio": 'distribution = "uniform"\nlow = 4.0\nhigh = 6.0',
    "lash.backlash_deg": 'distribution = "triangular"\nlow = 5.0\nmode = 6.0\nhigh = 8.0',
    "driveline.shafts[3].stiffness": 'distribution = "lognormal"\nsigma = 0.1',
}
STRUCTURAL = (
    "lash.contact.stiffness",
    "lash.contact.damping",
    "driveline.inertias[4]",
    "driveline.shafts[3].stiffness",
)
BETWEEN = {"spline": '["motor", "flange"]', "gear": '["pinion", "ring"]'}
DRIVING = {key: SPREAD[key] for key in ("load.ratio", "lash.backlash_deg")}
LOOSE_RADIUS = '[[sweep.tolerances]]\nparameter = "lash.radius"\ndistribution = "normal"\nstd = 1e-4\n'
NEAR_A_BOUNDARY = {  # at σr = 5 between DS(2) and DS(1)SS(1), which is at 3.75°
    "lash.backlash_deg": 'distribution = "normal"\nmean = 3.75\nstd = 0.05',
    "load.ratio": 'distribution = "normal"\nstd = 0.005',
}


def text(spread, count=64, seed=0, point=POINT):
    tables = [f'[[sweep.tolerances]]\nparameter = "{key}"\n{numbers}\n' for key, numbers in spread.items()]
    return "".join([point, *tables, f"[sweep.sampling]\ncount = {count}\nseed = {seed}\n"])


def study(spread, *overrides, **options):
    return study_from_text(text(spread, **options), overrides=overrides)


def record(found):
    """The record as JSON has it: null where something is not defined."""
    return plain(found)


@pytest.fixture
def clunk_command(command, here):
    def run(config, *arguments):
        (here / "config.toml").write_text(config, encoding="utf-8")
        return command("sensitivity", "config.toml", *arguments)

    return run


def test_an_additive_function_has_its_known_indices():
    """y = Σ a_i x_i has S_i = ST_i = a_i² Var(x_i) / Var(y).

    With 4096 Sobol points no seed of eight was wrong by more than 0.7 % of any index.
    """
    sample = saltelli_sample(study(SPREAD, count=4096))
    lognormal = 31.3**2 * np.exp(0.1**2) * (np.exp(0.1**2) - 1.0)
    triangular = (5**2 + 6**2 + 8**2 - 5 * 6 - 5 * 8 - 6 * 8) / 18
    variance = np.array([(0.05 * 409200.0) ** 2, (6.0 - 4.0) ** 2 / 12, triangular, lognormal])
    shares = np.array([0.5, 0.25, 0.15, 0.1])
    first, total, first_interval, total_interval = first_and_total(sample @ np.sqrt(shares / variance), seed=0)
    assert first == pytest.approx(shares, rel=0.02)
    assert total == pytest.approx(shares, rel=0.02)
    for interval in (first_interval, total_interval):
        assert np.all((interval[0] < shares) & (shares < interval[1]))
        assert np.all(interval[1] - interval[0] < 0.1)


def test_a_single_parameter_has_all_of_the_variance():
    point = study({"lash.backlash_deg": SPREAD["lash.backlash_deg"]}, count=64)
    (indices,) = sensitivity(point, of="severity").indices  # one needs no list
    (share,) = indices.indices.values()
    assert (share.first, share.total) == pytest.approx((1.0, 1.0), abs=0.02)  # of 64 samples


def test_a_product_s_interaction_is_in_the_total_indices_alone():
    """y = x1 x2 with means μ and variances v: Var(y) = v1 μ2² + v2 μ1² + v1 v2, the last one the interaction."""
    uniform = 'distribution = "uniform"\nlow = {}\nhigh = {}'
    spread = {"load.ratio": uniform.format(1.0, 7.0), "lash.backlash_deg": uniform.format(0.0, 12.0)}
    sample = saltelli_sample(study(spread, count=4096))
    first, total, _, _ = first_and_total(sample.prod(axis=2), seed=0)
    (m1, v1), (m2, v2) = (4.0, 3.0), (6.0, 12.0)
    whole = v1 * m2**2 + v2 * m1**2 + v1 * v2
    assert first == pytest.approx(np.array([v1 * m2**2, v2 * m1**2]) / whole, rel=0.02)
    assert total == pytest.approx(np.array([v1 * m2**2 + v1 * v2, v2 * m1**2 + v1 * v2]) / whole, rel=0.02)


def test_the_indices_of_small_tolerances_are_those_of_error_propagation():
    """Where Q is linear, S_i = (∂Q/∂p_i σ_i)² / Σ; the slopes are central differences of single runs.

    128 samples of a linear function, by thirty seeds, were wrong by 0.066 and 0.031 at most.
    """
    normal = 'distribution = "normal"\ndraws = "factor"\nstd = 1e-3'
    point = study(dict.fromkeys(STRUCTURAL, normal), count=128)
    found = sensitivity(point).indices[0]
    step, contributions = 1e-3, []
    for key in STRUCTURAL:
        own = nominal_value(point, key)
        above, below = (simulate(replace_values(point, {key: own * (1.0 + s)})).severity for s in (step, -step))
        contributions.append((above - below) ** 2)
    shares = np.array(contributions) / sum(contributions)
    assert [found.indices[key].first for key in STRUCTURAL] == pytest.approx(shares, abs=0.07)
    assert [found.indices[key].total for key in STRUCTURAL] == pytest.approx(shares, abs=0.035)
    assert found.std == pytest.approx(np.sqrt(sum(contributions)) / 2, rel=0.05)
    assert found.mean == pytest.approx(simulate(point).severity, rel=1e-5)
    assert found.nominal == simulate(point).severity


def test_a_label_near_a_boundary_has_indices_and_a_probability():
    point = study(NEAR_A_BOUNDARY, "lash.backlash_deg=3.75", count=128)
    found = sensitivity(point, of=["nominal_label", "label=D(2)", "double_sided", "primary_impacts"])
    label, pair, double, primaries = found.indices
    assert found.label in found.labels
    assert sum(found.labels.values()) == pytest.approx(1.0, abs=1e-12)
    assert label.mean == pytest.approx(found.labels[found.label], abs=1e-12)
    assert pair.quantity == "label=DS(2)"
    assert pair.mean == pytest.approx(found.labels["DS(2)"], abs=1e-12)
    assert 0.1 < label.mean < 0.9
    assert next(iter(label.indices)) == "lash.backlash_deg"
    assert double.indices is None
    assert double.mean == 1.0
    assert primaries.nominal == simulate(point).primaries.size


def test_what_changes_nothing_has_no_share():
    spread = {**DRIVING, "lash.contact.restitution": 'distribution = "uniform"\nlow = 0.4\nhigh = 0.6'}
    found = sensitivity(study(spread)).indices[0].indices["lash.contact.restitution"]
    assert (found.total, found.total_interval) == (0.0, [0.0, 0.0])


def test_what_all_runs_have_but_for_rounding_is_no_variance():
    """The torque before the load step is the largest that a shaft bears: the same, whatever its stiffness."""
    measure = 'measures = [{name = "held", quantity = "shaft torque", of = 3, reduce = "largest"}]'
    spread = {key: SPREAD[key] for key in ("lash.contact.stiffness", "driveline.shafts[3].stiffness")}
    (found,) = sensitivity(study(spread, measure, "load.static_torque=-1.0"), of="held").indices
    assert found.mean == pytest.approx(6.0, rel=1e-12)
    assert found.indices is None
    assert found.std == 0.0


def test_nothing_depends_on_the_number_of_workers_and_everything_on_the_seed():
    spread = {"lash.contact.damping": 'distribution = "normal"\ndraws = "factor"\nstd = 0.05', **DRIVING}
    one, three = (sensitivity(study(spread, count=16), workers=workers) for workers in (1, 3))
    assert record(one) == record(three)
    other = sensitivity(study(spread, count=16, seed=1))
    assert all(share.total != other.indices[0].indices[key].total for key, share in one.indices[0].indices.items())


def test_the_restitution_model_has_an_approach_velocity():
    model = 'lash.contact.model="restitution"'
    found = sensitivity(study(DRIVING, model))
    assert [indices.quantity for indices in found.indices] == ["approach_velocity", "nominal_label"]
    with pytest.raises(ClunkError, match="not defined; under the restitution model"):
        sensitivity(study(DRIVING, model), of=["severity"])


@pytest.mark.parametrize(
    ("point", "of", "message"),
    [
        (study_from_text(POINT), [], r"no \[\[sweep.tolerances\]\]"),
        (
            study_from_text(POINT + "".join(f'{LOOSE_RADIUS}draws = "{each}"\n' for each in ("factor", "offset"))),
            [],
            "lash.radius has two tolerances",
        ),
        (study(DRIVING, count=100), [], "count = 100: .* a power of two"),
        (study(DRIVING, count=4), [], "count = 4: .* 16 or more"),
        (study(DRIVING), ["sevrity"], "did you mean severity"),
        (study(DRIVING), ["label=DS"], "compares nothing"),
        # the run without tolerances has 18 events
        (study(DRIVING, "solver.max_events=18"), [], r"\d+ of 257 runs failed.*The first is at load.*max_events"),
        (study(DRIVING, 'solver.method="rk4"'), ["margin"], r"margin is not .*; only the exact method knows it"),
    ],
)
def test_what_has_no_indices_is_refused_in_a_sentence(point, of, message):
    with pytest.raises(ClunkError, match=message):
        sensitivity(point, of=of)


def test_where_nothing_happens_the_last_event_is_at_the_load_step():
    ratio = 'distribution = "uniform"\nlow = 0.0\nhigh = 2.0'
    found = sensitivity(study(SPREAD | {"load.ratio": ratio}), of="last_event_time").indices[0]
    assert found.quantiles["0.05"] == 0.0 < found.mean
    assert found.indices["load.ratio"].total > 0.5


def test_a_lash_that_there_is_not_is_refused_in_a_sentence():
    with pytest.raises(ClunkError, match="there is no lash 2"):
        sensitivity(study(DRIVING), lash=2)


def test_of_several_lashes_the_one_that_is_meant_is_named(command, here):
    lash = 'name = "{}"\nbacklash_deg = 6.0\nradius = 0.08\ncontact = {{ stiffness = 4.092e5, damping = 94.0 }}\n'
    two = [f"[[lash]]\nbetween = {between}\n{lash.format(name)}" for name, between in BETWEEN.items()]
    point = POINT.replace("[lash]\nbacklash_deg = 6.0\n", "".join(two))
    (here / "config.toml").write_text(text({"load.ratio": SPREAD["load.ratio"]}, count=16, point=point))
    code, out, _ = command("sensitivity", "config.toml", "--lash", "gear", "--of", "touches")
    assert code == 0
    assert re.search("^lash +gear$", out, re.MULTILINE)
    assert sensitivity(study({"load.ratio": SPREAD["load.ratio"]}, count=16)).lash == ""


def test_a_draw_that_the_config_s_own_check_did_not_see_is_refused_too():
    """A study is checked with `count` draws of each parameter; the indices draw twice as many, other ones."""
    spread = {**DRIVING, "lash.contact.damping": 'distribution = "normal"\ndraws = "factor"\nstd = 0.35'}
    for seed in range(40):
        try:
            point = study(spread, count=16, seed=seed)
        except clunk.ConfigError:
            continue
        if saltelli_sample(point)[:, :, 2].min() < 0.0:
            break
    with pytest.raises(
        ClunkError, match=r"A draw is not allowed: lash.contact.damping, .*found -.*bound its distribution"
    ):
        sensitivity(point)


def test_the_command_prints_tables_of_80_columns_and_draws_them(clunk_command, tmp_path):
    config = text(
        {
            **SPREAD,
            "lash.contact.damping": 'distribution = "lognormal"\ndraws = "factor"\nsigma = 0.05\nlow = 0.8\nhigh = 1.2',
        }
    )
    code, out, err = clunk_command(config, "-o", "bars.png", "--of", "touches", "--of", "double_sided")
    assert code == 0
    assert max(map(len, (out + err).splitlines())) <= 80
    assert re.search(r"label without tolerances +DS\(1\)SS\(1\)\n", out)
    assert re.search(r"double_sided\n +without tolerances +1\n +mean +1\n +standard deviation +0\n", out)
    assert (tmp_path / "bars.png").read_bytes().startswith(b"\x89PNG")


def test_the_chart_has_a_panel_for_what_varies_and_bars_of_the_indices():
    found = sensitivity(study(DRIVING), of=["severity", "double_sided", "approach_velocity"])
    severity, double, velocity = found.indices
    figure = sobol_bars(found)
    assert len(figure.axes) == 2  # a double-sided impact is always there
    assert [ax.get_title(loc="left") for ax in figure.axes] == ["Severity Q [rad/s²]", "Approach velocity V [rad/s]"]
    for ax, indices in zip(figure.axes, (severity, velocity), strict=True):
        widths = [bar.get_width() for bar in ax.patches]
        shares = [indices.indices[key] for key in severity.indices]
        assert widths == [*(each.first for each in shares), *(each.total for each in shares)]
    with pytest.raises(PlotError, match="same in all runs"):
        sobol_bars(sensitivity(study(DRIVING), of=["double_sided"]))
    assert double.indices is None
