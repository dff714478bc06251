"""Style of all figures: colours, sizes, titles, and how they are saved.

matplotlib is imported when it is first drawn with: of the colours there are other users, which do not wait for it.
"""

from __future__ import annotations

import os
import re
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from clunk.results.files import reason, write_whole
from clunk.results.labels import double_sided, excursions
from clunk.study.errors import ClunkError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patheffects import AbstractPathEffect
    from matplotlib.text import Text

_FORMATS = ("png", "svg", "pdf")
SIZE = (7.0, 5.2)  # inches
HISTORY_WIDTH = 7.2  # inches
MOST_POINTS = 10_000  # that a vector file has one by one: more would take seconds to show
_TITLE_MARGIN = 0.08  # inches, at the right of a title
_DPI = 150
INK = "#1c2126"
FAINT_INK = "#5b646c"
FAILED_FILL, FAILED_HATCH = "#d5d5d5", "#8a8a8a"
FAILED_LOOK = {"facecolor": FAILED_FILL, "edgecolor": FAILED_HATCH, "hatch": "//////"}
UNDEFINED = "#efefec"
# Of lines, in this order; also the colour blind tell them apart, and their lightness differs.
LINE_COLOURS = ("#2f7fc1", "#dd6b1f", "#1f9e83", "#7d55a8", "#b8447c", "#d9b310", "#7a6a55")
CENTRED: dict[str, Any] = {"ha": "center", "va": "center"}
DASHED = (0, (4.0, 1.6))
MINUS = "\N{MINUS SIGN}"
# One hue per number of double-sided impacts, tinted. Chosen so that the nine labels of Figure 3.4 stay apart under
# simulated protanopia, deuteranopia and tritanopia too (Machado et al. 2009; at least 6.8 in CIE L*a*b*).
_NO_IMPACT = "#f6f5f1"
HUES = ("#b5b010", "#2f7fc1", "#dd6b1f", "#a84a72", "#1f9e83", "#6b7480", "#9a6a4a")
_TINTS = (0.30, 0.70)  # lightest and darkest member of a family; text stays readable on the darkest
_STYLE: dict[str, Any] = {
    "font.size": 9.0,
    "axes.labelsize": 10.0,
    "axes.linewidth": 0.8,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "hatch.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "pdf.fonttype": 42,  # journals refuse Type 3
    "svg.hashsalt": "clunk",  # the same figure gives the same file
}


class PlotError(ClunkError):
    """Results that cannot be drawn as asked; its text is one sentence for the user."""


@contextmanager
def styled() -> Iterator[None]:
    """Draw in clunk's style, whatever a user's matplotlibrc says."""
    from matplotlib import style

    with style.context(["default", _STYLE]):
        yield


def new_figure(size: tuple[float, float] = SIZE) -> Figure:
    """An empty figure.

    size : width and height  [inches]
    """
    from clunk.plot.notebook import NotebookFigure

    return NotebookFigure(figsize=size, dpi=_DPI, layout="constrained")


def set_titles(figure: Figure, ax: Axes, title: str, line: str, *, parse_math: bool = False) -> None:
    """A title over the whole figure, wrapped when its layout is frozen, and a line under it over the axes.

    parse_math : whether the line is TeX between its dollar signs
    """
    figure.suptitle(title, fontsize=11.5, fontweight="bold", ha="left", parse_math=False)
    ax.set_title(line, loc="left", fontsize=9.0, color=FAINT_INK, parse_math=parse_math)


def freeze_layout(figure: Figure, ax: Axes) -> None:
    """Lay the figure out once and for all, so that labels can be fitted to it."""
    figure.set_layout_engine("constrained")
    figure.draw_without_rendering()
    title = figure._suptitle  # type: ignore[attr-defined]
    left = ax.get_position().x0
    if _wrap(figure, title, (1.0 - left) * figure.bbox.width - _TITLE_MARGIN * figure.dpi):
        figure.draw_without_rendering()  # the title takes another height
    figure.set_layout_engine("none")
    title.set_x(left)


def _wrap(figure: Figure, title: Text, room: float) -> bool:
    """Break a title into lines of `room` display pixels at most; whether that changed it."""
    before = title.get_text()
    text = " ".join(before.split())
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    for columns in range(max(1, len(text)), 0, -1):
        title.set_text(textwrap.fill(text, columns))
        if title.get_window_extent(renderer).width <= room:
            break
    return bool(title.get_text() != before)


def halo(linewidth: float = 2.4, colour: str = "white") -> list[AbstractPathEffect]:
    """An outline around a text or a line, so that it is seen on any ground."""
    from matplotlib import patheffects

    return [patheffects.withStroke(linewidth=linewidth, foreground=colour)]


def tidy(ax: Axes) -> None:
    """Draw horizontal grid lines, and no spines at the top and on the right."""
    ax.grid(axis="y", color="0.9", linewidth=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


def plain(text: str) -> str:
    """Escape dollar signs, which matplotlib would take for TeX."""
    return text.replace("$", r"\$")


def capital(text: str) -> str:
    """Text with a capital first letter."""
    return text[:1].upper() + text[1:]


def bare(symbol: str) -> str:
    """Symbol without its definition: σr of σr = Td/Ts."""
    return symbol.split("=")[0].strip()


def symbol_text(symbol: str) -> str:
    """Symbol as TeX with its subscripts: σr as σ with the subscript r, Td/Ts likewise."""
    return re.sub(r"(?<!\w)([^\W\d_])([^\W\d_]|\d{1,2})(?!\w)", r"\1$_\\mathregular{\2}$", plain(symbol))


def palette_of(labels: tuple[str, ...]) -> dict[str, str]:
    """A light tint for every label: the hue tells the number of double-sided impacts, the depth what follows them."""
    families: dict[int, list[str]] = {}
    for label in labels:
        families.setdefault(double_sided(label), []).append(label)
    palette: dict[str, str] = {}
    for pairs, members in families.items():
        hue = np.frombuffer(bytes.fromhex(HUES[pairs % len(HUES)][1:]), np.uint8) / 255.0
        impacts = sorted((label for label in members if label != "NI"), key=lambda label: (excursions(label), label))
        # Three depths at least, so that a family of one or two is light and the same label looks alike across maps.
        depths = np.linspace(*_TINTS, max(3, len(impacts)))
        for label, depth in zip(impacts, depths, strict=False):
            tint = np.rint(255.0 * (1.0 - depth * (1.0 - hue))).astype(np.uint8)
            palette[label] = f"#{tint.tobytes().hex()}"
    if "NI" in labels:
        palette["NI"] = _NO_IMPACT
    return palette


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure as PNG, SVG or PDF, by the suffix; the file appears whole or not at all. Raises PlotError."""
    path = Path(path)
    suffix = path.suffix.lower().removeprefix(".")
    if suffix not in _FORMATS:
        raise PlotError(f"{path} cannot be drawn: its name must end in {', '.join('.' + name for name in _FORMATS)}.")
    try:
        write_whole(path, lambda target: encode(figure, suffix, target))
    except OSError as error:
        raise PlotError(f"{path} cannot be written: {reason(error)}.") from error


def encode(figure: Figure, suffix: str, target: BinaryIO) -> None:
    """Write a figure to a stream as png, svg or pdf; the same figure gives the same bytes."""
    metadata: dict[str, Any] = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[suffix]
    options: dict[str, Any] = {"pil_kwargs": {"optimize": True}} if suffix == "png" else {}
    with styled():
        figure.savefig(target, format=suffix, metadata=metadata, **options)
