"""Pictures of maps for a page: pixels, lines, dots and texts; and the first of them, with the cells as they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from clunk.plot.layers import Layers
from clunk.plot.plane import cells_of, ruler
from clunk.plot.style import FAILED_FILL
from clunk.results.labels import FAILED
from clunk.results.tolerancemap import AnyMap
from clunk.study.arrays import Floats
from clunk.study.axes import ResultAxis

Pixels = npt.NDArray[np.uint32]

_PIXELS = 640  # of an image, across and upward
_FEW_PIXELS = 160  # of an image of few cells


class Shades(NamedTuple):
    """Colours of a quantity from its lowest to its highest value, and its name."""

    label: str
    low: float
    high: float
    colours: list[str]
    has_dark_lines: bool  # whether boundaries are seen as dark lines on them


@dataclass(frozen=True)
class Picture:
    """A map over two axes, or bands and a curve over one.

    pixels : (rows, columns) uint32, colours of a map from below, evenly spaced along its axes as they are scaled; or of
        a strip (columns,)
    edges : (columns + 1,) of a strip's bands, where the label changes
    lines : boundaries, each (n, 2), in the axes' units
    dots : (n, 2) undecided cells
    texts : label, x and y, of each that has room in its region
    legend : label, its colour and its share of the map
    shades : of a quantity
    curve : (n, 2) of a strip, the axis and the quantity
    peak : the largest value of a quantity, and those of the axes in its cell
    """

    pixels: Pixels
    legend: list[tuple[str, str, str]]
    lines: list[Floats] = field(default_factory=list)
    dots: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    texts: list[tuple[str, float, float]] = field(default_factory=list)
    shades: Shades | None = None
    edges: Floats | None = None
    curve: Floats | None = None
    peak: tuple[float, ...] | None = None


def cells_picture(results: AnyMap) -> Picture:
    """The picture of one lash's regimes over two axes without boundaries, each pixel of the nearest cell's colour."""
    layers = replace(Layers.of(results, 2), boundaries=None)
    pixels = _FEW_PIXELS if max(layers.codes.shape) < _FEW_PIXELS // 4 else _PIXELS
    columns, rows = (cells_of(axis, pixel_centres(axis, pixels)) for axis in layers.view.axes)
    colours = np.array([packed(colour) for colour in (*layers.colours, FAILED_FILL)], np.uint32)
    legend = legend_of(layers.names, layers.colours, layers.shares)
    return Picture(colours[layers.codes[np.ix_(columns, rows)].T], legend)


def pixel_centres(axis: ResultAxis, pixels: int = _PIXELS) -> Floats:
    """Centres of an image's pixels along an ascending axis, in its unit."""
    to, back = ruler(axis)
    edges = np.linspace(to(axis.values[0]), to(axis.values[-1]), pixels + 1)
    return np.asarray(back(0.5 * (edges[1:] + edges[:-1])), np.float64)


def legend_of(names: Sequence[str], colours: Sequence[str], shares: Floats) -> list[tuple[str, str, str]]:
    """Legend of a map's regions, each with its share of the map; the last share is that of failed cells."""
    entries = zip((*names, FAILED), (*colours, FAILED_FILL), shares.tolist(), strict=True)
    return [(name, colour, f"{100.0 * share:.3g} %") for name, colour, share in entries if share > 0.0]


def packed(colour: str) -> int:
    """A colour, #rrggbb, as the four bytes of a pixel: red, green, blue, opaque."""
    return int.from_bytes(bytes.fromhex(f"{colour[1:]}ff"), "little")
