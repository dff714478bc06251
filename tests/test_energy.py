"""The energy balance of a run: it closes for every contact, every lash and every method, and notices what does not."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from helpers.reference import Plant
from helpers.starts import started
from scipy.linalg import expm

from clunk.core.events import REJOIN, TOUCH
from clunk.simulation import stretches
from clunk.simulation.energy import balance
from clunk.simulation.history import sample
from clunk.simulation.trajectory import simulate
from clunk.study.config import study_from_text
from clunk.study.models import Solver

METHODS = get_args(Solver.model_fields["method"].annotation)
CLOSED = 1e-8  # of the largest term: RK4 at 2e-5 s takes (ωh)⁶/72 = 2e-11 of the contact mode's energy a step
CONTACTS = {
    "separation by gap": 'separation = "gap"',
    "separation by force": 'separation = "force"',
    "restitution": 'model = "restitution"',
    "plastic restitution": 'model = "restitution"\nrestitution = 0.0',
}
SHAFTS = """shafts = [{{between = [1, 2], stiffness = 31.3, damping = {a}}},
{{between = [2, 3], stiffness = 31.3, damping = {b}}}, {last}]
"""
GROUNDED = SHAFTS.format(a=0.08, b=0.04, last="{between = [3, 4], stiffness = 31.3, damping = 0.1}")
UNDAMPED = SHAFTS.format(a=0.0, b=0.0, last='{between = [4, "ground"], stiffness = 31.3, damping = 0.0}')

MAP = [(1.0, 6.0), (2.0, 6.0), (5.0, 6.0), (10.0, 10.0), (-2.5, 3.0), (7.0, 0.0)]  # load ratio, backlash in degrees


def run(contact, ratio=5.0, backlash=6.0, *, damping=94.0, shafts="", lash="", method="rk4", step=2e-5, end_time=1.0):
    return simulate(
        study_from_text(
            f'[driveline]\npreset = "boere-2008"\ninertias = [0.024, 0.002, 0.002, 0.002]\n{shafts}'
            f"[lash]\nbacklash_deg = {backlash}\n{lash}\n"
            f"[lash.contact]\n{contact}\ndamping = {damping}\n[load]\nratio = {ratio}\n"
            f'[solver]\nmethod = "{method}"\nstep = {step}\nend_time = {end_time}\nmax_events = 4096\n'
        )
    )


# Points of the report's map, and drivelines that drift in the gap, or never come to rest: RK4 loses 1e-9 of the
# undamped contact's oscillation a period, of which 0.3 s are 77.
CASES = {
    **{str(point): {"ratio": point[0], "backlash": point[1]} for point in MAP},
    "a lash to ground": {"shafts": GROUNDED, "lash": 'between = [4, "ground"]'},
    "no damper": {"shafts": UNDAMPED, "damping": 0.0, "end_time": 0.3},
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("contact", CONTACTS.values(), ids=CONTACTS)
@pytest.mark.parametrize("case", CASES)
def test_energy_is_accounted_for(case, contact, method):
    trajectory = run(contact, method=method, **CASES[case])
    energy, undamped = balance(trajectory), case == "no damper"
    assert trajectory.touches > 0 or case == str(MAP[0])
    assert energy.relative_residual < CLOSED
    assert (energy.damped == 0.0) == undamped
    assert min(*energy.damped_in_shafts, energy.damped_in_contact, energy.lost_at_impacts) >= 0.0
    assert not undamped or (energy.lost_at_impacts > 0.0) == ("restitution" in contact)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("contact", CONTACTS.values(), ids=CONTACTS)
def test_energy_is_accounted_for_from_a_state_in_the_gap(contact, method):
    thrown = started(run(contact, method=method).study, np.array([0.3, 0.2, 0.01, 0.0, -3.0, 2.0, 5.0, -1.0]))
    assert thrown.touches > 0
    energy = balance(thrown)
    assert energy.relative_residual < CLOSED
    kinetic = 0.5 * np.sum([0.024 * 9, 0.002 * 4, 0.002 * 25, 0.002])
    assert energy.stored_before == pytest.approx(kinetic + 0.5 * 31.3 * (0.1**2 + 0.19**2))


@pytest.mark.parametrize(("ratio", "backlash", "damping"), [(5.5, 8.0, 94.0), (2.0, 1.0, 400.0)])
def test_flanks_that_rejoin_regain_what_their_overlap_stores(ratio, backlash, damping):
    trajectory = run('separation = "force"', ratio, backlash, damping=damping)
    energy = balance(trajectory)
    assert np.any(trajectory.events["kind"] == REJOIN)
    assert 0.0 < energy.regained < energy.dropped
    assert energy.relative_residual < CLOSED
    assert max(energy.dropped, energy.regained) > 100 * CLOSED * energy.largest  # the balance would notice


def test_the_terms_are_those_of_the_sampled_motion():
    """Work and dissipation of Newton's law, 1e-6 s apart: of the contact's mode, 1623 1/s, a sum loses (ωh)²/12."""
    trajectory = run(CONTACTS["separation by force"], end_time=0.3)
    history = sample(trajectory, step=1e-6, until=trajectory.study.load.step_time + 0.3)
    whole = slice(int(np.flatnonzero(history.event == 0)[0]), None)
    rate, powers = history.velocity[whole], [history.torque[whole] * history.velocity[whole, 0]]
    powers += [c * (rate @ row) ** 2 for row, _, c in Plant().joints()]
    powers.append(0.6016 * (rate[:, 2] - rate[:, 3]) ** 2 * (history.contacts[whole, 0] != 0))
    energy = balance(trajectory)
    computed = [energy.work, *energy.damped_in_shafts, energy.damped_in_contact]
    assert computed == pytest.approx(np.trapezoid(powers, history.after_step[whole]), rel=1e-6, abs=1e-10)


def test_the_residual_falls_with_the_fourth_power_of_rk4_s_step():
    """RK4's local error in a phase's end state is of order h⁵, in a number of steps that grows as 1/h."""
    coarse, fine = (balance(run(CONTACTS["separation by gap"], step=step)) for step in (1e-4, 5e-5))
    assert coarse.relative_residual / fine.relative_residual == pytest.approx(16.0, rel=0.2)


@pytest.mark.parametrize("contact", CONTACTS.values(), ids=CONTACTS)
def test_a_state_that_does_not_follow_from_the_one_before_is_noticed(contact):
    """Velocities at the last event off by a part in 10⁴, or it 10 µs late, unbalance the run."""
    trajectory = run(contact)
    k = -1
    states, events = trajectory.states.copy(), trajectory.events.copy()
    states[k, 4:] *= 1.0 + 1e-4
    assert balance(replace(trajectory, phase_states=states)).relative_residual > 10 * CLOSED
    events["time"][k] += 1e-5
    assert balance(replace(trajectory, phases=events)).relative_residual > 10 * CLOSED


def test_an_impact_loses_what_newton_s_law_says():
    """½ m (1 - e²) v² with m = J3 J4/(J3 + J4); a lock is an impact with e = 0."""
    trajectory = run(CONTACTS["restitution"])
    touches = trajectory.events["kind"] == TOUCH
    locks = np.append(trajectory.events["regime"][1:] != 0, False)
    kept = np.where(locks[touches], 0.0, 0.25)
    expected = np.sum(0.5 * 0.001 * (1.0 - kept) * trajectory.events["speed"][touches] ** 2)
    assert balance(trajectory).lost_at_impacts == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("at_once", [1, 1 << 20], ids=["one by one", "together"])
def test_integrals_are_those_of_exponentials(monkeypatch, at_once):
    """Ψ is in the exponential of [[A, 1], [0, 0]] t, and AᵀG + G A = ΦᵀF Φ - F, both the integral of one rate.

    Within 1e-12: what rounding makes of an exponential whose matrix has a norm of 20, and is doubled as often.
    """
    monkeypatch.setattr(stretches, "_AT_ONCE", at_once)
    rng = np.random.default_rng(7)
    n, lengths = 5, np.array([0.0, 1e-9, 0.3, 2.0, 0.01, 4.0])  # s; rates are some 1/s
    rates, forms = rng.normal(size=(n, n)) - 2.0 * np.eye(n), rng.normal(size=(2, n, n))
    forms += forms.swapaxes(1, 2)
    zero, unit = np.zeros((n, n)), np.eye(n)
    for length, (travel, integrals) in zip(lengths, stretches.integrals(rates, lengths, forms), strict=True):
        whole = expm(length * np.block([[rates, unit], [zero, zero]]))
        assert travel == pytest.approx(whole[:n, n:], rel=1e-12, abs=1e-12 * length)
        flow = whole[:n, :n]
        rate = rates.T @ integrals + integrals @ rates
        assert rate == pytest.approx(flow.T @ forms @ flow - forms, rel=1e-12, abs=1e-12)
