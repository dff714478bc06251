"""Figures of analyses: maps compared, measured labels, thresholds, Sobol indices, optima."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import cycle, groupby

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from clunk.analysis.comparison import Comparison
from clunk.analysis.fitted import Fitted, fit_maps
from clunk.analysis.measurements import ExperimentComparison
from clunk.analysis.optimisation import RELEASE_TIME, Front
from clunk.analysis.sobol import CONFIDENCE, Sensitivity
from clunk.analysis.thresholds import DRAW, QUANTILE, Thresholds
from clunk.plot.layers import Layers, Measured, Note
from clunk.plot.maps import map_figure
from clunk.plot.plane import View, axis_label, cell_edges, scale_panels, value_text
from clunk.plot.style import (
    FAILED_FILL,
    INK,
    LINE_COLOURS,
    Look,
    PlotError,
    colour_of,
    lay_out,
    new_figure,
    new_panels,
    plain,
    shades,
    styled,
    swatch,
    symbol_text,
    tidy,
    tint,
)
from clunk.results.labels import FAILED, FAILED_CODE, primary_impacts
from clunk.results.maps import Results
from clunk.results.quantities import quantity_of
from clunk.study.axes import ResultAxis, parameters_of
from clunk.study.designs import axis_of
from clunk.study.parameters import quantity
from clunk.study.records import capital, counted, fill, words

_RARE_COLOUR = "#a9adb0"
_MARKED = 6  # most frequent transitions that have a colour each; the others share one
_LISTED = 3  # differing keys of two configs that a figure names; of the others it gives the number
_PALE = 0.25  # depth of the regimes' colours around differing cells: 0 is white, 1 the full colour
_NARROWEST = 0.002  # narrowest band that is drawn, as a share of the axis
_WITHOUT: Look = {"color": INK, "linewidth": 1.2, "linestyle": "--", "label": "without tolerances"}
_WIDTH = 7.2  # inches, width of bar charts
_BAR = 0.36  # width of a bar, as a share of the distance from one parameter to the next
_INTERVAL = {"ecolor": INK, "elinewidth": 1.0, "capsize": 2.0}
_FIRST, _SECOND = LINE_COLOURS[:2]

# --- Labels on maps


def difference_map(comparison: Comparison) -> Figure:
    """Map of the differences between two maps: the regimes of A, pale, and each cell that has another label in B.

    A differing cell has the colour of its pair of labels. Cells that failed in B only are marked, too.

    Raises PlotError unless two axes were swept.
    """
    a, _ = comparison.maps
    layers = Layers.of(a, View.of_plane(a))
    codes_a, codes_b, rest = map(layers.view.arrange, (comparison.codes_a, comparison.codes_b, comparison.differs))
    marks = []
    for transition, colour in zip(comparison.transitions, LINE_COLOURS[:_MARKED], strict=False):
        code_a, code_b = comparison.labels.index(transition.a), comparison.labels.index(transition.b)
        cells = (codes_a == code_a) & (codes_b == code_b)
        rest = rest & ~cells
        marks.append((f"{transition.a} → {transition.b}", cells, colour))
    marks.append((f"other transitions ({len(comparison.transitions) - len(marks)})", rest, _RARE_COLOUR))
    marks.append((f"{FAILED} in B only", (codes_b == FAILED_CODE) & (codes_a != FAILED_CODE), INK))
    paint, notes = 255.0 - _PALE * (255.0 - layers.colours_of(layers.codes)), []
    for text, cells, colour in marks:
        if cells.any():
            paint[cells] = list(bytes.fromhex(colour[1:]))
            notes.append(Note(f"{text}: {counted(cells.sum(), 'cell')}", colour))
    differing = f"{comparison.differing:,} of {comparison.cells:,} cells differ"
    keys = list(comparison.config_differences)
    more = f" and {len(keys) - _LISTED} more keys" if len(keys) > _LISTED else ""
    configs = f"configs differ in {', '.join(keys[:_LISTED])}{more}" if keys else "the same config"
    title = f"Differences: {a.title}" if len(set(comparison.titles.values())) == 1 else "Differences between two maps"
    layers = replace(layers, title=title, undecided=np.zeros_like(layers.undecided), facts=(differing, configs))
    return map_figure([replace(layers, paint=paint, notes=tuple(notes))])


def experiment_map(results: Results, comparison: ExperimentComparison) -> Figure:
    """Regime map with the measured points on it: dots where measured and computed labels agree, crosses elsewhere.

    Points outside the swept range are only counted, in a note.

    results : the map with which `comparison` compares the measurements

    Raises PlotError unless two axes were swept.
    """
    inside = [
        (point.at, point.measured, bool(point.agrees)) for point in comparison.points if point.computed is not None
    ]
    layers = _with_points(results, inside)
    facts = (*layers.facts, f"points: measured, {comparison.experiment}", comparison.caveat)
    outside = (Note(f"outside the map, not counted: {comparison.outside}", ""),) if comparison.outside else ()
    return map_figure([replace(layers, facts=facts, notes=outside)])


def measured_on_maps(fitted: Fitted) -> Figure:
    """Run the maps before and after the fit, and draw them side by side with the measured labels on them.

    A dot is a label that the model has at that point, a cross one that it has not. Points are compared with their own
    runs, not with the map's nearest cells.

    Raises ClunkError unless exactly two of the measured parameters vary, PlotError where the maps cannot be drawn.
    """
    panels, names = [], []
    matches = {"nominal": fitted.nominal_matches, "fitted": fitted.estimate_matches}
    for (name, of_name), results in zip(matches.items(), fit_maps(fitted), strict=True):
        met = (of_name["label"] == fitted.wanted).tolist()
        points = [(each.at, each.label, is_met) for each, is_met in zip(fitted.measured, met, strict=True)]
        panels.append(_with_points(results, points))
        names.append(f"{name}: {sum(met)} of {len(met)} labels")
    return map_figure(panels, names)


def _with_points(results: Results, points: Sequence[tuple[Mapping[str, float], str, bool]]) -> Layers:
    """Layers of a map with measured points.

    points : of each, its values by parameter, the measured label, and whether the model has that label there
    """
    layers = Layers.of(results, View.of_plane(results))
    x, y = parameters_of(layers.view.axes)
    return replace(layers, points=tuple(Measured(at[x], at[y], label, is_met) for at, label, is_met in points))


# --- Thresholds


def other_axis(axes: Sequence[ResultAxis]) -> ResultAxis:
    """The only axis with several values, draws and quantiles aside; `axes` are those of thresholds, without the key's.

    Raises PlotError where there is no such axis, or more than one.
    """
    several = [axis for axis in axes if len(axis) > 1 and axis.parameter not in (DRAW, QUANTILE)]
    if len(several) > 1:
        names = " and ".join(parameters_of(several))
        raise PlotError(f"Thresholds are drawn over one other axis: take one value of {names} (--at).")
    if not several:
        raise PlotError("There is no other axis to draw thresholds over; -o FILE.csv takes them.")
    return several[0]


@styled()
def threshold_figure(thresholds: Thresholds, nominal: Thresholds | None = None) -> Figure:
    """Figure of thresholds: outcomes as coloured bands over the other axis, and thresholds as curves between the bands.

    The key is the upward axis, on which the curves are exact at the other axis's values. For quantiles of draws, a band
    is where at least a share of the drawn drivelines has the same outcome; larger shares are darker.

    nominal : thresholds without tolerances, drawn as dashed curves; only where `thresholds` are quantiles of draws

    Raises PlotError unless exactly one other axis has several values.
    """
    single = nominal or thresholds
    x, study = other_axis(single.axes), thresholds.study
    figure = new_figure()
    ax = figure.subplots()
    tints = shades(len(thresholds.words))
    fills = {FAILED_CODE: FAILED_FILL}
    for code, word in enumerate(thresholds.words):
        fills[code] = colour_of(word) if isinstance(word, str) else tints[code]
    drawn, curves, seen = "thresholds of", [], set()
    shares, colours = [1.0], [INK]
    if nominal is not None:
        drawn = f"share of {study.swept.sampling.count:,} drivelines"
        shares, colours = thresholds.axes[-1].values.tolist(), [*LINE_COLOURS[1:]]
    for (rank, k), colour in zip(enumerate(np.argsort(shares)), cycle(colours), strict=False):
        paler = {code: tint(fill, (rank + 1.0) / len(shares)) for code, fill in fills.items()}
        seen |= _draw_bands(ax, thresholds, x, paler, slice(k, None, len(shares)), color=colour)
        curves.append(Line2D([], [], color=colour, linewidth=1.6, label=f"in {100.0 * shares[k]:g} %"))
    if nominal is not None:
        _draw_bands(ax, nominal, x, {}, slice(None), **_WITHOUT)
        curves.append(Line2D([], [], **_WITHOUT))
    scale_panels(figure, [ax], (x, thresholds.along))
    fixed = [value_text(axis, axis.values[0]) for axis in single.axes if len(axis) == 1]
    ordered = sorted(seen, key=lambda code: (primary_impacts(str(thresholds.word(code))), code))
    notes = [swatch(words(thresholds.word(code)), fills[code]) for code in ordered]
    line = "; ".join([f"{drawn}: {single.outcome.heading_with_unit}", *fixed])
    lay_out(figure, ax, study.title, line, [*notes, *(curves if nominal else [])])
    return figure


def _bands(thresholds: Thresholds, cell: int) -> tuple[tuple[int, ...], list[float]]:
    """Codes of the outcomes in a cell's intervals, and the thresholds between these intervals.

    Intervals too narrow to see are left out, and neighbours that then have the same code are joined.
    """
    narrowest = _NARROWEST * np.ptp(thresholds.along.values)
    codes: list[int] = []
    begins = []
    for begin, end, code in thresholds.intervals(cell):
        if end - begin >= narrowest and codes[-1:] != [code]:
            codes.append(code)
            begins.append(begin)
    return tuple(codes), begins[1:]


def _draw_bands(
    ax: Axes, thresholds: Thresholds, x: ResultAxis, fills: Mapping[int, str], every: slice, **look: object
) -> set[int]:
    """Fill the key's intervals of one outcome as bands over the axis `x`, and draw the thresholds between as curves.

    fills : colour of each code; bands of other codes stay empty
    every : slice of the thresholds' cells that picks those to draw, one for each value of `x`
    look : of the curves

    Returns the codes of the outcomes that have a filled band.
    """
    seen = set()
    low, high = thresholds.along.values[[0, -1]]
    cells = np.arange(thresholds.lowest.size)[every][x.values.argsort(kind="stable")]
    x = x.ascending
    edges = cell_edges(x).clip(x.values[0], x.values[-1])
    columns = [_bands(thresholds, cell) for cell in cells.tolist()]
    for codes, group in groupby(range(len(columns)), key=lambda k: columns[k][0]):
        alike = list(group)
        across = np.array([edges[alike[0]], *x.values[alike], edges[alike[-1] + 1]])
        between = np.array([columns[k][1] for k in alike]).reshape(len(alike), len(codes) - 1).T
        levels = np.pad(between, ((0, 0), (1, 1)), "edge")
        line: Look = {"color": INK, "linewidth": 1.4, "zorder": 3} | look
        ax.plot(across, levels.T, **line)
        levels = np.vstack([np.full(across.size, low), levels, np.full(across.size, high)])
        for code, lower, upper in zip(codes, levels[:-1], levels[1:], strict=True):
            if code in fills:
                ax.fill_between(across, lower, upper, zorder=1, facecolor=fills[code], linewidth=0.0, antialiased=False)
                seen.add(code)
    return seen


# --- Sensitivities, optima


@styled()
def sobol_bars(sensitivity: Sensitivity) -> Figure:
    """Bar chart of the first-order and total Sobol index of each parameter, with their confidence intervals.

    Each quantity that varies has a panel. The parameters of all panels are in the order of the first panel's total
    indices, the largest on top.

    Raises PlotError where no quantity varies.
    """
    drawn = [(each.heading, each.indices) for each in sensitivity.indices if each.indices]
    if not drawn:
        raise PlotError("There are no indices to draw: every quantity is the same in all runs, or nearly.")
    parameters = [*drawn[0][1]]
    places = np.arange(len(parameters))
    figure, panels = new_panels(len(drawn), 1, (_WIDTH, 1.0 + len(drawn) * (0.6 + 0.45 * len(parameters))))
    for ax, (heading, shares) in zip(panels, drawn, strict=True):
        ordered = [vars(shares[parameter]) for parameter in parameters]
        for name, colour, at in (("first", _FIRST, -0.5 * _BAR), ("total", _SECOND, 0.5 * _BAR)):
            share, *interval = np.transpose([(each[name], *each[f"{name}_interval"]) for each in ordered])
            ax.barh(places + at, share, _BAR, color=colour, xerr=abs(interval - share), error_kw=_INTERVAL)
        ax.axvline(0.0, color=INK, linewidth=0.8)
        ax.set_title(fill(capital(heading)), loc="left", fontsize=9.0)
        tidy(ax, "x")
    names = [f"{plain(capital(axis.name))}, {symbol_text(axis.symbol)}" for axis in map(quantity, parameters)]
    panels[0].set_yticks(places, names)
    panels[0].set_ylim(len(parameters) - 0.5, -0.5)
    panels[-1].set_xlabel(f"Share of the variance, with {100 * CONFIDENCE:g} % intervals")
    notes = [swatch("alone (first-order index)", _FIRST), swatch("in all (total index)", _SECOND)]
    point = ((quantity(parameter), value) for parameter, value in sensitivity.at.items())
    line = ", ".join(f"{axis.name} {value:g} {axis.unit.removeprefix('1')}".rstrip() for axis, value in point)
    lay_out(figure, panels[0], sensitivity.study.title, line, notes)
    return figure


@styled()
def trade_off(front: Front) -> Figure:
    """Curve of the minimised value over the bounded quantity, with a point for each optimum of a trade-off."""
    figure = new_figure()
    ax = figure.add_subplot()
    minimized, bounded = front.traded
    ax.plot(*([best.quantities[name] for best in front.points] for name in (bounded, minimized)), "o-", color=INK)
    ax.set(xlabel=_label(bounded, front), ylabel=_label(minimized, front))
    tidy(ax)
    lay_out(figure, ax, front.points[0].study.title, f"the least {minimized} for each {bounded}")
    return figure


def _label(name: str, front: Front) -> str:
    """Axis label of what a trade-off compares: a quantity, a key of the config, or the release time  [s]."""
    if name == RELEASE_TIME:
        return "Release time [s]"
    if name in front.points[0].parameters:
        return axis_label(axis_of(name, np.zeros(1)))
    return quantity_of(name, front.points[0].study).plot_label
