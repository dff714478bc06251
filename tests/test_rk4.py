"""Fixed-step RK4 with located events: its order, its steps, its regimes, and how a run ends."""

from itertools import pairwise

import numpy as np
import pytest
from helpers import reference
from helpers.running import core_run, empty_log, prepared, stepped, unproved

from clunk.core import switching, tile
from clunk.core.rk4.propagator import rk4_growth
from clunk.core.status import INTERRUPTED, Status
from clunk.core.tables import OPEN
from clunk.simulation import driveline
from clunk.study.config import study_from_text

# An error that goes with h⁴ falls sixteenfold when the step halves. The next order leaves 16 ± 16 hλ, which is 0.6 for
# the contact mode (λ = 1640 1/s) at h = 2.5e-5 s, and an event's place on the time grid moves the error by less.
STEPS = (5e-5, 2.5e-5)
ROUNDING = 5e-12  # rad, rad/s: what 80,000 steps, each rounded by 1e-16 of less than 1 rad, may add up to


def errors_against(events, final_state, run):
    """Largest error of the event times, the states at the events and the final state."""
    assert run.kinds == [(event.kind, event.side) for event in events]
    return (
        np.max(np.abs(run.events["time"] - [event.time for event in events])),
        np.max(np.abs(run.states - [event.state for event in events])),
        np.max(np.abs(run.final_state - final_state)),
    )


def test_rk4_error_falls_sixteenfold_when_the_step_halves():
    """Between events: the contact mode rings out after a load that never opens the gap (σr = 1), 20 ms after it."""
    plant = reference.boere(1.0, 6.0)
    events, final_state = reference.run(plant, end_time=0.02)
    assert len(events) == 1
    errors = [
        np.max(np.abs(core_run(unproved(prepared(plant, step, 0.02)), plant).final_state - final_state))
        for step in (4e-4, 2e-4)
    ]
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.25)  # larger steps, for rounding not to show


@pytest.mark.parametrize("separation", ["gap", "force"])
@pytest.mark.parametrize(("ratio", "backlash"), [(2.0, 6.0), (5.0, 6.0), (10.0, 10.0), (10.0, 16.0)])
def test_the_error_falls_sixteenfold_across_located_events(ratio, backlash, separation):
    plant = reference.boere(ratio, backlash, separation=separation)
    events, final_state = reference.run(plant)
    coarse, fine = (
        errors_against(events, final_state, core_run(unproved(prepared(plant, step)), plant)) for step in STEPS
    )
    assert len(events) > 6
    for large, small in zip(coarse, fine, strict=True):
        assert large == pytest.approx(16.0 * small, rel=0.1, abs=16.0 * ROUNDING)


@pytest.mark.parametrize("steps", [1, 2, 7, 40])
@pytest.mark.parametrize("closed", [False, True])
def test_steps_equal_the_four_classical_stages(steps, closed):
    """Precomputed products, one step or several at once, and the remainder of a step, against Kutta's formula."""
    step = 1e-4
    plant = reference.boere(1.0, 6.0)
    damping, stiffness = plant.open_matrices()
    inertia, coupling, half = np.array(plant.inertias), np.outer(plant.twist, plant.twist), plant.backlash / 2
    if closed:
        side, x = plant.preload()
        damping = damping + plant.contact_damping * coupling
        stiffness = stiffness + plant.contact_stiffness * coupling
        constant = plant.after * plant.load + side * plant.contact_stiffness * half * plant.twist
    else:
        x = np.array([-0.01, 0.02, 0.01, 0.015, 0.1, -0.2, 0.3, 0.2])
        constant = plant.after * plant.load

    def slope(state):
        return np.concatenate([state[4:], (constant - stiffness @ state[:4] - damping @ state[4:]) / inertia])

    expected = x
    for length in [*[step] * steps, 0.3 * step]:
        k1 = slope(expected)
        k2 = slope(expected + length / 2 * k1)
        k3 = slope(expected + length / 2 * k2)
        k4 = slope(expected + length * k3)
        expected = expected + length / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    run = core_run(unproved(prepared(plant, step, (steps + 0.3) * step)), plant, state=x)
    assert len(run.events) == 1
    # rounding of h A x, whose terms reach 1e-4 s · 1.3e6 1/s² · 0.6 rad, and of so many steps
    assert run.final_state == pytest.approx(expected, rel=1e-12, abs=steps * 1e-13)


def test_growth_is_that_of_the_stability_polynomial():
    """RK4 is stable up to -2.785 on the real axis and 2√2 on the imaginary one (Hairer & Wanner, §IV.2)."""
    assert rk4_growth(np.array([-2.785 + 0j, 2.8284j]), 1.0) == pytest.approx([1.0, 1.0], abs=1e-3)
    assert np.all(rk4_growth(np.array([-2.79 + 0j, 2.83j]), 1.0) > 1.0)
    assert np.all(rk4_growth(np.array([-2.78 + 0j, 2.82j]), 1.0) < 1.0)


@pytest.mark.parametrize("steps", range(1, 14))
def test_a_touch_between_two_steps_that_both_end_in_the_gap_is_not_skipped(steps):
    """A free inertia thrown against a flank and pulled back at 1000 rad/s² reaches it halfway through a step.

    q = φ/2 + reach - a (t - t*)²/2 lies below the flank at both ends of that step, by 1.25e-6 rad less `reach`.
    Whichever step it is: full steps are taken one by one or in blocks.
    """
    step, pull, half = 1e-4, 1000.0, np.deg2rad(3.0)
    plant = reference.Plant(
        inertias=(0.01,),
        shafts=(),
        lash=(1, "ground"),
        contact_stiffness=100.0,
        contact_damping=0.1,
        after=-10.0,
        acceleration_of=1,
    )
    turn = (steps + 0.5) * step
    for reach in (1e-6, 1e-9, -1e-9, -1e-6):
        start = np.array([half + reach - pull * turn**2 / 2, pull * turn])
        run = core_run(prepared(plant, step, 0.01), plant, state=start)
        assert run.kinds[1:2] == ([("touch", 1)] if reach > 0.0 else [])
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
    events, _ = reference.run(plant)
    run = core_run(prepared(plant, step), plant)
    assert run.kinds == [(event.kind, event.side) for event in events]
    steps = np.floor(run.events["time"] / step)
    assert max(np.count_nonzero(steps == one) for one in steps) >= together


@pytest.mark.parametrize("share", [0.0, 0.6, 1.0, 2.0])
@pytest.mark.parametrize("separation", ["gap", "force"])
def test_contacts_of_any_damping_keep_their_events(share, separation):
    """From none to twice the critical damping of the contact mode; above a half, the force falls from the touch on."""
    nominal = reference.Plant()
    critical = 2.0 * np.sqrt(nominal.contact_stiffness * 0.001)  # of the two inertias at the lash in series
    plant = reference.boere(5.0, 6.0, separation=separation, contact_damping=share * critical)
    events, _ = reference.run(plant, end_time=0.4)
    run = core_run(prepared(plant, 5e-5, 0.4), plant)
    assert run.kinds == [(event.kind, event.side) for event in events]
    # T_c (ωh)⁴/120 = 1e-9 s late a contact period, and a hundred of those in 0.4 s
    assert run.events["time"] == pytest.approx([event.time for event in events], abs=1e-7)


@pytest.mark.parametrize("separation", ["gap", "force"])
def test_no_backlash_passes_from_flank_to_flank(separation):
    """φθ = 0: wherever the gap opens, the other flank is touched at that instant, to rounding of the time."""
    run = core_run(prepared(plant := reference.boere(7.0, 0.0, separation=separation)), plant)
    leaving = "separation" if separation == "gap" else "opening"
    pairs = [(here, there) for here, there in pairwise(range(len(run.events))) if run.kinds[here][0] == leaving]
    assert len(pairs) == 6
    for here, there in pairs:
        assert run.kinds[there] == ("touch", -run.kinds[here][1])
        assert run.events["time"][there] - run.events["time"][here] <= 1e-12


def test_every_transition_keeps_what_it_says_is_zero():
    """At each event the functional that ended the regime is zero, and so is the guard named as such."""
    for separation in ("gap", "force"):
        plant = reference.boere(8.0, 5.0, separation=separation)
        run = core_run(prepared(plant), plant)
        q = run.states[:, : plant.n] @ plant.twist
        speed = run.states[:, plant.n :] @ plant.twist
        overlap = run.events["side"] * q - plant.backlash / 2
        force = plant.contact_stiffness * overlap + plant.contact_damping * run.events["side"] * speed
        for k, (kind, _) in enumerate(run.kinds):
            if kind == "load step":
                continue
            assert run.events["speed"][k] == speed[k]
            by_force = kind == "rejoin" or (kind == "separation" and separation == "force")
            # a time located to its last digit leaves the speed times 1e-16 s, and rounding of q = θ3 - θ4
            assert abs(force[k] if by_force else overlap[k]) < (1e-12 if by_force else 1e-15)
        assert np.all(np.diff(run.events["time"]) > 0.0)


class TestHowARunEnds:
    plant = reference.boere(5.0, 6.0)

    def test_more_events_than_the_buffer_holds_is_said(self):
        run = core_run(prepared(self.plant), self.plant, capacity=10)
        assert run.status == Status.EVENT_BUFFER_FULL
        assert len(run.events) == 10
        assert not run.complete
        enough = core_run(prepared(self.plant), self.plant, capacity=19)  # 18 events and the load step
        assert enough.status == Status.OK
        assert len(enough.events) == 19

    @pytest.mark.parametrize("size", [1e300, 1e308, np.inf, np.nan])
    @pytest.mark.parametrize("where", range(8))
    def test_a_state_beyond_all_numbers_is_said_and_ends(self, where, size):
        x = np.zeros(8)
        x[where] = size
        run = core_run(prepared(self.plant), self.plant, state=x, regime=OPEN)
        assert run.status == Status.NON_FINITE
        assert not run.complete

    def test_a_step_beyond_the_stability_limit_is_said(self):
        """The contact mode, ω = 1623 1/s and ζ = 0.196, allows a step of 1.67 ms (RK4's limit at that angle)."""
        assert prepared(self.plant, 1.5e-3).steps.stable
        assert not prepared(self.plant, 2e-3).steps.stable
        for step, status in ((1.5e-3, Status.OK), (2e-3, Status.UNSTABLE_STEP)):
            system, _ = driveline.prepare(study_from_text(reference.config_of(self.plant, step)))
            assert system.status == status

    def test_the_end_in_the_middle_of_something_is_not_complete(self):
        run = core_run(prepared(self.plant, end_time=0.15), self.plant)  # between two primary impacts
        assert run.status == Status.OK
        assert not run.complete
        assert run.end == 0.15
        assert run.label == "CR(1)"

    def test_a_finished_run_stops_early_and_says_so(self):
        run = core_run(prepared(self.plant), self.plant)
        assert run.complete
        assert run.events["time"][-1] < run.end < 2.0

    def test_a_run_without_a_bound_goes_on_to_the_end(self):
        run = core_run(unproved(prepared(self.plant)), self.plant)
        assert run.status == Status.OK
        assert not run.complete
        assert run.end == 2.0

    def test_a_set_stop_flag_abandons_the_run(self):
        (system, steps), x, half_gap = prepared(self.plant), np.zeros(8), self.plant.backlash / 2
        _, regime = switching.preload(system, np.array([self.plant.before, half_gap, 0.0]), x)
        start = stepped(x, regime, -1.0, half_gap)
        status, *_ = tile.run(system, steps, start, empty_log(64, 8), np.ones(1, np.uint8))
        assert status == INTERRUPTED


@pytest.mark.parametrize("separation", ["gap", "force"])
def test_stopping_early_changes_nothing(separation):
    """What is proved complete stays so: five times the end time adds no event and no acceleration, on a 9 x 9 map."""
    short_run = prepared(reference.boere(5.0, 6.0, separation=separation))
    long = unproved(prepared(reference.boere(5.0, 6.0, separation=separation), end_time=10.0))
    for ratio in np.linspace(0.0, 10.0, 9):
        for backlash in np.linspace(0.0, 20.0, 9):
            plant = reference.boere(ratio, backlash, separation=separation)
            short, whole = core_run(short_run, plant), core_run(long, plant)
            assert short.complete
            assert np.array_equal(short.states, whole.states)
            for field in ("time", "speed", "kind", "side"):
                assert np.array_equal(short.events[field], whole.events[field])
            assert np.array_equal(short.impact_severity, whole.impact_severity)
            assert short.label == whole.label
