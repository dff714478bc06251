"""One step of the time grid, or the rest of one, in a regime: its first event, and the extremes of accelerations.

The step is expanded into its Taylor polynomial of degree 4 in time. Guards and accelerations are then quartics.
"""

from typing import NamedTuple

import numpy as np

from clunk.core.arrays import FloatArray, IntArray
from clunk.core.events import INSTANT
from clunk.core.jit import part
from clunk.core.regimes import ROUNDING, System
from clunk.core.rk4 import quartic
from clunk.core.rk4.propagator import Steps
from clunk.core.rubbing import WITHIN
from clunk.core.sums import copy, weigh
from clunk.core.switching import set_weighed
from clunk.core.tables import ACCELERATION, TORQUE


class Room(NamedTuple):
    """Arrays of a run: for its present phase between two events, and for the full steps in that phase."""

    inputs: FloatArray  # (I,)  d of the run
    # of the phase: the inputs and guards of its regime, and the expansion of a step
    weighed: FloatArray  # (I,)  u of the regime
    at: IntArray  # (G,)  place of a guard's functional among the outputs: value and terms 2, 3, 4 of each functional
    sign: FloatArray  # (G,)  of each guard
    shift: FloatArray  # (G,)  of each guard
    taylor: FloatArray  # (5, N)  x(s) = sum of taylor[k] s^k
    # of full steps
    by_inputs: FloatArray  # what the phase's inputs add, see `Steps`; the next three are parts of it, which add
    affine: FloatArray  # (3, rows)  to a state and its outputs after no step, one and a stride
    modes_affine: FloatArray  # (2 M,)  to coordinates y
    steady_sag: FloatArray  # (F,)  to the distances of functionals from their chords over a stride, with signs
    z: FloatArray  # (rows,)  the state, padded, and its outputs
    after: FloatArray  # (rows,)  state and outputs after a step or a stride
    # scratch of the bounds on what can follow
    modes: FloatArray  # (2 M,)  coordinates y
    reach: FloatArray  # (F,)  bound of each functional's change from now on, or of its sag


def make_room(system: System, steps: Steps) -> Room:
    """Allocate the arrays that runs use one after the other."""
    width, of_modes, by_inputs = steps.transfer.shape[3], steps.mode_rows.shape[2], np.empty(steps.by_inputs.shape[2])
    affine, of_y, sag = np.split(by_inputs, np.cumsum([3 * width, of_modes]))
    most, driven = system.guards.shape[1], system.input_count
    return Room(
        inputs=np.empty(driven),
        weighed=np.empty(driven),
        at=np.empty(most, np.int64),
        sign=np.empty(most),
        shift=np.empty(most),
        taylor=np.empty((5, system.lashes.shape[1])),
        by_inputs=by_inputs,
        affine=affine.reshape(3, width),
        modes_affine=of_y,
        steady_sag=sag,
        z=np.empty(width),
        after=np.empty(width),
        modes=np.empty(of_modes),
        reach=np.empty(system.functionals.shape[1]),
    )


@part
def enter(room: Room, system: System, regime: int) -> None:
    """Begin a phase in a regime: set its inputs u, and the places, signs and shifts of its guards."""
    set_weighed(system, regime, room.inputs, room.weighed)
    for g in range(system.regimes[regime].guards):
        row = system.guards[regime, g]
        room.at[g], room.sign[g] = 4 * row.functional, row.sign
        room.shift[g] = weigh(system.offsets[regime, g], room.inputs)


@part
def expand(system: System, flow: int, x: FloatArray, room: Room) -> None:
    """Set `room.taylor` to the polynomial of a step in its length, which is RK4's own in a linear regime."""
    taylor, size = room.taylor, x.size
    copy(x, taylor[0])
    for order in range(1, 5):
        for row in range(size):
            value = 0.0
            for k in range(size):
                value += system.rates[flow, row, k] * taylor[order - 1, k]
            if order == 1:
                value += weigh(system.inputs[flow, row], room.weighed)
            taylor[order, row] = value / order


@part
def first_event(
    system: System, regime: int, room: Room, length: float, zero_guard: int, zero_order: int
) -> tuple[float, int]:
    """Time at which the first of the regime's guards turns negative within `length`, and its number; else (length, -1).

    Of the guard that the last event left at zero, with `zero_order` derivatives, these zeros are divided out. Any other
    guard within rounding of zero counts as zero, and so does its rate, so that the next derivative decides. A negative
    guard also counts as zero within what `rubbing.choose_states` takes for zero, and within its change in an INSTANT.
    The latter goes for a positive guard, too, where there is more than one element, as another element's event may have
    been located first. A guard that falls no lower than these tolerances in all the step does not turn negative.
    """
    earliest, which = length, -1
    for guard in range(system.regimes[regime].guards):
        row, sign, shift = system.guards[regime, guard], room.sign[guard], room.shift[guard]
        p, scale, of_rate = _quartic(system, system.regimes[regime].flow, row.functional, room)
        p = sign * p[0] + shift, sign * p[1], sign * p[2], sign * p[3], sign * p[4]
        order, scale = zero_order if guard == zero_guard else 0, scale + abs(shift)
        if system.impulsive and row.lash >= 0 and shift == 0.0:  # a torque, whose terms may all have decayed to nothing
            scale += abs(room.inputs[TORQUE])
        instant = INSTANT * abs(p[1])
        rounding = max(ROUNDING * scale, instant * (system.element_count > 1))
        least = -max(WITHIN * scale, instant)
        if least <= p[0] <= rounding:
            if quartic.extremes(p, length)[1] >= least:
                continue
            order = order or (1 if abs(p[1]) > ROUNDING * of_rate else 2)
        for _ in range(order):
            p = p[1], p[2], p[3], p[4], 0.0
        s = quartic.first_negative(p, length)
        if s >= 0.0 and (which < 0 or s < earliest):
            earliest, which = s, guard
    return earliest, which


@part
def widen_extremes(system: System, flow: int, room: Room, length: float, extremes: FloatArray) -> None:
    """Update the extremes of each lash's acceleration, (L, 2), by those on the step, both ends included  [rad/s2]."""
    for lash in range(system.lash_count):
        p, _, _ = _quartic(system, flow, lash * system.functionals_per_lash + ACCELERATION, room)
        high, low = quartic.extremes(p, length)
        extremes[lash, 0], extremes[lash, 1] = max(extremes[lash, 0], high), min(extremes[lash, 1], low)


@part
def finish(room: Room, s: float, x: FloatArray) -> bool:
    """Set `x` to the state after time `s` of the expanded step; return whether it is finite."""
    taylor, finite = room.taylor, True
    for k in range(x.size):
        x[k] = quartic.evaluate((taylor[0, k], taylor[1, k], taylor[2, k], taylor[3, k], taylor[4, k]), s)
        finite = finite and np.isfinite(x[k])
    return finite


@part
def _quartic(system: System, flow: int, which: int, room: Room) -> tuple[quartic.Quartic, float, float]:
    """The quartic of a functional over the step, and the sums of the magnitudes of the terms of c0 and of c1."""
    c0, taylor = weigh(system.feedthrough[flow, which], room.weighed), room.taylor
    c1 = c2 = c3 = c4 = of_rate = 0.0
    scale = abs(c0)
    for k in range(taylor.shape[1]):
        weight = system.functionals[flow, which, k]
        c0 += weight * taylor[0, k]
        c1 += weight * taylor[1, k]
        c2 += weight * taylor[2, k]
        c3 += weight * taylor[3, k]
        c4 += weight * taylor[4, k]
        scale += abs(weight * taylor[0, k])
        of_rate += abs(weight * taylor[1, k])
    return (c0, c1, c2, c3, c4), scale, of_rate
