"""The motion within a stretch, in one regime under one piece of the load: linear, x' = A x + B u with a constant u.

A ramp of the load is a part of its wave, and so of x. A phase, from one event to the next, is one stretch or several.

With z = (x, 1), z(t) = exp(M t) z(0), M = [[A, B u], [0, 0]]. Every phase starts from a known state; no event is
searched for.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from clunk.core import switching
from clunk.core.regimes import System
from clunk.core.runs import BEGIN, LEVEL, SLOPE, WAVE, WAVE_PARTNER
from clunk.core.status import Status
from clunk.core.tables import TORQUE
from clunk.study.arrays import Floats, Integers

_TERMS = 20  # of the power series, up to a norm of 1/2: the next one is 4e-25


class Regime(NamedTuple):
    """A regime under constant inputs: x' = rates · x + forcing; N states, x = (θ, θ')."""

    flow: int  # its number
    rates: Floats  # (N, N)
    forcing: Floats  # (N,)
    inputs: Floats  # (I,)  u, each by the regime's weight
    sides: Integers  # (L,)  sign of q on each lash's flank concerned, 0 for none
    closed: Integers  # (L,)  whether its flanks press on each other

    @property
    def matrix(self) -> Floats:
        """M, (N + 1, N + 1)."""
        matrix = np.pad(self.rates, (0, 1))
        matrix[:-1, -1] = self.forcing
        return matrix


def regime_under(system: System, number: int, inputs: Floats) -> Regime:
    """One of the regimes of a system under constant inputs (T, φ/2, T', …)  [N m, rad, N m/s]."""
    flow, contacts, u = system.regimes[number]["flow"], system.contacts[number], system.weights[number].copy()
    u[: inputs.size] *= inputs  # the others are 1
    return Regime(flow, system.rates[flow], system.inputs[flow] @ u, u, contacts["side"], contacts["closed"])


class Preload(NamedTuple):
    """Steady motion in contact."""

    status: Status
    regime: int
    sides: Integers  # (L,)  of the initial flanks, 0 for none
    x: Floats  # (N,)  [rad, rad/s]


def preload(system: System, inputs: Floats) -> Preload:
    """Steady motion in contact under constant inputs."""
    x = np.zeros(system.rates.shape[1])
    status, regime = switching.preload(system, inputs, x)
    return Preload(Status(status), regime, system.contacts[regime]["side"] * (status == Status.OK), x)


@dataclass(frozen=True, eq=False)
class Stretch:
    """A part of a run in one regime under one piece of its load."""

    begin: float  # s after the load step
    end: float
    regime: Regime
    x: Floats  # (N,)  where it begins  [rad, rad/s], and the load's wave

    @cached_property
    def after(self) -> Floats:
        """(N,) the state where it ends."""
        return states(self.regime, self.x, self.end - self.begin, 0.0, 1)[0]


def stretches(
    system: System, before: Floats, load: Floats, number: int, x: Floats, begin: float, end: float
) -> Iterator[Stretch]:
    """Cut the time in a regime, from a state (θ, θ') to the next event, where pieces of a load (P, PIECE) begin.

    before : inputs d before the load step  [N m, rad, N m/s]
    """
    first = int(np.searchsorted(load[:, BEGIN], begin, side="right")) - 1
    kinks = [*load[first + 1 :, BEGIN].tolist(), np.inf]
    for piece, kink in enumerate(kinks, first):
        if kink > begin:
            regime = regime_under(system, number, inputs_of(before, load, piece))
            stretch = Stretch(begin, min(kink, end), regime, _with_wave(system, x, load[piece], begin))
            yield stretch
            if kink < end:
                x = stretch.after
            begin = kink
        if kink >= end:
            return


def inputs_of(before: Floats, load: Floats, piece: int) -> Floats:
    """The inputs d, from those before the load step, under a piece of a load without its wave  [N m, rad, N m/s]."""
    inputs = before.copy()
    inputs[TORQUE] = load[piece, LEVEL]
    return inputs


def _with_wave(system: System, x: Floats, piece: Floats, begin: float) -> Floats:
    """The state (θ, θ', w) in a piece of a load, (PIECE,), from (θ, θ')."""
    size = 2 * system.inertias
    if system.rates.shape[1] == size:
        return x
    wave = np.array([piece[WAVE], piece[WAVE_PARTNER] + piece[SLOPE]])
    if begin > piece[BEGIN]:
        wave = _exponential((begin - piece[BEGIN]) * system.rates[0, size:, size:]) @ wave
    return np.concatenate([x[:size], wave])


def states(regime: Regime, x: Floats, offset: float, step: float, count: int) -> Floats:
    """(count, N) the states at offset, offset + step, … after the state `x`  [rad, rad/s]."""
    matrix, z = regime.matrix, np.empty((count, x.size + 1))
    z[0], filled = _exponential(offset * matrix) @ np.append(x, 1.0), 1
    power = _exponential(step * matrix) if count > 1 else matrix
    while filled < count:  # 2^k rows and the 2^k-th power of a step give the next 2^k rows
        more = min(filled, count - filled)
        z[filled : filled + more] = apply(power, z[:more])
        filled, power = filled + more, power @ power
    return z[:, :-1]


def _exponential(matrix: Floats) -> Floats:
    """exp(matrix), NaN where that is no number.

    scipy's expm takes LAPACK, whose threads wait for each other: 15 ms for nine rows on a busy machine, and a history
    needs forty of them. Of drivelines as stiff as configs/car_tip_in.toml both are right to 1e-11.
    """
    scaled, unit, size = balanced(matrix)
    if not np.isfinite(size):
        return np.full(matrix.shape, np.nan)
    return np.asarray(exponentials(scaled, np.asarray(size)) * unit[:, None] / unit)


def exponentials(matrices: Floats, sizes: Floats) -> Floats:
    """exp(matrix), by the power series of a part of it that is squared again and again: (…, Z, Z).

    Parameters
    ----------
    matrices : (…, Z, Z) float64
    sizes : (…,) float64
        A norm of each, or as much: so many halvings make it 1/2.
    """
    squarings = np.maximum(0, np.ceil(np.log2(np.maximum(2.0 * sizes, 1e-300))).astype(np.int64))[..., None, None]
    part = matrices * np.ldexp(1.0, -squarings)
    total = power = np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape)
    for k in range(1, _TERMS):
        power = power @ part / k
        total = total + power
    for k in range(squarings.max(initial=0)):
        total = np.where(squarings > k, total @ total, total)
    return total


def balanced(matrix: Floats) -> tuple[Floats, Floats, float]:
    """A matrix in units in which angles and velocities are of one size, these units, and its norm.

    The norm is about its largest |λ|; NaN or infinite where the matrix is not a number.
    """
    from scipy.linalg import matrix_balance  # a fifth of a second, which runs without histories do not take

    if not np.all(np.isfinite(matrix)):
        return matrix, np.ones(len(matrix)), np.nan
    with np.errstate(invalid="ignore"):  # it also casts the units to integers, for permutations that there are none of
        scaled, (unit, _) = matrix_balance(matrix, permute=False, separate=True)
    return scaled, unit, float(np.linalg.norm(scaled))


def apply(matrix: Floats, rows: Floats) -> Floats:
    """The matrix times each row; without BLAS, whose threads wait for each other longer than this takes (0.5 ms)."""
    return np.einsum("kj,ij->ik", matrix, rows)
