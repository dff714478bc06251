"""Figures of the page, drawn with Bokeh: the map, on which the cells of the shown runs are marked, and these runs."""

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

import numpy as np
from bokeh.events import Reset
from bokeh.models import (
    BoxAnnotation,
    ColorBar,
    ColumnDataSource,
    CustomJS,
    Div,
    LinearColorMapper,
    Model,
    Range1d,
    Span,
    Whisker,
)
from bokeh.plotting import figure
from matplotlib.colors import to_hex

from clunk.plot.histories import flank_names, measured_impacts, outcome
from clunk.plot.labelling import roomiest
from clunk.plot.layers import Layers
from clunk.plot.maps import cell_colours, shades_of
from clunk.plot.plane import View, cells_of, ruler, value_text
from clunk.plot.style import FAILED_FILL, FAINT_INK, INK, LINE_COLOURS, Look, bare
from clunk.results.maps import AnyMap
from clunk.results.quantities import YES_NO
from clunk.simulation.history import History
from clunk.study.arrays import Floats, LabelCodes
from clunk.study.axes import ResultAxis
from clunk.study.errors import ClunkError
from clunk.study.records import capital, html_table, with_unit
from clunk.study.tables import Quantity

RUN_COLOURS = (INK, *LINE_COLOURS[:2])  # of the selected run, and of the pinned ones
_PIXELS = 640  # pixels of the map's image, across and upward
_SKIP = 4  # names are placed in a coarser raster, of every fourth pixel of the image
_WIDTH, _HEIGHT = 2, 5  # size of a character of a name, in pixels of that coarser raster
_SHADES = 256  # colours of a colour bar
_CLOSEST = 1e-9  # narrowest range to which a figure zooms: a share of an axis, or s
_ABOVE = 0.05  # margin above a curve, and below it, as a share of its height
_COLUMNS = 800  # spans of time into which a curve is thinned, about as many as a screen tells apart
WIDE: Look = {"sizing_mode": "stretch_width", "margin": (2, 6, 2, 6)}
_TEXT = {"text_font_size": "11px"}

Cell = tuple[float, ...]  # a cell of the map, by its values of the map's axes
Changes = dict[str, Mapping[str, Any]]  # name of a model -> property -> new value

# Applies changes in the browser. The server, which sends the changes, need not hear of them again: hence sync: false.
_CHANGE = "for (const [name, [values]] of Object.entries(cb_obj.data)) models[name].setv(values, {sync: false});"


class Message:
    """A channel on which changes of several models reach the browser in one message, so that it draws once for all.

    The server's own copies of the models do not get these changes.

    models : by the names that `Changes` use
    source : data source that carries the changes; it has to be in the document
    """

    def __init__(self, models: Mapping[str, Model]) -> None:
        self.source = ColumnDataSource()
        self.source.js_on_change("data", CustomJS(args={"models": models}, code=_CHANGE))

    def send(self, changes: Changes) -> None:
        """Change properties of the models in the browser."""
        self.source.data = {name: [properties] for name, properties in changes.items()}


def _columns(names: str, rows: Sequence[tuple[Any, ...]]) -> Mapping[str, Any]:
    """Properties that give a data source these rows; names : of its columns, separated by blanks."""
    return {"data": {name: [row[k] for row in rows] for k, name in enumerate(names.split())}}


def _source(names: str) -> ColumnDataSource:
    return ColumnDataSource(**_columns(names, []))


class MapFigure:
    """Figure of a map over two axes, or of a curve over one axis on bands in the labels' colours.

    Each picture, of another quantity, lash or map, takes the place of the one before.

    models : the Bokeh models that a picture changes, by name
    """

    def __init__(self, axes: Sequence[ResultAxis]) -> None:
        self._axes = axes
        look: Look = {}
        for which, axis in zip("xy", axes, strict=False):
            look[f"{which}_axis_label"] = capital(title_of(axis))
            look[f"{which}_axis_type"] = "log" if axis.is_geometric else "linear"
            low, high = axis.ends
            least = _CLOSEST * (low if axis.is_geometric else high - low)
            look[f"{which}_range"] = Range1d(low, high, bounds=(low, high), min_interval=least)
        if len(axes) == 1:
            look["y_range"] = Range1d(0.0, 1.0)
        look |= {"tools": "pan,wheel_zoom,box_zoom,reset,save", "min_height": 240, "margin": 0}
        self.figure = plot = figure(name="map", sizing_mode="stretch_both", **look)
        plot.toolbar.logo = None
        plot.grid.visible = False
        # of fixed height: otherwise each new text would resize the map, which would be drawn again
        styles = {"line-height": "20px", "flex": "none", "overflow-y": "auto"}
        self.legend = Div(name="legend", height=62, styles=styles, **WIDE)
        columns = {
            "image": "image x y dw dh",
            "bands": "x0 x1 colour",
            "lines": "x y",
            "points": "x y",
            "names": "text x y",
        }
        sources = {name: _source(names) for name, names in columns.items()}
        self._marks, self._pointed = _source("x y colour"), _source("x y text align offset")
        shades = LinearColorMapper(palette=["#000000", "#ffffff"], low=0.0, high=1.0)
        bar = ColorBar(color_mapper=shades, width=10, visible=False)
        plot.add_layout(bar, "right")
        self.models = {**sources, "shades": shades, "bar": bar, "y axis": plot.yaxis[0]}
        self.models |= {"legend": self.legend, "y range": plot.y_range}
        ring = {"source": self._marks, "level": "overlay", "line_color": "colour", "line_width": 2.5}
        text = {"text_baseline": "middle", "text_font_size": "14px", "text_color": INK}
        if len(axes) > 1:
            plot.image_rgba("image", "x", "y", "dw", "dh", source=sources["image"])
            self.models["boundaries"] = plot.line("x", "y", source=sources["lines"], color=INK, line_width=0.9).glyph
            plot.scatter("x", "y", source=sources["points"], size=8, color=INK, alpha=0.1, line_color=None)
            plot.text("x", "y", "text", source=sources["names"], text_align="center", **text)
            for border in ({"line_width": 6.0, "line_color": "white"}, {}):
                plot.scatter("x", "y", size=13, fill_alpha=0.0, **ring | border)
        else:
            band = {"fill_color": "colour", "line_color": INK, "line_width": 0.9, "level": "underlay"}
            plot.vstrip("x0", "x1", source=sources["bands"], **band)
            plot.line("x", "y", source=sources["points"], color=INK, line_width=1.5)
            plot.vspan("x", **ring)
        beside: Look = {"text_align": "align", "x_offset": "offset", "background_fill_color": "white"}
        beside |= {"background_fill_alpha": 0.85, "padding": 3, "level": "overlay", "name": "pointed"}
        plot.text("x", "y", "text", source=self._pointed, **beside, **text)

    def changes(self, part: AnyMap, quantity: str) -> Changes:
        """Changes of the models that make the picture of a quantity; part : the map of one lash.

        Raises PlotError where the quantity has no value in any cell.
        """
        layers = Layers.of(part, View.of_grid(part), quantity)
        if len(self._axes) > 1:
            return self._map_changes(layers)
        edges, codes = layers.bands
        known = layers.values[np.isfinite(layers.values)]
        low, high = (known.min(), known.max()) if known.size else (0.0, 1.0)
        around = _ABOVE * (high - low) or 1.0
        colours = [(*layers.colours, FAILED_FILL)[code] for code in codes]
        return {
            "bands": {"data": {"x0": edges[:-1], "x1": edges[1:], "colour": colours}},
            "points": {"data": {"x": layers.view.x.values, "y": layers.values}},
            "y axis": {"axis_label": layers.value_label},
            "y range": dict.fromkeys(("start", "reset_start"), low - around)
            | dict.fromkeys(("end", "reset_end"), high + around),
            "legend": {"text": _legend(layers)},
        }

    def _map_changes(self, layers: Layers) -> Changes:
        x, y = map(_pixel_centres, layers.view.axes, self._axes)
        regions = layers.codes_at(x, y)
        shades = shades_of([layers]) if layers.shaded else None
        pixels = np.full((*regions.shape, 4), 255, np.uint8)
        if shades is None and layers.paint is None:
            pixels[..., :3] = layers.colours_of(regions)
        else:
            cells = np.ix_(*map(cells_of, layers.view.axes, (x, y)))
            pixels[..., :3] = np.rint(cell_colours(layers, shades)[cells].swapaxes(0, 1))
        (left, width), (low, height) = ((axis.values[0], np.ptp(axis.values)) for axis in layers.view.axes)
        # all boundaries are one line with gaps: as separate lines, each would add two buffers to the message
        gap = np.full((1, 2), np.nan)
        line = np.concatenate([part for each in layers.lines for part in (each, gap)] or [gap])
        names = [] if layers.shaded else _names(regions, layers, x, y)
        changes = {
            "image": _columns("image x y dw dh", [(pixels.view(np.uint32)[..., 0], left, low, width, height)]),
            "lines": {"data": {"x": line[:, 0], "y": line[:, 1]}},
            "points": {"data": {"x": layers.doubts[:, 0], "y": layers.doubts[:, 1]}},
            "names": _columns("text x y", names),
            "boundaries": {"line_color": "white" if layers.shaded and layers.has_light_lines else INK},
            "bar": {"visible": layers.shaded, "title": layers.value_label},
            "legend": {"text": _legend(layers)},
        }
        if shades is not None:
            (bottom, top), colours = shades.get_clim(), shades.get_cmap()(np.linspace(0.0, 1.0, _SHADES))
            changes["shades"] = {"palette": [to_hex(each) for each in colours], "low": bottom, "high": top}
        return changes

    def mark(self, marks: Sequence[tuple[Cell, str]]) -> None:
        """Mark cells, each with its colour; where marks overlap, the last is on top."""
        self._marks.update(**_columns("x y colour", [(cell[0], cell[-1], colour) for cell, colour in marks]))

    def label(self, text: str, x: float, y: float) -> None:
        """Write a text beside the pointer, on the side that has more room; an empty text removes it.

        x, y : of the pointer, in the axes' units
        """
        to, _ = ruler(self._axes[0])
        is_right = to(x) > to(self._axes[0].values).mean() if text else False
        shown = (x, y, text, "right", -14) if is_right else (x, y, text, "left", 14)
        self._pointed.update(**_columns("x y text align offset", [shown] if text else []))

    def nearest(self, x: float, y: float = 0.0) -> Cell | None:
        """The cell at a point, in the axes' units; None beyond the map."""
        try:
            return tuple(float(axis.values[axis.nearest(at)]) for axis, at in zip(self._axes, (x, y), strict=False))
        except ClunkError:
            return None


def title_of(of: ResultAxis | Quantity) -> str:
    """Title of an axis or a quantity: its name, short symbol and unit."""
    return with_unit(f"{of.name} {bare(of.symbol)}".rstrip(), of.unit)


def _legend(layers: Layers) -> str:
    """HTML of a map's legend: the visible regions with colours and shares of the map, notes, and the largest value."""
    square = '<span style="background: {}; border: 1px solid #1c2126">&emsp;</span>&nbsp;'
    entries = []
    for note in layers.legend(layers.seen):
        colour = square.format(note.colour) if note.colour else ""
        entries.append(f'<span style="white-space: nowrap">{colour}{escape(note.text)}</span>')
    if np.isfinite(layers.values).any() and (layers.quantity.type != YES_NO or layers.shaded):
        at = np.unravel_index(np.nanargmax(layers.values), layers.values.shape)
        place = (value_text(axis, axis.values[k], symbol=True) for axis, k in zip(layers.view.axes, at, strict=True))
        entries.append(escape(f"largest: {layers.values[at]:.6g} at {', '.join(place)}"))
    return " &nbsp; ".join(entries)


def _names(regions: LabelCodes, layers: Layers, x: Floats, y: Floats) -> list[tuple[str, float, float]]:
    """Name, x and y, in the axes' units, of each visible region: the roomiest place for its name, if there is any.

    regions : (y, x) regions of the image's pixels
    x, y : centres of these pixels
    """
    regions, x, y = regions[::_SKIP, ::_SKIP], x[::_SKIP], y[::_SKIP]
    names = []
    for name in layers.seen:
        centre = roomiest(regions == layers.names.index(name), _WIDTH * (len(name) + 1), _HEIGHT)
        if centre is not None:
            names.append((name, x[int(centre[0])], y[int(centre[1])]))
    return names


def _pixel_centres(axis: ResultAxis, whole: ResultAxis) -> Floats:
    """Centres of an image's pixels along an ascending axis, in its unit.

    whole : axis of the figure, whose scale, linear or logarithmic, they are evenly spaced on; a coarse axis with few
        values may not show it
    """
    to, back = ruler(whole)
    edges = np.linspace(to(axis.values[0]), to(axis.values[-1]), _PIXELS + 1)
    return back(0.5 * (edges[1:] + edges[:-1]))


class Shown(NamedTuple):
    """A run on the page, with the values and numbers from which it can be made again."""

    cell: Cell
    values: dict[str, float]  # value of every axis, by parameter
    numbers: dict[str, float]  # other numbers than the config's, by key
    history: History
    place: str  # the values of the swept keys and the numbers, as text


class _Panel(NamedTuple):
    name: str
    label: str
    values: Callable[[History], Floats]
    share: float  # height of the panel, relative to the other panels'
    padding: float = 0.25  # margins above and below the curves together, as a share of the curves' height


_PANELS = (
    _Panel("torque", "load [N m]", lambda run: run.torque, 0.9),
    _Panel("lash", "lash x_b [mm]", lambda run: 1e3 * run.backlash_coordinate, 1.4),
    _Panel("acceleration", "θ'' [rad/s²]", lambda run: run.acceleration[:, run.watched - 1], 1.4, 0.6),
    _Panel("contact", "contact [N m]", lambda run: run.contact_torque, 1.6),
)


class RunFigures:
    """Panels, header and event table of the selected run; the curves of pinned runs are drawn in the same panels.

    Curves are thinned anew for each span of time to which the user zooms.

    load_step : time of the load step  [s]
    models : other models of the page that `message` can change, by name
    header, compared : texts above the figures, on the selected run and on the pinned ones
    events : table below the figures, of the selected run
    figures : the panels, by name
    message : channel for changes of these figures and texts and of `models`
    """

    def __init__(self, load_step: float, models: Mapping[str, Model]) -> None:
        self._load_step = load_step
        self.header = Div(name="header", height=62, styles={"overflow": "hidden", "flex": "none"}, **WIDE)
        self.compared = Div(name="compared", styles={"flex": "none"}, **WIDE)
        self.events = Div(name="events", styles={"overflow-y": "auto", "font-size": "12px"}, **WIDE)
        self.events.update(sizing_mode="stretch_both", min_height=80, max_height=170)
        self._runs: Sequence[History] = []
        self._time = Range1d(0.0, 1.0, min_interval=_CLOSEST)
        self._whole = self._span = (0.0, 1.0)  # s: first and last time of all runs, and of the time axis as zoomed
        # one source has the curves of all runs in all panels
        self._curves = _source(" ".join(["colour", *(f"{panel.name}_{axis}" for panel in _PANELS for axis in "xy")]))
        self.figures = {panel.name: self._figure(panel) for panel in _PANELS}
        lash, acceleration = self.figures["lash"], self.figures["acceleration"]
        gap = BoxAnnotation(fill_color="#e4e4e4", fill_alpha=1.0, level="underlay", line_color=None)
        lash.add_layout(gap)
        flanks, touches, arrows = map(_source, (_FLANKS, _TOUCHES, _ARROWS))
        lash.text("x", "y", "text", source=flanks, text_baseline="baseline", text_color=FAINT_INK, x_offset=4, **_TEXT)
        look = {"line_color": "colour", "fill_color": "fill", "size": "size", "angle": "angle"}
        lash.scatter("x", "y", source=touches, marker="triangle", **look)
        acceleration.add_layout(Whisker(base="x", lower="low", upper="high", source=arrows, line_color=INK))
        above = {"text_align": "center", "text_baseline": "bottom", "y_offset": -2}
        acceleration.text("x", "high", "text", source=arrows, **above, **_TEXT)
        for name in ("start", "end"):
            self._time.on_change(name, self._on_zoom)
        own = {"time": self._time, "gap": gap, "curves": self._curves, "flanks": flanks, "touches": touches}
        own |= {"arrows": arrows, "header": self.header, "compared": self.compared, "events": self.events}
        own |= {name: each.y_range for name, each in self.figures.items()}
        self.message = Message({**models, **own})

    def _figure(self, panel: _Panel) -> Any:
        plot = figure(
            name=panel.name,
            x_range=self._time,
            y_range=Range1d(0.0, 1.0),
            y_axis_label=panel.label,
            lod_threshold=None,
            tools="xpan,xwheel_zoom,xbox_zoom,reset",
            active_drag="xbox_zoom",
            toolbar_location="right" if panel.name == "lash" else None,
            sizing_mode="stretch_both",
            min_height=int(64 * panel.share),
            styles={"flex": f"{panel.share} 1 0"},
            margin=0,
            min_border_left=80,  # the same in all panels, so that their time axes are aligned
            min_border_right=32,
        )
        plot.update(min_border_bottom=2, min_border_top=2, outline_line_color=None)
        plot.toolbar.logo = None
        plot.yaxis.axis_label_text_font_size = "11px"
        plot.yaxis.ticker.desired_num_ticks = 3 if panel.share < 1.0 else 5
        plot.axis.minor_tick_line_color = None
        plot.xgrid.visible = False
        plot.ygrid.grid_line_color = "#e6e6e6"
        plot.xaxis.visible = panel is _PANELS[-1]
        plot.xaxis.axis_label = "time [s]"
        look = {"line_color": FAINT_INK, "line_dash": "dotted", "line_width": 1.0}
        plot.add_layout(Span(location=self._load_step, dimension="height", **look))
        plot.multi_line(f"{panel.name}_x", f"{panel.name}_y", source=self._curves, color="colour", line_width=1.4)
        plot.on_event(Reset, lambda _: self.message.send(self._see(self._whole) | self._drawn()))
        return plot

    def show(self, run: Shown, pins: Sequence[Shown], lash: int, note: str) -> None:
        """Show the motion of one lash in the selected run and in the pinned ones.

        A time axis that the user has zoomed stays as it is; otherwise it shows the runs from begin to end.

        lash : position of the lash
        note : text for the header; may be empty
        """
        self._runs = [each.history.lashes[lash] for each in (run, *pins)]
        whole = min(each.time[0] for each in self._runs), max(each.time[-1] for each in self._runs)
        changes = self._see(whole) if self._span == self._whole else {}
        self._whole = whole
        half, trajectory = 1e3 * self._runs[0].half_gap, self._runs[0].trajectory
        facts = [*filter(None, [note]), *(f"{name} {text}" for name, text in trajectory.outcome() if name != "label")]
        label = f'<span style="font-size: 20px; font-weight: bold">{escape(trajectory.label)}</span>'
        headings, *events = trajectory.event_table()
        ending = (f"{trajectory.end:.7f}", f"end: {trajectory.ending}", *[""] * (len(headings) - 2))
        pinned = zip(pins, self._runs[1:], RUN_COLOURS[1:], strict=False)
        lines = [
            f'<span style="color: {colour}">■</span> {escape(f"{pin.place}: {outcome(history)}")}'
            for pin, history, colour in pinned
        ]
        changes |= {
            "gap": {"bottom": -half, "top": half},
            "header": {"text": f"{label} &nbsp; {escape(run.place)}<br>{escape(' · '.join(facts))}"},
            "compared": {"text": "<br>".join(lines)},
            "events": {"text": html_table([*events, ending], headings)},
        }
        self.message.send(changes | self._drawn())

    def refuse(self, text: str) -> None:
        """Clear the figures, and write into the header why there is no run."""
        self._runs = []
        texts: Changes = {"header": {"text": f"<b>no run</b>: {escape(text)}"}, "events": {"text": ""}}
        self.message.send(texts | self._drawn())

    def _see(self, span: tuple[float, float]) -> Changes:
        """Changes that make the time axis begin and end at these times  [s]."""
        self._span = span
        return {"time": {"start": span[0], "end": span[1]}}

    def _on_zoom(self, _attribute: str, _old: float, _new: float) -> None:
        self._span = float(self._time.start), float(self._time.end)
        self.message.send(self._drawn())

    def _drawn(self) -> Changes:
        """Changes that draw all runs within the time axis, and the flanks, touches and Q_i of the selected run."""
        begin, end = self._span
        flanks = []
        touches = []
        arrows = []
        for run in self._runs[:1]:
            flanks = [(begin, y, name, "top" if y > 0.0 else "bottom") for y, name in flank_names([run]).items()]
            for row, side, primary in zip(*run.touches, strict=True):
                place = run.time[row], 1e3 * run.backlash_coordinate[row]
                look = (RUN_COLOURS[0], 10) if primary else ("white", 6)
                touches.append((*place, 0.0 if side > 0 else np.pi, RUN_COLOURS[0], *look))
            for each in measured_impacts(run):
                x = each.begin + 0.012 * (end - begin)
                arrows.append((x, each.smallest, each.largest, f"Q{each.number}"))
        touches.sort(key=lambda touch: touch[-1])  # by the size of their marks: primary impacts are drawn on top
        changes = {
            "flanks": _columns(_FLANKS, flanks),
            "touches": _columns(_TOUCHES, touches),
            "arrows": _columns(_ARROWS, arrows),
        }
        shown = list(zip(self._runs, RUN_COLOURS, strict=False))[::-1]
        data: dict[str, list[Any]] = {"colour": [colour for _, colour in shown]}
        for panel in _PANELS:
            curves = [thinned(run.time, panel.values(run), begin, end, _COLUMNS) for run, _ in shown]
            data[f"{panel.name}_x"], data[f"{panel.name}_y"] = [x for x, _ in curves], [y for _, y in curves]
            if shown:  # set here: a browser that finds the range itself reports it to the server, 4 ms for each panel
                heights = np.concatenate([y for _, y in curves])
                if panel.name == "lash":
                    heights = np.append(heights, [y for _, y, *_ in flanks])
                low, high = heights.min(), heights.max()
                around = 0.5 * panel.padding * (high - low) or 1.0
                changes[panel.name] = {"start": low - around, "end": high + around}
        return {"curves": {"data": data}, **changes}


# Names of the columns of data sources.
_FLANKS, _TOUCHES, _ARROWS = "x y text baseline", "x y angle colour fill size", "x low high text"


def thinned(time: Floats, values: Floats, begin: float, end: float, spans: int) -> tuple[Floats, Floats]:
    """The part of a curve between two times, thinned to no more points than a screen tells apart.

    The samples are divided into equal spans, and each span is drawn as its least and its greatest value, both at its
    first time, so that no peak is lost and nothing moves by more than a span.

    Parameters
    ----------
    time, values : (M,) float64
        Time does not decrease.
    begin, end : float
        One sample beyond each is kept, so that the line reaches the borders of the picture.
    spans : int
        The curve has from as many to twice as many spans, or one for each sample if there are fewer samples.

    Returns
    -------
    time, values : (m,) float64, m at most 4 spans + 3
    """
    first = max(0, int(time.searchsorted(begin)) - 1)
    last = min(time.size, int(time.searchsorted(end, side="right")) + 1)
    starts = np.arange(first, last, max(1, (last - first) // spans))
    extremes = [reduce.reduceat(values[:last], starts) for reduce in (np.minimum, np.maximum)]
    return np.append(time[starts].repeat(2), time[last - 1]), np.append(np.ravel(extremes, "F"), values[last - 1])
