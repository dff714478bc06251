"""Texts on a map: names within their regions or beside them with a line, measured labels beside their points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import ndimage

from clunk.plot.layers import Layers
from clunk.plot.plane import Codes
from clunk.plot.style import CENTRED, INK
from clunk.study.arrays import Bools, Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZES, SMALL_SIZES = (10.5, 9.5, 8.5, 8.0), (8.5, 7.5, 6.5)  # points, tried in turn: of a map, of a panel of several
_PIXEL = 2.0  # display pixels per raster pixel; finer would only be slower
_NOWHERE = -2  # no region, so that no name is written there
_ROOM = 0.22  # of a text's size, around it
_STEEP = 5.0  # degrees: less is no slope
_LEADER_SIZE = 8.5
_LEADER = {"arrowstyle": "-", "color": INK, "linewidth": 0.8, "shrinkA": 0.0, "shrinkB": 0.0}
_SMALLEST_LEADER = 4e-4  # of the map's area: a smaller region is only noted, a leader would point at nothing
_SMALLEST_REPEAT = 1e-2  # of the map's area: a further region of a label that has its text already
_MOST_PARTS = 4  # regions of one label that are looked at, the largest first
# Where a text goes beside its point, the first that is free: right, left, above, below, then askew, then further away.
_SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1))
_FURTHER = (1.0, 2.2)


class Place(NamedTuple):
    """Place of a text: its centre in raster pixels, its size in points and its angle in degrees."""

    x: float
    y: float
    size: float
    angle: float


@dataclass
class Raster:
    """Pixels of a map's axes on the page, rows upwards.

    codes : (height, width) region of each pixel
    taken : (height, width) whether a text, a mark or a line is there
    """

    ax: Axes
    codes: Codes
    taken: Bools = field(init=False)
    _sizes: dict[tuple[str, float], tuple[int, int]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.taken = np.zeros(self.codes.shape, np.bool_)

    @classmethod
    def of(cls, ax: Axes, layers: Layers) -> Raster:
        """The regions of a map, or of a strip over its whole height, as they are drawn."""
        box = ax.get_window_extent()
        across, upward = ((np.arange(int(side / _PIXEL)) + 0.5) * _PIXEL for side in (box.width, box.height))
        to_data = ax.transData.inverted().transform
        x = to_data(np.column_stack([box.x0 + across, np.full(across.size, box.y0)]))[:, 0]
        y = to_data(np.column_stack([np.full(upward.size, box.x0), box.y0 + upward]))[:, 1]
        return cls(ax, layers.codes_at(x, y))

    def data(self, x: float, y: float) -> tuple[float, float]:
        """Data coordinates of a raster position."""
        box = self.ax.get_window_extent()
        point = self.ax.transData.inverted().transform((box.x0 + x * _PIXEL, box.y0 + y * _PIXEL))
        return float(point[0]), float(point[1])

    def pixels(self, values: Floats) -> Floats:
        """Raster columns and rows (n, 2) of data coordinates (n, 2)."""
        box = self.ax.get_window_extent()
        positions: Floats = (self.ax.transData.transform(values.reshape(-1, 2)) - [box.x0, box.y0]) / _PIXEL
        return positions

    def measure(self, text: str, size: float) -> tuple[int, int]:
        """Width and height in raster pixels that a text takes, with room around it."""
        if (text, size) not in self._sizes:
            from matplotlib.text import Text  # the explorer has names on its page before matplotlib is there

            figure = self.ax.get_figure(root=True)
            assert figure is not None
            drawn = Text(0, 0, text, fontsize=size, parse_math=False, figure=figure)
            box = drawn.get_window_extent(figure.canvas.get_renderer())  # type: ignore[attr-defined]
            room = 2.0 * _ROOM * size * figure.dpi / 72.0
            self._sizes[text, size] = math.ceil((box.width + room) / _PIXEL), math.ceil((box.height + room) / _PIXEL)
        return self._sizes[text, size]

    def take(self, text: str, place: Place) -> None:
        """Mark a text's rectangle as taken."""
        width, height = self.measure(text, place.size)
        rows, columns = np.indices(self.codes.shape)
        u, v = rotate(columns + 0.5 - place.x, rows + 0.5 - place.y, -place.angle)
        self.taken |= (np.abs(u) <= 0.5 * width) & (np.abs(v) <= 0.5 * height)

    @cached_property
    def border(self) -> Bools:
        """The pixels along the boundaries of regions."""
        border = np.zeros(self.codes.shape, np.bool_)
        border[1:] |= self.codes[1:] != self.codes[:-1]
        border[:, 1:] |= self.codes[:, 1:] != self.codes[:, :-1]
        return border


def rotate(x: Any, y: Any, degrees: float) -> tuple[Any, Any]:
    """Positions turned about the origin, anticlockwise."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return c * x - s * y, s * x + c * y


def corners_that_fit(mask: Bools, width: int, height: int) -> Bools:
    """Positions of the lower left corner of a rectangle that lies in the mask as a whole."""
    rows, columns = mask.shape[0] - height + 1, mask.shape[1] - width + 1
    if rows < 1 or columns < 1:
        return np.zeros((1, 1), np.bool_)
    fits: Bools = ndimage.minimum_filter(mask, (height, width), origin=(-(height // 2), -(width // 2)))
    return fits[:rows, :columns]


def write_beside(raster: Raster, points: Floats, texts: Sequence[str], size: float, radius: float) -> list[int]:
    """Write texts beside their points (n, 2) and over nothing else that is written; returns those without room.

    size, radius : of the texts and of the points, in points
    """
    unit = _PIXEL * 72.0 / raster.ax.get_figure(root=True).dpi  # type: ignore[union-attr]
    around = raster.pixels(points)
    reach = radius / unit
    for column, row in around.tolist():
        rows, columns = (slice(max(0, int(at - reach)), max(0, int(at + reach) + 1)) for at in (row, column))
        raster.taken[rows, columns] = True
    without = []
    for k, (text, (column, row)) in enumerate(zip(texts, around.tolist(), strict=True)):
        width, height = raster.measure(text, size)
        best, place = math.inf, None
        for rank, (away, (right, up)) in enumerate((away, side) for away in _FURTHER for side in _SIDES):
            left = round(column + right * (away * reach + 0.5 * width) - 0.5 * width)
            low = round(row + up * (away * reach + 0.5 * height) - 0.5 * height)
            window = np.s_[low : low + height, left : left + width]
            if min(left, low) < 0 or raster.taken[window].shape != (height, width) or raster.taken[window].any():
                continue
            cost = rank + 0.02 * np.count_nonzero(raster.border[window])  # a boundary through a text is a little worse
            if cost < best:
                best, place = cost, Place(left + 0.5 * width, low + 0.5 * height, size, 0.0)
        if place is None:
            without.append(k)
            continue
        box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.85, "edgecolor": "none"}
        _write(raster, text, place, gid="measured", bbox=box, zorder=7)
    return without


def write_names(raster: Raster, names: Sequence[str], sizes: Sequence[float] = SIZES, **look: Any) -> list[str]:
    """Write each name into its region, or beside it with a line; returns those that found no room, in order.

    sizes : that are tried; the small ones of a panel have no lines
    """
    codes = np.where(raster.taken, _NOWHERE, raster.codes)
    pointed: list[tuple[str, Bools]] = []
    written: set[str] = set()
    for code, name in enumerate(names):
        parts, count = ndimage.label(codes == code)
        boxes, areas = ndimage.find_objects(parts), np.bincount(parts.ravel(), minlength=count + 1)[1:]
        for rank, part in enumerate(np.argsort(-areas, kind="stable")[:_MOST_PARTS]):
            share = areas[part] / parts.size
            if rank and share < _SMALLEST_REPEAT:
                break
            place = _inside(raster, parts[boxes[part]] == part + 1, boxes[part], name, sizes)
            if place is not None:
                _write(raster, name, place, **look)
                written.add(name)
            elif not rank and share >= _SMALLEST_LEADER and sizes is SIZES:
                pointed.append((name, parts == part + 1))
    small = np.any([mask for _, mask in pointed], axis=0)
    for name, mask in pointed:
        if name not in written and _point_at(raster, mask, name, small & ~mask):
            written.add(name)
    return [name for name in names if name not in written]


def _inside(raster: Raster, mask: Bools, box: Any, text: str, sizes: Sequence[float]) -> Place | None:
    """The roomiest place for a text wholly inside a region, as large and as level as it can be.

    It is level, or along the region.

    mask, box : the region's pixels in its bounding box, and where that is
    """
    crop = np.pad(mask, 1)
    left, low = box[1].start - 1, box[0].start - 1
    slope = _slope(mask)
    for size in sizes:
        width, height = raster.measure(text, size)
        if mask.sum() < width * height:
            continue
        for angle in (0.0, slope) if abs(slope) > _STEEP else (0.0,):
            if (centre := roomiest(crop, width, height, angle)) is not None:
                return Place(left + centre[0], low + centre[1], size, angle)
    return None


def _slope(mask: Bools) -> float:
    """Angle of a region's longer axis of inertia, -90 to 90 degrees."""
    rows, columns = np.nonzero(mask)
    (xx, xy), (_, yy) = np.cov(columns, rows, ddof=0) if rows.size > 1 else np.zeros((2, 2))
    return math.degrees(0.5 * math.atan2(2.0 * xy, xx - yy))


def roomiest(mask: Bools, width: int, height: int, angle: float = 0.0) -> tuple[float, float] | None:
    """(x, y): the centre of a turned rectangle inside a mask that may be moved furthest in any direction."""
    turned = ndimage.rotate(mask.astype(np.uint8), angle, order=0) > 0 if angle else mask
    fits = corners_that_fit(turned, width, height)
    if not fits.any():
        return None
    room = ndimage.distance_transform_edt(np.pad(fits, 1))[1:-1, 1:-1]
    # Of many places as good, as along a band, the one nearest the region's middle.
    rows, columns = np.nonzero(room >= 0.93 * room.max())
    v, u = rows + 0.5 * (height - turned.shape[0]), columns + 0.5 * (width - turned.shape[1])  # from the middle
    nearest = np.argmin(np.hypot(u, v))
    x, y = rotate(u[nearest], v[nearest], angle)
    return float(x + 0.5 * mask.shape[1]), float(y + 0.5 * mask.shape[0])


def _write(raster: Raster, text: str, place: Place, **look: Any) -> None:
    """Write a text at its place, which it takes."""
    look = CENTRED | {"rotation": place.angle, "zorder": 5, "parse_math": False} | look
    raster.ax.text(*raster.data(place.x, place.y), text, fontsize=place.size, **look)
    raster.take(text, place)


def _point_at(raster: Raster, mask: Bools, text: str, avoid: Bools) -> bool:
    """Write a name beside a region too small for it, in the nearest free room, with a line to the region.

    avoid : other regions that are pointed at, which the line must not cross
    """
    blocked = raster.taken | ndimage.binary_dilation(avoid)
    depth = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    anchor = np.array([column + 0.5, row + 0.5])
    free = ~(ndimage.binary_dilation(raster.border) | raster.taken | mask)
    width, height = raster.measure(text, _LEADER_SIZE)
    rows, columns = np.nonzero(corners_that_fit(free, width, height))
    centres = np.column_stack([columns + 0.5 * width, rows + 0.5 * height])
    # A line from the side of a text reads better than one from above or below, and needs a little length to be seen.
    distance = np.hypot(*np.maximum(np.abs(centres - anchor) - 0.5 * np.array([width, height]), 0.0).T)
    distance[distance < 6.0] += 40.0
    for centre in centres[np.argsort(distance, kind="stable")[:4000:20]]:
        line = anchor + np.linspace(0.0, 1.0, 200)[:, None] * (centre - anchor)
        across, upward = np.floor(line.T).astype(np.intp)
        if blocked[upward, across].any():
            continue
        look = CENTRED | {"fontsize": _LEADER_SIZE, "arrowprops": _LEADER, "zorder": 5, "parse_math": False}
        raster.ax.annotate(text, raster.data(*anchor), raster.data(*centre), **look)
        raster.ax.plot(*raster.data(*anchor), "o", color=INK, markersize=2.6, zorder=5, gid="leader")
        raster.take(text, Place(float(centre[0]), float(centre[1]), _LEADER_SIZE, 0.0))
        raster.taken[upward, across] = True
        return True
    return False
