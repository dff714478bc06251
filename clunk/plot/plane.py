"""Results as a plane: what lies along which axis, in what order and on what scale."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import ticker
from matplotlib.axes import Axes

from clunk.plot.style import MINUS, PlotError, plain, symbol_text
from clunk.results.maps import Map
from clunk.study.axes import RUN, ResultAxis

Array = npt.NDArray[Any]
Floats = npt.NDArray[np.float64]

_USUAL = ("load.ratio", "lash.backlash_deg")
_MOST_COORDINATES = 3  # of a run in a title


@dataclass(frozen=True)
class View:
    """The swept axes of a map, ascending, and the order of its arrays along them."""

    axes: tuple[ResultAxis, ...]  # x and, if there are two, y
    fixed: tuple[ResultAxis, ...]  # parameters with one value
    keep: tuple[int, ...]
    order: tuple[npt.NDArray[np.intp], ...]

    @classmethod
    def of(cls, drawn: Map, dimensions: int) -> View:
        """The view of a map over this many axes. Raises PlotError where it has others."""
        keep = drawn_axes(drawn)
        if len(keep) != dimensions:
            swept = ", ".join(drawn.axes[index].parameter for index in keep)
            if len(keep) > 2:
                surplus = _surplus([drawn.axes[index] for index in keep])
                raise SurplusAxesError(
                    f"These results sweep {len(keep)} axes ({swept}) and a map shows two",
                    surplus,
                    [axis.parameter for axis in surplus[:2]],
                )
            words = {1: "one axis", 2: "two axes"}
            raise PlotError(
                f"This figure needs {words[dimensions]} and these results sweep {words[len(keep)]} ({swept})."
            )
        if dimensions == 2 and any(drawn.axes[index].parameter == RUN for index in keep):
            raise PlotError(
                "Runs that are drawn together have no order that a map could show: they are drawn as points over two "
                "of their parameters, x and y."
            )
        order = tuple(np.argsort(drawn.axes[index].values, kind="stable") for index in keep)
        ascending = ((drawn.axes[index], places) for index, places in zip(keep, order, strict=True))
        axes = tuple(replace(axis, values=axis.values[places]) for axis, places in ascending)
        return cls(axes, fixed_parameters(drawn), keep, order)

    @property
    def x(self) -> ResultAxis:
        """From left to right."""
        return self.axes[0]

    @property
    def y(self) -> ResultAxis:
        """Upwards."""
        return self.axes[1]

    def arrange(self, array: Array) -> Array:
        """An array of the results' shape as (nx,) or (nx, ny), ascending."""
        rest = tuple(axis for axis in range(array.ndim) if axis not in self.keep)
        turned = np.transpose(array, (*self.keep, *rest)).reshape([len(order) for order in self.order])
        return turned[np.ix_(*self.order)]


class SurplusAxesError(PlotError):
    """More axes than a figure shows.

    problem : the sentence without what to do about it
    surplus : axes of which one value may be chosen
    facets : parameters of which each value may have its own map instead
    """

    def __init__(self, problem: str, surplus: Sequence[ResultAxis], facets: Sequence[str] = ()) -> None:
        names = " and ".join(axis.parameter for axis in surplus)
        maps = f", or draw a map for each value of {' and '.join(facets)}" if facets else ""
        super().__init__(f"{problem}: choose one value of {names}{maps}.")
        self.problem, self.surplus, self.facets = problem, tuple(surplus), tuple(facets)


def drawn_axes(drawn: Map) -> tuple[int, ...]:
    """Indices of the axes with more than one value, x first; of the first axis if there is none.

    Of two, the load ratio is x.
    """
    keep = tuple(index for index, axis in enumerate(drawn.axes) if len(axis.values) > 1) or (0,)
    if len(keep) == 2 and drawn.axes[keep[1]].parameter == "load.ratio":
        keep = keep[::-1]
    return keep


def fixed_parameters(drawn: Map) -> tuple[ResultAxis, ...]:
    """Parameters with one value: axes, and a single run's coordinates or, if they are many, its number."""
    keep = drawn_axes(drawn)
    fixed: list[ResultAxis] = []
    for index, axis in enumerate(drawn.axes):
        if index not in keep or (axis.parameter == RUN and len(axis.values) == 1):
            few = axis.parameter == RUN and len(drawn.coordinates) <= _MOST_COORDINATES
            fixed += drawn.coordinates if few else [axis]
    return tuple(fixed)


def _surplus(axes: Sequence[ResultAxis]) -> list[ResultAxis]:
    """The axes beyond two, load ratio and backlash staying if they are there."""
    return sorted(axes, key=lambda axis: axis.parameter not in _USUAL)[2:]


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
    scaled = to(values)
    middle = 0.5 * (scaled[1:] + scaled[:-1])
    edges: Floats = back(np.concatenate(([2 * scaled[0] - middle[0]], middle, [2 * scaled[-1] - middle[-1]])))
    return edges


def scale_axes(ax: Axes, view: View) -> None:
    """Both axes of a map, from the first to the last value."""
    scale_axis(ax, "x", view.x)
    scale_axis(ax, "y", view.y)
    ax.set_xlim(view.x.values[0], view.x.values[-1])
    ax.set_ylim(view.y.values[0], view.y.values[-1])
    ax.tick_params(direction="out")


def scale_axis(ax: Axes, which: str, axis: ResultAxis) -> None:
    """Name, unit, scale and ticks of one axis, "x" or "y"."""
    label = axis_label(axis)
    if which == "x":
        ax.set_xlabel(label)
    else:
        ax.set_ylabel(label)
    line = ax.xaxis if which == "x" else ax.yaxis
    if not axis.is_geometric:
        line.set_major_locator(ticker.MaxNLocator(10, steps=[1, 2, 5, 10]))
    else:
        set_log_scale(ax, which, axis.values[0], axis.values[-1])


def set_log_scale(ax: Axes, which: str, low: float, high: float) -> None:
    """A logarithmic scale with plain numbers, some of them between the powers of ten: a short axis has few of those."""
    (ax.set_xscale if which == "x" else ax.set_yscale)("log")
    line = ax.xaxis if which == "x" else ax.yaxis
    line.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0) if math.log10(high / low) < 3 else (1.0,)))
    line.set_major_formatter(ticker.StrMethodFormatter("{x:g}"))
    line.set_minor_formatter(ticker.NullFormatter())


def value_text(axis: ResultAxis, value: float, *, symbol: bool = False) -> str:
    """A parameter's value with its name, or shorter with its `symbol`, and its unit."""
    name = axis.symbol.split("=")[0].strip() if symbol else axis.name
    unit = "" if axis.unit in ("", "1") else f" {axis.unit}"
    return f"{name or axis.parameter} = {number_text(value)}{unit}"


def number_text(value: float) -> str:
    """A number as figures write it: 1.6e6 for 1.6e+06."""
    return re.sub(r"e\+?(-?)0*", r"e\1", f"{value:.6g}").replace("-", MINUS)


def axis_span(axis: ResultAxis) -> str:
    """A parameter's name and from where to where it goes."""
    unit = "" if axis.unit in ("", "1") else f" {axis.unit}"
    return f"{axis.name or axis.parameter} from {number_text(axis.values[0])} to {number_text(axis.values[-1])}{unit}"


def axis_label(axis: ResultAxis) -> str:
    """An axis's name, symbol and unit."""
    name = axis.name or axis.parameter
    unit = "" if axis.unit in ("", "1") else f"[{axis.unit}]"
    parts = plain(name[:1].upper() + name[1:]), symbol_text(axis.symbol), plain(unit)
    return " ".join(part for part in parts if part)
