"""The energy balance of a run: the work of the load is stored, damped, or lost where the flanks meet and part.

    stored before + work of the load = stored after + damped + lost at impacts + left at separations - regained

Every term is computed by itself and none is the difference of the others, so that the residual tests the run: it shows
how far the state recorded at each event is from where the exact flow takes the state recorded at the event before.

Within a stretch of a phase, under one piece of the load, y = x' = (θ', θ'', w') obeys y' = A y. A damper takes
c ∫ (row · y)² dt, which is a quadratic form in y at the stretch's start. The work of the load's wave w, ∫ w θ' dt, is a
quadratic form in (y, w) there.
"""

import math

import numpy as np

from clunk.core.events import REJOIN, SEPARATION, TOUCH
from clunk.core.tables import TORQUE, half_gap_of
from clunk.simulation.driveline import Driveline
from clunk.simulation.load import run_load
from clunk.simulation.stretches import integrals, stretches
from clunk.simulation.system import build, held_inputs
from clunk.simulation.trajectory import Trajectory
from clunk.study.arrays import Floats
from clunk.study.records import Record, tells, told


class EnergyBalance(Record, repr=False):
    """Stored, supplied and lost energies of a run, from the load step to its end  [J]; S shafts.

    stored_before, stored_after : kinetic energy, and energy of the shafts' springs and of indented flanks (indentation)
    damped_in_shafts, rubbed_in_shafts : (S,) taken by the dampers, and by the friction, of each shaft
    lost_at_impacts : lost at touches of rigid flanks (restitution); otherwise 0
    dropped : left in flanks that still overlap as they part (separation by force); otherwise 0
    regained : part of `dropped` that is there again where such flanks rejoin before their gap opens
    """

    work: float = told("work of the load", "J")
    stored_before: float = told("stored before", "J")
    stored_after: float = told("stored at the end", "J")
    damped_in_shafts: tuple[float, ...] = told()
    damped_in_contact: float = told("damped in contact", "J")
    rubbed_in_shafts: tuple[float, ...] = told()
    lost_at_impacts: float = told("lost at impacts", "J")
    dropped: float = told("left at separations", "J")
    regained: float = told("regained at rejoins", "J")

    @property
    @tells("damped in all", "J")
    def damped(self) -> float:
        """Energy taken by all dampers  [J]."""
        return math.fsum((*self.damped_in_shafts, self.damped_in_contact))

    @property
    @tells("rubbed", "J")
    def rubbed(self) -> float:
        """Energy taken by friction  [J]."""
        return math.fsum(self.rubbed_in_shafts)

    @property
    @tells("residual", "J")
    def residual(self) -> float:
        """Sources less sinks: zero for an exact run  [J]."""
        return math.fsum(self._terms)

    @property
    def largest(self) -> float:
        """The largest term of the balance  [J]."""
        return max(map(abs, self._terms))

    @property
    @tells("residual over the largest energy", form=".1e")
    def relative_residual(self) -> float:
        """The residual's size relative to the largest term; 0 for a driveline without any energy."""
        return abs(self.residual) / (self.largest or 1.0)

    @property
    def _terms(self) -> tuple[float, ...]:
        """Sources, and sinks with a minus sign  [J]."""
        sinks = self.stored_after, self.damped, self.rubbed, self.lost_at_impacts, self.dropped
        return (self.stored_before, self.work, self.regained, *(-sink for sink in sinks))


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def balance(trajectory: Trajectory) -> EnergyBalance:
    """The energy balance of a run, from the states recorded at its events.

    With separation by force, the flanks part where the contact torque falls to zero, and they still overlap there. The
    energy of the contact spring is then no longer stored, and turns into heat in the flanks. Where the flanks rejoin,
    the spring is taken to be as indented as they overlap then. With separation by gap, the flanks part at zero
    indentation, as they touch; the contact torque that jumps there is that of the damper, which stores no energy.

    A term beyond the range of floating-point numbers is infinite or NaN.
    """
    from scipy.linalg import block_diag  # here, as importing scipy.linalg takes long, see `stretches._series`

    study, events, states = trajectory.study, trajectory.phases, trajectory.phase_states
    line, system = Driveline.from_study(study), build(study)
    n, impulsive = line.inertia.size, system.impulsive
    before, load = run_load(study)
    half_gaps = before[[half_gap_of(lash) for lash in range(len(line.lashes))]]
    rows, contact_dampings = np.vstack([line.shafts, line.lashes]), line.contact_dampings * (not impulsive)

    def stored(x: Floats, regime: int) -> float:
        """Energy stored in the inertias, in the shafts and in the contact."""
        contacts = system.contacts[regime]
        overlaps = contacts["side"] * (line.lashes @ x[:n]) - half_gaps
        contact = line.contact_stiffnesses * (contacts["closed"] > 0) @ overlaps**2 / 2.0 * (not impulsive)
        return math.fsum((line.inertia @ x[n : 2 * n] ** 2 / 2.0, *line.shaft_energy(x[:n]), contact))

    work, damped, rubbed = 0.0, np.zeros(rows.shape[0]), np.zeros(len(line.shafts))
    parts = [
        stretch
        for event, start, end in zip(events, states, np.append(events["time"][1:], trajectory.end), strict=True)
        for stretch in stretches(system, before, load, event["regime"], start, event["time"], end)
    ]
    torques = [twist - 1 for twist in held_inputs(line, system)[len(line.lashes) :]]
    size, wave = system.rates.shape[1], slice(2 * n, None)
    forms = np.zeros((len(rows) + 1, 2 * size - 2 * n, 2 * size - 2 * n))  # F of each damper, last of the wave
    forms[:-1, :n, :n] = rows[:, :, None] * rows[:, None, :]
    forms[-1, :n, size : size + 1] = line.load[:, None] / 2.0
    forms[-1] += forms[-1].T
    for flow in sorted({part.regime.flow for part in parts}):
        of_flow, rates = [part for part in parts if part.regime.flow == flow], system.rates[flow]
        lengths = np.array([part.end - part.begin for part in of_flow])
        taken_in_each = integrals(block_diag(rates, rates[wave, wave]), lengths, forms)
        for (_, _, regime, x, motion, moved), (_, taken) in zip(of_flow, taken_in_each, strict=True):
            y = np.append(motion, x[wave])
            *by_dampers, by_wave = np.einsum("i,kij,j->k", y, taken, y)
            damped += np.append(line.shaft_damping, contact_dampings * regime.closed) * by_dampers
            work += by_wave + regime.inputs[TORQUE] * (line.load @ moved[:n])
            for (friction, shares), torque in zip(line.frictions, torques, strict=True):
                rubbed += shares * regime.inputs[torque] * (friction.twist @ moved[:n])

    lost = 0.0
    if impulsive:
        touches, bits = np.flatnonzero(events["kind"] == TOUCH), 1 << np.arange(len(line.lashes))
        # successive touches with the same state are one impact of several lashes
        is_new_impact = (np.diff(touches) > 1) | (states[touches[1:]] != states[touches[:-1]]).any(axis=1)
        for impact in np.split(touches, np.flatnonzero(is_new_impact) + 1) if touches.size else ():
            struck = events["lash"][impact]
            together = system.contacts["closed"][events["regime"][impact[:1]]] @ bits + bits[struck].sum()
            passed = system.passed[(together - bits[struck])[:, None], struck[:, None], struck]
            speeds, after = events["speed"][impact], line.lashes[struck] @ states[impact[-1], n : 2 * n]
            lost += (speeds @ passed @ speeds - after @ passed @ after) / 2.0
    lash = events["lash"]
    by_force = np.array([not impulsive and each.contact.separation == "force" for each in study.lashes])[lash]
    overlaps = events["side"] * np.sum(line.lashes[lash] * states[:, :n], axis=1) - half_gaps[lash]
    springs = by_force * line.contact_stiffnesses[lash] * overlaps**2 / 2.0
    dropped, regained = (springs[events["kind"] == kind].sum() for kind in (SEPARATION, REJOIN))
    return EnergyBalance(
        work=work,
        stored_before=stored(states[0], events["regime"][0]),
        stored_after=stored(parts[-1].x + parts[-1].moved, events["regime"][-1]),
        damped_in_shafts=tuple(damped[: len(line.shafts)].tolist()),
        damped_in_contact=damped[len(line.shafts) :].sum(),
        rubbed_in_shafts=tuple(rubbed.tolist()),
        lost_at_impacts=lost,
        dropped=dropped,
        regained=regained,
    )
