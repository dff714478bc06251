"""Channels: quantities of a driveline that are linear in its state and inputs, tabulated for a walk over a run.

In a flow, z = (x, u) obeys z' = M z, so that a channel c · z is the series c Mᵏ z tᵏ/k!. Over a step of 1.4 divided by
the fastest rate of the flow, its first TERMS terms give it to rounding. Where the fastest modes have died down, a
channel hangs on the others alone, and steps may be longer: a flow has a *level* for each gap of a factor of two or more
between its rates, with the time after which it may be used.
"""

from contextlib import suppress
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.exponential import exponentials
from clunk.core.regimes import Each, System
from clunk.core.tables import TORQUE, TORQUE_RATE

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
ComplexArray = npt.NDArray[np.complex128]

TERMS = 20  # a multiple of four
CONTACT_TORQUE, CLOSING = 0, 1  # the first channels of a lash, signed like q and q'
OF_LASH = 2  # and how many these are; behind those of the last lash come the measures
PEAK_TO_PEAK, LARGEST = 0, 1  # reductions of a channel over a run

_STEP = 1.4  # of 1/rate: the next term is 1.4^20/20! = 3e-16
_DIED_DOWN = 40.0  # e-folds: 4e-18
_SOUND = 1e-11  # of a projector: how little P P - P and P M - M P may be


class Channels(NamedTuple):
    """The channels of D drivelines; K flows, V levels, L lashes, C channels, Z = N + I numbers in z.

    A level that a flow of a driveline does not have begins at infinity.
    """

    lengths: FloatArray  # (D, K, V)  s, of a step
    begins: FloatArray  # (D, K, V)  s into a stretch, from when on a level may be used; 0 for the first
    steps: FloatArray  # (D, K, V, Z, Z)  exp(M h) for a step of length h, transposed
    rates: FloatArray  # (D, K, V, Z, Z)  M h, without the modes that have died down, transposed
    series: FloatArray  # (D, K, V, C, Z, TERMS)  coefficients by z, of powers of t/h
    of_impacts: int  # whether primary impacts are measured too
    reductions: IntArray  # (C - OF_LASH L,)  of each measure
    contact_stiffness: FloatArray  # (D, L)  N m/rad
    contact_damping: FloatArray  # (D, L)  N m s/rad
    passed: FloatArray  # (D, H, L, L)  as of `System`  [kg m2]

    def at(self, drivelines: npt.NDArray[np.intp] | list[int]) -> "Channels":
        """Those of some drivelines."""
        common = "of_impacts", "reductions"
        return self._replace(**{name: getattr(self, name)[drivelines] for name in self._fields if name not in common})


class Levels(NamedTuple):
    """Those of some flows, F of them; see `Channels`."""

    lengths: FloatArray  # (F, V)
    begins: FloatArray  # (F, V)
    steps: FloatArray  # (F, V, Z, Z)
    rates: FloatArray  # (F, V, Z, Z)
    series: FloatArray  # (F, V, C, Z, TERMS)


def tabulate(each: Each, channels: FloatArray, system: System) -> Levels:
    """The levels of each flow of D drivelines, (D, K, V, …).

    Parameters
    ----------
    each : Each
    channels : (D, K, C, Z) float64
        Channel = row · z.
    system : System
        Of the first driveline.
    """
    *batch, size, driven = each.inputs.shape
    generators = np.zeros((*batch, size + driven, size + driven))
    generators[..., :size, :size], generators[..., :size, size:] = each.rates, each.inputs
    generators[..., size + TORQUE, size + TORQUE_RATE] = system.ramps
    flows, rows = (array.reshape(-1, *array.shape[-2:]) for array in (generators, channels))
    ends = np.repeat(each.end_time[:, 0], batch[1])
    levels = _levels(flows, rows, system.inertias, ends)
    return Levels._make(array.reshape(*batch, *array.shape[1:]) for array in levels)


def _levels(generators: FloatArray, channels: FloatArray, n: int, ends: FloatArray) -> Levels:
    """The levels of flows, each with longer steps than the one before; (F, Z, Z) and (F, C, Z), to these ends, (F,)."""
    # speeds in units in which they are of the size of the angles
    unit = np.ones(generators.shape[:2])
    fastest = np.sqrt(np.abs(generators[:, n : 2 * n, :n]).max(axis=(1, 2), initial=0.0))
    unit[:, n : 2 * n] = np.where(fastest > 0.0, fastest, 1.0)[:, None]
    into, back = unit[:, None] / unit[..., None], unit[..., None] / unit[:, None]
    scaled = generators * into
    rates, right = _fastest_first(*np.linalg.eig(scaled))
    others, left = _fastest_first(*np.linalg.eig(scaled.swapaxes(1, 2)))
    sizes, slowest, levels = np.abs(rates), _STEP / ends, list[Levels]()
    fastest, going = sizes[:, 0], np.arange(len(sizes))
    while going.size:
        faster = fastest[:, None] * (1.0 + 1e-6)
        fast = (sizes[going] > faster) & (np.abs(others[going]) > faster)
        decay = -rates.real[going].max(axis=1, where=fast, initial=-np.inf)
        projector = _without(fast, right[going], left[going])
        slow = scaled[going] @ projector
        wrong = np.abs(projector @ projector - projector).max(axis=(1, 2))
        moved = np.abs(projector @ scaled[going] - slow).max(axis=(1, 2)) / np.maximum(sizes[going, 0], slowest[going])
        sound = (decay > 0.0) & (wrong <= _SOUND) & (moved <= _SOUND)
        going, fastest, decay, projector, slow = (each[sound] for each in (going, fastest, decay, projector, slow))

        length = _STEP / np.maximum(fastest, slowest[going])
        moving = (slow * length[:, None, None]) * back[going]
        terms = [channels[going] @ (projector * back[going])]
        for k in range(1, TERMS):
            terms.append(terms[-1] @ moving / k)
        begin = _DIED_DOWN / decay
        # of matrices that are far from normal, four times the largest |λ|
        steps = exponentials(generators[going] * length[:, None, None], 4.0 * sizes[going, 0] * length)
        level = Levels(length, begin, steps.swapaxes(1, 2), moving.swapaxes(1, 2), np.stack(terms, axis=-1))
        levels.append(_spread(level, going, levels[0]) if levels else level)

        slower = np.where(sizes[going] <= fastest[:, None] / 2.0, sizes[going], -1.0).max(axis=1)
        more = (fastest > slowest[going]) & (slower >= 0.0) & (begin < ends[going])
        going, fastest = going[more], slower[more]
    return Levels._make(np.stack(arrays, axis=1) for arrays in zip(*levels, strict=True))


def _fastest_first(rates: ComplexArray, vectors: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    order, rates, vectors = np.argsort(-np.abs(rates), axis=1, kind="stable"), rates + 0j, vectors + 0j
    return np.take_along_axis(rates, order, axis=1), np.take_along_axis(vectors, order[:, None], axis=2)


def _without(fast: npt.NDArray[np.bool_], right: ComplexArray, left: ComplexArray) -> FloatArray:
    """Projectors along the fast modes, of which these are the right and, of the transpose, the left eigenvectors.

    Not numbers where they can't be told apart.
    """
    identity = np.eye(fast.shape[1])
    if not fast.any():
        return np.broadcast_to(identity, right.shape).copy()
    columns, lines = right * fast[:, None], (left * fast[:, None]).swapaxes(1, 2)
    gram = lines @ columns + np.where(fast[:, None], 0.0, identity)
    try:
        across = np.linalg.solve(gram, lines)
    except np.linalg.LinAlgError:
        across = np.full_like(lines, np.nan)
        for k in range(len(gram)):
            with suppress(np.linalg.LinAlgError):
                across[k] = np.linalg.solve(gram[k], lines[k])
    return np.asarray(identity - (columns @ across).real)


def _spread(level: Levels, flows: IntArray, first: Levels) -> Levels:
    """The level of some flows among those of all; the others have their first one, which never begins."""
    spread = Levels._make(array.copy() for array in first)
    spread.begins[:] = np.inf
    for array, some in zip(spread, level, strict=True):
        array[flows] = some
    return spread
