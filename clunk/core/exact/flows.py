"""The exact flow of a regime, as tables: modal coordinates, and their propagators over a ladder of spans.

Within a regime x(t) = origin(t) + basis y(t), where origin is a particular solution of x' = A x + B u, constant unless
the flow can drift or the torque ramps, and y' = Λ y, with Λ of 2 x 2 blocks, see `exact.modes`. If the load has a
wave, it is the last pair of y. In a pair nothing ever grows but a displacement on which no derivative depends. So the
nth derivative of a functional is bounded by the sum of |c Λⁿ| of each pair times the pair's amplitude at any earlier
time.

The angle by which a driveline rolls, if nothing holds it, moves no functional. It is kept in units so large that it
adds nothing to an amplitude. In the states that these tables are for, this angle and its speed stand apart, in the
places of the first inertia that rolls, see `regimes.rolling_apart`. The share that the other inertias have in them is
subtracted from their angles and speeds, which so keep their digits however far and fast the driveline rolls.

Coordinates are stored four pairs at a time, the first members before the second ones: [a0 a1 a2 a3 b0 b1 b2 b3].

A flow without a well-conditioned eigenbasis (at critical damping, for example) keeps coordinates in which |y|² is twice
the energy, which never grows either. It can take the shortest span only, by its Taylor series. So does a flow with a
mode in resonance with the wave, or with a drift under a wave much slower than its modes. In these |y| grows, but by no
more than a factor of _GROWTH over that span.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from clunk.core.arrays import Bools, FloatArray, IntArray
from clunk.core.batches import UnlikeError, alike
from clunk.core.exact.modes import TINY, Chain, Modes, Scaled, drifts, modes_of, scale
from clunk.core.jit import compiled
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
_RESONANCE = 1e-4  # of the wave's rate: an eigenvalue nearer to the wave's is in resonance with it
_SLOW = 1e-2  # of the softest mode's rate: a slower wave counts as in resonance with drifts, see `_with_wave`
_SLOW_IN_RAMPS = 1e-3  # a rate times the end time: a slower decay has no steady motion in ramps, see `_particular`
_GROWTH = math.exp(_SHORTEST / 2.0)  # of |y| over the shortest span, at most, without modes
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
    # the particular solution and its first three derivatives at t = 0, per input, rolling apart, as in `basis`; and the
    # solution's coordinates at t = 0, used under ramps
    origin: FloatArray  # (K, 5, I, C)
    origin_output: FloatArray  # (K, 4, F, I)  the functionals of `origin`, feedthrough included
    coordinates: FloatArray  # (K, N, C)  x - origin -> y
    basis: FloatArray  # (K, C, C)  y -> x - origin, filled up with zeros; the rolling of x stands apart
    span: FloatArray  # (K, SPANS)  [s]
    generator: FloatArray  # (K, C, C)  Λ times the shortest span
    modal: IntArray  # (K,)  whether the coordinates are modes
    steady: IntArray  # (K,)  whether the functionals of `origin` are constant under a constant torque


def build_flows(system: System, chains: list[Chain], held: list[int]) -> Flows:
    """Tables of each flow of a driveline, or of a batch.

    The tables of a driveline have the same bits in any batch. A batch has one `modal` and one `steady` for each flow:
    raises UnlikeError where drivelines differ in more than numbers.

    system : of a batch, which may be of one driveline; without the states of a ramp
    chains : of each flow
    held : the inputs that are the columns of `Chain.shift`
    """
    (*many, count, driven), states = system.feedthrough.shape, system.rates.shape[-1]
    # before anything else: drivelines that differ in more than numbers differ in the structure of their groups
    kinds = [(chain.rigid.shape, np.count_nonzero(chain.stiffness)) for chain in chains]  # likely of one structure
    groups = [
        group for kind in set(kinds) for group in _groups(chains, np.flatnonzero([each == kind for each in kinds]))
    ]
    wave = states - chains[0].shift.shape[-2]
    fastest = [np.linalg.matrix_norm(each.scaled.generator).reshape(many[0], -1).max(axis=1) for each in groups]
    fastest += [abs(system.rates[:, 0, -wave:, -wave:]).max(axis=(-2, -1))] * (wave > 0)
    is_fast = alike(np.max(fastest, axis=0) * system.end_time[:, 0] > _FAST, 0)
    spans = MORE_SPANS if is_fast else SPANS
    ends = [each.modes.slots.max(initial=-1) | 1 for each in groups if each.modes]  # of pairs
    size = whole(max([states, *(wave + 1 + end for end in ends)]))
    blocks = size // ROW
    shapes = (
        (spans + 1, blocks, 2, ROW),
        (count, blocks, WATCHED),
        (count, size, LONG),
        (5, driven, size),
        (4, count, driven),
        (states, size),
        (size, size),
        (spans,),
        (size, size),
    )
    floats = [aligned(math.prod((*many, *shape)), 1).reshape(*many, *shape) for shape in shapes]
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
    if (first := system.first_rolling) >= 0:  # the angle rolled by is 0 as a stretch begins
        rolled = tables.origin[:, :, 0, :, first, None]
        tables.origin[:, :, 4] -= rolled * tables.coordinates[:, :, None, first]
        rolled[:] = 0.0
    return tables


class _Group(NamedTuple):
    """G flows of the same structure in each of D drivelines, whose tables are made together.

    The chain, and what is made of it, has an axis of D G in front, in which the flows of a driveline are neighbours.
    """

    flows: IntArray  # (G,)
    chain: Chain
    scaled: Scaled
    modes: Modes | None


def _groups(chains: list[Chain], flows: IntArray) -> Iterator[_Group]:
    """Groups of the same structure among flows whose chains have arrays of the same shapes.

    Raises UnlikeError where the drivelines of a single flow differ in structure.
    """
    inertias, *others = zip(*(chains[k] for k in flows), strict=True)
    inertia, *matrices = (_in_rows(each, len(inertias[0])) for each in ([each[:, None] for each in inertias], *others))
    chain = Chain(inertia[:, 0], *matrices)
    try:
        scaled = scale(chain)
        group = _Group(flows, chain, scaled, modes_of(scaled))
    except UnlikeError as unlike:
        if flows.size == 1:
            raise
        first = np.unique(unlike.parts[0] % flows.size)
        first = first if first.size < flows.size else first[::2]  # all: drivelines differ, in some flow or in all
        yield from _groups(chains, flows[first])
        yield from _groups(chains, np.delete(flows, first))
    else:
        yield group


def _in_rows(matrices: Sequence[FloatArray], drivelines: int) -> FloatArray:
    """Stack the matrices of G flows, (m, n) of all drivelines or (D, m, n), as `_Group` has them: (D G, m, n)."""
    stacked = np.ascontiguousarray(np.stack(matrices, axis=-3))
    count, *shape = stacked.shape[-3:]
    return np.broadcast_to(stacked, (drivelines, count, *shape)).reshape(drivelines * count, *shape)


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
    modal, block, slots = modes is not None, scaled.generator, np.arange(into.shape[1])
    bases = into, back, block
    if modes:
        into, back, block, slots = modes.inverse @ into, back @ modes.basis, modes.block, modes.slots
    outputs = times(seen, back)
    unseen = alike(~block.any(axis=-2) & ~outputs.any(axis=-2))
    into[:, unseen], block[:, unseen] = into[:, unseen] / _FAR, block[:, unseen] / _FAR
    back[..., unseen] *= _FAR
    # A slow mode's response to a ramp is so large that a sum with it would leave no digits of the others'. So each
    # mode's is found by itself. Without ramps, the sum has less rounding. What only rounding drives, such as parts that
    # the load does not reach, `times` leaves at rest: it would press them on each other, and a slow wave move them far.
    inward, outward, generator = (into, back, block) if system.ramps else bases
    ends = np.repeat(system.end_time, flows.size, axis=0)
    slow = alike(abs(block).sum(axis=-1) * ends < _SLOW_IN_RAMPS * system.ramps * modal)
    begin = _particular(generator, times(inward, forcing), slow)
    origin = outward[:, None] @ begin
    tables.steady[:] = alike(~outputs[..., drifts(block) | slow].any(axis=(-2, -1)), 0)
    origin[:, 0][..., held] += chain.shift
    tables.origin[:, :4, :, :unforced] = origin.mT
    tables.origin_output[:] = times(seen[:, None], origin)
    tables.origin_output[:, 0] += feedthrough
    tables.origin_output[:, 1, :, TORQUE_RATE] += feedthrough[..., TORQUE]
    begin[:, 0][..., held] += into @ chain.shift
    if rates.shape[-1] > unforced:
        drive = times(into, rates[:, :unforced, unforced, None])
        wave_rates = rates[:, unforced:, unforced:]
        softest = np.linalg.diagonal(scaled.generator, offset=into.shape[-2] // 2).min(axis=-1, initial=1e9)
        slowest = _SLOW * softest * (1 - tables.steady)
        into, back, block, modal = _with_wave(into, back, block, drive[..., 0], wave_rates, slowest, modal)
        slots = np.append(slots, (slots.max(initial=-1) | 1) + [1, 2])
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
    tables.origin[:, 4, :, place[: begin.shape[2]]] = begin[:, 0].swapaxes(0, 1)
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


def _particular(generator: FloatArray, forcing: FloatArray, slow: Bools) -> FloatArray:
    """Coefficients p0 to p3 of a solution p0 + p1 t + p2 t²/2 + p3 t³/6 of y' = generator y + forcing, for each input.

    The column of the torque's rate of change is the solution for the torque's forcing times t. Returns
    (D G, 4, 2m, inputs).

    slow : (2m,) bool, decays so slow that their solution begins at zero, as that of a drift does, in powers of t up to
        the third. Their steady motion in a ramp, the ramp over the square of the rate, would leave no digits of what
        differs from it. Of what a ramp moves, the powers leave out a quarter of the rate times t
    """
    drift = drifts(generator) | slow
    particular, stays = np.zeros((4, *forcing.shape)), np.flatnonzero(~drift)
    p0, p1, p2, p3 = particular
    within = generator.take(stays, axis=-2).take(stays, axis=-1)
    p0[:, stays] = -np.linalg.solve(within, forcing[:, stays])
    p1[:, stays, TORQUE_RATE] = p0[:, stays, TORQUE]
    p0[:, stays, TORQUE_RATE] = np.linalg.solve(within, p1[:, stays, TORQUE_RATE, None])[..., 0]
    along, pushed = generator[:, drift], forcing[:, drift]
    p1[:, drift] = along @ p0 + pushed
    p2[:, drift] = along @ p1
    p2[:, drift, TORQUE_RATE] += pushed[..., TORQUE]
    p3[:, drift] = along @ p2
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
    that its drive is no larger than the norm of `block`. So it is where the wave's rate is below `slow`, (D G,)  [1/s]:
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
        scale[:, 0, 0] = np.where(length > 0.0, length / np.maximum(fastest, TINY), 1.0)
    unit, none = np.eye(2), np.zeros((count, 2, size))
    back = np.block([[back, back @ along], [none, unit / scale]])
    into = np.block([[into, -along], [none @ into, scale * unit]])
    return into, back, np.block([[block, pushed / scale], [none, wave]]), modal


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
