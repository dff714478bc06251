"""Pictures of maps as `clunk plot` draws them: smooth or traced boundaries, labels where they fit, quantities."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from contourpy import contour_generator
from matplotlib import colors
from matplotlib.cm import ScalarMappable
from scipy import ndimage

from clunk.explorer.pictures import Picture, Pixels, Shades, cells_of, label_colours, legend_of, packed, pixel_centres
from clunk.plot import certainty
from clunk.plot.layers import Layers
from clunk.plot.network import codes_at
from clunk.plot.painting import Colours, margin_of
from clunk.plot.raster import corners_that_fit, fine_index
from clunk.plot.style import FAILED_FILL, UNDEFINED
from clunk.results.labels import FAILED_CODE
from clunk.results.tolerancemap import AnyMap, ToleranceMap
from clunk.study.arrays import Floats

_SKIP = 4  # of the image, between the pixels among which labels are placed
_WIDTH, _HEIGHT = 2, 5  # of these pixels, that a character of a label takes
_SHADES = 256


def picture_of(results: AnyMap, quantity: str, dimensions: int) -> Picture:
    """The picture of one lash's map over this many axes. Raises PlotError where the quantity has no value at all."""
    paleness, colours = None, None
    if isinstance(results, ToleranceMap):
        if quantity == "regimes":
            layers = certainty.likely_layers(results, dimensions)
            paleness = layers.view.arrange(certainty.paleness(results.certainty))
        else:
            layers, colours = certainty.layers_of_quantity(results, dimensions, quantity)
    elif quantity == "regimes":
        layers = Layers.of(results, dimensions)
    else:
        layers = Layers.of_quantity(results, dimensions, quantity)
        layers.require_values()
        colours = Colours.of(layers.described, layers.values)
    return _map(layers, colours, paleness) if dimensions == 2 else _strip(layers)


def _strip(layers: Layers) -> Picture:
    edges, codes = layers.bands
    first = np.flatnonzero(np.diff(codes, prepend=codes[0] - 1))  # of the bands of a label that lie side by side
    edges, codes = np.append(edges[first], edges[-1]), codes[first]
    values = layers.values if layers.quantity != "regimes" else np.full(layers.codes.shape, np.nan)
    return Picture(
        pixels=label_colours(layers.labels)[codes],
        legend=_legend(layers),
        edges=edges,
        curve=np.column_stack([layers.view.x.values, values]),
        peak=_peak(layers),
    )


def _map(layers: Layers, shades: Colours | None, paleness: Floats | None) -> Picture:
    view = layers.view
    x, y = (pixel_centres(axis) for axis in view.axes)
    labels = _label_raster(layers, x, y)
    undecided = np.argwhere(layers.undecided)
    dots = np.column_stack([axis.values[at] for axis, at in zip(view.axes, undecided.T, strict=True)])
    lines, legend = _lines(layers), _legend(layers)
    columns, rows = (cells_of(axis, at) for axis, at in zip(view.axes, (x, y), strict=True))
    if shades is None:
        pixels, texts = label_colours(layers.labels)[labels], _texts(labels, layers, x, y)
        if paleness is not None:
            pixels = _whitened(pixels, paleness[np.ix_(columns, rows)].T)
        return Picture(pixels, legend, lines, dots, texts)
    mappable = ScalarMappable(shades.norm, shades.cmap)
    values = layers.values[np.ix_(columns, rows)].T
    pixels = np.where(np.isnan(values), packed(UNDEFINED), _packed_rows(mappable.to_rgba(values, bytes=True)))
    pixels[labels == FAILED_CODE] = packed(FAILED_FILL)
    low, high = float(shades.norm.vmin or 0.0), float(shades.norm.vmax or 0.0)
    scale = [colors.to_hex(colour) for colour in np.asarray(mappable.to_rgba(np.linspace(low, high, _SHADES))).tolist()]
    bar = Shades(shades.label, low, high, scale, layers.has_dark_lines)
    return Picture(pixels.astype(np.uint32), legend, lines, shades=bar, peak=_peak(layers))


def _peak(layers: Layers) -> tuple[float, ...] | None:
    """The largest value of a quantity, and those of the axes in its cell."""
    if layers.quantity == "regimes":
        return None
    at = np.unravel_index(int(np.nanargmax(layers.values)), layers.values.shape)
    return (float(layers.values[at]), *(float(axis.values[k]) for axis, k in zip(layers.view.axes, at, strict=True)))


def _label_raster(layers: Layers, x: Floats, y: Floats) -> npt.NDArray[np.int16]:
    """Codes of the labels at the pixels, (rows, columns)."""
    view = layers.view
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
    drawn = () if layers.boundaries is None else layers.boundaries.region_label.tolist()
    return legend_of(layers.labels, layers.codes, drawn)


def _whitened(pixels: Pixels, amounts: Floats) -> Pixels:
    """Pixels taken towards white by these amounts, 0 to 1."""
    rgba = np.ascontiguousarray(pixels).view(np.uint8).reshape(*pixels.shape, 4)
    return _packed_rows((rgba + amounts[..., None] * (255.0 - rgba)).astype(np.uint8))


def _packed_rows(rgba: npt.NDArray[np.uint8]) -> Pixels:
    """Pixels of (…, 4) bytes."""
    return np.ascontiguousarray(rgba).view("<u4")[..., 0].astype(np.uint32)
