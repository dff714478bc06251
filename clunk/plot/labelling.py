"""Placement of texts on a map: names within their regions, measured labels beside their points."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from PIL import Image
from scipy import ndimage

from clunk.plot.layers import Layers, Measured
from clunk.plot.style import CENTRED
from clunk.study.arrays import Bools, Floats, LabelCodes

_PIXEL = 2.0  # display pixels per raster pixel; a finer raster would only be slower
_NOWHERE = -2  # code of pixels that are taken: it is no region's, so that no name is written there
_ROOM = 0.22  # margin around a text, as a share of its font size
# Sides of its point on which a text may stand, (right, up), in the order in which they are tried: right, left, above,
# below, and then the four diagonals.
_SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1))


@dataclass
class Raster:
    """Raster of a map's axes as they are laid out on the page; its rows go upwards.

    codes : (height, width) region of each pixel
    taken : (height, width) whether a measured label or its point covers the pixel
    """

    ax: Axes
    codes: LabelCodes
    taken: Bools

    @classmethod
    def of(cls, ax: Axes, layers: Layers) -> "Raster":
        """Raster of the regions of a map as they are drawn; those of a strip reach over its whole height."""
        box, to_data = ax.get_window_extent(), ax.transData.inverted().transform
        across, upward = (np.arange(0.5 * _PIXEL, side, _PIXEL) for side in (box.width, box.height))
        x = to_data(np.column_stack([box.x0 + across, np.full(across.size, box.y0)]))[:, 0]
        y = to_data(np.column_stack([np.full(upward.size, box.x0), box.y0 + upward]))[:, 1]
        codes = layers.codes_at(x, y)
        return cls(ax, codes, np.zeros(codes.shape, bool))

    def pixels(self, values: Floats) -> Floats:
        """Raster columns and rows (n, 2) of data coordinates (n, 2)."""
        box = self.ax.get_window_extent()
        return (self.ax.transData.transform(values) - [box.x0, box.y0]) / _PIXEL

    def measure(self, text: str, size: float) -> tuple[int, int]:
        """Width and height of a text with the margin around it, in raster pixels; size : of the font, in points."""
        canvas: Any = self.ax.figure.canvas
        width, height, _ = canvas.get_renderer().get_text_width_height_descent(text, FontProperties(size=size), False)
        room = 2.0 * _ROOM * size * self.ax.figure.dpi / 72.0
        return math.ceil((width + room) / _PIXEL), math.ceil((height + room) / _PIXEL)

    def write(self, text: str, x: float, y: float, size: float, **look: Any) -> None:
        """Write a text with its centre at (x, y) in raster pixels; size : of the font, in points."""
        box = self.ax.get_window_extent()
        across, upward = self.ax.transData.inverted().transform((box.x0 + x * _PIXEL, box.y0 + y * _PIXEL))
        self.ax.text(across, upward, text, fontsize=size, **CENTRED | {"zorder": 5, "parse_math": False} | look)


def write_beside(raster: Raster, points: Sequence[Measured], size: float, radius: float) -> bool:
    """Write each measured label beside its point, where it covers no other label or point.

    size, radius : font size of the labels and radius of the points, in typographic points

    Returns whether any label had no room and was left out.
    """
    around = raster.pixels(np.array([(point.x, point.y) for point in points]).reshape(-1, 2)).tolist()
    reach = radius * raster.ax.figure.dpi / 72.0 / _PIXEL

    def window(x: float, y: float, width: float, height: float) -> Bools:
        left, low = round(x - 0.5 * width), round(y - 0.5 * height)
        return raster.taken[max(0, low) : max(0, low + round(height)), max(0, left) : max(0, left + round(width))]

    for x, y in around:
        window(x, y, 2.0 * reach, 2.0 * reach)[:] = True
    is_crowded = False
    box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.85, "edgecolor": "none"}
    for point, (column, row) in zip(points, around, strict=True):
        width, height = raster.measure(point.label, size)
        for right, up in _SIDES:
            x, y = column + right * (reach + 0.5 * width), row + up * (reach + 0.5 * height)
            free = window(x, y, width, height)
            if free.shape == (height, width) and not free.any():
                free[:] = True
                raster.write(point.label, x, y, size, gid="measured", bbox=box, zorder=7)
                break
        else:
            is_crowded = True
    return is_crowded


def write_names(raster: Raster, names: Sequence[str], sizes: Sequence[float]) -> list[str]:
    """Write each name into its region, in the first of the sizes that has room, level or else turned along the region.

    names : of the regions, in the order of their codes
    sizes : font sizes to try, in points, the largest first

    Returns the names that had no room in any size.
    """
    codes, without = np.where(raster.taken, _NOWHERE, raster.codes), []
    for code, name in enumerate(names):
        for size, is_along in product(sizes, (False, True)):
            place = roomiest(codes == code, *raster.measure(name, size), is_along=is_along)
            if place is not None:
                x, y, angle = place
                raster.write(name, x, y, size, rotation=angle)
                break
        else:
            without.append(name)
    return without


def roomiest(mask: Bools, width: int, height: int, *, is_along: bool = False) -> tuple[float, float, float] | None:
    """Place for a rectangle of given size within a mask, with the widest margin on all sides.

    mask : (rows, columns), True inside
    width, height : of the rectangle, in pixels of the mask
    is_along : whether the rectangle is turned along the mask's longer principal axis; otherwise it is level

    Returns the rectangle's centre, x in columns and y in rows, and its angle in degrees; None where it has no room.
    """
    if not mask.any():
        return None
    turned, angle = mask, 0.0
    if is_along:
        rows, columns = mask.nonzero()
        (xx, xy), (_, yy) = np.cov(columns, rows, ddof=0)
        angle = math.degrees(0.5 * math.atan2(2.0 * xy, xx - yy))
        turned = np.asarray(Image.fromarray(mask).rotate(angle, expand=True))
    # At each pixel, 1 plus the number of pixels by which a rectangle centred there may grow; 0 where it has no room.
    room = ndimage.minimum_filter(turned, (height, width), mode="constant")
    margins = ndimage.distance_transform_cdt(np.pad(room, 1), "chessboard")[1:-1, 1:-1]
    if not margins.any():
        return None
    # Along a band many places have nearly the widest margin: of these, take the one nearest their mean.
    good = margins > int(0.93 * (margins.max() - 1))
    places = np.argwhere(good)[:, ::-1] + 0.5 * (np.array([width, height]) % 2 - turned.shape[::-1])
    u, v = places[np.hypot(*(places - places.mean(axis=0)).T).argmin()]
    c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
    return c * u - s * v + 0.5 * mask.shape[1], s * u + c * v + 0.5 * mask.shape[0], angle
