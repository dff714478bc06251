"""Whether a run is over: no event can follow, and no acceleration that would count."""

import numpy as np

from clunk.core.arrays import FloatArray
from clunk.core.jit import part
from clunk.core.regimes import System, lashes_of
from clunk.core.rk4.propagator import Steps
from clunk.core.rk4.step import Room
from clunk.core.runs import Log
from clunk.core.sequence import find_primaries
from clunk.core.severity import window_extremes
from clunk.core.switching import weigh
from clunk.core.tables import ACCELERATION


@part
def settled(
    system: System,
    steps: Steps,
    regime: int,
    first_regime: int,
    room: Room,
    x: FloatArray,
    log: Log,
    count: int,
) -> bool:
    """Whether no event follows, and no acceleration beyond the extremes of the open windows.

    Every functional stays within its rest value plus or minus the sum of its modes' present amplitudes, for ever. That
    is proved for whole steps, and within them looked at in eight places. The first regime tells the initial flanks.
    """
    flow = system.regimes[regime].flow
    if steps.provable[flow] == 0:
        return False
    reach, primaries = room.reach, room.primaries
    _reach(steps, flow, room, x, reach)
    for guard in range(system.regimes[regime].guards):
        functional = system.guards[regime, guard].functional
        at_rest = room.sign[guard] * weigh(steps.rest_functional[flow, functional], room.weighed)
        if not at_rest + room.shift[guard] > (1.0 + 1e-9) * reach[functional]:
            return False
    if system.impulsive != 0:  # nothing is asked of the acceleration
        return True
    for lash in range(lashes_of(system)):
        side = system.contacts[first_regime, lash].side
        impacts = find_primaries(log.events, count, lash, side, system.sticking_time[lash], primaries)
        if impacts > 0:  # else nothing is asked of the acceleration either
            largest, smallest = window_extremes(log.extremes[:, lash], primaries[impacts - 1], count)
            acceleration = lash * system.functionals_per_lash + ACCELERATION
            at_rest = weigh(steps.rest_functional[flow, acceleration], room.weighed)
            swing = (1.0 + 1e-9) * reach[acceleration]
            if not (largest >= at_rest + swing and smallest <= at_rest - swing):
                return False
    return True


@part
def _reach(steps: Steps, flow: int, room: Room, x: FloatArray, reach: FloatArray) -> None:
    """How far each functional can get from its rest value from now on, into `reach`: its modes' amplitudes, summed."""
    size, watched = steps.mode_reach.shape[2], steps.mode_reach.shape[1]
    reach[:] = 0.0
    for mode in range(size):
        widest = 0.0
        for functional in range(watched):
            widest = max(widest, steps.mode_reach[flow, functional, mode])
        if widest == 0.0:
            continue  # the other one of a complex pair, or without effect on anything that is watched
        total = 0j
        for k in range(size):
            away = x[k]
            for j in range(room.weighed.size):
                away -= steps.rest_state[flow, k, j] * room.weighed[j]
            total += steps.mode_rows[flow, mode, k] * away
        amplitude = np.sqrt(total.real * total.real + total.imag * total.imag)
        for functional in range(watched):
            reach[functional] += amplitude * steps.mode_reach[flow, functional, mode]
