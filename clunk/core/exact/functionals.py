"""Functionals of the runs that have been taken, by the tables of the flow that these are in.

Either all runs have one driveline, whose tables are read as they are; or each may have another, and what is read of
theirs is gathered first, so that each lane has its own.
"""

import numpy as np
import numpy.typing as npt

from clunk.core.exact import curves, taylor
from clunk.core.exact.flows import LONG
from clunk.core.exact.workspace import Workspace, is_still, shortest_span, size_of
from clunk.core.jit import inlined_part, part
from clunk.core.lanes import vectors
from clunk.core.lanes.vectors import ROW, WIDTH, OfLanes, Vector
from clunk.core.regimes import inputs_of

FloatArray = npt.NDArray[np.float64]


@part
def gather(space: Workspace, table: FloatArray, first: int, count: int, to: FloatArray) -> None:
    """Gather `count` numbers, at least ROW, of a table of each lane's driveline, from `first` on.

    table : (D, …) float64
    to : (count or more, W) float64
    """
    numbers = table.size // table.shape[0]  # of a driveline
    for lane in range(WIDTH):
        space.offsets[lane] = space.drivelines[lane] * numbers + first
    for row in range(0, count, ROW):
        at = min(row, count - ROW)  # nothing is read behind the table's end
        vectors.gather(table, space.offsets, at, to, at)


@part
def gather_tables(space: Workspace, flow: int, first: int, count: int, items_per_run: int) -> None:
    """Look up the drivelines of the items taken, and gather what is of theirs in a flow.

    That is its shortest span, `count` of its functionals from the first on, and the origins of all.
    """
    for lane in range(WIDTH):
        driveline = space.runs[space.pool.items[lane] // items_per_run].driveline
        space.drivelines[lane] = driveline
        space.shortest[flow, lane] = space.flows.span[driveline, flow, 0]
    watch, output = space.flows.watch, space.flows.origin_output
    watched, origins = watch[0, 0, 0].size, output[0, 0].size
    at = (flow * watch.shape[2] + first) * watched
    gather(space, watch, at, count * watched, space.lane_watch[first * watched :])
    read = origins // 4 if is_still(space, flow) else origins
    gather(space, output, flow * origins, max(read, ROW), space.lane_output_origins)


@inlined_part
def evaluate(space: Workspace, flow: int, f: int) -> tuple[curves.Curve, Vector]:
    """`curves.evaluate` of the runs taken."""
    work, amplitudes, size = space.pool.work, space.amplitudes, size_of(space)
    if space.mixed != 0:
        gathered = OfLanes(space.lane_watch[f * space.flows.watch[0, 0, 0].size :])
        return curves.evaluate(gathered, work, amplitudes, size)
    return curves.evaluate(space.flows.watch[0, flow, f], work, amplitudes, size)


@inlined_part
def origin(space: Workspace, flow: int, f: int, inputs_at: int, still: bool, elapsed: Vector) -> curves.Origin:
    """`curves.origin` of the runs taken, after a time in their phase.

    inputs_at : where the regime's inputs lie in the rows that were taken
    """
    output, work, driven = space.flows.origin_output, space.pool.work, inputs_of(space.system)
    first, order = f * driven, output.shape[3] * driven
    if space.mixed != 0:
        gathered = OfLanes(space.lane_output_origins)
        return curves.origin(gathered, first, 1, order, work, inputs_at, driven, still, elapsed)
    return curves.origin(output[0, flow], first, 1, order, work, inputs_at, driven, still, elapsed)


@inlined_part
def expand(space: Workspace, flow: int, f: int, sign: Vector, shift: Vector, at: curves.Origin) -> None:
    """`taylor.expand` of the runs taken, into `space.series`."""
    size, shortest, series, work = size_of(space), shortest_span(space, flow), space.flows.series, space.pool.work
    if space.mixed != 0:
        gather(space, series, (flow * series.shape[2] + f) * size * LONG, size * LONG, space.lane_table)
        taylor.expand(OfLanes(space.lane_table), work, size, shortest, sign, shift, at, space.series)
    else:
        taylor.expand(series[0, flow, f], work, size, shortest, sign, shift, at, space.series)
