"""Functionals of the items taken from a queue, by the tables of the flow that all of these items are in.

If all runs have one driveline, its tables are read in place. If drivelines may differ from lane to lane
(`Workspace.mixed`), the parts that are read are first gathered into arrays with a column for each lane.
"""

from clunk.core.arrays import FloatArray
from clunk.core.exact import curves, taylor
from clunk.core.exact.curves import Origin
from clunk.core.exact.flows import LONG
from clunk.core.exact.workspace import Workspace, shortest_span
from clunk.core.jit import inlined_part, part
from clunk.core.lanes import vectors
from clunk.core.lanes.vectors import ROW, WIDTH, OfLanes, Table, Vector, fused
from clunk.core.tables import INPUTS


@part
def gather(space: Workspace, table: FloatArray, number: int, count: int, to: FloatArray) -> None:
    """Gather one block of a table, that of each lane's driveline, into the lane's column of `to`.

    table : (D, …) float64
        Of each driveline, blocks of `count` numbers.
    number : which block
    count : at least ROW
    to : (count or more, W) float64
    """
    numbers, places = table.size // table.shape[0], space.pool.places
    for lane in range(WIDTH):
        places[lane] = space.drivelines[lane] * numbers + number * count
    for row in range(0, count, ROW):
        at = min(row, count - ROW)  # the last rows overlap: nothing is read behind the table's end
        vectors.gather(table, places, at, to, at)


@part
def gather_tables(space: Workspace, flow: int, items_per_run: int) -> None:
    """Look up the drivelines of the items taken, and gather their tables of a flow.

    These are the flow's shortest span, and its functionals (`Flows.watch`) with their origins (`Flows.origin_output`).

    items_per_run : 1 for steps, `Workspace.searches_each` for searches
    """
    for lane in range(WIDTH):
        driveline = space.runs[space.pool.items[lane] // items_per_run].driveline
        space.drivelines[lane] = driveline
        space.shortest[flow, lane] = space.flows.span[driveline, flow, 0]
    watch, output = space.flows.watch, space.flows.origin_output
    watched, origins = watch[0, 0].size, output[0, 0].size
    gather(space, watch, flow, watched, space.lane_watch)
    gather(space, output, flow, origins, space.lane_output_origins)


@inlined_part
def evaluate(space: Workspace, flow: int, f: int) -> tuple[curves.Curve, Vector]:
    """`curves.evaluate` of functional `f` in a flow, for the items taken."""
    work, amplitudes, size = space.pool.work, space.amplitudes, space.behind
    if space.mixed:
        return curves.evaluate(OfLanes(space.lane_watch[f * space.flows.watch[0, 0, 0].size :]), work, amplitudes, size)
    return curves.evaluate(space.flows.watch[0, flow, f], work, amplitudes, size)


@inlined_part
def origin(space: Workspace, flow: int, f: int, inputs_at: int, elapsed: Vector) -> Origin:
    """The origin of functional `f` in a flow, for the items taken.

    inputs_at : the row of `Pool.work` where the regime's inputs u begin
    elapsed : since the stretch began  [s]
    """
    output, driven = space.flows.origin_output, space.system.input_count
    first, order = f * driven, output.shape[3] * driven
    still = space.flows.steady[0, flow] != 0 and not space.system.ramps
    if space.mixed:
        return weighed_origin(space, OfLanes(space.lane_output_origins), first, 1, order, inputs_at, still, elapsed)
    return weighed_origin(space, output[0, flow], first, 1, order, inputs_at, still, elapsed)


@inlined_part
def weighed_origin(
    space: Workspace, weights: Table, first: int, stride: int, order: int, at: int, still: bool, elapsed: Vector
) -> Origin:
    """The origin of a functional or a state: weighted sums of the inputs, carried on from the stretch's beginning.

    weights : one for each input, from `first` on and `stride` apart; those of the next derivative begin `order` further
    at : the row of `Pool.work` where the inputs begin
    still : whether the origin is constant; its derivatives are then left out, which saves a tenth of a step's time
    elapsed : since the stretch began  [s]
    """
    value = weighed(space, weights, first, stride, at)
    slope = curvature = third = vectors.splat(0.0)
    if not still:
        slope = weighed(space, weights, first + order, stride, at)
        curvature = weighed(space, weights, first + 2 * order, stride, at)
        third = weighed(space, weights, first + 3 * order, stride, at)
        value += elapsed * (slope + 0.5 * elapsed * (curvature + elapsed * (1.0 / 3.0) * third))
        slope += elapsed * (curvature + 0.5 * elapsed * third)
        curvature += elapsed * third
    return Origin(value, slope, curvature, third)


@inlined_part
def weighed(space: Workspace, weights: Table, first: int, stride: int, at: int) -> Vector:
    """Sum of weights times inputs, which begin in row `at` of `Pool.work`; rounded once for each term."""
    work = space.pool.work
    total = vectors.load(work, at) * vectors.number(weights, first)
    for k in range(1, INPUTS):  # those of a plain driveline: with a constant count, a run takes 3 % less time
        total = fused(vectors.load(work, at + k), vectors.number(weights, first + k * stride), total)
    for k in range(INPUTS, space.system.input_count):
        total = fused(vectors.load(work, at + k), vectors.number(weights, first + k * stride), total)
    return total


@inlined_part
def expand(space: Workspace, flow: int, f: int, sign: Vector, shift: Vector, at: Origin) -> Vector:
    """`taylor.expand` of functional `f` in a flow, for the items taken, into `Workspace.series`.

    at : the functional's origin
    """
    size, shortest, series, work = space.behind, shortest_span(space, flow), space.flows.series, space.pool.work
    if space.mixed:
        gather(space, series, flow * series.shape[2] + f, size * LONG, space.lane_table)
        return taylor.expand(OfLanes(space.lane_table), work, size, shortest, sign, shift, at, space.series)
    return taylor.expand(series[0, flow, f], work, size, shortest, sign, shift, at, space.series)
