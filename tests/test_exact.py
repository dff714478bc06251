"""Both methods beside the independent reference, and the margins and borders of the exact one.

The reference and the exact method are each good to rounding; how far they agree: see `agreement`.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers import margins, reference
from helpers.agreement import both_methods_are_the_reference, exact, kinds_of, propagated, sticking_time
from helpers.reference import CONTACTS

import clunk
from clunk.api import run_points
from clunk.core.status import QUALITY_GRAZING

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
def test_events_and_severities_are_the_references_and_only_a_whole_run_is_complete(ratio, backlash, contact):
    """There is nothing to come when it is, as the reference has it of three times as long."""
    plant = reference.boere(ratio, backlash, **CONTACTS[contact])
    whole = both_methods_are_the_reference(plant, 2.0, events=from_preload(plant))
    assert whole.complete
    assert whole.end < 2.0
    end = 0.999 * float(whole.events["time"][-1])
    cut = exact(plant, end_time=end)
    assert not cut.complete
    assert cut.end == end
    assert len(cut.events) < len(whole.events)
    assert np.array_equal(cut.events["time"], whole.events["time"][: len(cut.events)])


# Turns within a phase's first step, and turns above the guard's value at the end of the step.
HIDDEN = [(8.9, 1.3), (9.8, 1.2), (6.45, 4.9), (3.85, 0.3)]


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize(("ratio", "backlash"), [*POINTS[::3], *HIDDEN])
def test_the_margin_is_the_smallest_of_all_near_misses(ratio, backlash, contact):
    """Brute force, from every turning point of every phase; both are off by what 1e-11 s or rad do to a guard."""
    plant = reference.boere(ratio, backlash, **CONTACTS[contact])
    expected = margins.margin(plant, from_preload(plant), 2.0, sticking_time(plant))
    assert exact(plant).margin == pytest.approx(expected.margin, abs=1e-9), expected


@pytest.mark.parametrize("profile", ["step", "ramp", "smooth", "lag"])
def test_a_flank_that_carries_little_before_the_load_step_has_that_as_its_margin(profile):
    """The torque grows from there, with a slope of zero, so that rounding must not tell whether it turns back there.

    The margin goes through zero where the initial flank is the other one, and with it the label.
    """
    load = [f"load.profile={profile!r}", "load.initial_torque=-3", "load.final_torque=-33"]
    load += ["load.duration=0.06"] * (profile in ("ramp", "smooth")) + ["load.time_constant=0.06"] * (profile == "lag")
    study = clunk.load_study(Path("configs/nominal.toml"), ['solver.method="exact"', *load])
    torques = np.concatenate([-np.linspace(0.001, 8.0, 101), [0.001, 0.1]])
    runs = run_points(study, {"load.initial_torque": torques}, workers=1)
    assert runs.margin == pytest.approx(torques / -33.0, rel=1e-9)
    assert set(runs.label_map[:101]) == {"NI"}
    assert "NI" not in set(runs.label_map[101:])


def quality_of(plant):
    """(label, margin, whether it grazed)."""
    study = reference.study_of(plant)
    run = run_points(study, {"lash.backlash_deg": [study.lash.backlash_deg]}, workers=1)
    return run.label_map[0], run.margin[0], bool(run.quality[0] & QUALITY_GRAZING)


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
        assert (
            vague or not contact_opens or contact == "restitution" or any(quality_of(plant_at(end))[2] for end in edge)
        )
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

    def test_flanks_that_the_load_step_itself_parts_part_at_once(self):
        """The load acts on the held inertia, with undamped shafts at rest behind it: its torque turns at once."""
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


# Stiff dampers


@pytest.mark.parametrize("damping", [4.0, 400.0])
def test_a_damper_that_is_stiff_beside_its_shaft_has_the_events_of_the_reference(damping):
    """A hundred and 10,000 times the report's, so that one decay is as much slower as another is faster."""
    plant = reference.boere(5.0, 6.0)
    first, second, *others = plant.shafts
    stiff = replace(plant, shafts=(first, (*second[:3], damping), *others))
    run, events = exact(stiff, end_time=0.2), propagated(stiff, end_time=0.2)
    assert kinds_of(run) == [(event.kind, event.side) for event in events]
    assert len(events) > 5
    # the reference's exponentials are squared up from a time so much shorter
    assert run.events["time"] == pytest.approx([event.time for event in events], abs=1e-12 * damping)
