"""Loads that move, by both methods: the independent reference, limits in which one profile is another, and margins."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import margins, reference
from helpers.agreement import TIME, both_methods_are_the_reference, exact, kinds_of, propagated, sticking_time
from helpers.reference import CONTACTS, PROFILES, Plant, lag, ramp, sine, smooth, table

import clunk
from clunk.simulation.driveline import Driveline
from clunk.simulation.system import prepare


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("profile", PROFILES)
def test_both_methods_are_the_reference(profile, contact):
    """As are those of random drivelines, geared and free, under random loads: see `test_elements`."""
    run = both_methods_are_the_reference(Plant(profile=PROFILES[profile], **CONTACTS[contact]), 0.4)
    assert len(run.events) > 4


# Resonance with the load's wave

# the side of the load, without drag, drifts in the gap: by the third power of time under a ramp
UNDAMPED = Plant(shafts=((1, 2, 31.3, 0.0), (2, 3, 31.3, 0.0), (4, "ground", 31.3, 0.0)), contact_damping=0.0)


def frequencies(plant, closed):
    """The natural frequencies of a plant  [Hz]."""
    study = reference.study_of(plant, method="rk4")
    return Driveline.from_study(study).modes(closed=closed).frequency


@pytest.mark.parametrize("contact", ["gap", "restitution"])
@pytest.mark.parametrize("off", [0.0, 1e-6, 3e-4])
@pytest.mark.parametrize(("closed", "mode"), [(True, 0), (True, 1), (False, 0)])
def test_a_wave_in_resonance(closed, mode, off, contact):
    """At a natural frequency, beside it, and where the wave is just a mode like the others: at a condition of 3e3."""
    plant = replace(UNDAMPED, before=-3.0, **CONTACTS[contact])
    frequency = float(frequencies(plant, closed)[mode]) * (1.0 + off)
    profile = sine(0.5, frequency) if mode else smooth(0.5 / frequency)
    plant = replace(plant, profile=profile)
    study = reference.study_of(plant)
    _, flows = prepare(study, Driveline.from_study(study))
    if plant.restitution is None or not closed:  # the modes with the lash locked are others
        assert flows.modal[0, int(closed)] == (off > 1e-4)
    both_methods_are_the_reference(plant, 0.3)


@pytest.mark.parametrize("bearing", [0.0, 0.1])
@pytest.mark.parametrize("seconds", [1.0, 10.0, 1e3, 1e4])
def test_a_lag_so_slow_that_it_is_a_ramp_beside_a_drift(seconds, bearing):
    """In modes no digits were left of it at 1e4 s: there were 367 events for 9, at ten times the energy.

    What is left is the rounding of a torque of 20 N m for each second, of which the run sees the first part.
    """
    shafts = (*UNDAMPED.shafts, (1, "ground", 0.0, bearing))
    plant = replace(UNDAMPED, shafts=shafts, contact_damping=0.5, profile=lag(seconds), before=-6.0)
    plant = replace(plant, after=20.0 * seconds - 6.0)
    events = propagated(plant, end_time=1.0)
    assert len(events) == 9
    run = exact(plant, end_time=1.0)
    assert kinds_of(run) == [(event.kind, event.side) for event in events]
    assert run.events["time"] == pytest.approx([event.time for event in events], abs=4e-12 * seconds)


TRUCK = """
driveline.names = ["engine", "input", "output", "crown", "body"]
driveline.inertias = [1.316, 0.03242, 0.07709, 0.5017, 3832.0]
driveline.shafts = [
    { between = ["engine", "input"], stiffness = 2300.0, damping = 0.17 },
    { between = ["crown", "body"], stiffness = 5e4, damping = 30.0 },
    { between = ["body", "ground"], damping = 0.0 },
]
lash = [
    { between = ["input", "output"], ratio = 3.7, backlash_deg = 0.08, radius = 0.05 },
    { between = ["output", "crown"], ratio = 3.7, backlash_deg = 0.012, radius = 0.03 },
]
load = { profile = "lag", time_constant = 1.95, on = "engine", initial_torque = 881.8, final_torque = -298.6 }
solver = { method = "exact", step = 2e-5, end_time = 3.0 }
"""
RIGID = [f"lash[{k}].contact.{key}" for k in (1, 2) for key in ("model='restitution'", "restitution=0.3")]


@pytest.mark.parametrize("drag", [0.0, 100.0])
@pytest.mark.parametrize(
    "wave",
    [["load.time_constant=1.95"], ["load.profile='sine'", "load.frequency=0.12", "load.amplitude=1000"]],
)
def test_a_slow_wave_leaves_a_part_between_two_lashes_alone(wave, drag):
    """It does not drive that part, whose gap closed and opened by rounding, 10^5 times, where both lashes are open."""
    study = clunk.study_from_text(TRUCK, overrides=[*RIGID, *wave, f"driveline.shafts[3].damping={drag}"])
    run, stepped = clunk.simulate(study), clunk.simulate(study.but(solver=study.solver.but(method="rk4")))
    assert kinds_of(run) == kinds_of(stepped)
    # rounding of RK4 as the truck rolls: some 1e-8 s, twice as much at half the step
    assert run.events["time"] == pytest.approx(stepped.events["time"], abs=1e-6)


FLOATING = """
driveline.inertias = [0.006899, 102.63602636650182, 26.34, 1.763, 2.122]
driveline.shafts = [
    { between = [4, 5], ratio = 0.4, stiffness = 547500.0, damping = 9.825 },
    { between = [1, "ground"], damping = 1.961 },
    { between = [4, "ground"], damping = 785.3 },
    { between = [3, "ground"], damping = 1.543 },
]
lash = [
    { between = [1, 2], ratio = 20.0, backlash_deg = 0.07593661181884148, radius = 0.04121 },
    { between = [2, 3], backlash_deg = 0.008045, radius = 0.09531 },
    { between = [1, 4], ratio = -3.7, backlash_deg = 6.619, radius = 0.0996 },
]
load = { profile = "smooth", on = 3, initial_torque = -0.5727736721776115, final_torque = 1.044, duration = 2.41026 }
solver = { method = "exact", step = 1e-6, end_time = 1.528 }
"""
CONTACTS_OF_FLOATING = [(3.447e8, 3742.0), (1.5e8, 5e4), (7.699e8, 2.314e5)]


@pytest.mark.filterwarnings("ignore::clunk.ClunkWarning")  # the run ends before the change does
def test_a_torque_leaves_parts_that_it_does_not_reach_alone():
    """By rounding, it pressed them on each other with 1e-18 of itself: they touched 10^5 times."""
    contacts = [
        f"lash[{k}].contact={{stiffness={stiffness}, damping={damping}}}"
        for k, (stiffness, damping) in enumerate(CONTACTS_OF_FLOATING, 1)
    ]
    study = clunk.study_from_text(FLOATING, overrides=contacts)
    run, stepped = clunk.simulate(study), clunk.simulate(study.but(solver=study.solver.but(method="rk4")))
    assert kinds_of(run) == kinds_of(stepped)
    assert run.events["time"] == pytest.approx(stepped.events["time"], abs=1e-6)  # a step of RK4


DRIFTING = """
driveline.inertias = [1e-4, 0.05, 0.1]
driveline.shafts = [
    { between = [3, "ground"], stiffness = 1000.0, damping = 0.5 },
    { between = [1, 2], stiffness = [200.0, 0.0, 200.0], breakpoints_deg = [-0.5, -0.3], damping = 0.01 },
]
lash = { between = [2, 3], backlash_deg = 1.0, radius = 0.05, contact = { model = "restitution", restitution = 0.5 } }
load = { profile = "sine", initial_torque = -5.0, final_torque = -2.0, amplitude = 10.0, frequency = 0.0159 }
solver = { method = "exact", step = 1e-5, end_time = 10.01 }
"""


def test_a_sine_as_slow_as_the_run_on_a_stage_without_stiffness():
    """As a mode, it would turn the first part by 10^6 rad and leave no digits: the stage changed 10^5 times."""
    study = clunk.study_from_text(DRIFTING)
    run, stepped = clunk.simulate(study), clunk.simulate(study.but(solver=study.solver.but(method="rk4")))
    assert kinds_of(run) == kinds_of(stepped)
    assert run.events["time"] == pytest.approx(stepped.events["time"], abs=1e-5)  # a step of RK4


@pytest.mark.parametrize("contact", [{}, {"restitution": 0.95}])
@pytest.mark.parametrize("drag", [1e-8, 1e-6, 1e-5, 3e-5, 1e-4])
def test_a_ramp_on_a_part_that_is_all_but_undamped(drag, contact):
    """Its steady speed under the ramp would leave no digits of its own: events were up to 0.04 s off."""
    shafts = ((2, "ground", 1000.0, 0.5),)
    plant = Plant(
        (0.17, 0.05), shafts, (1, 2), before=-16.0, after=20.0, profile=ramp(0.1), acceleration_of=1, **contact
    )
    free, braked = (exact(replace(plant, shafts=(*shafts, (1, "ground", 0.0, each)))) for each in (0.0, drag))
    assert kinds_of(free)[:5] == kinds_of(braked)[:5]
    # what the drag itself does, and rounding
    assert braked.events["time"][:5] == pytest.approx(free.events["time"][:5], abs=3e-3 * drag + 1e-6)


BRAKED = """
driveline.inertias = [0.02, 10.0]
lash = { between = [1, 2], backlash_deg = 2.0, radius = 0.05, contact = { stiffness = 1e7, damping = 100.0 } }
load = { profile = "ramp", on = 1, initial_torque = 5.0, final_torque = -20.0, duration = 0.07 }
solver = { method = "exact", step = 1e-6, end_time = 0.5 }
driveline.shafts = [
    { between = [1, "ground"], damping = 0.001 },
    { between = [2, "ground"], damping = 0.0005 },
]
"""


@pytest.mark.parametrize("duration", [0.005, 0.07])
@pytest.mark.parametrize("bearing", [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8])
def test_a_ramp_on_a_part_that_a_bearing_brakes_slowly(bearing, duration):
    """Of a part that takes 20 s to stop, or 10^6, and rolls: touches were up to 0.03 s off, and labels wrong."""
    values = {"driveline.shafts[1].damping": bearing, "load.duration": duration}
    study = clunk.replace_values(clunk.study_from_text(BRAKED), values)
    run, stepped = clunk.simulate(study), clunk.simulate(study.but(solver=study.solver.but(method="rk4")))
    assert kinds_of(run) == kinds_of(stepped)
    # digits that are lost, or powers that are left out, both the most for a decay of 2,000 s
    assert run.events["time"] == pytest.approx(stepped.events["time"], abs=2e-6)


# One profile as another

NOMINAL = Plant()


def times_of(plant, **options):
    return exact(plant, **options).events["time"]


def test_knots_on_a_straight_line_change_nothing():
    """1,000 of them: each is a piece, at whose ends coordinates are rounded anew."""
    times = np.linspace(0.0, 0.1, 1000)
    tabled = replace(NOMINAL, profile=table(times, -6.0 + 50.0 * times))
    one, other = exact(replace(NOMINAL, profile=ramp(0.1))), exact(tabled)
    assert kinds_of(one) == kinds_of(other)
    assert other.events["time"] == pytest.approx(one.events["time"], abs=1e-11)
    assert other.impact_severity == pytest.approx(one.impact_severity, rel=1e-10)
    assert other.margin == pytest.approx(one.margin, abs=1e-10)


def test_a_short_ramp_is_a_step_half_its_duration_later():
    """Up to the square of the duration, of which the chatter of the first impact makes up to 20 times as much.

    A slope is a large number of which the steady motion under it is rounded: by some 1e-19 s² over the duration.
    """
    at_once = times_of(NOMINAL, end_time=0.13)
    for duration in (1e-4, 1e-5, 1e-6, 1e-8):
        late = times_of(replace(NOMINAL, profile=ramp(duration)), end_time=0.13)
        within = 20.0 * duration**2 + 1e-12 + 1e-18 / duration
        assert late[1:] - duration / 2 == pytest.approx(at_once[1:], abs=within)


@pytest.mark.parametrize("profile", ["ramp", "table"])
@pytest.mark.parametrize("duration", [2e-9, 9e-8])
def test_a_line_of_next_to_no_time_is_a_step_in_its_middle(profile, duration):
    """Where the truck rolls with next to no drag, the slope's own rounding would move events by 1e-3 s."""
    change = "on='engine', initial_torque=900.0, final_torque=-300.0"
    loads = {
        "step": [f"load={{profile='step', {change}}}"],
        "ramp": [f"load={{profile='ramp', {change}, duration={duration}}}"],
        "table": [f"load={{profile='table', on='engine', times=[0.0, {duration}, 1.0], torques=[900, -300, -300]}}"],
    }
    truck = [f"lash[{k}].contact.{key}" for k in (1, 2) for key in ("stiffness=3e8", "damping=5e3")]
    truck += ["driveline.shafts[3].damping=0.1"]
    studies = [clunk.study_from_text(TRUCK, overrides=[*truck, *loads[each]]) for each in (profile, "step")]
    run, at_once = map(clunk.simulate, studies)
    # 1e-10 s by the step in place of the line, and the rounding of speeds of 10^5 rad/s
    assert run.events["time"][1:] - duration / 2 == pytest.approx(at_once.events["time"][1:], abs=1e-8)


@pytest.mark.parametrize("method", ["exact", "rk4"])
@pytest.mark.parametrize("duration", [0.0, 0.9e-9])
@pytest.mark.parametrize(
    ("profile", "key"), [("ramp", "duration"), ("smooth", "duration"), ("lag", "time_constant"), ("pulse", "duration")]
)
def test_a_duration_of_less_than_a_nanosecond_is_a_step_or_nothing(profile, key, duration, method):
    run = exact(replace(NOMINAL, profile=reference.Profile(profile, **{key: duration})), method=method)
    if profile == "pulse":
        assert run.label == "NI"
        assert run.complete
    else:
        at_once = exact(NOMINAL, method=method)
        assert run.severity == pytest.approx(at_once.severity, rel=1e-12)
        assert run.events["time"] == pytest.approx(at_once.events["time"], abs=1e-12)


# Kinks and jumps


@pytest.mark.parametrize(
    ("contact", "event"), [("gap", 1), ("gap", 2), ("force", 1), ("force", 3), ("restitution", 2), ("restitution", 3)]
)
def test_an_event_at_a_kink_or_a_jump_happens_once(contact, event):
    """The load turns back, or jumps, at the very number that is the event's time without that.

    But not where rigid flanks are released: by the reference's rounding, they touch again there.
    """
    plant = replace(NOMINAL, profile=table((0.0, 0.5), (-6.0, 6.5)), **CONTACTS[contact])
    time = float(times_of(plant, end_time=0.4)[event])
    torque = -6.0 + 25.0 * time
    for profile in (
        table((0.0, time, time + 0.05), (-6.0, torque, -3.0)),
        table((0.0, time, time), (-6.0, torque, -5.0)),
        table((0.0, time, time), (-6.0, torque, 3.0)),
    ):
        run = both_methods_are_the_reference(replace(plant, profile=profile), 0.3)
        assert run.events["time"][event] == pytest.approx(time, abs=TIME["exact"])


@pytest.mark.parametrize("method", ["exact", "rk4"])
def test_nothing_is_complete_before_the_load_rests(method):
    """A second of rest before the torque falls; and a torque that falls by too little for anything to happen."""
    run = exact(replace(NOMINAL, profile=table((0.0, 1.0, 1.1), (-6.0, -6.0, -1.0))), end_time=3.0, method=method)
    assert run.events["time"][1] > 1.0
    assert run.label == "DS(1)SS(1)"
    assert run.complete
    run = exact(replace(NOMINAL, profile=table((0.0, 1.0, 1.0), (-6.0, -6.0, -5.0))), end_time=3.0, method=method)
    assert run.label == "NI"
    assert run.complete
    assert run.end >= 1.0


HELD = Plant(
    inertias=(0.03,),
    shafts=((1, "ground", 60.0, 1.0),),
    lash=(1, "ground"),
    backlash=0.05,
    before=-8.0,
    acceleration_of=1,
    restitution=0.3,
)


@pytest.mark.parametrize("begin", [0.0, 0.05])
@pytest.mark.parametrize("following", [(0.5,), (1.0, 0.5), (1.0, -8.0), (1.0, 9.0)])
def test_flanks_that_a_jump_parts_part_at_that_very_time(begin, following):
    """Also where the torque would press them together again soon, within less than a shortest span of the method."""
    times = (0.0, begin, begin, begin + 0.02) if begin else (0.0, 0.0, 0.02)
    torques = (-8.0,) * (2 if begin else 1) + following
    run = both_methods_are_the_reference(replace(HELD, profile=table(times[: len(torques)], torques)), 0.3)
    assert kinds_of(run)[1] == ("separation", -1)
    assert run.events["time"][1] == begin


@pytest.mark.parametrize("profile", [ramp(0.2), smooth(0.2), sine(3.0, 2.0)], ids=lambda profile: profile.name)
def test_rigid_flanks_of_two_free_inertias_part_where_the_torque_changes_its_sign(profile):
    """Nothing but the load makes the torque that holds them: it is zero there, and so is all that it is made of."""
    plant = Plant(
        inertias=(0.03, 0.02),
        shafts=(),
        lash=(1, 2),
        lash_ratio=3.7,
        backlash=0.2,
        before=-6.0,
        after=3.0 if profile.name != "sine" else -1e-3,
        acceleration_of=1,
        restitution=0.0,
        profile=profile,
    )
    assert len(both_methods_are_the_reference(plant, 0.6).events) > 2


# Margins


@pytest.mark.parametrize("row", reference.THRESHOLDS, ids=lambda row: f"{row[1].__name__} at {row[0]}")
def test_the_margin_passes_zero_where_the_label_changes(row):
    """The edges are good to 1e-8 s, of which a margin makes up to 100 times as much; it has the sign of what happened.

    Below an edge of a ramp there is more of a sequence, and above it less; of a pulse, the other way round.
    """
    ratio, profile, *sequence = row
    for before, edge, after in zip(sequence[::2], sequence[1::2], sequence[2::2], strict=False):
        near = [exact(reference.boere(ratio, 6.0, profile=profile(edge + off))) for off in (-1e-5, -2e-8, 2e-8, 1e-5)]
        assert [run.label for run in near] == [before, before, after, after]
        assert np.sign([run.margin for run in near[:2]]).tolist() == [near[0].margin / abs(near[0].margin)] * 2
        assert np.sign(near[1].margin) == -np.sign(near[2].margin) == -np.sign(near[3].margin)
        assert max(abs(run.margin) for run in near[1:3]) < 3e-6
        assert max(abs(near[0].margin), abs(near[3].margin)) < 1e-3


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize(
    ("ratio", "backlash", "profile"),
    [(5.0, 6.0, "table"), (3.3, 12.0, "ramp"), (3.3, 12.0, "lag"), (5.0, 6.0, "pulse")],
)
def test_the_margin_is_the_smallest_of_all_near_misses(ratio, backlash, profile, contact):
    """Brute force, from every turning point of every phase, the load's pieces and their ends included."""
    plant = reference.boere(ratio, backlash, profile=PROFILES[profile], **CONTACTS[contact])
    expected = margins.margin(plant, propagated(plant, end_time=0.5), 0.5, sticking_time(plant))
    assert exact(plant, end_time=0.5).margin == pytest.approx(expected.margin, abs=1e-9), expected


@pytest.mark.parametrize("contact", CONTACTS)
def test_the_margin_under_a_wave_of_no_time_is_that_of_a_step(contact):
    """How deep a guard would go takes milliseconds, which are thousands of turns of such a wave."""
    for ratio, backlash in ((1.5, 3.0), (1.7, 3.0), (2.5, 6.0), (3.3, 12.0)):
        plant = reference.boere(ratio, backlash, **CONTACTS[contact])
        at_once = exact(plant, end_time=0.5)
        assert at_once.label != "NI"
        for duration in (1e-6, 1e-8):  # which is what the margin may differ by, as a share of an impact's millisecond
            quick = exact(replace(plant, profile=smooth(duration)), end_time=0.5)
            assert quick.margin == pytest.approx(at_once.margin, abs=1e3 * duration)


@pytest.mark.parametrize(
    ("times", "torques"),
    [
        ((0.0, 0.05, 0.1), (-8.0, -1.75, -8.0)),
        ((0.0, 0.05, 0.05, 0.1), (-8.0, -8.0, -1.75, -8.0)),
        ((0.0, 0.05, 0.05, 0.1), (-8.0, -1.75, -4.0, -8.0)),
        ((0.0, 0.05, 0.05), (-8.0, -1.75, -8.0)),
    ],
    ids=["bends", "jumps down and rises", "falls and jumps up", "falls and jumps up for good"],
)
def test_a_near_miss_at_a_kink_of_the_load_is_in_the_margin(times, torques):
    """The load acts on the held inertia: at -1.5 N m its shaft alone would keep it at the flank."""
    run = exact(replace(HELD, profile=table(times, torques)), end_time=0.3)
    assert run.label == "NI"
    assert len(run.events) == 1
    assert run.margin == pytest.approx((1.75 - 1.5) / (-torques[-1] - 1.5), abs=1e-12)
