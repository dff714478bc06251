"""From states to the coordinates of a flow, over spans and parts of the shortest span in these, and back to states."""

from clunk.core.arrays import FloatArray
from clunk.core.exact import functionals, rows
from clunk.core.exact.flows import CROSS, PAIRS, SELF, TERMS
from clunk.core.exact.workspace import Workspace, field
from clunk.core.jit import inlined_part, part
from clunk.core.lanes import vectors
from clunk.core.lanes.pool import put_back
from clunk.core.lanes.vectors import ROW, WIDTH, OfLanes, Table, Vector, fused


@inlined_part
def to_coordinates(space: Workspace, flow: int) -> None:
    """Replace the states of the runs taken, at the beginning of a stretch, by their coordinates in its flow.

    Both lie in the first rows of `Pool.work`. The origin is subtracted from the states or, under ramps, its coordinates
    from theirs, see `flows._fill`.
    """
    origins, coordinates, begin = space.flows.origin, space.flows.coordinates, 4 * space.system.ramps
    if space.mixed:
        row = flow * origins.shape[2] + begin
        functionals.gather(space, origins, row, origins[0, 0, 0].size, space.lane_state_origins)
        functionals.gather(space, coordinates, flow, coordinates[0, 0].size, space.lane_table)
        _to_coordinates(space, OfLanes(space.lane_state_origins), OfLanes(space.lane_table))
    else:
        _to_coordinates(space, origins[0, flow, begin], coordinates[0, flow])


@part
def _to_coordinates(space: Workspace, begins: Table, coordinates: Table) -> None:
    """Replace the states in `Pool.work`, in all lanes, by their coordinates.

    begins : (I, C) for each lane or for all, the origin at t = 0 by each input; under ramps, its coordinates
    """
    work, x, size, states = space.pool.work, space.moved, space.behind, space.flows.coordinates.shape[2]
    ramps, zero = space.system.ramps, vectors.splat(0.0)
    for k in range(states):
        begin = zero if ramps else functionals.weighed(space, begins, k, size, space.inputs_at)
        vectors.store(x, k, vectors.load(work, k) - begin)
    for c in range(size):
        total = -functionals.weighed(space, begins, c, size, space.inputs_at) if ramps else zero
        for k in range(states):
            total = fused(vectors.load(x, k), vectors.number(coordinates, k * size + c), total)
        vectors.store(work, c, total)


@inlined_part
def to_states(space: Workspace, flow: int, mask: int) -> None:
    """Write the states of the runs taken to `Workspace.state`, for the lanes in a mask.

    They follow from the coordinates in a flow and the time ELAPSED.
    """
    flows = space.flows
    if space.mixed:
        count, origins = flows.basis[0, 0].size, flows.origin[0, 0].size
        functionals.gather(space, flows.origin, flow, origins, space.lane_state_origins)
        functionals.gather(space, flows.basis, flow, count, space.lane_table)
        _to_states(space, OfLanes(space.lane_state_origins), OfLanes(space.lane_table))
    else:
        _to_states(space, flows.origin[0, flow], flows.basis[0, flow])
    put_back(space.pool, space.moved, space.state, space.behind, mask)


@part
def _to_states(space: Workspace, origins: Table, basis: Table) -> None:
    """Write the states of the runs taken, in all lanes, to `Workspace.moved`."""
    work, size, elapsed = space.pool.work, space.behind, field(space, rows.ELAPSED)
    order = space.system.input_count * size
    for n in range(space.flows.coordinates.shape[2]):
        at = functionals.weighed_origin(space, origins, n, size, order, space.inputs_at, False, elapsed)
        away = vectors.splat(0.0)
        for j in range(size):
            away = fused(vectors.load(work, j), vectors.number(basis, j * size + n), away)
        vectors.store(space.moved, n, at.value + away)


@inlined_part
def move(space: Workspace, flow: int, short: bool, k: Vector, part: Vector) -> None:
    """Move the coordinates of each item taken over a span or, if `short`, over a part of the shortest span.

    k : number of each lane's span on the ladder; unused if `short`
    part : share of the shortest span; only used if `short`
    """
    size, flows, table, places = space.behind, space.flows, space.flows.propagator, space.pool.places
    if short and not flows.modal[0, flow]:
        functionals.gather(space, flows.generator, flow, size * size, space.lane_table)
        move_together(space.lane_table, part, space.pool.work, size, space.moved)
        return
    vectors.store(space.notes, 0, vectors.splat(float(table.shape[2] - 1)) if short else k)
    for lane in range(WIDTH):
        first = (space.drivelines[lane] * table.shape[1] + flow) * table.shape[2]
        places[lane] = (first + int(space.notes[0, lane])) * 2 * size
    for row in range(0, 2 * size, ROW):
        vectors.gather(table, places, row, space.moved, row)
    move_modes(space.moved, short, part, space.pool.work, size)


@inlined_part
def measure(work: FloatArray, size: int, amplitudes: FloatArray) -> None:
    """Write the amplitude sqrt(a² + b²) of each pair of coordinates to `amplitudes`, (C/2, WIDTH)."""
    for begin in range(0, size, ROW):
        for k in range(PAIRS):
            one, other = vectors.load(work, begin + k), vectors.load(work, begin + k + PAIRS)
            vectors.store(amplitudes, begin // 2 + k, vectors.root(fused(one, one, other * other)))


@inlined_part
def move_modes(shares: FloatArray, short: bool, part: Vector, work: FloatArray, size: int) -> None:
    """Move modal coordinates over a span by its propagator or, if `short`, over a part of the shortest span.

    That part is taken by the Taylor series of the exponential.

    shares : (2C, WIDTH) float64
        Each lane's row of `Flows.propagator`: its span's or, if `short`, the last one, which has the generator.
    """
    for begin in range(0, size, ROW):
        for k in range(PAIRS):
            p, q = begin + k, begin + k + PAIRS
            one, other = vectors.load(work, p), vectors.load(work, q)
            at_self, at_cross = 2 * begin + SELF * ROW + k, 2 * begin + CROSS * ROW + k
            same, cross = vectors.load(shares, at_self), vectors.load(shares, at_cross)
            same_too, crossed = vectors.load(shares, at_self + PAIRS), vectors.load(shares, at_cross + PAIRS)
            if short:
                moved, partner = one, other
                for n in range(TERMS - 1, 0, -1):
                    share = part * (1.0 / n)
                    change = fused(partner, cross, moved * same)
                    partner = fused(share, fused(partner, same_too, moved * crossed), other)
                    moved = fused(share, change, one)
            else:
                moved, partner = fused(same, one, cross * other), fused(same_too, other, crossed * one)
            vectors.store(work, p, moved)
            vectors.store(work, q, partner)


@inlined_part
def move_together(generator: FloatArray, part: Vector, work: FloatArray, size: int, moved: FloatArray) -> None:
    """Move coordinates that are no modes over a part of the shortest span, by the Taylor series of the exponential.

    generator : (C², WIDTH) float64
        `Flows.generator` of each lane.
    moved : (2C or more, WIDTH) float64
        Scratch.
    """
    for r in range(size):
        vectors.store(moved, r, vectors.load(work, r))
    for n in range(TERMS - 1, 0, -1):
        for r in range(size):
            total = vectors.splat(0.0)
            for c in range(size):
                total = fused(vectors.load(work, c), vectors.load(generator, r * size + c), total)
            vectors.store(moved, size + r, fused(part * (1.0 / n), total, vectors.load(moved, r)))
        for r in range(size):
            vectors.store(work, r, vectors.load(moved, size + r))
