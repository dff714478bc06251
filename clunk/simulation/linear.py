"""The linear view of vanishing backlash: how many impacts a load ratio brings (report §3.2, Figure 3.5, Table 3.1).

As the gap vanishes, the lash stays closed, and an impact is a change of sign of the torque it carries. That torque is
Ts (1 + σr f(t)) times what reaches the lash, with f(t) the response to the released torque, f(0) = 1. It is on the
other flank while f < -1/σr, so that every excursion of f below that level is one more crossing and back. With the
lowest mode alone f = exp(-ζ1 ω t) cos ω t, and each of its minima adds one.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from clunk.core.reductions import constrained, without_drift
from clunk.core.tables import FORCE, TORQUE
from clunk.simulation.driveline import Driveline, build
from clunk.study.arrays import Floats
from clunk.study.loads import is_ideal_step
from clunk.study.study import Study

_SAMPLES = 64  # a period of the fastest mode that matters, to bracket every minimum
_FAINTEST = 1e-3  # of the first swing: thresholds beyond σr = 1000 are nobody's load ratio
_MOST_SAMPLES = 500_000  # 8000 periods of the fastest mode; half a second
_BLOCK = 1 << 14


def periods_in_envelope(study: Study, ratio: float) -> float:
    """n_c, how many periods the envelope of the lowest mode stays above the static torque.

    n_c = ln(σr) / (2π ζ1) (report Eq. 3.1, where 2π is missing); NaN where nothing oscillates.
    """
    damping_ratio = _lowest_damping_ratio(study)
    if damping_ratio is None or ratio <= 0.0:
        return float("nan")
    return float(np.log(ratio) / (2.0 * np.pi * damping_ratio))


def one_mode_thresholds(study: Study, count: int = 4) -> Floats:
    """Load ratios at which one more impact appears as the backlash vanishes, by the lowest mode alone.

    σr = exp(2π ζ1 (n - 1/2)), n = 1 … `count` (report Table 3.1). Empty for a driveline that does not oscillate.
    """
    damping_ratio = _lowest_damping_ratio(study)
    if damping_ratio is None:
        return np.empty(0)
    return np.asarray(np.exp(2.0 * np.pi * damping_ratio * (np.arange(1, count + 1) - 0.5)), np.float64)


def _lowest_damping_ratio(study: Study) -> float | None:
    """ζ1 of the closed lash; None where nothing oscillates, or no one mode does for shafts with stages."""
    driveline = Driveline.from_study(study)
    ratios = np.empty(0) if driveline.staged else driveline.modes(closed=True).damping_ratio
    return float(ratios[0]) if ratios.size else None


def rigid_contact_thresholds(study: Study, count: int = 4) -> Floats:
    """Load ratios at which one more impact appears, by all modes of the locked chain; fewer where f has fewer."""
    response = _Response.of(study)
    return np.empty(0) if response is None else levels_of_excursions(response.extremes(), count)


def levels_of_excursions(extremes: Floats, count: int) -> Floats:
    """The σr from which on f has 1, 2, … `count` separate excursions below -1/σr; fewer where f has fewer.

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
        excursions = int(below.sum()) - int(joined.sum())
        while len(levels) < min(excursions, count):
            levels.append(-1.0 / level)
    return np.array(levels, dtype=np.float64)


def thresholds_on(study: Study, parameter: str, ratios: Floats) -> Floats:
    """Threshold load ratios as values of a swept torque of an ideal step; empty for any other parameter or load.

    σr is (T before - T after) / T after, whichever of the two torques is swept.
    """
    load = study.load
    if not is_ideal_step(load):
        return np.empty(0)
    if parameter == "load.ratio":
        return ratios
    if parameter == "load.initial_torque" and load.final_torque:
        return (1.0 + ratios) * load.final_torque
    if parameter == "load.final_torque" and load.initial_torque:
        return load.initial_torque / (1.0 + ratios)
    return np.empty(0)


@dataclass(frozen=True, eq=False)
class _Response:
    """f(t) = Re sum of amplitude · exp(rate t)."""

    rate: npt.NDArray[np.complex128]
    amplitude: npt.NDArray[np.complex128]

    @classmethod
    def of(cls, study: Study) -> "_Response | None":
        """None where there is no static torque across the lash, no eigenbasis to speak of, or a shaft with stages."""
        contact = study.lashes[0].contact.model_copy(update={"model": "restitution"})
        shafts = tuple(shaft.model_copy(update={"friction": 0.0}) for shaft in study.driveline.shafts)
        line = study.driveline.model_copy(update={"shafts": shafts})  # linear: friction is none
        lash = study.lashes[0].model_copy(update={"contact": contact})
        locked = study.model_copy(update={"lash": lash, "driveline": line})
        system = build(locked)
        carried = system.contact_torque[0, 0, TORQUE]
        if carried == 0.0 or len(system.preload) > 1:
            return None
        lashes = system.lashes[:, system.inertias : 2 * system.inertias]
        expand, pick, _ = without_drift(constrained(lashes, [1]), system.drift)
        rate, right = np.linalg.eig(pick @ system.rates[1] @ expand)
        if rate.size == 0 or np.linalg.cond(right) > 1e10:
            return None
        start = np.linalg.solve(right, pick @ system.preload[0, :, TORQUE])
        amplitude = (system.functionals[1, FORCE] @ expand @ right) * start / carried
        # the torque released is felt as the missing balance: F = C x + D T with T = 0 from the step on
        keep = np.abs(amplitude) > 1e-12
        return cls(rate[keep].astype(np.complex128), amplitude[keep].astype(np.complex128))

    def __call__(self, time: Floats) -> Floats:
        return np.asarray((np.exp(np.multiply.outer(time, self.rate)) @ self.amplitude).real)

    def extremes(self) -> Floats:
        """Minima and maxima of f in turn, a minimum first, until its envelope has become too faint."""
        fastest = float(np.max(np.abs(self.rate.imag), initial=0.0))
        if fastest == 0.0:
            return np.empty(0)
        slowest = float(-self.rate.real.max())
        dt = 2.0 * np.pi / fastest / _SAMPLES
        lasting = np.log(np.abs(self.amplitude).sum() / _FAINTEST) / slowest if slowest > 0.0 else np.inf
        steps = int(min(lasting / dt, _MOST_SAMPLES))
        turns = []
        for start in range(0, steps, _BLOCK):  # the exponentials of all modes at all times would fill the memory
            time = np.asarray(dt * np.arange(start, min(start + _BLOCK, steps) + 2), dtype=np.float64)
            f = self(time)
            rising = np.diff(f) > 0.0
            turns.append(self._turns(time[np.flatnonzero(rising[1:] != rising[:-1]) + 1], dt))
        values: Floats = np.concatenate(turns) if turns else np.empty(0)
        return values[1:] if values.size > 1 and values[0] > values[1] else values

    def _turns(self, near: Floats, within: float) -> Floats:
        """The values of f where its slope is zero, by Newton's method from times that near.

        From a 64th of a period off, each step leaves the cube of the error, 1e-3, 1e-9, none; and to first order the
        value at an extreme does not depend on its time.
        """
        time = near
        for _ in range(3):
            modes = np.exp(np.multiply.outer(time, self.rate)) * self.amplitude
            slope, bend = (modes @ self.rate).real, (modes @ self.rate**2).real
            step = np.divide(-slope, bend, out=np.zeros_like(slope), where=bend != 0.0)
            time = np.clip(time + step, near - within, near + within)
        return self(time)
