"""Layers of a drawn map: its regions with their colours, the values of a quantity, lines, marks and texts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from matplotlib.colors import to_rgba_array
from PIL import Image, ImageDraw
from scipy.ndimage import morphological_gradient

from clunk.core.status import QUALITY_UNDECIDED
from clunk.plot.plane import View, cell_edges, cells_of, value_text
from clunk.plot.style import FAILED_FILL, UNDEFINED, PlotError, colour_of, group_colour, shades
from clunk.results.boundaries import Boundaries
from clunk.results.labels import FAILED, FAILED_CODE, double_sided
from clunk.results.maps import CERTAIN, AnyMap, ToleranceMap
from clunk.results.quantities import LABEL, TEXT, WHY_UNDEFINED, YES_NO, Quantity, quantity_of
from clunk.study.arrays import Array, Bools, Floats, LabelCodes
from clunk.study.axes import ResultAxis
from clunk.study.loads import STEP_KEYS
from clunk.study.records import counted

MOST_LABELS = 16  # regions with a colour each; more labels are grouped by their number of double-sided impacts
_SEEN = 5e-6  # share of a map's area, some pixels: a smaller region has no name, a smaller island no line
_MOST_STEPS = 40_000  # most cell edges drawn as lines between regions: more would cover the map like a veil
# Certainties of a label, and how far each takes its colour towards white (0 to 1), linear in between.
_FADES = (0.5, CERTAIN), (0.8, 0.3)


class Measured(NamedTuple):
    """A measured label at a point of a map, in the axes' units, and whether the computed label there agrees with it."""

    x: float
    y: float
    label: str
    agrees: bool


class Note(NamedTuple):
    """A text in the notes under a figure, and the colour of the swatch before it; empty for no swatch."""

    text: str
    colour: str


@dataclass(frozen=True, eq=False)
class Layers:
    """Parts of a map as they are drawn over ascending axes: regions, and the values of a quantity that is a number.

    title : str
    load : str, the load in words
    view : View, the axes
    quantity : Quantity
    names, colours : of the regions, which are labels, groups of labels, or values of a quantity such as yes and no
    codes : int16, region of each cell: (nx, ny), of a strip (nx,), of points (cells,) in C order; -1 failed
    regions_of : (labels + 1,) int16, region of each label code of the boundaries; last -1, for failed cells
    boundaries : Boundaries, if they have been traced; only curves between two different regions are drawn
    undecided : bool, shape of `codes`: cells of a regime map's grid whose label is undecided (`QUALITY_UNDECIDED`), if
        another label could be in another region
    unresolved : (n, axes) float64, places where the tracing left boundaries unresolved, in the axes' units
    values : float64, shape of `codes`, NaN where the quantity is not known; empty where it is the label
    value_label : name of the values beside an axis or a colour bar
    shaded : whether cells have the colours of their values instead of their regions' colours
    paint : (nx, ny, 3) float64, 0 to 255, colours of the cells instead of their regions' colours, if any
    points : measured labels
    notes : further notes under the figure
    facts : phrases for the line under the title
    caveats : phrases on what the map does not tell, which come after the facts
    """

    title: str
    load: str
    view: View
    quantity: Quantity
    names: tuple[str, ...]
    colours: tuple[str, ...]
    codes: LabelCodes
    regions_of: LabelCodes
    boundaries: Boundaries | None
    undecided: Bools
    unresolved: Floats
    values: Floats
    value_label: str
    shaded: bool = False
    paint: Floats | None = None
    points: tuple[Measured, ...] = ()
    notes: tuple[Note, ...] = ()
    facts: tuple[str, ...] = ()
    caveats: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, drawn: AnyMap, view: View, quantity: str = LABEL, most: int = MOST_LABELS, among: AnyMap | None = None
    ) -> "Layers":
        """Layers of a quantity of a map in a view.

        Over one axis, the regions are the labels, and the values those of the quantity; where the label itself is
        asked for, they are those of the `hardness` of the impacts.

        most : most labels with a region each; more are grouped by their number of double-sided impacts
        among : the whole map, where `drawn` is a part of it and other parts are drawn beside it

        Raises PlotError where the quantity is not defined in any cell of the whole map, ClunkError where there is no
        quantity of that name.
        """
        described = quantity_of(quantity, drawn)
        if is_strip := len(view.axes) == 1 and described.type == TEXT:
            described = quantity_of(hardness(drawn), drawn)
        traced = None if view.places else drawn.boundaries
        labels = drawn.labels if traced is None else traced.labels
        is_label = described.type == TEXT
        values = np.zeros(0) if is_label else view.arrange(described.of_runs(drawn))
        among = among or drawn
        if not is_label and not is_strip and np.isnan(described.of_runs(among)).all():
            has_failed = (among.sequence == FAILED_CODE).all()
            why = "; all runs have failed" if has_failed else WHY_UNDEFINED.get(described.name, "")
            raise PlotError(f"There is no {described.name} to draw: it is not defined in any cell{why}.")
        codes = view.arrange(drawn.sequence)
        undecided, draws = np.zeros(codes.shape, bool), ""
        if isinstance(drawn, ToleranceMap):
            draws = f"{drawn.draws:,} draws"
        elif not view.places:
            undecided = (view.arrange(drawn.quality) & QUALITY_UNDECIDED) != 0
        layers = cls(
            title=drawn.title.strip() or "Impact regimes",
            load=drawn.load_phrase(STEP_KEYS),
            view=view,
            quantity=described,
            names=labels,
            colours=tuple(map(colour_of, labels)),
            codes=codes,
            regions_of=np.array([*range(len(labels)), FAILED_CODE], np.int16),
            boundaries=traced,
            undecided=undecided,
            unresolved=np.zeros((0, len(view.axes))) if traced is None else traced.unresolved[:, view.keep],
            values=values,
            value_label=drawn.plot_label(described),
            facts=(draws or (f"{codes.size:,} runs" if view.places else ""),),
            caveats=tuple(drawn.caveats),
        )
        if len(view.axes) == 1 or is_label:
            layers = layers._grouped(most)
            return layers._faded(drawn) if isinstance(drawn, ToleranceMap) else layers
        of_labels = [described.of_label(label) for label in labels]
        by_label = None not in of_labels
        whole = np.unique(np.array(of_labels) if by_label else values[np.isfinite(values)])
        if described.type == YES_NO:
            whole = np.arange(2.0)  # both, so that yes and no have the same colours where only one of them occurs
        if (by_label or described.type == YES_NO) and whole.size <= MOST_LABELS and not draws:
            if not by_label:  # traced boundaries are those between labels, not between values of this quantity
                codes = np.where(np.isnan(values), FAILED_CODE, whole.searchsorted(values)).astype(np.int16)
                unresolved, undecided = layers.unresolved[:0], np.zeros_like(undecided)
                layers = replace(layers, codes=codes, boundaries=None, unresolved=unresolved, undecided=undecided)
            fact = f"{'whether' if described.type == YES_NO else 'numbers:'} {described.heading}"
            return layers._regrouped(np.array(of_labels) if by_label else whole, layers._looks_of(whole), fact)
        if not view.places:
            layers = replace(
                layers, facts=(draws, f"lines: boundaries of the {'most likely ' if draws else ''}regimes")
            )
        layers = layers._grouped(most)
        codes = layers._faded(drawn).codes if isinstance(drawn, ToleranceMap) else layers.codes
        return replace(layers, codes=codes, shaded=True, undecided=np.zeros_like(undecided))

    def _grouped(self, most: int) -> "Layers":
        """Layers with labels grouped by their number of double-sided impacts if more than `most` labels are seen."""
        if len(self.seen) <= most:
            return self
        numbers = np.array([-1 if name == "NI" else double_sided(name) for name in self.names])
        looks = {number: (f"{number or 'no'} double-sided", group_colour(number)) for number in numbers.tolist()}
        looks |= {-1: ("NI", colour_of("NI"))}
        return self._regrouped(numbers, looks, "labels grouped by their number of double-sided impacts")

    def _looks_of(self, whole: Floats) -> dict[float, tuple[str, str]]:
        """Name and colour of the region of each of these values of the quantity, which are whole numbers."""
        counts = whole.astype(int).tolist()
        names = [("no", "yes")[count] if self.quantity.type == YES_NO else str(count) for count in counts]
        is_grouped = self.quantity.name == "double_sided_impacts"
        tints = map(group_colour, counts) if is_grouped else shades(whole.size)
        return dict(zip(whole.tolist(), zip(names, tints, strict=True), strict=True))

    def _regrouped(self, numbers: Array, looks: Mapping[float, tuple[str, str]], fact: str) -> "Layers":
        """Layers in which all present regions with the same number become one region.

        Marks of doubt stay only where two of the new regions meet: elsewhere a doubtful label changes nothing.

        numbers : a number for each present region, in the order of their codes
        looks : number -> name and colour of its region
        fact : phrase for the line under the title
        """
        present, group = np.unique(numbers, return_inverse=True)
        regions_of = np.array([*group, FAILED_CODE], np.int16)
        codes = regions_of[self.codes]
        meets = morphological_gradient(codes, 3) > 0
        places = tuple(map(cells_of, self.view.axes, self.unresolved.T))
        names, colours = (tuple(looks[number][k] for number in present.tolist()) for k in (0, 1))
        return replace(
            self,
            codes=codes,
            regions_of=regions_of,
            names=names,
            colours=colours,
            undecided=self.undecided & meets,
            unresolved=self.unresolved[meets[places]] if len(self.unresolved) else self.unresolved,
            facts=(*self.facts, fact),
        )

    def _faded(self, drawn: ToleranceMap) -> "Layers":
        """Layers of the most likely label, or group of labels, in each cell, paler where this is less certain."""
        if self.failed.all():
            return self
        regions = np.arange(len(self.names))[:, None] == self.regions_of[:-1]
        likely = np.stack([self.view.arrange(drawn.of_labels(labels)) for labels in regions])
        codes, certainty = np.where(self.failed, FAILED_CODE, likely.argmax(axis=0)), likely.max(axis=0)
        uncertain = certainty < CERTAIN
        white = np.where(uncertain, np.interp(certainty, *_FADES), 0.0)
        text = f"paler: less than {100 * CERTAIN:.0f} % likely, {counted(uncertain.sum(), 'cell')}"
        colours = self.colours_of(codes)
        return replace(
            self,
            codes=codes.astype(np.int16),
            paint=colours + white[..., None] * (255.0 - colours),
            notes=(Note(text, ""),) if uncertain.any() else (),
            facts=(f"most likely of {drawn.draws:,} draws", *self.facts[1:]),
        )

    @property
    def doubts(self) -> Floats:
        """(n, axes) places of undecided cells, and then those of unresolved boundaries, in the axes' units."""
        cells = [axis.values[k] for axis, k in zip(self.view.axes, self.undecided.nonzero(), strict=True)]
        return np.vstack([np.column_stack(cells), self.unresolved])

    @property
    def has_light_lines(self) -> bool:
        """Whether white boundaries stand out from the cells' shades.

        They do not where shades begin at white, as of probabilities, or have white in their middle, as of the margin.
        """
        return self.quantity.type != YES_NO and self.quantity.name != "margin"

    def colours_of(self, regions: LabelCodes) -> Floats:
        """(…, 3) colours of regions (…), 0 to 255."""
        return 255.0 * to_rgba_array([*self.colours, FAILED_FILL])[regions, :3]

    @property
    def failed(self) -> Bools:
        """Whether each cell failed, shape of `codes`."""
        return self.codes == FAILED_CODE

    @cached_property
    def shares(self) -> Floats:
        """(regions + 1,) share of the map that each region has, and last what failed.

        It is a share of the traced area where boundaries have been traced, and otherwise of the number of cells.
        """
        regions, areas = self.codes.ravel(), np.full(self.codes.size, 1.0 / self.codes.size)
        if self.boundaries is not None:
            regions, areas = self.regions_of[self.boundaries.region_label], self.boundaries.region_area
        return np.roll(np.bincount(regions.astype(np.intp) - FAILED_CODE, areas, minlength=len(self.names) + 1), -1)

    @property
    def seen(self) -> list[str]:
        """Names of the regions that are large enough to be seen."""
        return [name for name, share in zip(self.names, self.shares, strict=False) if share >= _SEEN]

    def legend(self, names: Sequence[str], *, is_counted: bool = True) -> list[Note]:
        """Notes on the named regions, on cells that failed, have no value or are blurred, and then `Layers.notes`.

        is_counted : whether the notes tell the regions' shares of the map and the numbers of cells
        """

        def text(name: str, count: str) -> str:
            return f"{name}: {count}" if is_counted else name

        notes = [
            Note(text(name, f"{100 * share:.{2 if share < 0.995 else 4}g} %"), colour)
            for name, colour, share in zip(self.names, self.colours, self.shares.tolist(), strict=False)
            if name in names and share >= _SEEN
        ]
        if self.shaded and (np.isnan(self.values) & ~self.failed).any():
            why = "not known" if self.quantity.name == "margin" else "not defined"
            notes.append(Note(why, UNDEFINED))
        doubtful = (
            (FAILED, self.failed.sum(), "cell", FAILED_FILL),
            ("blurred, undecided", self.undecided.sum(), "cell", ""),
            ("blurred, lines unresolved", len(self.unresolved), "place", ""),
        )
        notes += [Note(text(name, counted(count, unit)), colour) for name, count, unit, colour in doubtful if count]
        return [*notes, *self.notes]

    @property
    def bands(self) -> tuple[Floats, LabelCodes]:
        """Edges (n + 1,) and regions (n,) of the bands of a strip, each band a row of neighbouring cells of one region.

        An edge between bands is halfway between two samples, see `cell_edges`.
        """
        edges, first = cell_edges(self.view.x), np.flatnonzero(np.diff(self.codes, prepend=self.codes[0] - 1))
        return np.append(edges[first], edges[-1]), self.codes[first]

    @cached_property
    def lines(self) -> list[Floats]:
        """Lines (n, 2) between two regions: traced curves, or else edges between cells, unless there are too many.

        A closed curve around an island that is too small to be seen is left out: it would be all that is drawn of the
        island.
        """
        if self.boundaries is None:
            return _lines_between(self.codes, *map(cell_edges, self.view.axes))
        left, right = (self.regions_of[each] for each in (self.boundaries.curve_left, self.boundaries.curve_right))
        curves = (curve.vertices for curve in self.boundaries.curves)
        islands = (each.rings[0] for each in self.boundaries.regions if each.area < _SEEN and len(each.rings) == 1)
        unseen = {tuple(at) for ring in islands for at in ring}
        return [
            curve[:, self.view.keep]
            for curve, is_drawn in zip(curves, left != right, strict=False)
            if is_drawn and not (tuple(curve[0]) in unseen and np.array_equal(curve[0], curve[-1]))
        ]

    @cached_property
    def outlines(self) -> list[tuple[int, tuple[Floats, ...]]]:
        """Region and closed polygons (n, 2) of each connected traced part of the map: the outer polygon, then holes.

        Empty where no boundaries have been traced.
        """
        if self.boundaries is None:
            return []
        codes = self.regions_of[self.boundaries.region_label].tolist()
        rings = [tuple(ring[:, self.view.keep] for ring in region.rings) for region in self.boundaries.regions]
        return list(zip(codes, rings, strict=True))

    def codes_at(self, x: Floats, y: Floats) -> LabelCodes:
        """(ny, nx) regions at the pixels of a raster: `x` (nx,) and `y` (ny,), both ascending, in the axes' units.

        Regions of a strip are the same at every y.
        """
        if len(self.view.axes) < 2:
            return np.broadcast_to(self.codes[cells_of(self.view.x, x)], (len(y), len(x)))
        cells = self.codes[np.ix_(*map(cells_of, self.view.axes, (x, y)))].T
        # Only outer polygons are painted, the largest first: what lies in a hole is smaller and covers the hole.
        image = Image.fromarray(cells.astype(np.int32))
        draw = ImageDraw.Draw(image)
        for code, (ring, *_) in sorted(self.outlines, key=lambda each: -np.ptp(each[1][0], axis=0).prod()):
            pixels = [
                np.interp(ring[:, k], at, np.arange(len(at)), left=-1, right=len(at)) for k, at in enumerate((x, y))
            ]
            draw.polygon(np.column_stack(pixels).ravel().tolist(), fill=code)
        return np.asarray(image).astype(np.int16)

    def subtitle(self, fixed: Sequence[ResultAxis]) -> str:
        """Line under the title: the load, the values of the fixed parameters, the facts and the map's caveats."""
        values = [value_text(axis, axis.values[0]) for axis in fixed]
        return "; ".join(filter(None, [self.load, *values, *self.facts, *self.caveats]))


def hardness(drawn: AnyMap) -> str:
    """Name of the quantity that tells how hard the impacts of a map are: the severity Q, if any cell defines it.

    The restitution model does not define Q. Then it is the approach velocity V, and in a tolerance map, which has no V,
    the probability of double-sided impacts.
    """
    if np.isfinite(quantity_of("severity", drawn).of_runs(drawn)).any():
        return "severity"
    return "double_sided" if isinstance(drawn, ToleranceMap) else "approach_velocity"


def _lines_between(codes: LabelCodes, x: Floats, y: Floats) -> list[Floats]:
    """Edges (2, 2) between cells of different regions; none where there are more than `_MOST_STEPS`.

    x, y : (nx + 1,) and (ny + 1,) edges of the cells
    """

    def upright(codes: LabelCodes, x: Floats, y: Floats) -> Floats:
        i, j = np.nonzero(codes[1:] != codes[:-1])
        return np.stack([x[[i + 1, i + 1]], y[[j, j + 1]]], axis=-1)

    lines = np.concatenate([upright(codes, x, y), upright(codes.T, y, x)[..., ::-1]], axis=1)
    return list(lines.swapaxes(0, 1)) if lines.shape[1] <= _MOST_STEPS else []
