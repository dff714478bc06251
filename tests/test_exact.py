"""The exact method against independent mathematics: a propagator of its own, DOP853, and laws that must hold.

The propagator (`reference`) and the exact method are each good to rounding; how far they agree: see `agreement`.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from helpers import general, margins, reference
from helpers.agreement import check, exact, kinds_of, propagated, sticking_time
from helpers.randomplants import END_TIME, nudged, plants, rolling_plants
from helpers.running import empty_log, stepped
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from clunk.core import switching, tile
from clunk.core.events import TOUCH
from clunk.core.status import QUALITY_GRAZING
from clunk.simulation import driveline
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text

CONTACTS = {
    "gap": {"separation": "gap"},
    "force": {"separation": "force"},
    "restitution": {"restitution": 0.5},
}
POINTS = [
    (2.0, 6.0),
    (5.0, 6.0),
    (10.0, 10.0),
    (10.0, 16.0),
    (7.0, 2.0),
    (3.3, 12.0),
    (8.0, 0.5),
    (6.0, 20.0),
    (4.0, 3.0),
    (9.0, 6.0),
    (-1.6, 3.0),
    (-3.0, 6.0),
]


@cache
def from_preload(plant):
    """The reference's events in four times what the exact method runs; several tests compare the same runs."""
    return propagated(plant, end_time=4.0 * exact(plant).end)


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize(("ratio", "backlash"), POINTS)
class TestTheReportsDriveline:
    def test_every_event_and_every_severity(self, ratio, backlash, contact):
        """And there is nothing to come when the run is complete, as the reference has it of three times as long."""
        plant = reference.boere(ratio, backlash, **CONTACTS[contact])
        events, run = from_preload(plant), exact(plant)
        assert run.complete
        assert run.end < 2.0
        assert kinds_of(run) == [(event.kind, event.side) for event in events]
        # 1e-12 s; the last touches of the slowest runs, at 0.3 rad/s after 20 others, have been magnified a little
        assert run.events["time"] == pytest.approx([event.time for event in events], abs=4e-12)
        assert run.states == pytest.approx(np.array([event.state for event in events]), abs=1e-9)
        primaries = reference.primary_impacts(events, sticking_time(plant))
        assert list(run.primaries) == primaries
        if contact == "restitution":
            assert np.isnan(run.impact_severity).all()
        else:
            severities = reference.severities(events, primaries)
            assert run.impact_severity == pytest.approx(severities, rel=1e-9)
            assert run.severity == pytest.approx(np.sqrt(np.sum(severities**2)), rel=1e-9)
        approach = np.sqrt(sum(events[k].speed ** 2 for k in primaries))
        assert run.approach_velocity == pytest.approx(approach, rel=1e-10)

    def test_a_run_that_is_cut_off_is_not_complete(self, ratio, backlash, contact):
        plant = reference.boere(ratio, backlash, **CONTACTS[contact])
        whole = exact(plant)
        last = float(whole.events["time"][-1])
        cut = exact(plant, end_time=0.999 * last)
        assert not cut.complete
        assert cut.end == 0.999 * last
        assert len(cut.events) < len(whole.events)
        assert np.array_equal(cut.events["time"], whole.events["time"][: len(cut.events)])

    def test_mirrored_load_swaps_flanks(self, ratio, backlash, contact):
        plant = reference.boere(ratio, backlash, **CONTACTS[contact])
        one, other = exact(plant), exact(replace(plant, before=-plant.before, after=-plant.after))
        assert other.initial_side == -one.initial_side
        assert np.array_equal(other.events["side"], -one.events["side"])
        assert np.array_equal(other.events["time"], one.events["time"])
        assert np.array_equal(other.states, -one.states)
        assert other.margin == one.margin
        assert other.label == one.label
        assert np.array_equal(other.impact_severity, one.impact_severity, equal_nan=True)

    def test_twice_the_torque_in_twice_the_gap_is_twice_the_motion(self, ratio, backlash, contact):
        plant = reference.boere(ratio, backlash, **CONTACTS[contact])
        twice = replace(plant, before=2 * plant.before, after=2 * plant.after, backlash=2 * plant.backlash)
        one, other = exact(plant), exact(twice)
        assert np.array_equal(other.events["time"], one.events["time"])
        assert np.array_equal(other.events["speed"], 2.0 * one.events["speed"])
        assert np.array_equal(other.states, 2.0 * one.states)
        assert other.label == one.label
        assert other.margin == pytest.approx(one.margin, rel=1e-12)
        assert np.array_equal(other.impact_severity, 2.0 * one.impact_severity, equal_nan=True)

    @pytest.mark.parametrize("slower", [2.0, 3.0])
    def test_inertias_and_dampers_scaled_with_time_only_take_longer(self, ratio, backlash, contact, slower):
        """t -> a t: J a², c a, k as it was; angles stay, speeds are a share 1/a."""
        plant = reference.boere(ratio, backlash, **CONTACTS[contact])
        slow = replace(
            plant,
            inertias=tuple(slower**2 * inertia for inertia in plant.inertias),
            shafts=tuple((one, other, k, slower * c) for one, other, k, c in plant.shafts),
            contact_damping=slower * plant.contact_damping,
        )
        one, other = exact(plant), exact(slow, end_time=2.0 * slower)
        assert kinds_of(one) == kinds_of(other)
        assert other.events["time"] / slower == pytest.approx(one.events["time"], abs=4e-12)
        assert other.label == one.label
        assert other.margin == pytest.approx(one.margin, abs=1e-9)
        assert slower**2 * other.impact_severity == pytest.approx(one.impact_severity, rel=1e-9, nan_ok=True)


class TestTheReportsOracle:
    """Numbers computed beforehand with other codes, to the digits that were written down."""

    @pytest.mark.parametrize(
        ("ratio", "backlash", "stiffness", "events", "times", "speeds", "label"),
        [
            (1.0, 6.0, 4.092e5, 0, [], [], "NI"),
            (2.0, 6.0, 4.092e5, 6, [0.2158974], [-1.430961], "SS(1)"),
            (
                5.0, 6.0, 4.092e5, 18,
                [0.11914968, 0.26126542, 0.56499567], [8.624357, -6.640220, -1.360790], "DS(1)SS(1)",
            ),
            (
                10.0, 10.0, 4.09e5, 32,
                [0.1101488, 0.2671179, 0.4826656, 0.6388111, 0.9284417],
                [17.48973, -13.49554, 4.84184, -3.60564, -1.41822], "DS(2)SS(1)",
            ),
        ],
    )  # fmt: skip
    def test_events(self, ratio, backlash, stiffness, events, times, speeds, label):
        run = exact(reference.boere(ratio, backlash, contact_stiffness=0.08**2 * stiffness))
        assert len(run.events) == 1 + events
        found = run.events[run.primaries]
        assert found["time"] == pytest.approx(times, abs=6e-8)
        assert found["speed"] == pytest.approx(speeds, abs=6e-6)
        assert run.label == label

    def test_severities(self):
        run = exact(reference.boere(5.0, 6.0))
        assert run.impact_severity == pytest.approx([7316.5, 5623.3, 1154.1], abs=0.05)
        assert run.severity == pytest.approx(9299.7, abs=0.05)
        assert exact(reference.boere(2.0, 6.0)).severity == pytest.approx(1212.7, abs=0.05)
        assert exact(reference.boere(10.0, 16.0)).severity == pytest.approx(20374.3, abs=0.05)

    def test_restitution(self):
        run = exact(reference.boere(5.0, 6.0, restitution=0.5))
        touches = run.events["time"][run.events["kind"] == TOUCH]
        assert touches[:3] == pytest.approx([0.1190, 0.1285, 0.1324], abs=5e-5)
        assert run.events["time"][run.primaries] == pytest.approx([0.1190, 0.2608, 0.5633], abs=5e-5)


@pytest.mark.parametrize("separation", ["gap", "force"])
@pytest.mark.parametrize(("ratio", "backlash"), POINTS)
def test_severity_is_what_rk4_converges_to(ratio, backlash, separation):
    """At h = 2e-5 s the contact mode (ω = 1623 1/s) loses (ωh)⁴/120 = 1e-8 of its amplitude a radian."""
    plant = reference.boere(ratio, backlash, separation=separation)
    run, stepped = exact(plant), exact(plant, method="rk4", step=2e-5)
    assert kinds_of(run) == kinds_of(stepped)
    assert stepped.impact_severity == pytest.approx(run.impact_severity, rel=2e-7)
    assert stepped.events["time"] == pytest.approx(run.events["time"], abs=1e-8)


# Random drivelines

SEARCH = {"deadline": None, "phases": [Phase.generate], "suppress_health_check": list(HealthCheck)}
RESTITUTION = st.sampled_from([0.0, 0.3, 0.5, 0.7])


class TestRandomDrivelines:
    @settings(max_examples=15, **SEARCH)
    @given(plants())
    def test_indentation(self, drawn):
        check(*drawn)

    @settings(max_examples=25, **SEARCH)
    @given(RESTITUTION.flatmap(plants))
    def test_restitution(self, drawn):
        check(*drawn)

    @settings(max_examples=10, **SEARCH)
    @given((st.none() | RESTITUTION).flatmap(rolling_plants))
    def test_without_anything_that_holds_them(self, drawn):
        check(*drawn)

    @settings(max_examples=4, **SEARCH)
    @given(plants())
    def test_indentation_by_a_general_integrator(self, drawn):
        against_dop853(*drawn)

    @settings(max_examples=4, **SEARCH)
    @given(RESTITUTION.flatmap(plants))
    def test_restitution_by_a_general_integrator(self, drawn):
        against_dop853(*drawn)

    @pytest.mark.slow
    @settings(max_examples=500, **SEARCH)
    @given(plants())
    def test_many_indentation(self, drawn):
        check(*drawn)

    @pytest.mark.slow
    @settings(max_examples=500, **SEARCH)
    @given(RESTITUTION.flatmap(plants))
    def test_many_restitution(self, drawn):
        check(*drawn)

    @pytest.mark.slow
    @settings(max_examples=500, **SEARCH)
    @given((st.none() | RESTITUTION).flatmap(rolling_plants))
    def test_many_without_anything_that_holds_them(self, drawn):
        check(*drawn)

    @pytest.mark.slow
    @settings(max_examples=60, **SEARCH)
    @given((st.none() | RESTITUTION).flatmap(plants))
    def test_many_by_a_general_integrator(self, drawn):
        against_dop853(*drawn)


def against_dop853(plant, state):
    run = exact(plant, state, END_TIME)
    found = general.run(plant, END_TIME, state, most=20)
    kinds, one = kinds_of(run)[1:], run.events["time"][1:]
    other = exact(*nudged(plant, state, 1e-8), END_TIME)
    for k, (kind, side, time, speed) in enumerate(found):
        if k >= len(other.events) - 1 or abs(other.events["time"][k + 1] - time) > 1e-5:
            return  # what a share of 1e-8 moves so far is not resolved at 1e-12
        if kind == "touch" and abs(speed) < 1e-2:
            return  # nor is what 1e-11 rad of dense output moves by more than 1e-9 s
        if kinds_of(other)[k + 1] != (kind, side) or END_TIME - time < 1e-6:
            return
        assert kinds[k] == (kind, side), f"event {k + 1}, at {time} s"
        apart = np.abs(other.events["time"][1 : k + 2] - one[: k + 1]).max()
        assert abs(one[k] - time) <= 1e-9 + 0.01 * apart, f"event {k + 1}, at {time} s"
    assert len(found) == 20 or len(kinds) == len(found)


# Turns within a phase's first step, and turns above the guard's value at the end of the step.
HIDDEN = [(8.9, 1.3), (9.8, 1.2), (6.45, 4.9), (3.85, 0.3)]


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize(("ratio", "backlash"), [*POINTS, *HIDDEN])
def test_the_margin_is_the_smallest_of_all_near_misses(ratio, backlash, contact):
    """Brute force, from every turning point of every phase; both are off by what 1e-11 s or rad do to a guard."""
    plant = reference.boere(ratio, backlash, **CONTACTS[contact])
    expected = margins.margin(plant, from_preload(plant), 2.0, sticking_time(plant))
    assert exact(plant).margin == pytest.approx(expected.margin, abs=1e-9), expected


def quality_of(plant):
    """(label, margin, whether it grazed)."""
    study = study_from_text(reference.config_of(plant, method="exact"))
    system, tables = driveline.prepare(study)
    x, log = np.zeros(2 * plant.n), empty_log(512, 2 * plant.n)
    half_gap = float(np.deg2rad(study.lash.backlash_deg) / 2)  # the very number that `simulate` takes
    _, regime = switching.preload(system, np.array([plant.before, half_gap, 0.0]), x)
    start = stepped(x, regime, plant.after, half_gap)
    _, _, quality, _ = tile.run(system, tables, start, log, np.zeros(1, np.uint8))
    return simulate(study).label, log.margins[0], bool(quality & QUALITY_GRAZING)


def edge_of(plant_at, low, high):
    """The two neighbouring load ratios between which the label changes, by bisection."""
    first = exact(plant_at(low)).label
    while np.nextafter(low, high) < high:
        middle = 0.5 * (low + high)
        if exact(plant_at(middle)).label == first:
            low = middle
        else:
            high = middle
    return low, high


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize(
    ("low", "high", "backlash", "contact_opens"),
    [(1.2, 2.0, 6.0, True), (2.0, 3.4, 6.0, False), (3.4, 4.0, 6.0, True)],
    ids=["NI or SS(1)", "SS(1) or DS(1)", "DS(1) or DS(1)SS(1)"],
)
class TestTangency:
    """Where an excursion just reaches the flank, or the contact just opens: |margin| there goes with the distance.

    By force, the flanks part before they open, and overlap and its slope vanish together: there, rounding decides.
    """

    def test_it_is_decided_once(self, low, high, backlash, contact_opens, contact):
        """One label below, another above; the margin has the sign of what happened, and goes to zero.

        Within some 1e-14 of the edge the rounding of the angles decides, and neighbouring ratios take turns.
        """

        def plant_at(ratio):
            return reference.boere(ratio, backlash, **CONTACTS[contact])

        vague = contact == "force" and contact_opens
        labels, edge = set(), edge_of(plant_at, low, high)
        for side, end in zip((-1.0, 1.0), edge, strict=True):
            label, margin, grazed = quality_of(plant_at(end))
            labels.add(label)
            rounding = 5e-12 if vague else 2e-12
            assert abs(margin) <= rounding
            for away in (1e-13, 1e-12, 1e-11, 1e-10, 1e-9, 1e-7, 1e-5):
                beside, margin, grazed = quality_of(plant_at(end * (1.0 + side * away)))
                if vague and away < 1e-10:
                    continue  # opening and rejoining are one instant there, and rounding decides which is first
                assert beside == label
                assert abs(margin) <= 10.0 * away + rounding
                if not vague and away >= 1e-10:
                    assert np.sign(margin) == -side
                if grazed and not vague:  # only within its tolerance of 1e-12, which a ratio goes to its own share
                    assert away <= 1e-11
        assert len(labels) == 2


@pytest.mark.parametrize(
    ("ratio", "begin", "inside", "end"), [(1.7, 0.5, 0.559, 0.6), (2.5, 4.2, 4.237, 4.3), (5.95, 4.2, 4.22, 4.23)]
)
def test_the_margin_vanishes_at_both_borders_of_a_thin_region(ratio, begin, inside, end):
    """Where a contact that held ends, the flank may be touched again; at the other border it just is not.

    At 1e-8 and 1e-6 of a degree from a border a margin is in proportion to that, as what is linear in the backlash is,
    with a slope of at most 1 a degree. The second term is the last bracket's width, the rounding of the angles.
    """
    labels = set()
    for outside in (begin, end):
        low, high = inside, outside
        first = exact(reference.boere(ratio, inside)).label
        while abs(high - low) > 1e-13:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if exact(reference.boere(ratio, middle)).label == first else (low, middle)
        for edge, away in ((low, inside - outside), (high, outside - inside)):
            near, far = (exact(reference.boere(ratio, edge + np.copysign(step, away))) for step in (1e-8, 1e-6))
            assert near.label == far.label
            assert near.margin == pytest.approx(0.01 * far.margin, rel=1e-3, abs=1e-12)
            assert 0.0 < (near.margin if near.label != first else -near.margin) < 1e-8
            labels.add(near.label)
    assert len(labels) == 2


def test_grazing_is_said_of_a_flank_reached_within_rounding():
    """Among neighbouring load ratios there is one whose excursion ends within 1e-12 of the gap from the flank."""

    def plant_at(ratio):
        return reference.boere(ratio, 6.0)

    below, above = edge_of(plant_at, 2.0, 3.4)
    _, margin, grazed = quality_of(plant_at(below))
    assert grazed
    assert abs(margin) <= 1e-12
    assert not quality_of(plant_at(above * (1.0 + 1e-10)))[2]


def test_an_edge_is_undecided_whatever_the_damping_of_the_contact():
    """By force: the label hangs on whether the parted flanks open. The default margin tolerance is 1e-4."""

    def plant_at(ratio):
        return reference.boere(ratio, 6.0, separation="force", contact_damping=5.0)

    for end in edge_of(plant_at, 1.2, 2.5):
        assert abs(exact(plant_at(end)).margin) < 1e-4


class TestPhasesOfSpecialKinds:
    def test_a_drift_is_not_taken_for_ringing(self):
        """A free undamped motor, thrown slowly at an overdamped load at rest, reaches it when the gap is used up."""
        plant = reference.Plant(
            inertias=(1.0, 1.0),
            shafts=((2, "ground", 1.0, 10.0),),
            lash=(1, 2),
            contact_stiffness=1e4,
            contact_damping=1.0,
            backlash=0.1,
            after=0.0,
            acceleration_of=1,
        )
        for speed in (0.1, 0.01, 0.003, 0.001):
            run = exact(plant, [0.045, 0.0, speed, 0.0], end_time=10.0)
            assert kinds_of(run)[1] == ("touch", 1)
            assert run.events["time"][1] == pytest.approx(0.005 / speed, rel=1e-10)

    HELD = reference.Plant(
        inertias=(0.01,),
        shafts=((1, "ground", 30.0, 0.1),),
        lash=(1, "ground"),
        backlash=0.05,
        before=-4.0,
        after=-0.2,
        acceleration_of=1,
        restitution=0.3,
    )

    @pytest.mark.parametrize("method", ["exact", "rk4"])
    def test_flanks_that_the_load_step_itself_parts_do_not_touch_at_once(self, method):
        """The load acts on the held inertia: its torque turns at once, and the gap opens with a curvature."""
        run = exact(self.HELD, end_time=0.5, method=method)
        assert kinds_of(run) == [("load step", -1), ("separation", -1)]
        assert run.events["time"][1] == 0.0
        assert run.label == "NI"

    def test_flanks_that_the_load_step_itself_parts_part_at_once(self):
        """The same, with a tree of undamped shafts at rest behind the held inertia."""
        plant = reference.Plant(
            inertias=(0.00546, 0.02815, 0.01604, 0.01262, 0.01, 0.00305),
            shafts=(
                (1, 2, 14.67, 0.0),
                (1, 3, 30.0, 0.0),
                (1, 4, 16.38, 0.0),
                (4, 5, 120.0, 0.0),
                (3, 6, 30.27, 0.0),
                (1, "ground", 9.15, 0.0),
            ),
            lash=(1, "ground"),
            backlash=0.2,
            before=-4.0,
            after=1.0,
            restitution=0.5,
        )
        run = exact(plant, end_time=0.5)
        assert kinds_of(run)[1] == ("separation", -1)
        assert run.events["time"][1] == 0.0

    def test_a_release_that_hardly_opens_locks_again(self):
        """Restitution, a share of 1e-9 from the tangency: the fastest touch is at 2e-11 rad/s, the last rounding."""
        plant = reference.boere(1.4323498487472537 * (1.0 - 1e-9), 6.0, restitution=0.5)
        assert exact(plant).label == "SS(1)"

    def test_no_near_miss_leaves_the_margin_at_its_cap(self):
        assert exact(reference.boere(6.0, 20.0)).margin == 0.25
