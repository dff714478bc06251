"""One short step through a regime, with everything in it located.

The step is expanded into its Taylor polynomial of degree 4 in time. Guards and acceleration are then quartics.
"""

import numpy as np
import numpy.typing as npt

from clunk.core.jit import compiled
from clunk.core.regimes import ACCELERATION, System
from clunk.core.rk4 import quartic
from clunk.core.switching import ROUNDING

FloatArray = npt.NDArray[np.float64]


@compiled
def expand(system: System, flow: int, x: FloatArray, torque: float, gap_input: float, taylor: FloatArray) -> None:
    """The step as a polynomial of its length: x(s) = sum of taylor[k] s^k, RK4's own for a linear regime."""
    size = x.size
    for k in range(size):
        taylor[0, k] = x[k]
    for order in range(1, 5):
        for row in range(size):
            value = 0.0
            for k in range(size):
                value += system.rates[flow, row, k] * taylor[order - 1, k]
            if order == 1:
                value += system.inputs[flow, row, 0] * torque + system.inputs[flow, row, 1] * gap_input
            taylor[order, row] = value / order


@compiled
def first_event(
    system: System,
    regime: int,
    torque: float,
    half_gap: float,
    taylor: FloatArray,
    length: float,
    zero_guard: int,
    zero_order: int,
) -> tuple[float, int]:
    """When the first of the regime's guards turns negative within `length`, and which; (length, -1) if none does.

    Where the last event left a guard at zero, with or without its first derivatives, those zeros are divided out; a
    guard within rounding of zero is taken to be zero, so that its derivatives decide.
    """
    earliest, which = length, -1
    flow, gap_input = system.regimes[regime].flow, system.regimes[regime].side * half_gap
    for guard in range(system.regimes[regime].guards):
        row = system.guards[regime, guard]
        functional, sign, shift = row.functional, row.sign, row.offset * half_gap
        c0, c1, c2, c3, c4, scale = _quartic(system, flow, functional, torque, gap_input, taylor)
        c0, c1, c2, c3, c4 = sign * c0 + shift, sign * c1, sign * c2, sign * c3, sign * c4
        order = zero_order if guard == zero_guard else 0
        if order == 0 and abs(c0) <= ROUNDING * (scale + abs(shift)):
            order = 1
        for _ in range(order):
            c0, c1, c2, c3, c4 = c1, c2, c3, c4, 0.0
        s = quartic.first_negative(c0, c1, c2, c3, c4, length)
        if s >= 0.0 and (which < 0 or s < earliest):
            earliest, which = s, guard
    return earliest, which


@compiled
def acceleration_extremes(
    system: System, flow: int, torque: float, gap_input: float, taylor: FloatArray, length: float
) -> tuple[float, float]:
    """The largest and the smallest acceleration on the step, both ends included  [rad/s2]."""
    c0, c1, c2, c3, c4, _ = _quartic(system, flow, ACCELERATION, torque, gap_input, taylor)
    return quartic.extremes(c0, c1, c2, c3, c4, length)


@compiled
def finish(taylor: FloatArray, s: float, x: FloatArray) -> bool:
    """Set `x` to the state after time `s` of the expanded step; return whether it is finite."""
    finite = True
    for k in range(x.size):
        x[k] = quartic.evaluate(taylor[0, k], taylor[1, k], taylor[2, k], taylor[3, k], taylor[4, k], s)
        finite = finite and np.isfinite(x[k])
    return finite


@compiled
def _quartic(
    system: System, flow: int, which: int, torque: float, gap_input: float, taylor: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """A functional over the step: the coefficients of its quartic, and the size of the terms that make the first."""
    driven = system.feedthrough[flow, which, 0] * torque + system.feedthrough[flow, which, 1] * gap_input
    c0, c1, c2, c3, c4, scale = driven, 0.0, 0.0, 0.0, 0.0, abs(driven)
    for k in range(taylor.shape[1]):
        weight = system.functionals[flow, which, k]
        c0 += weight * taylor[0, k]
        c1 += weight * taylor[1, k]
        c2 += weight * taylor[2, k]
        c3 += weight * taylor[3, k]
        c4 += weight * taylor[4, k]
        scale += abs(weight * taylor[0, k])
    return c0, c1, c2, c3, c4, scale
