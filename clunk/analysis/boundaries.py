"""The boundary network of a regime map over two axes: which labels meet where, to 1e-9 of each axis.

Lines are traced (`clunk.analysis.lines`), linked to curves and closed to regions (`clunk.analysis.network`), and each
curve gets its event (`events_between`).
"""

from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np

from clunk.analysis.lines import CHORD, TOUCHES, Lines
from clunk.analysis.network import SAME, Path, Ring, junctions_of, paths_of, regions_of, rings_of
from clunk.analysis.search import POINT, PointRuns, check_axis, grid_axes, in_halves
from clunk.analysis.triangles import Triangles
from clunk.core.events import STAGE, TOUCH
from clunk.core.status import Status
from clunk.results.boundaries import (
    END_TIME,
    INITIAL_FLANK,
    OPPOSITE_FLANK,
    STICKING_ENDS,
    STICKING_TIME,
    UNKNOWN,
    Boundaries,
)
from clunk.results.maps import AnyMap, Results
from clunk.results.quantities import LABEL, OF_RUNS
from clunk.study.arrays import Codes, Floats, Records
from clunk.study.axes import ResultAxis, parameters_of
from clunk.study.errors import ClunkError
from clunk.study.models import WhichLash, lash_position
from clunk.study.study import Study
from clunk.sweeping.progress import ShowProgress, reporting
from clunk.sweeping.runner import Runner
from clunk.sweeping.sweep import engine_of

_AT_ONCE = 64  # pairs of runs whose events are in memory at a time: few runs have more than hundreds of events
_AT_END = 1e-6  # of the end time: an event of one run only that is as near to the end is due to the end
# of the end time: the same event of two runs is no further apart, as points 1e-9 apart have runs that are alike up to
# the first event that only one of them has
_SAME_TIME = 1e-6


def require_boundaries(study: Study) -> None:
    """Raise ClunkError where the map of a study has no boundaries that could be traced between its cells."""
    axes = grid_axes(study, "Boundaries")
    if study.swept.tolerances:
        raise ClunkError("A tolerance map has no boundaries: in its cells labels are probable, not certain.")
    if len(axes) != 2:
        raise ClunkError(
            f"Boundaries are lines on a map of two axes, and the config has {len(axes)}; the values of one axis at "
            f"which its label changes are found by clunk thresholds --along {axes[0].parameter}."
        )
    for axis in axes:
        check_axis(study, axis, "boundaries")


def is_traced(study: Study, asked: bool | None, lash: WhichLash) -> bool:
    """Whether a sweep of a study traces the boundaries of its map.

    It does as `asked`; where that is None, as ``[sweep] boundaries`` says; and where the config says nothing, if the
    map has boundaries. Raises ClunkError where boundaries are asked for and the map has none, and ConfigError where the
    study has no such lash.
    """
    lash_position(lash, study.lash_names)
    if asked is None:
        asked = study.swept.boundaries
    if asked is False:
        return False
    try:
        require_boundaries(study)
    except ClunkError:
        if asked:
            raise
        return False
    return True


def boundaries(
    study: Study,
    results: Results,
    *,
    lash: WhichLash = None,
    workers: int | None = None,
    progress: ShowProgress = False,
) -> Boundaries:
    """Trace the boundaries of a study's regime map.

    Parameters
    ----------
    study : Study
    results : Results
        The study's map. Failed cells have a label of their own, `failed`.
    lash : str, optional
        Of several lashes, the one whose labels are meant, by name or number; by default the first.
    workers : int, optional
        Threads; by default one for each core that this process may use.
    progress
        As in `clunk.sweep`; it counts runs, with a total of 0, as their number in all is not known.

    Raises
    ------
    ClunkError
        Where the map has no boundaries, see `require_boundaries`.
    ConfigError
        Where there is no such lash.
    """
    require_boundaries(study)
    position, part = lash_position(lash, results.lash_names), results.of_lash(lash)
    ascending = np.ix_(*(axis.values.argsort() for axis in part.axes))

    def values_at(places: Floats) -> Floats:
        return np.column_stack([*map(_values, part.axes, places.T)])

    with engine_of(None, workers) as engine, reporting(progress, study, what="runs along the boundaries") as report:
        keys = parameters_of(part.axes)
        point_runs = PointRuns(study, keys, OF_RUNS[LABEL], position, engine, words=part.labels, progress=report)
        across, upward = map(_shares, part.axes)
        nodes = np.zeros(part.sequence.shape, POINT)
        nodes["outcome"], nodes["measure"] = part.sequence[ascending], part.margin[ascending]
        nodes["touches"] = part.touches[ascending]
        triangles = Triangles(across, upward, nodes)
        # touches of other lashes in a run, which the runs of points do not count
        of_others = (results.touches.sum() - part.touches.sum()) // nodes.size
        beside = point_runs.preparing + of_others // TOUCHES
        lines = Lines(triangles, lambda places: point_runs(values_at(places)), point_runs.cost, beside)
        lines.trace()
        paths = paths_of(*lines.segments(), lines.position)
        # regions and curves within a junction are left out
        regions = regions_of([ring for ring in rings_of(paths, triangles.outcome[0]) if _extent(ring) > SAME])
        paths = [path for path in paths if _extent(path) > SAME]
        crossings = [[node for node in path.nodes if node >= 0] for path in paths]
        below, above = lines.bracket(np.array([nodes[len(nodes) // 2] for nodes in crossings], np.int64))
        events = events_between(point_runs.runner, engine, position, values_at(below), values_at(above))
        events[abs(above - below).max(axis=1) > CHORD] = UNKNOWN  # many events may lie between points so far apart
    junctions, junction_labels = junctions_of(lines.met, lines.met_labels)
    rings = [ring for region in regions for ring in region]
    cells = np.column_stack([*map(np.searchsorted, (across, upward), lines.unresolved.T)])
    _, first = np.unique(cells, axis=0, return_index=True)  # one unresolved place for each cell that has any
    return Boundaries(
        lash=results.lashes[position] if results.lashes else "",
        axes=part.axes,
        labels=tuple(map(str, point_runs.words)),
        vertices=values_at(np.concatenate([np.zeros((0, 2)), *(path.vertices for path in paths)])),
        curve_counts=np.array([len(path.vertices) for path in paths], np.int32),
        curve_left=np.array([path.left for path in paths], np.int16),
        curve_right=np.array([path.right for path in paths], np.int16),
        curve_event=events.astype(np.int8),
        junctions=values_at(junctions),
        junction_labels=junction_labels,
        ring_vertices=values_at(np.concatenate([ring.vertices for ring in rings])),
        ring_counts=np.array([len(ring.vertices) for ring in rings], np.int32),
        region_rings=np.array([len(region) for region in regions], np.int32),
        region_label=np.array([region[0].label for region in regions], np.int16),
        region_area=np.array([sum(ring.area for ring in region) for region in regions]),
        unresolved=values_at(lines.unresolved[first]),
    )


def with_boundaries(
    study: Study,
    results: AnyMap,
    *,
    lash: WhichLash = None,
    **options: Any,
) -> AnyMap:
    """A regime map with its boundaries, traced unless it has those of this lash already; any other map as it is.

    options : as of `boundaries`
    """
    if not isinstance(results, Results):
        return results
    part = results if lash is None else results.of_lash(lash)
    if part.boundaries is not None:
        return results
    return replace(results, boundaries=boundaries(study, results, lash=lash, **options))


def _extent(outline: Path | Ring) -> float:
    """Larger side of the box around a curve or a ring, as a share of the map."""
    return float(np.ptp(outline.vertices, axis=0).max())


def _shares(axis: ResultAxis) -> Floats:
    """Ascending places from 0 to 1 of an axis's values: as they are spaced, or as their logarithms where geometric."""
    values = axis.ascending.values
    places = np.log(values) if axis.is_geometric else values
    return (places - places[0]) / np.ptp(places)


def _values(axis: ResultAxis, shares: Floats) -> Floats:
    """Values of an axis at places from 0 to 1; at 0 and 1 these are the ends of the axis, bit for bit."""
    low, high = axis.ends
    inner = low * (high / low) ** shares if axis.is_geometric else low + shares * (high - low)
    return np.where(shares == 1.0, high, inner.clip(low, high))


def events_between(runner: Runner, engine: Executor, lash: int, one: Floats, other: Floats) -> Codes:
    """Events that make the labels of pairs of points differ, (n,) positions in `EVENTS`.

    The first event that only one of a pair's two runs has decides. Where it is a touch, that flank is grazed; any other
    event means that one run ends a contact that holds in the other; and one just before the end time, that the end time
    is reached. Where both runs have the same events, a contact has held for the sticking time in one of them only.

    engine : of threads
    lash : position of the lash whose labels differ
    one, other : the two points of each pair, (n, keys of the runner)
    """

    def of_pairs(pairs: Floats) -> Codes:
        points = pairs.reshape(-1, one.shape[1])
        records, logs = runner.grid.logged(dict(zip(runner.keys, points.T, strict=True)), len(points))
        records, logs = records[:, lash].reshape(-1, 2), logs.reshape(len(pairs), 2, -1)
        return _differences(records, logs, runner.study.solver.end_time, lash)

    def of_part(begin: int) -> Codes:
        pairs = np.stack([part[begin : begin + _AT_ONCE] for part in (one, other)], axis=1)
        return in_halves(of_pairs, pairs, np.array([UNKNOWN]))

    return np.concatenate([np.zeros(0, np.int64), *engine.map(of_part, range(0, len(one), _AT_ONCE))])


def _differences(records: Records, logs: Records, end_time: float, lash: int) -> Codes:
    """Events that make the labels of pairs of runs differ, from their CELL (n, 2) and EVENT (n, 2, events)."""
    sides = np.where(records["status"] == Status.OK, records["initial_side"], 0)
    # neither a change of a shaft's stage nor an event of another lash changes a label
    times = np.where((logs["kind"] == STAGE) | ((logs["lash"] >= 0) & (logs["lash"] != lash)), np.nan, logs["time"])
    order = np.isnan(times).argsort(axis=2, kind="stable")
    logs, times = np.take_along_axis(logs, order, 2), np.take_along_axis(times, order, 2)
    is_event = ~np.isnan(times)
    differ = abs(times[:, 0] - times[:, 1]) > _SAME_TIME * end_time
    for name in ("kind", "side"):
        differ |= logs[name][:, 0] != logs[name][:, 1]
    differ |= ~is_event.all(axis=1)  # beyond the last event of one of the runs
    first = differ.argmax(axis=1)
    times = np.where(is_event, times, np.inf)[np.arange(len(logs)), :, first]
    events = logs[np.arange(len(logs)), times.argmin(axis=1), first]
    return np.select(
        [
            (sides[:, 0] == 0) | (sides[:, 0] != sides[:, 1]),
            ~differ.any(axis=1) | ~np.isfinite(times).any(axis=1),
            times.min(axis=1) > (1.0 - _AT_END) * end_time,
            events["kind"] != TOUCH,
            events["side"] == sides[:, 0],
        ],
        [UNKNOWN, STICKING_TIME, END_TIME, STICKING_ENDS, INITIAL_FLANK],
        OPPOSITE_FLANK,
    )
