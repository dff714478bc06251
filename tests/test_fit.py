"""Fits to measured sequences: known parameters are recovered, and bad input is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import clunk
from clunk.analysis import fitting
from clunk.analysis.fitted import effective_size, fitted_study, losses, order_of_events, weights_of
from clunk.analysis.fitting import MATCH, outlier_misfit, sample
from clunk.analysis.measurements import Experiment, experiment_of
from clunk.api import run_points, sweep
from clunk.cli import cli
from clunk.results.labels import flanks_of_label
from clunk.study.config import load_study, study_from_text
from clunk.study.errors import ClunkError, ConfigError
from clunk.study.models import Fit
from clunk.study.study import Study, digest

RIG = '[driveline]\npreset = "boere-2008"\n[solver]\nmethod = "exact"\nend_time = 1.0\n'
SMALL = "[fit]\ncandidates = 64\ndraws = 128\neffective_draws = 20\n"
PRIOR = '[[fit.parameters]]\nparameter = "{}"\ndistribution = "uniform"\ndraws = "{}"\nlow = {}\nhigh = {}\n'
GAP = PRIOR.format("lash.backlash_deg", "factor", 0.7, 1.6)
TRUE_GAP = 1.3  # of the model over the measured one


def study_of(*priors: str, fit: str = SMALL) -> Study:
    return study_from_text(RIG + fit + "".join(priors))


@pytest.fixture(scope="module")
def measured() -> Experiment:
    """Runs of the rig at gaps that were measured too small, with times."""
    ratios, gaps = (each.ravel() for each in np.meshgrid([2.0, 4.0, 6.0, 9.0], [3.0, 8.0]))
    runs = run_points(study_from_text(RIG), {"load.ratio": ratios, "lash.backlash_deg": TRUE_GAP * gaps})
    lines = ["load_ratio,lash_backlash_deg,label,impact_time_1,impact_time_std"]
    for k, (ratio, gap) in enumerate(zip(ratios, gaps, strict=True)):
        lines.append(f"{ratio},{gap},{runs.label_map[k]},{runs.impact_time[runs.first_impact[k]]:.6f},0.0005")
    return experiment_of("\n".join(lines), "rig.csv")


@pytest.mark.parametrize(("text", "letters"), [("NI", ""), ("DS(1)SS(1)", "OII"), ("OS(1)DS(2)CR(1)", "OOIOIO")])
def test_a_label_has_the_flanks_of_its_excursions(text: str, letters: str) -> None:
    assert "".join("O" if flank > 0 else "I" for flank in flanks_of_label(text)) == letters


@pytest.mark.parametrize("text", ["CR(2)", "DS(1)OS(1)", "OS(1)SS(1)", "CR(1)SS(1)"])
def test_a_label_of_no_sequence_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="no sequence"):
        flanks_of_label(text)


@pytest.mark.parametrize(("low", "high"), [(0.7, 1.6), (1.05, 1.6)])
def test_the_config_as_it_is_is_a_candidate_where_the_priors_allow_it(measured: Experiment, low: float, high: float):
    """Times to 1e-9 s: no other of a few candidates comes as near, but 1 is not in every prior."""
    true = study_from_text(RIG)
    points = zip(*(each.values for each in measured.measurements), strict=True)
    runs = run_points(true, dict(zip(("load.ratio", "lash.backlash_deg"), points, strict=True)))
    first = runs.first_impact[:-1]
    lines = ["load_ratio,lash_backlash_deg,label,impact_time_1,impact_time_std"]
    for each, word, time in zip(measured.measurements, runs.label_map, runs.impact_time[first], strict=True):
        lines.append(f"{each.values[0]},{each.values[1]},{word},{time},1e-9")
    priors = PRIOR.format("lash.backlash_deg", "factor", low, high)
    fitted = clunk.fit(study_of(priors), experiment_of("\n".join(lines), "as it is.csv"))
    assert (fitted.estimate.tolist() == [1.0]) == (low < 1.0)
    assert low <= fitted.estimate[0] <= high


def test_importance_sampling_finds_a_gaussian_posterior_far_from_the_prior() -> None:
    # likelihood N(3, 0.05²) in the first coordinate: posterior mean 3/(1 + 0.05²), spread about 0.05; the second: prior
    draws, values, log_density = sample(
        lambda draws: (draws[:, 0] - 3.0) ** 2 / (2 * 0.05**2), 2, effective=500, most=8192, seed=1
    )
    weights = weights_of(values, log_density)
    assert effective_size(weights) >= 500
    mean = weights @ draws
    spread = np.sqrt(weights @ (draws - mean) ** 2)
    # standard errors with 500 draws: 1/sqrt(500) = 0.045 of a spread; four of them
    expected = np.array([0.05 / np.sqrt(1.0025), 1.0])
    assert np.all(np.abs(mean - [3.0 / 1.0025, 0.0]) < 4 * 0.045 * expected)
    np.testing.assert_allclose(spread, expected, rtol=4 * 0.045 / np.sqrt(2.0))


def test_one_bad_time_costs_its_logarithm_and_no_more() -> None:
    assert outlier_misfit(0.0) == 0.0
    assert np.isfinite(outlier_misfit(np.array([1e155, -1e300, np.inf]))).all()  # whose square is not
    assert outlier_misfit(1.0) == pytest.approx(0.5, rel=0.01)  # normal near 0
    assert outlier_misfit(1e4) < 2.5 * outlier_misfit(1e2)


def test_a_miss_more_costs_less_where_many_are_missed_and_grows_with_the_distance() -> None:
    fit = Fit.model_validate({"parameters": ({"parameter": "load.ratio", "distribution": "normal", "std": 1.0},)})
    wanted = np.full(20, 2)
    matches = np.zeros((21, 20), MATCH)
    for misses in range(21):
        matches["label"][misses] = np.where(np.arange(20) < misses, 3, 2)
    costs = np.diff(losses(matches, wanted, fit))
    assert costs[0] > 2.0
    assert np.all(np.diff(costs) < 0.0)
    far = matches.copy()
    far["distance"][:, 0] = 0.2
    assert losses(far, wanted, fit)[5] - losses(matches, wanted, fit)[5] == pytest.approx(0.2 / fit.scatter)


@pytest.mark.parametrize(
    ("measured", "computed", "words"),
    [
        ("SS(1)", "DS(1)", "Impact 1 would have to be on the initial flank, before the gap is crossed."),
        ("DS(2)", "DS(1)SS(1)", "Impact 3 would have to be on the opposite flank, before the gap turns back."),
        ("DS(1)", "OS(2)CR(1)", "Impact 2 would have to be on the initial flank, before the gap turns back."),
        ("OS(2)CR(1)", "DS(1)", "Impact 2 would have to be on the opposite flank, before the gap is crossed."),
        ("DS(1)SS(1)", "DS(1)", "once more"),
        ("NI", "SS(1)", "stay at the initial flank"),
    ],
)
def test_reasons_name_the_first_impact_that_differs(measured: str, computed: str, words: str) -> None:
    assert words in order_of_events(flanks_of_label(measured), flanks_of_label(computed))


def test_a_fit_recovers_the_scale_of_the_gap(measured: Experiment) -> None:
    fitted = fitting.fit(study_of(GAP), measured)
    assert fitted.met == len(measured.measurements)
    low, high = fitted.intervals()[0]
    assert low <= TRUE_GAP <= high
    assert high - low < 0.1  # eight times known to 0.5 ms leave about 0.05, a single one 0.15
    assert fitted.estimate[0] == pytest.approx(TRUE_GAP, abs=0.05)
    assert fitted.undetermined[0].spread < 0.3


def test_an_estimate_is_what_priors_and_measurements_leave_probable(measured: Experiment) -> None:
    """Of a stiffness that no label depends on the prior's middle, and not any that meets them as well."""
    stiffness = '[[fit.parameters]]\nparameter = "lash.contact.stiffness"\ndistribution = "lognormal"\nsigma = 0.3\n'
    labels = [replace(each, impacts={}, std={}) for each in measured.measurements]
    fitted = clunk.fit(study_of(GAP, stiffness + 'draws = "factor"\n'), replace(measured, measurements=tuple(labels)))
    assert fitted.met == len(labels)
    inside = (fitted.intervals()[:, 0] <= fitted.estimate) & (fitted.estimate <= fitted.intervals()[:, 1])
    assert inside.all()
    assert fitted.estimate[1] == pytest.approx(1.0, abs=0.1)  # they find the middle to 0.03; else 1.2 to 1.7


def test_what_the_data_leave_open_is_a_direction_of_the_ensemble(measured: Experiment) -> None:
    """Coordinates on an ellipse in space, whose long axis is (1, 2, 3), and its short one a tenth of it."""
    along, turn = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0), np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    across = np.cross(along, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(along, [1.0, 0.0, 0.0]))
    ellipse = np.outer(np.cos(turn), along) + 0.1 * np.outer(np.sin(turn), across)
    fitted = replace(clunk.fit(study_of(GAP), measured), coordinates=ellipse, weights=np.full(64, 1.0 / 64.0))
    widest, *_ = fitted.undetermined
    assert widest.spread == pytest.approx(np.sqrt(0.5))
    assert abs(np.dot(widest.direction, along)) == pytest.approx(1.0)


def test_the_nearest_measurement_predicts_what_lies_beside_it(measured: Experiment) -> None:
    fitted = clunk.fit(study_of(GAP), measured)
    alone, *_ = fitted.predictions
    labels = [each.label for each in measured.measurements]
    spans = np.ptp(fitted.points, axis=0)
    apart = (((fitted.points[:, None] - fitted.points) / spans) ** 2).sum(axis=2) + np.diag(np.full(len(labels), 9.0))
    assert alone["nearest"] == sum(labels[k] == labels[j] for k, j in enumerate(apart.argmin(axis=1)))
    assert 0 < alone["nearest"] < len(labels)


def test_a_measured_label_that_nobody_meets_is_missed_with_a_reason(measured: Experiment) -> None:
    first, *others = measured.measurements
    wrong = replace(measured, measurements=(replace(first, label="DS(9)"), *others))
    fitted = fitting.fit(study_of(GAP), wrong)
    assert [each.met_by_some for each in fitted.measured[:2]] == [False, True]
    assert fitted.met == len(measured.measurements) - 1
    assert fitted.intervals()[0, 0] <= TRUE_GAP <= fitted.intervals()[0, 1]
    assert "No factor that was tried on one measured value" in fitted.missed[0].reason


def test_values_in_another_unit_are_not_met_and_the_fit_says_so(measured: Experiment) -> None:
    """Times in s: all are met, and none of tenths of them."""
    priors = study_of(GAP, PRIOR.format("driveline.inertias[4]", "factor", 0.7, 1.6))
    fitted = clunk.fit(priors, measured)
    assert fitted.met_impacts == [{"quantity": "impact_time", "measured": 8, "met": 8}]
    assert not any("impact_time" in each for each in fitted.warnings)
    others = tuple(
        replace(each, impacts={"impact_time": {0: each.impacts["impact_time"][0] / 10}})
        for each in measured.measurements
    )
    wrong = clunk.fit(priors, replace(measured, measurements=others))
    assert wrong.met_impacts == [{"quantity": "impact_time", "measured": 8, "met": 0}]
    assert any("0 of 8 values of impact_time" in each and "in s?" in each for each in wrong.warnings)


@pytest.mark.parametrize(
    ("measured", "computed", "pairs"),
    [
        ("DS(1)SS(2)", "DS(2)SS(1)", {0: 0, 1: 1, 2: 3, 3: 4}),  # O I I I and O I O I I
        ("DS(1)SS(1)", "DS(2)SS(1)", {0: 0, 1: 1, 2: 3}),
        ("DS(1)SS(3)", "DS(3)SS(3)", {0: 0, 1: 1, 2: 3, 3: 5, 4: 6}),
        ("DS(2)", "SS(2)", {1: 0, 3: 1}),
    ],
)
def test_impacts_go_together_in_order_as_many_as_can_and_the_earliest(
    measured: str, computed: str, pairs: dict
) -> None:
    assert fitting.partners(flanks_of_label(measured), flanks_of_label(computed)) == pairs


def test_times_are_met_where_a_label_has_a_crossing_less() -> None:
    """The first two impacts of runs of DS(2)SS(1), whose labels were written down as DS(1)SS(2)."""
    gap = PRIOR.format("lash.backlash_deg", "factor", 0.999, 1.001)
    ratios = [7.75, 8.25]
    runs = run_points(study_from_text(RIG), {"load.ratio": ratios, "lash.backlash_deg": [3.0, 3.0]})
    assert runs.label_map.tolist() == ["DS(2)SS(1)"] * 2
    lines = ["load_ratio,lash_backlash_deg,label,impact_time_1,impact_time_2,impact_time_std"]
    for ratio, first in zip(ratios, runs.first_impact, strict=False):
        times = runs.impact_time[first : first + 2]
        lines.append(f"{ratio},3,DS(1)SS(2),{times[0]},{times[1]},0.001")
    fitted = clunk.fit(study_of(gap), experiment_of("\n".join(lines), "rig.csv"))
    assert fitted.met == 0
    assert fitted.met_impacts == [{"quantity": "impact_time", "measured": 4, "met": 4}]


def test_a_fit_does_not_change_the_digest_of_a_sweep() -> None:
    assert digest(study_of(GAP)) == digest(study_from_text(RIG))


HEADER = "load_ratio,lash_backlash_deg,label"
CSV = HEADER + "\n2,3,SS(1)\n5,6,DS(1)SS(1)\n"
SPEED = HEADER + ",impact_closing_speed_{0},impact_closing_speed_std\n2,3,SS(1),1,{1}\n5,6,SS(1),,\n"
TIMES = HEADER + ",impact_time_1,impact_time_2,impact_time_std\n2,3,SS(1),{},,1\n5,6,DS(1)SS(1),{},{},1\n"
SEVERITY = HEADER + ",impact_severity_1,impact_severity_std\n2,3,SS(1),1,1\n5,6,SS(1),1,1\n"


@pytest.mark.parametrize(
    ("config", "csv", "words"),
    [
        ("", CSV, "nothing to fit: the config has no [[fit.parameters]]"),
        (GAP, CSV.replace("SS(1)\n5", "CR(2)\n5"), "line 2: no sequence of impacts has the label CR(2)"),
        (GAP, HEADER + "\n2,3,SS(1)\n", "has one measurement"),
        (GAP, SPEED.format(2, 1), "impact_closing_speed_2 is given, and SS(1) has 1 primary impact"),
        (GAP, TIMES.format(0.1, 0.2, 0.1), "line 3: of two impacts the later one has the smaller impact_time"),
        (GAP, TIMES.format(119, 0.1, 0.2), "line 2: an impact_time is greater than solver.end_time, 1 s"),
        (GAP, SPEED.format(1, ""), "without its standard deviation"),
        (GAP, CSV.replace("load_ratio", "load_initial_torque"), "the load is given by"),
        (GAP, CSV.replace("load_ratio", "load_ratoi"), "did you mean load_ratio?"),
        (GAP.replace("factor", "value"), CSV, "must act on the measured values"),
        (
            PRIOR.format("lash.backlash_deg", "offset", -4.0, 4.0),
            CSV,
            "line 2: lash.backlash_deg is -1, as measured or at an end of its prior",
        ),
        (
            PRIOR.format("driveline.inertias[4]", "factor", -1.0, 1.0),
            CSV,
            "it allows driveline.inertias[4] = -0.002:",
        ),
        (PRIOR.format("driveline.inertia", "factor", 0.5, 1.0), CSV, "has no number"),
        (PRIOR.format("load.on", "factor", 0.5, 1.0), CSV, "cannot be drawn"),
        (PRIOR.format("impacts.sticking_time", "value", 0.001, 0.01), CSV, "needs a value in this config"),
        (GAP, CSV.replace("load_ratio", "load_on"), "load.on is an inertia's number"),
        (GAP + GAP, CSV, "fitted by fit.parameters[1] already"),
        ('[lash.contact]\nmodel = "restitution"\n' + GAP, SEVERITY, "not defined for the restitution model"),
    ],
)
def test_what_cannot_be_fitted_is_refused_at_once(config: str, csv: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(RIG + config)
    (tmp_path / "rig.csv").write_text(csv)
    ran = CliRunner().invoke(cli, ["fit", str(tmp_path / "rig.toml"), str(tmp_path / "rig.csv")])
    assert ran.exit_code == 1
    assert isinstance(ran.exception, ConfigError | ClunkError)
    assert words in " ".join(str(ran.exception).split())


def test_a_fit_is_printed_drawn_and_written(tmp_path: Path) -> None:
    names = ["lash.contact.damping", "driveline.shafts[3].damping"]
    fit = "[fit]\ncandidates = 1\ndraws = 64\neffective_draws = 1\n"
    priors = "".join(PRIOR.format(name, "factor", 0.9, 1.1) for name in names)
    (tmp_path / "rig.toml").write_text(RIG + fit + GAP + priors)
    (tmp_path / "rig.csv").write_text(CSV)
    command = ["fit", str(tmp_path / "rig.toml"), str(tmp_path / "rig.csv")]
    more = ["--plot", str(tmp_path / "fit.png"), "--write", str(tmp_path / "fitted.toml")]
    first, second = (CliRunner().invoke(cli, command + options) for options in (more, []))
    assert first.exit_code == second.exit_code == 0
    assert "more parameters, 3, than measurements, 2" in " ".join(first.output.split())
    assert first.stdout == second.stdout
    assert [path.name for path in tmp_path.glob("*.png")] == ["fit.png"]
    assert load_study(tmp_path / "fitted.toml").lash.contact.damping != 94.0


AXES = '[[sweep.axes]]\nparameter = "{}"\nvalues = {}\n'


def test_the_fitted_config_has_the_labels_of_the_best_candidate_where_they_were_measured(measured: Experiment) -> None:
    ratios, gaps = (sorted({each.values[k] for each in measured.measurements}) for k in (0, 1))
    axes = AXES.format("load.ratio", ratios) + AXES.format("lash.backlash_deg", gaps)
    damping = PRIOR.format("lash.contact.damping", "factor", 0.8, 1.2)
    fitted = fitting.fit(study_from_text(RIG + axes + SMALL + GAP + damping), measured)
    study = fitted_study(fitted)
    assert study.fit is None
    assert study.sweep.axes[1].values == pytest.approx(fitted.estimate[0] * np.array(gaps))
    computed = [fitted.labels[code] for code in fitted.estimate_matches["label"]]
    assert sweep(study).label_map.T.ravel().tolist() == computed  # measured with the load ratio first


def test_an_offset_moves_each_value_of_a_logarithmic_axis(measured: Experiment) -> None:
    axis = '[[sweep.axes]]\nparameter = "lash.backlash_deg"\nstart = 1.0\nstop = 100.0\ncount = 3\nscale = "log"\n'
    offset = PRIOR.format("lash.backlash_deg", "offset", 1.9, 2.1)
    fitted = fitting.fit(study_from_text(RIG + axis + SMALL + offset), measured)
    moved = fitted_study(fitted).sweep.axes[0].grid
    assert moved == pytest.approx(np.array([1.0, 10.0, 100.0]) + fitted.estimate[0])


def test_an_offset_below_zero_is_refused_on_an_axis_and_the_maps_end_before_it(tmp_path: Path) -> None:
    (tmp_path / "rig.csv").write_text(CSV)
    offset = PRIOR.format("lash.backlash_deg", "offset", -2.9, -2.8)
    fitted = clunk.fit(
        study_from_text(RIG + AXES.format("lash.backlash_deg", [0.0, 6.0]) + SMALL + offset), tmp_path / "rig.csv"
    )
    with pytest.raises(ConfigError, match=r"lash\.backlash_deg: found -2\.8"):
        fitted_study(fitted)
    assert clunk.draw(fitted).axes[0].get_ylim()[0] == 3.0


def test_the_same_seed_gives_the_same_fit_which_is_drawn_on_two_maps(tmp_path: Path) -> None:
    (tmp_path / "rig.csv").write_text(CSV)
    first, again = (clunk.fit(study_of(GAP), tmp_path / "rig.csv") for _ in range(2))
    assert np.array_equal(again.matches, first.matches)
    assert f"met by the best candidate   {first.met}" in repr(again)
    nominal, fitted, *_ = clunk.draw(first).axes
    assert f"nominal: {first.met_by_config} of 2 labels" in nominal.get_title("left")
    assert f"fitted: {first.met} of 2 labels" in fitted.get_title("left")
