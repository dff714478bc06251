"""Channels: quantities of a driveline that are linear in its state and inputs, tabulated for a walk over a run.

In a flow, z = (x, u) obeys z' = M z, so that a channel c · z is the series c Mᵏ z tᵏ/k!. Over a step of 1.4 divided by
the fastest rate of the flow, its first TERMS terms give it to rounding. Where the fastest modes have died down, the
series is as good over longer steps: there are steps of twice, four times, … this length.
"""

from typing import NamedTuple

import numpy as np

from clunk.core.arrays import FloatArray, IntArray, Positions
from clunk.core.exponential import exponentials
from clunk.core.regimes import System
from clunk.core.tables import TORQUE, TORQUE_RATE

TERMS = 20  # a multiple of four
LEVELS = 4  # of steps, each twice as long as the one before: beyond, rounding in fast modes would spoil the series
CONTACT_TORQUE, CLOSING = 0, 1  # the first channels of a lash, signed like q and q'
OF_LASH = 2  # and how many these are; behind those of the last lash come the measures

_STEP = 1.4  # of 1/rate: the next term is 1.4^20/20! = 3e-16


class Channels(NamedTuple):
    """The channels of D drivelines; K flows, V levels, L lashes, C channels, Z = N + I numbers in z."""

    lengths: FloatArray  # (D, K)  s, of the shortest step
    steps: FloatArray  # (D, K, V, Z, Z)  exp(M h) for a step of each level, transposed
    rates: FloatArray  # (D, K, Z, Z)  M h for the shortest step, transposed
    series: FloatArray  # (D, K, C, Z, TERMS)  coefficients by z, of powers of t/h for the shortest step
    of_impacts: int  # whether primary impacts are measured too
    swings: IntArray  # (C - OF_LASH L,)  whether a measure is peak-to-peak, and not the largest magnitude
    contact_stiffness: FloatArray  # (D, L)  N m/rad
    contact_damping: FloatArray  # (D, L)  N m s/rad

    def at(self, drivelines: Positions | list[int]) -> "Channels":
        """Those of some drivelines."""
        common = "of_impacts", "swings"
        return self._replace(**{name: getattr(self, name)[drivelines] for name in self._fields if name not in common})


def tabulate(systems: System, channels: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The lengths, steps, rates and series of D drivelines, see `Channels`.

    Parameters
    ----------
    systems : System
        Of a batch.
    channels : (D, K, C, Z) float64
        Channel = row · z.
    """
    *flows, size, driven = systems.inputs.shape
    generators = np.zeros((*flows, size + driven, size + driven))
    generators[..., :size, :size], generators[..., :size, size:] = systems.rates, systems.inputs
    generators[..., size + TORQUE, size + TORQUE_RATE] = systems.ramps
    fastest = np.abs(np.linalg.eigvals(systems.rates)).max(axis=-1)
    lengths = _STEP / np.maximum(fastest, _STEP / systems.end_time)
    rates = generators * lengths[..., None, None]
    terms = [channels]
    for k in range(1, TERMS):
        terms.append(terms[-1] @ rates / k)
    steps = [exponentials(rates, 4.0 * fastest * lengths)]  # of matrices far from normal, four times the largest |λ|
    for _ in range(1, LEVELS):
        steps.append(steps[-1] @ steps[-1])
    transposed = [np.ascontiguousarray(array.swapaxes(-1, -2)) for array in (np.stack(steps, axis=2), rates)]
    return lengths, *transposed, np.stack(terms, axis=-1)
