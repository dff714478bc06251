"""Layers of a map or strip: its regimes, marks and a quantity along ascending axes, of any map that is drawn."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from clunk.core.status import QUALITY_UNDECIDED
from clunk.plot.plane import Codes, View, cell_edges, value_text
from clunk.plot.regions import Regions, regions_of
from clunk.plot.style import SIZE, PlotError
from clunk.results.boundaries import Boundaries
from clunk.results.labels import FAILED_CODE
from clunk.results.quantities import REGIME_QUANTITIES, Quantity
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import ToleranceMap
from clunk.study.arrays import Bools, Floats
from clunk.study.axes import ResultAxis
from clunk.study.loads import PROFILES, STEP_KEYS, numbers

# "regimes" is the map of labels
QUANTITIES = ["regimes", *(name for name, each in REGIME_QUANTITIES.items() if each.words and not each.dimension)]

_LINE = 92  # characters of a subtitle that the width of a figure takes
_WHY_UNDEFINED = {
    "severity": "; under the restitution model accelerations are impulsive, and approach_velocity is the measure to "
    "plot",
    "margin": "; only the exact method knows it (solver.method)",
}


@dataclass(frozen=True)
class Layers:
    """Regimes over ascending axes, marks of cells, and a quantity where one is drawn.

    title : str
    load : str, in words
    view : View, the axes
    labels : code -> label
    codes : (nx, ny) int16, of a strip (nx,), of points (cells,) in C order
    undecided : bool, shape of `codes`: cells whose margin is below its tolerance
    quantity : str; "regimes" where nothing but the labels is drawn
    values : float64, shape of `codes`, NaN where the quantity is not known; of the regimes NaN everywhere
    described : Quantity, its description
    points : int, fine points across the map, as of `Regions`
    boundaries : Boundaries, if they have been traced: they are drawn in the place of smooth ones
    caveats : phrases on what the map does not tell
    """

    title: str
    load: str
    view: View
    labels: tuple[str, ...]
    codes: Codes
    undecided: Bools
    quantity: str
    values: Floats
    described: Quantity = REGIME_QUANTITIES["sequence"]
    points: int = 700
    boundaries: Boundaries | None = None
    caveats: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, drawn: Results | ToleranceMap, dimensions: int, quantity: str = "regimes", values: Floats | None = None
    ) -> Layers:
        """Layers of a map over this many axes, 0 for its cells as points. Raises PlotError where it has other axes.

        values : of the quantity, in the shape of the map
        """
        view = View.of(drawn, dimensions)
        # An ideal step is a worst case, and a reader should know.
        load = drawn.setting("load") or {}
        swept = [each.parameter.removeprefix("load.") for each in drawn.parameters]
        known = load.get("profile") in PROFILES
        phrase = [PROFILES[load["profile"]].name, *numbers(load, without=[*STEP_KEYS, *swept])] if known else []
        codes = view.arrange(drawn.sequence)
        unmarked = np.zeros(codes.shape, np.bool_)
        traced = drawn.boundaries if isinstance(drawn, Results) and dimensions else None
        return cls(
            title=drawn.title.strip() or "Impact regimes",
            load=", ".join(phrase),
            view=view,
            labels=drawn.labels if traced is None else traced.labels,
            codes=codes,
            undecided=view.arrange(drawn.quality & QUALITY_UNDECIDED) != 0 if isinstance(drawn, Results) else unmarked,
            quantity=quantity,
            values=np.full(codes.shape, np.nan) if values is None else view.arrange(values),
            boundaries=traced,
            caveats=tuple(drawn.caveats),
        )

    @classmethod
    def of_quantity(cls, results: Results, dimensions: int, quantity: str) -> Layers:
        """Layers of a regime map and one of its quantities, as `of`. Raises PlotError where it has no such quantity.

        The quantity is NaN in cells that failed.
        """
        if quantity not in quantities_of(results)[1:]:
            drawn = ", ".join(quantities_of(results)[1:])
            raise PlotError(f"There is no quantity {quantity!r} to draw; there are {drawn}.")
        values = np.where(results.sequence == FAILED_CODE, np.nan, results.values(quantity).astype(np.float64))
        return replace(cls.of(results, dimensions, quantity, values), described=results.quantities[quantity])

    def require_values(self) -> None:
        """Raise PlotError where a quantity is drawn and none of its values is known."""
        if self.quantity != "regimes" and np.isnan(self.values).all():
            why = _WHY_UNDEFINED.get(self.quantity, "")
            raise PlotError(f"There is no {self.quantity} to draw: it is not defined in any cell{why}.")

    @property
    def bands(self) -> tuple[Floats, Codes]:
        """Edges (n + 1,) and codes (n,) of a strip's bands: as traced, or cells with edges halfway between samples."""
        if self.boundaries is None:
            return cell_edges(self.view.x), self.codes
        edges = np.append(self.boundaries.ring_vertices[::2, 0], self.view.x.values[-1])
        return edges, self.boundaries.region_label

    @cached_property
    def regions(self) -> Regions:
        """Regions of a map's labels between the samples."""
        return regions_of(self.codes, self.points)

    @property
    def failed(self) -> Bools:
        """Cells that failed."""
        failed: Bools = self.codes == FAILED_CODE
        return failed

    @property
    def has_dark_lines(self) -> bool:
        """Whether boundaries are seen as dark lines: on diverging colours."""
        return self.quantity in ("margin", "double_sided")

    @property
    def boundaries_note(self) -> str:
        """Name of the lines on a quantity's map."""
        return f"{'dark' if self.has_dark_lines else 'light'} lines: boundaries of the regimes"

    @property
    def present(self) -> list[str]:
        """The labels that some cell or region has: those of a slice may be fewer than the results'."""
        codes = self.codes.ravel()
        if self.boundaries is not None:
            codes = np.concatenate([codes, self.boundaries.region_label])
        return [self.labels[code] for code in np.unique(codes) if code != FAILED_CODE]

    def count(self, label: str) -> int:
        """Number of cells with a label."""
        return int(np.count_nonzero(self.codes == self.labels.index(label)))

    def subtitle(self, *facts: str, fixed: Iterable[ResultAxis] | None = None, width: float = SIZE[0]) -> str:
        """The load, the values of fixed parameters, further facts and the map's caveats; in lines.

        fixed : by default the axes that are not drawn
        width : of the figure  [inches]
        """
        values = [value_text(axis, axis.values[0]) for axis in (self.view.fixed if fixed is None else fixed)]
        lines = [""]
        for part in filter(None, [self.load, *values, *facts, *self.caveats]):
            if lines[-1] and len(lines[-1]) + len(part.split("\n")[0]) > _LINE * width / SIZE[0]:
                lines.append("")
            lines[-1] += f"; {part}" if lines[-1] else part
        return ";\n".join(lines)


def quantities_of(results: Results) -> list[str]:
    """Names of the quantities that can be drawn of a map: `QUANTITIES` and those measured besides."""
    return [*QUANTITIES, *(name for name, each in results.measured_quantities.items() if not each.dimension)]


def stacked(panels: Sequence[Layers]) -> Layers:
    """Layers of several panels as one, for their common colours and notes."""
    names = ("codes", "undecided", "values")
    arrays: dict[str, Any] = {name: np.stack([getattr(panel, name) for panel in panels]) for name in names}
    return replace(panels[0], **arrays)
