"""Problems of others, with answers that nobody here wrote: closed forms and stored results, each with its source."""

import math
from dataclasses import replace

import pytest
from helpers import reference
from helpers.agreement import exact
from helpers.reference import Plant, sine
from scipy.integrate import quad

from clunk.core.events import OPENING, SEPARATION, TOUCH

# Event times of the exact method are good to 1e-12 s; RK4 at a step h of these problems (|λ| <= 320 1/s) is off by some
# (|λ| h)^4 / 120 of a time scale of 10 ms: 1e-12 s at 1e-5 s, which its sums of rounding over 4,000 steps exceed.
METHODS = {"exact": 1e-12, "rk4": 1e-10}


BACKLASH = Plant(
    inertias=(5.0,),
    shafts=(),
    lash=(1, "ground"),
    contact_stiffness=2.0e4,
    contact_damping=50.0,
    backlash=math.pi / 4,
    before=0.0,
    after=0.0,
    acceleration_of=1,
    separation="force",
)


@pytest.fixture(params=METHODS)
def method(request):
    return request.param


def events_of(run, kind):
    """Time and speed of a run's events of one kind."""
    events = run.events[run.events["kind"] == kind]
    return list(zip(events["time"].tolist(), events["speed"].tolist(), strict=True))


def test_backlash_to_ground_with_spring_and_damper(method):
    """Modelica Standard Library 4.1, Mechanics.Rotational.Examples.Backlash: J = 5, c = 2e4, d = 50, b = π/4 whole.

    From φ = π/2 at rest, no load: the flank's torque c (φ - b/2) + d φ' vanishes at the first zero of an oscillation
    started at the overlap 3π/8; from there on the inertia coasts. The stored trajectory (tolerance 1e-6) has the speed
    -66.196495 rad/s and the other flank at 0.038023866 s.
    """
    inertia, stiffness, damping, gap = 5.0, 2.0e4, 50.0, math.pi / 4
    run = exact(BACKLASH, [math.pi / 2, 0.0], 0.04, method, step=1e-5)
    decay, overlap = damping / (2.0 * inertia), math.pi / 2 - gap / 2
    omega = math.sqrt(stiffness / inertia - decay**2)
    # overlap e^(-σt) (cos ωt + σ/ω sin ωt), its slope, and c x + d x' = 0: tan ωt = -c ω / (c σ - d (σ² + ω²))
    leaves = math.atan2(stiffness * omega, damping * (decay**2 + omega**2) - stiffness * decay) / omega
    damped = overlap * math.exp(-decay * leaves)
    left = damped * (math.cos(omega * leaves) + decay / omega * math.sin(omega * leaves))
    speed = -damped * (omega + decay**2 / omega) * math.sin(omega * leaves)
    assert (leaves, speed) == pytest.approx((0.02365921584, -66.19661798), rel=1e-9)  # as published, to its digits

    within = {"abs": METHODS[method], "rel": METHODS[method]}
    ((time, closing),) = events_of(run, SEPARATION)
    assert (time, closing) == pytest.approx((leaves, speed), **within)
    ((opens, _),) = events_of(run, OPENING)
    assert opens == pytest.approx(leaves - left / speed, **within)
    assert opens == pytest.approx(0.02615921584, abs=5e-12)
    ((touches, closing), *_) = events_of(run, TOUCH)
    assert touches == pytest.approx(0.03802384258, abs=5e-12 + METHODS[method])
    assert closing == pytest.approx(speed, **within)


def test_the_same_with_flanks_that_part_where_the_gap_opens(method):
    """At the first zero of the overlap, 3π/8 e^(-σt) (cos ωt + σ/ω sin ωt)."""
    run = exact(replace(BACKLASH, separation="gap"), [math.pi / 2, 0.0], 0.04, method, step=1e-5)
    decay = 50.0 / (2.0 * 5.0)
    omega = math.sqrt(2.0e4 / 5.0 - decay**2)
    opens = (math.pi - math.atan2(omega, decay)) / omega
    speed = -3.0 * math.pi / 8.0 * math.exp(-decay * opens) * (omega + decay**2 / omega) * math.sin(omega * opens)
    assert (opens, speed) == pytest.approx((0.0261697, -65.371), rel=1e-5)  # as written down
    ((time, leaving),) = events_of(run, SEPARATION)
    assert (time, leaving) == pytest.approx((opens, speed), rel=METHODS[method])


def test_spring_under_gravity_on_a_floor(method):
    """Siconos tutorials, BouncingBallEventDriven/LinearOscillatorED: m = 1e-3, k = 100, g = 9.81, e = 0.9, x = 1.

    x = (1 + g/ω²) cos ωt - g/ω² reaches the floor x = 0 at cos ωt = (g/ω²) / (1 + g/ω²). Here the floor is the lower
    flank of a gap of 2 rad, q = x - 1, so that the load also holds the spring's other end up.
    """
    mass, stiffness, gravity, restitution = 1e-3, 100.0, 9.81, 0.9
    plant = Plant(
        inertias=(mass,),
        shafts=((1, "ground", stiffness, 0.0),),
        lash=(1, "ground"),
        backlash=2.0,
        before=-200.0,
        after=-(mass * gravity + stiffness * 1.0),
        acceleration_of=1,
        restitution=restitution,
    )
    run = exact(plant, [0.0, 0.0], 0.012, method, step=1e-5)
    omega = math.sqrt(stiffness / mass)
    sag = gravity / omega**2
    impact = math.acos(sag / (1.0 + sag)) / omega
    speed = -omega * (1.0 + sag) * math.sin(omega * impact)
    assert (impact, speed) == pytest.approx((0.0049669839438886, -316.2587864392), rel=1e-12)

    times, speeds = zip(*events_of(run, TOUCH), strict=True)
    assert times[0] == pytest.approx(impact, abs=METHODS[method])
    assert speeds[0] == pytest.approx(speed, rel=METHODS[method])
    after = run.states[run.events["kind"] == TOUCH][0]
    assert after[1] == pytest.approx(284.6329077953, rel=1e-12 + METHODS[method])  # -e times the speed before


@pytest.mark.parametrize(("off", "touches"), [(-1e-8, 0), (1e-8, 1)])
def test_a_forced_oscillator_grazes_its_wall(method, off, touches):
    """COCO, Recipes for Continuation, example 15.2: k = 1, c = 0.1, ω = 1, a wall at 1, e = 0.8; grazing at A = 0.1.

    By linear theory A = √((k - ω²)² + (c ω)²). From the steady oscillation, -A/(c ω) cos t, begun at its far end; a
    constant torque of 1 has its middle 1 from one flank of a gap of 4, and 3 from the other.
    """
    stiffness, damping, omega = 1.0, 0.1, 1.0
    amplitude = math.hypot(stiffness - omega**2, damping * omega) * (1.0 + off)
    plant = Plant(
        inertias=(1.0,),
        shafts=((1, "ground", stiffness, damping),),
        lash=(1, "ground"),
        backlash=4.0,
        before=1.0,
        after=1.0,
        acceleration_of=1,
        restitution=0.8,
        profile=sine(amplitude, omega / (2.0 * math.pi)),
    )
    run = exact(plant, [1.0 - 10.0 * amplitude, 0.0], 6.0, method, step=1e-3)
    events = events_of(run, TOUCH)
    assert len(events) == touches
    if method == "exact" and not touches:
        assert run.margin == pytest.approx((1.0 - 10.0 * amplitude) / 4.0, abs=1e-14)  # of the whole gap
    for time, speed in events:  # a share `off` below the crest cos u = 1, whose speed is 10 A sin u
        before_crest = math.acos(1.0 / (1.0 + off))
        assert time == pytest.approx(math.pi - before_crest, abs=1e-8)
        assert speed == pytest.approx(math.sin(before_crest), rel=1e-4)


def test_tip_in_through_the_lash(method):
    """A. Lagerberg, Chalmers R005/2007; parameters as stored with CORA (models/Cora/powertrain), open loop.

    Motor 0.3 kg m², ratio 12, half gap 0.03 rad behind the gear, k = 1e4, then 0.01 kg m² with drag 1, 1e5 N m/rad, and
    140 kg m² with drag 5.6. The torque goes from -5 to 5 N m with a lag of 0.1 s: the gap is crossed, without return.
    In it the motor is alone with T = 5 - 10 exp(-t/0.1), and the load coasts.
    """
    lag, drag, load_inertia, motor_inertia, ratio = 0.1, 6.6, 140.01, 0.3, 12.0
    plant = Plant(
        inertias=(motor_inertia, 0.01, 140.0),
        shafts=((2, 3, 1e5, 0.0), (2, "ground", 0.0, 1.0), (3, "ground", 0.0, 5.6)),
        lash=(2, 1),
        lash_ratio=1.0 / ratio,
        backlash=0.06,
        contact_stiffness=1e4,
        contact_damping=0.0,
        before=-5.0,
        after=5.0,
        acceleration_of=2,
        profile=reference.lag(lag),
    )
    run = exact(plant, None, 2.0, method)
    assert set(run.flanks) == {1}
    (parted, _), *_ = events_of(run, SEPARATION)
    (met, closing), *_ = events_of(run, TOUCH)
    at_separation = run.states[run.events["kind"] == SEPARATION][0][3:]

    def twist_rate(time):
        impulse = 5.0 * (time - parted) + 10.0 * lag * (math.exp(-time / lag) - math.exp(-parted / lag))
        coasting = at_separation[2] * math.exp(-(time - parted) * drag / load_inertia)
        return coasting - (at_separation[0] + impulse / motor_inertia) / ratio

    # the shaft of 1e5 N m/rad, at 3200 rad/s with the 0.01 kg m², was bent by less than 60 N m: 6e-4 rad of 0.06
    crossed, _ = quad(twist_rate, parted, met)
    assert crossed == pytest.approx(-0.06, abs=6e-4)
    assert closing == pytest.approx(twist_rate(met), rel=0.05)
    assert met < 0.5
