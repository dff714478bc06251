"""Figures of a quantity of a map: one plane, or several side by side, a strip along one axis, or runs as points."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, product

import numpy as np
from matplotlib import colors, ticker
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from clunk.plot.labelling import Raster, write_beside, write_names
from clunk.plot.layers import MOST_LABELS, Layers, Note, hardness
from clunk.plot.plane import (
    View,
    cell_edges,
    drawn_axes,
    fixed_parameters,
    scale_axis,
    scale_panels,
    value_text,
)
from clunk.plot.style import (
    DASHED,
    FAILED_FILL,
    FAINT_INK,
    HUES,
    INK,
    LINE_COLOURS,
    MINUS,
    MOST_POINTS,
    SIZE,
    UNDEFINED,
    Look,
    PlotError,
    add_notes,
    lay_out,
    new_figure,
    new_panels,
    plain,
    styled,
    swatch,
    symbol_text,
    tidy,
)
from clunk.results.labels import FAILED, label_order
from clunk.results.maps import AnyMap, ToleranceMap
from clunk.results.quantities import WHOLE, YES_NO, quantity_of
from clunk.study.arrays import Floats
from clunk.study.parameters import numbered

_POINT = 6.5  # typographic points, diameter of the mark of a measured label
_POINT_LOOKS: dict[bool, tuple[str, Look]] = {  # whether a measured label agrees -> name and look of its mark
    True: ("agrees", {"marker": "o", "markersize": _POINT, "color": INK}),
    False: ("differs", {"marker": "X", "markersize": _POINT + 1.0, "color": "#b23500"}),
}
# Font sizes in points, for one panel of several and for a single map: those to try for the names of regions, in turn,
# and that of measured labels.
_SIZES = ((8.5, 7.5, 6.5), 6.5), ((10.5, 9.5, 8.5, 8.0), 8.0)
MOST_VALUES = (12, 4)  # most values drawn of a facet: of a single one, and of each of two
_DOUBT: Look = {"linestyle": "none", "marker": "o", "markeredgewidth": 0.0, "alpha": 0.1}
_PROBABLE = colors.LinearSegmentedColormap.from_list("probable", ["#f6f5f1", HUES[1]])
# An axis of backlash shows where backlash vanishes if it begins at zero, or above it by this share of its end at most.
_VANISHING = 0.02
_NARROWEST, _HIGHEST = 2.0, 2.2  # inches, least width and greatest height of each of several panels
_AROUND = (0.9, 1.3)  # inches, width and height for the axes and titles around several panels


def draw(
    drawn: AnyMap,
    quantity: str,
    thresholds: Sequence[float] = (),
    *,
    facets: Sequence[str] = (),
    x: str | None = None,
    y: str | None = None,
) -> Figure:
    """Draw a quantity of a map.

    Two swept axes give a map, one gives a strip, and runs of a sample or of axes that are walked together give points.
    Further axes become `facets`, or are fixed at one value beforehand (`Results.at`).

    quantity : in the words of `clunk.results.quantities`
    thresholds : see `map_figure`
    facets : one axis or two; each of their values, or each combination, has its own map
    x, y : parameters to draw runs over, by default the first two of: a grid's axes, load ratio, backlash, others. One
        alone draws the quantity over it.

    Raises PlotError where the map cannot be drawn so, and ClunkError where there is no such quantity.
    """
    quantity = quantity_of(quantity, drawn).name
    if facets:
        return facet_map(drawn, facets, quantity, x, y)
    layers = Layers.of(drawn, View.of(drawn, x, y), quantity)
    if layers.view.places or len(layers.view.axes) > 1:
        return map_figure([layers], thresholds=thresholds)
    return strip(layers)


def default_quantities(
    drawn: AnyMap, *, facets: Sequence[str] = (), x: str | None = None, y: str | None = None
) -> list[str]:
    """Quantities that are drawn where the user names none, a picture each.

    Over two axes they are the regimes and the `hardness` of the impacts, and for a tolerance map, in between, the
    probability of double-sided impacts. Over one axis it is the hardness alone, whose picture has the labels, too.
    """
    numbers = [*["double_sided"] * isinstance(drawn, ToleranceMap), hardness(drawn)]
    known = [name for name in numbers if np.isfinite(quantity_of(name, drawn).of_runs(drawn)).any()]
    names = ["regimes", *known]  # the regimes alone where all cells have failed
    return list(dict.fromkeys(names)) if facets or len(View.of(drawn, x, y).axes) > 1 else names[-1:]


@styled()
def map_figure(
    panels: Sequence[Layers],
    names: Sequence[str] = (),
    line: str = "",
    *,
    columns: int = 0,
    thresholds: Sequence[float] = (),
) -> Figure:
    """Figure of maps over the same axes in the same colours: named regions (Figure 3.4), a quantity (3.7), or points.

    panels : one or more, whose quantity is the same
    names : of the panels, if there are several
    line : text under the title, by default the subtitle of the first map
    columns : number of columns of panels; 0 for 2 of four panels, and otherwise 3 at most
    thresholds : values of the x axis at which the number of impacts for vanishing backlash changes (report §3.2),
        marked where y is the backlash from zero on
    """
    first, is_single = panels[0], len(panels) == 1
    columns = columns or (2 if len(panels) == 4 else min(len(panels), 3))
    width = max((SIZE[0] - _AROUND[0]) / columns, _NARROWEST)
    height = math.ceil(len(panels) / columns) * min(0.85 * width, _HIGHEST)
    size = SIZE if is_single else (_AROUND[0] + columns * width, _AROUND[1] + height)
    figure, axes = new_panels(len(panels), columns, size)
    shades = shades_of(panels) if first.shaded else None
    scale_panels(figure, axes, first.view.axes)
    if len(first.view.axes) == 1:
        axes[0].set_ylabel(first.value_label)
    for ax, name in zip(axes, names, strict=False):
        ax.set_title(name, loc="left", fontsize=9.0)
    if shades is not None:
        ticks = ticker.MaxNLocator(integer=True) if first.quantity.type == WHOLE else None
        figure.colorbar(shades, ax=axes, pad=0.02, aspect=28, label=first.value_label, ticks=ticks)
    for ax, layers in zip(axes, panels, strict=True):
        _paint(ax, layers, shades, linewidth=0.9 if is_single and shades is None else 0.6)
    lay_out(figure, axes[0], first.title, line or first.subtitle(first.view.fixed))
    notes = []
    for ax, layers in zip(axes, panels, strict=True):
        notes += _write_on_map(ax, layers, is_single=is_single)
    if is_single and not first.view.places and shades is None:
        _mark_thresholds(axes[0], first, thresholds)
    for ax in axes:
        notes += ax.get_legend_handles_labels()[0]
    regions, by_text = {*chain(*(each.names for each in panels))}, {str(note.get_label()): note for note in notes}
    ordered = sorted(by_text, key=lambda text: label_order(text) if text in regions else (math.inf, ""))
    add_notes(figure, [by_text[text] for text in ordered])
    return figure


def facet_map(results: AnyMap, facets: Sequence[str], quantity: str, x: str | None, y: str | None) -> Figure:
    """Figure with a map of a quantity for each value of one facet, or for each pair of values of two: rows, columns.

    Of many values, evenly spaced ones are drawn: at most 12 of one facet, and 4 of each of two.

    Raises PlotError where a facet is no axis of several values, or where not two axes are left for the maps.
    """
    facets = numbered(facets, results.tables)
    changing = {axis.parameter: axis for axis in drawn_axes(results)}
    if len(facets) > len(MOST_VALUES) or len(set(facets)) < len(facets) or not changing.keys() >= set(facets):
        raise PlotError(
            f"A facet is an axis of several values, or two are rows and columns; these are {', '.join(changing)}."
        )
    axes = [changing[facet] for facet in facets]
    values = [axis.few(MOST_VALUES[len(axes) - 1]) for axis in axes]
    places = list(product(*values))
    labels = np.unique(results.sequence[results.sequence >= 0])
    most = 0 if labels.size > MOST_LABELS else MOST_LABELS  # labels are grouped in all panels or in none
    parts = [results.at(dict(zip(facets, place, strict=True))) for place in places]
    panels = [Layers.of(part, View.of_plane(part, x, y), quantity, most, results) for part in parts]
    names = []
    for place in places:
        texts = (value_text(axis, value, symbol=True) for axis, value in zip(axes, place, strict=True))
        parted = (text.rpartition(" = ") for text in texts)  # only the symbol is set as TeX, not its value and unit
        names.append("\n".join(symbol_text(symbol) + plain(equals + value) for symbol, equals, value in parted))
    counts = [f"{axis.name}: {len(shown)} of {len(axis)} values" for axis, shown in zip(axes, values, strict=True)]
    line = replace(panels[0], caveats=(*counts, *results.caveats)).subtitle(fixed_parameters(results))
    return map_figure(panels, names, line, columns=len(values[1]) if len(values) > 1 else 0)


@styled()
def strip(layers: Layers) -> Figure:
    """Figure of the labels along one swept axis as a coloured strip, and below it the curve of a quantity.

    Of a tolerance map, the labels are the most likely ones.
    """
    layers = replace(layers, undecided=layers.undecided & False)  # a strip blurs no undecided cells
    samples, (edges, _) = layers.view.x.values, layers.bands
    figure = new_figure()
    band, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1.0, 4.6))
    pixels = np.rint(cell_colours(layers, None)[None]).astype(np.uint8)
    band.pcolormesh(cell_edges(layers.view.x), [0.0, 1.0], pixels, rasterized=True, zorder=1)
    for edge in edges[1:-1]:
        band.axvline(edge, color=INK, linewidth=0.9, zorder=2)
        ax.axvline(edge, color=FAINT_INK, linewidth=0.6, linestyle=DASHED, zorder=1)
    look = {"color": LINE_COLOURS[0], "markersize": min(3.0, 300.0 / samples.size), "clip_on": False, "zorder": 3}
    jumps, kind = np.diff(layers.codes) != 0, layers.quantity.type
    if kind == YES_NO and np.isin(layers.values[np.isfinite(layers.values)], (0.0, 1.0)).all():  # of single runs
        jumps |= np.diff(layers.values) != 0.0
        ax.set_yticks([0.0, 1.0], ["no", "yes"])
    elif kind == WHOLE:
        ax.yaxis.set_major_locator(ticker.MaxNLocator(integer=True))
    for cells in np.split(np.arange(samples.size), np.flatnonzero(jumps) + 1):
        ax.plot(samples[cells], layers.values[cells], "o-", **look)  # the quantity jumps between regimes
    scale_axis(ax, "x", layers.view.x)
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylabel(layers.value_label)
    ax.axhline(0.0, color=INK, linewidth=0.8, zorder=2)
    tidy(ax)
    band.set_yticks([])
    band.tick_params(bottom=False, labelbottom=False)
    lay_out(figure, band, layers.title, layers.subtitle(layers.view.fixed))
    add_notes(figure, _write_on_map(band, layers, is_single=True))
    return figure


def shades_of(panels: Sequence[Layers]) -> ScalarMappable:
    """Colour scale of a quantity's values in all panels.

    Colours of the margin diverge from zero, those of a probability, from 0 to 1, begin at white, and those of other
    quantities begin at zero, or at the least value if that is negative.
    """
    values = np.concatenate([layers.values.ravel() for layers in panels])
    low, high = min(np.nanmin(values), 0.0), np.nanmax(values)
    if panels[0].quantity.type == YES_NO:
        return ScalarMappable(colors.Normalize(0.0, 1.0), _PROBABLE)
    if panels[0].quantity.name == "margin":
        return ScalarMappable(colors.CenteredNorm(0.0, max(-low, abs(high)) or 1.0), "PuOr")
    return ScalarMappable(colors.Normalize(low, high if high > low else low + 1.0), "viridis")


def cell_colours(layers: Layers, shades: ScalarMappable | None) -> Floats:
    """(nx, ny, 3) colours of the cells, 0 to 255: of their values on the scale `shades`, or else of their regions."""
    if shades is None:
        return layers.colours_of(layers.codes) if layers.paint is None else layers.paint
    cells = shades.to_rgba(layers.values)[..., :3]
    cells[np.isnan(layers.values)] = colors.to_rgb(UNDEFINED)
    cells[layers.failed] = colors.to_rgb(FAILED_FILL)
    return 255.0 * cells


def _paint(ax: Axes, layers: Layers, shades: ScalarMappable | None, linewidth: float) -> None:
    """Fill the regions or the cells of a map with their colours, and draw its boundaries and marks of doubt.

    Runs of a sample are drawn as points instead.
    """
    if layers.view.places:
        colours = cell_colours(layers, shades) / 255.0
        count = len(colours)
        points: Look = {"edgecolors": INK, "linewidths": min(0.2, 40.0 / count), "rasterized": count > MOST_POINTS}
        across, upward = (*layers.view.places, layers.values)[:2]  # over one axis y is the quantity
        ax.scatter(across, upward, s=max(2.0, 40.0 - 0.1 * count), c=colours, **points)
        ax.margins(0.03)
        ax.autoscale()
        ax.grid(color="0.92", linewidth=0.6)
        ax.set_axisbelow(True)
        return
    if shades is None and layers.paint is None and layers.boundaries is not None:
        _fill_regions(ax, layers)
    else:
        pixels = np.rint(cell_colours(layers, shades).swapaxes(0, 1)).astype(np.uint8)
        ax.pcolormesh(*map(cell_edges, layers.view.axes), pixels, rasterized=True, zorder=0.5, gid="cells")
        ax.set(xlim=layers.view.x.values[[0, -1]], ylim=layers.view.y.values[[0, -1]])
    look: Look = {"colors": "white" if shades is not None and layers.has_light_lines else INK, "linewidths": linewidth}
    lines = LineCollection(layers.lines, joinstyle="round", capstyle="projecting", gid="boundaries", zorder=3, **look)
    ax.add_collection(lines, autolim=False)
    if len(layers.doubts):  # a haze under the lines, on every undecided cell and every unresolved place
        size = max(4.0, 250.0 / max(map(len, layers.view.axes)))  # pt: at least half a cell
        look = _DOUBT | {"markersize": size, "color": INK, "rasterized": len(layers.doubts) > MOST_POINTS}
        ax.plot(*layers.doubts.T, zorder=2, gid="undecided", **look)


def _fill_regions(ax: Axes, layers: Layers) -> None:
    """Fill the traced regions, each with a thin edge that closes the seam between two neighbours."""
    parts: dict[int, list[Path]] = {}
    for region, rings in layers.outlines:
        parts.setdefault(region, []).extend(Path(ring, closed=True) for ring in rings)
    for region, paths in parts.items():  # -1, the region of failed cells, picks the last name and colour
        name, colour = (*layers.names, FAILED)[region], (*layers.colours, FAILED_FILL)[region]
        look = {"color": colour, "linewidth": 0.3, "zorder": 1, "gid": f"region {name}"}
        ax.add_artist(PathPatch(Path.make_compound_path(*paths), **look))


def _write_on_map(ax: Axes, layers: Layers, *, is_single: bool) -> list[Artist]:
    """Draw the measured points with their labels, write the regions' names, and return the notes under the figure.

    Regions whose names have no room on the map are named in the notes.
    """
    unnamed: Sequence[str] = layers.names if layers.view.places and not layers.shaded else ()
    is_crowded = False
    if not layers.shaded and not layers.view.places:
        raster, (sizes, size) = Raster.of(ax, layers), _SIZES[is_single]
        for agrees, (gid, marker) in _POINT_LOOKS.items():
            places = [(point.x, point.y) for point in layers.points if point.agrees == agrees]
            if layers.points:
                label = f"measured, {gid}"
                label += f": {len(places)} of {len(layers.points)}" if is_single and agrees else ""
                look: Look = marker | {"linestyle": "none", "markeredgecolor": "white", "clip_on": False, "zorder": 6}
                look["in_layout"] = False  # without points, the layout would place it at the figure's corner
                ax.plot(*np.reshape(places, (-1, 2)).T, gid=gid, label=label, **look)
        is_crowded = write_beside(raster, layers.points, size, 0.5 * _POINT + 1.5)
        unnamed = write_names(raster, layers.names, sizes)
    notes = layers.legend(unnamed, is_counted=is_single)
    notes += [Note("a point without a label: no room", "")] * is_crowded
    return [swatch(*note) if note.colour else swatch(note.text, "none", edgecolor="none") for note in notes]


def _mark_thresholds(ax: Axes, layers: Layers, thresholds: Sequence[float]) -> None:
    """Mark on the x axis where the number of impacts for vanishing backlash changes, with the values in a note.

    Nothing is marked unless y is the backlash and begins near zero.
    """
    low, high = ax.get_xlim()
    bottom, top = ax.get_ylim()
    inside = sorted(value for value in thresholds if low <= value <= high)
    if inside and layers.view.y.parameter == "lash.backlash_deg" and bottom <= _VANISHING * top:
        values = ", ".join(f"{value:.3g}" for value in inside).replace("-", MINUS)
        look: Look = {"linestyle": "none", "marker": "^", "color": INK, "markersize": 5.5, "clip_on": False}
        look |= {"label": f"vanishing backlash: {values}", "transform": ax.get_xaxis_transform(), "zorder": 6}
        ax.plot(inside, [0.0] * len(inside), **look)
