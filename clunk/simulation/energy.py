"""The energy balance of a run: what the load put in is stored, damped, or lost where the flanks meet and part.

    stored before + work of the load = stored after + damped + lost at impacts + dropped by the contact - regained

Every term is computed by itself and none is the difference of the others, so that the residual tests the run: how far
the state recorded at each event is from where the exact flow takes the one recorded before it. Within a phase
x' = A x + B u with a constant u, so that y = x' = (θ', θ'') obeys y' = A y, and a damper takes c ∫ (row · y)² dt, a
quadratic form in y at the phase's start:

    Ψ(t) = ∫ exp(A s) ds,  G(t) = ∫ exp(A s)ᵀ rowᵀ row exp(A s) ds

are power series for a short time, and Φ(2t) = Φ(t)², Ψ(2t) = Ψ(t) (1 + Φ(t)), G(2t) = G(t) + Φ(t)ᵀ G(t) Φ(t) with
Φ = exp(A t) (C.F. Van Loan, Computing integrals involving the matrix exponential, 1978, doi:10.1109/TAC.1978.1101743).
Neither has a growing exponential in it.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clunk.core.events import REJOIN, SEPARATION, TOUCH
from clunk.core.regimes import CLOSED_FLOW
from clunk.simulation import driveline
from clunk.simulation.driveline import Driveline
from clunk.simulation.load import load_step
from clunk.simulation.trajectory import Trajectory

FloatArray = npt.NDArray[np.float64]

_ORDER = 18  # of the power series, up to |A| t = 1/4: (2 |A| t)^18 / 18! is 1e-21


@dataclass(frozen=True)
class EnergyBalance:
    """Where the energy of a run went, from the load step to its end; S shafts.

    work : float  [J], of the load torque
    kinetic_before, kinetic_after : float  [J]
    shafts_before, shafts_after : (S,) float  [J], stored in each shaft's spring
    contact_before, contact_after : float  [J], stored in the indented flanks; 0 for the restitution model
    damped_in_shafts : (S,) float  [J]
    damped_in_contact : float  [J]
    lost_at_impacts : float  [J], of the restitution model
    dropped : float  [J], left in flanks that overlap as they part, of separation by force
    regained : float  [J], of it found again where such flanks rejoin before they have opened
    """

    work: float
    kinetic_before: float
    kinetic_after: float
    shafts_before: tuple[float, ...]
    shafts_after: tuple[float, ...]
    contact_before: float
    contact_after: float
    damped_in_shafts: tuple[float, ...]
    damped_in_contact: float
    lost_at_impacts: float
    dropped: float
    regained: float

    @property
    def stored_before(self) -> float:
        """Kinetic energy and that of every spring, at the load step  [J]."""
        return math.fsum((self.kinetic_before, *self.shafts_before, self.contact_before))

    @property
    def stored_after(self) -> float:
        """The same at the end of the run  [J]."""
        return math.fsum((self.kinetic_after, *self.shafts_after, self.contact_after))

    @property
    def damped(self) -> float:
        """What all dampers have taken  [J]."""
        return math.fsum((*self.damped_in_shafts, self.damped_in_contact))

    @property
    def residual(self) -> float:
        """What the terms leave unexplained  [J]."""
        sources = self.stored_before, self.work, self.regained
        sinks = self.stored_after, self.damped, self.lost_at_impacts, self.dropped
        return math.fsum((*sources, *(-sink for sink in sinks)))

    @property
    def largest(self) -> float:
        """The largest term of the balance  [J]."""
        terms = self.stored_before, self.work, self.stored_after, self.damped, self.lost_at_impacts, self.dropped
        return max(abs(term) for term in terms)

    @property
    def relative_residual(self) -> float:
        """The residual's size relative to the largest term; 0 for a driveline without any energy."""
        return abs(self.residual) / self.largest if self.largest != 0.0 else abs(self.residual)


def balance(trajectory: Trajectory) -> EnergyBalance:
    """The energy balance of a run, from the states recorded at its events.

    In separation by force the contact torque has fallen to zero where the flanks part, but they still overlap. The
    spring's energy there is no longer stored, and turns into heat in the flanks; where they rejoin, the spring is taken
    as indented as they overlap then. In separation by gap the flanks part as they touched, at zero indentation; the
    contact torque that jumps there is the damper's, which stores nothing.

    A term beyond the range of numbers is infinite or NaN.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return _balance(trajectory)


def _balance(trajectory: Trajectory) -> EnergyBalance:
    study = trajectory.study
    line, system = Driveline.from_study(study), driveline.build(study)
    n, impulsive = line.inertia.size, bool(system.impulsive)
    torque, half_gap = float(load_step(study.load).after), float(np.deg2rad(study.lash.backlash_deg) / 2)
    shafts = study.driveline.shafts
    twists = np.zeros((len(shafts), n))
    for twist, shaft in zip(twists, shafts, strict=True):
        for inertia, sign in zip(shaft.between, (1.0, -1.0), strict=True):
            if inertia != "ground":
                twist[int(inertia) - 1] = sign
    dampers = np.array([*(shaft.damping for shaft in shafts), 0.0 if impulsive else line.contact_damping])
    rows = np.vstack([twists, line.lash])

    def in_shafts(x: FloatArray) -> FloatArray:
        return np.array([shaft.stiffness for shaft in shafts]) * (twists @ x[:n]) ** 2 / 2.0

    def in_contact(x: FloatArray, side: int) -> float:
        return 0.0 if impulsive else float(line.contact_stiffness * (side * (line.lash @ x[:n]) - half_gap) ** 2 / 2.0)

    def in_inertias(x: FloatArray) -> float:
        return float(line.inertia @ x[n:] ** 2 / 2.0)

    events, states = trajectory.events, trajectory.states
    ends = np.append(events["time"][1:], trajectory.end)
    work, damped, x = 0.0, np.zeros(rows.shape[0]), states[0]
    for event, start, end in zip(events, states, ends, strict=True):
        flow, side = system.regimes[["flow", "side"]][event["regime"]]
        is_closed = np.concatenate([np.ones(len(shafts)), [float(flow == CLOSED_FLOW)]])
        rates = system.rates[flow] @ start + system.inputs[flow] @ [torque, side * half_gap]
        travel, forms = _integrals(system.rates[flow], rows, float(end - event["time"]))
        moved = travel @ rates
        work += torque * float(line.load @ moved[:n])
        damped += is_closed * dampers * np.einsum("i,kij,j->k", rates, forms, rates)
        x = start + moved

    touches, partings, rejoins = (np.flatnonzero(events["kind"] == kind) for kind in (TOUCH, SEPARATION, REJOIN))
    lost = 0.0
    if impulsive:
        speed_after = states[touches] @ system.lash
        lost = float(np.sum(events["speed"][touches] ** 2 - speed_after**2) / np.sum(line.lash**2 / line.inertia) / 2.0)
    dropped, regained = 0.0, 0.0
    if not impulsive and study.lash.contact.separation == "force":
        dropped, regained = (
            math.fsum(in_contact(states[k], int(events["side"][k])) for k in found) for found in (partings, rejoins)
        )

    def contact_at(state: FloatArray, regime: int) -> float:
        return (
            in_contact(state, int(system.regimes["side"][regime]))
            if system.regimes["flow"][regime] == CLOSED_FLOW
            else 0.0
        )

    return EnergyBalance(
        work=work,
        kinetic_before=in_inertias(states[0]),
        kinetic_after=in_inertias(x),
        shafts_before=tuple(in_shafts(states[0]).tolist()),
        shafts_after=tuple(in_shafts(x).tolist()),
        contact_before=contact_at(states[0], int(events["regime"][0])),
        contact_after=contact_at(x, int(events["regime"][-1])),
        damped_in_shafts=tuple(damped[:-1].tolist()),
        damped_in_contact=float(damped[-1]),
        lost_at_impacts=lost,
        dropped=dropped,
        regained=regained,
    )


def _integrals(rates: FloatArray, rows: FloatArray, length: float) -> tuple[FloatArray, FloatArray]:
    """Ψ and G of a flow over a time.

    Parameters
    ----------
    rates : (2n, 2n) float64
        A, of x = (θ, θ').
    rows : (m, n) float64
        What a damper sees of the velocities.
    length : float  [s]

    Returns
    -------
    travel : (2n, 2n) float64  [s]
        Ψ: x moves by Ψ x'.
    forms : (m, 2n, 2n) float64  [s]
        G of each row: ∫ (row · θ')² dt = x'ᵀ G x'.
    """
    size, n = rates.shape[0], rows.shape[1]
    # in units in which an angle and a velocity are of one size, so that the norm of A is about its largest |λ|
    fastest = float(np.abs(np.linalg.eigvals(rates)).max()) if np.all(np.isfinite(rates)) else math.nan
    unit = np.concatenate([np.ones(n), np.full(n, fastest if fastest > 0.0 else 1.0)])
    scaled = rates / unit[:, None] * unit
    reach = float(np.linalg.norm(scaled)) * length
    if not math.isfinite(reach):
        return np.full((size, size), math.nan), np.full((rows.shape[0], size, size), math.nan)
    doublings = max(0, math.ceil(math.log2(4.0 * reach))) if reach > 0.0 else 0
    short = length / 2.0**doublings

    term, form = np.eye(size), np.zeros((rows.shape[0], size, size))
    form[:, :n, :n] = rows[:, :, None] * rows[:, None, :]
    flow, travel, forms = np.eye(size), np.zeros((size, size)), np.zeros_like(form)
    for k in range(1, _ORDER + 1):
        travel += term * short / k
        forms += form * short / k
        term = term @ scaled * short / k
        form = (form @ scaled + scaled.T @ form) * short / k
        flow += term
    for _ in range(doublings):
        forms += flow.T @ forms @ flow
        travel += travel @ flow
        flow = flow @ flow
    return travel * unit[:, None] / unit, forms / unit[:, None] / unit
