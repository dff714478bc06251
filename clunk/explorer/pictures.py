"""Pictures of maps for a page, of the layers that `clunk plot` draws: pixels, lines, dots, names and a colour bar."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from clunk.plot.labelling import roomiest
from clunk.plot.layers import Layers
from clunk.plot.plane import Codes, cells_of, ruler
from clunk.plot.style import FAILED_FILL
from clunk.results.labels import FAILED
from clunk.results.tolerancemap import AnyMap
from clunk.study.arrays import Floats
from clunk.study.axes import ResultAxis

Pixels = npt.NDArray[np.uint32]

_PIXELS = 640  # of an image, across and upward
_SKIP = 4  # of the image, between the pixels among which names are placed
_WIDTH, _HEIGHT = 2, 5  # of these pixels, that a character of a name takes
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

    legend : label, its colour and its share of the map
    pixels : (rows, columns) uint32, colours of a map from below, evenly spaced along its axes as they are scaled
    bands, edges : colours of a strip's bands, and (bands + 1,) where the label changes
    lines : boundaries, each (n, 2), in the axes' units
    dots : (n, 2) undecided cells
    texts : label, x and y, of each that has room in its region
    shades : of a quantity
    curve : (n, 2) of a strip, the axis and the quantity
    peak : the largest value of a quantity, and those of the axes in its cell
    """

    legend: list[tuple[str, str, str]]
    pixels: Pixels = field(default_factory=lambda: np.zeros((0, 0), np.uint32))
    lines: list[Floats] = field(default_factory=list)
    dots: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    texts: list[tuple[str, float, float]] = field(default_factory=list)
    shades: Shades | None = None
    bands: list[str] = field(default_factory=list)
    edges: Floats = field(default_factory=lambda: np.zeros(0))
    curve: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    peak: tuple[float, ...] | None = None


def picture_of(results: AnyMap, quantity: str, dimensions: int) -> Picture:
    """The picture of one lash's map over this many axes. Raises PlotError where the quantity has no value at all."""
    layers = Layers.of(results, dimensions, quantity)
    return _map(layers) if dimensions == 2 else _strip(Layers.of(results, 1), layers)


def _strip(regimes: Layers, layers: Layers) -> Picture:
    edges, codes = regimes.bands
    values = np.full(regimes.codes.shape, np.nan) if layers.values is None else layers.values
    return Picture(
        legend=_legend(regimes),
        bands=[(*regimes.colours, FAILED_FILL)[code] for code in codes],
        edges=edges,
        curve=np.column_stack([layers.view.x.values, values]),
        peak=_peak(layers),
    )


def _map(layers: Layers) -> Picture:
    x, y = (_pixel_centres(axis) for axis in layers.view.axes)
    regions = layers.codes_at(x, y)
    cells = np.ix_(*(cells_of(axis, at) for axis, at in zip(layers.view.axes, (x, y), strict=True)))
    shades, texts, peak = None, [], None
    pixels = np.full((*regions.shape, 4), 255, np.uint8)
    if layers.shaded:
        shades, pixels[..., :3] = _shades(layers, cells)
        peak = _peak(layers)
    else:
        colours = np.array([list(bytes.fromhex(each[1:])) for each in (*layers.colours, FAILED_FILL)], np.uint8)
        pixels[..., :3] = colours[regions] if layers.paint is None else layers.paint[cells].swapaxes(0, 1)
        texts = _texts(regions, layers, x, y)
    packed = pixels.view("<u4")[..., 0].astype(np.uint32)
    return Picture(_legend(layers), packed, layers.lines, layers.doubts, texts, shades, peak=peak)


def _shades(layers: Layers, cells: tuple[npt.NDArray[np.intp], ...]) -> tuple[Shades, npt.NDArray[np.uint8]]:
    """The colour bar of a quantity, and the colours (y, x, 3) of these cells."""
    from matplotlib.colors import to_hex  # the first picture, of regimes, does not wait for it

    from clunk.plot.maps import cell_colours, shades_of

    shades = shades_of([layers])
    low, high = shades.get_clim()
    assert low is not None
    assert high is not None
    scale = [to_hex(colour) for colour in np.asarray(shades.to_rgba(np.linspace(low, high, _SHADES))).tolist()]
    painted = np.rint(cell_colours(layers, shades)[cells].swapaxes(0, 1)).astype(np.uint8)
    return Shades(layers.value_label, low, high, scale, not layers.has_light_lines), painted


def _peak(layers: Layers) -> tuple[float, ...] | None:
    """The largest value of a quantity, and those of the axes in its cell."""
    if layers.values is None:
        return None
    at = np.unravel_index(int(np.nanargmax(layers.values)), layers.values.shape)
    return (float(layers.values[at]), *(float(axis.values[k]) for axis, k in zip(layers.view.axes, at, strict=True)))


def _texts(regions: Codes, layers: Layers, x: Floats, y: Floats) -> list[tuple[str, float, float]]:
    """Names in the roomiest part of their largest region, where they have room."""
    regions, x, y = regions[::_SKIP, ::_SKIP], x[::_SKIP], y[::_SKIP]
    texts = []
    for text in layers.seen:
        parts, count = ndimage.label(regions == layers.names.index(text))
        if not count:
            continue
        largest = 1 + int(np.argmax(np.bincount(parts.ravel())[1:]))
        rows, columns = ndimage.find_objects(parts)[largest - 1]
        centre = roomiest(parts[rows, columns] == largest, _WIDTH * (len(text) + 1), _HEIGHT)
        if centre is not None:
            at = columns.start + int(centre[0]), rows.start + int(centre[1])
            texts.append((text, float(x[at[0]]), float(y[at[1]])))
    return texts


def _pixel_centres(axis: ResultAxis) -> Floats:
    """Centres of an image's pixels along an ascending axis, in its unit."""
    to, back = ruler(axis)
    edges = np.linspace(to(axis.values[0]), to(axis.values[-1]), _PIXELS + 1)
    return np.asarray(back(0.5 * (edges[1:] + edges[:-1])), np.float64)


def _legend(layers: Layers) -> list[tuple[str, str, str]]:
    """Regions that are large enough to be seen, each with its share of the map; the last share is of failed cells."""
    seen = {*layers.seen, FAILED}
    entries = zip((*layers.names, FAILED), (*layers.colours, FAILED_FILL), layers.shares.tolist(), strict=True)
    return [(name, colour, f"{100.0 * share:.3g} %") for name, colour, share in entries if share and name in seen]
