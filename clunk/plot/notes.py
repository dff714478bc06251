"""Notes under a figure: swatches of labels, and marks of failed, undefined and undecided cells with their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from clunk.plot.layers import Layers
from clunk.plot.style import FAILED_LOOK, INK, UNDEFINED, palette_of
from clunk.results.labels import FAILED
from clunk.study.arrays import Bools

DOT: dict[str, Any] = {"linestyle": "none", "marker": "o", "color": INK, "markeredgewidth": 0.0}


def set_notes(figure: Figure, handles: Sequence[Artist]) -> None:
    """Put a row of notes under the axes, in place of the one that is there."""
    for legend in list(figure.legends):
        legend.remove()
    if handles:
        look: dict[str, Any] = {"ncols": note_columns(figure, handles), "frameon": False, "handlelength": 1.6}
        figure.legend(handles=list(handles), loc="outside lower center", **look)


def note_columns(figure: Figure, handles: Sequence[Artist]) -> int:
    """Number of notes side by side that the width of the figure takes."""
    widest = max(len(str(handle.get_label())) for handle in handles)
    return max(1, int((figure.get_figwidth() - 0.4) / (0.45 + 0.075 * widest)))  # inches: a swatch, a character


def cells_phrase(count: int) -> str:
    """A number of cells, for example 1 cell or 1,234 cells."""
    return f"{count:,} cell{'' if count == 1 else 's'}"


def swatch(text: str, colour: str) -> Patch:
    """A note that begins with a colour."""
    return Patch(facecolor=colour, edgecolor=INK, linewidth=0.6, label=text)


def remark(text: str) -> Patch:
    """A note without a mark."""
    return Patch(alpha=0.0, label=text)


def label_notes(layers: Layers, labels: Sequence[str], most: int, *, counted: bool) -> list[Artist]:
    """Swatches of `most` labels, with their numbers of cells where `counted`, and how many labels more there are.

    Where boundaries have been traced, the part of the map's area takes the place of the cells.
    """
    palette, more = palette_of(layers.labels), len(labels) - most
    notes: list[Artist] = [
        swatch(f"{label}: {_extent(layers, label)}" if counted else label, palette[label]) for label in labels[:most]
    ]
    return notes + ([remark(f"and {more} label{'' if more == 1 else 's'} more")] if more > 0 else [])


def _extent(layers: Layers, label: str) -> str:
    if layers.boundaries is None:
        return cells_phrase(layers.count(label))
    return f"{100.0 * layers.boundaries.areas.get(label, 0.0):.2g} %"


def failed_notes(failed: Bools, text: str = FAILED) -> list[Artist]:
    """Number of failed cells, beside their hatch; nothing where there are none."""
    count = int(np.count_nonzero(failed))
    look: dict[str, Any] = FAILED_LOOK | {"linewidth": 0.6}
    return [Patch(label=f"{text}: {cells_phrase(count)}", **look)] if count else []


def undecided_notes(undecided: Bools) -> list[Artist]:
    """Number of undecided cells, beside their dot; nothing where there are none."""
    count = int(np.count_nonzero(undecided))
    return [Line2D([], [], **DOT, markersize=3.0, label=f"undecided: {cells_phrase(count)}")] if count else []


def undefined_notes(layers: Layers) -> list[Artist]:
    """Why cells that did not fail have no value, beside their colour; nothing where all have one."""
    undefined = np.isnan(layers.values) & ~layers.failed
    reason = "not known" if layers.quantity == "margin" else "not defined (no events)"
    return [swatch(reason, UNDEFINED)] if undefined.any() else []
