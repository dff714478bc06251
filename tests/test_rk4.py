"""Fixed-step RK4 with located events: its order, its steps, its regimes, and how a run ends."""

from itertools import pairwise

import numpy as np
import pytest
from helpers import reference, studies
from helpers.agreement import exact, kinds_of

import clunk
from clunk.core.rk4.propagator import build_steps, rk4_growth
from clunk.simulation import batches
from clunk.simulation.trajectory import simulate
from clunk.study.errors import ClunkError

# An error that goes with h⁴ falls sixteenfold when the step halves. The next order leaves 16 ± 16 hλ, which is 0.6 for
# the contact mode (λ = 1640 1/s) at h = 2.5e-5 s, and an event's place on the time grid moves the error by less.
STEPS = (5e-5, 2.5e-5)
ROUNDING = 5e-12  # rad, rad/s: what 80,000 steps, each rounded by 1e-16 of less than 1 rad, may add up to


def stepped(plant, step=1e-4, end_time=2.0, state=None):
    return exact(plant, state, end_time, "rk4", step)


def same_kinds(run, events):
    return kinds_of(run) == [(event.kind, event.side) for event in events]


@pytest.mark.parametrize("separation", ["gap", "force"])
@pytest.mark.parametrize(("ratio", "backlash"), [(2.0, 6.0), (5.0, 6.0), (10.0, 10.0), (10.0, 16.0)])
def test_the_error_falls_sixteenfold_across_located_events(ratio, backlash, separation):
    """The largest one of the event times, and of the states at them."""
    plant = reference.boere(ratio, backlash, separation=separation)
    events, _ = reference.run(plant)
    assert len(events) > 6
    errors = []
    for step in STEPS:
        run = stepped(plant, step)
        assert same_kinds(run, events)
        times = np.abs(run.events["time"] - [event.time for event in events])
        errors.append((times.max(), np.abs(run.states - [event.state for event in events]).max()))
    for large, small in zip(*errors, strict=True):
        assert large == pytest.approx(16.0 * small, rel=0.1, abs=16.0 * ROUNDING)


def test_growth_is_that_of_the_stability_polynomial():
    """RK4 is stable up to -2.785 on the real axis and 2√2 on the imaginary one (Hairer & Wanner, §IV.2)."""
    assert rk4_growth(np.array([-2.785 + 0j, 2.8284j]), 1.0) == pytest.approx([1.0, 1.0], abs=1e-3)
    assert np.all(rk4_growth(np.array([-2.79 + 0j, 2.83j]), 1.0) > 1.0)
    assert np.all(rk4_growth(np.array([-2.78 + 0j, 2.82j]), 1.0) < 1.0)


@pytest.mark.parametrize("steps", [*range(1, 14), 30, 63, 64, 65, 90])
def test_a_touch_between_two_steps_that_both_end_in_the_gap_is_not_skipped(steps):
    """A free inertia thrown against a flank and pulled back at 1000 rad/s² reaches it halfway through a step.

    q = φ/2 + reach - a (t - t*)²/2 lies below the flank at both ends of that step, by 1.25e-6 rad less `reach`.
    Whichever step it is: full steps are taken one by one, in blocks, or in strides.
    """
    step, pull, half = 1e-4, 1000.0, np.deg2rad(3.0)
    plant = reference.Plant((0.01,), (), (1, "ground"), 100.0, 0.1, after=-10.0, acceleration_of=1)
    turn = (steps + 0.5) * step
    for reach in (1e-6, 1e-9, -1e-9, -1e-6):
        start = np.array([half + reach - pull * turn**2 / 2, pull * turn])
        run = stepped(plant, step, turn + 8e-3, start)
        assert kinds_of(run)[1:2] == ([("touch", 1)] if reach > 0.0 else [])
        if reach > 0.0:  # q = 0.05 is known to 1e-17, the time to that over the speed
            speed = np.sqrt(2.0 * reach * pull)
            assert run.events["time"][1] == pytest.approx(turn - speed / pull, abs=1e-15 / speed)


@pytest.mark.parametrize(("separation", "together"), [("gap", 2), ("force", 3)])
@pytest.mark.parametrize("step", [1e-3, 2e-3])
def test_several_events_in_one_step_are_all_found(step, separation, together):
    """A gap of 1e-3° crossed at 0.8 rad/s: separation, opening and the touch opposite lie within half a step.

    The driveline is slow enough for such steps to be accurate: the contact mode has λ = 68 1/s, hλ <= 0.14, as the
    nominal step has for the report's driveline.
    """
    plant = reference.Plant(
        inertias=(0.024, 0.02, 0.02),
        shafts=((1, 2, 5.0, 0.1), (3, "ground", 5.0, 0.1), (1, "ground", 0.0, 0.1)),
        lash=(2, 3),
        contact_stiffness=40.0,
        contact_damping=0.01,  # force ends c/k = 0.25 ms before the gap opens
        backlash=np.deg2rad(1e-3),
        before=-10.0,
        acceleration_of=2,
        separation=separation,
    )
    run = stepped(plant, step)
    assert same_kinds(run, reference.run(plant)[0])
    steps = np.floor(run.events["time"] / step)
    assert max(np.count_nonzero(steps == one) for one in steps) >= together


@pytest.mark.parametrize("separation", ["gap", "force"])
def test_no_backlash_passes_from_flank_to_flank(separation):
    """φθ = 0: wherever the gap opens, the other flank is touched at that instant, to rounding of the time."""
    run = stepped(reference.boere(7.0, 0.0, separation=separation))
    kinds, leaving = kinds_of(run), "separation" if separation == "gap" else "opening"
    pairs = [(here, there) for here, there in pairwise(range(len(kinds))) if kinds[here][0] == leaving]
    assert len(pairs) == 6
    assert run.label == "DS(3)"
    for here, there in pairs:
        assert kinds[there] == ("touch", -kinds[here][1])
        assert run.events["time"][there] - run.events["time"][here] <= 1e-12


@pytest.mark.parametrize("separation", ["gap", "force"])
def test_every_transition_keeps_what_it_says_is_zero(separation):
    """At each event the functional that ended the regime is zero, and so is the guard named as such."""
    plant = reference.boere(8.0, 5.0, separation=separation)
    run, side = stepped(plant), slice(1, None)
    q, speed = run.states[side, :4] @ plant.twist, run.states[side, 4:] @ plant.twist
    overlap = run.events["side"][side] * q - plant.backlash / 2
    force = plant.contact_stiffness * overlap + plant.contact_damping * run.events["side"][side] * speed
    assert run.events["speed"][side] == pytest.approx(speed, abs=1e-15)
    for (kind, _), gap, torque in zip(kinds_of(run)[side], overlap, force, strict=True):
        by_force = kind == "rejoin" or (kind == "separation" and separation == "force")
        # a time located to its last digit leaves the speed times 1e-16 s, and rounding of q = θ3 - θ4
        assert abs(torque if by_force else gap) < (1e-12 if by_force else 1e-15)
    assert np.all(np.diff(run.events["time"]) > 0.0)


def test_a_state_beyond_all_numbers_and_a_step_beyond_the_stability_limit_are_said():
    """The contact mode, ω = 1623 1/s and ζ = 0.196, allows a step of 1.67 ms (RK4's limit at that angle)."""
    plant = reference.boere(5.0, 6.0)
    with pytest.raises(ClunkError, match="infinite or undefined"):
        stepped(plant, state=np.full(8, 1e300) * np.arange(1, 9))
    assert stepped(plant, 1.5e-3).touches > 0
    with pytest.raises(ClunkError, match="unstable"):
        stepped(plant, 2e-3)


@pytest.mark.parametrize("contact", reference.CONTACTS.values(), ids=reference.CONTACTS)
def test_stopping_early_changes_nothing(contact, monkeypatch):
    """What is proved complete stays so: five times the end time adds no event and no acceleration."""
    plants = [reference.boere(ratio, gap, **contact) for ratio in (0.0, 2.5, 5.0, 10.0) for gap in (0.0, 6.0, 16.0)]
    early = [stepped(plant) for plant in plants]

    def unproved(*driveline):
        system, tables = build_steps(*driveline)
        return system, tables._replace(settles=np.zeros_like(tables.settles))

    monkeypatch.setattr(batches, "build_steps", unproved)
    for plant, short in zip(plants, early, strict=True):
        whole = simulate(reference.study_of(plant, end_time=10.0, method="rk4"))
        assert short.complete
        assert not whole.complete
        assert np.array_equal(short.states, whole.states)
        assert np.array_equal(short.impact_severity, whole.impact_severity, equal_nan=True)
        assert short.label == whole.label
    batches.prepare_one.cache_clear()


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 5, 7, 8, 11])
def test_strides_change_nothing(seed, monkeypatch):
    """Labels and touches of a random study are those of runs in which each step is seen; the rest is so to rounding.

    Another torque by its last bit moves the last event of these 4 x 3 runs by up to 1e-11 s, as strides do; of the
    seeds left out, by up to 3 ms.
    """
    study = studies.random_study(seed, "solver.method=rk4")
    strided = clunk.sweep(study, boundaries=False)

    def without_strides(*driveline):
        system, tables = build_steps(*driveline)
        return system, tables._replace(strides=np.zeros_like(tables.strides))

    monkeypatch.setattr(batches, "build_steps", without_strides)
    batches.prepare_one.cache_clear()
    every = clunk.sweep(study, boundaries=False)
    batches.prepare_one.cache_clear()
    assert np.array_equal(strided.label_map, every.label_map)
    assert np.array_equal(strided.touches, every.touches)
    assert strided.last_event_time == pytest.approx(every.last_event_time, abs=1e-9, nan_ok=True)
    assert strided.severity == pytest.approx(every.severity, rel=1e-7, nan_ok=True)
