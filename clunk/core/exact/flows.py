"""The exact flow of a regime, as tables: modal coordinates, and their propagators over a ladder of spans.

Within a regime x(t) = origin(t) + basis y(t), where origin is a particular solution of x' = A x + B u, constant unless
the flow can drift or the torque ramps, and y' = Λ y. If the load has a wave, it is the last pair of y. Λ is real and
made of 2 x 2 blocks: [[σ, ω], [-ω, σ]] for a complex pair of eigenvalues, diagonal for two real ones, and
[[0, ω], [0, σ]] for a displacement without stiffness and its velocity, with σ = 0 without damping. As two modes, these
would be a difference of large numbers where σ is small. In a pair nothing but such a displacement ever grows, and no
derivative depends on it. So the nth derivative of a functional is bounded by the sum of |c Λⁿ| of each pair times the
pair's amplitude at any earlier time.

The angle by which a driveline rolls, if nothing holds it, moves no functional. It is kept in units so large that it
adds nothing to an amplitude. In the states that these tables are for, this angle and its speed stand apart, in the
places of the first inertia that rolls, see `regimes.rolling_apart`. The share that the other inertias have in them is
subtracted from their angles and speeds, which so keep their digits however far and fast the driveline rolls.

Real modes are paired in the order of their rates. The bounds take the amplitude of a pair together with the rates of
both of its members, so that a mode much faster than its partner would keep spans short for as long as the partner
lasts. Such a mode has a pair alone.

Coordinates are stored four pairs at a time, the first members before the second ones: [a0 a1 a2 a3 b0 b1 b2 b3].

A flow without a well-conditioned eigenbasis (at critical damping, for example) keeps coordinates in which |y|² is twice
the energy, which never grows either. It can take the shortest span only, by its Taylor series. So does a flow with a
mode in resonance with the wave, or with a drift under a wave that is slower than the run. In these |y| grows, but by no
more than a factor of _GROWTH over that span.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.core.arrays import FloatArray, IntArray
from clunk.core.batches import UnlikeError, alike
from clunk.core.jit import compiled, inlined_part
from clunk.core.lanes.pool import aligned, whole
from clunk.core.lanes.vectors import ROW
from clunk.core.reductions import product
from clunk.core.regimes import System
from clunk.core.tables import TORQUE, TORQUE_RATE

SPANS = 32  # of the ladder, two an octave
MORE_SPANS = 128  # of the ladder of drivelines with a rate so fast that 32 spans end long before a run does
_FAST = 1e6  # a rate times the end time: beyond it there are MORE_SPANS
PAIRS = ROW // 2  # pairs of coordinates stored together; the number of pairs is filled up to a multiple of it
TERMS = 12  # of a Taylor series over the shortest span
_OF_SERIES = 14  # terms of the series of an exponential over one and a half of the shortest span
LONG = 2 * ROW  # room for the TERMS of a Taylor series, in whole ROWs
# Where in a block of `Flows.watch` factors begin. Coordinates times factors are a functional less its origin, its slope
# and its curvature; amplitudes times factors bound, from now on, its third derivative, its value less its origin (the
# sway) and its sixth derivative.
VALUE, SLOPE, CURVATURE = range(0, 3 * ROW, ROW)
WATCHED = 3 * ROW + 3 * PAIRS
THIRD, SWAY, SIXTH = range(3 * ROW, WATCHED, PAIRS)
_BOUNDED = (3, 0, 6)  # the orders of the derivatives that THIRD, SWAY and SIXTH bound, all less than TERMS
SELF, CROSS = range(2)  # the factors in a 2 x 2 block of a coordinate itself, and of its partner
_SHORTEST = 1.0 / 4.0  # |λ| times the shortest span, at most: TERMS terms are then exact to rounding
_CONVERGED = 1e-14  # of an eigenvalue's magnitude: the largest step by which Newton's method may end
_NEAR = 1e-7  # of their magnitude: eigenvalues this near, found from two guesses, may be the same one
_MOST_STEPS = 10  # of Newton's method, to an eigenvalue
_MAX_CONDITION = 4e4  # of unit eigenvectors in energy coordinates, by Frobenius norms: beyond it, four digits are lost
_TINY = 1e-300  # instead of zero, as a divisor
_APART = 1e-2  # the least singular value of unit vectors that may make a basis
_ROUNDING = 1e-12  # relative size below which a number may be rounding
# A part that turns freely with less than this share of the drag on all that rolls counts as undamped, however light or
# heavy it is. As a damped part, its speed would be measured from the speed that it reaches at last, a number so large
# that no digits are left of the difference. As an undamped part that rolls, it loses the share of the torque that its
# drag takes.
_SMALL = 1e-8
# The limit where nothing is dragged as it rolls: a free part whose rate of decay is less than this share of the softest
# mode's rate (of 1 rad/s without any) counts as undamped.
_TOO_SLOW = 1e-10
_RESONANCE = 1e-4  # of the wave's rate: an eigenvalue nearer to the wave's is in resonance with it
_SLOW = 1.0  # a wave's rate times the end time: a slower wave counts as in resonance with drifts, see `_with_wave`
_GROWTH = math.exp(_SHORTEST / 2.0)  # of |y| over the shortest span, at most, without modes
_FASTER = 16.0  # times as fast as all that it could be paired with: a decay that has a pair alone
_FILLED = 3  # the first field of `Flows` that `_fill` fills; `build_flows` makes the earlier ones of these
_FAR = 2.0**40  # unit of a displacement that nothing depends on


class Flows(NamedTuple):
    """Tables of the flows of D drivelines; each has an axis of D in front of the shape given here.

    K flows, N states, I inputs, F functionals, C coordinates, a multiple of 8, B = C/8, SPANS or MORE_SPANS.
    """

    # the SELF and CROSS factors of each coordinate over each span; in the last row those in `generator`, if modal
    propagator: FloatArray  # (K, SPANS + 1, B, 2, 8)
    watch: FloatArray  # (K, F, B, WATCHED)  coordinates -> VALUE to CURVATURE, amplitudes -> THIRD to SIXTH
    series: FloatArray  # (K, F, C, LONG)  y -> a functional's Taylor coefficients over the shortest span
    # the particular solution and its first three derivatives at t = 0, per input; rolling apart, as in `basis`
    origin: FloatArray  # (K, 4, I, C)
    origin_output: FloatArray  # (K, 4, F, I)  the functionals of `origin`, feedthrough included
    coordinates: FloatArray  # (K, N, C)  x - origin -> y
    basis: FloatArray  # (K, C, C)  y -> x - origin, filled up with zeros; the rolling of x stands apart
    span: FloatArray  # (K, SPANS)  [s]
    generator: FloatArray  # (K, C, C)  Λ times the shortest span
    modal: IntArray  # (K,)  whether the coordinates are modes
    steady: IntArray  # (K,)  whether the functionals of `origin` are constant under a constant torque


class Chain(NamedTuple):
    """A chain M θ'' + C θ' + K θ = … in m angles without constraint, and how the n of the driveline follow from these.

    Or the chains of D drivelines: all arrays then have an axis of D in front; `inertia` always has it.

    inertia : (D, m) float64, the diagonal of M
    damping, stiffness : (m, m) float64
    expand, pick : (2n, 2m), (2m, 2n) float64, of the driveline (θ, θ') = expand (θ, θ') + shift (s φ/2), and back
    shift : (2n, L + M) float64, for the s φ/2 of each lash and the twist of each friction that sticks
    rigid : (m, k) float64, all motions that twist no spring, no two of the same angle; k = 0 if the driveline is held
    """

    inertia: FloatArray
    damping: FloatArray
    stiffness: FloatArray
    expand: FloatArray
    pick: FloatArray
    shift: FloatArray
    rigid: FloatArray


def build_flows(system: System, chains: list[Chain], held: list[int]) -> Flows:
    """Tables of each flow of a driveline, or of a batch.

    The tables of a driveline have the same bits in any batch. A batch has one `modal` and one `steady` for each flow:
    raises UnlikeError where drivelines differ in more than numbers.

    system : of a batch, if only of one driveline; without the states of a ramp
    chains : of each flow
    held : the inputs that are the columns of `Chain.shift`
    """
    (*many, count, driven), states = system.feedthrough.shape, system.rates.shape[-1]
    # before anything else: drivelines that differ in more than numbers differ in the structure of their groups
    kinds = [(chain.rigid.shape, _held_motions(chain)) for chain in chains]
    groups = [
        group for kind in set(kinds) for group in _groups(chains, np.flatnonzero([each == kind for each in kinds]))
    ]
    wave = states - chains[0].shift.shape[-2]
    fastest = [np.linalg.matrix_norm(each.scaled.generator).reshape(many[0], -1).max(axis=1) for each in groups]
    fastest += [abs(system.rates[:, 0, -wave:, -wave:]).max(axis=(-2, -1))] * (wave > 0)
    is_fast = alike(np.max(fastest, axis=0) * system.end_time[:, 0] > _FAST, 0)
    spans = MORE_SPANS if is_fast else SPANS
    size = whole(max([states, *(wave + _ends(each.modes.slots) for each in groups if each.modes is not None)]))
    blocks = size // ROW
    shapes = (
        (spans + 1, blocks, 2, ROW),
        (count, blocks, WATCHED),
        (count, size, LONG),
        (4, driven, size),
        (4, count, driven),
        (states, size),
        (size, size),
        (spans,),
        (size, size),
    )
    # All tables are in one piece, for which there are larger pages: a sweep of drivelines takes 3 % less time.
    ends = np.cumsum([math.prod((*many, *shape)) for shape in shapes])
    pieces = np.split(aligned(ends[-1], 1).ravel(), ends[:-1])
    floats = [piece.reshape(*many, *shape) for piece, shape in zip(pieces, shapes, strict=True)]
    tables = Flows._make([*floats, *np.zeros((2, *many), np.int64)])
    while groups:
        group = groups.pop()
        try:
            _fill(tables, system, group, held)
        except UnlikeError:
            if group.flows.size == 1:
                raise
            groups += [each for k in group.flows for each in _groups(chains, np.array([k]))]
    _propagate(tables.generator, tables.propagator)
    _expand(tables.generator, tables.modal, tables.span, tables.series, tables.watch)
    if system.first_rolling >= 0:
        tables.origin[:, :, 0, :, system.first_rolling] = 0.0  # the angle rolled by is 0 as a phase begins
    return tables


class _Scaled(NamedTuple):
    """A chain in energy coordinates: the undamped modes' displacements times their ω, and their velocities.

    The displacement of a mode without stiffness is scaled by the ω of the softest mode that has stiffness.
    """

    into: FloatArray  # (D, 2m, 2m)  (θ, θ') -> z
    back: FloatArray
    generator: FloatArray  # z' = generator z
    # (2m,)  displacements that nothing depends on, and velocities that only such displacements depend on
    drift: npt.NDArray[np.bool_]


class _Modes(NamedTuple):
    """Real eigenbases of a chain, their inverses, and the generators in them, (D, 2m, 2m).

    slots : (2m,) int64, ascending, the place of each coordinate: 2p and 2p + 1 make a pair. Where one of these is
        empty, the other is a decay much faster than all that it could be paired with
    """

    basis: FloatArray
    inverse: FloatArray
    block: FloatArray
    slots: IntArray


class _Group(NamedTuple):
    """G flows of the same structure in each of D drivelines, whose tables are made together.

    The chain, and what is made of it, has an axis of D G in front, in which the flows of a driveline are neighbours.
    """

    flows: IntArray  # (G,)
    chain: Chain
    scaled: _Scaled
    modes: _Modes | None


def _groups(chains: list[Chain], flows: IntArray) -> Iterator[_Group]:
    """Groups of the same structure among flows whose chains have arrays of the same shapes.

    Raises UnlikeError where the drivelines of a single flow differ in structure.
    """
    inertias, *others = zip(*(chains[k] for k in flows), strict=True)
    inertia, *matrices = (_in_rows(each, len(inertias[0])) for each in ([each[:, None] for each in inertias], *others))
    chain = Chain(inertia[:, 0], *matrices)
    try:
        scaled = _scale(chain)
        group = _Group(flows, chain, scaled, _modes(scaled))
    except UnlikeError as unlike:
        if flows.size == 1:
            raise
        first = np.unique(unlike.parts[0] % flows.size)
        first = first if first.size < flows.size else first[::2]  # all: drivelines differ, in some flow or in all
        yield from _groups(chains, flows[first])
        yield from _groups(chains, np.delete(flows, first))
    else:
        yield group


def _held_motions(chain: Chain) -> int:
    """Estimate of how many motions springs hold in a flow of the first driveline.

    Flows with the same number are likely of the same structure.
    """
    stiffness = chain.stiffness
    return int(np.linalg.matrix_rank(stiffness[(0,) * (stiffness.ndim - 2)], hermitian=True))


def _in_rows(matrices: Sequence[FloatArray], drivelines: int) -> FloatArray:
    """Stack the matrices of G flows, (m, n) of all drivelines or (D, m, n), as `_Group` has them: (D G, m, n)."""
    stacked = np.ascontiguousarray(np.stack(matrices, axis=-3))
    count, *shape = stacked.shape[-3:]
    return np.broadcast_to(stacked, (drivelines, count, *shape)).reshape(drivelines * count, *shape)


def _ends(slots: IntArray) -> int:
    """The number of slots up to the last of these, in whole pairs."""
    return (slots.max(initial=-1) | 1) + 1


def _fill(every: Flows, system: System, group: _Group, held: list[int]) -> None:
    """Fill the tables of the flows of a group, and the first terms of their series.

    Coordinates that the tables have and the group has not stay zero.
    """
    flows, chain, scaled, modes = group
    filled = every[_FILLED:]
    made = [np.zeros((len(chain.inertia), *table.shape[2:]), table.dtype) for table in filled]
    tables = Flows._make([*every[:_FILLED], *made])
    rates, inputs, functionals, feedthrough = (  # A, B, C and D
        array[:, flows].reshape(-1, *array.shape[2:]) for array in system[:4]
    )
    unforced = chain.shift.shape[-2]  # number of states without those of a wave
    times, seen = product if chain.rigid.size else np.matmul, functionals[..., :unforced]
    into, back = times(scaled.into, chain.pick), times(chain.expand, scaled.back)
    forcing = inputs[:, :unforced].copy()
    forcing[..., held] += rates[:, :unforced, :unforced] @ chain.shift
    origin = back[:, None] @ _particular(scaled, into @ forcing)
    origin[:, 0][..., held] += chain.shift
    tables.origin[..., :unforced] = origin.mT
    tables.origin_output[:] = times(seen[:, None], origin)
    tables.origin_output[:, 0] += feedthrough
    tables.origin_output[:, 1, :, TORQUE_RATE] += feedthrough[..., TORQUE]
    tables.steady[:] = alike(~times(seen, back[..., scaled.drift]).any(axis=(-2, -1)), 0)

    modal, block, slots = modes is not None, scaled.generator, np.arange(into.shape[1])
    if modes is not None:
        into, back, block, slots = modes.inverse @ into, back @ modes.basis, modes.block, modes.slots
    unseen = alike(~block.any(axis=-2) & ~times(seen, back).any(axis=-2))
    into[:, unseen], block[:, unseen] = into[:, unseen] / _FAR, block[:, unseen] / _FAR
    back[..., unseen] *= _FAR
    if rates.shape[-1] > unforced:
        drive = into @ np.ascontiguousarray(rates[:, :unforced, unforced])[..., None]
        wave_rates = rates[:, unforced:, unforced:]
        slow = np.repeat(_SLOW / system.end_time[:, 0], flows.size) * (1 - tables.steady)
        into, back, block, modal = _with_wave(into, back, block, drive[..., 0], wave_rates, slow, modal)
        slots = np.append(slots, _ends(slots) + np.arange(2))
        tables.steady[:] *= modal
    tables.modal[:] = modal
    fastest = np.linalg.norm(block, axis=-1)
    fastest = fastest.max(axis=-1, initial=0.0) if modal else np.linalg.norm(fastest, axis=-1)
    fastest[fastest == 0.0] = _SHORTEST
    shortest = np.ldexp(1.0, np.frexp(_SHORTEST / fastest)[1] - 1)
    octaves = np.arange(tables.span.shape[1] // 2)
    tables.span[:] = shortest[:, None] * np.ldexp([[1.0, 1.5]], octaves[:, None]).ravel()

    states, size = tables.coordinates.shape[-2:]
    place = halves(np.arange(size)).swapaxes(1, 2).reshape(-1)[slots]  # of the coordinates in the tables
    tables.coordinates[..., place] = into.mT
    tables.basis[:, place, :states] = back.mT
    tables.generator[:, place[:, None], place] = shortest[:, None, None] * block
    for table, of_group in zip(filled, made, strict=True):
        table[:, flows] = of_group.reshape(-1, flows.size, *table.shape[2:])
    firsts = times(functionals, back)
    every.series[:, flows[:, None, None], np.arange(firsts.shape[1])[:, None], place, 0] = firsts.reshape(
        len(every.series), flows.size, *firsts.shape[1:]
    )


def halves(rows: Any) -> Any:
    """Reshape (…, C) to (…, B, 2, 4): blocks of the first members of four pairs, and then the second members."""
    return rows.reshape(*rows.shape[:-1], -1, 2, PAIRS)


def _scale(chain: Chain) -> _Scaled:
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
    slowest = np.where(drag > 0.0, _SMALL * drag * abs(shapes).max(axis=-2, initial=0.0) ** 2, _TOO_SLOW * softest**0.5)
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
    return _Scaled(into, back, generator, np.concatenate((free, undamped)))


def _are_free(shapes: FloatArray, matrix: FloatArray) -> npt.NDArray[np.bool_]:
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


def _particular(scaled: _Scaled, forcing: FloatArray) -> FloatArray:
    """Coefficients p0 to p3 of a solution p0 + p1 t + p2 t²/2 + p3 t³/6 of z' = generator z + forcing, for each input.

    The column of the torque's rate of change is the solution for the torque's forcing times t. Returns
    (D, 4, 2m, inputs).
    """
    generator, drift = scaled.generator, scaled.drift
    particular, stays = np.zeros((4, *forcing.shape)), np.flatnonzero(~drift)
    p0, p1, p2, p3 = particular
    within = generator.take(stays, axis=-2).take(stays, axis=-1)
    p0[:, stays] = -np.linalg.solve(within, forcing[:, stays])
    p1[:, stays, TORQUE_RATE] = p0[:, stays, TORQUE]
    p0[:, stays, TORQUE_RATE] = np.linalg.solve(within, p1[:, stays, TORQUE_RATE, None])[..., 0]
    along, pushed = generator.take(np.flatnonzero(drift), axis=-2), forcing[:, drift]
    p1[:, drift] = along @ p0 + pushed
    p2[:, drift] = along @ p1
    p2[:, drift, TORQUE_RATE] += pushed[..., TORQUE]
    p3[:, drift, TORQUE_RATE] = (along @ p2[..., TORQUE_RATE, None])[..., 0]
    return particular.swapaxes(0, 1)


def _with_wave(
    into: FloatArray,
    back: FloatArray,
    block: FloatArray,
    drive: FloatArray,
    wave: FloatArray,
    slow: FloatArray,
    modal: bool,
) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
    """Coordinates, basis and generator with the wave as one pair more: y' = block y + drive w1, w' = wave w.

    As a mode, the wave includes the steady response to it, the real part of v (w1 + i w2) with (rate - block) v =
    drive. Where the flow has no modes, or one of them is in resonance with the wave, w itself is the pair, scaled so
    that its drive is no larger than the norm of `block`. So it is where the wave's rate is below `slow`, (D,)  [1/s]:
    as a mode, the wave would include a response of a drift as large as the drive over the square of that rate, nearly
    all of which the drift's own coordinates would cancel.

    Returns the three, and whether the coordinates are modes.
    """
    count, size = drive.shape
    rate = wave[:, :1, 0] - 1j * wave[:, :1, 1]  # the eigenvalue of w1 + i w2
    swings = np.sqrt(np.maximum(-block * block.mT, 0.0)).sum(axis=-1)
    away = abs(np.linalg.diagonal(block) - 1j * swings - rate).min(axis=-1, initial=np.inf)
    modal = modal and not alike((away <= _RESONANCE * abs(rate[:, 0])) | (abs(rate[:, 0]) < slow), 0)
    (along, pushed), scale = np.zeros((2, count, size, 2)), np.ones((count, 1, 1))
    pushed[..., 0] = drive
    if modal:
        shares = np.linalg.solve(rate[..., None] * np.eye(size) - block, drive[..., None])[..., 0]
        along[..., 0], along[..., 1] = shares.real, -shares.imag
        pushed[:] = 0.0
    else:
        length, fastest = np.linalg.norm(drive, axis=-1), np.linalg.matrix_norm(block)
        scale[:, 0, 0] = np.where(length > 0.0, length / np.maximum(fastest, _TINY), 1.0)
    unit, none = np.eye(2), np.zeros((count, 2, size))
    back = np.block([[back, back @ along], [none, unit / scale]])
    into = np.block([[into, -along], [none @ into, scale * unit]])
    return into, back, np.block([[block, pushed / scale], [none, wave]]), modal


def _modes(scaled: _Scaled) -> _Modes | None:
    """The modes of a chain; None where they are badly conditioned.

    In this order: oscillating modes, the fastest first; undamped drifts; damped drifts, each with the slow decay that
    moves it; the other decays, the fastest first; and the displacements of damped drifts that no slow decay moves far.
    """
    generator, drift = scaled.generator, scaled.drift
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
        # oscillating modes keep spans short as well, for their share of the time that the partner lasts
        lasting = -partner, *(turning.T * (partner / np.minimum(sigma[:, :rings].T, partner - _TINY)))
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
    return _Modes(basis, inverse @ (2.0 * np.eye(size) - basis @ inverse), block, slots)


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


@compiled
def _propagate(generator: FloatArray, table: FloatArray) -> None:
    """Write exp(generator · span) over the spans of the ladder, and behind them the generator itself.

    E = exp(generator · span) - 1 is a series over the shortest span, and over one and a half of it; each further span
    is twice an earlier one, and has E (2 + E). So small angles keep their digits, and a sine and an exponential for
    each span would take ten times as long.

    generator : (D, K, C, C), of each pair a block [[σ1, ω], [-ω, σ2]], or [[0, ω], [0, σ2]] for a drift
    table : (D, K, SPANS + 1, B, 2, 8)
        Output.
    """
    drivelines, flows, spans, blocks, _, _ = table.shape
    for driveline, flow, block in np.ndindex(drivelines, flows, blocks):
        shares, of_block = table[driveline, flow, :, block], slice(block * ROW, (block + 1) * ROW)
        rates = generator[driveline, flow, of_block, of_block]
        for i in range(PAIRS):
            j = i + PAIRS
            turns = 1.0 * (rates[j, i] == -rates[i, j])
            for k, other in ((i, j), (j, i)):
                shares[-1, SELF, k], shares[-1, CROSS, k] = rates[k, k], rates[k, other]
            for odd in range(2):  # the spans 1, 2, 4, …, and 1.5, 3, 6, …
                scale = 1.0 + 0.5 * odd
                a, b, c, d = scale * rates[i, i], scale * rates[i, j], scale * rates[j, i], scale * rates[j, j]
                own = cross = partner = 0.0  # E of a coordinate on itself, of its partner on it, of that on itself
                for n in range(_OF_SERIES, 0, -1):
                    back = cross * c
                    cross = ((1.0 + own) * b + cross * d) / n
                    own, partner = ((1.0 + own) * a + back) / n, ((1.0 + partner) * d + back) / n
                for span in range(odd, spans - 1, 2):
                    shares[span, SELF, i], shares[span, CROSS, i] = 1.0 + own, cross
                    shares[span, SELF, j], shares[span, CROSS, j] = 1.0 + partner, -turns * cross
                    back = turns * cross * cross
                    cross *= 2.0 + own + partner
                    own, partner = own * (2.0 + own) - back, partner * (2.0 + partner) - back


@compiled
def _expand(generator: FloatArray, modal: IntArray, span: FloatArray, series: FloatArray, watch: FloatArray) -> None:
    """Complete the Taylor series of functionals over the shortest span from their first terms, and fill `Flows.watch`.

    Without modes, functionals are bounded by _GROWTH times |y|, which is at most the sum of the amplitudes.
    """
    for at in np.ndindex(series.shape[:3]):  # a driveline, a flow and a functional
        terms, seen, rates, unit = series[at], watch[at], generator[at[:2]], 1.0
        size = len(terms)
        for n in range(TERMS):
            squares = 0.0
            for c in range(size):
                total, pair = terms[c, n], c - c % ROW + c % PAIRS
                rows = range(size) if not modal[at[:2]] else range(pair, pair + PAIRS + 1, PAIRS)
                for r in rows if n > 0 else range(0):
                    total += terms[r, n - 1] * rates[r, c]
                total /= max(n, 1)
                terms[c, n], squares = total, squares + total * total
                if n * ROW < THIRD:
                    seen[c // ROW, n * ROW + c % ROW] = unit * total
            for k, order in enumerate(_BOUNDED):
                for p in range(size // 2 if n == order else 0):
                    block, c = p // PAIRS, p % PAIRS
                    bound = np.hypot(terms[block * ROW + c, n], terms[block * ROW + c + PAIRS, n])
                    if not modal[at[:2]]:
                        bound = _GROWTH * np.sqrt(squares)
                    # coordinates are rounded each time that they are multiplied, span by span
                    seen[block, THIRD + k * PAIRS + c] = (1.0 + 1e-9) * unit * bound
            unit *= (n + 1) / span[at[:2]][0]


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
