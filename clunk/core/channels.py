"""Channels: quantities of a driveline that are linear in its state and inputs, tabulated for a walk over a run.

In a flow, z = (x, u) obeys z' = M z, so that a channel c · z is the series c Mᵏ z tᵏ/k!. Over a step of 1.4 divided by
the fastest rate of the flow, its first TERMS terms give it to rounding. Where the fastest modes have died down, the
series is as good over longer steps: there are steps of twice, four times, … this length.
"""

from typing import NamedTuple

from clunk.core.arrays import FloatArray, IntArray, Positions

TERMS = 20
LEVELS = 4  # of steps, each twice as long as the one before; with more, rounding in fast modes would spoil the series
CONTACT_TORQUE, CLOSING = 0, 1  # the channels of a lash: its contact torque, signed like q, and q'
OF_LASH = 2  # channels of each lash; behind those of the last lash come the measures


class Channels(NamedTuple):
    """The channels of D drivelines; K flows, V levels, L lashes, C channels, Z = N + I numbers in z."""

    lengths: FloatArray  # (D, K)  s, of the shortest step
    steps: FloatArray  # (D, K, V, Z, Z)  exp(M h) for a step of each level, transposed
    rates: FloatArray  # (D, K, Z, Z)  M h for the shortest step, transposed
    series: FloatArray  # (D, K, C, Z, TERMS)  coefficients by z, of powers of t/h for the shortest step
    of_impacts: int  # how many quantities of primary impacts the study asks for; if none, impacts are not measured
    swings: IntArray  # (C - OF_LASH L,)  whether a measure is peak-to-peak, and not the largest magnitude
    contact_stiffness: FloatArray  # (D, L)  N m/rad
    contact_damping: FloatArray  # (D, L)  N m s/rad

    def at(self, drivelines: Positions | list[int]) -> "Channels":
        """The channels of the drivelines at some positions."""
        common = "of_impacts", "swings"
        return self._replace(**{name: getattr(self, name)[drivelines] for name in self._fields if name not in common})
