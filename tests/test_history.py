"""A history is the run itself between its events: the physics holds in every row, and files read back equal."""

import functools
from pathlib import Path

import numpy as np
import pytest
from helpers.reference import Plant
from helpers.studies import random_study

from clunk.plot import PlotError, histories
from clunk.plot.histories import small_gap
from clunk.results.export import save_history
from clunk.simulation.history import sample, shown_until
from clunk.simulation.small_gap import SmallGap
from clunk.simulation.trajectory import simulate
from clunk.study.config import load_study, study_from_text
from clunk.study.errors import ClunkError
from clunk.study.study import Study

PRESET = '[driveline]\npreset = "boere-2008"\n'
CONFIGS = Path(__file__).parents[1] / "configs"
MODELS = ("gap", "force", "restitution")
INERTIA = np.array([0.024, 0.002, 0.002, 0.002])
RADIUS, HALF_GAP = 0.08, np.deg2rad(6.0) / 2
CONTACT_STIFFNESS, CONTACT_DAMPING = RADIUS**2 * 4.092e5, RADIUS**2 * 94.0


def small_gap_of(study: Study):
    return small_gap(study.title, SmallGap.of(study))


def nominal(model: str = "gap", *overrides: str) -> Study:
    """The report's nominal case with one of the contact models."""
    study = study_from_text(PRESET, overrides=overrides)
    contact = study.lash.contact.model_copy(
        update={"model": "restitution"} if model == "restitution" else {"separation": model}
    )
    return study.model_copy(update={"lash": study.lash.model_copy(update={"contact": contact})})


@functools.cache
def run(model="gap", *overrides):
    return simulate(nominal(model, *overrides))


@functools.cache
def history(model="gap", *overrides, **options):
    return sample(run(model, *overrides), **options)


def rows_of_events(history):
    """The rows that follow the events."""
    return np.flatnonzero(history.event >= 0)


# --- Sampling


def test_a_picture_of_short_steps_has_no_more_samples_than_it_can_show():
    study = nominal("gap", "solver.step=1e-6", "solver.end_time=0.5")
    assert 100_000 <= sample(simulate(study)).time.size < 101_000


@pytest.mark.parametrize("model", MODELS)
def test_rows_at_events_are_the_states_of_the_run(model):
    sampled, trajectory = history(model), run(model)
    rows = rows_of_events(sampled)
    np.testing.assert_array_equal(sampled.event[rows], np.arange(trajectory.events.size))
    np.testing.assert_array_equal(sampled.after_step[rows], trajectory.events["time"])
    np.testing.assert_array_equal(np.hstack([sampled.angle, sampled.velocity])[rows], trajectory.states)


@pytest.mark.parametrize("model", MODELS)
def test_every_event_is_seen_from_both_sides(model):
    sampled = history(model)
    rows = rows_of_events(sampled)
    np.testing.assert_array_equal(sampled.time[rows - 1], sampled.time[rows])
    assert np.all(np.diff(sampled.time) >= 0.0)
    # nothing else repeats a time, nor comes too near to one
    assert np.all(np.diff(np.delete(sampled.time, rows)) > 1e-7 * 1e-4)


@pytest.mark.parametrize("model", ["gap", "force"])
def test_acceleration_balances_the_torques(model):
    sampled = history(model)
    q = sampled.angle[:, 2] - sampled.angle[:, 3]
    rate = sampled.velocity[:, 2] - sampled.velocity[:, 3]
    side = -run(model).initial_side * sampled.contacts[:, 0].astype(float)
    across = np.where(side == 0.0, 0.0, CONTACT_STIFFNESS * (q - side * HALF_GAP) + CONTACT_DAMPING * rate)
    damping, stiffness = Plant().open_matrices()
    torque = -sampled.velocity @ damping.T - sampled.angle @ stiffness.T
    torque += sampled.torque[:, None] * [1.0, 0.0, 0.0, 0.0] - across[:, None] * [0.0, 0.0, 1.0, -1.0]
    np.testing.assert_allclose(sampled.acceleration * INERTIA, torque, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("model", ["gap", "force"])
def test_peak_to_peak_of_the_history_is_the_severity(model):
    sampled, trajectory = history(model, step=2e-5, until=1.0), run(model)
    rows = rows_of_events(sampled)
    limits = [*rows[trajectory.primaries], sampled.time.size]
    for k, severity in enumerate(trajectory.impact_severity):
        window = sampled.acceleration[limits[k] : limits[k + 1], 2]
        assert np.ptp(window) == pytest.approx(severity, rel=1e-3)
        assert np.ptp(window) <= severity * (1.0 + 1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_before_the_load_step_everything_rests_on_the_initial_flank(model):
    sampled = history(model)
    before = slice(0, rows_of_events(sampled)[0])
    assert sampled.time[0] == 0.0
    assert sampled.time[before][-1] == pytest.approx(0.1)
    assert sampled.time[before].size == 1001
    for quantity in (sampled.velocity, sampled.acceleration):
        assert not quantity[before].any()
    assert np.all(sampled.torque[before] == -6.0)
    assert np.all(sampled.contacts[before, 0] == -1)
    np.testing.assert_array_equal(sampled.angle[before], np.tile(run(model).states[0, :4], (1001, 1)))
    np.testing.assert_allclose(31.3 * sampled.angle[before, 3], -6.0, rtol=1e-12)  # k4 carries the load
    indentation = 0.0 if model == "restitution" else 6.0 / CONTACT_STIFFNESS
    np.testing.assert_allclose(sampled.backlash_coordinate[before], -RADIUS * (HALF_GAP + indentation), rtol=1e-12)


@pytest.mark.parametrize("overrides", [(), ("load.step_time=0",)])
def test_load_step_is_seen_from_both_sides(overrides):
    sampled = history("gap", *overrides)
    at = rows_of_events(sampled)[0]
    assert sampled.torque[at - 1 : at + 1].tolist() == [-6.0, -1.0]
    assert sampled.acceleration[at, 0] == pytest.approx(5.0 / 0.024)  # the torque that goes is no longer balanced
    assert np.all(sampled.torque[at:] == -1.0)


def test_complete_run_goes_on_to_rest():
    trajectory = run()
    assert trajectory.complete
    assert trajectory.end < 2.0
    sampled = sample(trajectory, until=8.0, step=1e-3)
    assert sampled.time[-1] == pytest.approx(8.0)
    np.testing.assert_allclose(sampled.velocity[-1], 0.0, atol=1e-6)
    assert sampled.angle[-1, 3] == pytest.approx(-1.0 / 31.3, rel=1e-6)


def test_a_run_that_may_go_on_is_not_sampled_beyond_its_end():
    trajectory = run("gap", "load.ratio=7.0", "solver.end_time=0.04")
    assert not trajectory.complete
    assert sample(trajectory, until=0.5).time[-1] == pytest.approx(0.1 + 0.04)


@pytest.mark.parametrize("options", [{"until": 0.0}, {"until": 0.1}, {"step": 0.0}, {"step": -1e-3}])
def test_no_samples_are_refused_in_one_sentence(options):
    with pytest.raises(ClunkError, match=r"^A run cannot be sampled until .*, 0\.1 s, and step greater than 0\.$"):
        sample(run(), **options)


def test_too_many_samples_are_refused_in_one_sentence():
    with pytest.raises(ClunkError, match=r"10,000,000 is the limit.*\.$"):
        sample(run(), step=1e-8)


# --- Files


@pytest.mark.parametrize("model", ["gap", "restitution"])
def test_csv_reads_back_equal(tmp_path, model):
    sampled, trajectory = history(model), run(model)
    path = tmp_path / "new" / "history.csv"
    save_history(path, sampled)
    table = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    np.testing.assert_array_equal(table["time_s"], sampled.time)
    np.testing.assert_array_equal(table["after_step_s"], sampled.after_step)
    for k in range(4):
        np.testing.assert_array_equal(table[f"theta_{k + 1}_rad"], sampled.angle[:, k])
        np.testing.assert_array_equal(table[f"theta_dot_{k + 1}_rad_per_s"], sampled.velocity[:, k])
        np.testing.assert_array_equal(table[f"theta_ddot_{k + 1}_rad_per_s2"], sampled.acceleration[:, k])
    np.testing.assert_array_equal(table["torque_Nm"], sampled.torque)
    np.testing.assert_array_equal(table["backlash_coordinate_m"], sampled.backlash_coordinate)
    np.testing.assert_array_equal(table["contact"], sampled.contacts[:, 0])
    named = np.flatnonzero(table["event"] != "")
    np.testing.assert_array_equal(named, rows_of_events(sampled))
    primary = named[table["event"][named] == "primary touch"]
    np.testing.assert_array_equal(table["after_step_s"][primary], trajectory.events["time"][trajectory.primaries])
    assert table["flank"][primary].tolist() == ["opposite", "initial", "initial"]
    assert table["event"][named[0]] == "load step"
    assert [file.name for file in path.parent.iterdir()] == ["history.csv"]


# --- Figures


def recording(label, model="gap", *overrides):
    return history(model, *overrides, until=1.0, name=label)


def marks(figure, gid):
    return [line for ax in figure.axes for line in ax.lines if line.get_gid() == gid]


def test_backlash_panels_are_those_of_figure_3_2():
    runs = [
        recording(label, model, f"load.ratio={ratio}")
        for ratio in (1, 2, 5)
        for label, model in (("IFM", "gap"), ("RCM", "restitution"))
    ]
    figure = histories.history_figure(runs, "backlash")
    assert len(figure.axes) == 3
    titles = [ax.get_title(loc="right") for ax in figure.axes]
    assert [title.split(": ")[1] for title in titles] == ["NI", "SS(1)", "DS(1)SS(1)"]
    for ax in figure.axes:
        assert ax.get_xlim() == (0.0, 1.0)
        np.testing.assert_allclose(ax.get_ylim(), (-5.0, 5.0), atol=0.1)  # mm
        gap = ax.patches[0].get_extents().transformed(ax.transData.inverted())
        np.testing.assert_allclose([gap.y0, gap.y1], [-1e3 * RADIUS * HALF_GAP, 1e3 * RADIUS * HALF_GAP], rtol=1e-9)
        curves = [line for line in ax.lines if len(line.get_xdata()) > 1000]
        assert [line.get_linestyle() for line in curves] == ["-", "--"]
    assert [text.get_text() for text in figure.legends[0].get_texts()][:2] == ["IFM", "RCM"]
    assert len(marks(figure, "primary")) == 2 * (0 + 1 + 3)


def test_each_of_eight_inertias_has_a_colour_of_its_own():
    shafts = ", ".join(f"{{between = [{k}, {k + 1}], stiffness = 300.0, damping = 0.3}}" for k in range(1, 7))
    study = study_from_text(
        f"""
        [driveline]
        inertias = [{", ".join(["0.1"] * 8)}]
        shafts = [{shafts}, {{between = [8, "ground"], stiffness = 30.0, damping = 0.3}}]
        [lash]
        between = [7, 8]
        backlash_deg = 3.0
        radius = 0.05
        contact = {{stiffness = 1e6, damping = 100.0}}
        [load]
        initial_torque = 20.0
        final_torque = -3.0
        """
    )
    figure = histories.history_figure([sample(simulate(study))])
    names = [text.get_text() for text in figure.axes[1].get_legend().get_texts()]
    colours = {line.get_color() for line in figure.axes[1].get_legend().get_lines()}
    assert len(names) == len(colours) == 8


def test_every_touch_is_marked_at_its_flank():
    trajectory = run()
    figure = histories.history_figure([recording("IFM")], "backlash")
    assert len(marks(figure, "primary")) == trajectory.primaries.size
    assert len(marks(figure, "secondary")) == trajectory.touches - trajectory.primaries.size
    assert {line.get_markerfacecolor() for line in marks(figure, "secondary")} == {"white"}
    assert "white" not in {line.get_markerfacecolor() for line in marks(figure, "primary")}
    expected = {1: "^", -1: "v"}
    for line, k in zip(marks(figure, "primary"), trajectory.primaries, strict=True):
        side = int(trajectory.events["side"][k])
        assert line.get_marker() == expected[side]
        assert line.get_xdata()[0] == pytest.approx(0.1 + trajectory.events["time"][k])
        assert line.get_ydata()[0] == pytest.approx(side * 1e3 * RADIUS * HALF_GAP)


def test_closeup_shows_the_first_impact_as_figure_3_3():
    (ax,) = histories.history_figure([recording("IFM"), recording("RCM", "restitution")], "closeup").axes
    np.testing.assert_allclose(ax.get_xlim(), (0.18, 0.28), atol=1e-12)
    np.testing.assert_allclose(ax.get_ylim(), (3.0, 4.8), atol=0.05)


def test_closeup_without_a_touch_says_so():
    with pytest.raises(PlotError, match="no primary impact happens"):
        histories.history_figure([recording("IFM", "gap", "load.ratio=1")], "closeup")


@pytest.mark.parametrize("overrides", [(), ("load.ratio=10", "lash.backlash_deg=1")])
def test_arrows_span_the_peak_to_peak_accelerations(overrides):
    trajectory = run("gap", *overrides)
    (ax,) = histories.history_figure([recording("IFM", "gap", *overrides)], "acceleration").axes
    arrows = [text for text in ax.texts if getattr(text, "arrow_patch", None) is not None]
    spans = [arrow.xyann[1] - arrow.xy[1] for arrow in arrows]
    np.testing.assert_allclose(spans, trajectory.impact_severity, rtol=1e-12)
    names = [text.get_text() for text in ax.texts if text.get_gid() == "severity"]
    assert [name.split(" = ")[0] for name in names] == [rf"Q$_\mathregular{{{i + 1}}}$" for i in range(len(spans))]


@pytest.mark.parametrize("model", ["gap", "restitution"])
def test_small_gap_response_swings_within_its_envelope(model):
    response = SmallGap.of(nominal(model))
    assert response.torque[0] == pytest.approx(-6.0)
    time = response.time - response.time[0]
    swing = 5.0 * np.exp(-response.decay * time)
    later = time > 0.1
    outside = np.abs(response.torque[later] - response.end) / swing[later]
    assert 0.99 < outside.max() < 1.1  # the other modes add little
    maxima = np.count_nonzero(np.diff(np.sign(response.torque)) > 0)
    assert maxima == 2 == round(response.periods)  # DS(2) as the backlash vanishes
    (ax,) = small_gap_of(nominal(model)).axes
    (crossing,) = [line for line in ax.lines if line.get_gid() == "tc"]
    assert crossing.get_xdata()[0] == pytest.approx(0.1 + np.log(5.0) / response.decay)


@pytest.mark.parametrize(("ratio", "crosses"), [(-5.0, True), (-0.5, False), (0.5, False)])
def test_the_envelope_of_a_torque_that_reverses_crosses_zero_where_the_ratio_is_beyond_one(ratio, crosses):
    study = nominal("gap", f"load.ratio={ratio}")
    response = SmallGap.of(study)
    (ax,) = small_gap_of(study).axes
    marked = [line.get_xdata()[0] for line in ax.lines if line.get_gid() == "tc"]
    assert len(marked) == crosses
    if crosses:
        swing = abs(response.start - response.end) * np.exp(-response.decay * (marked[0] - response.step_time))
        assert swing == pytest.approx(abs(response.end), rel=1e-12)


@pytest.mark.parametrize("name", ["rig_with_friction", 8103, 8112])
def test_where_friction_yields_at_a_touch_no_row_is_of_a_regime_that_lasts_no_time(name):
    """At an event there are the state just before and just after; accelerations are within the windows' extremes."""
    study = random_study(name) if isinstance(name, int) else load_study(CONFIGS / f"{name}.toml")
    trajectory = simulate(study.but(sweep=None))
    history = sample(trajectory)
    at_once = [np.count_nonzero(history.after_step == time) for time in np.unique(trajectory.events["time"])]
    assert max(at_once) == 2
    assert np.array_equal(history.event[history.event >= 0], np.arange(trajectory.events.size))
    for each in history.lashes:
        acceleration = each.acceleration[:, each.watched - 1]
        for impact in each.impacts:
            within = (history.time > impact.begin) & (history.time < impact.end)
            scale = 1e-9 * (abs(impact.largest) + abs(impact.smallest))
            assert acceleration[within].max(initial=-np.inf) <= impact.largest + scale
            assert acceleration[within].min(initial=np.inf) >= impact.smallest - scale
            first = acceleration[(history.time == impact.begin) & (history.event >= 0)]
            assert impact.smallest - scale <= first.min()
            assert first.max() <= impact.largest + scale


def test_a_run_without_events_or_oscillations_is_shown_to_its_end():
    """Of rigid flanks between parts without springs no mode is left that would take a time to fade."""
    of_rigid = '[lash.contact]\nmodel = "restitution"\nrestitution = 0.5\n'
    text = '[driveline]\ninertias = [0.02, 0.01]\n[[driveline.shafts]]\nbetween = [2, "ground"]\ndamping = 0.5\n'
    text += f"[lash]\nbetween = [1, 2]\nbacklash_deg = 6.0\nradius = 0.08\n{of_rigid}[load]\ninitial_torque = 6.0\n"
    run = simulate(study_from_text(text + "final_torque = 4.0\n[solver]\nend_time = 1.5\n"))
    assert run.label == "NI"
    assert shown_until(run) == run.study.load.step_time + 1.5
    assert sample(run, until=shown_until(run)).time[-1] == pytest.approx(1.5 + run.study.load.step_time)
