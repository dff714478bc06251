"""Axes of figures: which parameters are x and y, arrays in the order of their values, scales and numbers."""

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

_X = "load.ratio"  # from left to right wherever it is an axis
USUAL = (_X, "lash.backlash_deg")  # stay axes of a map where others are fixed


class View(NamedTuple):
    """The axes that a map is drawn over, ascending, and the order of its arrays along them, or its cells as points.

    axes : x and, if there are two, y
    fixed : parameters with one value
    keep, order : of a grid each axis's dimension in the map, and the order of its values
    places : of points the value on each axis of every cell, in C order; of a grid none
    """

    axes: ResultAxes
    fixed: ResultAxes
    keep: tuple[int, ...] = ()
    order: tuple[Positions, ...] = ()
    places: tuple[Floats, ...] = ()

    @classmethod
    def of(cls, drawn: Map, x: str | None = None, y: str | None = None) -> "View":
        """The view of a grid over its axes, or of the runs of a sample or of axes that are walked together as points.

        x, y : of runs the parameters, by default a grid's axis, load ratio and backlash first; one alone leaves the
            other to a quantity

        Raises PlotError where the map has more axes, or other parameters.
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
        """The same over two axes. Raises PlotError where the map has one."""
        view = cls.of(drawn, x, y)
        if len(view.axes) < 2:
            raise PlotError(f"This figure needs two axes, and here is one: {view.x.parameter}.")
        return view

    @classmethod
    def of_grid(cls, drawn: Map) -> "View":
        """The view of a map over its one or two swept axes. Raises PlotError where it has more."""
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
        """The view of a map's cells as points over one or two of its parameters.

        Raises PlotError where one does not change, or cells that differ in a dimension that is not drawn would lie on
        each other.
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
        """Turn an array of the results' shape into (nx,) or (nx, ny), ascending; of points into C order."""
        if self.places:
            return array.ravel()
        turned = np.moveaxis(array, self.keep, range(len(self.keep))).reshape([len(order) for order in self.order])
        return turned[np.ix_(*self.order)]


def parted_axes(swept: Sequence[ResultAxis]) -> tuple[list[ResultAxis], list[ResultAxis]]:
    """The two axes that a map shows, x first, and those beyond."""
    ranked = sorted(swept, key=lambda axis: axis.parameter not in USUAL)
    shown = [axis for axis in swept if axis in ranked[:2]]
    return sorted(shown, key=lambda axis: axis.parameter != _X), ranked[2:]


def drawn_axes(drawn: Map) -> list[ResultAxis]:
    """The axes with more than one value, x first; the first axis if there is none."""
    several = [axis for axis in drawn.axes if len(axis) > 1] or drawn.axes[:1]
    return sorted(several, key=lambda axis: axis.parameter != _X)


def fixed_parameters(drawn: Map) -> ResultAxes:
    """Parameters with one value: axes, and a single run's coordinates."""
    shown = parameters_of(drawn_axes(drawn))
    return tuple(axis for axis in drawn.parameters if len(axis) == 1 and axis.parameter not in shown)


def ruler(axis: ResultAxis) -> tuple[Callable[[Any], Any], Callable[[Any], Any]]:
    """The scale of an axis and its inverse: halfway between two values of a geometric axis is their geometric mean."""
    return (np.log, np.exp) if axis.is_geometric else (np.asarray, np.asarray)


def cell_edges(axis: ResultAxis) -> Floats:
    """(n + 1,) limits of cells centred on their values."""
    values = axis.values
    if len(values) == 1:
        half = 0.5 * (abs(values[0]) or 1.0)
        return np.array([values[0] - half, values[0] + half])
    to, back = ruler(axis)
    scaled = np.pad(to(values), 1, "reflect", reflect_type="odd")  # beyond both ends as far apart as at them
    return back(0.5 * (scaled[1:] + scaled[:-1]))


def cells_of(axis: ResultAxis, at: Floats) -> Positions:
    """Positions of the cells of an ascending axis in which points lie; beyond it the first and the last."""
    return np.clip(cell_edges(axis).searchsorted(at) - 1, 0, len(axis) - 1)


def scale_panels(figure: Figure, panels: Sequence[Axes], axes: Sequence[ResultAxis]) -> None:
    """Scale x and y of panels that share them, from the first to the last value; of several they are named once."""
    ax, is_single = panels[0], len(panels) == 1
    for which, axis in zip("xy", axes, strict=False):
        scale_axis(ax, which, axis, 10 if is_single else 5)
        ax.set(**{f"{which}lim": axis.ends})
    if not is_single:
        figure.subfigs[0].supxlabel(ax.get_xlabel(), fontsize=10.0)
        figure.subfigs[0].supylabel(ax.get_ylabel(), fontsize=10.0)
        ax.set(xlabel="", ylabel="")


def scale_axis(ax: Axes, which: str, axis: ResultAxis, most: int = 10) -> None:
    """Set name, unit, scale and ticks of one axis, "x" or "y"; most : ticks."""
    ax.set(**{f"{which}label": axis_label(axis)})
    line = getattr(ax, f"{which}axis")
    if not axis.is_geometric:
        line.set_major_locator(ticker.MaxNLocator(most, steps=[1, 2, 5, 10]))
        return
    # Plain numbers, some of them between the powers of ten: a short axis has few of those.
    ax.set(**{f"{which}scale": "log"})
    is_short = axis.values[-1] < 1e3 * axis.values[0]
    line.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0) if is_short else (1.0,)))
    line.set_major_formatter("{x:g}")
    line.set_minor_formatter("")


def value_text(axis: ResultAxis, value: float, *, symbol: bool = False) -> str:
    """A parameter's value with its name, or shorter with its `symbol`, and its unit; or its word."""
    if axis.words:
        return axis.words[axis.nearest(value)]
    name = bare(axis.symbol) if symbol else axis.name
    return f"{name or axis.parameter} = {number_text(value)}{axis.unit_after}"


def number_text(value: float) -> str:
    """A number as figures write it: 1.6e6 for 1.6e+06."""
    return re.sub(r"e\+?(-?)0*", r"e\1", f"{value:.6g}").replace("-", MINUS)


def axis_label(axis: ResultAxis) -> str:
    """An axis's name, symbol and unit."""
    return with_unit(f"{plain(capital(axis.name))} {symbol_text(axis.symbol)}".rstrip(), plain(axis.unit))
