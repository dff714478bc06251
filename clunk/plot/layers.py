"""Layers of a plane: regions with their colours, a quantity's values, lines and marks, of any map that is drawn."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw
from scipy import ndimage

from clunk.core.status import QUALITY_UNDECIDED
from clunk.plot.plane import Codes, View, cell_edges, cells_of, value_text
from clunk.plot.style import FAILED_FILL, FAINT_INK, HUES, SIZE, PlotError, cells_phrase, colour_of, group_colour, tint
from clunk.results.boundaries import Boundaries
from clunk.results.labels import FAILED, FAILED_CODE, double_sided
from clunk.results.quantities import LABEL, NUMBER, TEXT, YES_NO, Quantity, quantity_of
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import CERTAIN, AnyMap, ToleranceMap
from clunk.study.arrays import Array, Bools, Floats
from clunk.study.axes import ResultAxis
from clunk.study.loads import PROFILES, STEP_KEYS, numbers
from clunk.study.summaries import counted

MOST_LABELS = 16  # that are told apart: more are grouped by their number of double-sided impacts
_SEEN = 5e-6  # of a map's area, some pixels: a smaller region has no name
_MOST_STEPS = 40_000  # of lines between cells: more would be a veil
_LINE = 92  # characters of a subtitle that the width of a figure takes
_ORDERED = ("#f6f6e2", "#b5dcc0", "#62b3c4", "#3f83b8")  # of whole numbers, from the lowest to the highest
_NO, _YES = "#f6f5f1", tint(HUES[1], 0.5)
# A cell's colour is taken towards white where its label is less certain than these, by so much.
_FADES = ((CERTAIN, 0.30), (0.8, 0.55), (0.65, 0.80))
_WHY_UNDEFINED = {
    "severity": "; under the restitution model accelerations are impulsive, and approach_velocity is the measure to "
    "plot",
    "margin": "; only the exact method knows it (solver.method)",
}


class Measured(NamedTuple):
    """A measured label at a point of a map, and whether the map has it there."""

    x: float
    y: float
    label: str
    agrees: bool


class Note(NamedTuple):
    """A text in the notes under a figure, and the colour before it, if there is one."""

    text: str
    colour: str


@dataclass(frozen=True, eq=False)
class Layers:
    """What is drawn of a map over ascending axes: regions, and the values of a quantity where it is a number.

    title : str
    load : str, in words
    view : View, the axes
    quantity : Quantity
    names, colours : of the regions: labels, or groups of them, or the values of a quantity that are told apart
    codes : (nx, ny) int16, regions of the cells, of a strip (nx,), of points (cells,) in C order; -1 failed
    values : float64, shape of `codes`, NaN where a quantity is not known; None of labels
    value_label : name of the values beside an axis or a colour bar
    shaded : whether cells have the colours of their values, in the place of their regions'
    paint : (nx, ny, 3) uint8, colours of the cells in the place of the regions', if there are any
    boundaries : Boundaries, if they have been traced: of them those between two regions are drawn
    regions_of : code in the boundaries -> region; the last is that of failed cells
    undecided : bool, shape of `codes`: cells whose margin is below its tolerance, where that makes a difference
    unresolved : (n, 2) places that tracing left open
    points : measured labels
    notes : further notes under the figure
    facts : for the line under the title
    caveats : phrases on what the map does not tell, behind them
    """

    title: str
    load: str
    view: View
    quantity: Quantity
    names: tuple[str, ...]
    colours: tuple[str, ...]
    codes: Codes
    undecided: Bools
    values: Floats | None = None
    value_label: str = ""
    shaded: bool = False
    paint: npt.NDArray[np.uint8] | None = None
    boundaries: Boundaries | None = None
    regions_of: Codes | None = None
    unresolved: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    points: tuple[Measured, ...] = ()
    notes: tuple[Note, ...] = ()
    facts: tuple[str, ...] = ()
    caveats: tuple[str, ...] = ()

    @classmethod
    def of(cls, drawn: AnyMap, dimensions: int, quantity: str | Quantity = LABEL, most: int = MOST_LABELS) -> Layers:
        """Layers of a quantity of a map over this many axes, 0 for its cells as points.

        most : labels that are told apart; more are shown by their number of double-sided impacts

        Raises PlotError where the map has other axes, or the quantity is not defined in any cell; ClunkError where
        there is no such quantity.
        """
        described = quantity_of(quantity, drawn) if isinstance(quantity, str) else quantity
        view = View.of(drawn, dimensions)
        traced = drawn.boundaries if isinstance(drawn, Results) and dimensions else None
        labels = drawn.labels if traced is None else traced.labels
        codes = view.arrange(drawn.sequence)
        values = None if described.type == TEXT else view.arrange(described.of_runs(drawn))
        if values is not None and np.isnan(values).all():
            why = _WHY_UNDEFINED.get(described.name, "")
            raise PlotError(f"There is no {described.name} to draw: it is not defined in any cell{why}.")
        layers = cls(
            title=drawn.title.strip() or "Impact regimes",
            load=_load_phrase(drawn),
            view=view,
            quantity=described,
            names=labels,
            colours=tuple(colour_of(label) for label in labels),
            codes=codes,
            undecided=np.zeros(codes.shape, np.bool_),
            values=values,
            value_label=drawn.plot_label(described),
            boundaries=traced,
            caveats=tuple(drawn.caveats),
            regions_of=np.array([*range(len(labels)), FAILED_CODE], np.int16),
        )
        if isinstance(drawn, Results):
            undecided = (view.arrange(drawn.quality) & QUALITY_UNDECIDED) != 0
            layers = replace(layers, undecided=undecided)
            unresolved = np.asarray(getattr(traced, "unresolved", np.zeros((0, 2))), np.float64)
            if len(unresolved):
                layers = replace(layers, unresolved=unresolved[:, list(view.keep)])
        else:
            layers = replace(layers, facts=(f"{drawn.draws:,} draws",))
            return layers._faded(drawn, most) if values is None else layers._shaded("the most likely regimes", most)
        if values is None:
            return layers._grouped(most)
        of_labels = [described.of_label(label) for label in labels]
        by_label = None not in of_labels
        whole = np.unique([*of_labels, *values[np.isfinite(values)]] if by_label else values[np.isfinite(values)])
        if described.type == NUMBER or whole.size > MOST_LABELS or not (by_label or described.type == YES_NO):
            return layers._shaded("the regimes", most)
        return layers._by_value(np.array(of_labels) if by_label else None, values, whole)

    def _shaded(self, regimes: str, most: int) -> Layers:
        """The layers with the values as colours under the lines between regimes."""
        lines = f"{'light' if self.has_light_lines else 'dark'} lines: boundaries of {regimes}"
        facts = (*self.facts, lines) if len(self.view.axes) > 1 else self.facts
        return replace(self._grouped(most), shaded=True, facts=facts, undecided=np.zeros_like(self.undecided))

    def _grouped(self, most: int) -> Layers:
        """Regions of labels, or of their numbers of double-sided impacts where the labels are too many to be read."""
        seen = len(self.seen)
        if seen <= most:
            return self
        numbers = np.array([-1 if name == "NI" else double_sided(name) for name in self.names])
        present, group = np.unique(numbers, return_inverse=True)
        names = tuple("NI" if n < 0 else f"{n or 'no'} double-sided" for n in present.tolist())
        colours = tuple(colour_of("NI") if n < 0 else group_colour(n) for n in present.tolist())
        fact = f"{seen} labels, grouped by their number of double-sided impacts"
        return replace(self._regrouped(group), names=names, colours=colours, facts=(*self.facts, fact))

    def _by_value(self, of_labels: Array | None, values: Floats, whole: Floats) -> Layers:
        """Regions of equal values: exact where labels tell them, and else of the cells."""
        if of_labels is not None:
            layers = self._regrouped(np.searchsorted(whole, of_labels))
        else:
            codes = np.where(np.isnan(values), FAILED_CODE, np.searchsorted(whole, values)).astype(np.int16)
            layers = replace(self, codes=codes, boundaries=None, undecided=np.zeros_like(self.undecided))
        if self.quantity.type == YES_NO:
            names = tuple("yes" if value else "no" for value in whole)
            colours = tuple(_YES if value else _NO for value in whole)
            fact = f"whether {self.quantity.heading}"
        else:
            names = tuple(f"{value:g}" for value in whole)
            shares = np.linspace(0.0, 1.0, max(whole.size, 3))
            colours = tuple(_ordered(share) for share in shares[: whole.size])
            fact = f"numbers: {self.quantity.heading}"
        if self.quantity.name == "double_sided_impacts":
            colours = tuple(group_colour(int(value)) for value in whole)
        return replace(layers, names=names, colours=colours, facts=(*self.facts, fact))

    def _regrouped(self, group: Array) -> Layers:
        """The layers with regions of groups, marked where these meet; group : of each region."""
        regions_of = np.array([*group, FAILED_CODE], np.int16)
        codes = regions_of[self.codes]
        meets = ndimage.maximum_filter(codes, 3) != ndimage.minimum_filter(codes, 3)
        places = tuple(cells_of(axis, at) for axis, at in zip(self.view.axes, self.unresolved.T, strict=False))
        unresolved = self.unresolved[meets[places]] if len(self.unresolved) else self.unresolved
        marks = {"undecided": self.undecided & meets, "unresolved": unresolved}
        return replace(self, codes=codes, regions_of=regions_of, **marks)

    def _faded(self, drawn: ToleranceMap, most: int) -> Layers:
        """The most likely labels, paler where they are less certain, without those that are nowhere most likely."""
        present = np.unique(self.codes[self.codes != FAILED_CODE])
        codes = np.where(self.codes == FAILED_CODE, FAILED_CODE, np.searchsorted(present, self.codes)).astype(np.int16)
        names = tuple(self.names[code] for code in present)
        layers = replace(self, names=names, colours=tuple(map(colour_of, names)), codes=codes)._grouped(most)
        certainty, white = self.view.arrange(drawn.certainty), np.zeros(codes.shape)
        for below, amount in _FADES:
            white[certainty < below] = amount
        paint = layers.region_colours + white[..., None] * (255.0 - layers.region_colours)
        grey = [tint(FAINT_INK, 1.0 - amount) for _, amount in _FADES]
        spans = [f"less than {100 * below:.0f} % likely" for below, _ in _FADES]
        spans[0] += f": {cells_phrase(drawn.uncertain)}"
        notes = tuple(Note(text, colour) for text, colour in zip(spans, grey, strict=True) if drawn.uncertain)
        return replace(
            layers, paint=paint.astype(np.uint8), notes=notes, facts=(f"most likely of {drawn.draws:,} draws",)
        )

    @property
    def doubts(self) -> Floats:
        """(n, axes) places of undecided cells, and of those that tracing left open."""
        at = np.nonzero(self.undecided)
        cells = [axis.values[k] for axis, k in zip(self.view.axes, at, strict=True)]
        return np.vstack([np.column_stack(cells), self.unresolved[:, : len(cells)]])

    @property
    def doubts_text(self) -> str:
        """What the `doubts` are, with their numbers; empty where there are none."""
        count, places = int(np.count_nonzero(self.undecided)), len(self.unresolved)
        texts = [f"undecided: {cells_phrase(count)}"] * bool(count)
        return "; ".join(texts + [f"lines unresolved: {counted(places, 'place')}"] * bool(places))

    @property
    def has_light_lines(self) -> bool:
        """Whether boundaries are seen as light lines: on all colours but those that begin or turn at white."""
        return self.quantity.type != YES_NO and self.quantity.name != "margin"

    @property
    def region_colours(self) -> npt.NDArray[np.float64]:
        """(nx, ny, 3) colour of each cell's region, 0 to 255."""
        table = np.array([list(bytes.fromhex(each[1:])) for each in (*self.colours, FAILED_FILL)], np.float64)
        return np.asarray(table[self.codes])

    @property
    def failed(self) -> npt.NDArray[np.bool_]:
        """Cells that failed."""
        failed: npt.NDArray[np.bool_] = self.codes == FAILED_CODE
        return failed

    @cached_property
    def shares(self) -> Floats:
        """Share of the map of each region, as traced, and else of its cells; last that of what failed."""
        regions, areas = self.codes.ravel(), np.full(self.codes.size, 1.0 / self.codes.size)
        if self.boundaries is not None and self.regions_of is not None:
            regions, areas = self.regions_of[self.boundaries.region_label], self.boundaries.region_area
        counts = np.bincount(regions.astype(np.intp) - FAILED_CODE, areas, minlength=len(self.names) + 1)
        return np.roll(counts, -1)

    @property
    def seen(self) -> list[str]:
        """Names of the regions that are large enough to be seen."""
        return [name for name, share in zip(self.names, self.shares, strict=False) if share >= _SEEN]

    def note(self, name: str, *, counted: bool) -> Note:
        """A region in the notes, with its share of the map or number of cells where `counted`."""
        code = self.names.index(name)
        extent = f"{100.0 * self.shares[code]:.2g} %"
        if self.boundaries is None:
            extent = cells_phrase(int(np.count_nonzero(self.codes == code)))
        return Note(f"{name}: {extent}" if counted else name, self.colours[code])

    @property
    def edges(self) -> tuple[Floats, ...]:
        """Edges (n + 1,) of the cells along each axis."""
        return tuple(map(cell_edges, self.view.axes))

    @property
    def bands(self) -> tuple[Floats, Codes]:
        """Edges (n + 1,) and regions (n,) of a strip's bands: as traced, or with edges halfway between samples."""
        if self.boundaries is None or self.regions_of is None:
            edges, codes = cell_edges(self.view.x), self.codes
        else:
            edges = np.append(self.boundaries.ring_vertices[::2, 0], self.view.x.values[-1])
            codes = self.regions_of[self.boundaries.region_label]
        first = np.flatnonzero(np.diff(codes, prepend=codes[0] - 1))
        return np.append(edges[first], edges[-1]), codes[first]

    @cached_property
    def lines(self) -> list[Floats]:
        """Lines (n, 2) between two regions: as traced, or along the cells, if they are not too many to be seen."""
        if self.boundaries is None or self.regions_of is None:
            return _lines_between(self.codes, *self.edges)
        bounded = self.regions_of[self.boundaries.curve_left] != self.regions_of[self.boundaries.curve_right]
        parts = np.split(
            self.boundaries.vertices[:, list(self.view.keep)], np.cumsum(self.boundaries.curve_counts)[:-1]
        )
        return [part for part, is_drawn in zip(parts, bounded, strict=False) if is_drawn]

    @cached_property
    def outlines(self) -> list[tuple[int, tuple[Floats, ...]]]:
        """Region, and closed polygons (n, 2) of each connected part of it as traced: the outer one, then holes."""
        if self.boundaries is None or self.regions_of is None:
            return []
        keep = list(self.view.keep)
        codes = self.regions_of[self.boundaries.region_label].tolist()
        rings = [tuple(ring[:, keep] for ring in region.rings) for region in self.boundaries.regions]
        return list(zip(codes, rings, strict=True))

    def codes_at(self, x: Floats, y: Floats) -> Codes:
        """Regions (y, x) at ascending pixels along the axes, of a strip the same at every y."""
        if len(self.view.axes) < 2:
            edges, codes = self.bands
            places = np.clip(np.searchsorted(edges, x) - 1, 0, len(codes) - 1)
            return np.broadcast_to(codes[places], (len(y), len(x)))
        columns, rows = (cells_of(axis, at) for axis, at in zip(self.view.axes, (x, y), strict=True))
        cells: Codes = self.codes[np.ix_(columns, rows)].T
        # A hole is filled by what is in it, which is painted after what is around it.
        image = Image.fromarray(cells.astype(np.int32))
        draw = ImageDraw.Draw(image)
        for code, (ring, *_) in sorted(self.outlines, key=lambda each: -float(np.ptp(each[1][0], axis=0).prod())):
            pixels = [
                np.interp(ring[:, k], at, np.arange(len(at)), left=-1, right=len(at)) for k, at in enumerate((x, y))
            ]
            draw.polygon(np.column_stack(pixels).ravel().tolist(), fill=code)
        return np.asarray(image).astype(np.int16)

    def subtitle(self, *facts: str, fixed: Iterable[ResultAxis] | None = None, width: float = SIZE[0]) -> str:
        """The load, the values of fixed parameters, further facts and the map's caveats; in lines.

        fixed : by default the axes that are not drawn
        width : of the figure  [inches]
        """
        values = [value_text(axis, axis.values[0]) for axis in (self.view.fixed if fixed is None else fixed)]
        lines = [""]
        for part in filter(None, [self.load, *values, *facts, *self.facts, *self.caveats]):
            if lines[-1] and len(lines[-1]) + len(part.split("\n")[0]) > _LINE * width / SIZE[0]:
                lines.append("")
            lines[-1] += f"; {part}" if lines[-1] else part
        return ";\n".join(lines)


def hardness(results: AnyMap) -> str:
    """The quantity that tells how hard impacts are: Q is not defined for the restitution model, V is."""
    is_defined = not isinstance(results, Results) or np.isfinite(results.severity).any()
    return "severity" if is_defined else "approach_velocity"


def stacked(panels: Sequence[Layers]) -> Layers:
    """Layers of several panels as one, for their common colours and notes."""
    names = {name: colour for panel in panels for name, colour in zip(panel.names, panel.colours, strict=True)}
    place = {name: code for code, name in enumerate(names)} | {FAILED: FAILED_CODE}
    codes = [np.array([*map(place.get, (*each.names, FAILED))], np.int16)[each.codes] for each in panels]
    arrays: dict[str, Any] = {"codes": np.stack(codes), "undecided": np.stack([each.undecided for each in panels])}
    arrays["unresolved"] = np.vstack([each.unresolved for each in panels])
    if panels[0].values is not None:
        arrays["values"] = np.stack([panel.values for panel in panels if panel.values is not None])
    return replace(panels[0], names=tuple(names), colours=tuple(names.values()), boundaries=None, **arrays)


def _load_phrase(drawn: AnyMap) -> str:
    """The load in words: an ideal step is a worst case, and a reader should know."""
    load = drawn.setting("load") or {}
    if load.get("profile") not in PROFILES:
        return ""
    swept = [each.parameter.removeprefix("load.") for each in drawn.parameters]
    return ", ".join([PROFILES[load["profile"]].name, *numbers(load, without=[*STEP_KEYS, *swept])])


def _ordered(share: float) -> str:
    """Colour of a whole number; share : 0 of the lowest to 1 of the highest."""
    table = np.array([list(bytes.fromhex(each[1:])) for each in _ORDERED], np.float64)
    mixed = [np.interp(share, np.linspace(0.0, 1.0, len(table)), column) for column in table.T]
    return f"#{np.rint(mixed).astype(np.uint8).tobytes().hex()}"


def _lines_between(codes: Codes, x: Floats, y: Floats) -> list[Floats]:
    """Straight lines (2, 2) between cells of different regions, along their edges; none where there are too many."""
    lines: list[Floats] = []
    for turned, (across, along) in enumerate(((x, y), (y, x))):
        cells = codes.T if turned else codes
        differs = np.pad(cells[1:] != cells[:-1], ((0, 0), (1, 1))).astype(np.int8)
        row, begin = np.nonzero(np.diff(differs, axis=1) > 0)
        end = np.nonzero(np.diff(differs, axis=1) < 0)[1]
        if len(lines) + row.size > _MOST_STEPS:
            return []
        ends = np.stack(
            [np.column_stack([across[row + 1], along[begin]]), np.column_stack([across[row + 1], along[end]])], 1
        )
        lines += list(ends[:, :, ::-1] if turned else ends)
    return lines
