"""The modes of a chain: coordinates y of its free motion, y' = Λ y, from which the tables of its flow are made.

The chain is first brought to energy coordinates z, whose |z|² is twice its energy; its eigenvectors are found in these.
Λ is real and made of 2 x 2 blocks: [[σ, ω], [-ω, σ]] for a complex pair of eigenvalues, diagonal for two real ones, and
[[0, ω], [0, σ]] for a displacement without stiffness and its velocity, with σ = 0 without damping. As two modes, these
would be a difference of large numbers where σ is small. In a pair nothing but such a displacement ever grows, and no
derivative depends on it.

Real modes are paired in the order of their rates. The bounds of a flow take the amplitude of a pair together with the
rates of both of its members, so that a mode much faster than its partner would keep spans short for as long as the
partner lasts. Such a mode has a pair alone.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from clunk.core.arrays import Bools, FloatArray, IntArray
from clunk.core.batches import UnlikeError, alike
from clunk.core.jit import compiled, inlined_part
from clunk.core.reductions import product

TINY = 1e-300  # instead of zero, as a divisor
_CONVERGED = 1e-14  # of an eigenvalue's magnitude: the largest step by which Newton's method may end
_NEAR = 1e-7  # of their magnitude: eigenvalues this near, found from two guesses, may be the same one
_MOST_STEPS = 10  # of Newton's method, to an eigenvalue
_MAX_CONDITION = 4e4  # of unit eigenvectors in energy coordinates, by Frobenius norms: beyond it, four digits are lost
_APART = 1e-2  # the least singular value of unit vectors that may make a basis
_ROUNDING = 1e-12  # relative size below which a number may be rounding
# A part that turns freely with less than this share of the drag on all that rolls counts as undamped, however light or
# heavy it is. As a damped part, its speed would be measured from the speed that it reaches at last, a number so large
# that no digits are left of the difference. As an undamped part that rolls, it loses the share of the torque that its
# drag takes. At this limit either costs about as much, of a part that weighs little beside what rolls.
_SMALL = 1e-9
# The limit where nothing is dragged as it rolls: a free part whose rate of decay is less than this share of the softest
# mode's rate (of 1 rad/s without any) counts as undamped.
_TOO_SLOW = 1e-10
_FASTER = 16.0  # times as fast as all that it could be paired with: a decay that has a pair alone


class Chain(NamedTuple):
    """A chain M θ'' + C θ' + K θ = … in m angles without constraint, and how the n of the driveline follow from these.

    Or the chains of D drivelines: all arrays then have an axis of D in front; `inertia` always has it.

    inertia : (D, m) float64, the diagonal of M
    damping, stiffness : (m, m) float64
    expand, pick : (2n, 2m), (2m, 2n) float64, of the driveline (θ, θ') = expand (θ, θ') + shift (s φ/2), and back
    shift : (2n, L + M) float64, for the s φ/2 of each lash and the twist of each friction that sticks
    rigid : (m, k) float64, motions that twist no spring, no two of the same angle, as far as they are known beforehand:
        all of them, or none if the driveline is held with its lashes closed, and has no stages and nothing that sticks;
        a part that an open lash sets free is then found by the size of its terms, see `_are_free`
    """

    inertia: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    expand: FloatArray
    pick: FloatArray
    shift: FloatArray
    rigid: FloatArray


class Scaled(NamedTuple):
    """A chain in energy coordinates: the undamped modes' displacements times their ω, and their velocities.

    The displacement of a mode without stiffness is scaled by the ω of the softest mode that has stiffness.
    """

    into: FloatArray  # (D, 2m, 2m)  (θ, θ') -> z
    back: FloatArray
    generator: FloatArray  # z' = generator z


class Modes(NamedTuple):
    """Real eigenbases of a chain, their inverses, and the generators in them, (D, 2m, 2m).

    slots : (2m,) int64, ascending, the place of each coordinate: 2p and 2p + 1 make a pair. Where one of these is
        empty, the other is a decay much faster than all that it could be paired with
    """

    basis: FloatArray
    inverse: FloatArray
    block: FloatArray
    slots: IntArray


def scale(chain: Chain) -> Scaled:
    """The chain in energy coordinates; raises UnlikeError where the chains of a batch differ in their free motions."""
    count, m = chain.inertia.shape
    root = np.sqrt(chain.inertia)[..., None]
    squared, rotated = _undamped_modes(chain.stiffness / (root * root.mT), root * chain.rigid)
    shapes = rotated / root
    free = _are_free(shapes, chain.stiffness)
    if free.sum() > 1:  # separate the free shapes that are not damped either
        damped = shapes[..., free].mT @ chain.damping @ shapes[..., free]
        shapes[..., free] = shapes[..., free] @ np.linalg.eigh(damped)[1]
    across = shapes.mT
    stiffness, damping = across @ chain.stiffness @ shapes, across @ chain.damping @ shapes
    stiffness[:, free], stiffness[..., free] = 0.0, 0.0
    softest = squared[:, ~free].min(axis=-1, initial=np.inf, keepdims=True)
    softest[np.isinf(softest)] = 1.0
    drag = np.sum(chain.rigid * product(chain.damping, chain.rigid), axis=(-2, -1))[:, None]
    largest = abs(shapes).max(axis=-2, initial=0.0)
    slowest = np.where(drag > 0.0, _SMALL * drag * largest**2, _TOO_SLOW * softest**0.5)
    is_slow = alike(free & (np.linalg.diagonal(damping) <= slowest))
    undamped = free & (is_slow | _are_free(shapes, chain.damping))
    damping[:, undamped], damping[..., undamped] = 0.0, 0.0
    squared = np.where(free, softest, squared)

    frequency, each = np.sqrt(squared), np.arange(m)
    generator, into, back = np.zeros((3, count, 2 * m, 2 * m))
    generator[:, each, m + each] = frequency
    generator[:, m:, :m] = -stiffness / frequency[:, None]
    generator[:, m:, m:] = -damping
    into[:, m:, m:], back[:, m:, m:] = across * chain.inertia[:, None], shapes
    into[:, :m, :m], back[:, :m, :m] = frequency[..., None] * into[:, m:, m:], shapes / frequency[:, None]
    return Scaled(into, back, generator)


def _are_free(shapes: FloatArray, matrix: FloatArray) -> Bools:
    """Mask of shapes that twist no spring, or no damper, of a matrix: the quadratic form of such a shape is rounding.

    Either its terms cancel, however light the lightest part is; or the shape has no terms but those of its rounding,
    which are tiny beside the terms of other shapes.
    """
    terms = np.sum(abs(shapes) * (abs(matrix) @ abs(shapes)), axis=-2)
    bound = np.maximum(terms, _ROUNDING * terms.max(axis=-1, initial=0.0, keepdims=True))
    return alike(np.sum(shapes * (matrix @ shapes), axis=-2) <= _ROUNDING * bound)


def _undamped_modes(stiffness: FloatArray, rigid: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues, increasing, and eigenvectors of symmetric matrices with known null vectors.

    rigid : (D, m, 0 or more) float64, these null vectors, orthogonal to each other
    """
    motions = rigid.shape[-1]
    if not motions:
        return np.linalg.eigh(stiffness)
    others = np.linalg.qr(rigid, mode="complete")[0][..., motions:]
    squared, rotated = np.linalg.eigh(others.mT @ stiffness @ others)
    known = rigid / np.linalg.norm(rigid, axis=-2, keepdims=True)
    zeros = np.zeros((len(rigid), motions))
    return np.concatenate([zeros, squared], axis=-1), np.concatenate([known, others @ rotated], axis=-1)


def drifts(generator: FloatArray) -> Bools:
    """Mask of a generator's coordinates on which nothing depends, or only such coordinates do.

    These are displacements without stiffness, and velocities without damping of such displacements.
    """
    sinks = alike(~generator.any(axis=-2))
    return alike(~generator[:, ~sinks].any(axis=-2))


def modes_of(scaled: Scaled) -> Modes | None:
    """The modes of a chain; None where they are badly conditioned. Raises UnlikeError where chains differ in structure.

    In this order: oscillating modes, the fastest first; undamped drifts; damped drifts, each with the slow decay that
    moves it; the other decays, the fastest first; and the displacements of damped drifts that no slow decay moves far.
    """
    generator = scaled.generator
    drift = drifts(generator)
    count, size, _ = generator.shape
    stays, moved = np.flatnonzero(~drift), np.flatnonzero(drift)
    half = size // 2
    frequency = np.linalg.diagonal(generator[:, :half, half:])
    damping, stiffness = -generator[:, half:, half:], -generator[:, half:, :half] * frequency[:, None]
    modes, eigenvalues = _first_guesses(stiffness, damping, np.flatnonzero(~drift[half:]))
    shapes = np.empty((count, half, modes.size), complex)
    _ring(stiffness, damping, modes, eigenvalues, shapes, np.empty((half, half), complex))
    vectors = np.concatenate([frequency[..., None] * shapes, eigenvalues[:, None] * shapes], axis=1)
    failed = np.flatnonzero(np.isnan(eigenvalues).any(axis=-1))  # chains that are left to LAPACK
    if failed.size:
        newton, newton_vectors, more = eigenvalues[failed], vectors[failed], (0, stays.size - modes.size)
        eigenvalues = np.pad(eigenvalues, ((0, 0), more), constant_values=-1j)  # filled up with what comes last
        vectors = np.pad(vectors, ((0, 0), (0, 0), more), constant_values=1.0)
        kept = generator[failed].take(stays, axis=-1)
        lapack, right = (array.astype(complex) for array in np.linalg.eig(kept.take(stays, axis=-2)))
        # beside a rate 1e16 times as fast, a slow one is rounded to zero
        lapack = np.where(lapack == 0.0, -np.finfo(float).eps * abs(lapack).max(axis=-1, keepdims=True), lapack)
        of_all = np.zeros((failed.size, size, stays.size), complex)
        of_all[:, stays], of_all[:, moved] = right, kept.take(moved, axis=-2) @ right / lapack[:, None]
        for n in np.flatnonzero(drift[modes]):  # a rate of rolling is tiny, and LAPACK's rounding that of the largest
            known = np.flatnonzero(np.isfinite(newton[:, n]))
            same = abs(lapack[known] - newton[known, n, None]).argmin(axis=-1)
            lapack[known, same], of_all[known, :, same] = newton[known, n], newton_vectors[known, :, n]
        eigenvalues[failed], vectors[failed] = lapack, of_all
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    omega = eigenvalues.imag
    order = np.lexsort((-abs(eigenvalues), omega == 0.0, omega < 0.0))  # the conjugates are last
    eigenvalues = np.take_along_axis(eigenvalues, order, axis=-1)
    vectors = np.take_along_axis(vectors, order[:, None], axis=-1)
    sigma, omega = np.minimum(eigenvalues.real, 0.0), eigenvalues.imag  # a chain is passive: growth is rounding
    rings, decays = alike(np.stack([omega > 0.0, omega == 0.0], axis=-2).sum(axis=-1)).tolist()
    ringing, decaying = vectors[..., :rings], vectors[..., rings : rings + decays].real
    turning, rates = omega[:, :rings], sigma[:, rings : rings + decays]

    basis, block = np.zeros((2, count, size, size))
    at, end = 2 * np.arange(rings), 2 * rings
    basis[..., at], basis[..., at + 1] = ringing.real, ringing.imag
    block[:, at, at] = block[:, at + 1, at + 1] = sigma[:, :rings]
    block[:, at, at + 1], block[:, at + 1, at] = turning, -turning
    for k in np.flatnonzero(drift[half:]):
        basis[:, k, end], basis[:, k + half, end + 1] = generator[:, k, k + half], 1.0
        block[:, end, end + 1] = 1.0
        end += 2
    damped = np.flatnonzero(drift[:half] & ~drift[half:])
    moved = _moved_far(damped, decaying)
    slow, fast = moved.size, decays - moved.size
    far = np.zeros((count, size, slow))  # the displacement still to go as a drift's velocity decays
    far[:, moved] = decaying[:, moved, fast:]
    near = decaying[..., fast:] - far
    lengths, speeds = np.linalg.norm(far, axis=-2), np.linalg.norm(near, axis=-2)
    at = end + 2 * np.arange(slow)
    basis[..., at], basis[..., at + 1] = far / lengths[:, None], near / speeds[:, None]
    block[:, at, at + 1], block[:, at + 1, at + 1] = rates[:, fast:] * lengths / speeds, rates[:, fast:]
    at = end + 2 * slow + np.arange(fast)
    basis[..., at], block[:, at, at] = decaying[..., :fast], rates[:, :fast]
    slots = np.arange(size)
    # rates: of each decay's partner, which is the next decay, or behind the last a displacement that none moves far
    partners = [*rates[:, 1:fast].T, *np.zeros((damped.size - slow, count))]
    for k, quick, partner in zip(at, rates[:, :fast].T, partners, strict=False):
        # oscillating modes keep spans short as well: each counts by ω times its lifetime over the partner's
        lasting = -partner, *(turning.T * (partner / np.minimum(sigma[:, :rings].T, partner - TINY)))
        slots[k + 1 :] += slots[k] % 2 == 0 and alike(-quick > _FASTER * np.stack(lasting).max(axis=0), 0)
    alone = np.setdiff1d(damped, moved)
    basis[:, alone, size - alone.size + np.arange(alone.size)] = 1.0
    try:
        inverse = np.linalg.inv(basis)
    except np.linalg.LinAlgError:
        if count > 1:
            raise UnlikeError(np.array_split(np.arange(count), 2)) from None
        return None
    sizes = np.linalg.norm(basis, axis=-2)  # of columns: to scale by these loses no digits
    parts = basis / sizes[:, None], inverse * sizes[..., None]
    condition = math.prod(map(np.linalg.matrix_norm, parts))
    if not alike(condition <= _MAX_CONDITION, 0):
        return None
    return Modes(basis, inverse @ (2.0 * np.eye(size) - basis @ inverse), block, slots)


def _moved_far(damped: IntArray, decaying: FloatArray) -> IntArray:
    """The damped drifts that the slowest decaying modes move far, one for each of these modes.

    This is the largest set that these modes move independently of each other; it may be empty.
    """
    for slow in range(min(damped.size, decaying.shape[-1]), 0, -1):
        columns = decaying[:, damped, -slow:]
        lengths = np.linalg.norm(columns, axis=-2, keepdims=True)
        units = columns / np.where(lengths > 0.0, lengths, 1.0)
        most = alike(np.sort(np.argsort(-np.linalg.norm(units, axis=-1), axis=-1, kind="stable")[:, :slow]))
        apart = np.linalg.svdvals(units[:, most])[:, -1] > _APART
        if alike(apart & (lengths.min(axis=(-2, -1)) > 1.0 / _FASTER), 0):
            return damped[most]
    return damped[:0]


def _first_guesses(stiffness: FloatArray, damping: FloatArray, modes: IntArray) -> tuple[IntArray, Any]:
    """The mode of each eigenvalue, (k,), and the eigenvalues that there would be if no damper coupled modes, (D, k).

    A mode with stiffness that is overdamped in any driveline comes twice, with both of its eigenvalues; where it
    oscillates, these are conjugates.
    """
    half, squared = (np.linalg.diagonal(array).take(modes, 1) for array in (0.5 * damping, stiffness))
    over = half * half - squared
    swing = np.sqrt(over.astype(complex))
    guesses, twice = np.where(squared > 0.0, swing - half, -2.0 * half), ((over > 0.0) & (squared > 0.0)).any(axis=0)
    return np.append(modes, modes[twice]), np.concatenate([guesses, (-swing - half)[:, twice]], axis=-1)


@compiled
def _ring(stiffness: FloatArray, damping: FloatArray, modes: IntArray, rates: Any, shapes: Any, scratch: Any) -> None:
    """Eigenpairs of chains in energy coordinates, by Newton's method from those without dampers between the modes.

    They solve P(λ) x = (λ² + λ D + K) x = 0 with x = 1 in the displacement of the eigenvalue's mode. All equations but
    this mode's give x; the mode's equation, s(λ) = 0, has the derivative xᵀ P'(λ) x. P is symmetric: only its diagonal
    and what is right of that are read and eliminated, the mode last. An eigenvalue is NaN if it does not converge, or
    converges to one that is found already, to zero, or from a complex guess to a real number or to the conjugate.
    This happens to modes that begin to swing, or cease to, or that dampers couple closely. LAPACK takes five times as
    long.

    stiffness, damping : (D, m, m) float64
    modes : (k,) int64
        The mode that each eigenvalue is of.
    rates : (D, k) complex128
        First guesses; output, λ.
    shapes : (D, m, k) complex128
        Output, x.
    scratch : (m, m) complex128
    """
    m = len(scratch)
    for driveline in range(len(rates)):
        k_of, d_of = stiffness[driveline], damping[driveline]
        for n, mode in enumerate(modes):
            rate, x, sound = rates[driveline, n], shapes[driveline, :, n], False
            swing = rate.imag
            for _ in range(_MOST_STEPS):
                for i in range(m):  # rows and columns: the modes 0, 1, …, m - 1 without this one, and then this one
                    r = mode if i == m - 1 else i + (i >= mode)
                    for j in range(i, m):
                        c = mode if j == m - 1 else j + (j >= mode)
                        scratch[i, j] = k_of[r, c] + rate * d_of[r, c]
                    scratch[i, i] += rate * rate
                for p in range(m - 1):
                    scratch[p, p] = _over(1.0 + 0.0j, scratch[p, p])
                    for i in range(p + 1, m):
                        share = scratch[p, i] * scratch[p, p]
                        for j in range(i, m):
                            scratch[i, j] -= share * scratch[p, j]
                slope, x[mode] = 0.0j, 1.0
                for p in range(m - 2, -1, -1):
                    total = scratch[p, m - 1]
                    for j in range(p + 1, m - 1):
                        total += scratch[p, j] * x[j + (j >= mode)]
                    x[p + (p >= mode)] = -total * scratch[p, p]
                for r, c in np.ndindex(m, m):
                    slope += x[r] * (d_of[r, c] + 2.0 * rate * (r == c)) * x[c]
                step = _over(scratch[m - 1, m - 1], slope)
                rate -= step
                sound = abs(step) <= _CONVERGED * abs(rate)
                if sound:
                    break
            # 0 is the eigenvalue of a displacement without stiffness, whatever damps its velocity
            sound &= (rate.imag * swing > _ROUNDING * abs(rate * swing)) == (swing != 0.0) and rate != 0.0
            for other in rates[driveline, :n]:
                sound &= abs(rate - other) > _NEAR * abs(rate)
            rates[driveline, n] = rate if sound else np.nan


@inlined_part
def _over(one: complex, other: complex) -> complex:
    """The quotient of two complex numbers; NaN, but no error, if the divisor is zero."""
    return one * other.conjugate() * (1.0 / (other.real**2 + other.imag**2))
