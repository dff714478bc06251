"""The figure of the map: its image, boundaries and names, and marks of the cells that runs are shown of."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import Any

import numpy as np
from bokeh.models import ColorBar, DataRange1d, Div, LinearColorMapper, Model, Range1d
from bokeh.plotting import figure
from matplotlib.colors import to_hex

from clunk.explorer.message import Changes, columns, source
from clunk.plot.labelling import roomiest
from clunk.plot.layers import Layers
from clunk.plot.maps import cell_colours, shades_of
from clunk.plot.plane import Codes, cells_of, ruler, value_text
from clunk.plot.style import FAILED_FILL, INK, LINE_COLOURS, bare, capital
from clunk.results.maps import AnyMap
from clunk.results.quantities import YES_NO
from clunk.study.arrays import Floats
from clunk.study.axes import ResultAxis

RUN_COLOURS = (INK, *LINE_COLOURS[:2])  # of the run that is shown, and of those that are pinned
_PIXELS = 640  # of an image, across and upward
_SKIP = 4  # of the image, between the pixels among which names are placed
_WIDTH, _HEIGHT = 2, 5  # of these pixels, that a character of a name takes
_SHADES = 256
_LISTED = 16  # labels below the map, and edges of a strip's bands

Cell = tuple[float, ...]  # values of the map's axes


class MapFigure:
    """A map over two axes, or a curve over one on bands of the labels' colours; one picture takes another's place.

    models : what a picture changes, by name
    """

    def __init__(self, axes: Sequence[ResultAxis]) -> None:
        self._axes = axes
        is_map = len(axes) > 1
        self.figure = plot = figure(
            name="map",
            x_axis_type="log" if axes[0].is_geometric else "linear",
            y_axis_type="log" if is_map and axes[1].is_geometric else "linear",
            x_range=_range(axes[0]),
            y_range=_range(axes[1]) if is_map else DataRange1d(),
            x_axis_label=_title(axes[0]),
            y_axis_label=_title(axes[1]) if is_map else "",
            tools="pan,wheel_zoom,box_zoom,reset,save",
            sizing_mode="stretch_both",
            min_height=240,
            margin=0,
        )
        plot.toolbar.logo = None
        plot.grid.visible = False
        # of one height, or the map would be drawn anew with every text
        look = {"line-height": "20px", "flex": "none", "overflow-y": "auto"}
        self.legend = Div(name="legend", height=62, styles=look, sizing_mode="stretch_width", margin=(2, 6, 2, 6))
        columns_of = {"image": "image x y dw dh", "bands": "x0 x1 colour", "lines": "x y", "points": "x y"}
        sources = {name: source(names) for name, names in (columns_of | {"names": "text x y"}).items()}
        self._marks = source("x y colour")
        self._pointed = source("x y text align offset")
        shades = LinearColorMapper(palette=["#000000", "#ffffff"], low=0.0, high=1.0)
        bar = ColorBar(color_mapper=shades, width=10, visible=False)
        plot.add_layout(bar, "right")
        self.models: dict[str, Model] = {**sources, "shades": shades, "bar": bar, "y axis": plot.yaxis[0]}
        self.models["legend"] = self.legend
        ring = {"source": self._marks, "level": "overlay"}  # drawn without the rest
        text = {"text_baseline": "middle", "text_font_size": "14px", "text_color": INK}
        if is_map:
            plot.image_rgba("image", "x", "y", "dw", "dh", source=sources["image"])
            self.models["boundaries"] = plot.line("x", "y", source=sources["lines"], color=INK, line_width=0.9).glyph
            plot.scatter("x", "y", source=sources["points"], size=2.5, color=INK)
            plot.text("x", "y", "text", source=sources["names"], text_align="center", **text)
            for width, colour in ((6.0, "white"), (2.5, "colour")):
                plot.scatter("x", "y", size=13, fill_alpha=0.0, line_width=width, line_color=colour, **ring)
        else:
            plot.vstrip(
                "x0",
                "x1",
                source=sources["bands"],
                fill_color="colour",
                line_color=INK,
                line_width=0.9,
                level="underlay",
            )
            plot.line("x", "y", source=sources["points"], color=INK, line_width=1.5)
            plot.vspan("x", line_width=2.5, line_color="colour", **ring)
        beside: dict[str, Any] = {"text_align": "align", "x_offset": "offset", "background_fill_color": "white"}
        beside |= {"background_fill_alpha": 0.85, "padding": 3, "level": "overlay", "name": "pointed"}
        plot.text("x", "y", "text", source=self._pointed, **beside, **text)

    def changes(self, part: AnyMap, quantity: str) -> Changes:
        """Changes of the models to a picture of a quantity of one lash's map.

        Raises PlotError where the quantity has no value at all.
        """
        layers = Layers.of(part, len(self._axes), quantity)
        if len(self._axes) > 1:
            return self._map_changes(layers)
        regimes = Layers.of(part, 1)
        edges, codes = regimes.bands
        inner = [f"{edge:.4g}" for edge in edges[1:-1].tolist()]
        notes = [f"label changes: {', '.join(inner)}"] if 0 < len(inner) <= _LISTED else []
        colours = [(*regimes.colours, FAILED_FILL)[code] for code in codes]
        return {
            "bands": {"data": {"x0": edges[:-1], "x1": edges[1:], "colour": colours}},
            "points": {"data": {"x": layers.view.x.values, "y": layers.values}},
            "y axis": {"axis_label": layers.value_label},
            "legend": {"text": _legend(regimes, [*notes, *self._peak(layers)])},
        }

    def _map_changes(self, layers: Layers) -> Changes:
        x, y = (_pixel_centres(axis) for axis in layers.view.axes)
        regions = layers.codes_at(x, y)
        shades = shades_of([layers]) if layers.shaded else None
        pixels = np.full((*regions.shape, 4), 255, np.uint8)
        if shades is None and layers.paint is None:
            table = [list(bytes.fromhex(each[1:])) for each in (*layers.colours, FAILED_FILL)]
            pixels[..., :3] = np.array(table, np.uint8)[regions]
        else:
            cells = np.ix_(*(cells_of(axis, at) for axis, at in zip(layers.view.axes, (x, y), strict=True)))
            pixels[..., :3] = np.rint(cell_colours(layers, shades)[cells].swapaxes(0, 1))
        (left, width), (low, height) = ((axis.values.min(), np.ptp(axis.values)) for axis in self._axes)
        image = {"image": [pixels.view(np.uint32)[..., 0]], "x": [left], "y": [low], "dw": [width], "dh": [height]}
        # one line with gaps: each of a hundred lines would be two buffers of the message
        gap = np.full((1, 2), np.nan)
        line = np.concatenate([part for each in layers.lines for part in (each, gap)] or [gap])
        is_light = layers.shaded and layers.has_light_lines
        changes: Changes = {
            "image": {"data": image},
            "lines": {"data": {"x": line[:, 0], "y": line[:, 1]}},
            "points": {"data": {"x": layers.doubts[:, 0], "y": layers.doubts[:, 1]}},
            "names": columns("text x y", [] if layers.shaded else _names(regions, layers, x, y)),
            "boundaries": {"line_color": "white" if is_light else INK},
            "bar": {"visible": layers.shaded, "title": layers.value_label},
            "legend": {"text": _legend(layers, self._peak(layers))},
        }
        if shades is not None:
            (bottom, top), colours = shades.get_clim(), shades.get_cmap()(np.linspace(0.0, 1.0, _SHADES))
            changes["shades"] = {"palette": [to_hex(each) for each in colours], "low": bottom, "high": top}
        return changes

    def _peak(self, layers: Layers) -> list[str]:
        """A note on the largest value of a quantity, with its cell."""
        if layers.values is None or (layers.quantity.type == YES_NO and not layers.shaded):
            return []
        at = np.unravel_index(int(np.nanargmax(layers.values)), layers.values.shape)
        axes = zip(self._axes, layers.view.axes, at, strict=True)
        place = [value_text(axis, ascending.values[k], symbol=True) for axis, ascending, k in axes]
        return [f"largest: {layers.values[at]:.6g} at {', '.join(place)}"]

    def mark(self, marks: Sequence[tuple[Cell, str]]) -> None:
        """Mark cells with colours, the last on top."""
        x, y = ([cell[min(k, len(cell) - 1)] for cell, _ in marks] for k in (0, 1))
        self._marks.data = {"x": x, "y": y, "colour": [colour for _, colour in marks]}

    def label(self, text: str, x: float, y: float) -> None:
        """Write a text beside the pointer, on the side that has more room; an empty one takes it away."""
        to, _ = ruler(self._axes[0])
        is_right = to(x) > np.mean(to(self._axes[0].values)) if text else False
        shown = (x, y, text, "right", -14) if is_right else (x, y, text, "left", 14)
        self._pointed.data = columns("x y text align offset", [shown] if text else [])["data"]

    def nearest(self, x: float, y: float = 0.0) -> Cell | None:
        """Values of the axes in the cell at a point; None beyond the map."""
        cell = []
        for axis, value in zip(self._axes, (x, y), strict=False):
            if not axis.values.min() <= value <= axis.values.max():
                return None
            to, _ = ruler(axis)
            cell.append(float(axis.values[np.argmin(np.abs(to(axis.values) - to(value)))]))
        return tuple(cell)


def title_of(name: str, symbol: str, unit: str) -> str:
    """A quantity with its short symbol and its unit."""
    return " ".join(part for part in (name, bare(symbol), f"[{unit}]" if unit not in ("", "1") else "") if part)


def _title(axis: ResultAxis) -> str:
    return title_of(capital(axis.name or axis.parameter), axis.symbol, axis.unit)


def _legend(layers: Layers, notes: Sequence[str]) -> str:
    """Regions that are large enough to be seen, with their colours and shares of the map, and notes."""
    square = '<span style="background: {}; border: 1px solid #1c2126">&emsp;</span>&nbsp;{}'
    entries = [
        f'<span style="white-space: nowrap">{square.format(note.colour, escape(note.text))}</span>'
        if note.colour
        else escape(note.text)
        for note in layers.legend(layers.seen)
    ]
    if len(entries) > _LISTED:
        entries[_LISTED:] = [f"and {len(entries) - _LISTED} more"]
    return " &nbsp; ".join([*entries, *map(escape, notes)])


def _names(regions: Codes, layers: Layers, x: Floats, y: Floats) -> list[tuple[str, float, float]]:
    """Names in the roomiest part of their largest region, where they have room, and where that is."""
    regions, x, y = regions[::_SKIP, ::_SKIP], x[::_SKIP], y[::_SKIP]
    names = []
    for name in layers.seen:
        centre = roomiest(regions == layers.names.index(name), _WIDTH * (len(name) + 1), _HEIGHT)
        if centre is not None:
            names.append((name, float(x[int(centre[0])]), float(y[int(centre[1])])))
    return names


def _pixel_centres(axis: ResultAxis) -> Floats:
    """Centres of an image's pixels along an ascending axis, in its unit."""
    to, back = ruler(axis)
    edges = np.linspace(to(axis.values[0]), to(axis.values[-1]), _PIXELS + 1)
    return np.asarray(back(0.5 * (edges[1:] + edges[:-1])), np.float64)


def _range(axis: ResultAxis) -> Range1d:
    low, high = float(axis.values.min()), float(axis.values.max())
    return Range1d(low, high, bounds=(low, high))
