"""The exact flow of a regime, as tables: modal coordinates, and their propagators over a ladder of spans.

Within a regime x(t) = origin(t) + basis y(t), where origin is a particular solution of x' = A x + B u, constant unless
the flow can drift or the torque ramps, and y' = Λ y. The wave of a load that has one is the last pair of y. Λ is real
and made of 2 x 2 blocks: [[σ, ω], [-ω, σ]] for a complex pair of eigenvalues, diagonal for two real ones, and
[[0, ω], [0, σ]] for a displacement without stiffness and its velocity, σ = 0 without damping either: their difference,
were they modes, would be one of large numbers where σ is small. Of a pair nothing but such a displacement ever grows,
and on that no derivative depends. So a functional's nth derivative stays within the sum of |c Λⁿ| times the amplitudes
at any earlier time.

The angle that a driveline rolls by, if nothing holds it, moves no functional. It is kept in units so large that it adds
nothing to an amplitude.

Four pairs of coordinates lie together: first the one member of each, then the other.

A flow without a well-conditioned eigenbasis (critical damping, for example) keeps coordinates in which |y|² is twice
the energy; that never grows either. It can take the shortest span only, by its Taylor series. So does a flow with a
mode in resonance with the wave, of which |y| grows, but by no more than _GROWTH over that span.
"""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.lanes.vectors import ROW
from clunk.core.tables import TORQUE, TORQUE_RATE

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

SPANS = 32  # two an octave
BLOCK = ROW // 2  # pairs: their number is filled up to a multiple
TERMS = 12  # of a Taylor series over the shortest span
LONG = 2 * ROW  # room for its terms
# columns of `Flows.watch`: a functional less its origin, its slope and curvature; what bounds from now on its third
# derivative, its value less its origin, its slope and its sixth derivative
VALUE, SLOPE, CURVATURE, JERK, SWAY, SLOPE_BOUND, SIXTH = range(7)
_BOUNDED = (3, 0, 1, 6)  # the orders that JERK and what follows it bound
SELF, CROSS, DECAY = range(3)  # of a 2 x 2 block: what multiplies a coordinate itself, and its partner
_SHORTEST = 1.0 / 4.0  # |λ| times the shortest span: TERMS terms are then exact to rounding
_LADDER = np.ldexp(np.tile([1.0, 1.5], SPANS // 2), np.repeat(np.arange(SPANS // 2), 2))
_TAYLOR = np.array([1.0 / math.factorial(k) for k in range(TERMS)])
_MAX_CONDITION = 1e4  # of an eigenbasis in energy coordinates: beyond it, more than four digits are lost
_APART = 1e-2  # of unit vectors that may make a basis
_ROUNDING = 1e-12  # relative to the largest of its kind
_RESONANCE = 1e-4  # of the wave's rate: an eigenvalue nearer than that is in resonance with it
_GROWTH = math.exp(_SHORTEST / 2.0)
_FAR = 2.0**40  # units of a displacement that nothing depends on


class Flows(NamedTuple):
    """The flows' tables: K flows, N states, I inputs, F functionals, C coordinates, a multiple of 8, B = C/8."""

    origin: FloatArray  # (K, 4, I, C)  the particular solution and its first three derivatives at t = 0, per input
    origin_output: FloatArray  # (K, 4, F, I)  the functionals of it
    coordinates: FloatArray  # (K, N, C)  x - origin -> y
    basis: FloatArray  # (K, C, C)  y -> x - origin, filled up
    modal: IntArray  # (K,)  whether the coordinates are modes
    ringing: IntArray  # (K,)  how many pairs, from the first on and fastest first, are oscillating modes
    span: FloatArray  # (K, SPANS)  [s]
    propagator: FloatArray  # (K, SPANS, B, 3, 8)  over a span: each coordinate's SELF and CROSS share, and its DECAY
    power: FloatArray  # (K, TERMS, B, 2, 8)  SELF and CROSS of (Λ times the shortest span)^k / k!, for modes
    generator: FloatArray  # (K, C, C)  Λ times the shortest span
    watch: FloatArray  # (K, F, 2C, 8)  coordinates, then amplitudes -> VALUE to CURVATURE; JERK to SIXTH
    series: FloatArray  # (K, F, C, LONG)  y -> a functional's Taylor coefficients over the shortest span
    steady: IntArray  # (K,)  whether the functionals of the origin do not move under a constant torque
    rolls: IntArray  # (K,)  whether the origin does, all the same


class Chain(NamedTuple):
    """A chain M θ'' + C θ' + K θ = … in m angles without constraint, and how they lie in the n of the driveline.

    inertia : (m,) float64, the diagonal of M
    damping, stiffness : (m, m) float64
    expand, pick : (2n, 2m), (2m, 2n) float64, of the driveline (θ, θ') = expand (θ, θ') + shift (s φ/2), and back
    shift : (2n, L + M) float64, for the s φ/2 of each lash and the twist of each friction that sticks
    rigid : (m, k) float64, of a driveline that rolls all motions that twist no spring, each of other angles; else none
    """

    inertia: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    expand: FloatArray
    pick: FloatArray
    shift: FloatArray
    rigid: FloatArray


def build_flows(
    rates: FloatArray,
    inputs: FloatArray,
    functionals: FloatArray,
    feedthrough: FloatArray,
    chains: list[Chain],
    held: list[int],
) -> Flows:
    """Tables of the open and the closed flow; the arrays are those of `regimes.System`.

    Few and whole array operations: a sweep over inertias, stiffnesses or dampings builds these for each of its values.
    """
    flows, states = rates.shape[:2]
    count, driven = functionals.shape[1], inputs.shape[2]
    blocks = -(-states // ROW)
    size = blocks * ROW
    tables = Flows(
        origin=np.zeros((flows, 4, driven, size)),
        origin_output=np.zeros((flows, 4, count, driven)),
        coordinates=np.zeros((flows, states, size)),
        basis=np.zeros((flows, size, size)),
        modal=np.zeros(flows, np.int64),
        ringing=np.zeros(flows, np.int64),
        span=np.zeros((flows, SPANS)),
        propagator=np.zeros((flows, SPANS, blocks, 3, ROW)),
        power=np.zeros((flows, TERMS, blocks, 2, ROW)),
        generator=np.zeros((flows, size, size)),
        watch=np.zeros((flows, count, 2 * size, ROW)),
        series=np.zeros((flows, count, size, LONG)),
        steady=np.zeros(flows, np.int64),
        rolls=np.zeros(flows, np.int64),
    )
    for k, chain in enumerate(chains):
        _fill(tables, k, rates[k], inputs[k], functionals[k], feedthrough[k], chain, held)
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
    held: list[int],
) -> None:
    """Flow `k`; the coordinates that a chain has fewer than the tables stay zero."""
    scaled, still = _scale(chain), len(chain.shift)
    into, back = scaled.into @ chain.pick, chain.expand @ scaled.back
    forcing = inputs[:still].copy()
    forcing[:, held] += rates[:still, :still] @ chain.shift
    origin = back @ _particular(scaled, into @ forcing)
    origin[0][:, held] += chain.shift
    tables.origin[k, :, :, :still] = origin.transpose(0, 2, 1)
    tables.origin_output[k] = _outputs(functionals[:, :still], origin, chain)
    tables.origin_output[k, 0] += feedthrough
    tables.origin_output[k, 1, :, TORQUE_RATE] += feedthrough[:, TORQUE]
    tables.steady[k] = not _outputs(functionals[:, :still], back[:, scaled.drift], chain).any()
    tables.rolls[k] = tables.steady[k] and scaled.drift.any()

    modes = _modes(scaled)
    if modes is None:
        block = scaled.generator
    else:
        vectors, inverse, block = modes
        into, back = inverse @ into, back @ vectors
        tables.ringing[k] = np.count_nonzero(block.diagonal(-1)[::2])
    modal, growth = modes is not None, 1.0
    unseen = ~block.any(axis=0) & ~_outputs(functionals[:, :still], back, chain).any(axis=0)
    into[unseen], back[:, unseen], block[unseen] = into[unseen] / _FAR, back[:, unseen] * _FAR, block[unseen] / _FAR
    if rates.shape[0] > still:
        wave = rates[still:, still:]
        into, back, block, resonates = _with_wave(into, back, block, into @ rates[:still, still], wave, modal)
        if resonates or not modal:
            modal, growth = False, _GROWTH
            tables.steady[k] = tables.ringing[k] = 0
    tables.modal[k] = modal
    fastest = math.sqrt((block * block).sum(axis=1).max(initial=0.0)) if modal else float(np.linalg.norm(block, 2))
    shortest = 2.0 ** math.floor(math.log2(_SHORTEST / fastest)) if fastest > 0.0 else 1.0
    tables.span[k] = shortest * _LADDER

    states, size = tables.coordinates.shape[1:]
    place = _places(size)[: into.shape[0]]
    generator, basis = tables.generator[k], tables.basis[k]
    tables.coordinates[k][:, place], basis[place, :states] = into.T, back.T
    generator[place[:, None], place] = shortest * block
    if modal:
        pairs = _pairs(generator)
        _propagate(pairs, _halves(np.isin(np.arange(size), place[: unseen.size][unseen])), tables.propagator[k])
        _expand(pairs, tables.power[k])

    derivatives = np.empty((TERMS, functionals.shape[0], size))  # by the time over the shortest span
    derivatives[0] = _outputs(functionals, basis[:, :states].T, chain)
    for j in range(1, TERMS):
        np.matmul(derivatives[j - 1], generator, out=derivatives[j])
    tables.series[k][:, :, :TERMS] = (_TAYLOR[:, None, None] * derivatives).transpose(1, 2, 0)
    slow = derivatives / (shortest ** np.arange(TERMS))[:, None, None]
    watch = tables.watch[k].reshape(functionals.shape[0], 2, -1, 2, BLOCK, ROW)
    watch[:, 0, ..., VALUE : CURVATURE + 1] = _halves(slow[: CURVATURE + 1]).transpose(1, 2, 3, 4, 0)
    watch[:, 1, :, 0, :, JERK : SIXTH + 1] = (growth * _reach(slow[list(_BOUNDED)], modal)).transpose(1, 2, 3, 0)


def _outputs(functionals: FloatArray, columns: FloatArray, chain: Chain) -> FloatArray:
    """The functionals of some states; of a driveline that rolls, zero to the last bit where only rounding is left."""
    outputs: FloatArray = functionals @ columns
    if chain.rigid.size:
        outputs[np.abs(outputs) <= _ROUNDING * (np.abs(functionals) @ np.abs(columns))] = 0.0
    return outputs


@functools.cache
def _places(size: int) -> IntArray:
    """Where the coordinates 0, 1, 2, … lie, of which 2p and 2p + 1 are a pair."""
    return np.ascontiguousarray(_halves(np.arange(size)).transpose(0, 2, 1)).ravel()


def _halves(rows: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """(…, C) as (…, B, 2, 4): the one members of four pairs, and the other."""
    return rows.reshape(*rows.shape[:-1], -1, 2, BLOCK)


def _reach(rows: FloatArray, modal: bool) -> FloatArray:
    """(…, B, 4), what bounds |row · y| from now on, by the pairs' amplitudes."""
    halves = _halves(rows)
    pairs = np.hypot(halves[..., 0, :], halves[..., 1, :])
    if not modal:  # by |y|, which is at most the sum of the amplitudes
        pairs[:] = np.linalg.norm(rows, axis=-1)[..., None, None]
    return np.asarray(pairs * (1.0 + 1e-9), np.float64)  # what is multiplied up, span by span, is rounded


def _scale(chain: Chain) -> _Scaled:
    m = chain.inertia.size
    root = np.sqrt(chain.inertia)
    squared, rotated = _undamped_modes(chain.stiffness / (root[:, None] * root), root[:, None] * chain.rigid)
    shapes = rotated / root[:, None]
    free = squared <= _ROUNDING * squared.max(initial=0.0)
    drifting = bool(free.any())
    if np.count_nonzero(free) > 1:  # among the free shapes those apart that are not damped either
        shapes[:, free] = shapes[:, free] @ np.linalg.eigh(shapes[:, free].T @ chain.damping @ shapes[:, free])[1]
    stiffness, damping = shapes.T @ chain.stiffness @ shapes, shapes.T @ chain.damping @ shapes
    undamped = free
    if drifting:
        stiffness[free], stiffness[:, free] = 0.0, 0.0
        friction = damping.diagonal()
        undamped = free & (friction <= _ROUNDING * friction.max(initial=0.0))
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


def _undamped_modes(stiffness: FloatArray, rigid: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues, increasing, and eigenvectors of a symmetric matrix, of which some at zero are known to rounding."""
    motions = rigid.shape[1]
    if not motions:
        return np.linalg.eigh(stiffness)
    others = np.linalg.qr(rigid, mode="complete")[0][:, motions:]
    squared, rotated = np.linalg.eigh(others.T @ stiffness @ others)
    known = rigid / np.linalg.norm(rigid, axis=0)
    return np.concatenate([np.zeros(motions), squared]), np.hstack([known, others @ rotated])


def _particular(scaled: _Scaled, forcing: FloatArray) -> FloatArray:
    """p0 to p3 with p0 + p1 t + p2 t²/2 + p3 t³/6 a solution of z' = generator z + forcing: (4, 2m, inputs).

    That to the torque's rate of change is one to the torque's forcing times t.
    """
    generator, drift = scaled.generator, scaled.drift
    particular, stays = np.zeros((4, *forcing.shape)), ~drift
    p0, p1, p2, p3 = particular
    if not drift.any():
        p0[:] = -np.linalg.solve(generator, forcing)
        p1[:, TORQUE_RATE] = p0[:, TORQUE]
        p0[:, TORQUE_RATE] = np.linalg.solve(generator, p1[:, TORQUE_RATE])
        return particular
    p0[stays] = -np.linalg.solve(generator[stays][:, stays], forcing[stays])
    p1[stays, TORQUE_RATE] = p0[stays, TORQUE]
    p0[stays, TORQUE_RATE] = np.linalg.solve(generator[stays][:, stays], p1[stays, TORQUE_RATE])
    p1[drift] = generator[drift] @ p0 + forcing[drift]
    p2[drift] = generator[drift] @ p1
    p2[drift, TORQUE_RATE] += forcing[drift, TORQUE]
    p3[drift, TORQUE_RATE] = generator[drift] @ p2[:, TORQUE_RATE]
    return particular


def _with_wave(
    into: FloatArray, back: FloatArray, block: FloatArray, drive: FloatArray, wave: FloatArray, modal: bool
) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
    """Coordinates, basis and generator with the wave as one pair more: y' = block y + drive w1, w' = wave w.

    As a mode it moves what is steady under it along, by X w with block X + drive (1, 0) = X wave. Where the flow has no
    modes, or one of them is in resonance with the wave, w is added as it is, scaled to drive no more than the fastest.

    Returns the three, and whether there is such a resonance.
    """
    size, states = block.shape[0], into.shape[1]
    rate = complex(wave[0, 0], wave[0, 1])
    resonates = modal and bool(np.abs(np.linalg.eigvals(block) - rate).min(initial=np.inf) <= _RESONANCE * abs(rate))
    both, generator = np.zeros((size, 2)), np.zeros((size + 2, size + 2))
    generator[:size, :size], generator[size:, size:] = block, wave
    scale = 1.0
    if modal and not resonates:  # X is linear in (1, 0) and (0, 1): a system of twice the size
        both[:, 0] = -drive
        system = np.kron(block, np.eye(2)) - np.kron(np.eye(size), wave.T)
        both[:] = np.linalg.solve(system, both.ravel()).reshape(size, 2)
    else:
        fastest = float(np.linalg.norm(block, 2))
        scale = float(np.linalg.norm(drive)) / fastest if fastest > 0.0 and np.any(drive) else 1.0
        generator[:size, size] = drive / scale
    wider_into, wider_back = np.zeros((size + 2, states + 2)), np.zeros((states + 2, size + 2))
    wider_into[:size, :states], wider_into[:size, states:] = into, -both
    wider_back[:states, :size], wider_back[:states, size:] = back, back @ both
    wider_into[size:, states:], wider_back[states:, size:] = scale * np.eye(2), np.eye(2) / scale
    return wider_into, wider_back, generator, resonates


def _modes(scaled: _Scaled) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """A real eigenbasis, its inverse, and the generator in it; None where it is badly conditioned.

    Oscillating modes first, fastest first; then drifts, undamped and damped, then what is overdamped.
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
    for k in np.flatnonzero(drift[size // 2 :]):
        block[end, end + 1] = 1.0
        basis[:, end], basis[:, end + 1] = unit[k] * generator[k, k + size // 2], unit[k + size // 2]
        end += 2
    damped = np.flatnonzero(drift[: size // 2] & ~drift[size // 2 :])
    slowest = _velocities_of(damped, vectors, decays)
    if slowest.size:
        far = np.zeros((size, slowest.size))  # the displacement that is left to go while such a velocity decays
        far[damped] = vectors[damped][:, slowest].real
        near = vectors[:, slowest].real - far
        lengths, speeds = np.linalg.norm(far, axis=0), np.linalg.norm(near, axis=0)
        at = np.arange(end, end + 2 * slowest.size, 2)
        basis[:, at], basis[:, at + 1] = far / lengths, near / speeds
        block[at, at + 1], block[at + 1, at + 1] = sigma[slowest] * lengths / speeds, sigma[slowest]
        end += 2 * slowest.size
        decays, damped = decays[: -slowest.size], damped[:0]
    at = np.arange(end, end + decays.size)
    basis[:, at], block[at, at] = vectors[:, decays].real, sigma[decays]
    basis[damped, np.arange(end + decays.size, size)] = 1.0
    try:
        inverse = np.linalg.inv(basis)
    except np.linalg.LinAlgError:
        return None
    # by the Frobenius norms, at most as many times larger as there are coordinates, the condition is known sooner
    bound = math.sqrt((basis * basis).sum() * (inverse * inverse).sum())
    if not bound <= _MAX_CONDITION and size and not np.linalg.cond(basis) <= _MAX_CONDITION:
        return None
    return basis, inverse @ (2.0 * unit - basis @ inverse), block


def _velocities_of(damped: IntArray, vectors: npt.NDArray[Any], decays: IntArray) -> IntArray:
    """The slowest decaying modes, as many as there are damped drifts, if it is these that they move, and no fewer."""
    if not 0 < damped.size <= decays.size:
        return decays[:0]
    slowest = decays[-damped.size :]
    moved = np.linalg.svd(_normalised(vectors[damped][:, slowest].real), compute_uv=False)
    return slowest if moved[-1] > _APART else slowest[:0]


def _normalised(columns: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(columns, axis=0)
    return np.asarray(columns / np.where(lengths > 0.0, lengths, 1.0))


@functools.cache
def _unit(size: int) -> FloatArray:
    return np.eye(size)


class _Pairs(NamedTuple):
    """A block-diagonal generator: of each pair its block [[σ1, ω], [-ω, σ2]], or [[0, ω], [0, σ2]] for a drift."""

    sigma: FloatArray  # (B, 2, 4)
    omega: FloatArray  # (B, 4)
    drift: BoolArray  # (B, 4)


def _pairs(generator: FloatArray) -> _Pairs:
    one, other = _halves(np.arange(generator.shape[0])).transpose(1, 0, 2)
    omega = generator[one, other]
    return _Pairs(_halves(generator.diagonal()), omega, omega != -generator[other, one])


def _propagate(pairs: _Pairs, unseen: BoolArray, result: FloatArray) -> None:
    """exp(generator · span) over the spans of the ladder, and the decay of the amplitudes.

    unseen : (B, 2, 4), coordinates that no functional sees, and amplitudes need not bound
    result : (SPANS, B, 3, 8)
    """
    decay, angle = np.exp(_LADDER[:, None, None, None] * pairs.sigma), _LADDER[:, None, None] * pairs.omega
    halves, drifting = result.reshape(*result.shape[:-1], 2, BLOCK), pairs.drift.any()
    turning = np.where(pairs.drift, 0.0, angle) if drifting else angle
    halves[:, :, SELF] = decay * np.cos(turning)[:, :, None]
    sine = np.sin(turning)
    halves[:, :, CROSS, 0], halves[:, :, CROSS, 1] = decay[:, :, 0] * sine, -decay[:, :, 1] * sine
    halves[:, :, DECAY] = np.where(unseen, 0.0, decay).max(axis=2)[:, :, None]
    if drifting:
        speed = _LADDER[:, None, None] * pairs.sigma[:, 1]
        with np.errstate(invalid="ignore"):
            share = np.where(speed != 0.0, np.expm1(speed) / speed, 1.0)
        halves[:, :, CROSS, 0] += np.where(pairs.drift, angle * share, 0.0)


def _expand(pairs: _Pairs, result: FloatArray) -> None:
    """generator^k / k! for k from 0 on.

    result : (TERMS, B, 2, 8)
    """
    power = np.empty((TERMS, *pairs.sigma.shape), np.complex128)
    power[0], power.real[1:], power.imag[1:] = 1.0, pairs.sigma, np.where(pairs.drift, 0.0, pairs.omega)[:, None]
    np.multiply.accumulate(power, axis=0, out=power)
    power *= _TAYLOR[:, None, None, None]
    halves = result.reshape(*result.shape[:-1], 2, BLOCK)
    halves[:, :, SELF] = power.real
    halves[:, :, CROSS, 0], halves[:, :, CROSS, 1] = power.imag[:, :, 0], -power.imag[:, :, 1]
    if pairs.drift.any():
        # ω σ^(k-1) / k!
        going = halves[:-1, :, SELF, 1] * pairs.omega / np.arange(1, TERMS)[:, None, None]
        halves[1:, :, CROSS, 0] += np.where(pairs.drift, going, 0.0)
