"""Moving along the modes: into the coordinates of a flow, over spans and parts of the shortest, and back to states."""

import numpy as np
import numpy.typing as npt

from clunk.core.exact import rows
from clunk.core.exact.curves import A_THIRD, weighed, weighed_drift, weight
from clunk.core.exact.flows import BLOCK, CROSS, DECAY, SELF, TERMS
from clunk.core.exact.workspace import Workspace, field, is_still
from clunk.core.jit import unowned_inlined
from clunk.core.lanes import vectors
from clunk.core.lanes.vectors import ROW, WIDTH, Vector, fused
from clunk.core.regimes import inputs_of

FloatArray = npt.NDArray[np.float64]


@unowned_inlined
def to_coordinates(space: Workspace, flow: int) -> None:
    """From the states of the runs taken to their coordinates in a flow, and the amplitudes of these."""
    flows, work, away = space.flows, space.pool.work, space.moved
    size, states = flows.basis.shape[1], flows.coordinates.shape[1]
    inputs, driven, ramps = space.inputs_at, inputs_of(space.system), space.system.ramps != 0
    origins, coordinates = flows.origin[flow], flows.coordinates[flow]
    for k in range(states):
        origin = weighed(work, inputs, origins, k, size, driven, ramps)
        vectors.store(away, k, vectors.load(work, k) - origin)
    for c in range(size):
        total = vectors.splat(0.0)
        for k in range(states):
            total = fused(vectors.load(away, k), vectors.number(coordinates, k * size + c), total)
        vectors.store(work, c, total)
    measure(work, size)


@unowned_inlined
def to_states(space: Workspace, flow: int, mask: int) -> None:
    """From the coordinates in a flow to states: those of the lanes in a mask, into `space.state`."""
    flows, work, left = space.flows, space.pool.work, space.moved
    origins, basis, size = flows.origin[flow], flows.basis[flow], flows.basis.shape[1]
    elapsed = field(space, rows.ELAPSED)
    driven = inputs_of(space.system)
    inputs, order, still = space.inputs_at, driven * size, is_still(space, flow) and flows.rolls[flow] == 0
    ramps, half = space.system.ramps != 0, 0.5 * elapsed * elapsed
    sixth = half * elapsed * A_THIRD
    for n in range(flows.coordinates.shape[1]):
        origin = weighed(work, inputs, origins, n, size, driven, ramps)
        if not still:
            origin += weighed_drift(work, inputs, origins, order + n, size, driven) * elapsed
            origin += weighed_drift(work, inputs, origins, 2 * order + n, size, driven) * half
            origin += weighed_drift(work, inputs, origins, 3 * order + n, size, driven) * sixth
        away = vectors.splat(0.0)
        for j in range(size):
            away = fused(vectors.load(work, j), vectors.number(basis, j * size + n), away)
        vectors.store(left, n, origin + away)
    unused = space.state.shape[0] - 1
    for lane in range(WIDTH):
        space.offsets[lane] = (space.pool.items[lane] if (mask >> lane) & 1 else unused) * size
    for row in range(0, size, ROW):
        vectors.scatter(left, row, space.state, space.offsets, row)


@unowned_inlined
def move_by_spans(space: Workspace, flow: int, numbers: Vector) -> None:
    """Move each of the items taken by the span of the ladder with its number; a negative one counts as 0."""
    size, propagator = space.flows.basis.shape[1], space.flows.propagator[flow]
    vectors.store(space.notes, 0, numbers)
    for lane in range(WIDTH):
        space.offsets[lane] = int(max(vectors.number(space.notes, lane), 0.0)) * 3 * size
    for row in range(0, 3 * size, ROW):
        vectors.gather(propagator, space.offsets, row, space.moved, row)
    jump(space.moved, space.pool.work, size)


@unowned_inlined
def move_by_parts(space: Workspace, flow: int, part: Vector) -> None:
    """Move each of the items taken by a part of the shortest span."""
    flows, size = space.flows, space.flows.basis.shape[1]
    move(flows.power[flow], flows.generator[flow], flows.modal[flow] != 0, part, space.pool.work, size, space.moved)


@unowned_inlined
def jump(propagated: FloatArray, work: FloatArray, size: int) -> None:
    """Move by a span.

    propagated : (3C, WIDTH) float64
        The span's row of `propagator`, of each lane.
    """
    for begin in range(0, size, ROW):
        at = 3 * begin
        for k in range(BLOCK):
            p, q, pair = begin + k, begin + k + BLOCK, size + begin // 2 + k
            one, other = vectors.load(work, p), vectors.load(work, q)
            same, cross, decay = at + SELF * ROW + k, at + CROSS * ROW + k, at + DECAY * ROW + k
            moved = fused(vectors.load(propagated, same), one, vectors.load(propagated, cross) * other)
            partner = fused(
                vectors.load(propagated, same + BLOCK), other, vectors.load(propagated, cross + BLOCK) * one
            )
            vectors.store(work, p, moved)
            vectors.store(work, q, partner)
            vectors.store(work, pair, vectors.load(propagated, decay) * vectors.load(work, pair))


@unowned_inlined
def measure(work: FloatArray, size: int) -> None:
    """The amplitudes of the pairs."""
    for begin in range(0, size, ROW):
        for k in range(BLOCK):
            one, other = vectors.load(work, begin + k), vectors.load(work, begin + k + BLOCK)
            vectors.store(work, size + begin // 2 + k, vectors.root(fused(one, one, other * other)))


@unowned_inlined
def move(
    power: FloatArray, generator: FloatArray, modes: bool, part: Vector, work: FloatArray, size: int, moved: FloatArray
) -> None:
    """Move by a part of the shortest span, by the Taylor series of the exponential. `moved` is scratch, 2C rows."""
    if modes:
        for begin in range(0, size, ROW):
            for k in range(BLOCK):
                one, other = vectors.load(work, begin + k), vectors.load(work, begin + k + BLOCK)
                total1, total2 = vectors.splat(0.0), vectors.splat(0.0)
                for j in range(TERMS - 1, -1, -1):
                    first = (j * (size // ROW) + begin // ROW) * 2
                    same, cross = first + SELF, first + CROSS
                    term1 = fused(other, weight(power, cross, k), one * weight(power, same, k))
                    term2 = fused(one, weight(power, cross, k + BLOCK), other * weight(power, same, k + BLOCK))
                    total1, total2 = fused(total1, part, term1), fused(total2, part, term2)
                vectors.store(work, begin + k, total1)
                vectors.store(work, begin + k + BLOCK, total2)
        return
    for r in range(size):
        vectors.store(moved, r, vectors.load(work, r))
    for k in range(TERMS - 1, 0, -1):
        for r in range(size):
            total = vectors.splat(0.0)
            for c in range(size):
                total = fused(vectors.load(work, c), vectors.number(generator, r * size + c), total)
            vectors.store(moved, size + r, vectors.load(moved, r) + part / float(k) * total)
        for r in range(size):
            vectors.store(work, r, vectors.load(moved, size + r))
