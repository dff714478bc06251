"""The motion within a stretch, in one regime under one piece of the load: linear, x' = A x + B u with a constant u.

A ramp of the load is a part of its wave w, and so of the state x = (θ, θ', w). A phase, from one event to the next,
consists of one or more stretches.

y = x' obeys y' = A y, so that x changes by Ψ(t) y(0), where Ψ(t) = ∫ exp(A s) ds. Every phase starts from a known
state; no event is searched for.
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from clunk.core.regimes import System
from clunk.core.runs import BEGIN, LEVEL, SLOPE, WAVE, WAVE_PARTNER
from clunk.core.tables import TORQUE
from clunk.study.arrays import Floats, Integers

_TERMS = 18  # of the power series, used up to a norm of 1/2: the first left out, of a form, is 1/19! = 8e-18
_NO_FORMS = np.zeros((0, 1, 1))
_AT_ONCE = 1 << 20  # numbers in the matrices of all times that are computed together: 8 MB


class Regime(NamedTuple):
    """A regime under constant inputs: x' = rates · x + forcing; N states, x = (θ, θ') or (θ, θ', w) with a wave."""

    flow: int  # number of the regime's flow
    rates: Floats  # (N, N)
    forcing: Floats  # (N,)
    inputs: Floats  # (I,)  u: each input d times the regime's weight
    sides: Integers  # (L,)  sign of q on the flank of each lash that touches or overlaps, 0 between the flanks
    closed: Integers  # (L,)  whether the flanks of each lash press on each other


def regime_under(system: System, number: int, inputs: Floats) -> Regime:
    """Regime `number` of a system under constant inputs d = (T, φ/2, T', …)  [N m, rad, N m/s]."""
    flow, contacts, u = system.regimes[number]["flow"], system.contacts[number], system.weights[number].copy()
    u[: inputs.size] *= inputs  # inputs left out are 1; where a friction sticks does not matter, as B is zero there
    return Regime(flow, system.rates[flow], system.inputs[flow] @ u, u, contacts["side"], contacts["closed"])


class Stretch(NamedTuple):
    """A part of a run in one regime under one piece of its load."""

    begin: float  # s after the load step
    end: float
    regime: Regime
    x: Floats  # (N,)  at the beginning  [rad, rad/s], and the load's wave
    motion: Floats  # (N,)  y = x' at the beginning
    moved: Floats  # (N,)  change of x from the beginning to the end


def stretches(
    system: System, before: Floats, load: Floats, number: int, x: Floats, begin: float, end: float
) -> Iterator[Stretch]:
    """Cut the time in a regime, from a state (θ, θ') to the next event, at the times where pieces of the load begin.

    before : inputs d before the load step  [N m, rad, N m/s]
    load : (P, PIECE), pieces of the load
    number : the regime
    x, begin, end : the state at the beginning, and the times from and to which it is followed  [s after the load step]
    """
    first = load[:, BEGIN].searchsorted(begin, side="right") - 1
    kinks = np.append(load[first + 1 :, BEGIN], np.inf)
    begins, ends = np.append(begin, kinks[:-1]), np.minimum(kinks, end)
    pieces = np.flatnonzero((kinks > begins) & ((begins < end) | (begins == begin)))
    travels = integrals(system.rates[system.regimes[number]["flow"]], (ends - begins)[pieces])
    for piece, (travel, _) in zip(pieces, travels, strict=True):
        regime = regime_under(system, number, inputs_of(before, load, first + piece))
        x = _with_wave(system, x, load[first + piece], begins[piece])
        motion = regime.rates @ x + regime.forcing
        moved = travel @ motion
        yield Stretch(begins[piece], ends[piece], regime, x, motion, moved)
        x = x + moved


def inputs_of(before: Floats, load: Floats, piece: np.intp | int) -> Floats:
    """Inputs d under a piece of a load, without its wave, from those before the load step  [N m, rad, N m/s]."""
    inputs = before.copy()
    inputs[TORQUE] = load[piece, LEVEL]
    return inputs


def _with_wave(system: System, x: Floats, piece: Floats, begin: float) -> Floats:
    """State (θ, θ', w) at a time in a piece of a load, (PIECE,), from (θ, θ'); the same state without a wave."""
    size = 2 * system.inertias
    if system.rates.shape[1] == size:
        return x
    from scipy.linalg import expm  # see `_series`

    wave = np.array([piece[WAVE], piece[WAVE_PARTNER] + piece[SLOPE]])
    if begin > piece[BEGIN]:
        wave = expm(system.rates[0, size:, size:] * (begin - piece[BEGIN])) @ wave
    return np.concatenate([x[:size], wave])


def states(regime: Regime, x: Floats, travel: Floats, count: int) -> Floats:
    """States at `count` times a step apart, (count, N), the first of them `x`  [rad, rad/s].

    travel : (N, N), Ψ of the step
    """
    z, power, filled = np.ones((count, x.size + 1)), np.eye(x.size + 1), 1  # z = (x, 1), and a power of its step
    z[0, :-1] = x
    power[:-1, :-1] += regime.rates @ travel
    power[:-1, -1] = travel @ regime.forcing
    while filled < count:  # 2^k rows and the 2^k-th power of a step give the next 2^k rows
        more = min(filled, count - filled)
        z[filled : filled + more] = apply(power, z[:more])
        filled, power = filled + more, power @ power
    return z[:, :-1]


def integrals(rates: Floats, lengths: Floats, forms: Floats = _NO_FORMS) -> Iterator[tuple[Floats, Floats]]:
    """Ψ(t) = ∫ exp(A s) ds and G(t) = ∫ exp(A s)ᵀ F exp(A s) ds from 0 to each of several times t.

    Power series give both for a short time. Doublings of it, Ψ(2t) = Ψ(t) (1 + Φ(t)) and
    G(2t) = G(t) + Φ(t)ᵀ G(t) Φ(t) with Φ = exp(A t) = 1 + A Ψ, give them for a longer one (C.F. Van Loan, Computing
    integrals involving the matrix exponential, 1978, doi:10.1109/TAC.1978.1101743). Neither has a growing exponential,
    such as exp(-A t), in it. Both are NaN where A is not finite.

    Parameters
    ----------
    rates : (N, N) float64
        A.
    lengths : (S,) float64  [s]
    forms : (m, N, N) float64, optional
        F, symmetric.

    Yields
    ------
    travel : (N, N) float64  [s]
        Ψ, for one time after the other.
    integrals : (m, N, N) float64  [s]
        G of each form.
    """
    scaled, unit, norm, terms = _series(rates.tobytes(), len(rates))
    of_forms = [forms * unit[:, None] * unit]
    for k in range(2, _TERMS + 1 if forms.size else 2):
        product = of_forms[-1] @ scaled / k
        of_forms.append(product + product.mT)
    count = max(1, _AT_ONCE // (rates.size + forms.size))
    for k in range(0, lengths.size, count):
        reach = norm * lengths[k : k + count]
        doublings = np.maximum(np.frexp(np.nan_to_num(reach))[1] + 1, 0)
        powers = np.ldexp(reach, -doublings)[:, None] ** np.arange(1, _TERMS + 1)
        travel, grown = np.tensordot(powers, terms, 1), np.tensordot(powers[:, : len(of_forms)], of_forms, 1)
        for n in range(doublings.max()):
            more = doublings > n
            half = travel[more]
            flow = np.eye(len(rates)) + scaled @ half
            travel[more] += half @ flow
            grown[more] += flow.mT[:, None] @ grown[more] @ flow[:, None]
        yield from zip(travel / norm * unit[:, None] / unit, grown / norm / unit[:, None] / unit, strict=True)


@lru_cache(maxsize=64)  # a run returns to the same few flows
def _series(rates: bytes, size: int) -> tuple[Floats, Floats, float, Floats]:
    """Scaled A of a flow, units that balance it, its norm in these units, and the terms of the power series of Ψ.

    In these units angles and velocities are of about the same size, and the norm of A, (size, size), is about its
    largest |λ|; A is scaled by dividing it by that norm. Both are NaN where A is not finite.
    """
    from scipy.linalg import matrix_balance  # here, as it takes 0.2 s, which runs without histories need not wait

    matrix, unit, norm = np.frombuffer(rates).reshape(size, size), np.ones(size), np.nan
    if np.isfinite(matrix).all():
        with np.errstate(invalid="ignore"):  # scipy also casts the units to integers, as permutations, unused here
            matrix, (unit, _) = matrix_balance(matrix, permute=False, separate=True)
        norm = float(np.linalg.norm(matrix)) or 1.0
    scaled = matrix / norm
    terms = [np.eye(size)]
    for k in range(2, _TERMS + 1):
        terms.append(terms[-1] @ scaled / k)
    return scaled, unit, norm, np.array(terms)


def apply(matrix: Floats, rows: Floats) -> Floats:
    """Matrix times each row, without BLAS: its threads wait for each other longer than the product takes (0.5 ms)."""
    return np.einsum("kj,ij->ik", matrix, rows)
