"""The Restitution Coefficient Model against the report, against its own laws, and against a bouncing ball."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import BOERE, axis
from helpers import reference
from helpers.agreement import exact
from helpers.reference import Plant
from helpers.studies import random_study

from clunk.core.events import LOCK, SEPARATION, TOUCH
from clunk.simulation import driveline
from clunk.simulation.energy import balance
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.errors import ClunkError
from clunk.study.study import replace_values
from clunk.sweeping.sweep import sweep

NOMINAL = BOERE + '[lash.contact]\nmodel = "restitution"\n'
MAP = axis("load.ratio", 0.0, 10.0, 41) + axis("lash.backlash_deg", 0.0, 20.0, 41)
# Every inertia, shaft and end of a lash that a restitution impact may meet.
DRIVELINES = {
    "between the last two": Plant(),
    "between the first two": Plant(
        shafts=((2, 3, 31.3, 0.04), (3, 4, 31.3, 0.08), (4, "ground", 31.3, 0.1)), lash=(1, 2)
    ),
    "to ground": Plant(shafts=((1, 2, 31.3, 0.08), (2, 3, 31.3, 0.04), (3, 4, 31.3, 0.1)), lash=(4, "ground")),
}
GEARED = """
[driveline]
inertias = [0.017, 0.0043, 0.004, 0.0117]
shafts = [
    { between = [1, 2], stiffness = 236.0, damping = 0.03 },
    { between = [3, 4], stiffness = 26.6, damping = 0.11 },
    { between = [4, "ground"], stiffness = 11.0, damping = 0.1 },
]
[lash]
between = [2, 3]
backlash_deg = 0.0
radius = 0.05
ratio = -3.14
contact = { model = "restitution", restitution = 0.5 }
[load]
profile = "ramp"
on = 1
initial_torque = -5.2
final_torque = -1.6
duration = 0.1
[solver]
end_time = 0.5
"""


def nominal(**values):
    return replace_values(study_from_text(NOMINAL), {key.replace("__", "."): value for key, value in values.items()})


def lash_row(study):
    n = len(study.driveline.inertias)
    row = np.zeros(n)
    for end, sign in zip(study.lash.between, (1.0, -1.0), strict=True):
        if end != "ground":
            row[end - 1] = sign
    return row


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_rigid_flanks_need_no_stiffness_and_are_locked_where_they_stay_closed(method):
    with_stiffness = study_from_text(NOMINAL, overrides=[f"solver.method={method}"])
    contact = with_stiffness.lash.contact.model_copy(update={"stiffness": None, "damping": None})
    lash = with_stiffness.lash.model_copy(update={"contact": contact})
    rigid = with_stiffness.model_copy(update={"lash": lash})
    assert simulate(rigid).events.tobytes() == simulate(with_stiffness).events.tobytes()
    modes = driveline.Driveline.from_study(rigid).modes(closed=True)
    stiff = driveline.Driveline.from_study(replace_values(with_stiffness, {"lash.contact.stiffness": 4e9}))
    n = modes.frequency.size
    assert (n, stiff.modes(closed=True).frequency.size) == (3, 4)
    # of a contact 3e5 times as stiff as the shafts the lower modes differ from the locked ones by about its inverse
    assert stiff.modes(closed=True).frequency[:n] == pytest.approx(modes.frequency, rel=1e-5)
    assert not modes.overdamped.size


def test_both_contact_models_have_the_nine_labels_and_agree_in_99_percent_of_the_map():
    restitution = sweep(study_from_text(NOMINAL + MAP))
    indentation = sweep(study_from_text(BOERE + MAP))
    assert set(restitution.labels) == set(indentation.labels)
    assert len(restitution.labels) == 9
    texts = [np.array(results.labels)[results.sequence] for results in (restitution, indentation)]
    assert np.mean(texts[0] == texts[1]) >= 0.99
    assert np.isnan(restitution.severity).all()


@pytest.mark.parametrize("name", DRIVELINES)
@pytest.mark.parametrize("e", [0.0, 0.3, 0.5, 0.8, 1.0])
def test_momentum_and_the_velocity_ratio_hold_to_rounding_at_every_impact(name, e):
    plant = replace(DRIVELINES[name], restitution=e)
    run = exact(plant, None, 0.3, "rk4")
    lash, inertias = plant.twist, np.array(plant.inertias)
    n = inertias.size
    touches = np.flatnonzero(run.events["kind"] == TOUCH)
    assert touches.size >= (1 if e == 0.0 else 3)
    for k in touches:
        after, before = run.states[k, n:] @ lash, run.events["speed"][k]
        locks = k + 1 < len(run.events) and run.events["kind"][k + 1] == LOCK
        # θ' of a few rad/s in sums of two: rounding is a few 1e-16 times 10
        assert after == pytest.approx(0.0 if locks else -e * before, abs=1e-14)
    # the impact itself: no momentum into the pair but from ground, none into the others
    impulse = lash / inertias
    pair = np.flatnonzero(lash)
    if pair.size == 2:
        assert abs(np.sum(inertias[pair] * impulse[pair])) < 1e-15


@pytest.mark.parametrize("e", [0.15, 0.3, 0.5, 0.7, 0.9, 0.95])
def test_a_bouncing_ball_bounces_when_the_textbook_says(e):
    """Constant torque, one inertia, lash to ground: after the first impact the n-th follows at 2v0/g (1-eⁿ)/(1-e)."""
    acceleration, half_gap = 5.0 / 0.5, np.deg2rad(30.0)
    ball = Plant((0.5,), (), (1, "ground"), backlash=2.0 * half_gap, before=5.0, after=5.0, acceleration_of=1)
    run = exact(replace(ball, restitution=e), [0.0, 0.0], 60.0, "rk4", step=1e-3)
    touches = run.events["time"][run.events["kind"] == TOUCH]
    assert touches[0] == pytest.approx(np.sqrt(2 * half_gap / acceleration), rel=1e-12)
    v0 = e * np.sqrt(2 * half_gap * acceleration)
    n = np.arange(1, touches.size)
    expected = 2 * v0 / acceleration * (1 - e**n) / (1 - e)
    assert touches[1:] - touches[0] == pytest.approx(expected, rel=1e-9)
    # it locks at the first rebound within 1e-4 of the fastest touch, which no power of e is to rounding, and all but
    # that share of the way to the limit
    assert touches.size == np.ceil(np.log(1e-4) / np.log(e))
    lock = run.events["time"][run.events["kind"] == LOCK]
    assert lock.size == 1
    limit = 2 * v0 / (acceleration * (1 - e))
    assert lock[0] - touches[0] == pytest.approx(limit, rel=1.1e-4 / e)
    assert run.complete


def test_without_restitution_no_release_is_taken_for_sticking():
    results = sweep(study_from_text(NOMINAL + "restitution = 0.0\n" + MAP))
    assert not [label for label in results.labels if "OS" in label or "CR" in label]


def test_an_elastic_impact_keeps_the_energy_and_the_run_ends_by_itself():
    study = nominal(lash__contact__restitution=1.0)
    repeating = r"More events than solver\.max_events .* Of the last [\d,]+, from .*, [\d,]+ are touches"
    with pytest.raises(ClunkError, match=repeating):
        simulate(study.model_copy(update={"solver": study.solver.model_copy(update={"max_events": 200})}))
    run = simulate(replace_values(study, {"solver.end_time": 0.2}))
    inertias = np.array(study.driveline.inertias)
    lash = lash_row(study)
    for k in np.flatnonzero(run.events["kind"] == TOUCH):
        after = run.states[k, 4:]
        before = after + 2.0 * run.events["speed"][k] * (lash / inertias) / np.sum(lash**2 / inertias)
        assert np.sum(inertias * before**2) == pytest.approx(np.sum(inertias * after**2), rel=1e-13)


CRITICAL = """
driveline = {{inertias = [1.0, 2.0], shafts = [
    {{between = [1, "ground"], stiffness = 100.0, damping = 20.0}},
    {{between = [2, "ground"], stiffness = 200.0, damping = 40.0}},
]}}
lash = {{between = [1, 2], backlash_deg = 1.0, radius = 0.05, contact = {{model = "restitution", restitution = 0.5}}}}
load = {{initial_torque = 50.0, final_torque = -20.0}}
solver = {{method = "{}", end_time = 2.0, step = 1e-5}}
"""


def test_a_driveline_runs_that_has_no_modes_in_any_regime():
    """Both parts and the whole are damped critically: the angles are t e^(-10 t), no two exponentials."""
    exact, rk4 = (simulate(study_from_text(CRITICAL.format(method))) for method in ("exact", "rk4"))
    assert exact.touches > 4
    assert exact.events["kind"].tolist() == rk4.events["kind"].tolist()
    assert exact.events["time"] == pytest.approx(rk4.events["time"], abs=1e-9)


LIGHT_END = """
driveline = {{inertias = [0.02, 0.02, {}], shafts = [{{between = [2, 3], stiffness = 100.0, damping = 0.5}}]}}
lash = {{between = [1, 2], backlash_deg = 3.0, radius = 0.05, contact = {{model = "restitution"}}}}
load = {{initial_torque = 5.0, final_torque = -1.0}}
solver = {{method = "exact", end_time = 0.2}}
"""


def test_a_light_end_behind_a_damper_changes_what_it_weighs():
    """Its own decay, of 5e9 /s at last, leaves modes that are as far apart as before, and the energy closes."""
    runs = [simulate(study_from_text(LIGHT_END.format(inertia))) for inertia in (1e-6, 1e-8, 1e-10)]
    assert len({run.label for run in runs}) == 1
    heavy, light, lightest = (run.events["time"] for run in runs)
    assert heavy - lightest == pytest.approx(100.0 * (light - lightest), rel=0.05, abs=1e-10)
    assert max(balance(run).relative_residual for run in runs) < 1e-12


def test_the_margin_is_small_where_flanks_all_but_lock():
    """Locked, they touch again after a separation from sticking; parting before, they do not, and the label is another.

    At the border the flanks are about as slow as what locks them, 1e-4 of their fastest touch, and the torque is as
    slight a share of that at rest, since it turns its sign within the rebounds.
    """

    def run(restitution):
        return exact(reference.boere(5.0, 6.0, restitution=restitution))

    low, high = 0.98, 0.99
    locks, parts = run(low), run(high)
    assert (locks.label, parts.label) == ("DS(1)SS(1)", "DS(1)")
    assert min(abs(locks.margin), abs(parts.margin)) > 4e-3
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if run(middle).label == locks.label else (low, middle)
    assert max(abs(run(low).margin), abs(run(high).margin)) < 1e-3


def test_a_faster_locking_speed_locks_earlier():
    slow, fast = simulate(nominal()), simulate(nominal(lash__contact__locking_speed=0.5))
    assert fast.touches < slow.touches
    speeds = np.abs(fast.events["speed"][fast.events["kind"] == TOUCH])
    locked = fast.events["kind"][np.flatnonzero(fast.events["kind"] == TOUCH) + 1] == LOCK
    assert np.all(0.5 * speeds[locked] <= 0.5)
    assert np.all(0.5 * speeds[~locked] > 0.5)


def test_without_a_gap_separation_passes_straight_to_the_other_flank():
    run = simulate(nominal(lash__backlash_deg=0.0))
    kinds, times = run.events["kind"], run.events["time"]
    separations = np.flatnonzero(kinds == SEPARATION)
    assert separations.size == 4  # σr = 5 lies between the second and the third threshold: DS(2)
    assert run.label == "DS(2)"
    assert np.all(kinds[separations + 1] == TOUCH)
    assert np.all(times[separations + 1] == times[separations])
    assert np.all(run.events["speed"][separations + 1] == 0.0)


@pytest.mark.parametrize("step", [1.3617e-05, 1.9532e-05, 2.7736e-05, 3.7087e-05, 4.5316e-05, 6.6313e-05, 8.9565e-05])
def test_without_a_gap_they_change_once_whatever_the_step_and_the_ratio(step):
    """By steps of which rounding adds up: were it taken away where the sides change, the torque would change too."""
    for method in ("rk4", "exact"):
        run = simulate(study_from_text(GEARED, overrides=[f"solver.step={step}", f"solver.method='{method}'"]))
        assert run.label == "CR(1)"


PASSING_ITS_FLANKS = """
driveline.inertias = [0.008481, 0.3226, 0.01319, 0.02554]
driveline.shafts = [
    { between = [3, 1], ratio = -1.0, stiffness = 0.02407, damping = 0.001429 },
    { between = [4, 1], ratio = -0.7, stiffness = 279.3, damping = 0.1539 },
    { between = [4, "ground"], damping = 0.1005 },
    { between = [2, "ground"], damping = 0.1738 },
]
lash.between = [4, 2]
lash.ratio = 2.5
lash.backlash_deg = 0.0
lash.radius = 0.02612
lash.contact = { model = "restitution", restitution = 0.9 }
load = { on = 3, profile = "lag", initial_torque = 1.43, final_torque = -0.0715, time_constant = 0.1901 }
solver = { method = "exact", end_time = 15.51 }
"""


@pytest.mark.parametrize("torque", [1.03675, 1.847, 2.86])
def test_without_a_gap_they_do_not_change_back_by_rounding(torque):
    """The torque between the flanks is zero where they change: its rounding pulled them back, again and again."""
    run = simulate(study_from_text(PASSING_ITS_FLANKS, overrides=[f"load.initial_torque={torque}"]))
    assert run.label == "DS(3)CR(1)"
    assert np.count_nonzero(run.events["kind"] == TOUCH) == 7  # as often as the torque changes its sign


WITHOUT_A_GAP_BEHIND = """
[driveline]
inertias = [0.024, 0.0193, 0.0088, 0.01]
[[driveline.shafts]]
between = [1, 2]
stiffness = 31.5
damping = 0.05
[[driveline.shafts]]
between = [4, "ground"]
stiffness = 47.4
damping = 0.05
[[lash]]
between = [2, 3]
backlash_deg = 5.46
radius = 0.08
contact = {{model = "restitution", restitution = {0}}}
[[lash]]
between = [3, 4]
backlash_deg = {1}
radius = 0.08
contact = {{model = "restitution", restitution = {0}}}
[load]
initial_torque = 5.39
final_torque = -0.93
[solver]
method = "{2}"
end_time = 0.4
"""


@pytest.mark.parametrize("method", ["exact", "rk4"])
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_flanks_without_a_gap_change_sides_and_touch_no_other_lash(restitution, method):
    """The others are at their flanks where they touch, and V is as with the least of gaps, but for 2e-11 by that.

    Energy closes to what each located event leaves, by rk4 some 1e-12 of all; a touch that is none leaves 5 %.
    """
    without, least = (
        simulate(study_from_text(WITHOUT_A_GAP_BEHIND.format(restitution, gap, method))) for gap in (0.0, 1e-9)
    )
    energy = balance(without)
    assert abs(energy.residual) < 1e-10 * energy.stored_before
    touches = (without.events["lash"] == 0) & (without.events["kind"] == TOUCH)
    twists = without.states[touches, 1] - without.states[touches, 2]
    assert np.abs(twists) == pytest.approx(np.deg2rad(5.46) / 2.0, rel=1e-9)
    assert without.approach_velocity == pytest.approx(least.approach_velocity, rel=1e-9)
    assert np.any((without.events["lash"] == 1) & (without.events["kind"] == LOCK))


@pytest.mark.parametrize("torque", [60.0, 100.0, 140.0, 200.0, 249.3])
def test_an_impact_pulls_nothing_along_by_flanks_that_are_still(torque):
    """Two lashes in a row part at once, and the part between them moves freely, at the flank of the second as it was.

    The touch of the first pushes it away from there: no impulse reaches what is behind. So it leaves with what Newton's
    law gives two free bodies, to what friction changes behind the lash until it touches on the other side.
    """
    study = random_study(60, "solver.end_time=0.2").model_copy(update={"sweep": None})
    run = simulate(replace_values(study, {"lash[1].backlash_deg": 0.9968, "load.initial_torque": torque}))
    first, second = np.flatnonzero(run.events["kind"] == TOUCH)[:2]
    assert run.events["kind"][1:first].tolist() == [SEPARATION, SEPARATION]
    assert run.events["lash"][[first, second]].tolist() == [0, 1]
    assert run.events["time"][second] - run.events["time"][first] > 1e-3
    inertia, lash = study.driveline.inertias, study.lashes[0]
    share = (1.0 + lash.contact.restitution) / (1.0 + lash.ratio**2 * inertia[0] / inertia[1])  # Eq. 2.9
    share *= abs(lash.ratio) * inertia[0] / inertia[1]
    speeds = np.abs(run.events["speed"])
    assert speeds[second] == pytest.approx(share * speeds[first], rel=1e-4)


SPLIT = """
[driveline]
inertias = [1500.0, 300.0, 120.0, 200.0, 120.0, 210.0]
shafts = [
    { between = [1, 2], stiffness = 3e7, damping = 3e4 },
    { between = [3, 4], stiffness = 8e6, damping = 6000.0 },
    { between = [5, 6], stiffness = 7e6, damping = 6000.0 },
    { between = [4, "ground"], stiffness = 0.0, damping = 4000.0 },
    { between = [6, "ground"], stiffness = 0.0, damping = 3500.0 },
]
[[lash]]
between = [2, 3]
backlash_deg = 0.8
radius = 0.25
contact = { model = "restitution", restitution = 0.4 }
[[lash]]
between = [2, 5]
backlash_deg = 1.2
radius = 0.25
ratio = -1.0
contact = { model = "restitution", restitution = 0.2 }
[load]
profile = "step"
on = 1
initial_torque = 9e4
final_torque = -1.5e4
[solver]
step = 1e-5
end_time = 0.8
"""


@pytest.mark.parametrize(("gap", "torque"), [(1.716901778834982, 16343.0472868185), (2.30303868, 21335.3772027)])
def test_impacts_of_two_branches_on_one_shaft_die_out(gap, torque):
    """Each touch of one lash parts the other by less than rounding tells, and that must not make its next touch faster.

    A touch that came of the rounding of the gap alone, faster than at what touches lock, kept both going without end.
    """
    keys = [f"lash[2].backlash_deg={gap}", f"load.initial_torque={torque}"]
    methods = [f'solver.method="{method}"' for method in ("exact", "rk4")]
    runs = [simulate(study_from_text(SPLIT, overrides=[*keys, method])) for method in methods]
    assert runs[0].label == runs[1].label
    for run in runs:
        assert balance(run).relative_residual < 1e-11  # 4e-13 by 8e4 steps of rk4
        assert np.count_nonzero(run.events["kind"] == TOUCH) < 100  # 75 and 95 are few beside 30,000, without end


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_rigid_flanks_have_no_extremes_of_an_acceleration_that_their_impacts_make_infinite(method):
    rigid = ['lash.contact.model="restitution"', "lash.contact.restitution=0.5"]
    run = simulate(study_from_text(BOERE, overrides=[f'solver.method="{method}"', *rigid]))
    assert run.label != "NI"
    assert np.isnan(run.extremes).all()
    assert np.isnan(run.severity)
