"""A history is the run itself between its events: the physics holds in every row, and files read back equal."""

import functools

import numpy as np
import pytest
from matplotlib.text import Text
from scipy.integrate import solve_ivp

from clunk.core.events import LOCK, TOUCH
from clunk.plot import PlotError, histories, save
from clunk.plot.histories import small_gap
from clunk.results.historyfile import save_csv
from clunk.simulation.history import sample, shown_until
from clunk.simulation.phases import balanced
from clunk.simulation.small_gap import SmallGap
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.errors import ClunkError
from clunk.study.study import Study

xarray = pytest.importorskip("xarray")

PRESET = '[driveline]\npreset = "boere-2008"\n'
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


def matrices(closed):
    """Damping and stiffness of report Eqs 2.5 and 2.12, written out."""
    k, c, d1 = (31.3, 31.3, 31.3), (0.08, 0.04, 0.1), 0.1
    k34, c34 = (CONTACT_STIFFNESS, CONTACT_DAMPING) if closed else (0.0, 0.0)

    def chain(a, b, on_three, ground):
        return np.array(
            [[a, -a, 0, 0], [-a, a + b, -b, 0], [0, -b, b + on_three, -on_three], [0, 0, -on_three, on_three + ground]]
        )

    damping = chain(c[0], c[1], c34, c[2])
    damping[0, 0] += d1
    return damping, chain(k[0], k[1], k34, k[2])


def equation_of_motion(contact):
    """Report Eqs 2.5 and 2.12 under T = -1 N m; `contact` is the sign of q on the flank in contact, 0 in the gap."""
    damping, stiffness = matrices(contact != 0)
    load = np.array([-1.0, 0.0, 0.0, 0.0])
    load += contact * CONTACT_STIFFNESS * HALF_GAP * np.array([0.0, 0.0, 1.0, -1.0])

    def rates(_, x):
        return np.concatenate([x[4:], (load - damping @ x[4:] - stiffness @ x[:4]) / INERTIA])

    return rates


# --- Sampling


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


@pytest.mark.parametrize("model", MODELS)
def test_backlash_coordinate_is_continuous(model):
    sampled = history(model)
    fastest = RADIUS * np.abs(sampled.velocity[:, 2] - sampled.velocity[:, 3]).max()
    rows = rows_of_events(sampled)
    assert np.all(np.abs(np.diff(sampled.backlash_coordinate)) <= 1.01 * fastest * 1e-4)
    np.testing.assert_allclose(
        sampled.backlash_coordinate[rows - 1], sampled.backlash_coordinate[rows], rtol=0.0, atol=1e-14
    )


def test_touches_and_separations_are_at_the_flanks():
    sampled, trajectory = history(), run()
    rows = rows_of_events(sampled)[1:]
    flank = RADIUS * HALF_GAP * trajectory.events["side"][1:]
    np.testing.assert_allclose(sampled.backlash_coordinate[rows], flank, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("phase", [0, 1, 2, 3])
def test_phase_solves_the_equation_of_motion(phase):
    sampled = history()
    rows = rows_of_events(sampled)
    between = slice(rows[phase], rows[phase + 1])
    contact = sampled.contact[rows[phase]] * -run().initial_side
    assert contact == (-1, 0, 1, 0)[phase]
    x = np.hstack([sampled.angle, sampled.velocity])[between]
    time = sampled.after_step[between]
    solved = solve_ivp(
        equation_of_motion(contact), time[[0, -1]], x[0], t_eval=time, method="DOP853", rtol=1e-12, atol=1e-14
    ).y.T
    np.testing.assert_allclose(x[:-1], solved[:-1], rtol=0.0, atol=1e-9)
    # The last row is where the run's RK4 located the event. Its error in the contact mode is (ω h)^5/120 ≈ 1e-6 a step,
    # for some 20 steps of contact at up to 8 rad/s.
    np.testing.assert_allclose(x[-1], solved[-1], rtol=0.0, atol=2e-4)


@pytest.mark.parametrize("model", ["gap", "force"])
def test_acceleration_balances_the_torques(model):
    sampled = history(model)
    q = sampled.angle[:, 2] - sampled.angle[:, 3]
    rate = sampled.velocity[:, 2] - sampled.velocity[:, 3]
    side = -run(model).initial_side * sampled.contact.astype(float)
    across = np.where(side == 0.0, 0.0, CONTACT_STIFFNESS * (q - side * HALF_GAP) + CONTACT_DAMPING * rate)
    damping, stiffness = matrices(closed=False)
    torque = -sampled.velocity @ damping.T - sampled.angle @ stiffness.T
    torque += sampled.torque[:, None] * [1.0, 0.0, 0.0, 0.0] - across[:, None] * [0.0, 0.0, 1.0, -1.0]
    np.testing.assert_allclose(sampled.acceleration * INERTIA, torque, rtol=0.0, atol=1e-10)


def test_run_loses_the_energy_that_its_dampers_take():
    sampled = history(step=1e-5, until=0.5)
    damping, stiffness = matrices(closed=False)
    rate = sampled.velocity[:, 2] - sampled.velocity[:, 3]
    indentation = np.maximum(np.abs(sampled.backlash_coordinate) / RADIUS - HALF_GAP, 0.0)
    stored = 0.5 * np.sum(sampled.angle @ stiffness * sampled.angle, axis=1) + 0.5 * CONTACT_STIFFNESS * indentation**2
    energy = 0.5 * sampled.velocity**2 @ INERTIA + stored
    power = sampled.torque * sampled.velocity[:, 0] - np.sum(sampled.velocity @ damping * sampled.velocity, axis=1)
    power -= CONTACT_DAMPING * rate**2 * (sampled.contact != 0)
    work = np.concatenate([[0.0], np.cumsum(np.diff(sampled.time) * (power[1:] + power[:-1]) / 2)])
    # the trapezoidal rule at 1e-5 s is good to 1e-5 of the first energy where contact is made
    np.testing.assert_allclose(energy, energy[0] + work, rtol=0.0, atol=1e-5 * energy[0])


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
    assert np.all(sampled.contact[before] == -1)
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


def test_touches_reverse_the_relative_velocity_by_the_coefficient_of_restitution():
    sampled, trajectory = history("restitution"), run("restitution")
    rows = rows_of_events(sampled)
    kinds = trajectory.events["kind"]
    rebounds = [k for k in np.flatnonzero(kinds == TOUCH) if kinds[min(k + 1, kinds.size - 1)] != LOCK]
    assert len(rebounds) > 10
    relative = sampled.velocity[:, 2] - sampled.velocity[:, 3]
    momentum = sampled.velocity[:, 2] + sampled.velocity[:, 3]  # of equal inertias
    after, before = rows[rebounds], rows[rebounds] - 1
    np.testing.assert_allclose(relative[after], -0.5 * relative[before], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(relative[before], trajectory.events["speed"][rebounds], rtol=1e-12)
    np.testing.assert_allclose(momentum[after], momentum[before], rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(sampled.velocity[after][:, :2], sampled.velocity[before][:, :2])


def test_locked_flanks_stay_together():
    sampled = history("restitution")
    locked = sampled.contact != 0
    assert 0.5 < np.mean(locked) < 1.0
    relative = sampled.velocity[:, 2] - sampled.velocity[:, 3]
    np.testing.assert_allclose(relative[locked], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.abs(sampled.backlash_coordinate[locked]), RADIUS * HALF_GAP, rtol=1e-9)


@pytest.mark.parametrize("step", [1e-4, 7.3e-4, 0.05])
def test_samples_are_multiples_of_the_step_from_the_load_step(step):
    sampled = sample(run(), step=step)
    rows = rows_of_events(sampled)
    between = np.delete(sampled.after_step, np.concatenate([rows, rows - 1]))
    multiples = np.rint(between[1:-1] / step)
    np.testing.assert_allclose(between[1:-1], multiples * step, rtol=0.0, atol=1e-12)
    missed = np.setdiff1d(np.arange(-np.floor(0.1 / step) + 1, np.ceil(2.0 / step)), multiples)
    np.testing.assert_allclose(np.isin(missed, [0.0]), True)  # an event took its place


def test_coarse_and_fine_samples_agree():
    fine, coarse = sample(run(), step=2e-5, until=1.0), sample(run(), step=1e-3, until=1.0)
    common = np.isin(np.rint(fine.after_step * 1e5), np.rint(coarse.after_step * 1e5)) & (fine.event < 0)
    at = np.searchsorted(coarse.after_step, fine.after_step[common] - 1e-9)
    near = np.abs(coarse.after_step[at] - fine.after_step[common]) < 1e-12
    assert np.count_nonzero(near) > 900
    np.testing.assert_allclose(coarse.angle[at][near], fine.angle[common][near], rtol=0.0, atol=1e-12)


def test_complete_run_goes_on_to_rest():
    trajectory = run()
    assert trajectory.complete
    assert trajectory.end < 2.0
    sampled = sample(trajectory, until=8.0, step=1e-3)
    assert sampled.time[-1] == pytest.approx(8.0)
    np.testing.assert_allclose(sampled.velocity[-1], 0.0, atol=1e-6)
    assert sampled.angle[-1, 3] == pytest.approx(-1.0 / 31.3, rel=1e-6)


def test_history_may_end_before_the_load_step():
    sampled = sample(run(), until=0.05)
    assert sampled.time[-1] == pytest.approx(0.05)
    assert not rows_of_events(sampled).size
    assert np.all(sampled.torque == -6.0)


def test_run_from_an_initial_state_has_nothing_before_its_load_step():
    trajectory = simulate(nominal(), initial_state=[0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 1.0, 0.0])
    sampled = sample(trajectory)
    assert sampled.after_step[0] == 0.0
    assert sampled.time[0] == 0.1
    assert sampled.velocity[0].tolist() == [0.0, 0.0, 1.0, 0.0]
    assert np.all(sampled.torque == -1.0)
    with pytest.raises(ClunkError, match="initial state has nothing before"):
        sample(trajectory, before=0.1)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"step": 0.0}, "step must be a positive number of seconds, not 0"),
        ({"step": -1e-4}, "step must be a positive number"),
        ({"step": float("nan")}, "step must be a positive number"),
        ({"until": -0.5}, "starts at 0 s cannot end at -0.5 s"),
        ({"until": float("inf")}, "cannot end at inf"),
        ({"before": -1.0}, "before the load step must be a number of seconds >= 0"),
        ({"step": 1e-8}, "10,000,000 is the limit"),
    ],
)
def test_impossible_samples_are_refused_in_one_sentence(options, sentence):
    with pytest.raises(ClunkError, match=sentence) as error:
        sample(run(), **options)
    assert str(error.value).endswith(".")


def test_run_that_may_go_on_is_not_sampled_beyond_its_end():
    trajectory = run("gap", "solver.end_time=0.3")
    assert not trajectory.complete
    assert sample(trajectory).time[-1] == pytest.approx(0.4)
    with pytest.raises(ClunkError, match=r"ends at 0.4 s and more may follow; to go on until 1 s, raise solver.end_t"):
        sample(trajectory, until=1.0)


def test_picture_ends_after_the_last_event_and_within_the_run():
    assert shown_until(run()) == pytest.approx(1.0)  # as in Figure 3.1
    assert shown_until(run("gap", "load.ratio=1")) == pytest.approx(1.0)
    assert shown_until(run("gap", "solver.end_time=0.3")) == pytest.approx(0.4)


# --- Files


@pytest.mark.parametrize("model", ["gap", "restitution"])
def test_csv_reads_back_equal(tmp_path, model):
    sampled, trajectory = history(model), run(model)
    path = tmp_path / "new" / "history.csv"
    save_csv(path, sampled)
    table = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    np.testing.assert_array_equal(table["time_s"], sampled.time)
    np.testing.assert_array_equal(table["after_step_s"], sampled.after_step)
    for k in range(4):
        np.testing.assert_array_equal(table[f"theta_{k + 1}_rad"], sampled.angle[:, k])
        np.testing.assert_array_equal(table[f"theta_dot_{k + 1}_rad_per_s"], sampled.velocity[:, k])
        np.testing.assert_array_equal(table[f"theta_ddot_{k + 1}_rad_per_s2"], sampled.acceleration[:, k])
    np.testing.assert_array_equal(table["torque_Nm"], sampled.torque)
    np.testing.assert_array_equal(table["backlash_coordinate_m"], sampled.backlash_coordinate)
    np.testing.assert_array_equal(table["contact"], sampled.contact)
    named = np.flatnonzero(table["event"] != "")
    np.testing.assert_array_equal(named, rows_of_events(sampled))
    primary = named[table["event"][named] == "primary touch"]
    np.testing.assert_array_equal(table["after_step_s"][primary], trajectory.events["time"][trajectory.primaries])
    assert table["flank"][primary].tolist() == ["opposite", "initial", "initial"]
    assert table["event"][named[0]] == "load step"
    assert [file.name for file in path.parent.iterdir()] == ["history.csv"]


def test_unwritable_path_is_an_error_in_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ClunkError, match="cannot be written: "):
        save_csv(tmp_path / "file" / "history.csv", history())
    (tmp_path / "directory").mkdir()
    with pytest.raises(ClunkError, match="cannot be written: "):
        save_csv(tmp_path / "directory", history())
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["directory", "file"]


# --- Figures


def recording(label, model="gap", *overrides):
    return history(model, *overrides, until=1.0, name=label)


def marks(figure, gid):
    return [line for ax in figure.axes for line in ax.lines if line.get_gid() == gid]


def test_backlash_panels_are_those_of_figure_3_2():
    runs = [
        recording(f"load.ratio={ratio}, {label}", model, f"load.ratio={ratio}")
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
    (ax,) = histories.closeup([recording("IFM"), recording("RCM", "restitution")]).axes
    np.testing.assert_allclose(ax.get_xlim(), (0.18, 0.28), atol=1e-12)
    np.testing.assert_allclose(ax.get_ylim(), (3.0, 4.8), atol=0.05)


def test_closeup_of_the_initial_flank_is_around_it():
    (ax,) = histories.closeup([recording("IFM")], around=0.361, width=0.05).axes
    assert -4.8 < ax.get_ylim()[0] < -1e3 * RADIUS * HALF_GAP < ax.get_ylim()[1] < -3.0


def test_closeup_without_a_touch_says_so():
    with pytest.raises(PlotError, match="no primary impact happens"):
        histories.closeup([recording("IFM", "gap", "load.ratio=1")])
    with pytest.raises(PlotError, match=r"no touch to look at closely between 0.86 s and 0.96 s"):
        histories.closeup([recording("IFM")], around=0.9)
    with pytest.raises(PlotError, match="no touch to look at closely"):  # it was not sampled for so long
        histories.closeup([sample(run(), until=0.15)])
    with pytest.raises(PlotError, match="wider than 0 s"):
        histories.closeup([recording("IFM")], width=0.0)


@pytest.mark.parametrize("overrides", [(), ("load.ratio=10", "lash.backlash_deg=1")])
def test_arrows_span_the_peak_to_peak_accelerations(overrides):
    trajectory = run("gap", *overrides)
    (ax,) = histories.history_figure([recording("IFM", "gap", *overrides)], "acceleration").axes
    arrows = [text for text in ax.texts if getattr(text, "arrow_patch", None) is not None]
    spans = [arrow.xyann[1] - arrow.xy[1] for arrow in arrows]
    np.testing.assert_allclose(spans, trajectory.impact_severity, rtol=1e-12)
    names = [text.get_text() for text in ax.texts if text.get_gid() == "severity"]
    assert names == [rf"Q$_\mathregular{{{i + 1}}}$" for i in range(trajectory.primaries.size)]


def test_restitution_model_is_given_no_severity():
    figure = histories.history_figure([recording("RCM", "restitution")])
    texts = [text.get_text() for text in figure.findobj(Text)]
    assert any("Q is not defined" in text for text in texts)
    assert not any(text.startswith("Q$") for text in texts)


def test_several_runs_are_explained_once():
    runs = [recording("five"), recording("ten $10", "gap", "load.ratio=10", "lash.backlash_deg=10")]
    figure = histories.history_figure(runs)
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert texts[0].startswith("five: DS(1)SS(1), Q = 9300")
    assert texts[1].startswith(r"ten \$10: DS(2)SS(1), Q = ")
    assert len(figure.axes) == 4


@pytest.mark.parametrize(
    ("profile", "ticks"),
    [
        ("ramp", [-6.0, -1.0]),
        ("smooth", [-6.0, -1.0]),
        ("lag", [-6.0, -1.0]),
        ("pulse", [-6.0, -1.0]),
        ("sine", None),
    ],
)
def test_the_torque_is_drawn_above_with_ticks_where_it_begins_and_ends(profile, ticks):
    numbers = "duration=0.2", "time_constant=0.05", "amplitude=2.0", "frequency=8.0"
    run = recording(profile, "gap", f"load.profile='{profile}'", *(f"load.{number}" for number in numbers))
    ax = histories.history_figure([run]).axes[0]
    assert ax.get_ylabel().startswith("Torque")
    drawn = ax.lines[-1].get_ydata()
    np.testing.assert_array_equal(drawn, run.torque)
    assert ticks is None or ax.get_yticks().tolist() == ticks
    low, high = ax.get_ylim()
    assert low < drawn.min()
    assert drawn.max() < high


def test_a_pulse_is_named_there_and_back():
    study = study_from_text(
        '[driveline]\npreset = "boere-2008"\n[load]\nprofile = "pulse"\nduration = 0.2\n'
        "initial_torque = -6.0\nfinal_torque = -1.0\n"
    )
    (ax, _) = histories.history_figure([sample(simulate(study))], "speeds").axes
    assert "T = −6 → −1 → −6 N m, d = 0.2 s" in ax.get_title(loc="left")


@pytest.mark.parametrize("ratio", [1.463, 3.129, 6.693, 14.317])
def test_envelope_ends_half_a_period_off_at_the_thresholds_of_table_3_1(ratio):
    response = SmallGap.of(nominal("gap", f"load.ratio={ratio}"))
    assert response.periods % 1.0 == pytest.approx(0.5, abs=1e-3)
    assert response.characteristic_time * response.frequency == pytest.approx(response.periods)


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


def test_small_gap_without_a_crossing_says_so():
    (ax,) = small_gap_of(nominal("gap", "load.ratio=0.8")).axes
    assert "never crosses zero" in ax.get_title(loc="left")


def test_pictures_are_written(tmp_path):
    save(histories.history_figure([recording("IFM")], "angles"), tmp_path / "angles.svg")
    assert (tmp_path / "angles.svg").stat().st_size > 5000


def test_text_is_large_enough_to_read():
    for figure in (
        histories.history_figure([recording("IFM")]),
        histories.closeup([recording("IFM")]),
        small_gap_of(nominal()),
    ):
        figure.draw_without_rendering()
        assert min(text.get_fontsize() for text in figure.findobj(Text) if text.get_text()) >= 8.0


def test_no_run_is_an_error():
    with pytest.raises(PlotError, match="no run to draw"):
        histories.history_figure([], "angles")


def test_units_beyond_integers_are_balanced_without_a_warning():
    matrix = np.array([[0.0, 1e60], [1e-60, 0.0]])
    scaled, unit, _ = balanced(matrix)
    assert unit.max() > 2.0**63
    assert np.abs(scaled).max() < 10.0
