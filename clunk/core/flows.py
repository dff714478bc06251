"""The exact flow of a regime, as tables: modal coordinates, and their propagators over a ladder of spans.

Within a regime x(t) = origin(t) + basis y(t), where origin is a particular solution of x' = A x + B u, constant unless
the flow can drift, and y' = Λ y. Λ is real and made of 2 x 2 blocks: [[σ, ω], [-ω, σ]] for a complex pair of
eigenvalues, diagonal for two real ones, [[0, 1], [0, 0]] for an undamped drift. The amplitudes of the modes never grow,
so a functional's third derivative stays within the sum of |c Λ³| times the amplitudes at any earlier time.

A flow without a well-conditioned eigenbasis (critical damping, for example) keeps coordinates in which |y|² is twice
the energy; that never grows either. It can take the shortest span only, by its Taylor series.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

SPANS = 32  # two an octave
BLOCK = 4  # pairs: their number is filled up to a multiple, so that the kernels' loops have a known length
TERMS = 10  # of a Taylor series over the shortest span
JERK, SWAY = 6, 7  # in `Flows.watch`: what bounds a functional's third derivative, and its value less its origin
_SHORTEST = 1.0 / 8.0  # |λ| times the shortest span: TERMS terms are then exact to rounding
_LADDER = np.ldexp(np.tile([1.0, 1.5], SPANS // 2), np.repeat(np.arange(SPANS // 2), 2))
_TAYLOR = np.array([1.0 / math.factorial(k) for k in range(TERMS)])
_MAX_CONDITION = 1e4  # of an eigenbasis in energy coordinates: beyond it, more than four digits are lost
_ROUNDING = 1e-12  # relative to the largest of its kind


class Flows(NamedTuple):
    """The open and the closed flow: N states, F functionals, C coordinates in P = C/2 pairs, a multiple of BLOCK."""

    origin: FloatArray  # (2, 3, N, 2)  for (T, s φ/2): value, slope and curvature of the particular solution at t = 0
    origin_output: FloatArray  # (2, 3, F, 2)  the functionals of it
    coordinates: FloatArray  # (2, N, C)  x - origin -> y
    basis: FloatArray  # (2, N, C)  y -> x - origin
    modal: IntArray  # (2,)  whether the coordinates are modes
    ringing: IntArray  # (2,)  how many pairs, from the first on and fastest first, are oscillating modes
    span: FloatArray  # (2, SPANS)  [s]
    propagator: FloatArray  # (2, SPANS, P, 5)  of each pair over a span: its block's four entries, and its decay
    generator: FloatArray  # (2, C, C)  Λ times the shortest span
    watch: FloatArray  # (2, F, P, 8)  pair -> value, slope and curvature of a functional; amplitude -> JERK and SWAY
    series: FloatArray  # (2, F, TERMS, C)  y -> a functional's Taylor coefficients over the shortest span
    steady: IntArray  # (2,)  whether the origin does not move


class Chain(NamedTuple):
    """A chain M θ'' + C θ' + K θ = … in m angles without constraint, and how they lie in the n of the driveline.

    inertia : (m,) float64, the diagonal of M
    damping, stiffness : (m, m) float64
    expand, pick : (2n, 2m), (2m, 2n) float64, x = expand (θ, θ') + shift s φ/2 and back
    shift : (2n,) float64
    """

    inertia: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    expand: FloatArray
    pick: FloatArray
    shift: FloatArray


def build_flows(
    rates: FloatArray,
    inputs: FloatArray,
    functionals: FloatArray,
    feedthrough: FloatArray,
    chains: list[Chain],
) -> Flows:
    """Tables of the open and the closed flow; the arrays are those of `regimes.System`.

    Few and whole array operations: a sweep over inertias, stiffnesses or dampings builds these for each of its values.
    """
    flows, states = rates.shape[:2]
    count = functionals.shape[1]
    pairs = -(-states // (2 * BLOCK)) * BLOCK
    size = 2 * pairs
    tables = Flows(
        origin=np.zeros((flows, 3, states, 2)),
        origin_output=np.zeros((flows, 3, count, 2)),
        coordinates=np.zeros((flows, states, size)),
        basis=np.zeros((flows, states, size)),
        modal=np.zeros(flows, np.int64),
        ringing=np.zeros(flows, np.int64),
        span=np.zeros((flows, SPANS)),
        propagator=np.zeros((flows, SPANS, pairs, 5)),
        generator=np.zeros((flows, size, size)),
        watch=np.zeros((flows, count, pairs, 8)),
        series=np.zeros((flows, count, TERMS, size)),
        steady=np.zeros(flows, np.int64),
    )
    for k, chain in enumerate(chains):
        _fill(tables, k, rates[k], inputs[k], functionals[k], feedthrough[k], chain)
    return tables


class _Scaled(NamedTuple):
    """A chain in energy coordinates: the undamped modes' ω times their displacements, and their velocities.

    A mode without stiffness takes the softest other one's ω, to scale only.
    """

    into: FloatArray  # (2m, 2m)  (θ, θ') -> z
    back: FloatArray
    generator: FloatArray  # z' = generator z
    drift: BoolArray  # (2m,)  displacements that nothing depends on, and the velocities that only they depend on


def _fill(
    tables: Flows,
    k: int,
    rates: FloatArray,
    inputs: FloatArray,
    functionals: FloatArray,
    feedthrough: FloatArray,
    chain: Chain,
) -> None:
    """Flow `k`; the coordinates that a chain has fewer than the tables stay zero."""
    scaled = _scale(chain)
    into, back = scaled.into @ chain.pick, chain.expand @ scaled.back
    forcing = inputs.copy()
    forcing[:, 1] += rates @ chain.shift
    tables.origin[k] = back @ _particular(scaled, into @ forcing)
    tables.origin[k, 0, :, 1] += chain.shift
    tables.origin_output[k] = functionals @ tables.origin[k]
    tables.origin_output[k, 0] += feedthrough
    tables.steady[k] = not scaled.drift.any()

    size, count = into.shape[0], functionals.shape[0]
    modes = _modes(scaled)
    if modes is None:
        block = scaled.generator
        fastest = float(np.linalg.norm(block, 2))
    else:
        vectors, inverse, block = modes
        into, back = inverse @ into, back @ vectors
        fastest = math.sqrt((block * block).sum(axis=1).max(initial=0.0))
        tables.modal[k] = 1
        tables.ringing[k] = np.count_nonzero(block.diagonal(-1)[::2])
    tables.coordinates[k, :, :size], tables.basis[k, :, :size] = into.T, back
    shortest = 2.0 ** math.floor(math.log2(_SHORTEST / fastest)) if fastest > 0.0 else 1.0
    span = shortest * _LADDER
    tables.span[k], tables.generator[k, :size, :size] = span, shortest * block
    _propagate(block, span, tables.propagator[k, :, : size // 2])

    derivatives = np.empty((TERMS, count, size))
    derivatives[0] = functionals @ back
    for j in range(1, TERMS):
        np.matmul(derivatives[j - 1], block, out=derivatives[j])
    watch = tables.watch[k, :, : size // 2]
    for j in range(3):
        watch[:, :, 2 * j : 2 * j + 2] = derivatives[j].reshape(count, size // 2, 2)
    watch[:, :, JERK : SWAY + 1] = _reach(derivatives[[3, 0]], modes is not None).transpose(1, 2, 0)
    factor = _TAYLOR * shortest ** np.arange(TERMS)
    tables.series[k, :, :, :size] = (factor[:, None, None] * derivatives).transpose(1, 0, 2)


def _reach(rows: FloatArray, modal: bool) -> FloatArray:
    """(…, P), what bounds |row · y| from now on, by the pairs' amplitudes."""
    pairs = np.hypot(rows[..., 0::2], rows[..., 1::2])
    if not modal:  # by |y|, which is at most the sum of the amplitudes
        pairs[:] = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.asarray(pairs * (1.0 + 1e-9), np.float64)  # what is multiplied up, span by span, is rounded


def _scale(chain: Chain) -> _Scaled:
    m = chain.inertia.size
    root = np.sqrt(chain.inertia)
    squared, rotated = np.linalg.eigh(chain.stiffness / (root[:, None] * root))
    shapes = rotated / root[:, None]
    free = squared <= _ROUNDING * squared.max(initial=0.0)
    drifting = bool(free.any())
    if np.count_nonzero(free) > 1:  # among the free shapes those apart that are not damped either
        shapes[:, free] = shapes[:, free] @ np.linalg.eigh(shapes[:, free].T @ chain.damping @ shapes[:, free])[1]
    stiffness, damping = shapes.T @ chain.stiffness @ shapes, shapes.T @ chain.damping @ shapes
    undamped = free
    if drifting:
        stiffness[free], stiffness[:, free] = 0.0, 0.0
        own = damping.diagonal()
        undamped = free & (own <= _ROUNDING * own.max(initial=0.0))
        damping[undamped], damping[:, undamped] = 0.0, 0.0
        squared = np.where(free, squared[~free].min(initial=np.inf), squared)
        squared[np.isinf(squared)] = 1.0

    frequency = np.sqrt(squared)
    generator, into, back = np.zeros((3, 2 * m, 2 * m))
    generator[:m, m:].flat[:: m + 1] = frequency
    generator[m:, :m] = -stiffness / frequency
    generator[m:, m:] = -damping
    into[m:, m:], back[m:, m:] = shapes.T * chain.inertia, shapes
    into[:m, :m], back[:m, :m] = frequency[:, None] * into[m:, m:], shapes / frequency
    return _Scaled(into, back, generator, np.concatenate((free, undamped)))


def _particular(scaled: _Scaled, forcing: FloatArray) -> FloatArray:
    """p0, p1, p2 with p0 + p1 t + p2 t²/2 a solution of z' = generator z + forcing: (3, 2m, inputs)."""
    generator, drift = scaled.generator, scaled.drift
    particular = np.zeros((3, *forcing.shape))
    if not drift.any():
        particular[0] = -np.linalg.solve(generator, forcing)
        return particular
    stays, p0 = ~drift, particular[0]
    p0[stays] = -np.linalg.solve(generator[stays][:, stays], forcing[stays])
    particular[1, drift] = generator[drift] @ p0 + forcing[drift]
    particular[2, drift] = generator[drift] @ particular[1]
    return particular


def _modes(scaled: _Scaled) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """A real eigenbasis, its inverse, and the generator in it; None where it is badly conditioned.

    Oscillating modes first, fastest first; then undamped drifts, then what is overdamped, then damped drifts.
    """
    generator, drift = scaled.generator, scaled.drift
    size = generator.shape[0]
    drifting = bool(drift.any())
    if drifting:
        stays = ~drift
        eigenvalues, right = np.linalg.eig(generator[stays][:, stays])
        vectors = np.zeros((size, eigenvalues.size), right.dtype)
        vectors[stays] = right
        vectors[drift] = generator[drift][:, stays] @ right / eigenvalues
    else:
        eigenvalues, vectors = np.linalg.eig(generator)
    fastest_first = np.argsort(-np.abs(eigenvalues), kind="stable")
    eigenvalues, vectors = eigenvalues[fastest_first], vectors[:, fastest_first]
    sigma, omega = np.minimum(eigenvalues.real, 0.0), eigenvalues.imag  # a chain is passive: growth is rounding
    rings, decays = np.flatnonzero(omega > 0.0), np.flatnonzero(omega == 0.0)

    unit = _unit(size)
    basis, block = np.zeros((size, size)), np.zeros((size, size))
    end = 2 * rings.size
    basis[:, 0:end:2], basis[:, 1:end:2] = vectors[:, rings].real, vectors[:, rings].imag
    at = np.arange(0, end, 2)
    block[at, at] = block[at + 1, at + 1] = sigma[rings]
    block[at, at + 1], block[at + 1, at] = omega[rings], -omega[rings]
    displacement, velocity = np.flatnonzero(drift[: size // 2]), np.flatnonzero(drift[size // 2 :])
    for k in velocity:
        block[end, end + 1] = 1.0
        basis[:, end], basis[:, end + 1] = unit[k] * generator[k, k + size // 2], unit[k + size // 2]
        end += 2
    at = np.arange(end, end + decays.size)
    basis[:, at], block[at, at] = vectors[:, decays].real, sigma[decays]
    end += decays.size
    for k in displacement:
        if k not in velocity:
            basis[:, end] = unit[k]
            end += 1
    try:
        inverse = np.linalg.inv(basis)
    except np.linalg.LinAlgError:
        return None
    # by the Frobenius norms, at most as many times larger as there are coordinates, the condition is found sooner
    bound = math.sqrt((basis * basis).sum() * (inverse * inverse).sum())
    if not bound <= _MAX_CONDITION and size and not np.linalg.cond(basis) <= _MAX_CONDITION:
        return None
    return basis, inverse @ (2.0 * unit - basis @ inverse), block


@functools.cache
def _unit(size: int) -> FloatArray:
    return np.eye(size)


def _propagate(block: FloatArray, span: FloatArray, result: FloatArray) -> None:
    """exp(block · span) of each pair of a block-diagonal generator, and the decay of its amplitude.

    result : (spans, P, 5)
    """
    diagonal, above, below = block.diagonal(), block.diagonal(1)[::2], block.diagonal(-1)[::2]
    decay, angle = np.exp(span[:, None] * diagonal), span[:, None] * above
    first, second = decay[:, 0::2], decay[:, 1::2]
    cosine, sine = np.cos(angle), np.sin(angle)
    result[:, :, 0], result[:, :, 3] = first * cosine, second * cosine
    result[:, :, 1], result[:, :, 2] = first * sine, -second * sine
    result[:, :, 4] = np.maximum(first, second)
    drifts = above != -below
    if drifts.any():  # they do not decay
        result[:, drifts, 0], result[:, drifts, 1] = 1.0, angle[:, drifts]
        result[:, drifts, 2], result[:, drifts, 3] = 0.0, 1.0
