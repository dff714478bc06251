"""How hard the primary impacts are: the peak-to-peak acceleration after each, and the speed before it.

Q_i = max θ'' - min θ'' and Q = sqrt(sum Q_i²) are report Eqs 3.2 and 3.3.
"""

import numpy as np
import numpy.typing as npt

from clunk.core.jit import compiled, part


@compiled
def peak_to_peak(
    extremes: npt.NDArray[np.float64],
    count: int,
    primaries: npt.NDArray[np.int64],
    impacts: int,
    severity: npt.NDArray[np.float64],
) -> float:
    """Write Q_i of each primary impact to `severity`; return Q = sqrt(sum Q_i^2) (report Eq. 3.3).

    The window of primary i runs from its touch, right limit included, up to the next primary or the end of the run,
    gap phases included, with the one-sided limits at every event.

    Parameters
    ----------
    extremes : (capacity, 2) float64  [rad/s2]
        Largest and smallest acceleration of the phase behind each event.
    primaries : (capacity,) int64
        Indices of the primary impacts among the events.
    severity : (capacity,) float64  [rad/s2]
        Output.
    """
    for i in range(impacts):
        end = primaries[i + 1] if i + 1 < impacts else count
        largest, smallest = window_extremes(extremes, primaries[i], end)
        severity[i] = largest - smallest
    return root_of_squares(severity, impacts)


@part
def approach_velocity(
    events: npt.NDArray[np.void], primaries: npt.NDArray[np.int64], impacts: int, speeds: npt.NDArray[np.float64]
) -> float:
    """Write each primary impact's closing speed to `speeds`; return V = sqrt(sum v_i^2), defined for both models.

    Parameters
    ----------
    speeds : (capacity,) float64  [rad/s]
        Output, v_i = |q'| just before primary impact i.
    """
    for i in range(impacts):
        speeds[i] = abs(events[primaries[i]].speed)
    return root_of_squares(speeds, impacts)


@compiled
def root_of_squares(values: npt.NDArray[np.float64], count: int) -> float:
    """The square root of the sum of the squares of `values[:count]`, summed in order."""
    total = 0.0
    for i in range(count):
        total += values[i] ** 2
    return float(np.sqrt(total))


@part
def window_extremes(extremes: npt.NDArray[np.float64], begin: int, end: int) -> tuple[float, float]:
    """The largest and the smallest acceleration over the phases behind the events from one to before another  [rad/s2].

    extremes : as for `peak_to_peak`
    """
    largest, smallest = -np.inf, np.inf
    for k in range(begin, end):
        largest = max(largest, extremes[k, 0])
        smallest = min(smallest, extremes[k, 1])
    return largest, smallest
