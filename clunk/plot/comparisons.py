"""Comparisons on maps: where two regime maps differ, and measured labels on a map, or before and after a fit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from clunk.analysis.comparison import Comparison
from clunk.analysis.fitted import Fitted, fit_maps
from clunk.analysis.trends import ExperimentComparison
from clunk.plot.layers import Layers, Measured, Note
from clunk.plot.maps import map_figure
from clunk.plot.style import INK, LINE_COLOURS
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.maps import Results
from clunk.study.errors import shorten
from clunk.study.records import counted

_RARE_COLOUR = "#a9adb0"
_MARKED = 6  # transitions with colours of their own
_LISTED = 3  # keys of the config that differ
_PALE = 0.25  # depth of the regimes' colours under differing cells


def difference_map(a: Results, comparison: Comparison) -> Figure:
    """The regimes of A, pale, and on them each cell that has another label in B, coloured by the two labels.

    a : the first of the maps that `comparison` compares

    Raises PlotError unless two axes were swept.
    """
    layers = Layers.of(a, 2)
    codes_a, codes_b, rest = map(layers.view.arrange, (comparison.codes_a, comparison.codes_b, comparison.differs))
    rest = rest.copy()
    marks = []
    for transition, colour in zip(comparison.transitions, LINE_COLOURS[:_MARKED], strict=False):
        code_a, code_b = comparison.labels.index(transition.a), comparison.labels.index(transition.b)
        cells = (codes_a == code_a) & (codes_b == code_b)
        rest &= ~cells
        marks.append((f"{transition.a} → {transition.b}", cells, colour))
    rare = len(comparison.transitions) - len(marks)
    marks.append((f"{rare} other transition{'' if rare == 1 else 's'}", rest, _RARE_COLOUR))
    marks.append((f"{FAILED} in B only", (codes_b == FAILED_CODE) & (codes_a != FAILED_CODE), INK))
    paint = 255.0 - _PALE * (255.0 - layers.region_colours)
    notes = []
    for text, cells, colour in marks:
        if cells.any():
            paint[cells] = list(bytes.fromhex(colour[1:]))
            notes.append(Note(f"{text}: {counted(int(np.count_nonzero(cells)), 'cell')}", colour))
    title = f"Differences: {a.title}" if len(set(comparison.titles.values())) == 1 else "Differences between two maps"
    undoubted = replace(
        layers,
        title=title,
        undecided=np.zeros_like(layers.undecided),
        paint=paint,
        notes=tuple(notes),
        facts=tuple(_differences(comparison)),
    )
    return map_figure([undoubted])


def experiment_map(results: Results, comparison: ExperimentComparison) -> Figure:
    """The regime map with the measured points on it: dots where the labels agree, crosses where not.

    results : what `comparison` compares the measurements with

    Raises PlotError unless two axes were swept.
    """
    layers = Layers.of(results, 2)
    across, upward = layers.view.keep
    points = [
        Measured(point.values[across], point.values[upward], point.measured, point.agrees)
        for point in comparison.points
        if point.computed is not None
    ]
    facts = (*layers.facts, f"points: measured, {comparison.experiment.name}", comparison.experiment.caveat)
    outside = (Note(f"outside the map, not counted: {comparison.outside}", ""),) if comparison.outside else ()
    return map_figure([replace(layers, points=tuple(points), facts=facts, notes=outside)])


def measured_on_maps(fitted: Fitted, workers: int | None = None) -> Figure:
    """The measured labels on maps before and after the fit, side by side, which are run: dots agree, crosses do not.

    Points are compared with their own runs, not with the map's nearest cells.

    Raises ClunkError unless two parameters were measured, PlotError where the maps cannot be drawn.
    """
    panels, names = [], []
    matches = {"nominal": fitted.nominal_matches, "fitted": fitted.estimate_matches}
    for (name, of_name), results in zip(matches.items(), fit_maps(fitted, workers), strict=True):
        layers = Layers.of(results, 2)
        places = fitted.points[:, [fitted.axes.index(axis.parameter) for axis in layers.view.axes]].tolist()
        labels = [each.label for each in fitted.experiment.measurements]
        met = (of_name["pattern"] == fitted.wanted).tolist()
        points = tuple(Measured(x, y, label, is_met) for (x, y), label, is_met in zip(places, labels, met, strict=True))
        panels.append(replace(layers, points=points))
        names.append(f"{name}: {sum(met)} of {len(points)} labels")
    return map_figure(panels, names)


def _differences(comparison: Comparison) -> list[str]:
    """Number of differing cells, titles and config of both maps; for the line under the title."""
    facts = [f"{comparison.differing:,} of {comparison.cells:,} cells differ"]
    if comparison.titles["a"] != comparison.titles["b"]:
        facts += [f"{letter.upper()}: {title}" for letter, title in comparison.titles.items()]
    changes = {key: each for key, each in comparison.config_differences.items() if key != "title"}
    if not changes:
        return [*facts, "A and B: the same config"]
    listed = [f"{key} = {_shortened(each['a'])} → {_shortened(each['b'])}" for key, each in changes.items()]
    more = f" and {len(changes) - _LISTED} more keys" if len(changes) > _LISTED else ""
    return [*facts, f"A → B: {', '.join(listed[:_LISTED])}{more}"]


def _shortened(value: Any) -> str:
    """A value of the config as text of 30 characters at most."""
    return "(not given)" if value is None else shorten(value, 30)
