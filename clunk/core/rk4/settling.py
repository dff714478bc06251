"""Whether a run is over: no event can follow, and no acceleration that would count."""

import numpy as np
import numpy.typing as npt

from clunk.core.jit import compiled
from clunk.core.regimes import ACCELERATION, System
from clunk.core.rk4.propagator import Steps
from clunk.core.sequence import find_primaries
from clunk.core.severity import window_extremes

FloatArray = npt.NDArray[np.float64]


@compiled
def settled(
    system: System,
    steps: Steps,
    regime: int,
    torque: float,
    half_gap: float,
    x: FloatArray,
    events: npt.NDArray[np.void],
    count: int,
    primaries: npt.NDArray[np.int64],
) -> bool:
    """Whether it is proved that no event follows, and no acceleration beyond the extremes of the open window.

    Every functional stays within its rest value plus or minus the sum of its modes' present amplitudes, for ever.
    """
    flow = system.regimes[regime].flow
    if steps.provable[flow] == 0:
        return False
    size = system.rates.shape[1]
    gap_input = system.regimes[regime].side * half_gap
    watched = steps.mode_reach.shape[1]
    reach = np.zeros(watched)
    for mode in range(size):
        widest = 0.0
        for functional in range(watched):
            widest = max(widest, steps.mode_reach[flow, functional, mode])
        if widest == 0.0:
            continue  # the other one of a complex pair, or without effect on anything that is watched
        real, imaginary = 0.0, 0.0
        for k in range(size):
            away = x[k] - steps.rest_state[flow, k, 0] * torque - steps.rest_state[flow, k, 1] * gap_input
            real += steps.mode_rows[flow, 0, mode, k] * away
            imaginary += steps.mode_rows[flow, 1, mode, k] * away
        amplitude = np.sqrt(real * real + imaginary * imaginary)
        for functional in range(watched):
            reach[functional] += amplitude * steps.mode_reach[flow, functional, mode]
    for guard in range(system.regimes[regime].guards):
        row = system.guards[regime, guard]
        functional = row.functional
        at_rest = (
            steps.rest_functional[flow, functional, 0] * torque + steps.rest_functional[flow, functional, 1] * gap_input
        )
        value = row.sign * at_rest + row.offset * half_gap
        if not value > (1.0 + 1e-9) * reach[functional]:
            return False
    found = find_primaries(events, count, system.sticking_time, primaries)
    if found == 0 or system.impulsive != 0:  # nothing is asked of the acceleration
        return True
    largest, smallest = window_extremes(events, primaries[found - 1], count)
    swing = (1.0 + 1e-9) * reach[ACCELERATION]
    return bool(largest >= swing and smallest <= -swing)
