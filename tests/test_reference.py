"""The independent reference itself: closed forms of one and two inertias, and SciPy's DOP853 on random drivelines.

Loads, gear ratios and drivelines that roll. Closed forms hold to rounding, some 1e-12 of the largest angle; where
rounding is magnified by chatter, runs are compared as far as two runs that start a share of 1e-8 apart agree.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from helpers import general, margins, reference
from helpers.randomplants import general_plants, nudged
from helpers.reference import Mode, Plant, lag, pulse, ramp, run, sine, smooth, step, table
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

PROFILES = {
    "step": step(),
    "ramp": ramp(0.3),
    "smooth": smooth(0.25),
    "lag": lag(0.08),
    "a lag of half a contact period": lag(2e-3),
    "pulse": pulse(0.2),
    "table": table((0.0, 0.05, 0.05, 0.2, 0.3, 0.3), (-6.0, -4.0, -2.0, -3.0, -3.0, -1.0)),
    "table that jumps at 0": table((0.0, 0.0, 0.1), (-6.0, -4.0, -1.0)),
    "sine": sine(3.0, 5.0, 0.3),
}


def kinds_of(events):
    return [(event.kind, event.side) for event in events]


def times_of(events):
    return np.array([event.time for event in events])


# Closed forms of one inertia held to ground

INERTIA, DAMPING, STIFFNESS = 0.01, 0.05, 30.0
POLES = np.roots([INERTIA, DAMPING, STIFFNESS])


def to_wave(rate, t):
    """(θ, θ', θ'') from rest under exp(rate t) from t = 0 on, complex: partial fractions of 1/((s - rate) P(s))."""
    amplitude = 1.0 / np.polyval([INERTIA, DAMPING, STIFFNESS], rate)
    terms = [(amplitude, rate), *((1.0 / ((2.0 * INERTIA * p + DAMPING) * (p - rate)), p) for p in POLES)]
    return (t >= 0.0) * np.array([sum(a * p**k * np.exp(p * np.abs(t)) for a, p in terms) for k in range(3)])


def to_slope(t):
    """(θ, θ', θ'') from rest under the torque t from t = 0 on: partial fractions of 1/(s² P(s))."""
    terms = [(1.0 / ((2.0 * INERTIA * p + DAMPING) * p**2), p) for p in POLES]
    straight = [t / STIFFNESS - DAMPING / STIFFNESS**2, 1.0 / STIFFNESS, 0.0]
    waves = [sum(a * p**k * np.exp(p * np.abs(t)) for a, p in terms) for k in range(3)]
    return (t >= 0.0) * np.array([line + wave.real for line, wave in zip(straight, waves, strict=True)])


def to_step(t):
    return to_wave(0.0, t).real


def by_hand(profile, before, after, t):
    """(3, T): θ, θ', θ'' of the inertia at the times t, from rest under `before`, by superposition."""
    change, d, t = after - before, profile.duration, np.atleast_1d(t)
    rest = np.array([[before / STIFFNESS], [0.0], [0.0]])
    match profile.name:
        case "step":
            moved = change * to_step(t)
        case "ramp":
            moved = change / d * (to_slope(t) - to_slope(t - d))
        case "smooth":  # 1 - cos(πt/d), and the same again from d on, which makes 2
            bumps = [to_step(u) - to_wave(1j * np.pi / d, u).real for u in (t, t - d)]
            moved = change / 2.0 * (bumps[0] + bumps[1])
        case "lag":
            moved = change * (to_step(t) - to_wave(-1.0 / profile.time_constant, t).real)
        case "pulse":
            moved = change * (to_step(t) - to_step(t - d))
        case "table":
            moved, knots = 0.0, list(zip(profile.times, profile.torques, strict=True))
            for (begin, torque), (end, following) in pairwise(knots):
                if end == begin:
                    moved = moved + (following - torque) * to_step(t - begin)
                else:
                    slope = (following - torque) / (end - begin)
                    moved = moved + slope * (to_slope(t - begin) - to_slope(t - end))
        case "sine":
            omega = 2.0 * np.pi * profile.frequency
            swing = profile.amplitude * (np.exp(1j * profile.phase) * to_wave(1j * omega, t)).imag
            moved = change * to_step(t) + swing
    return rest + moved


def held_inertia(profile, **changes):
    """One inertia on a shaft to ground, in a gap that it never leaves, and its state at rest."""
    plant = Plant(
        inertias=(INERTIA,),
        shafts=((1, "ground", STIFFNESS, DAMPING),),
        lash=(1, "ground"),
        backlash=100.0,
        acceleration_of=1,
        profile=profile,
        **changes,
    )
    return plant, np.array([plant.before / STIFFNESS, 0.0])


@pytest.mark.parametrize("name", PROFILES)
class TestOneInertiaToGround:
    @pytest.mark.parametrize("end_time", [0.03, 0.2, 0.3, 0.47])
    def test_its_motion_is_the_closed_form(self, name, end_time):
        plant, state = held_inertia(PROFILES[name])
        _, final = run(plant, end_time, state)
        assert final == pytest.approx(by_hand(plant.profile, plant.before, plant.after, end_time)[:2, 0], abs=2e-12)

    def test_its_acceleration_takes_both_limits_at_a_jump(self, name):
        """Sampled on either side of kinks and at every 20 µs: (55 rad/s · 10 µs)²/2 = 1.5e-7 of its size off a peak."""
        plant, state = held_inertia(PROFILES[name])
        (event,), _ = run(plant, 0.5, state)
        corners = [t + side for t in general.kinks(plant) for side in (-1e-12, 0.0)]
        times = np.concatenate([np.linspace(0.0, 0.5, 25001), corners])
        samples = by_hand(plant.profile, plant.before, plant.after, times)[2]
        scale = np.ptp(samples)
        assert event.largest == pytest.approx(max(samples), abs=3e-7 * scale)
        assert event.smallest == pytest.approx(min(samples), abs=3e-7 * scale)

    def test_it_ends_where_it_would_without_the_lash_in_a_gear(self, name):
        """Ground as the first end of lash and shaft, and a ratio: the twist is -ratio θ."""
        plant, state = held_inertia(PROFILES[name])
        geared = replace(
            plant,
            shafts=(("ground", 1, STIFFNESS / 9.0, DAMPING / 9.0),),
            ratios=(-3.0,),
            lash=("ground", 1),
            lash_ratio=0.5,
        )
        assert geared.twist == [-0.5]
        assert run(geared, 0.4, state)[1] == pytest.approx(run(plant, 0.4, state)[1], abs=2e-12)


def test_the_acceleration_on_either_side_of_a_jump_counts():
    """A pulse that ends at a turning point: the acceleration there jumps from one extreme to the other."""
    period = 2.0 * np.pi / POLES[0].imag
    plant, state = held_inertia(pulse(1.5 * period), before=-1.0, after=4.0)
    (event,), _ = run(plant, 1.0, state)
    before = by_hand(plant.profile, -1.0, 4.0, 1.5 * period - 1e-13)[2, 0]
    assert event.smallest == pytest.approx(before - 5.0 / INERTIA, rel=1e-9)
    (event,), _ = run(plant, 1.5 * period, state)
    assert event.smallest > before - 0.5 * 5.0 / INERTIA


def test_the_wall_at_which_a_forced_oscillator_grazes():
    """k = 1, c = 0.1, ω = 1, a wall at 1: torques of amplitude 0.1 reach it (COCO, Recipes for Continuation, 15.2)."""

    def touches(amplitude):
        """Begun on the steady oscillation, θ = -10 A cos t."""
        plant = Plant(
            inertias=(1.0,),
            shafts=((1, "ground", 1.0, 0.1),),
            lash=(1, "ground"),
            backlash=2.0,
            before=0.0,
            after=0.0,
            acceleration_of=1,
            restitution=0.8,
            profile=sine(amplitude, 0.5 / np.pi),
        )
        events, _ = run(plant, 20.0, np.array([-10.0 * amplitude, 0.0]))
        return len(events) > 1

    assert not touches(0.1 * (1.0 - 1e-10))
    assert touches(0.1 * (1.0 + 1e-10))


# Profiles that are one another

NOMINAL = reference.boere(5.0, 6.0)


@pytest.mark.parametrize("profile", [ramp(0.0), smooth(0.0), lag(0.0), table((0.0, 0.0), (-6.0, -1.0))])
def test_a_load_that_changes_in_no_time_is_a_step(profile):
    assert replace(NOMINAL, profile=profile).pieces == NOMINAL.pieces


@pytest.mark.parametrize("profile", [pulse(0.0), table((0.0,), (-6.0,)), table((0.0, 1.0), (-6.0, -6.0))])
def test_a_load_that_does_not_change_leaves_the_driveline_at_rest(profile):
    plant = replace(NOMINAL, profile=profile)
    (event,), final = run(plant, 1.0)
    assert final == pytest.approx(event.state, abs=1e-10)  # the constant load is off by some 1e-14 a block


@pytest.mark.parametrize("damping", [0.0, 0.5], ids=["undamped", "damped"])
def test_a_rigid_flank_that_nothing_presses_any_more_stays_closed(damping):
    """Its torque is rounding, which undamped shafts build up; the least pull parts it at once."""
    shafts = (1, 2, 30.0, damping), (2, 3, 110.25, damping)
    plant = Plant((0.03, 0.004, 0.01), shafts, (1, "ground"), after=0.0, acceleration_of=1, restitution=0.0)
    (event,), final = run(plant, 0.5)
    assert final == pytest.approx(event.state, abs=1e-12)
    pulled, _ = run(nudged(plant, None, 1e-10)[0], 0.1)
    assert kinds_of(pulled)[1] == ("separation", -1)
    assert pulled[1].time == 0.0


def test_a_short_ramp_is_a_step_half_its_duration_later():
    """What the ramp does to the state after it differs by the square of the duration; chatter magnifies that."""
    until = 0.13  # s: separation, the first crossing and its first rebounds
    at_once = times_of(run(NOMINAL, until)[0])[1:4]
    late = [times_of(run(replace(NOMINAL, profile=ramp(d)), until)[0])[1:4] - d / 2 - at_once for d in (1e-3, 5e-4)]
    assert np.abs(late[1]).max() < 5e-4**2
    assert late[0] / late[1] == pytest.approx(4.0, rel=0.02)  # by halving


@pytest.mark.parametrize("duration", [0.05, 0.3])
def test_a_table_of_two_torques_is_the_ramp(duration):
    ramped, tabled = (replace(NOMINAL, profile=p) for p in (ramp(duration), table((0.0, duration), (-6.0, -1.0))))
    assert ramped.pieces == tabled.pieces
    one, other = (run(plant, 0.5) for plant in (ramped, tabled))
    assert times_of(one[0]).tolist() == times_of(other[0]).tolist()
    assert one[1].tolist() == other[1].tolist()


def test_knots_on_a_straight_line_change_nothing():
    times = np.linspace(0.0, 0.1, 101)
    tabled = replace(NOMINAL, profile=table(times, -6.0 + 50.0 * times))
    one, other = run(replace(NOMINAL, profile=ramp(0.1)))[0], run(tabled)[0]
    assert kinds_of(one) == kinds_of(other)
    assert times_of(one) == pytest.approx(times_of(other), abs=1e-12)
    primaries = reference.primary_impacts(one, NOMINAL.contact_period())
    assert reference.severities(one, primaries) == pytest.approx(reference.severities(other, primaries), rel=1e-10)


@pytest.mark.parametrize("times", [(0.1, 0.2), (0.0, 0.2, 0.1), (0.0, 0.1, 0.1, 0.1)])
def test_a_table_whose_times_make_no_sense_is_refused(times):
    with pytest.raises(ValueError, match="times"):
        table(times, [1.0] * len(times))


# Labels of the nominal driveline over how long the load takes, separation by gap


@pytest.mark.parametrize("row", reference.THRESHOLDS, ids=lambda row: f"{row[1].__name__} at {row[0]}")
def test_the_labels_change_at_these_durations(row):
    """To 2e-8 s; there an excursion only just reaches a flank or a contact only just opens, so the margin is zero."""
    ratio, profile, *sequence = row
    for before, edge, after in zip(sequence[::2], sequence[1::2], sequence[2::2], strict=False):
        for label, duration in ((before, edge - 2e-8), (after, edge + 2e-8)):
            plant = reference.boere(ratio, 6.0, profile=profile(duration))
            events, _ = run(plant)
            assert reference.label(events, reference.primary_impacts(events, plant.contact_period())) == label
        assert abs(margins.margin(plant, events, 2.0, plant.contact_period()).margin) < 2e-5


# Gear ratios

RATIO = 3.7
GEARED = Plant(
    inertias=(0.024, 0.002, 0.002, 0.0274, 0.05),
    shafts=(
        (1, 2, 31.3, 0.08),
        (2, 3, 31.3, 0.04),
        (4, 5, 31.3 * RATIO**2, 0.1 * RATIO**2),
        (5, "ground", 60.0, 0.9),
        (1, "ground", 20.0, 0.1),
    ),
    lash=(3, 4),
    lash_ratio=RATIO,
    before=-9.0,
    after=6.0,
    profile=pulse(0.1),
)


def reflected(plant, ratio, behind):
    """The same driveline without its gear: what is behind it, with angles `ratio` times as large.

    Inertias, stiffnesses and dampings there are divided by the ratio's square, a torque there by the ratio.
    """

    def behind_gear(*ends):
        return all(end == "ground" or end in behind for end in ends)

    share = ratio**-2
    return replace(
        plant,
        inertias=tuple(J * share if k in behind else J for k, J in enumerate(plant.inertias, 1)),
        shafts=tuple(
            (one, other, k * share, c * share) if behind_gear(one, other) else (one, other, k, c)
            for one, other, k, c in plant.shafts
        ),
        ratios=(),
        lash_ratio=1.0,
        before=plant.before / (ratio if plant.loaded in behind else 1.0),
        after=plant.after / (ratio if plant.loaded in behind else 1.0),
    )


@pytest.mark.parametrize("contact", [{"separation": "gap"}, {"separation": "force"}, {"restitution": 0.5}], ids=str)
@pytest.mark.parametrize(
    ("place", "loaded", "ratio", "rolls"),
    [
        ("lash", 1, RATIO, False),
        ("lash", 1, -RATIO, True),
        ("lash", 5, RATIO, True),
        ("lash", 5, -RATIO, False),
        ("shaft", 1, RATIO, True),
        ("shaft", 1, -RATIO, False),
    ],
)
def test_a_gear_is_that_driveline_reflected_by_hand(place, loaded, ratio, rolls, contact):
    behind = (4, 5) if place == "lash" else (3, 4, 5)
    plant = replace(GEARED, loaded=loaded, **contact)
    if place == "shaft":
        plant = replace(plant, ratios=(1.0, ratio, 1.0, 1.0, 1.0), lash_ratio=1.0, contact_stiffness=2e4)
    else:
        plant = replace(plant, lash_ratio=ratio)
    if rolls:
        plant = replace(plant, shafts=(*plant.shafts[:3], (5, "ground", 0.0, 0.5), (1, "ground", 0.0, 0.1)))
    by_reflection = reflected(plant, ratio, behind)
    if place == "shaft":  # the lash is behind the gear, and its twist as many times as large
        by_reflection = replace(
            by_reflection,
            contact_stiffness=plant.contact_stiffness / ratio**2,
            contact_damping=plant.contact_damping / ratio**2,
            backlash=plant.backlash * abs(ratio),
        )
    turned = -1 if place == "shaft" and ratio < 0.0 else 1  # a reversing gear turns the flanks round
    scale = np.array([ratio if k in behind else 1.0 for k in range(1, 6)] * 2)
    assert plant.contact_period() == pytest.approx(by_reflection.contact_period(), rel=1e-14)
    (one, _), (other, _) = run(plant, 0.35), run(by_reflection, 0.35)
    assert len(one) > 5
    assert kinds_of(one) == [(event.kind, turned * event.side) for event in other]
    assert times_of(one) == pytest.approx(times_of(other), abs=1e-11)
    rolled = np.array([1.0] * 5 + [0.0] * 5) if rolls else np.zeros(10)
    for geared, straight in zip(one, other, strict=True):
        seen = scale * geared.state
        seen += rolled * (straight.state - seen)[0]  # where the rigid-body angle is zero is a choice
        assert seen == pytest.approx(straight.state, abs=1e-8)


# Drivelines that roll

CHAIN = Plant(
    inertias=(0.03, 0.02),
    shafts=(),
    lash=(1, 2),
    contact_stiffness=2000.0,
    contact_damping=0.0,
    backlash=0.05,
    before=-6.0,
    after=1.0,
    acceleration_of=1,
)


def chain_by_hand(plant):
    """(time, q') of the first separation and of the touch that follows, of two free inertias and no damper.

    In contact the indentation x swings about J_red T / (J1 k) with ω² = k/J_red; in the gap q'' = T/J1.
    """
    (first, second), k, side = plant.inertias, plant.contact_stiffness, np.sign(plant.before)
    reduced = 1.0 / (1.0 / first + 1.0 / second)
    omega = np.sqrt(k / reduced)
    start, centre = (side * reduced * torque / (first * k) for torque in (plant.before, plant.after))
    swing = np.arccos(-centre / (start - centre))  # from the turning point `start` until x = 0
    speed = -side * (start - centre) * omega * np.sin(swing)
    apart = plant.after / first
    # q runs over the whole gap: speed t + apart t²/2 = -side φ
    until = np.roots([0.5 * apart, speed, side * plant.backlash])
    after = min(t.real for t in until if abs(t.imag) < 1e-12 and t.real > 0.0)
    return (swing / omega, speed), (swing / omega + after, speed + apart * after)


@pytest.mark.parametrize("torques", [(-6.0, 1.0), (6.0, -1.0), (-2.0, 4.0)])
def test_two_free_inertias_accelerate_steadily_part_and_meet_as_by_hand(torques):
    plant = replace(CHAIN, before=torques[0], after=torques[1])
    events, _ = run(plant, 0.2)
    assert events[0].side == np.sign(torques[0])
    (parted, leaving), (met, closing) = chain_by_hand(plant)
    assert kinds_of(events)[1:3] == [("separation", events[0].side), ("touch", -events[0].side)]
    assert times_of(events)[1:3] == pytest.approx([parted, met], abs=1e-13)
    assert [event.speed for event in events[1:3]] == pytest.approx([leaving, closing], rel=1e-12)


def test_a_free_chain_starts_at_rest_under_the_torque_that_accelerates_what_is_behind_the_lash():
    side, state = CHAIN.preload()
    assert side == -1
    assert state[2:].tolist() == [0.0, 0.0]
    contact = CHAIN.contact_stiffness * (state[0] - state[1] + CHAIN.backlash / 2)
    assert contact == pytest.approx(-6.0 * 0.02 / (0.03 + 0.02), rel=1e-12)


def test_what_resists_sets_the_speed_and_carries_its_share():
    """A reversing gear of 2 and three bearings: Ω = T Σ / (c1 + 4 c3 + …), by powers."""
    plant = Plant(
        inertias=(0.03, 0.01, 0.02),
        shafts=((1, 2, 40.0, 0.3), (1, "ground", 0.0, 0.01), (3, "ground", 0.0, 0.02), (1, 3, 0.0, 0.005)),
        ratios=(-2.0, 1.0, 1.0, 1.0),
        lash=(2, 3),
        before=-6.0,
        acceleration_of=2,
    )
    side, state = plant.preload()
    # θ1' = -2 θ2', θ2' = θ3'; the damper between 1 and 3 slips by -3 θ3'
    slow = -6.0 * -2.0 / (0.01 * 4.0 + 0.02 + 0.005 * 9.0)
    assert state[3:] == pytest.approx([-2.0 * slow, slow, slow], rel=1e-12)
    passed = 0.02 * slow - 0.005 * -3.0 * slow  # into inertia 3: its bearing, and the damper's torque the other way
    assert side == np.sign(passed)
    contact = plant.contact_stiffness * (state[1] - state[2] - side * plant.backlash / 2)
    assert contact == pytest.approx(passed, rel=1e-10)


@pytest.mark.parametrize(
    "plant",
    [
        replace(CHAIN, after=-6.0, contact_damping=1.0),
        replace(CHAIN, after=-6.0, shafts=((2, "ground", 0.0, 0.01),)),
        replace(CHAIN, after=-6.0, shafts=((2, "ground", 0.0, 0.01),), restitution=0.5),
        replace(CHAIN, after=-6.0, shafts=((2, "ground", 0.0, 0.001),), lash_ratio=-3.7),
    ],
    ids=["accelerating", "at constant speed", "with rigid contact", "geared, and fast"],
)
def test_the_steady_motion_goes_on_for_ever_without_rounding(plant):
    """5 s, up to 4e5 rad, of which rounding alone is 5e-11 rad: the twist is that of the beginning to less.

    The speed is off by some 1e-14 of its size a block, 1e-11 in all (measured: 7e-12), so the torque that a bearing
    takes from it is, and so the indentation of 0.003 rad that passes it on. Rigid flanks add rounding up in time.
    """
    (event,), final = run(plant, 5.0)
    speeds, accelerations = plant.steady_speeds(-6.0)
    assert final[2:] == pytest.approx(speeds + 5.0 * accelerations, rel=1e-10)
    assert final[:2] == pytest.approx(event.state[:2] + 5.0 * speeds + 12.5 * accelerations, rel=1e-10)
    assert event.largest - event.smallest < 1e-10 * 6.0 / min(plant.inertias)
    flow = reference.Flow(plant)
    regime = flow.regime(0, event.modes)
    z = flow.augmented(event.coordinates, 0, 0.0)
    for _ in range(int(5.0 / (reference.BLOCK * regime.cell))):
        z = regime.powers[-1] @ z
    indentation = 6.0 / plant.contact_stiffness
    rounding = 2e-11 * indentation if plant.restitution is None else 1e-10
    assert flow.rows[0] @ z[:2] == pytest.approx(plant.twist @ event.state[:2], abs=rounding)


def test_events_are_the_same_seen_from_a_frame_that_moves():
    """At 8192 rad/s more, angles grow to 3000 rad; the rate of the twist is good to 1e-12 rad/s at first."""
    side, state = CHAIN.preload()
    one, _ = run(CHAIN, 0.4)
    other, final = run(CHAIN, 0.4, state + np.array([0.0, 0.0, 8192.0, 8192.0]), Mode("closed", side))
    assert kinds_of(one) == kinds_of(other)
    assert len(one) > 10
    assert times_of(one) == pytest.approx(times_of(other), abs=1e-12)
    assert final[0] > 3000.0


class TestRigidMotions:
    def test_a_loop_whose_ratios_fit_rolls(self):
        plant = replace(
            CHAIN,
            inertias=(0.03, 0.02, 0.01),
            shafts=((1, 3, 30.0, 0.0), (3, 2, 30.0, 0.0)),
            ratios=(-2.0, 0.3),
            lash_ratio=-0.6,
        )
        assert plant.rigid_motion.shape == (3, 1)
        r = plant.rigid_motion[:, 0] / plant.rigid_motion[0, 0]
        assert r == pytest.approx([1.0, -1.0 / 0.6, -0.5], rel=1e-12)

    def test_a_loop_whose_ratios_do_not_fit_is_at_rest(self):
        plant = replace(
            CHAIN,
            inertias=(0.03, 0.02, 0.01),
            shafts=((1, 3, 30.0, 0.0), (3, 2, 30.0, 0.0)),
            ratios=(-2.0, 0.3),
            lash_ratio=-0.7,
        )
        assert plant.rigid_motion.size == 0
        _, state = plant.preload()
        assert state[3:].tolist() == [0.0] * 3

    def test_two_parts_that_nothing_joins_are_refused(self):
        plant = replace(CHAIN, inertias=(0.03, 0.02, 0.01), shafts=((2, 3, 0.0, 0.5),))
        with pytest.raises(ValueError, match="more than one rigid-body motion"):
            plant.preload()

    def test_a_lash_that_carries_nothing_has_no_initial_flank(self):
        """The loose inertia behind it is neither accelerated nor dragged."""
        plant = replace(CHAIN, shafts=((1, "ground", 0.0, 0.1),))
        with pytest.raises(ValueError, match="no flank"):
            plant.preload()
        replace(plant, shafts=(*plant.shafts, (2, "ground", 0.0, 1e-3))).preload()


# Random drivelines

SEARCH = {"deadline": None, "phases": [Phase.generate], "suppress_health_check": list(HealthCheck), "derandomize": True}
CONTACTS = st.none() | st.sampled_from([0.0, 0.3, 0.5, 0.7])
END_TIME = 0.2  # s


def rates_of_change(plant, state, side):
    """The accelerations that the torque before the load step gives a state, from general's equations of motion."""
    lash = general.OneLash(replace(plant, profile=step(), after=plant.before))
    return lash.slope(0.0, state, ("closed", side))[plant.n :]


@settings(max_examples=50, **SEARCH)
@given(CONTACTS.flatmap(general_plants))
def test_the_motion_before_the_load_step_is_steady(drawn):
    """No joint with stiffness turns, no acceleration but the rigid body's, and the flanks are pressed together."""
    plant, state = drawn
    if state is not None:
        return
    side, state = plant.preload()
    theta, speeds = state[: plant.n], state[plant.n :]
    for row, k, _ in [*plant.joints(), (plant.twist, 1.0, 0.0)]:
        if k > 0.0:
            assert row @ speeds == pytest.approx(0.0, abs=1e-12 * max(np.abs(speeds).max(), 1.0))
    lash = general.OneLash(replace(plant, profile=step(), after=plant.before))
    assert lash.contact(0.0, state, side) > 0.0
    scale = plant.contact_stiffness * max(np.abs(theta).max(), 1.0) / min(plant.inertias)
    _, accelerations = plant.steady_speeds(plant.before)
    assert rates_of_change(plant, state, side) == pytest.approx(accelerations, abs=1e-12 * scale)


def agrees_with_dop853(plant, state):
    """Compare events as far as 1e-8 of what a run starts from does not matter to them."""
    moved, moved_state = nudged(plant, state, 1e-8)
    try:
        events, _ = run(plant, END_TIME, state, max_events=300)
        others, _ = run(moved, END_TIME, moved_state, max_events=300)
    except RuntimeError:
        return
    expected = general.run(plant, END_TIME, state, most=12)
    for (kind, side, time, speed), event, other in zip(expected, events[1:], others[1:], strict=False):
        apart = abs(event.time - other.time)
        if apart > 1e-5 or END_TIME - time < 1e-6 or (event.kind, event.side) != (other.kind, other.side):
            return
        if kind == "touch" and abs(speed) < 1e-2:
            return  # 1e-11 rad of dense output move it by more than 1e-9 s
        assert (event.kind, event.side) == (kind, side), f"at {time} s"
        assert abs(event.time - time) <= 1e-9 + 0.01 * apart, f"{kind} at {time} s"
        rounding = 1e-6 * max(abs(speed), 1.0) + 0.01 * abs(event.speed - other.speed)
        assert event.speed == pytest.approx(speed, abs=rounding)
    assert len(expected) == 12 or len(events) == 1 + len(expected) or len(events) != len(others)


class TestRandomDrivelines:
    @settings(max_examples=6, **SEARCH)
    @given(general_plants())
    def test_indentation_by_a_general_integrator(self, drawn):
        agrees_with_dop853(*drawn)

    @settings(max_examples=6, **SEARCH)
    @given(st.sampled_from([0.0, 0.3, 0.5, 0.7]).flatmap(general_plants))
    def test_restitution_by_a_general_integrator(self, drawn):
        agrees_with_dop853(*drawn)

    @pytest.mark.slow
    @settings(max_examples=300, **{**SEARCH, "derandomize": False})
    @given(CONTACTS.flatmap(general_plants))
    def test_many_by_a_general_integrator(self, drawn):
        agrees_with_dop853(*drawn)
