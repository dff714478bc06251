"""The figure of the map: its image, boundaries and labels, and marks of the cells that runs are shown of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import ColorBar, DataRange1d, LinearColorMapper, Model, Range1d
from bokeh.plotting import figure

from clunk.explorer.message import Changes, source
from clunk.explorer.pictures import Picture
from clunk.plot.plane import ruler
from clunk.plot.style import INK, LINE_COLOURS
from clunk.study.axes import ResultAxis

RUN_COLOURS = (INK, *LINE_COLOURS[:2])  # of the run that is shown, and of those that are pinned

Mark = tuple[float, float, str]  # x, y and colour


def axis_title(axis: ResultAxis) -> str:
    """Name, symbol and unit of an axis as plain text."""
    name = axis.name or axis.parameter
    unit = "" if axis.unit in ("", "1") else f"[{axis.unit}]"
    return " ".join(part for part in (name[:1].upper() + name[1:], axis.symbol, unit) if part)


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
            x_axis_label=axis_title(axes[0]),
            y_axis_label=axis_title(axes[1]) if is_map else "",
            tools="pan,wheel_zoom,box_zoom,reset",
            sizing_mode="stretch_both",
            min_height=240,
            margin=0,
        )
        plot.toolbar.logo = None
        plot.grid.visible = False
        image, bands = source("image", "x", "y", "dw", "dh"), source("x0", "x1", "colour")
        lines, points, texts = source("x", "y"), source("x", "y"), source("x", "y", "text")
        self._marks, self._curve = source("x", "y", "colour"), np.zeros((0, 2))
        self._pointed = source("x", "y", "text", "align", "offset")
        shades = LinearColorMapper(palette=["#000000", "#ffffff"], low=0.0, high=1.0)
        bar = ColorBar(color_mapper=shades, width=10, visible=False)
        plot.add_layout(bar, "right")
        self.models: dict[str, Model] = {"image": image, "bands": bands, "lines": lines, "points": points}
        self.models |= {"texts": texts, "shades": shades, "bar": bar, "y axis": plot.yaxis[0]}
        text = {"text_align": "center", "text_baseline": "middle", "text_font_size": "14px", "text_color": INK}
        if is_map:
            plot.image_rgba("image", "x", "y", "dw", "dh", source=image)
            self.models["boundaries"] = plot.line("x", "y", source=lines, color=INK, line_width=0.9).glyph
            plot.scatter("x", "y", source=points, size=2.5, color=INK)
            plot.text("x", "y", "text", source=texts, **text)
        else:
            plot.vstrip("x0", "x1", source=bands, fill_color="colour", line_color=INK, line_width=0.9, level="underlay")
            plot.line("x", "y", source=points, color=INK, line_width=1.5)
        ring = {"source": self._marks, "size": 13, "fill_alpha": 0.0, "level": "overlay"}  # drawn without the rest
        for width, colour in ((6.0, "white"), (2.5, "colour")):
            plot.scatter("x", "y", line_width=width, line_color=colour, **ring)
        beside = {"text_align": "align", "x_offset": "offset", "text_baseline": "middle", "text_font_size": "13px"}
        ground: dict[str, Any] = {"background_fill_color": "white", "background_fill_alpha": 0.85, "padding": 3}
        plot.text("x", "y", "text", source=self._pointed, level="overlay", name="pointed", **beside, **ground)

    def changes(self, picture: Picture, name: str) -> Changes:
        """Changes of the models to a picture of a quantity of this name."""
        if len(self._axes) > 1:
            return self._map_changes(picture)
        self._curve = picture.curve
        return {
            "bands": {"data": {"x0": picture.edges[:-1], "x1": picture.edges[1:], "colour": picture.bands}},
            "points": {"data": {"x": self._curve[:, 0], "y": self._curve[:, 1]}},
            "y axis": {"axis_label": name},
        }

    def _map_changes(self, picture: Picture) -> Changes:
        (x, width), (y, height) = ((axis.values.min(), np.ptp(axis.values)) for axis in self._axes)
        # one line with gaps: each of a hundred lines would be two buffers of the message
        gap = np.full((1, 2), np.nan)
        line = np.concatenate([part for each in picture.lines for part in (each, gap)] or [gap])
        shades, names = picture.shades, ("text", "x", "y")
        texts = zip(*picture.texts, strict=True) if picture.texts else ((), (), ())
        changes: dict[str, dict[str, Any]] = {
            "image": {"data": {"image": [picture.pixels], "x": [x], "y": [y], "dw": [width], "dh": [height]}},
            "lines": {"data": {"x": line[:, 0], "y": line[:, 1]}},
            "points": {"data": {"x": picture.dots[:, 0], "y": picture.dots[:, 1]}},
            "texts": {"data": {name: list(column) for name, column in zip(names, texts, strict=True)}},
            "boundaries": {"line_color": INK if shades is None or shades.has_dark_lines else "white"},
            "bar": {"visible": False} if shades is None else {"visible": True, "title": shades.label},
        }
        if shades is not None:
            changes["shades"] = {"palette": shades.colours, "low": shades.low, "high": shades.high}
        return changes

    def mark(self, marks: Sequence[Mark]) -> None:
        """Put rings around cells, the last on top; over one axis, where the curve is."""
        if len(self._axes) == 1:
            x, y = self._curve.T
            marks = [(at, float(y[np.argmin(np.abs(x - at))]) if x.size else 0.0, colour) for at, _, colour in marks]
        columns = zip(*marks, strict=True) if marks else ((), (), ())
        self._marks.data = {name: list(each) for name, each in zip(("x", "y", "colour"), columns, strict=True)}

    def label(self, text: str, x: float, y: float) -> None:
        """Write a text beside the pointer, on the side that has more room; an empty one takes it away."""
        axis = self._axes[0]
        to, _ = ruler(axis)
        is_right = to(x) > 0.5 * (to(axis.values.min()) + to(axis.values.max())) if text else False
        align, offset = ("right", -14) if is_right else ("left", 14)
        shown = {"x": [x], "y": [y], "text": [text], "align": [align], "offset": [offset]}
        self._pointed.data = shown if text else {name: [] for name in shown}

    def nearest(self, x: float, y: float = 0.0) -> tuple[float, ...] | None:
        """Values of the axes in the cell at a point; None beyond the map."""
        point = (x, y)[: len(self._axes)]
        at = []
        for axis, value in zip(self._axes, point, strict=True):
            low, high = float(axis.values.min()), float(axis.values.max())
            if not low <= value <= high:
                return None
            to, _ = ruler(axis)
            at.append(float(axis.values[int(np.argmin(np.abs(to(axis.values) - to(value))))]))
        return tuple(at)


def _range(axis: ResultAxis) -> Range1d:
    low, high = float(axis.values.min()), float(axis.values.max())
    if low == high:
        half = 0.5 * (abs(low) or 1.0)
        low, high = low - half, high + half
    return Range1d(low, high, bounds=(low, high))
