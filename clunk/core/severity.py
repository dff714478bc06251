"""How hard the primary impacts are: the peak-to-peak acceleration after each, and the speed before it.

Q_i = max θ'' - min θ'' and Q = sqrt(sum Q_i²) are report Eqs 3.2 and 3.3; V = sqrt(sum v_i²), v_i = |q'| just before.
The window of a primary impact runs from its touch, right limit included, up to the next primary or the end of the run,
gap phases included, with the one-sided limits at every event.
"""

import numpy as np

from clunk.core.arrays import FloatArray
from clunk.core.jit import compiled


@compiled
def root_of_squares(values: FloatArray, count: int) -> float:
    """The square root of the sum of the squares of `values[:count]`, summed in order."""
    total = 0.0
    for i in range(count):
        total += values[i] ** 2
    return np.sqrt(total)
