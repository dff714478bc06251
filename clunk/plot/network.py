"""Regions and boundaries of a map as they were traced: polygons and curves with all of their vertices, unsmoothed."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from clunk.plot.plane import Codes, View
from clunk.results.boundaries import Boundaries, Region
from clunk.study.arrays import Floats


def fill_label(ax: Axes, boundaries: Boundaries, view: View, label: str, look: dict[str, Any]) -> None:
    """Fill all regions of a label."""
    rings = [ring[:, view.keep] for region in boundaries.regions if region.label == label for ring in region.rings]
    if rings:
        path = Path.make_compound_path(*(Path(ring, closed=True) for ring in rings))
        ax.add_patch(PathPatch(path, linewidth=0.0, zorder=1, gid=f"region {label}", **look))


def draw_curves(ax: Axes, boundaries: Boundaries, view: View, look: dict[str, Any]) -> None:
    """Draw the curves between the labels."""
    curves = [curve.vertices[:, view.keep] for curve in boundaries.curves]
    ax.add_collection(LineCollection(curves, joinstyle="round", gid="boundaries", **look), autolim=False)


def codes_at(boundaries: Boundaries, view: View, across: Floats, upward: Floats, codes: Codes) -> Codes:
    """Codes of the regions at points of a grid, (upward, across); codes : of points on a boundary, to begin with."""
    filled = codes.copy()
    for region, code in zip(boundaries.regions, boundaries.region_label, strict=True):
        outer = region.rings[0][:, view.keep]
        (low_x, low_y), (high_x, high_y) = outer.min(axis=0), outer.max(axis=0)
        columns = slice(*np.searchsorted(across, [low_x, high_x], side="right"))
        rows = slice(*np.searchsorted(upward, [low_y, high_y], side="right"))
        points = np.stack(np.meshgrid(across[columns], upward[rows]), axis=-1)
        filled[rows, columns][_within(region, view, points.reshape(-1, 2)).reshape(points.shape[:2])] = code
    return filled


def _within(region: Region, view: View, points: Floats) -> Any:
    """Whether points (n, 2) are within the outer ring of a region and in none of its holes."""
    inside = [Path(ring[:, view.keep]).contains_points(points) for ring in region.rings] if len(points) else []
    return inside[0] & ~np.any(inside[1:], axis=0) if len(inside) > 1 else inside[0] if inside else np.zeros(0, bool)
