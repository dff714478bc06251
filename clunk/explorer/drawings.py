"""Pictures of maps as `clunk plot` draws them: traced boundaries or cells, names where they fit, quantities."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from matplotlib import colors
from matplotlib.cm import ScalarMappable
from scipy import ndimage

from clunk.explorer.pictures import Picture, Pixels, Shades, legend_of, packed, pixel_centres
from clunk.plot.labelling import corners_that_fit
from clunk.plot.layers import Layers
from clunk.plot.maps import Colours
from clunk.plot.plane import cells_of
from clunk.plot.style import FAILED_FILL, UNDEFINED
from clunk.results.labels import FAILED_CODE
from clunk.results.tolerancemap import AnyMap
from clunk.study.arrays import Floats

_SKIP = 4  # of the image, between the pixels among which names are placed
_WIDTH, _HEIGHT = 2, 5  # of these pixels, that a character of a name takes
_SHADES = 256


def picture_of(results: AnyMap, quantity: str, dimensions: int) -> Picture:
    """The picture of one lash's map over this many axes. Raises PlotError where the quantity has no value at all."""
    layers = Layers.of(results, dimensions, quantity)
    return _map(layers) if dimensions == 2 else _strip(Layers.of(results, 1), layers)


def _strip(regimes: Layers, layers: Layers) -> Picture:
    edges, codes = regimes.bands
    values = np.full(regimes.codes.shape, np.nan) if layers.values is None else layers.values
    return Picture(
        pixels=_region_colours(regimes)[codes],
        legend=_legend(regimes),
        edges=edges,
        curve=np.column_stack([layers.view.x.values, values]),
        peak=_peak(layers),
    )


def _map(layers: Layers) -> Picture:
    view = layers.view
    x, y = (pixel_centres(axis) for axis in view.axes)
    regions = layers.codes_at(x, y)
    columns, rows = (cells_of(axis, at) for axis, at in zip(view.axes, (x, y), strict=True))
    if not layers.shaded:
        pixels = _region_colours(layers)[regions]
        if layers.paint is not None:
            opaque = np.full((*layers.paint.shape[:2], 4), 255, np.uint8)
            opaque[..., :3] = layers.paint
            pixels = _packed_rows(opaque)[np.ix_(columns, rows)].T
        return Picture(pixels, _legend(layers), layers.lines, layers.doubts, _texts(regions, layers, x, y))
    assert layers.values is not None
    shades = Colours.of(layers)
    mappable = ScalarMappable(shades.norm, shades.cmap)
    values = layers.values[np.ix_(columns, rows)].T
    pixels = np.where(np.isnan(values), packed(UNDEFINED), _packed_rows(mappable.to_rgba(values, bytes=True)))
    pixels[regions == FAILED_CODE] = packed(FAILED_FILL)
    low, high = float(shades.norm.vmin or 0.0), float(shades.norm.vmax or 0.0)
    scale = [colors.to_hex(colour) for colour in np.asarray(mappable.to_rgba(np.linspace(low, high, _SHADES))).tolist()]
    bar = Shades(shades.label, low, high, scale, not layers.has_light_lines)
    return Picture(pixels.astype(np.uint32), _legend(layers), layers.lines, shades=bar, peak=_peak(layers))


def _peak(layers: Layers) -> tuple[float, ...] | None:
    """The largest value of a quantity, and those of the axes in its cell."""
    if layers.values is None:
        return None
    at = np.unravel_index(int(np.nanargmax(layers.values)), layers.values.shape)
    return (float(layers.values[at]), *(float(axis.values[k]) for axis, k in zip(layers.view.axes, at, strict=True)))


def _texts(labels: npt.NDArray[np.int16], layers: Layers, x: Floats, y: Floats) -> list[tuple[str, float, float]]:
    """Names in the roomiest part of their largest region, where they have room."""
    labels, x, y = labels[::_SKIP, ::_SKIP], x[::_SKIP], y[::_SKIP]
    texts = []
    for text in layers.seen:
        parts, count = ndimage.label(labels == layers.names.index(text))
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
    return legend_of(layers.names, layers.colours, layers.shares)


def _region_colours(layers: Layers) -> Pixels:
    """Colour of each region, and last that of failed cells."""
    return np.array([packed(colour) for colour in (*layers.colours, FAILED_FILL)], np.uint32)


def _packed_rows(rgba: npt.NDArray[np.uint8]) -> Pixels:
    """Pixels of (…, 4) bytes."""
    return np.ascontiguousarray(rgba).view("<u4")[..., 0].astype(np.uint32)
