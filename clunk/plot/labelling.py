"""Labels of a map: within their regions, beside these with a line to them, or else in the notes under the map."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import ndimage

from clunk.plot.layers import Layers
from clunk.plot.notes import failed_notes, label_notes, note_columns, set_notes, undecided_notes
from clunk.plot.raster import Place, Raster, centres_that_fit, corners_that_fit, rotate
from clunk.plot.style import CENTRED, INK, freeze_layout
from clunk.study.arrays import Bools

# What is tried in turn: size in points, and whether the text may be turned.
_SETTINGS = ((10.5, False), (9.5, False), (9.5, True), (8.5, False), (8.5, True), (8.0, False), (8.0, True))
_ANGLES = tuple(angle for step in range(1, 10) for angle in (10.0 * step, -10.0 * step))[:-1]
_LEADER_SIZE = 8.5
_LEADER = {"arrowstyle": "-", "color": INK, "linewidth": 0.8, "shrinkA": 0.0, "shrinkB": 0.0}
_SMALLEST_LEADER = 2e-4  # of the map's area: a smaller region is only noted, a leader would point at nothing
_SMALLEST_REPEAT = 1e-3  # of the map's area: a further region of a label that has its text already
_MOST_PARTS = 4  # regions of one label that are looked at, the largest first
_MOST_NOTES = 24
_MOST_ROWS = 8  # of notes: more would leave no map


def label_and_note(figure: Figure, ax: Axes, layers: Layers, more: Sequence[Artist] = ()) -> None:
    """Write the labels into their regions, and under the axes those that find no room, marks of cells and `more`.

    The notes take height from the map, and less of it then fits: laid out again until the notes are the same.
    """

    def notes(labels: list[str]) -> list[Artist]:
        swatches = label_notes(layers, labels, _MOST_NOTES, counted=True)
        if swatches and len(swatches) > (room := _MOST_ROWS * note_columns(figure, swatches)):
            swatches = label_notes(layers, labels, room - 1, counted=True)
        return [*swatches, *failed_notes(layers.failed), *undecided_notes(layers.undecided), *more]

    noted: set[str] = set()
    unlabelled: list[str] = []
    for _ in range(4):
        in_order = [label for label in layers.labels if label in noted]
        unlabelled = settle(figure, ax, layers, notes(in_order))
        if noted.issuperset(unlabelled):
            break
        noted.update(unlabelled)
    if noted != set(unlabelled):  # a label that found room in the end; the row keeps its height
        set_notes(figure, notes(unlabelled))


def settle(
    figure: Figure,
    ax: Axes,
    layers: Layers,
    notes: Sequence[Artist],
    prepare: Callable[[Raster], None] = lambda raster: None,
) -> list[str]:
    """Lay the figure out with these notes under the map, then write the regions' labels; returns those without room.

    prepare : called with the map as pixels before labels are written
    """
    for artist in [*ax.texts, *(line for line in ax.lines if line.get_gid() == "leader")]:
        artist.remove()
    set_notes(figure, notes)
    freeze_layout(figure, ax)
    prepare(raster := Raster.of(ax, layers))
    unlabelled = label_regions(raster, layers.labels, leaders=len(layers.view.axes) > 1)
    return [label for label in unlabelled if label in layers.present]


def label_regions(
    raster: Raster, labels: tuple[str, ...], *, leaders: bool, settings: Sequence[tuple[float, bool]] = _SETTINGS
) -> list[str]:
    """Write each label into its region; returns, in order, those that found no room.

    settings : what is tried in turn, each a size in points and whether the text may be turned
    """
    pointed: list[tuple[str, Bools]] = []
    written: set[str] = set()
    for code, text in enumerate(labels):
        parts, count = ndimage.label(raster.label == code)
        areas = np.bincount(parts.ravel(), minlength=count + 1)[1:]
        for rank, part in enumerate(np.argsort(-areas, kind="stable")[:_MOST_PARTS] + 1):
            share = areas[part - 1] / parts.size
            if rank and share < _SMALLEST_REPEAT:
                break
            mask = parts == part
            place = _inside(raster, mask, text, settings)
            if place is not None:
                _write(raster, text, place)
                written.add(text)
            elif leaders and share >= _SMALLEST_LEADER:
                pointed.append((text, mask))
    small = np.any([mask for _, mask in pointed], axis=0)
    for text, mask in pointed:
        if _point_at(raster, mask, text, small & ~mask):
            written.add(text)
    return [label for label in labels if label not in written]


def _inside(raster: Raster, mask: Bools, text: str, settings: Sequence[tuple[float, bool]]) -> Place | None:
    """The roomiest place for a text wholly inside a region, as large and as level as it can be."""
    rows, columns = ndimage.find_objects(mask.astype(np.int8))[0]
    crop = np.pad(mask[rows, columns], 1)
    x0, y0 = columns.start - 1, rows.start - 1
    for size, turned in settings:
        width, height = raster.measure(text, size)
        fits = [(_roomiest(crop, width, height, angle), angle) for angle in (_ANGLES if turned else (0.0,))]
        scored = [(fit[0] - 0.03 * abs(angle), fit, angle) for fit, angle in fits if fit]  # steep must be worth it
        if scored:
            _, (_, x, y), angle = max(scored, key=operator.itemgetter(0))
            return Place(x0 + x, y0 + y, size, angle)
    return None


def _roomiest(mask: Bools, width: int, height: int, angle: float) -> tuple[float, float, float] | None:
    """(room, x, y): the centre of a turned rectangle inside a mask that may be moved furthest in any direction."""
    if angle == 0.0:
        turned = mask
    else:
        reach = math.hypot(*mask.shape) / 2
        count = 2 * math.ceil(reach)
        v, u = np.indices((count, count)) + 0.5 - count / 2
        x, y = rotate(u, v, angle)
        column = np.floor(x + mask.shape[1] / 2).astype(np.intp)
        row = np.floor(y + mask.shape[0] / 2).astype(np.intp)
        within = (column >= 0) & (column < mask.shape[1]) & (row >= 0) & (row < mask.shape[0])
        turned = np.zeros((count, count), np.bool_)
        turned[within] = mask[row[within], column[within]]
    fits = corners_that_fit(turned, width, height)
    if not fits.any():
        return None
    room = ndimage.distance_transform_edt(np.pad(fits, 1))[1:-1, 1:-1]
    # Of many places as good, as along a band, the one nearest the region's middle.
    middle = ndimage.center_of_mass(turned)
    rows, columns = np.nonzero(room >= 0.93 * room.max())
    nearest = np.argmin(np.hypot(rows + 0.5 * height - middle[0] - 0.5, columns + 0.5 * width - middle[1] - 0.5))
    row, column = rows[nearest], columns[nearest]
    u, v = column + 0.5 * width, row + 0.5 * height  # from the rectangle's corner to its centre
    x, y = rotate(u - turned.shape[1] / 2, v - turned.shape[0] / 2, angle)
    return float(room.max()), float(x + mask.shape[1] / 2), float(y + mask.shape[0] / 2)


def _write(raster: Raster, text: str, place: Place) -> None:
    """Write a text at its place, which it takes."""
    x, y = raster.data(place.x, place.y)
    raster.ax.text(x, y, text, fontsize=place.size, rotation=place.angle, parse_math=False, zorder=5, **CENTRED)
    raster.take(text, place)


def _point_at(raster: Raster, mask: Bools, text: str, avoid: Bools) -> bool:
    """Write a label beside a region too small for it, in the nearest free room, with a line to the region.

    avoid : other regions that are pointed at, which the line must not cross
    """
    blocked = raster.taken | ndimage.binary_dilation(avoid)
    depth = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
    anchor = np.array([column + 0.5, row + 0.5])
    # Free is what no text has taken and no boundary crosses.
    free = ~(ndimage.binary_dilation(raster.border()) | raster.taken | mask)
    width, height = raster.measure(text, _LEADER_SIZE)
    centres = centres_that_fit(free, width, height)
    # A line from the side of a text reads better than one from above or below, and needs a little length to be seen.
    gap = np.maximum(np.abs(centres - anchor) - 0.5 * np.array([width, height]), 0.0)
    distance = np.hypot(*gap.T)
    distance[distance < 6.0] += 40.0
    for index in np.argsort(distance, kind="stable")[:4000:20]:
        centre = centres[index]
        line = anchor + np.linspace(0.0, 1.0, 200)[:, None] * (centre - anchor)
        column_, row_ = np.floor(line.T).astype(np.intp)
        if blocked[row_, column_].any():
            continue
        look = CENTRED | {"fontsize": _LEADER_SIZE, "arrowprops": _LEADER, "zorder": 5}
        raster.ax.annotate(text, raster.data(*anchor), raster.data(*centre), parse_math=False, **look)
        raster.ax.plot(*raster.data(*anchor), "o", color=INK, markersize=2.6, zorder=5, gid="leader")
        raster.take(text, Place(float(centre[0]), float(centre[1]), _LEADER_SIZE, 0.0))
        raster.taken[row_, column_] = True
        return True
    return False
