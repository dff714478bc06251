"""Style of all figures: colours, sizes, titles and notes, and how figures are saved."""

import io
import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Literal

import matplotlib.style
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Patch

from clunk.results.files import PICTURES, check, write_whole, writing
from clunk.results.labels import double_sided
from clunk.study.errors import ClunkError
from clunk.study.records import fill

Look = dict[str, Any]  # keyword arguments for matplotlib, or for Bokeh

SIZE = (7.0, 5.2)  # inches, width and height
MOST_POINTS = 10_000  # points in a vector file; more would take seconds to show and are drawn as an image
_INDENT = 0.125  # left of a title before the figure is laid out, as a share of the figure's width
_DPI = 150
INK = "#1c2126"
FAINT_INK = "#5b646c"
FAILED_FILL = "#a9a9a9"
UNDEFINED = "#efefec"
# Colours of lines, in the order in which they are used; the colour-blind tell them apart, too, and lightness differs.
LINE_COLOURS = ("#2f7fc1", "#dd6b1f", "#1f9e83", "#7d55a8", "#b8447c", "#d9b310", "#7a6a55")
CENTRED: Look = {"ha": "center", "va": "center"}
DASHED = (0, (4.0, 1.6))
MINUS = "\N{MINUS SIGN}"
_NO_IMPACT = "#f6f5f1"
# One hue for each number of double-sided impacts, so that a colour means the same in every picture. Chosen so that the
# labels of Figure 3.4 and the numbers up to five stay apart under simulated protanopia, deuteranopia and tritanopia,
# too (Machado et al. 2009; tests/test_plot.py).
HUES = ("#8fae20", "#1154d4", "#d95f28", "#a05585", "#199ec4", "#725ed4", "#c98a2a")
# Depth of a label's tint: _LIGHTEST + _RANGE (1 - exp(-w / _FALL)), with the weight w of the excursions in the label.
_LIGHTEST, _RANGE, _FALL = 0.172, 0.62, 2.35
_GROUP_TINTS = (0.55, 0.85, 0.25)  # depths from 0, 7 and 14 double-sided impacts on: there the hues begin again
_WEIGHTS = {"DS": 0.0, "SS": 1.0, "OS": 1.67, "CR": 0.0}  # weight of one excursion, by its term in the label
_BEFORE = 0.4  # additional weight of an excursion before the last double-sided one
_STYLE: Look = {
    "font.size": 9.0,
    "axes.labelsize": 10.0,
    "axes.linewidth": 0.8,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.fontsize": 8.5,
    "pdf.fonttype": 42,  # journals refuse Type 3
    "svg.hashsalt": "clunk",  # the same figure gives the same file
}


class PlotError(ClunkError):
    """Results that cannot be drawn as asked; its text is one sentence for the user."""


@contextmanager
def styled() -> Iterator[None]:
    """Draw in clunk's style, whatever a user's matplotlibrc says."""
    with matplotlib.style.context(["default", _STYLE]):
        yield


class NotebookFigure(Figure):
    """A figure that a notebook shows without pyplot."""

    def _repr_png_(self) -> bytes:
        picture = io.BytesIO()
        encode(self, "png", picture)
        return picture.getvalue()


def new_figure(size: tuple[float, float] = SIZE) -> Figure:
    """An empty figure.

    size : width and height  [inches]
    """
    figure = NotebookFigure(figsize=size, dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def new_panels(count: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """Figure with panels in rows of `columns`, all over the same axes, and one line of text under its title.

    count : number of panels
    size : width and height of the figure  [inches]
    """
    figure = new_figure(size)
    inner = figure.add_subfigure(figure.add_gridspec(1, 1)[0])  # holds the line under the title and the axes' names
    panels = inner.subplots(math.ceil(count / columns), columns, sharex=True, sharey=True, squeeze=False).ravel()
    for ax in panels[count:]:
        ax.remove()
    for ax in panels[max(0, count - columns) : count]:
        ax.xaxis.set_tick_params(labelbottom=True)  # the panel below, with the tick labels, may have been removed
    return figure, list(panels[:count])


def lay_out(
    figure: Figure, ax: Axes, title: str, line: str, notes: Sequence[Artist] = (), *, parse_math: bool = False
) -> None:
    """Write the title, and a line under it above the axes, and lay the figure out with the notes below.

    Afterwards the size of the axes is final, so that texts drawn within can be fitted to them.

    ax : panel with whose left side the title is aligned
    parse_math : whether the line is TeX between its dollar signs
    """
    place = {"x": _INDENT, "ha": "left", "wrap": True}
    # matplotlib measures wrapped text as TeX, even with `parse_math` off: hence `plain`
    titles = [figure.suptitle(plain(title), fontsize=11.5, fontweight="bold", **place)]
    line = line if parse_math else plain(line)
    look: Look = {"fontsize": 9.0, "color": FAINT_INK}
    titles += [part.suptitle(line, **look, **place) for part in figure.subfigs]
    if len(titles) == 1:
        ax.set_title(line, loc="left", wrap=True, **look)
    heights = [text.get_window_extent().height for text in titles]
    add_notes(figure, notes)
    for text in titles:
        text.set_x(ax.get_position().x0)
    if heights != [text.get_window_extent().height for text in titles]:
        _arrange(figure)  # a title moved to the right may wrap into another line, which takes height


def add_notes(figure: Figure, handles: Sequence[Artist]) -> None:
    """Put rows of notes under a figure, which grows by their height, and lay the figure out."""
    if handles:
        each, character, room = 0.45, 0.075, figure.get_figwidth() - 0.4  # inches: a swatch, a letter, all notes
        for handle in handles:
            lines = str(handle.get_label()).splitlines()
            handle.set_label("\n".join(fill(line, width=int((room - each) / character)) for line in lines))
        widest = max(len(line) for handle in handles for line in str(handle.get_label()).splitlines())
        columns = max(1, int(room / (each + character * widest)))
        look: Look = {"loc": "outside lower center", "ncols": min(columns, len(handles)), "frameon": False}
        legend = figure.legend(handles=handles, handlelength=1.6, **look)
        figure.set_figheight(figure.get_figheight() + legend.get_window_extent().height / figure.dpi)
    _arrange(figure)


def _arrange(figure: Figure) -> None:
    ConstrainedLayoutEngine().execute(figure)
    figure.set_layout_engine(None)  # with a layout engine, saving would draw the figure twice


def swatch(text: str, colour: str, **look: Any) -> Patch:
    """Note for a legend: a swatch of the colour, and the text after it."""
    fill: Look = {"facecolor": colour, "edgecolor": INK, "linewidth": 0.6} | look
    return Patch(label=text, **fill)


def tidy(ax: Axes, axis: Literal["x", "y"] = "y") -> None:
    """Draw grid lines at the ticks of one axis, and hide the top and right spines."""
    ax.grid(axis=axis, color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def plain(text: str) -> str:
    """Escape dollar signs, which matplotlib would take for TeX."""
    return text.replace("$", r"\$")


def bare(symbol: str) -> str:
    """Symbol without its definition: ``σr`` from ``σr = Td/Ts``."""
    return symbol.split("=")[0].strip()


def symbol_text(symbol: str) -> str:
    """Symbol as TeX with subscripts: σr becomes σ with the subscript r, and Td/Ts likewise."""
    return re.sub(r"(?<!\w)([^\W\d_])([^\W\d_]\d{0,2}|\d{1,2})(?!\w)", r"\1$_\\mathregular{\2}$", plain(symbol))


def tint(colour: str, depth: float) -> str:
    """A colour mixed with white; depth : share of the colour, 0 for white and 1 for the colour itself."""
    mixed = 255.0 - depth * (255.0 - np.frombuffer(bytes.fromhex(colour[1:]), np.uint8))
    return f"#{np.rint(mixed).astype(np.uint8).tobytes().hex()}"


def shades(count: int) -> list[str]:
    """Colours of `count` ordered values, from pale to deep in one hue."""
    return [tint(LINE_COLOURS[0], 0.08 + 0.52 * k / max(count - 1, 1)) for k in range(count)]


def group_colour(count: int) -> str:
    """Colour of the group of all labels with this number of double-sided impacts."""
    again, hue = divmod(count, len(HUES))
    return tint(HUES[hue], _GROUP_TINTS[again % len(_GROUP_TINTS)])


def colour_of(label: str) -> str:
    """Colour of a label, the same in every picture.

    The hue tells the number of double-sided impacts. The shade is deeper for more single-sided (SS) and opposite-sided
    (OS) excursions.
    """
    if label == "NI":
        return _NO_IMPACT
    terms = [(kind, int(count)) for kind, count in re.findall(r"([A-Z]+)\((\d+)\)", label)]
    last = max((k for k, (kind, _) in enumerate(terms) if kind == "DS"), default=0)
    follows = sum(count * _WEIGHTS[kind] for kind, count in terms)
    follows += sum(_BEFORE * count for kind, count in terms[:last] if kind != "DS")
    depth = _LIGHTEST + _RANGE * (1.0 - math.exp(-follows / _FALL))
    return tint(HUES[double_sided(label) % len(HUES)], depth)


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure as PNG, SVG or PDF, by the path's suffix; the file appears whole or not at all.

    Raises ClunkError where the suffix is none of these, or the file cannot be written.
    """
    check(Path(path), PICTURES)
    with writing(path) as target:
        write_whole(target, lambda file: encode(figure, target.suffix.lower().removeprefix("."), file))


def encode(figure: Figure, suffix: str, target: BinaryIO) -> None:
    """Write a figure to a stream; the same figure gives the same bytes. suffix : png, svg or pdf"""
    metadata = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[suffix]
    with styled():
        figure.savefig(target, format=suffix, metadata=metadata)
