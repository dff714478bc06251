"""Runs of clunk held to the independent reference, as far as rounding lets two exact codes agree.

Every touch divides an error of the gap, some 1e-16 rad, by its speed, and chatter multiplies it. So runs are compared
as far as two runs of the reference agree that start a share of 1e-10 apart, and to a tenth of what lies between those.
"""

import numpy as np
import pytest

from clunk.simulation.energy import balance
from helpers import reference
from helpers.randomplants import nudged
from helpers.starts import started

NUDGE = 1e-10
NEAR = {"exact": 2e-9, "rk4": 1e-6}  # s, what chatter makes of rounding; rk4's own error at a step of 20 µs is 1e-8 s
RESOLVED = 0.05  # of NEAR: how far a nudge may move an event; two thirds to nine tenths of random lashes' events are
# Runs of which rounding is not magnified. RK4 steps 5e-5 s, of which the contact's mode (ω = 1623 1/s) makes 0.08 rad:
# it loses (ωh)⁴/120 = 3.6e-7 of its amplitude a radian, and is late by as much at the end of a contact of 2 ms.
TIME = {"exact": 4e-12, "rk4": 1e-7}  # s
STATE = {"exact": 1e-9, "rk4": 1e-4}  # rad, rad/s: of speeds of 10 rad/s, at accelerations of up to 1e3 rad/s²
SEVERITY = {"exact": 1e-9, "rk4": 3e-6}  # relative
REST = 1e-11  # rad/s²: a twist of 1e-17 rad at 3e3 N m/rad and 3e-3 kg m², where nothing moves


def exact(plant, state=None, end_time=2.0, method="exact", step=1e-4):
    study = reference.study_of(plant, step=step, end_time=end_time, method=method)
    return started(study, state)


def propagated(plant, state=None, end_time=2.0):
    events, _ = reference.run(plant, end_time, state)
    return events


def kinds_of(trajectory):
    return [(trajectory.kind_name(k), int(event["side"])) for k, event in enumerate(trajectory.events)]


def sticking_time(plant):
    return plant.contact_period() if plant.restitution is None else 0.0


def both_methods_are_the_reference(plant, end_time, state=None, events=None):
    """Hold a run by either method to all events of the reference, which are resolved; return the exact run."""
    events = propagated(plant, state, end_time) if events is None else events
    primaries = reference.primary_impacts(events, sticking_time(plant))
    approach = np.sqrt(sum(events[k].speed ** 2 for k in primaries))
    for method in ("rk4", "exact"):
        run = exact(plant, state, end_time, method=method, step=5e-5)
        assert kinds_of(run) == [(event.kind, event.side) for event in events]
        assert run.events["time"] == pytest.approx([event.time for event in events], abs=TIME[method])
        if not plant.rigid_motion.size:  # else where its angle is zero is a choice
            assert run.states == pytest.approx(np.array([event.state for event in events]), abs=STATE[method])
        assert list(run.primaries) == primaries
        assert run.label == reference.label(events, primaries)
        assert run.approach_velocity == pytest.approx(approach, rel=SEVERITY[method])
        if plant.restitution is None:
            severities = reference.severities(events, primaries)
            assert run.impact_severity == pytest.approx(severities, rel=SEVERITY[method])
            assert run.severity == pytest.approx(np.sqrt(np.sum(severities**2)), rel=SEVERITY[method])
        else:
            assert np.isnan(run.impact_severity).all()
        if run.complete and plant.profile.name != "lag":  # which rests for good only once its tail makes no difference
            assert run.end >= plant.pieces[-1].begin
    return run


def happened_in(run):
    """Kind, flank and lash of each event of a run."""
    happened = [(run.kind_name(k), int(event["side"]), int(event["lash"])) for k, event in enumerate(run.events)]
    return in_order(happened[1:], run.events["time"][1:])


def in_order(happened, times):
    """Events with those of one instant lash by lash, in which order they are as good as in any other."""
    instants = np.cumsum(np.diff(times, prepend=times[:1]) > 1e-11)
    return [happened[k] for k in sorted(range(times.size), key=lambda k: (instants[k], happened[k][2], k))]


def as_in_the_reference(plant, method, end_time, state=None, step=2e-5):
    """Hold a run to the reference, as far as two runs of that agree which begin a little apart.

    Events and energies; of a run that is resolved to its end also each lash's primary impacts and severities.
    """
    events, moved = (
        reference.run(each, end_time, start)[0] for each, start in ((plant, state), nudged(plant, state, NUDGE))
    )
    (happened, times), (_, moved_times) = happened_by(events), happened_by(moved)
    count = min(times.size, moved_times.size)
    unresolved = np.flatnonzero(np.abs(times[:count] - moved_times[:count]) > RESOLVED * NEAR[method])
    count = int(unresolved[0]) if unresolved.size else count
    run = exact(plant, state, end_time, method, step)
    assert happened_in(run)[:count] == happened[:count]
    assert run.events["time"][1 : count + 1] == pytest.approx(times[:count], abs=NEAR[method])
    energy, share = balance(run), 1e-9 if method == "exact" else 1e-5
    assert abs(energy.residual) < share * energy.largest + 1e-20  # J, where nothing moves at all
    if count < times.size or count < moved_times.size:
        return
    assert len(run.events) == 1 + count
    for number, (lash, each) in enumerate(zip(plant.lashes, run.lashes, strict=True), 1):
        primaries = reference.primary_impacts(events, 0.0 if lash.rigid else plant.contact_period(number), number)
        assert run.events["time"][each.primaries] == pytest.approx(
            [events[k].time for k in primaries], abs=NEAR[method]
        )
        if primaries and not lash.rigid and len(moved) == len(events):
            severities = reference.severities(events, primaries)
            apart = np.abs(reference.severities(moved, primaries) - severities)
            # the rounding of up to 300 events, ten times that of the report's 30
            within = 10.0 * SEVERITY[method] * severities + 0.1 * apart + 1e-10 * severities.max() + REST
            assert np.all(np.abs(each.impact_severity - severities) <= within)


def happened_by(events):
    """Kind, flank and lash of each event of the reference, from 0, and their times; lashes' own alone."""
    events = [event for event in events[1:] if event.kind not in ("stage", "slip", "stick")]
    times = np.array([event.time for event in events])
    return in_order([(event.kind, event.side, int(event.element.split()[1]) - 1) for event in events], times), times
