"""The boundary network of a regime map over one or two axes: which labels meet where, to 1e-9 of each axis.

Of two axes, lines are traced (`clunk.analysis.lines`), linked to curves and closed to regions
(`clunk.analysis.network`), and each curve gets its event (`clunk.analysis.boundaryevents`). Of one axis, they are its
thresholds (`clunk.analysis.thresholds`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.analysis.boundaryevents import events_between
from clunk.analysis.lines import Lines, Triangles
from clunk.analysis.network import SAME, junctions_of, paths_of, regions_of, rings_of
from clunk.analysis.pointruns import PointRuns
from clunk.analysis.search import POINT
from clunk.analysis.thresholds import thresholds
from clunk.results.boundaries import NO_LABEL, Boundaries
from clunk.results.maps import AnyMap, Results
from clunk.results.quantities import LABEL, OF_RUNS
from clunk.study.arrays import Floats
from clunk.study.axes import ResultAxis
from clunk.study.designs import design_of, has_tolerances
from clunk.study.errors import ClunkError
from clunk.study.models import lash_position
from clunk.study.parameters import located
from clunk.study.study import Study
from clunk.sweeping.progress import Progress
from clunk.sweeping.runner import Runner
from clunk.sweeping.sweep import engine_of

RUNS_OF_BOUNDARIES = "runs along the boundaries"  # of which progress tells


class BoundaryError(ClunkError):
    """A study whose map has no boundaries to trace; its text is one sentence for the user."""


def require_boundaries(study: Study) -> None:
    """Raise BoundaryError where a study's map has no boundaries between its cells that could be traced."""
    swept, axes = study.sweep, design_of(study).axes
    if swept is None or not axes:
        raise BoundaryError("There are no boundaries to trace: the config has no [[sweep.axes]].")
    if has_tolerances(study):
        raise BoundaryError("A tolerance map has no boundaries: in its cells labels are probable, not certain.")
    if swept.samples or swept.design == "zip":
        reason = (
            "samples have no neighbours" if swept.samples else 'axes that are walked together (design = "zip") do not'
        )
        raise BoundaryError(f"Boundaries are traced on a grid of axes; {reason}.")
    if len(axes) > 2:
        raise BoundaryError(f"Boundaries are traced on maps of one or two axes, and the config has {len(axes)}.")
    for axis in axes:
        if len(axis.values) < 2:
            raise BoundaryError(f"{axis.parameter} has one value; boundaries lie between two or more.")
        if len(np.unique(axis.values)) < len(axis.values):
            raise BoundaryError(f"{axis.parameter} has a value twice; boundaries lie between different ones.")
        if located(study, axis.parameter)[1].whole:
            raise BoundaryError(f"{axis.parameter} is a whole number, between whose values nothing lies.")


def is_traced(study: Study, asked: bool | None = None) -> bool:
    """Whether a sweep of a study traces the boundaries of its map.

    It does as asked, else as ``[sweep] boundaries`` says, and without either on two axes whose map has boundaries.
    Raises BoundaryError where they are asked for and the map has none.
    """
    if asked is None and study.sweep is not None:
        asked = study.sweep.boundaries
    if asked is False or (asked is None and len(design_of(study).axes) != 2):
        return False
    try:
        require_boundaries(study)
    except BoundaryError:
        if asked:
            raise
        return False
    return True


def boundaries(
    study: Study,
    results: Results,
    *,
    lash: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Boundaries:
    """Trace the boundaries of a study's regime map.

    Parameters
    ----------
    study : Study
    results : Results
        Its map. Where cells failed, that is a label of its own.
    lash : str, optional
        Of several lashes, the one whose labels are meant, by name or number; by default the first.
    workers : int, optional
        Threads; by default one for each core that this process may use.
    progress : callable(done, 0), optional
        Called in this thread with the number of points that have been run.

    Raises
    ------
    BoundaryError
        Where the map has none, see `require_boundaries`.
    ConfigError
        Where there is no such lash.
    """
    require_boundaries(study)
    position, part = lash_position(lash, results.lash_names), results.of_lash(lash)
    traced = (_of_axis if len(part.axes) == 1 else _of_plane)(study, part, position, workers, progress)
    return replace(traced, lash=results.lashes[position]) if results.lashes else traced


def with_boundaries(
    study: Study,
    results: AnyMap,
    *,
    lash: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> AnyMap:
    """A regime map with its boundaries, traced where it has none of this lash yet. Raises as `boundaries`."""
    if not isinstance(results, Results):
        return results
    part = results if lash is None else results.of_lash(lash)
    if part.boundaries is not None:
        return results
    return replace(results, boundaries=boundaries(study, results, lash=lash, workers=workers, progress=progress))


class _Scale:
    """An axis from 0 to 1, in its logarithm where it is geometric."""

    def __init__(self, axis: ResultAxis) -> None:
        self.to: Callable[..., Any] = np.log if axis.is_geometric else np.asarray
        self.back: Callable[..., Any] = np.exp if axis.is_geometric else np.asarray
        self.lowest, self.highest = axis.values.min(), axis.values.max()
        self.begin = self.to(self.lowest)
        self.span = self.to(self.highest) - self.begin
        self.order = np.argsort(axis.values)

    def shares(self, values: Floats) -> Floats:
        shares: Floats = (self.to(values) - self.begin) / self.span
        return np.clip(shares, 0.0, 1.0)

    def values(self, shares: Floats) -> Floats:
        inner = np.clip(self.back(self.begin + shares * self.span), self.lowest, self.highest)
        values: Floats = np.where(shares == 0.0, self.lowest, np.where(shares == 1.0, self.highest, inner))
        return values


def _of_plane(study: Study, results: Results, lash: int, workers: int | None, progress: Progress | None) -> Boundaries:
    scales = [_Scale(axis) for axis in results.axes]
    ascending = np.ix_(*(scale.order for scale in scales))

    def values_at(places: Floats) -> Floats:
        return np.column_stack([scale.values(places[:, k]) for k, scale in enumerate(scales)])

    with engine_of(None, workers) as engine:
        point_runs = PointRuns(
            study,
            [axis.parameter for axis in results.axes],
            OF_RUNS[LABEL],
            lash,
            engine,
            words=results.labels,
            progress=progress,
        )
        across, upward = (
            scale.shares(axis.values[scale.order]) for scale, axis in zip(scales, results.axes, strict=True)
        )
        nodes = np.zeros(results.sequence.shape, POINT)
        nodes["outcome"], nodes["measure"] = results.sequence[ascending], results.margin[ascending]
        nodes["touches"] = results.touches[ascending]
        triangles = Triangles(across, upward, nodes)
        lines = Lines(triangles, lambda places: point_runs(values_at(places)), point_runs.cost)
        lines.trace()
        paths = paths_of(*lines.segments(), lines.position)
        regions = regions_of(rings_of(paths, int(triangles.outcome[0])))
        paths = [path for path in paths if np.ptp(path.vertices, axis=0).max() > SAME]  # none across a junction
        crossings = [[node for node in path.nodes if node >= 0] for path in paths]
        below, above = lines.bracket(np.array([nodes[len(nodes) // 2] for nodes in crossings], np.int64))
        events = events_between(point_runs.runner, lash, values_at(below), values_at(above))
    junctions, junction_labels = junctions_of(lines.met, lines.met_labels)
    rings = [ring for region in regions for ring in region]
    return Boundaries(
        axes=results.axes,
        labels=tuple(map(str, point_runs.words)),
        vertices=values_at(np.concatenate([np.zeros((0, 2)), *(path.vertices for path in paths)])),
        curve_counts=np.array([len(path.vertices) for path in paths], np.int32),
        curve_left=np.array([path.left for path in paths], np.int16),
        curve_right=np.array([path.right for path in paths], np.int16),
        curve_event=events.astype(np.int8),
        junctions=values_at(junctions),
        junction_labels=_filled(junction_labels),
        ring_vertices=values_at(np.concatenate([ring.vertices for ring in rings])),
        ring_counts=np.array([len(ring.vertices) for ring in rings], np.int32),
        region_rings=np.array([len(region) for region in regions], np.int32),
        region_label=np.array([region[0].label for region in regions], np.int16),
        region_area=np.array([sum(ring.area for ring in region) for region in regions]),
        unresolved=values_at(_one_of_each_cell(lines.unresolved, across, upward)),
    )


def _one_of_each_cell(places: Floats, across: Floats, upward: Floats) -> Floats:
    """The first of the places (n, 2) within each cell of a map, in the order of the cells."""
    cells = np.column_stack([np.searchsorted(across, places[:, 0]), np.searchsorted(upward, places[:, 1])])
    _, first = np.unique(cells, axis=0, return_index=True)
    return places[first]


def _filled(labels: list[list[int]]) -> npt.NDArray[np.int16]:
    """Codes of junctions as rows of an array."""
    width = max(3, *map(len, labels)) if labels else 3
    return np.array([codes + [NO_LABEL] * (width - len(codes)) for codes in labels], np.int16).reshape(-1, width)


def _of_axis(study: Study, results: Results, lash: int, workers: int | None, progress: Progress | None) -> Boundaries:
    """The boundaries along one axis: single values, and intervals between them."""
    (axis,) = results.axes
    scan = thresholds(study, along=axis.parameter, lash=str(lash + 1), workers=workers, progress=progress or False)
    words = [word for word in scan.words if word not in results.labels]
    labels = (*results.labels, *map(str, words))
    number = np.array([*(labels.index(str(word)) for word in scan.words), -1], np.int16)
    scale = _Scale(axis)
    codes = number[np.concatenate([scan.lowest, scan.above])]
    edges = np.concatenate([[scale.lowest], scan.value, [scale.highest]])
    count, aside = scan.value.size, 1e-9 * (scale.highest - scale.lowest)
    runner = Runner(study, [axis.parameter])
    below, above = np.maximum(scan.value - aside, scale.lowest)[:, None], scan.value[:, None] + aside
    events = events_between(runner, lash, below, above)
    return Boundaries(
        axes=results.axes,
        labels=labels,
        vertices=scan.value[:, None],
        curve_counts=np.ones(count, np.int32),
        curve_left=number[scan.below],
        curve_right=number[scan.above],
        curve_event=events.astype(np.int8),
        junctions=np.zeros((0, 2)),
        junction_labels=_filled([]),
        ring_vertices=np.column_stack([edges[:-1], edges[1:]]).reshape(-1, 1),
        ring_counts=np.full(count + 1, 2, np.int32),
        region_rings=np.ones(count + 1, np.int32),
        region_label=codes,
        region_area=np.diff(scale.shares(edges)),
        unresolved=np.array([0.5 * (begin + end) for _, begin, end in scan.unresolved]).reshape(-1, 1),
    )
