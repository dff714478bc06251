"""Axes of figures: which parameters are x and y, arrays in ascending order along them, scales, and texts of values."""

import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from clunk.plot.style import MINUS, PlotError, bare, plain, symbol_text
from clunk.results.maps import Map
from clunk.study.arrays import Array, Floats, Positions
from clunk.study.axes import RUN, ResultAxes, ResultAxis, parameters_of
from clunk.study.parameters import numbered
from clunk.study.records import capital, with_unit

_X = "load.ratio"  # the x axis of every figure whose axes include it
USUAL = (_X, "lash.backlash_deg")  # of more axes than two, these are drawn first; others are fixed or become facets


class View(NamedTuple):
    """View of a map: ascending axes that it is drawn over, and the order of its arrays along them, or cells as points.

    axes : x and, if there are two, y
    fixed : parameters with one value
    keep : of a grid, the dimension of the map that each axis is
    order : of a grid, the positions of each axis's values in ascending order
    places : of points, for each axis (cells,) its values in all cells, in C order; empty for a grid
    """

    axes: ResultAxes
    fixed: ResultAxes
    keep: tuple[int, ...] = ()
    order: tuple[Positions, ...] = ()
    places: tuple[Floats, ...] = ()

    @classmethod
    def of(cls, drawn: Map, x: str | None = None, y: str | None = None) -> "View":
        """View of a grid over its axes, or of the runs of a sample, or of axes that are walked together, as points.

        x, y : parameters to draw runs over, by default the first two of: a grid's axes, load ratio, backlash, others.
            One alone leaves the other axis to a quantity.

        Raises PlotError where a grid has more than two axes, or x or y is given; and as `of_points`.
        """
        swept = parameters_of(drawn_axes(drawn))
        if not any(axis.parameter == RUN and len(axis) > 1 for axis in drawn.axes):
            if x is not None or y is not None:
                raise PlotError(
                    "x and y are for axes that are walked together and for samples; of a map's two axes the load ratio "
                    "or else the first is x."
                )
            return cls.of_grid(drawn)
        if names := [name for name in (x, y) if name is not None]:
            return cls.of_points(drawn, numbered(names, drawn.tables))
        coordinates = sorted(parameters_of(drawn.coordinates), key=lambda name: name not in USUAL)
        return cls.of_points(drawn, [*(name for name in swept if name != RUN), *coordinates][:2])

    @classmethod
    def of_plane(cls, drawn: Map, x: str | None = None, y: str | None = None) -> "View":
        """View of a map over two axes, see `View.of`. Raises PlotError also where there is only one axis."""
        view = cls.of(drawn, x, y)
        if len(view.axes) < 2:
            raise PlotError(f"This figure needs two axes, and here is one: {view.x.parameter}.")
        return view

    @classmethod
    def of_grid(cls, drawn: Map) -> "View":
        """View of a map over its one or two swept axes. Raises PlotError where more axes have several values."""
        swept = drawn_axes(drawn)
        if len(swept) > 2:
            names = ", ".join(parameters_of(swept))
            surplus = " and ".join(parameters_of(parted_axes(swept)[1]))
            raise PlotError(
                f"These results sweep {len(swept)} axes ({names}) and a map shows two: choose one value of {surplus} "
                "(--at), or draw a map for each (--facet)."
            )
        order = tuple(axis.values.argsort(kind="stable") for axis in swept)
        axes = tuple(axis.ascending for axis in swept)
        return cls(axes, fixed_parameters(drawn), tuple(map(drawn.axes.index, swept)), order)

    @classmethod
    def of_points(cls, drawn: Map, names: Sequence[str]) -> "View":
        """View of a map's cells as points over one or two of its parameters.

        Raises PlotError where a parameter does not change, or where points would hide each other: cells that differ in
        a dimension that is not drawn.
        """
        dimensions = parameters_of(drawn.axes)
        changing = {axis.parameter: axis for axis in (*drawn.parameters, *drawn.axes) if len(axis) > 1}
        for name in names:
            if name not in changing:
                raise PlotError(f"{name} does not change in these results; what does is {', '.join(changing)}.")
        along = [name if name in dimensions else RUN for name in names]
        shown = {*along, RUN} if len(names) == 1 else {*along}
        if hidden := [axis.parameter for axis in drawn_axes(drawn) if axis.parameter not in shown]:
            raise PlotError(
                f"Points that differ in {' and '.join(hidden)} would lie on each other: choose one value (--at), or "
                "draw a map for each (--facet)."
            )
        cells = np.indices(drawn.shape)
        axes = tuple(changing[name].ascending for name in names)
        places = tuple(
            changing[name].values[cells[dimensions.index(at)]].ravel() for name, at in zip(names, along, strict=True)
        )
        return cls(axes, fixed_parameters(drawn), places=places)

    @property
    def x(self) -> ResultAxis:
        """The axis from left to right."""
        return self.axes[0]

    @property
    def y(self) -> ResultAxis:
        """The upward axis."""
        return self.axes[1]

    def arrange(self, array: Array) -> Array:
        """Arrange an array of the results' shape as (nx,) or (nx, ny) along ascending axes; as (cells,) for points."""
        if self.places:
            return array.ravel()
        turned = np.moveaxis(array, self.keep, range(len(self.keep))).reshape([len(order) for order in self.order])
        return turned[np.ix_(*self.order)]


def parted_axes(swept: Sequence[ResultAxis]) -> tuple[list[ResultAxis], list[ResultAxis]]:
    """Axes parted into the two that a map shows, x first, and the further ones; `USUAL` axes are shown first."""
    ranked = sorted(swept, key=lambda axis: axis.parameter not in USUAL)
    shown = [axis for axis in swept if axis in ranked[:2]]
    return sorted(shown, key=lambda axis: axis.parameter != _X), ranked[2:]


def drawn_axes(drawn: Map) -> list[ResultAxis]:
    """Axes with more than one value, the load ratio first; where none has more than one, the first axis of the map."""
    several = [axis for axis in drawn.axes if len(axis) > 1] or drawn.axes[:1]
    return sorted(several, key=lambda axis: axis.parameter != _X)


def fixed_parameters(drawn: Map) -> ResultAxes:
    """Parameters with one value that is no drawn axis's: of axes, and of the coordinates of a single run."""
    shown = parameters_of(drawn_axes(drawn))
    return tuple(axis for axis in drawn.parameters if len(axis) == 1 and axis.parameter not in shown)


def ruler(axis: ResultAxis) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """Scale function of an axis and its inverse: the logarithm for a geometric axis, the identity for others."""
    return (np.log, np.exp) if axis.is_geometric else (np.asarray, np.asarray)


def cell_edges(axis: ResultAxis) -> Floats:
    """(n + 1,) edges of the cells around an axis's values: halfway between neighbours on the axis's scale."""
    values = axis.values
    if len(values) == 1:
        half = 0.5 * (abs(values[0]) or 1.0)
        return np.array([values[0] - half, values[0] + half])
    to, back = ruler(axis)
    scaled = np.pad(to(values), 1, "reflect", reflect_type="odd")  # the outer cells extend as far out as in
    return back(0.5 * (scaled[1:] + scaled[:-1]))


def cells_of(axis: ResultAxis, at: Floats) -> Positions:
    """Positions of the cells of an ascending axis in which points lie; points beyond it count to the end cells."""
    return np.clip(cell_edges(axis).searchsorted(at) - 1, 0, len(axis) - 1)


def scale_panels(figure: Figure, panels: Sequence[Axes], axes: Sequence[ResultAxis]) -> None:
    """Set scale and limits of the x and y axes that panels share; several panels have one name for each axis in all.

    An axis reaches from its least to its greatest value.
    """
    ax, is_single = panels[0], len(panels) == 1
    for which, axis in zip("xy", axes, strict=False):
        scale_axis(ax, which, axis, 10 if is_single else 5)
        ax.set(**{f"{which}lim": axis.ends})
    if not is_single:
        figure.subfigs[0].supxlabel(ax.get_xlabel(), fontsize=10.0)
        figure.subfigs[0].supylabel(ax.get_ylabel(), fontsize=10.0)
        ax.set(xlabel="", ylabel="")


def scale_axis(ax: Axes, which: str, axis: ResultAxis, most: int = 10) -> None:
    """Set name, unit, scale and ticks of one axis of a panel; which : "x" or "y"; most : number of ticks."""
    ax.set(**{f"{which}label": axis_label(axis)})
    line = getattr(ax, f"{which}axis")
    if not axis.is_geometric:
        line.set_major_locator(ticker.MaxNLocator(most, steps=[1, 2, 5, 10]))
        return
    # Plain numbers at the powers of ten; on an axis of less than three decades, at 2 and 5 times these, too.
    ax.set(**{f"{which}scale": "log"})
    is_short = axis.values[-1] < 1e3 * axis.values[0]
    line.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0) if is_short else (1.0,)))
    line.set_major_formatter("{x:g}")
    line.set_minor_formatter("")


def value_text(axis: ResultAxis, value: float, *, symbol: bool = False) -> str:
    """Text of a parameter's value with name and unit, or shorter with its `symbol`; of an axis of words, the word."""
    if axis.words:
        return axis.words[axis.nearest(value)]
    name = bare(axis.symbol) if symbol else axis.name
    return f"{name or axis.parameter} = {number_text(value)}{axis.unit_after}"


def number_text(value: float) -> str:
    """Text of a number in figures, to six digits: 1.6e6 rather than 1.6e+06, and a true minus sign."""
    return re.sub(r"e\+?(-?)0*", r"e\1", f"{value:.6g}").replace("-", MINUS)


def axis_label(axis: ResultAxis) -> str:
    """An axis's name, symbol and unit."""
    return with_unit(f"{plain(capital(axis.name))} {symbol_text(axis.symbol)}".rstrip(), plain(axis.unit))
