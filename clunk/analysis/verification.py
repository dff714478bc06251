"""The same grid by both methods: do labels, events and severity agree?

The two share the model and nothing else: `rk4` steps in time, `exact` follows the modes of each regime. Exact is
guarded: it cannot skip an event, to rounding, for this model; and it knows how near each run came to another label. So
labels may differ only in flagged cells, undecided or grazing ones; where they differ elsewhere, the step is too coarse.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from clunk.analysis.comparison import Comparison, compare
from clunk.core.status import QUALITY_COMPLETE, QUALITY_GRAZING, QUALITY_UNDECIDED, Status
from clunk.results.maps import values_at
from clunk.results.regimemap import Results
from clunk.simulation.trajectory import Trajectory, simulate
from clunk.study.config import Axis, Study, Sweep
from clunk.study.designs import nominal
from clunk.study.summaries import as_text
from clunk.sweeping import sweep as sweeping

Method = Literal["rk4", "exact"]
Bools = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]

METHODS: tuple[Method, Method] = ("rk4", "exact")
GUARDED = "guarded: cannot skip an event, to rounding, for this model"
SMALL = 0.01  # of the map's largest value: below it a relative difference says nothing


@dataclass(frozen=True)
class Disagreement:
    """A cell with two labels.

    values : those of the comparison's parameters, in their units
    rk4, exact : its labels
    margin : how near the exact run came to another label
    flagged : whether the exact run is undecided or grazing
    """

    values: tuple[float, ...]
    rk4: str
    exact: str
    margin: float
    flagged: bool


@dataclass(frozen=True)
class Largest:
    """The largest difference of a quantity between the methods, over the cells with equal labels.

    quantity : of `Results`
    difference : in the quantity's unit
    values : the parameters of the cell that has it
    touches : of that cell, by rk4 and by exact: where they differ, a weak rebound may be all that does
    of_largest : the difference over the map's largest value
    of_own : the largest difference over the value itself, where that is at least `SMALL` of the map's largest; NaN
        where none is
    """

    quantity: str
    difference: float
    values: tuple[float, ...]
    touches: tuple[int, int]
    of_largest: float
    of_own: float


@dataclass(frozen=True)
class EventPair:
    """An event of a single run by both methods; a time is NaN where that method has no such event.

    kind, flank : as `Trajectory` names them
    rk4, exact : float  [s after the load step]
    """

    kind: str
    flank: str
    rk4: float
    exact: float


@dataclass(frozen=True, eq=False)
class Verification:
    """What comparing the two methods over a grid shows; a study without axes is a grid of one cell.

    study : Study
    rk4, exact : Results
    seconds : of each sweep, in the order of `METHODS`
    comparison : of the labels, rk4's as A
    flagged : shape, bool: undecided or grazing by the exact method
    largest : for each quantity that is defined somewhere
    events : of the single run of a study without axes, else empty
    """

    study: Study
    rk4: Results
    exact: Results
    seconds: tuple[float, float]
    comparison: Comparison
    flagged: Bools
    largest: tuple[Largest, ...]
    events: tuple[EventPair, ...]

    def __repr__(self) -> str:
        rows = [
            ("cells", f"{self.cells:,}"),
            ("labels equal", f"{self.equal:,}"),
            ("labels differ in flagged cells", f"{self.differing_flagged:,}"),
            ("labels differ elsewhere", f"{self.differing_elsewhere:,}"),
        ]
        return as_text(f"clunk.Verification of {self.study.title!r}", rows)

    @property
    def cells(self) -> int:
        """Cells of the grid."""
        return self.flagged.size

    @property
    def failed(self) -> int:
        """Cells that failed by one method or both; they are not compared."""
        return self.cells - self.comparison.cells

    @property
    def equal(self) -> int:
        """Cells with the same label by both methods."""
        return self.comparison.cells - self.comparison.differing

    @property
    def differing_flagged(self) -> int:
        """Cells with two labels that the exact method flags."""
        return int(np.count_nonzero(self.comparison.differs & self.flagged))

    @property
    def differing_elsewhere(self) -> int:
        """Cells with two labels that it does not flag."""
        return int(np.count_nonzero(self.comparison.differs & ~self.flagged))

    @property
    def equal_touches(self) -> int:
        """Cells with as many touches by both methods."""
        ran = ~(self.comparison.failed_a | self.comparison.failed_b)
        return int(np.count_nonzero(ran & (self.rk4.touches == self.exact.touches)))

    @property
    def agrees(self) -> bool:
        """Whether labels differ in flagged cells alone, and there was something to compare."""
        return self.comparison.cells > 0 and not self.differing_elsewhere

    @property
    def verdict(self) -> str:
        """The verdict as a sentence."""
        compared = self.comparison.cells
        if not compared:
            return "There is no verdict: no cell has a label by both methods."
        if self.events:
            return self._verdict_on_a_run()
        where = f"all {compared:,} cells" if compared > 1 else "the one cell"
        if self.failed:
            where += " that did not fail"
        if not self.comparison.differing:
            return f"The methods agree: the same label in {where}."
        if self.agrees:
            return (
                f"The methods agree: the same label in {where} but {self.differing_flagged:,}, "
                "and exact flags each of those."
            )
        count = self.differing_elsewhere
        return (
            f"The methods disagree: two labels in {_cells(count)} of {compared:,} "
            f"that exact does not flag; a smaller solver.step than {self.study.solver.step:g} s may mend it."
        )

    def _verdict_on_a_run(self) -> str:
        if not self.comparison.differing:
            return "The methods agree: the run has the same label."
        if self.agrees:
            return "The methods agree: the run has two labels, and exact flags it."
        return (
            "The methods disagree: the run has two labels and exact does not flag it; "
            f"a smaller solver.step than {self.study.solver.step:g} s may mend it."
        )

    def count(self, method: Method, quality: int) -> int:
        """How many cells one method gives a bit of `clunk.core.status`'s quality."""
        results = self.rk4 if method == "rk4" else self.exact
        return int(np.count_nonzero(results.quality & quality))

    def disagreements(self, *, flagged: bool) -> Iterator[Disagreement]:
        """The cells with two labels that the exact method flags, or those that it does not, in the grid's order."""
        found = self.comparison
        for cell in np.argwhere(found.differs & (self.flagged == flagged)):
            at = tuple(int(k) for k in cell)
            yield Disagreement(
                values=values_at(found.axes, at, found.coordinates),
                rk4=found.labels[found.codes_a[at]],
                exact=found.labels[found.codes_b[at]],
                margin=float(self.exact.margin[at]),
                flagged=flagged,
            )

    def record(self) -> dict[str, Any]:
        """The verification for JSON; null where something is not defined."""
        parameters = [axis.parameter for axis in self.comparison.parameters] if self.study.sweep else []

        def at(values: tuple[float, ...]) -> dict[str, float]:
            return dict(zip(parameters, values, strict=False))  # a single run has no parameters

        return {
            "title": self.study.title,
            "agrees": self.agrees,
            "verdict": self.verdict,
            "exact_is": GUARDED,
            "step": self.study.solver.step,
            "margin_tolerance": self.study.solver.margin_tolerance,
            "cells": self.cells,
            "failed": {
                method: int(np.count_nonzero(results.status != Status.OK))
                for method, results in zip(METHODS, (self.rk4, self.exact), strict=True)
            },
            "seconds": dict(zip(METHODS, self.seconds, strict=True)),
            "labels_equal": self.equal,
            "labels_differ_flagged": self.differing_flagged,
            "labels_differ_elsewhere": self.differing_elsewhere,
            "touches_equal": self.equal_touches,
            "share_undecided": self.count("exact", QUALITY_UNDECIDED) / self.cells,
            "share_grazing": self.count("exact", QUALITY_GRAZING) / self.cells,
            "share_complete": {method: self.count(method, QUALITY_COMPLETE) / self.cells for method in METHODS},
            "largest_differences": [
                {
                    "quantity": found.quantity,
                    "difference": found.difference,
                    "over_largest": _or_none(found.of_largest),
                    "over_own": _or_none(found.of_own),
                    "at": at(found.values),
                    "touches": dict(zip(METHODS, found.touches, strict=True)),
                }
                for found in self.largest
            ],
            "differing_cells": [
                {
                    "at": at(cell.values),
                    "rk4": cell.rk4,
                    "exact": cell.exact,
                    "margin": _or_none(cell.margin),
                    "flagged": cell.flagged,
                }
                for flagged in (False, True)
                for cell in self.disagreements(flagged=flagged)
            ],
            "events": [
                {"event": e.kind, "flank": e.flank, "rk4": _or_none(e.rk4), "exact": _or_none(e.exact)}
                for e in self.events
            ],
        }


def verify(
    study: Study,
    *,
    workers: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Verification:
    """Run a study by both methods, whichever its own is, and compare.

    Parameters
    ----------
    study : Study
        Without axes, its single run is compared, event by event; of one with tolerances, the nominal runs.
    workers : int, optional
        Threads of each sweep; by default one for each core that this process may use.
    progress : callable(done, total), optional
        Called in this thread with the cells of both sweeps together.

    Raises
    ------
    SweepError, SimulationError
        Where no cell can run; the single run of a study without axes must finish.
    """
    events: tuple[EventPair, ...] = ()
    grid = nominal(study)
    if study.sweep is None:
        events = pair_events(*(simulate(by(study, method)) for method in METHODS))
        one = Axis(parameter="lash.backlash_deg", values=(study.lash.backlash_deg,))
        grid = study.model_copy(update={"sweep": Sweep(axes=(one,))})
    cells = sweeping.cell_count(grid)
    found: list[Results] = []
    seconds: list[float] = []
    for k, method in enumerate(METHODS):
        sweeping.warm_up(by(study, method))

        def advance(done: int, _total: int, before: int = k * cells) -> None:
            if progress is not None:
                progress(before + done, len(METHODS) * cells)

        began = time.perf_counter()
        found.append(sweeping.sweep(by(grid, method), workers=workers, progress=advance))
        seconds.append(time.perf_counter() - began)
    rk4, exact = found
    comparison = compare(rk4, exact)
    return Verification(
        study=study,
        rk4=rk4,
        exact=exact,
        seconds=(seconds[0], seconds[1]),
        comparison=comparison,
        flagged=(exact.quality & (QUALITY_UNDECIDED | QUALITY_GRAZING)) != 0,
        largest=tuple(_largest(rk4, exact, comparison)),
        events=events,
    )


def by(study: Study, method: Method) -> Study:
    """The study by one of the methods."""
    return study.model_copy(update={"solver": study.solver.model_copy(update={"method": method})})


def pair_events(rk4: Trajectory, exact: Trajectory) -> tuple[EventPair, ...]:
    """The events of a run by both methods, in order of time.

    Two events are the same where they are of one kind and flank and each is the other's nearest: an event that one
    method lacks does not shift all that follow.
    """
    pairs = []
    times = [_times_by_kind(run) for run in (rk4, exact)]
    for kind, flank in {**times[0], **times[1]}:
        a, b = (np.array(side.get((kind, flank), [])) for side in times)
        to_b = np.abs(a[:, None] - b).argmin(axis=1) if b.size else np.full(a.size, -1)
        to_a = np.abs(b[:, None] - a).argmin(axis=1) if a.size else np.full(b.size, -1)
        mutual = [k for k in range(a.size) if b.size and to_a[to_b[k]] == k]
        pairs += [EventPair(kind, flank, float(a[k]), float(b[to_b[k]])) for k in mutual]
        pairs += [EventPair(kind, flank, float(a[k]), math.nan) for k in range(a.size) if k not in mutual]
        found = {int(to_b[k]) for k in mutual}
        pairs += [EventPair(kind, flank, math.nan, float(b[k])) for k in range(b.size) if k not in found]
    return tuple(sorted(pairs, key=lambda pair: pair.rk4 if math.isnan(pair.exact) else pair.exact))


def _times_by_kind(run: Trajectory) -> dict[tuple[str, str], list[float]]:
    times: dict[tuple[str, str], list[float]] = {}
    for k in range(len(run.events)):
        times.setdefault((run.kind_name(k), run.flank_name(k)), []).append(float(run.events["time"][k]))
    return times


def _largest(rk4: Results, exact: Results, comparison: Comparison) -> Iterator[Largest]:
    """The largest differences over the cells with equal labels, whose primary impacts correspond one to one."""
    failed = comparison.failed_a | comparison.failed_b
    same = np.flatnonzero(~(comparison.differs | failed))
    counts = exact.primary_impacts.ravel()
    mine, theirs = (np.repeat(~(comparison.differs | failed).ravel(), r.primary_impacts.ravel()) for r in (rk4, exact))
    owner = np.repeat(same, counts[same])
    for name in ("impact_time", "last_event_time", "severity", "impact_severity", "approach_velocity"):
        if name.startswith("impact_"):
            a, b, cells = getattr(rk4, name)[mine], getattr(exact, name)[theirs], owner
            everywhere = getattr(exact, name)
        else:
            everywhere = getattr(exact, name).ravel()
            a, b, cells = getattr(rk4, name).ravel()[same], everywhere[same], same
        known = np.isfinite(a) & np.isfinite(b)
        if not known.any():
            continue
        a, b, cells = a[known], b[known], cells[known]
        difference, largest = np.abs(a - b), float(np.nanmax(np.abs(everywhere)))
        k = int(difference.argmax())
        at = tuple(int(i) for i in np.unravel_index(cells[k], exact.shape))
        yield Largest(
            quantity=name,
            difference=float(difference[k]),
            values=values_at(exact.axes, at, exact.coordinates),
            touches=(int(rk4.touches[at]), int(exact.touches[at])),
            of_largest=_over(float(difference[k]), largest),
            of_own=_relative(difference, np.abs(b), largest),
        )


def _relative(difference: Floats, value: Floats, largest: float) -> float:
    counts = (value >= SMALL * largest) & (value > 0.0)
    return float(np.max(difference[counts] / value[counts])) if counts.any() else math.nan


def _over(difference: float, largest: float) -> float:
    return difference / largest if largest > 0.0 else 0.0


def _cells(count: int) -> str:
    return f"{count:,} cell{'' if count == 1 else 's'}"


def _or_none(value: float) -> float | None:
    """JSON has no NaN."""
    return value if math.isfinite(value) else None
