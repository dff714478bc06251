"""Layers of a map or strip: what the painter needs of results, whatever kind of map they are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.status import QUALITY_UNDECIDED
from clunk.plot.plane import View, fixed_parameters, value_text
from clunk.plot.style import SIZE, PlotError
from clunk.results.labels import FAILED_CODE
from clunk.results.maps import Map
from clunk.results.quantities import CELL_QUANTITIES
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import ToleranceMap
from clunk.study.axes import ResultAxis

Bools = npt.NDArray[np.bool_]
Codes = npt.NDArray[np.int16]
Floats = npt.NDArray[np.float64]

DRAWN = [name for name, quantity in CELL_QUANTITIES.items() if quantity.words]
QUANTITIES = ["regimes", *DRAWN]  # "regimes" is the map of labels

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
    codes : (nx, ny) int16, of a strip (nx,)
    undecided : bool, shape of `codes`: cells whose margin is below its tolerance
    inferred : bool, likewise: cells that a refined sweep did not run
    quantity : str; "regimes" where nothing but the labels is drawn
    values : float64, shape of `codes`, NaN where the quantity is not known; of the regimes NaN everywhere
    """

    title: str
    load: str
    view: View
    labels: tuple[str, ...]
    codes: Codes
    undecided: Bools
    inferred: Bools
    quantity: str
    values: Floats

    @classmethod
    def of(
        cls, drawn: Results | ToleranceMap, dimensions: int, quantity: str = "regimes", values: Floats | None = None
    ) -> Layers:
        """Layers of a map over this many axes; `values` has its shape. Raises PlotError where it has other axes."""
        view = View.of(drawn, dimensions)
        codes = view.arrange(drawn.sequence)
        no = np.zeros(codes.shape, np.bool_)
        return cls(
            title=title_of(drawn),
            load=load_of(drawn),
            view=view,
            labels=drawn.labels,
            codes=codes,
            undecided=view.arrange(drawn.quality & QUALITY_UNDECIDED) != 0 if isinstance(drawn, Results) else no,
            inferred=view.arrange(drawn.inferred) if isinstance(drawn, Results) else no,
            quantity=quantity,
            values=np.full(codes.shape, np.nan) if values is None else view.arrange(values),
        )

    @classmethod
    def of_quantity(cls, results: Results, dimensions: int, quantity: str) -> Layers:
        """Layers of a regime map and one of its quantities. Raises PlotError where there is no such quantity."""
        require_quantity(quantity)
        return cls.of(results, dimensions, quantity, known_values(results, quantity))

    @classmethod
    def of_points(cls, results: Results, quantity: str) -> Layers:
        """Layers of the cells in C order, whatever the axes. Raises PlotError as `of_quantity` and `require_some`."""
        values = np.full(results.shape, np.nan)
        if quantity != "regimes":
            require_quantity(quantity)
            require_some(values := known_values(results, quantity), quantity)
        return cls(
            title=title_of(results),
            load=load_of(results),
            view=View((), fixed_parameters(results), (), ()),
            labels=results.labels,
            codes=results.sequence.ravel(),
            undecided=(results.quality.ravel() & QUALITY_UNDECIDED) != 0,
            inferred=results.inferred.ravel(),
            quantity=quantity,
            values=values.ravel(),
        )

    @property
    def failed(self) -> Bools:
        """Cells that failed."""
        failed: Bools = self.codes == FAILED_CODE
        return failed

    @property
    def has_dark_lines(self) -> bool:
        """Whether boundaries are seen as dark lines: on diverging colours, and where few cells have one."""
        return self.quantity in ("margin", "double_sided") or bool(self.inferred.any())

    @property
    def boundaries_note(self) -> str:
        """Name of the lines on a quantity's map."""
        return f"{'dark' if self.has_dark_lines else 'light'} lines: boundaries of the regimes"

    @property
    def present(self) -> list[str]:
        """The labels that some cell has: those of a slice may be fewer than the results'."""
        return [self.labels[code] for code in np.unique(self.codes) if code != FAILED_CODE]

    def count(self, label: str) -> int:
        """Number of cells with a label."""
        return int(np.count_nonzero(self.codes == self.labels.index(label)))

    def subtitle(self, *facts: str) -> str:
        """The load, the values of the axes that are not drawn, and further facts; in lines."""
        return subtitle_of(self.load, self.view.fixed, facts)


def stacked(panels: Sequence[Layers]) -> Layers:
    """Layers of several panels as one, for what they share: colours and notes."""
    names = ("codes", "undecided", "inferred", "values")
    arrays: dict[str, Any] = {name: np.stack([getattr(panel, name) for panel in panels]) for name in names}
    return replace(panels[0], **arrays)


def known_values(results: Results, name: str) -> Floats:
    """A quantity of every cell, NaN where it failed, or was inferred and its regime does not tell it."""
    unknown = results.sequence == FAILED_CODE
    if CELL_QUANTITIES[name].inferred is not None:
        unknown |= results.inferred
    values: Floats = np.where(unknown, np.nan, getattr(results, name).astype(np.float64))
    return values


def require_quantity(name: str) -> None:
    """Raise PlotError where a regime map has no such quantity to draw."""
    if name not in DRAWN:
        raise PlotError(f"There is no quantity {name!r} to draw; there are {', '.join(DRAWN)}.")


def require_some(values: Floats, name: str) -> None:
    """Raise PlotError where none of a quantity's values is known."""
    if np.isnan(values).all():
        why = _WHY_UNDEFINED.get(name, "")
        raise PlotError(f"There is no {name} to draw: it is not defined in any cell{why}.")


def title_of(drawn: Map) -> str:
    """The title of a map's figures."""
    return drawn.title.strip() or "Impact regimes"


def load_of(drawn: Map) -> str:
    """The load in words: an ideal step is a worst case, and a reader should know."""
    profile = drawn.setting("load.profile")
    if not isinstance(profile, str):
        return ""
    return "ideal torque step (tip-out)" if profile == "tip-out" else f"load: {profile}"


def subtitle_of(load: str, fixed: Iterable[ResultAxis], facts: Iterable[str], width: float = SIZE[0]) -> str:
    """The load, the values of fixed parameters, and further facts; in lines.

    width : of the figure  [inches]
    """
    lines = [""]
    for part in filter(None, [load, *(value_text(axis, axis.values[0]) for axis in fixed), *facts]):
        if lines[-1] and len(lines[-1]) + len(part.split("\n")[0]) > _LINE * width / SIZE[0]:
            lines.append("")
        lines[-1] += f"; {part}" if lines[-1] else part
    return ";\n".join(lines)
