"""Pictures of maps for a page: the pixels, lines, dots and texts of the figures that `clunk plot` draws."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from contourpy import contour_generator
from matplotlib import colors
from matplotlib.cm import ScalarMappable
from scipy import ndimage

from clunk.plot.layers import Layers
from clunk.plot.network import codes_at
from clunk.plot.painting import Colours, margin_of
from clunk.plot.plane import View, cell_edges, ruler
from clunk.plot.raster import corners_that_fit, fine_index
from clunk.plot.style import FAILED_FILL, UNDEFINED, palette_of
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.regimemap import Results

Floats = npt.NDArray[np.float64]
Pixels = npt.NDArray[np.uint32]

_PIXELS = 640  # of an image, across and upward
_SKIP = 4  # of the image, between the pixels among which labels are placed
_WIDTH, _HEIGHT = 2, 5  # of these pixels, that a character of a label takes
_SHADES = 256


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
    edges : (columns + 1,) of a strip's bands
    lines : boundaries, each (n, 2), in the axes' units
    dots : (n, 2) undecided cells
    texts : label, x and y, of each that has room in its region
    legend : label, its colour and its share of the map
    shades : of a quantity
    curve : (n, 2) of a strip, the axis and the quantity
    """

    pixels: Pixels
    legend: list[tuple[str, str, str]]
    lines: list[Floats] = field(default_factory=list)
    dots: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    texts: list[tuple[str, float, float]] = field(default_factory=list)
    shades: Shades | None = None
    edges: Floats | None = None
    curve: Floats | None = None


def picture_of(results: Results, quantity: str, dimensions: int) -> Picture:
    """The picture of one lash's map over this many axes. Raises PlotError where the quantity has no value at all."""
    if quantity == "regimes":
        layers = Layers.of(results, dimensions)
    else:
        layers = Layers.of_quantity(results, dimensions, quantity)
        layers.require_values()
    return _map(layers) if dimensions == 2 else _strip(layers)


def _strip(layers: Layers) -> Picture:
    edges, codes = layers.bands
    values = layers.values if layers.quantity != "regimes" else np.full(layers.codes.shape, np.nan)
    return Picture(
        pixels=_label_colours(layers)[codes],
        legend=_legend(layers),
        edges=edges,
        curve=np.column_stack([layers.view.x.values, values]),
    )


def _map(layers: Layers) -> Picture:
    view = layers.view
    x, y = (_centres(axis.values[0], axis.values[-1], *ruler(axis)) for axis in view.axes)
    labels = _label_raster(layers, x, y)
    undecided = np.argwhere(layers.undecided)
    dots = np.column_stack([axis.values[at] for axis, at in zip(view.axes, undecided.T, strict=True)])
    lines, legend = _lines(layers), _legend(layers)
    if layers.quantity == "regimes":
        texts = _texts(labels, layers, x, y)
        return Picture(_label_colours(layers)[labels], legend, lines, dots, texts)
    shades = Colours.of(layers.described, layers.values)
    mappable = ScalarMappable(shades.norm, shades.cmap)
    edges = [cell_edges(axis) for axis in view.axes]
    columns, rows = (
        np.clip(np.searchsorted(edge, at) - 1, 0, len(edge) - 2) for edge, at in zip(edges, (x, y), strict=True)
    )
    values = layers.values[np.ix_(columns, rows)].T
    pixels = np.where(np.isnan(values), _packed(UNDEFINED), _packed_rows(mappable.to_rgba(values, bytes=True)))
    pixels[labels == FAILED_CODE] = _packed(FAILED_FILL)
    low, high = float(shades.norm.vmin or 0.0), float(shades.norm.vmax or 0.0)
    scale = [colors.to_hex(colour) for colour in np.asarray(mappable.to_rgba(np.linspace(low, high, _SHADES))).tolist()]
    bar = Shades(shades.label, low, high, scale, layers.has_dark_lines)
    return Picture(pixels.astype(np.uint32), legend, lines, shades=bar)


def _centres(first: float, last: float, to: Any, back: Any) -> Floats:
    """Centres of an image's pixels along an axis, in its unit."""
    edges = np.linspace(to(first), to(last), _PIXELS + 1)
    return np.asarray(back(0.5 * (edges[1:] + edges[:-1])), np.float64)


def _label_raster(layers: Layers, x: Floats, y: Floats) -> npt.NDArray[np.int16]:
    """Codes of the labels at the pixels, (rows, columns)."""
    view: View = layers.view
    if layers.boundaries is not None:
        columns, rows = (fine_index(at, axis, 1) for at, axis in zip((x, y), view.axes, strict=True))
        return codes_at(layers.boundaries, view, x, y, layers.codes[np.ix_(columns, rows)].T)
    columns, rows = map(fine_index, (x, y), view.axes, layers.regions.factor)
    return layers.regions.label[np.ix_(columns, rows)].T


def _lines(layers: Layers) -> list[Floats]:
    """The boundaries between the labels."""
    if layers.boundaries is not None:
        return [curve.vertices[:, layers.view.keep] for curve in layers.boundaries.curves]
    lines: list[Floats] = []
    present = layers.regions.present
    for code in present if len(present) > 1 else ():
        x, y, margin = margin_of(layers, code)
        if margin.min() < 0.0 < margin.max():
            lines += [np.asarray(line) for line in contour_generator(x, y, margin).lines(0.0)]
    return lines


def _texts(labels: npt.NDArray[np.int16], layers: Layers, x: Floats, y: Floats) -> list[tuple[str, float, float]]:
    """Labels in the roomiest part of their largest region, where they have room."""
    labels, x, y = labels[::_SKIP, ::_SKIP], x[::_SKIP], y[::_SKIP]
    texts = []
    for text in layers.present:
        parts, count = ndimage.label(labels == layers.labels.index(text))
        if not count:
            continue
        largest = 1 + int(np.argmax(np.bincount(parts.ravel())[1:]))
        rows, columns = ndimage.find_objects(parts)[largest - 1]
        width = _WIDTH * (len(text) + 1)
        fits = corners_that_fit(parts[rows, columns] == largest, width, _HEIGHT)
        if fits.any():
            room = ndimage.distance_transform_edt(np.pad(fits, 1))[1:-1, 1:-1]
            row, column = np.unravel_index(int(np.argmax(room)), room.shape)
            centre = columns.start + column + width // 2, rows.start + row + _HEIGHT // 2
            texts.append((text, float(x[centre[0]]), float(y[centre[1]])))
    return texts


def _legend(layers: Layers) -> list[tuple[str, str, str]]:
    palette, cells = palette_of(layers.labels), layers.codes.size
    counts = {label: layers.count(label) for label in layers.present}
    legend = [(label, palette[label], f"{100.0 * count / cells:.3g} %") for label, count in counts.items()]
    failed = int(np.count_nonzero(layers.failed))
    return [*legend, (FAILED, FAILED_FILL, f"{100.0 * failed / cells:.3g} %")] if failed else legend


def _label_colours(layers: Layers) -> Pixels:
    """Colour of each code, and last of the code of failed cells, -1."""
    palette = palette_of(layers.labels)
    return np.array([_packed(palette[label]) for label in layers.labels] + [_packed(FAILED_FILL)], np.uint32)


def _packed(colour: str) -> int:
    """A colour as the four bytes of a pixel: red, green, blue, opaque."""
    return int(_packed_rows(np.array([[*colors.to_rgba_array(colour)[0] * 255.0]]).round().astype(np.uint8))[0])


def _packed_rows(rgba: npt.NDArray[np.uint8]) -> Pixels:
    """Pixels of (…, 4) bytes."""
    return np.ascontiguousarray(rgba).view("<u4")[..., 0].astype(np.uint32)
