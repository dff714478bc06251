"""A map as pixels on the page: the regions, and the room that texts have taken."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.text import Text
from scipy import ndimage

from clunk.plot.plane import View, ruler
from clunk.plot.regions import Regions
from clunk.study.axes import ResultAxis

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Codes = npt.NDArray[np.int16]

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
        """One region everywhere."""
        box = ax.get_window_extent()
        return cls(ax, np.zeros((int(box.height / _PIXEL), int(box.width / _PIXEL)), np.int16))

    @classmethod
    def of(cls, ax: Axes, regions: Regions, view: View) -> Raster:
        """The labels as they are drawn."""
        box = ax.get_window_extent()
        width, height = int(box.width / _PIXEL), int(box.height / _PIXEL)
        across = box.x0 + (np.arange(width) + 0.5) * _PIXEL
        upward = box.y0 + (np.arange(height) + 0.5) * _PIXEL
        inverse = ax.transData.inverted()
        x = inverse.transform(np.column_stack((across, np.full(width, box.y0))))[:, 0]
        y = inverse.transform(np.column_stack((np.full(height, box.x0), upward)))[:, 1]
        columns = _fine_index(x, view.x, regions.factor[0])
        rows = _fine_index(y, view.y, regions.factor[1])
        return cls(ax, regions.label[np.ix_(columns, rows)].T)

    @classmethod
    def of_strip(cls, ax: Axes, codes: Codes, edges: Floats) -> Raster:
        """The labels along one axis, which change halfway between samples."""
        blank = cls.blank(ax)
        height, width = blank.label.shape
        x = np.array([blank.data(column + 0.5, 0.0)[0] for column in range(width)])
        cell = np.clip(np.searchsorted(edges, x) - 1, 0, len(codes) - 1)
        return cls(ax, np.broadcast_to(codes[cell], (height, width)))

    def data(self, x: float, y: float) -> tuple[float, float]:
        """Data coordinates of a raster position."""
        box = self.ax.get_window_extent()
        point = self.ax.transData.inverted().transform((box.x0 + x * _PIXEL, box.y0 + y * _PIXEL))
        return float(point[0]), float(point[1])

    def measure(self, text: str, size: float) -> tuple[int, int]:
        """Width and height in raster pixels that a text takes, with room around it."""
        figure = self.ax.get_figure(root=True)
        assert figure is not None
        drawn = Text(0, 0, text, fontsize=size, parse_math=False, figure=figure)
        box = drawn.get_window_extent(figure.canvas.get_renderer())  # type: ignore[attr-defined]
        room = 0.22 * size * figure.dpi / 72.0
        return math.ceil((box.width + 2 * room) / _PIXEL), math.ceil((box.height + 2 * room) / _PIXEL)

    def take(self, text: str, place: Place) -> None:
        """Mark a text's rectangle as taken."""
        width, height = self.measure(text, place.size)
        rows, columns = np.indices(self.label.shape)
        u, v = rotate(columns + 0.5 - place.x, rows + 0.5 - place.y, -place.angle)
        self.taken |= (np.abs(u) <= 0.5 * width) & (np.abs(v) <= 0.5 * height)

    def take_line(self, start: tuple[float, float], stop: tuple[float, float]) -> None:
        """Mark the pixels of a line between two raster positions as taken."""
        height, width = self.taken.shape
        column, row = (a + np.linspace(0.0, 1.0, 60) * (b - a) for a, b in zip(start, stop, strict=True))
        rows, columns = np.clip(row.astype(np.intp), 0, height - 1), np.clip(column.astype(np.intp), 0, width - 1)
        self.taken[rows, columns] = True

    def pixels(self, values: Floats) -> tuple[Floats, Floats]:
        """Raster columns and rows of data coordinates (n, 2)."""
        box = self.ax.get_window_extent()
        column, row = (self.ax.transData.transform(values.reshape(-1, 2)) - [box.x0, box.y0]).T / _PIXEL
        return column, row

    def block(self, x: Floats, y: Floats, size: float) -> int:
        """Take squares of this many points around some values; returns half a square's pixels."""
        figure = self.ax.get_figure(root=True)
        assert figure is not None
        half = math.ceil(0.5 * size * figure.dpi / 72.0 / _PIXEL)
        height, width = self.label.shape
        columns, rows = self.pixels(np.column_stack((x, y)))
        hit = np.zeros(self.label.shape, np.bool_)
        hit[np.clip(rows, 0, height - 1).astype(np.intp), np.clip(columns, 0, width - 1).astype(np.intp)] = True
        hit = ndimage.binary_dilation(hit, np.ones((2 * half + 1, 2 * half + 1)))
        self.taken |= hit
        return half

    def border(self) -> Bools:
        """The pixels along the boundaries of regions."""
        border = np.zeros(self.label.shape, np.bool_)
        border[1:] |= self.label[1:] != self.label[:-1]
        border[:, 1:] |= self.label[:, 1:] != self.label[:, :-1]
        return border

    def clear_taken(self) -> None:
        """Keep regions' labels off what is taken. Of a region that falls apart so, the largest piece keeps its name."""
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


def _fine_index(values: Floats, axis: ResultAxis, factor: int) -> npt.NDArray[np.intp]:
    to, _ = ruler(axis)
    samples = axis.values
    index = np.interp(to(np.clip(values, samples[0], samples[-1])), to(samples), np.arange(len(samples)))
    fine: npt.NDArray[np.intp] = np.rint(index * factor).astype(np.intp)
    return fine


def rotate(x: Any, y: Any, degrees: float) -> tuple[Any, Any]:
    """Positions turned about the origin, anticlockwise."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return c * x - s * y, s * x + c * y


def corners_that_fit(mask: Bools, width: int, height: int) -> Bools:
    """Positions of the lower left corner of a rectangle that lies in the mask as a whole."""
    rows, columns = mask.shape[0] - height + 1, mask.shape[1] - width + 1
    if rows < 1 or columns < 1:
        return np.zeros((1, 1), np.bool_)
    total = np.zeros((mask.shape[0] + 1, mask.shape[1] + 1), np.int64)
    np.cumsum(np.cumsum(mask, axis=0), axis=1, out=total[1:, 1:])
    inside = total[height:, width:] - total[:-height, width:] - total[height:, :-width] + total[:-height, :-width]
    fits: Bools = inside == width * height
    return fits
