"""A map as pixels on the page: the regions, and the room that texts have taken."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from scipy import ndimage

from clunk.plot.layers import Layers
from clunk.plot.network import codes_at
from clunk.plot.plane import Codes, ruler
from clunk.study.arrays import Bools, Floats, Positions
from clunk.study.axes import ResultAxis

_PIXEL = 2.0  # display pixels per raster pixel; finer would only be slower
_NOWHERE = -2  # no region, so that no label is written there


class Place(NamedTuple):
    """Place of a text: its centre in raster pixels, its size in points and its angle."""

    x: float
    y: float
    size: float
    angle: float


@dataclass
class Raster:
    """Pixels of a map's axes on the page, rows upwards.

    label : (height, width) code of each pixel
    taken : (height, width) whether a text, a mark or a line is there
    """

    ax: Axes
    label: Codes
    taken: Bools = field(init=False)

    def __post_init__(self) -> None:
        self.taken = np.zeros(self.label.shape, np.bool_)

    @classmethod
    def blank(cls, ax: Axes) -> Raster:
        """Pixels of a map as a single region."""
        box = ax.get_window_extent()
        return cls(ax, np.zeros((int(box.height / _PIXEL), int(box.width / _PIXEL)), np.int16))

    @classmethod
    def of(cls, ax: Axes, layers: Layers) -> Raster:
        """The labels of a map or strip as they are drawn; those of a strip change halfway between samples."""
        box, (height, width) = ax.get_window_extent(), cls.blank(ax).label.shape
        across = box.x0 + (np.arange(width) + 0.5) * _PIXEL
        upward = box.y0 + (np.arange(height) + 0.5) * _PIXEL
        inverse = ax.transData.inverted()
        x = inverse.transform(np.column_stack((across, np.full(width, box.y0))))[:, 0]
        y = inverse.transform(np.column_stack((np.full(height, box.x0), upward)))[:, 1]
        if len(layers.view.axes) == 1:
            edges, codes = layers.bands
            cells = np.clip(np.searchsorted(edges, x) - 1, 0, len(codes) - 1)
            return cls(ax, np.broadcast_to(codes[cells], (height, width)))
        if layers.boundaries is not None:
            nearest = layers.codes[np.ix_(*map(fine_index, (x, y), layers.view.axes, (1, 1)))].T
            return cls(ax, codes_at(layers.boundaries, layers.view, x, y, nearest))
        columns, rows = map(fine_index, (x, y), layers.view.axes, layers.regions.factor)
        return cls(ax, layers.regions.label[np.ix_(columns, rows)].T)

    @property
    def figure(self) -> Figure:
        """The figure of the axes."""
        figure = self.ax.get_figure(root=True)
        assert figure is not None
        return figure

    def data(self, x: float, y: float) -> tuple[float, float]:
        """Data coordinates of a raster position."""
        box = self.ax.get_window_extent()
        point = self.ax.transData.inverted().transform((box.x0 + x * _PIXEL, box.y0 + y * _PIXEL))
        return float(point[0]), float(point[1])

    def measure(self, text: str, size: float) -> tuple[int, int]:
        """Width and height in raster pixels that a text takes, with room around it."""
        drawn = Text(0, 0, text, fontsize=size, parse_math=False, figure=self.figure)
        box = drawn.get_window_extent(self.figure.canvas.get_renderer())  # type: ignore[attr-defined]
        room = 0.22 * size * self.figure.dpi / 72.0
        return math.ceil((box.width + 2 * room) / _PIXEL), math.ceil((box.height + 2 * room) / _PIXEL)

    def take(self, text: str, place: Place) -> None:
        """Mark a text's rectangle as taken."""
        width, height = self.measure(text, place.size)
        rows, columns = np.indices(self.label.shape)
        u, v = rotate(columns + 0.5 - place.x, rows + 0.5 - place.y, -place.angle)
        self.taken |= (np.abs(u) <= 0.5 * width) & (np.abs(v) <= 0.5 * height)

    def take_line(self, columns: Floats, rows: Floats) -> None:
        """Mark the pixels of a line through raster positions as taken."""
        share = np.linspace(0.0, 1.0, 60)
        fine_columns, fine_rows = (ends[:-1, None] + share * np.diff(ends)[:, None] for ends in (columns, rows))
        self.taken[self._at(fine_columns, fine_rows)] = True

    def _at(self, columns: Floats, rows: Floats) -> tuple[Positions, ...]:
        """Index of the pixels at raster positions; of those outside, of the nearest on the border."""
        pairs = zip((rows, columns), self.label.shape, strict=True)
        return tuple(np.clip(positions, 0, count - 1).astype(np.intp) for positions, count in pairs)

    def pixels(self, values: Floats) -> tuple[Floats, Floats]:
        """Raster columns and rows of data coordinates (n, 2)."""
        box = self.ax.get_window_extent()
        column, row = (self.ax.transData.transform(values.reshape(-1, 2)) - [box.x0, box.y0]).T / _PIXEL
        return column, row

    def block(self, x: Floats, y: Floats, size: float) -> int:
        """Take squares of this many points around some values; returns half a square's pixels."""
        half = math.ceil(0.5 * size * self.figure.dpi / 72.0 / _PIXEL)
        hit = np.zeros(self.label.shape, np.bool_)
        hit[self._at(*self.pixels(np.column_stack((x, y))))] = True
        self.taken |= ndimage.binary_dilation(hit, np.ones((2 * half + 1, 2 * half + 1)))
        return half

    def border(self) -> Bools:
        """The pixels along the boundaries of regions."""
        border = np.zeros(self.label.shape, np.bool_)
        border[1:] |= self.label[1:] != self.label[:-1]
        border[:, 1:] |= self.label[:, 1:] != self.label[:, :-1]
        return border

    def clear_taken(self) -> None:
        """Take the taken pixels out of the regions; of one that falls apart so, the largest piece stays."""
        free = np.full(self.label.shape, _NOWHERE, np.int16)
        for code in np.unique(self.label):
            regions, _ = ndimage.label(self.label == code)
            pieces, count = ndimage.label((regions > 0) & ~self.taken)
            if not count:
                continue
            area = np.bincount(pieces.ravel(), minlength=count + 1)
            region_of = ndimage.maximum(regions, pieces, np.arange(1, count + 1)).astype(np.intp)
            for region in np.unique(region_of):
                within = np.flatnonzero(region_of == region) + 1
                free[pieces == within[np.argmax(area[within])]] = code
        self.label = free


def fine_index(values: Floats, axis: ResultAxis, factor: int) -> Positions:
    """Index of the fine point nearest to each value of an axis."""
    to, _ = ruler(axis)
    samples = axis.values
    index = np.interp(to(np.clip(values, samples[0], samples[-1])), to(samples), np.arange(len(samples)))
    fine: Positions = np.rint(index * factor).astype(np.intp)
    return fine


def rotate(x: Any, y: Any, degrees: float) -> tuple[Any, Any]:
    """Positions turned about the origin, anticlockwise."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return c * x - s * y, s * x + c * y


def centres_that_fit(mask: Bools, width: int, height: int) -> Floats:
    """(n, 2) centres x, y of the rectangles that lie in the mask as a whole."""
    rows, columns = np.nonzero(corners_that_fit(mask, width, height))
    return np.column_stack((columns + 0.5 * width, rows + 0.5 * height))


def corners_that_fit(mask: Bools, width: int, height: int) -> Bools:
    """Positions of the lower left corner of a rectangle that lies in the mask as a whole."""
    rows, columns = mask.shape[0] - height + 1, mask.shape[1] - width + 1
    if rows < 1 or columns < 1:
        return np.zeros((1, 1), np.bool_)
    fits: Bools = ndimage.minimum_filter(mask, (height, width), origin=(-(height // 2), -(width // 2)))
    return fits[:rows, :columns]
