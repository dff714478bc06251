"""Runs of a sample as points: where in two parameters which regime happens, or a quantity against one parameter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from clunk.core.status import QUALITY_UNDECIDED
from clunk.plot.labelling import present
from clunk.plot.maps import (
    colour_map,
    finish_bar,
    quantity_label,
    quantity_norm,
    quantity_values,
    subtitle_of,
    title_of,
    undecided_notes,
)
from clunk.plot.plane import at_option, axis_label, drawn_axes, fixed_parameters, set_log_scale
from clunk.plot.style import (
    FAILED_FILL,
    FAILED_HATCH,
    INK,
    PlotError,
    cells_phrase,
    freeze_layout,
    new_figure,
    palette_of,
    set_notes,
    set_titles,
    styled,
)
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.regimemap import Results
from clunk.study.axes import RUN, ResultAxis

Floats = npt.NDArray[np.float64]

_ROOM = 0.03  # of an axis's span, beside the outermost points
_LOG_SPAN = 30.0  # of the largest value over the smallest, from which a scale may be logarithmic
_NOT_KNOWN = "#ffffff"


def scatter_map(results: Results, x: str, y: str, quantity: str = "regimes") -> Figure:
    """Every run as a point over two parameters, in the colour of its label or of a quantity.

    Raises PlotError where x or y is not swept, points would lie on each other, or the quantity is defined nowhere.
    """
    across, upward = _parameter(results, x), _parameter(results, y)
    _require_points_apart(results, (x, y))
    codes = results.sequence.ravel()
    values = None if quantity == "regimes" else quantity_values(results, quantity).ravel()
    with styled():
        figure = new_figure()
        ax = figure.add_subplot()
        _titles(figure, ax, results)
        at = _values_of(results, across), _values_of(results, upward)
        if values is None:
            notes = _points_by_label(ax, results, *at)
        else:
            shown = np.isfinite(values)
            colour: dict[str, Any] = {"cmap": colour_map(quantity), "norm": quantity_norm(values, quantity)}
            points = ax.scatter(at[0][shown], at[1][shown], c=values[shown], **_look(codes.size), **colour, zorder=3)
            finish_bar(figure.colorbar(points, ax=ax, pad=0.02, aspect=28), quantity)
            notes = _undefined_points(ax, codes, values, *at)
        notes += _mark_failed(ax, codes, *at)
        _finish(figure, ax, (across, upward), notes)
        return figure


def scatter_curve(results: Results, x: str, quantity: str) -> Figure:
    """A quantity of every run over one parameter, each point in the colour of its label.

    The runs may all have the same x, whose points then show their spread.

    Raises PlotError where x is not swept, other axes are left, or the quantity is defined nowhere.
    """
    label = quantity_label(quantity)
    across = _parameter(results, x)
    _require_points_apart(results, (x, RUN))
    values = quantity_values(results, quantity).ravel()
    with styled():
        figure = new_figure()
        ax = figure.add_subplot()
        _titles(figure, ax, results)
        notes = _points_by_label(ax, results, _values_of(results, across), values)
        failed = int(np.count_nonzero(results.sequence == FAILED_CODE))
        if failed:
            notes.append(Line2D([], [], linestyle="none", label=f"{FAILED}, not shown: {cells_phrase(failed)}"))
        ax.set_ylabel(label)
        _finish(figure, ax, (across,), notes)
        return figure


def parameter_choice(results: Results) -> tuple[str, ...]:
    """Of what two parameters a sample is drawn by default, or the only one.

    The grid's axes first, then load ratio and backlash, then the others in order.
    """
    axes = [results.axes[index].parameter for index in drawn_axes(results)]
    drawn = [axis.parameter for axis in results.coordinates]
    usual = [name for name in ("load.ratio", "lash.backlash_deg") if name in drawn]
    names = [name for name in axes if name != RUN] + usual + [name for name in drawn if name not in usual]
    return tuple(names[:2])


def _parameter(results: Results, name: str) -> ResultAxis:
    """A parameter that changes."""
    changing = {axis.parameter: axis for axis in (*results.parameters, *results.axes) if len(axis.values) > 1}
    if name not in changing:
        raise PlotError(f"{name} does not change in these results; what does is {', '.join(changing)}.")
    return changing[name]


def _require_points_apart(results: Results, chosen: Sequence[str]) -> None:
    """Cells that differ in a dimension that is not drawn would lie on each other."""
    if len(set(chosen)) < len(chosen):
        raise PlotError(f"--x and --y are both {chosen[0]}; name two parameters.")
    axes = {results.axes[index].parameter: results.axes[index] for index in drawn_axes(results)}
    hidden = set(axes) - {name if name in axes else RUN for name in chosen}
    if hidden:
        others = [axis for name, axis in axes.items() if name in hidden]
        raise PlotError(
            f"Points that differ in {', '.join(axis.parameter for axis in others)} would lie on each other: also give "
            f"{' '.join(map(at_option, others))}, for example{', or --facet run' if hidden == {RUN} else ''}."
        )


def _values_of(results: Results, axis: ResultAxis) -> Floats:
    """A parameter's value in every cell, in C order."""
    own = [each.parameter for each in results.axes]
    dimension = own.index(axis.parameter if axis.parameter in own else RUN)
    shape = [-1 if k == dimension else 1 for k in range(len(own))]
    return np.broadcast_to(axis.values.reshape(shape), results.shape).ravel()


def _titles(figure: Figure, ax: Axes, results: Results) -> None:
    count = f"{results.sequence.size:,} runs"
    set_titles(figure, ax, title_of(results), subtitle_of(results, fixed_parameters(results), [count]))


def _look(count: int) -> dict[str, Any]:
    """Points that are seen one by one in a small sample, and as a cloud in a large one."""
    size = float(np.clip(6.5 * (256.0 / count) ** 0.35, 1.6, 6.5))
    return {"s": size**2, "edgecolors": INK, "linewidths": 0.5 if size > 3.0 else 0.0}


def _points_by_label(ax: Axes, results: Results, x: Floats, y: Floats) -> list[Artist]:
    """Points in their labels' colours, and the notes that name them."""
    codes, palette = results.sequence.ravel(), palette_of(results.labels)
    look = _look(codes.size)
    colours = np.array([palette[label] for label in results.labels] + [FAILED_FILL])
    known = (codes != FAILED_CODE) & np.isfinite(y)
    ax.scatter(x[known], y[known], c=colours[codes[known]], **look, zorder=3)
    undecided = known & (results.quality.ravel() & QUALITY_UNDECIDED != 0)
    ax.plot(x[undecided], y[undecided], ".", color=INK, markersize=1.5, zorder=4, gid="undecided")
    notes: list[Artist] = []
    for label in present(results.labels, codes):
        cells = cells_phrase(int(np.count_nonzero(codes == results.labels.index(label))))
        notes.append(_handle(f"{label}: {cells}", palette[label]))
    return [*notes, *undecided_notes(int(np.count_nonzero(undecided)))]


def _undefined_points(ax: Axes, codes: npt.NDArray[np.int16], values: Floats, x: Floats, y: Floats) -> list[Artist]:
    undefined = np.isnan(values) & (codes != FAILED_CODE)
    if not undefined.any():
        return []
    ax.scatter(x[undefined], y[undefined], c=_NOT_KNOWN, **_look(codes.size), zorder=2)
    return [_handle("not defined (no events)", _NOT_KNOWN)]


def _mark_failed(ax: Axes, codes: npt.NDArray[np.int16], x: Floats, y: Floats) -> list[Artist]:
    failed = codes == FAILED_CODE
    if not failed.any():
        return []
    ax.plot(x[failed], y[failed], "x", color=FAILED_HATCH, markersize=4.0, zorder=2, gid="failed")
    note = f"{FAILED}: {cells_phrase(int(np.count_nonzero(failed)))}"
    return [Line2D([], [], linestyle="none", marker="x", color=FAILED_HATCH, label=note)]


def _handle(text: str, fill: str) -> Line2D:
    look: dict[str, Any] = {"markerfacecolor": fill, "markeredgecolor": INK}
    return Line2D([], [], linestyle="none", marker="o", markersize=6.0, markeredgewidth=0.5, label=text, **look)


def _finish(figure: Figure, ax: Axes, axes: tuple[ResultAxis, ...], notes: list[Artist]) -> None:
    """Names, scales and limits of the drawn parameters' axes, and the notes under them."""
    for which, axis in zip("xy", axes, strict=False):
        low, high = float(axis.values.min()), float(axis.values.max())
        limits = low - _ROOM * (high - low), high + _ROOM * (high - low)
        if _is_skew(axis):
            set_log_scale(ax, which, low, high)
            limits = low * (low / high) ** _ROOM, high * (high / low) ** _ROOM
        ax.set(**{f"{which}lim": limits, f"{which}label": axis_label(axis)})
    ax.grid(color="0.92", linewidth=0.6)
    ax.set_axisbelow(True)
    set_notes(figure, notes)
    freeze_layout(figure, ax)


def _is_skew(axis: ResultAxis) -> bool:
    """Whether most values crowd at the lower end of a wide span, as those of a wide lognormal distribution do."""
    low, middle, high = np.quantile(axis.values, (0.0, 0.5, 1.0))
    return bool(low > 0.0 and high > _LOG_SPAN * low and middle < 0.2 * high)
