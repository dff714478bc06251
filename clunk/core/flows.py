"""The exact flow of a regime, as tables: modal coordinates, and their propagators over a ladder of spans.

Within a regime x(t) = origin(t) + basis y(t), where origin is a particular solution of x' = A x + B u, constant unless
the flow can drift, and y' = Λ y. Λ is real and made of 2 x 2 blocks: [[σ, ω], [-ω, σ]] for a complex pair of
eigenvalues, diagonal for two real ones, [[0, 1], [0, 0]] for an undamped drift. The amplitudes of the modes never grow,
so a functional's third derivative stays within the sum of |c Λ³| times the amplitudes at any earlier time.

A flow without a well-conditioned eigenbasis (critical damping, for example) keeps coordinates in which |y|² is twice
the energy; that never grows either. It can take the shortest span only, by its Taylor series.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

SPANS = 32  # two an octave
BLOCK = 4  # pairs: their number is filled up to a multiple, so that the kernels' loops have a known length
TERMS = 8  # of a Taylor series over the shortest span
JERK, SWAY = 6, 7  # in `Flows.watch`: what bounds a functional's third derivative, and its value less its origin
_SHORTEST = 1.0 / 32.0  # |λ| times the shortest span: TERMS terms are then exact to rounding
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

    mass, damping, stiffness : (m, m) float64
    expand, pick : (2n, 2m), (2m, 2n) float64, x = expand (θ, θ') + shift s φ/2 and back
    shift : (2n,) float64
    """

    mass: FloatArray
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
    """Tables of the open and the closed flow; the arrays are those of `regimes.System`."""
    pairs = -(-rates.shape[1] // (2 * BLOCK)) * BLOCK
    flows = [
        _filled_up(_flow(rates[k], inputs[k], functionals[k], feedthrough[k], chain), pairs)
        for k, chain in enumerate(chains)
    ]
    return Flows(*(np.stack(field) for field in zip(*flows, strict=True)))


def _filled_up(flow: Flows, pairs: int) -> Flows:
    """With coordinates added that stay zero."""
    more = pairs - flow.watch.shape[1]
    return flow._replace(
        coordinates=np.pad(flow.coordinates, ((0, 0), (0, 2 * more))),
        basis=np.pad(flow.basis, ((0, 0), (0, 2 * more))),
        propagator=np.pad(flow.propagator, ((0, 0), (0, more), (0, 0))),
        generator=np.pad(flow.generator, ((0, 2 * more), (0, 2 * more))),
        watch=np.pad(flow.watch, ((0, 0), (0, more), (0, 0))),
        series=np.pad(flow.series, ((0, 0), (0, 0), (0, 2 * more))),
    )


class _Scaled(NamedTuple):
    """A chain in energy coordinates: the undamped modes' ω times their displacements, and their velocities.

    A mode without stiffness takes the softest other one's ω, to scale only.
    """

    into: FloatArray  # (2m, 2m)  (θ, θ') -> z
    back: FloatArray
    generator: FloatArray  # z' = generator z
    drift: BoolArray  # (2m,)  displacements that nothing depends on, and the velocities that only they depend on


def _flow(
    rates: FloatArray, inputs: FloatArray, functionals: FloatArray, feedthrough: FloatArray, chain: Chain
) -> Flows:
    scaled = _scale(chain)
    into, back = scaled.into @ chain.pick, chain.expand @ scaled.back
    forcing = inputs.copy()
    forcing[:, 1] += rates @ chain.shift
    origin = np.stack([back @ p for p in _particular(scaled, into @ forcing)])
    origin[0, :, 1] += chain.shift
    origin_output = np.stack([functionals @ p for p in origin])
    origin_output[0] += feedthrough

    size, count = into.shape[0], functionals.shape[0]
    modes = _modes(scaled)
    if modes is None:
        vectors, inverse, block = np.eye(size), np.eye(size), scaled.generator
        fastest = float(np.linalg.norm(block, 2))
    else:
        vectors, inverse, block = modes
        fastest = float(np.linalg.norm(block, axis=1).max(initial=0.0))
    shortest = 2.0 ** np.floor(np.log2(_SHORTEST / fastest)) if fastest > 0.0 else 1.0
    span = shortest * np.ldexp(np.tile([1.0, 1.5], SPANS // 2), np.repeat(np.arange(SPANS // 2), 2))

    derivatives = np.zeros((TERMS, count, size))
    derivatives[0] = functionals @ back @ vectors
    for k in range(1, TERMS):
        derivatives[k] = derivatives[k - 1] @ block
    pairs = derivatives[:3].reshape(3, count, size // 2, 2).transpose(1, 2, 0, 3).reshape(count, size // 2, 6)
    reach = [_reach(derivatives[k], modes is not None)[..., None] for k in (3, 0)]
    watch = np.concatenate([pairs, *reach], axis=2)
    factor = np.cumprod(np.r_[1.0, shortest / np.arange(1, TERMS)])
    return Flows(
        origin=origin,
        origin_output=origin_output,
        coordinates=(inverse @ into).T,
        basis=back @ vectors,
        modal=np.array(modes is not None, np.int64),
        ringing=np.array(0 if modes is None else np.count_nonzero(np.diag(block, -1)[::2]), np.int64),
        span=span,
        propagator=_propagators(block, span),
        generator=shortest * block,
        watch=watch,
        series=(factor[:, None, None] * derivatives).transpose(1, 0, 2),
        steady=np.array(not np.any(scaled.drift), np.int64),
    )


def _reach(row: FloatArray, modal: bool) -> FloatArray:
    """(F, P), what bounds |row · y| from now on, by the pairs' amplitudes."""
    pairs = np.hypot(row[:, 0::2], row[:, 1::2])
    if not modal:  # by |y|, which is at most the sum of the amplitudes
        pairs[:] = np.linalg.norm(row, axis=1, keepdims=True)
    return np.asarray(pairs * (1.0 + 1e-9), np.float64)  # what is multiplied up, span by span, is rounded


def _scale(chain: Chain) -> _Scaled:
    m = chain.mass.shape[0]
    root = np.linalg.cholesky(chain.mass)
    squared, rotated = np.linalg.eigh(np.linalg.solve(root, np.linalg.solve(root, chain.stiffness).T))
    shapes = np.linalg.solve(root.T, rotated)
    free = squared <= _ROUNDING * squared.max(initial=0.0)
    # among the free shapes those apart that are not damped either
    damping = shapes[:, free].T @ chain.damping @ shapes[:, free]
    shapes[:, free] = shapes[:, free] @ np.linalg.eigh(damping)[1]
    stiffness, damping = shapes.T @ chain.stiffness @ shapes, shapes.T @ chain.damping @ shapes
    stiffness[free], stiffness[:, free] = 0.0, 0.0
    undamped = free & (np.diag(damping) <= _ROUNDING * np.diag(damping).max(initial=0.0))
    damping[undamped], damping[:, undamped] = 0.0, 0.0

    frequency = np.sqrt(np.where(free, squared[~free].min(initial=np.inf), squared))
    frequency[np.isinf(frequency)] = 1.0
    generator = np.zeros((2 * m, 2 * m))
    generator[:m, m:] = np.diag(frequency)
    generator[m:, :m] = -stiffness / frequency
    generator[m:, m:] = -damping
    into, back = np.zeros((2 * m, 2 * m)), np.zeros((2 * m, 2 * m))
    into[m:, m:], back[m:, m:] = shapes.T @ chain.mass, shapes
    into[:m, :m], back[:m, :m] = frequency[:, None] * into[m:, m:], shapes / frequency
    return _Scaled(into, back, generator, np.r_[free, undamped])


def _particular(scaled: _Scaled, forcing: FloatArray) -> list[FloatArray]:
    """p0, p1, p2 with p0 + p1 t + p2 t²/2 a solution of z' = generator z + forcing."""
    generator, drift = scaled.generator, scaled.drift
    p0, p1, p2 = (np.zeros_like(forcing) for _ in range(3))
    p0[~drift] = -np.linalg.solve(generator[np.ix_(~drift, ~drift)], forcing[~drift])
    p1[drift] = generator[np.ix_(drift, ~drift)] @ p0[~drift] + forcing[drift]
    p2[drift] = generator[np.ix_(drift, drift)] @ p1[drift]
    return [p0, p1, p2]


def _modes(scaled: _Scaled) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """A real eigenbasis, its inverse, and the generator in it; None where it is badly conditioned."""
    generator, drift = scaled.generator, scaled.drift
    size = generator.shape[0]
    eigenvalues, right = np.linalg.eig(generator[np.ix_(~drift, ~drift)])
    eigenvalues = eigenvalues.astype(np.complex128)
    vectors = np.zeros((size, eigenvalues.size), np.complex128)
    vectors[~drift] = right
    vectors[drift] = generator[np.ix_(drift, ~drift)] @ right / eigenvalues

    displacement, velocity = np.flatnonzero(drift[: size // 2]), np.flatnonzero(drift[size // 2 :])
    columns: list[FloatArray] = []
    block = np.zeros((size, size))
    fastest_first = np.argsort(-np.abs(eigenvalues), kind="stable")
    eigenvalues, vectors = eigenvalues[fastest_first], vectors[:, fastest_first]
    for value, vector in zip(eigenvalues, vectors.T, strict=True):
        if value.imag > 0.0:
            at = len(columns)
            sigma = min(value.real, 0.0)  # a chain is passive: growth is rounding
            block[at : at + 2, at : at + 2] = [[sigma, value.imag], [-value.imag, sigma]]
            columns += [vector.real, vector.imag]
    unit = np.eye(size)
    for k in velocity:
        at = len(columns)
        block[at, at + 1] = 1.0
        columns += [unit[k] * generator[k, k + size // 2], unit[k + size // 2]]
    for value, vector in zip(eigenvalues, vectors.T, strict=True):
        if value.imag == 0.0:
            block[len(columns), len(columns)] = min(value.real, 0.0)
            columns.append(vector.real)
    columns += [unit[k] for k in displacement if k not in velocity]
    basis = np.stack(columns, axis=1) if columns else np.zeros((0, 0))
    if size and not np.linalg.cond(basis) <= _MAX_CONDITION:
        return None
    inverse = np.linalg.inv(basis)
    return basis, inverse @ (2.0 * unit - basis @ inverse), block


def _propagators(block: FloatArray, span: FloatArray) -> FloatArray:
    """(spans, P, 5), exp(block · span) of each pair of a block-diagonal generator, and the decay of its amplitude."""
    pairs = block.shape[0] // 2
    result = np.zeros((span.size, pairs, 5))
    for p in range(pairs):
        part = block[2 * p : 2 * p + 2, 2 * p : 2 * p + 2]
        decay = np.exp(np.outer(span, np.diag(part)))
        angle = part[0, 1] * span
        if part[0, 1] == -part[1, 0]:
            result[:, p, 0], result[:, p, 3] = decay[:, 0] * np.cos(angle), decay[:, 1] * np.cos(angle)
            result[:, p, 1], result[:, p, 2] = decay[:, 0] * np.sin(angle), -decay[:, 1] * np.sin(angle)
        else:  # a drift
            result[:, p, 0], result[:, p, 1], result[:, p, 3] = 1.0, angle, 1.0
        result[:, p, 4] = decay.max(axis=1)
    return result
