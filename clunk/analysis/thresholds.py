"""Thresholds: the values of a swept key at which an outcome changes, in every cell of the other axes.

The runs at the axis's own values are a scan: between two neighbours of different outcome lies a threshold. All of these
brackets are narrowed side by side (`clunk.analysis.search`).

With tolerances each drawn driveline has thresholds of its own, along a further axis, `draw`; the draws are those of a
tolerance map, made once for all cells. `threshold_quantiles` sums them up: at a value of the key the probability of an
outcome is the share of the draws that have it there, which is constant between neighbouring thresholds of all draws.

A pair of thresholds between two values of the axis shows in no outcome at these values. Such pairs are looked for where
the touches of two neighbours differ by two or more, and where the measure of the runs (the margin, or the distance of
a quantity from its bound) dips towards zero.

The search ends, whatever the runs do (`clunk.analysis.search`): hidden thresholds are looked for down to the spacing
over 2^`_HALVINGS`, and a bracket between neighbours whose outcomes differ becomes `_MOST` brackets at most. Where the
outcome changes more often than that, as labels do where touches without end are cut off, or motion is chaotic, the
brackets are left as wide as they are then, and the place is among `Thresholds.unresolved`.
"""

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from clunk.analysis.search import (
    OFF_FAILURES,
    TOLERANCE,
    PointRuns,
    Points,
    Word,
    check_axis,
    grid_axes,
    narrow,
    with_hidden,
)
from clunk.core.status import Status
from clunk.results.labels import FAILED, FAILED_CODE, normalised_label
from clunk.results.quantities import LABEL, NOMINAL, NUMBER, Quantity, quantity_of
from clunk.study.arrays import Codes, Floats
from clunk.study.axes import ResultAxes, ResultAxis, parameters_of
from clunk.study.designs import Design
from clunk.study.errors import ClunkError, listing, nearest, shorten
from clunk.study.models import WhichLash, lash_position
from clunk.study.parameters import drawn_numbers, numbered, spellings, with_draws
from clunk.study.records import as_text
from clunk.study.study import Study, takes_study
from clunk.sweeping.progress import ShowProgress, reporting
from clunk.sweeping.sweep import engine_of

DRAW = "draw"  # the axis of the drawn drivelines, their numbers from 1
UNCERTAIN, UNCERTAIN_CODE = "uncertain", -3  # see `threshold_quantiles`

_HALVINGS = 16  # of the spacing in search of hidden thresholds: 22 halvings found no more
_MOST = 32  # most thresholds that are resolved between two neighbouring values of the axis


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Thresholds(Design):
    """The thresholds of an outcome along a key, in each cell of the other axes.

    Cells are numbered in C order of the other axes; without other axes there is one cell. n is the number of thresholds
    of all cells, which are in the order of cells and, in each, of ascending values.

    study : Study
    along : the key's axis, its values ascending
    axes : the other axes; with tolerances the first is `draw`
    outcome : Quantity
    words : code -> label, whether something holds, or count; the code -1 is `failed`, and -3 `uncertain`
    lowest : (cells,) int64, the outcome's code at the axis's least value
    cell : (n,) int64
    value : (n,) float64, in the key's unit, right to 1e-9 of the axis's range where it is resolved, to 1e-3 where runs
        begin to fail
    off : (n,) float64, in the key's unit, by how much the value may be off: half the width of its bracket
    below, above : (n,) int64, the outcome's code at smaller and at greater values
    runs : number of runs that the search took
    failures : number of these that failed, by their cause
    lash : name of the lash whose outcome it is; empty where there is one
    """

    study: Study
    along: ResultAxis
    outcome: Quantity
    words: tuple[Word, ...]
    lowest: Codes
    cell: Codes
    value: Floats
    off: Floats
    below: Codes
    above: Codes
    runs: int
    failures: dict[Status, int]
    lash: str = ""

    def __repr__(self) -> str:
        rows = [("along", f"{self.along.parameter}: {self.along.spread}"), ("of", self.outcome.name)]
        rows += [("lash", self.lash)] if self.lash else []
        rows += [("cells", f"{axis.parameter}: {axis.spread}") for axis in self.axes]
        return as_text(f"clunk.Thresholds {self.study.title!r}", [*rows, ("thresholds", f"{self.value.size:,}")])

    def word(self, code: int) -> Word:
        """The outcome of a code."""
        return {FAILED_CODE: FAILED, UNCERTAIN_CODE: UNCERTAIN}.get(code) or self.words[code]

    def at(self, cell: int) -> dict[str, float]:
        """Values of the other axes in a cell, by parameter."""
        return {key: float(value) for key, value in self.columns(np.array(cell)).items()}

    @property
    def unresolved(self) -> list[tuple[int, float, float]]:
        """Places at which the outcome changes too often to be followed: the cell, and the key's values at both ends.

        There is one place at most between two neighbouring values of the axis.
        """
        fails = (self.below == FAILED_CODE) | (self.above == FAILED_CODE)
        wide = self.off > np.where(fails, OFF_FAILURES, TOLERANCE) * np.ptp(self.along.values)
        begins, ends = self.value - self.off, self.value + self.off
        at = np.stack([self.cell, self.along.values.searchsorted(self.value)])
        places = np.unique(at[:, wide], axis=1).T
        rows = [wide & (place == at.T).all(axis=1) for place in places]
        return [(int(cell), begins[row].min(), ends[row].max()) for (cell, _), row in zip(places, rows, strict=True)]

    def intervals(self, cell: int) -> list[tuple[float, float, int]]:
        """The intervals of the axis with one outcome each in a cell, ascending: begin, end and code."""
        first, last = self.cell.searchsorted([cell, cell + 1])
        ends = self.along.values[[0, -1]].tolist()
        inner, codes = self.value[first:last].tolist(), self.above[first:last].tolist()
        return [*zip([ends[0], *inner], [*inner, ends[1]], [int(self.lowest[cell]), *codes], strict=True)]

    def rows(self) -> list[dict[str, Any]]:
        """A row for each threshold: values of the other axes, of the threshold, and the outcomes `below` and `above`.

        A cell without thresholds has one row, with None as the threshold's value.
        """
        rows = []
        for cell, lowest in enumerate(self.lowest.tolist()):
            neighbours = pairwise(self.intervals(cell))
            none = [(None, lowest, lowest)]
            for value, below, above in [(end, below, above) for (*_, below), (end, _, above) in neighbours] or none:
                sides = {"below": self.word(below), "above": self.word(above)}
                rows.append(self.at(cell) | {self.along.parameter: value} | sides)
        return rows

    def csv(self) -> str:
        """Comma-separated values of `rows`."""
        text = io.StringIO()
        rows = self.rows()
        writer = csv.DictWriter(text, rows[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return text.getvalue()

    def where(self, word: Word, **at: float) -> list[tuple[float, float]]:
        """Intervals of the key, begin and end, in which the outcome is `word`, in the cell nearest to some values.

        at : value of each other axis, by the name of its variable, as in ``lash_backlash_deg=6.0``

        Raises ClunkError where an axis is not named, a name is not that of an axis, or a value lies beyond its axis;
        and where the outcome is of another kind than those of the thresholds, or a text that is no label.
        """
        if word not in (FAILED, UNCERTAIN):
            if any(isinstance(word, str) != isinstance(each, str) for each in self.words):
                raise ClunkError(f"{word} is no outcome; these are {listing([*map(str, self.words)])}.")
            try:
                word = normalised_label(word) if isinstance(word, str) else word
            except ValueError as error:
                raise ClunkError(f"{error}; labels are written like DS(1)SS(1).") from None
        names = {axis.variable: axis for axis in self.axes}
        if set(names) != set(at):
            raise ClunkError(
                f"A cell is named by {listing([*names]) or 'nothing'}, not by {', '.join(at) or 'nothing'}."
            )
        places = tuple(axis.nearest(at[name]) for name, axis in names.items())
        cell = int(np.ravel_multi_index(places, self.shape)) if places else 0
        return [(begin, end) for begin, end, code in self.intervals(cell) if self.word(code) == word]


@takes_study
def thresholds(
    study: Study,
    *,
    along: str,
    of: str = LABEL,
    lash: WhichLash = None,
    workers: int | None = None,
    progress: ShowProgress = False,
) -> Thresholds:
    """All values of a swept key at which an outcome changes, in each cell of the other axes.

    Parameters
    ----------
    study : Study
        With an axis of two values or more for the key: two thresholds closer to each other than its spacing may be
        missed. With tolerances, values of the key and of axes are nominal, and drivelines are drawn around them.
    along : str
        The key.
    of : str, optional
        The outcome: `label`, `double_sided`, `chatter`, `label=DS(2)`, `touches`, `primary_impacts`, or a bound on a
        number such as `severity<=8000`; see `clunk.results.quantities`.
    lash : str, optional
        Of several lashes, the one whose outcome is meant, by name or number; by default the first.
    workers, progress
        As in `clunk.sweep`; progress counts runs in place of cells, with a total of 0, as it is not known.

    Returns
    -------
    Thresholds
        A failed run has an outcome of its own, `failed`. Places where outcomes change too often to be followed are
        among `unresolved`. With tolerances, the thresholds are those of each drawn driveline, which
        `clunk.threshold_quantiles` sums up.

    Raises
    ------
    ClunkError
        Where the key is no axis of this study, or there is no such outcome.
    ConfigError
        Where there is no such lash.
    ClunkError, KeyboardInterrupt
        As `clunk.sweep`.

    Examples
    --------
    >>> import clunk
    >>> axis = ["sweep.axes=[{parameter='load.ratio', start=0.0, stop=10.0, count=21}]"]
    >>> study = clunk.load_study("configs/nominal.toml", axis)
    >>> ratios = clunk.thresholds(study, along="load.ratio", of="double_sided")
    >>> ratios.value.round(6).tolist()
    [2.521797]
    >>> [(round(begin, 3), end) for begin, end in ratios.where(True)]
    [(2.522, 10.0)]
    """
    along_axis, axes = axes_of(study, along)
    position, outcome = lash_position(lash, study.lash_names), quantity_of(of, study)
    if outcome.type == NUMBER:
        raise ClunkError(f"{outcome.name} changes everywhere; give a bound, as in severity<=8000.")
    if outcome.name == NOMINAL:
        raise ClunkError(f"{NOMINAL} has no thresholds; name the label, as in label=DS(1)SS(1).")
    design = Design(axes)
    tolerances = study.swept.tolerances
    drawn = drawn_numbers(study, tolerances)
    keys = {*parameters_of((*axes, along_axis)), *parameters_of(tolerances)} - {DRAW}
    scanned = np.arange(design.cells).repeat(len(along_axis))
    with engine_of(None, workers) as engine, reporting(progress, study, what="runs") as report:
        point_runs = PointRuns(study, sorted(keys), outcome, position, engine, progress=report)

        def run(cells: Codes, values: Floats) -> Points:
            columns = design.columns(cells)
            columns[along_axis.parameter] = values
            draws = columns.pop(DRAW, np.ones(1)).astype(np.int64)
            columns = with_draws(study, columns, tolerances, (numbers[draws - 1] for numbers in drawn))
            runs = point_runs(point_runs.runner.values(columns))
            runs["cell"], runs["value"] = cells, values
            return runs

        points, _ = with_hidden(run(scanned, np.tile(along_axis.values, design.cells)), run, _HALVINGS)
        low, high = narrow(points, run, _MOST, np.ptp(along_axis.values))
    return Thresholds(
        study=study,
        along=along_axis,
        axes=axes,
        outcome=outcome,
        words=point_runs.words,
        lowest=points["outcome"][np.unique(points["cell"], return_index=True)[1]],
        cell=low["cell"],
        value=0.5 * (low["value"] + high["value"]),
        off=0.5 * (high["value"] - low["value"]),
        below=low["outcome"],
        above=high["outcome"],
        runs=point_runs.count,
        failures=point_runs.failures,
        lash=study.lash_names[position] * (len(study.lashes) > 1),
    )


def axes_of(study: Study, along: str) -> tuple[ResultAxis, ResultAxes]:
    """The key's axis, ascending, and the other axes, of which `draw` is the first with tolerances.

    Raises ClunkError where there are no thresholds along the key.
    """
    axes = grid_axes(study, "Thresholds")
    names = parameters_of(axes)
    (along,) = numbered([along], study)
    if along not in names:
        likely = None if along in spellings(study).values() else nearest(along, names)
        hint = f"; did you mean {likely}?" if likely else "."
        raise ClunkError(f"{shorten(along)} is none of the config's [[sweep.axes]], {listing(names)}{hint}")
    axis = axes[names.index(along)]
    check_axis(study, axis, "thresholds")
    draws = np.arange(1.0, study.swept.sampling.count + 1.0)
    drawn = (ResultAxis(DRAW, draws, "number of the draw", "", "1"),) if study.swept.tolerances else ()
    return axis.ascending, drawn + tuple(each for each in axes if each is not axis)


QUANTILE = "quantile"  # the axis of `threshold_quantiles`, in the place of `draw`


def check_quantiles(quantiles: Sequence[float]) -> None:
    """Raise ClunkError unless quantiles are one or more different numbers from 0.5 to 1."""
    if not quantiles or len(set(quantiles)) < len(quantiles) or not all(0.5 <= each <= 1.0 for each in quantiles):
        raise ClunkError(
            "Quantiles are different shares of the draws that have the same outcome, from 0.5 to 1; found "
            f"{listing([f'{each:g}' for each in quantiles]) or 'none'}."
        )


def threshold_quantiles(thresholds: Thresholds, quantiles: Sequence[float] = (0.5, 0.95)) -> Thresholds:
    """Values of the key between which a given share of the drawn drivelines have the same outcome.

    Parameters
    ----------
    thresholds : Thresholds
        Of a study with tolerances.
    quantiles : sequence of float
        Shares of the draws, from 0.5 to 1.

    Returns
    -------
    Thresholds
        With a last axis `quantile` in the place of `draw`. The outcome is `uncertain` where none has the share of the
        draws; of two that have half of the draws each, it is the first in the order of `words`.

    Raises
    ------
    ClunkError
        Where the thresholds are not those of drawn drivelines, or a quantile is not from 0.5 to 1.

    Examples
    --------
    >>> import clunk
    >>> axis = "sweep.axes=[{parameter='load.ratio', start=0.0, stop=10.0, count=11}]"
    >>> study = clunk.load_study("configs/tolerance.toml", [axis, "lash.backlash_deg=6.0", "sweep.sampling.count=16"])
    >>> drawn = clunk.thresholds(study, along="load.ratio", of="double_sided")
    >>> [(begin, round(end, 3)) for begin, end in clunk.threshold_quantiles(drawn, [0.95]).where(False, quantile=0.95)]
    [(0.0, 2.507)]
    """
    if not thresholds.axes or thresholds.axes[0].parameter != DRAW:
        raise ClunkError("Quantiles are those of drawn drivelines: the config has no [[sweep.tolerances]].")
    check_quantiles(quantiles)
    draws = len(thresholds.axes[0])
    cells = thresholds.lowest.size // draws
    needed = [math.ceil(quantile * draws - 1e-9) for quantile in quantiles]
    lowest, columns = [], []
    for cell in range(cells):
        at = np.flatnonzero(thresholds.cell % cells == cell)
        at = at[thresholds.value[at].argsort()]
        # number of draws with each outcome, last `failed`, in each interval between neighbours of all draws' thresholds
        counts = np.zeros((at.size + 1, len(thresholds.words) + 1), np.int64)
        np.add.at(counts[0], thresholds.lowest[cell::cells], 1)
        following = np.arange(1, at.size + 1)
        counts[following, thresholds.above[at]] += 1
        counts[following, thresholds.below[at]] -= 1
        counts = counts.cumsum(axis=0)
        is_last = np.diff(thresholds.value[at], append=np.inf) > 0.0  # the last of draws that change at the same value
        at, counts = at[is_last], counts[np.append(True, is_last)]
        likely = counts.argmax(axis=1)
        codes = np.where(likely == len(thresholds.words), FAILED_CODE, likely)
        for k, count in enumerate(needed):
            certain = np.where(counts.max(axis=1) >= count, codes, UNCERTAIN_CODE)
            change = np.flatnonzero(certain[1:] != certain[:-1])
            lowest.append(certain[0])
            place, changing = np.full(change.size, cell * len(needed) + k), at[change]
            columns.append(
                (place, thresholds.value[changing], thresholds.off[changing], certain[change], certain[change + 1])
            )
    axis = ResultAxis(QUANTILE, np.array(quantiles, np.float64), "share of the draws", "", "1")
    place, value, off, below, above = map(np.concatenate, zip(*columns, strict=True))
    return replace(
        thresholds,
        axes=(*thresholds.axes[1:], axis),
        lowest=np.array(lowest),
        cell=place,
        value=value,
        off=off,
        below=below,
        above=above,
    )
