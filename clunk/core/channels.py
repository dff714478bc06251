"""Channels: quantities of a driveline that are linear in its state and inputs, tabulated for a walk over a run.

In a flow, z = (x, u) obeys z' = M z, so that a channel c · z is the series c Mᵏ z tᵏ/k!. Over a step of 1.4 divided by
the fastest rate of the flow, its first TERMS terms give it to rounding. Where the fastest modes have died down, a
channel hangs on the others alone, and steps may be longer: a flow has a *level* for each gap of a factor of two or more
between its rates, with the time after which it may be used.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.regimes import System
from clunk.core.tables import TORQUE, TORQUE_RATE

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

TERMS = 20  # a multiple of four
CONTACT_TORQUE, CLOSING = 0, 1  # the first channels of a lash, signed like q and q'
OF_LASH = 2  # and how many these are; behind those of the last lash come the measures
PEAK_TO_PEAK, LARGEST = 0, 1  # reductions of a channel over a run

_STEP = 1.4  # of 1/rate: the next term is 1.4^20/20! = 3e-16
_DIED_DOWN = 40.0  # e-folds: 4e-18
_SOUND = 1e-11  # of a projector: how little P P - P and P M - M P may be


class Channels(NamedTuple):
    """The channels of a driveline; K flows, V levels, L lashes, C channels, Z = N + I numbers in z."""

    lengths: FloatArray  # (K, V)  s, of a step
    begins: FloatArray  # (K, V)  s into a stretch, from when on a level may be used; 0 for the first
    steps: FloatArray  # (K, V, Z, Z)  exp(M h) for a step of length h, transposed
    rates: FloatArray  # (K, V, Z, Z)  M h, without the modes that have died down, transposed
    series: FloatArray  # (K, V, C, Z, TERMS)  coefficients by z, of powers of t/h
    of_impacts: int  # whether primary impacts are measured too
    reductions: IntArray  # (C - OF_LASH L,)  of each measure
    contact_stiffness: FloatArray  # (L,)  N m/rad
    contact_damping: FloatArray  # (L,)  N m s/rad
    mobility: FloatArray  # (L,)  1/(kg m2), of q: q'' of a unit torque across the open lash


def tabulate(system: System, rows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Lengths, begins, steps, rates and series of `Channels`.

    rows : (K, C, Z) float64, channel = row · z in each flow
    """
    flows = [
        _levels(generator, channels, system) for generator, channels in zip(_generators(system), rows, strict=True)
    ]
    most = max(map(len, flows))
    # levels that a flow does not have are never used
    padded = [[*levels, *[levels[0]._replace(begin=np.inf)] * (most - len(levels))] for levels in flows]
    lengths, begins, steps, rates, series = (
        np.array([[level[k] for level in levels] for levels in padded]) for k in range(5)
    )
    return lengths, begins, steps, rates, series


def _generators(system: System) -> FloatArray:
    """(K, Z, Z) float64, M of each flow."""
    flows, size, driven = system.inputs.shape
    generators = np.zeros((flows, size + driven, size + driven))
    generators[:, :size, :size], generators[:, :size, size:] = system.rates, system.inputs
    generators[:, size + TORQUE, size + TORQUE_RATE] = system.ramps
    return generators


class _Level(NamedTuple):
    """A level of a flow, as in `Channels`."""

    length: float
    begin: float
    step: FloatArray
    rates: FloatArray
    series: FloatArray


def _levels(generator: FloatArray, channels: FloatArray, system: System) -> list[_Level]:
    """The levels of a flow, each with longer steps than the one before."""
    n = system.inertias
    # speeds in units in which they are of the size of the angles
    unit = np.ones(len(generator))
    unit[n : 2 * n] = np.sqrt(np.abs(generator[n : 2 * n, :n]).max(initial=0.0)) or 1.0
    scaled = generator * unit / unit[:, None]
    eigenvalues, right = np.linalg.eig(scaled)
    others, left = np.linalg.eig(scaled.T)
    sizes = np.abs(eigenvalues)
    levels: list[_Level] = []
    slowest, fastest = _STEP / system.end_time, float(sizes.max())
    while True:
        fast = sizes > fastest * (1.0 + 1e-6)
        projector = np.eye(len(scaled))
        decay = -float(eigenvalues.real[fast].max(initial=-np.inf))
        if fast.any():
            if not decay > 0.0:
                break
            columns, lines = right[:, fast], left[:, np.abs(others) > fastest * (1.0 + 1e-6)].T
            projector = projector - (columns @ np.linalg.pinv(lines @ columns) @ lines).real
        slow = scaled @ projector
        wrong = [projector @ projector - projector, (projector @ scaled - slow) / max(float(sizes.max()), slowest)]
        if not max(float(np.abs(part).max()) for part in wrong) <= _SOUND:
            break
        length = _STEP / max(fastest, slowest)
        rates = (slow * length) * unit[:, None] / unit
        terms = [channels @ (projector * unit[:, None] / unit)]
        for k in range(1, TERMS):
            terms.append(terms[-1] @ rates / k)
        begin = _DIED_DOWN / decay if fast.any() else 0.0
        levels.append(_Level(length, begin, _exponential(generator * length).T, rates.T, np.stack(terms, axis=2)))
        slower = sizes[sizes <= fastest / 2.0]
        if fastest <= slowest or not slower.size or not begin < system.end_time:
            break
        fastest = float(slower.max())
    return levels


def _exponential(matrix: FloatArray) -> FloatArray:
    """Matrix exponential, by the series of a part of the matrix that is squared again and again."""
    halvings = max(0, int(np.ceil(np.log2(max(float(np.abs(np.linalg.eigvals(matrix)).max()), 1e-300)))) + 3)
    part = matrix / 2.0**halvings
    power = total = np.eye(len(matrix))
    for k in range(1, TERMS):
        power = power @ part / k
        total = total + power
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total, np.float64)
