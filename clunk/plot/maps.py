"""Maps of results: regimes like the report's Figure 3.4, severities and other quantities like its Figure 3.7."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy import ndimage

from clunk.analysis.ridge import ridge_of
from clunk.plot.labelling import label_and_note
from clunk.plot.layers import Layers
from clunk.plot.painting import Colours, mark_undecided, new_map, paint_regimes, shaded_map
from clunk.plot.plane import View, spaced_numbers
from clunk.plot.raster import Raster, centres_that_fit
from clunk.plot.style import CENTRED, FAINT_INK, INK, bare, freeze_layout, halo, styled, symbol_text
from clunk.results.regimemap import Results
from clunk.study.arrays import Floats

_WITH_THRESHOLDS = ("load.ratio", "load.initial_torque", "load.final_torque")


@styled()
def regime_map(results: Results, thresholds: Sequence[float] = ()) -> Figure:
    """The sequence of impacts in every cell, each region with its label inside (Figure 3.4).

    thresholds : values of the x axis at which the number of impacts for vanishing backlash changes (Table 3.1), marked
        where x is the load ratio or a load torque and y the backlash; along any other, they might not stay the same

    Raises PlotError unless two axes were swept.
    """
    layers = Layers.of(results, 2)
    figure, ax = new_map(layers)
    paint_regimes(ax, layers)
    if layers.view.x.parameter in _WITH_THRESHOLDS and layers.view.y.parameter == "lash.backlash_deg":
        _mark_thresholds(ax, thresholds)
    mark_undecided(ax, layers)
    label_and_note(figure, ax, layers)
    return figure


@styled()
def quantity_map(results: Results, name: str) -> Figure:
    """A quantity of every cell as colour, under the regimes' boundaries (of the severity, Figure 3.7).

    Of how hard impacts are there is also the ridge: the backlash at which it is worst for each load ratio.

    The margin's colours diverge from zero, where a run is as near to one label as to another.

    Raises PlotError unless two axes were swept, `name` is a quantity and it is defined in some cell.
    """
    layers = Layers.of_quantity(results, 2, name)
    layers.require_values()
    has_ridge = name in ("severity", *results.measured_quantities)
    ridge = ridge_of(layers.values) if has_ridge else np.full(len(layers.values), np.nan)
    figure, ax = shaded_map(layers, Colours.of(layers.described, layers.values), layers.boundaries_note)
    if np.isfinite(ridge).any():
        _draw_ridge(ax, layers.view, ridge)
    freeze_layout(figure, ax)
    if np.isfinite(ridge).any():
        _label_ridge(ax, layers, ridge)
    return figure


def _mark_thresholds(ax: Axes, thresholds: Sequence[float]) -> None:
    """Triangles where the number of impacts for vanishing backlash changes, with their values above the map."""
    low, high = ax.get_xlim()
    inside = sorted(value for value in thresholds if low <= value <= high)
    if not inside:
        return
    along = ax.get_xaxis_transform()
    ax.plot(inside, [0.0] * len(inside), "^", color=INK, markersize=5.5, transform=along, clip_on=False, zorder=6)
    top = ax.secondary_xaxis("top")
    top.set_xticks(inside, spaced_numbers(ax, inside))
    top.tick_params(direction="out", length=3.0, labelsize=8.5)
    top.minorticks_off()
    top.set_xlabel("▲ thresholds for vanishing backlash", loc="right", fontsize=8.5, color=FAINT_INK, labelpad=3.0)


def _draw_ridge(ax: Axes, view: View, ridge: Floats) -> None:
    """The ridge as a line, broken where it leaves the map or jumps from one hill to another."""
    known = np.isfinite(ridge)
    y = np.where(known, view.y.values[np.where(known, ridge, 0).astype(np.intp)], np.nan)
    jump = np.abs(np.diff(ridge)) > max(3.0, 0.05 * len(view.y.values))
    x = np.insert(view.x.values, np.flatnonzero(jump) + 1, np.nan)
    y = np.insert(y, np.flatnonzero(jump) + 1, np.nan)
    look: dict[str, Any] = {"color": "white", "linewidth": 1.4, "path_effects": halo(2.8, INK), "zorder": 4}
    ax.add_line(Line2D(x, y, gid="ridge", label="ridge", **look))


def _label_ridge(ax: Axes, layers: Layers, ridge: Floats) -> None:
    """Name the ridge beside its middle, off the line itself."""
    view = layers.view
    raster = Raster.blank(ax)
    known = np.flatnonzero(np.isfinite(ridge))
    points = np.column_stack((view.x.values[known], view.y.values[ridge[known].astype(np.intp)]))
    across, upward = raster.pixels(points)
    raster.take_line(across, upward)
    clear = ndimage.distance_transform_edt(~raster.taken) > 3.0
    symbol = bare(view.x.symbol) or view.x.name
    largest = f"largest {layers.described.symbol or 'value'} for each"
    width, height = raster.measure(f"{largest} {symbol}", 9.0)
    centres = centres_that_fit(clear, width, height)
    if not centres.size:
        return
    middle = len(known) // 2
    nearest = centres[np.argmin(np.hypot(*(centres - [across[middle], upward[middle]]).T))]
    x, y = raster.data(*nearest)
    look: dict[str, Any] = {"color": "white", "path_effects": halo(2.2, INK), "zorder": 5} | CENTRED
    ax.text(x, y, f"{largest} {symbol_text(symbol)}", fontsize=9.0, **look)
