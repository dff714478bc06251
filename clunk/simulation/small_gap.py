"""The linear limit of vanishing backlash: response, and number of impacts by load ratio (report §3.1 and 3.2).

As the gap vanishes, the lash stays closed, and an impact is a change of sign of the torque it carries (Figure 3.5,
Table 3.1). That torque is Ts (1 + σr f(t)) times the share of the load that reaches the lash, with f(t) the response to
the released torque, f(0) = 1. The torque is on the other flank while f < -1/σr, so that every excursion of f below that
level is one more crossing and back. With the lowest mode alone f = exp(-ζ1 ω t) cos ω t, each minimum of which adds an
excursion.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clunk.core.arrays import ComplexArray
from clunk.core.reductions import Reduction, constrained
from clunk.core.regimes import driveline_at
from clunk.core.status import Status
from clunk.core.tables import FORCE, TORQUE
from clunk.simulation.driveline import Driveline
from clunk.simulation.load import run_load
from clunk.simulation.measures import torque_across
from clunk.simulation.stretches import inputs_of, integrals, regime_under, states
from clunk.simulation.system import build, explained, preload
from clunk.study.arrays import Floats
from clunk.study.errors import ClunkError
from clunk.study.study import Study

_SAMPLES = 128  # in a period of the fastest mode that matters: a parabola through three gives an extreme to 1e-7
_FAINTEST = 1e-3  # |f| below which extremes are not searched for: they matter to load ratios beyond 1000 only
_MOST_SAMPLES = 500_000  # 4000 periods of the fastest mode


class SmallGap(NamedTuple):
    """The torque across a lash without a gap after an ideal step, on the plot's time axis, signed like q = lash · θ."""

    time: Floats  # s
    torque: Floats  # N m
    start: float  # N m, before the load step
    end: float  # N m, in steady motion after it
    decay: float  # 1/s, ζ1 ω1
    frequency: float  # Hz, of the lowest mode
    damping_ratio: float  # ζ1
    step_time: float  # s

    @property
    def ratio(self) -> float:
        """Load ratio σr = (F before - F after) / F after, of the torque F across the lash."""
        return (self.start - self.end) / self.end if self.end != 0.0 else np.inf

    @property
    def periods(self) -> float:
        """n_c, see `periods_in_envelope`."""
        return periods_in_envelope(self.ratio, self.damping_ratio)

    @property
    def characteristic_time(self) -> float:
        """t_c after the load step, where |σr| exp(-ζ1 ω1 t) = 1  [s]."""
        return self.periods / self.frequency

    @classmethod
    def of(cls, study: Study) -> "SmallGap":
        """The response of a study's driveline to a step from T0 to its load's last torque.

        Raises ClunkError where there is none: without steady motion or a damped oscillation in contact, with a load
        that does not reach the lash, and for several lashes, stages or friction.
        """
        driveline, system = Driveline.from_study(study), build(study)
        if len(study.lashes) > 1 or driveline.staged or driveline.frictions:
            raise ClunkError(
                "A small-gap response is drawn of one lash in a linear driveline only, without stages and friction."
            )
        modes = driveline.modes(closed=True)
        if system.status != Status.OK:
            raise ClunkError(f"There is no response to draw: {explained(study, Status(system.status))}.")
        before, load = run_load(study)
        before[np.arange(before.size) != TORQUE] = 0.0  # without a gap
        after = inputs_of(before, load, -1)
        rest = preload(system, before)
        if rest.status != Status.OK or modes.frequency.size == 0 or modes.damping_ratio[0] <= 0.0:
            raise ClunkError(
                "There is no response to draw: the lash carries no torque before the load step, or the driveline has "
                "no damped oscillation in contact."
            )
        frequency, damping_ratio = modes.frequency[0], modes.damping_ratio[0]
        decay = 2.0 * np.pi * frequency * damping_ratio
        start, end = (system.contact_torque[0, 0, TORQUE] * inputs[TORQUE] for inputs in (before, after))
        crossing = np.log(abs((start - end) / end)) / decay if end != 0.0 and start != end else 0.0
        duration = max(1.35 * crossing, 3.0 / frequency)
        step = min(1.0 / (200.0 * frequency), max(study.solver.step, duration / 20_000))
        time = step * np.arange(int(duration / step) + 1)
        # without a gap no flank has an offset, and which one is closed does not matter
        regime = regime_under(system, rest.regime, after)
        state = states(regime, rest.x, next(integrals(regime.rates, np.array([step])))[0], time.size)
        across = torque_across(driveline, driveline_at(system, None), regime.flow, 0)[0]
        torque = state @ across[: state.shape[1]] + across[state.shape[1] + TORQUE] * after[TORQUE]
        time += study.load.step_time
        return cls(time, torque, start, end, decay, frequency, damping_ratio, study.load.step_time)


def periods_in_envelope(ratio: float, damping_ratio: float) -> float:
    """Number n_c of periods for which the envelope of the lowest mode stays above the static torque.

    n_c = ln|σr| / (2π ζ1) (report Eq. 3.1, where 2π is missing); NaN for |σr| <= 1, where the envelope is never above.
    """
    return np.log(abs(ratio)) / (2.0 * np.pi * damping_ratio) if abs(ratio) > 1.0 else np.nan


def one_mode_thresholds(study: Study) -> Floats:
    """Load ratios at which one more impact appears as the backlash vanishes, by the lowest mode alone.

    σr = exp(2π ζ1 (n - 1/2)), n = 1 … 4 (report Table 3.1). Empty for a driveline that does not oscillate, and for
    shafts with stages, with which no single mode describes the oscillation.
    """
    driveline = Driveline.from_study(study)
    lowest = np.empty(0) if driveline.staged else driveline.modes(closed=True).damping_ratio[:1]
    return np.exp(2.0 * np.pi * lowest[:, None] * (np.arange(4) + 0.5)).ravel()


def rigid_contact_thresholds(study: Study, count: int = 4) -> Floats:
    """Load ratios at which one more impact appears as the backlash vanishes, by all modes with the lash locked.

    There are at most `count`, and fewer where f has fewer excursions; friction is left out. Empty if the lash carries
    no static torque, the eigenbasis is ill-conditioned, nothing oscillates, or shafts have stages.
    """
    contact = study.lashes[0].contact.but(model="restitution")
    rigid = study.but(lash=study.lashes[0].but(contact=contact))
    system = build(rigid, replace(Driveline.from_study(rigid), shaft_friction=np.zeros(len(study.driveline.shafts))))
    carried = system.contact_torque[0, 0, TORQUE]
    if carried == 0.0 or len(system.steady_motion) > 1:
        return np.empty(0)
    size = 2 * system.inertias  # without the load's wave
    expand, pick, _ = _without_drift(constrained(system.lashes[:, system.inertias : size], [1]), system.drift)
    rates, right = np.linalg.eig(pick @ system.rates[1, :size, :size] @ expand)
    if rates.size == 0 or np.linalg.cond(right) > 1e10:
        return np.empty(0)
    start = np.linalg.solve(right, pick @ system.steady_motion[0, :size, TORQUE])
    # decay from the steady state under the released torque: F = C x + D T across the lash, T = 0 from the step on
    amplitudes = (system.functionals[1, FORCE, :size] @ expand @ right) * start / carried
    felt = abs(amplitudes) > 1e-12
    return levels_of_excursions(_extremes(rates[felt], amplitudes[felt]), count)


def _without_drift(reduction: Reduction, drift: Floats) -> Reduction:
    """Reduction with one coordinate fewer for each of the drifts, to which the other coordinates are then relative.

    drift : (N, D) float64, the drifts: states that nothing depends on; each is zero where the others are not
    """
    if not drift.size:
        return reduction
    along = reduction.pick @ drift
    size, columns = along.shape
    pivots = abs(along).argmax(axis=0)
    identity = np.eye(size)
    relative = identity - along / along[pivots, np.arange(columns)] @ identity[pivots]
    pick = np.delete(relative, pivots, axis=0) @ reduction.pick
    return Reduction(np.delete(reduction.expand, pivots, axis=1), pick, reduction.shift)


def _extremes(rates: ComplexArray, amplitudes: ComplexArray) -> Floats:
    """Minima and maxima of f = Re sum of amplitude · exp(rate t) in turn, a minimum first, until |f| < `_FAINTEST`."""
    fastest = abs(rates.imag).max(initial=0.0)
    if fastest == 0.0:
        return np.empty(0)
    step, slowest = 2.0 * np.pi / fastest / _SAMPLES, -rates.real.max()
    lasting = np.log(abs(amplitudes).sum() / _FAINTEST) / slowest if slowest > 0.0 else np.inf
    time = step * np.arange(int(min(lasting / step, _MOST_SAMPLES)) + 2)
    f = np.zeros(time.size)
    for rate, amplitude in zip(rates, amplitudes, strict=True):
        f += (amplitude * np.exp(rate * time)).real
    rising = np.diff(f) > 0.0
    turns = np.flatnonzero(rising[1:] != rising[:-1]) + 1
    swing = f[turns + 1] - f[turns - 1]
    values = f[turns] - swing**2 / (8.0 * (f[turns + 1] - 2.0 * f[turns] + f[turns - 1]))
    return values[1:] if values.size > 1 and values[0] > values[1] else values


def levels_of_excursions(extremes: Floats, count: int) -> Floats:
    """Load ratios σr from which on f has 1, 2, … `count` separate excursions below -1/σr; fewer where f has fewer.

    Two dips are one excursion while f does not rise above the level between them. As the level rises from the deepest
    minimum, an excursion begins at each minimum, and two become one at each maximum between them.

    Parameters
    ----------
    extremes : (m,) float64
        Minima and maxima of f in turn, a minimum first.
    """
    minima, between = extremes[0::2], extremes[1::2]
    levels: list[float] = []
    for level in np.sort(minima[minima < 0.0]):
        below = minima <= level
        joined = below[:-1] & below[1:] & (between[: minima.size - 1] <= level)
        excursions = below.sum() - joined.sum()
        while len(levels) < min(excursions, count):
            levels.append(-1.0 / level)
    return np.array(levels)
