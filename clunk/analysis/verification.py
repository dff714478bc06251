"""Verification: one study by both methods, whose labels, events and severity must agree.

The methods share the model and nothing else: `rk4` steps in time, `exact` follows the modes of each regime. Exact is
guarded: it cannot skip an event, to rounding, for this model; and it knows how near each run came to another label. So
labels may differ only in flagged cells, undecided or grazing ones; where they differ elsewhere, the step is too coarse.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from clunk.analysis.comparison import Comparison, DifferingCell, compare
from clunk.core.status import QUALITY_GRAZING, QUALITY_UNDECIDED
from clunk.results.maps import values_at
from clunk.results.quantities import IMPACT_QUANTITIES
from clunk.results.regimemap import Results
from clunk.simulation.trajectory import Trajectory, simulate
from clunk.study.arrays import Bools
from clunk.study.designs import nominal
from clunk.study.document import dotted
from clunk.study.study import Study
from clunk.study.summaries import as_text
from clunk.study.sweeps import Axis, Sweep
from clunk.sweeping import sweep as sweeping
from clunk.sweeping.progress import Progress

Method = Literal["rk4", "exact"]

METHODS: tuple[Method, Method] = ("rk4", "exact")
GUARDED = "guarded: cannot skip an event, to rounding, for this model"
SMALL = 0.01  # of the map's largest value: below it a relative difference says nothing


@dataclass(frozen=True)
class Largest:
    """The largest difference of a quantity between the methods, over the cells with equal labels.

    quantity : of `Results`
    difference : in the quantity's unit
    values : the parameters of the cell that has it
    touches : of that cell, by rk4 and by exact; where they differ, one method may have lost a weak rebound
    of_largest : the difference over the map's largest value
    relative : the largest difference over the value itself, where that is at least `SMALL` of the map's largest; NaN
        where none is
    """

    quantity: str
    difference: float
    values: tuple[float, ...]
    touches: tuple[int, int]
    of_largest: float
    relative: float


@dataclass(frozen=True)
class EventPair:
    """An event of a single run by both methods; a time is NaN where that method has no such event.

    name, flank : as `Trajectory` names them
    rk4, exact : float  [s after the load step]
    """

    name: str
    lash: str
    flank: str
    rk4: float
    exact: float


@dataclass(frozen=True, eq=False)
class Verification:
    """A study run by both methods and compared; a study without axes is a grid of one cell.

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
        """Number of cells of the grid."""
        return self.flagged.size

    @property
    def failed(self) -> int:
        """Number of cells that failed by one method or both; they are not compared."""
        return self.cells - self.comparison.cells

    @property
    def equal(self) -> int:
        """Number of cells with the same label by both methods."""
        return self.comparison.cells - self.comparison.differing

    @property
    def differing_flagged(self) -> int:
        """Number of cells with two labels that the exact method flags."""
        return int(np.count_nonzero(self.comparison.differs & self.flagged))

    @property
    def differing_elsewhere(self) -> int:
        """Number of cells with two labels that the exact method does not flag."""
        return int(np.count_nonzero(self.comparison.differs & ~self.flagged))

    @property
    def equal_touches(self) -> int:
        """Number of cells with as many touches by both methods."""
        ran = ~(self.comparison.failed_a | self.comparison.failed_b)
        return int(np.count_nonzero(ran & (self.rk4.touches == self.exact.touches)))

    @property
    def agrees(self) -> bool:
        """Whether labels differ in flagged cells alone, and there was something to compare."""
        return self.comparison.cells > 0 and not self.differing_elsewhere

    def count(self, method: Method, quality: int) -> int:
        """Number of cells to which a method gives a bit of `clunk.core.status`'s quality."""
        results = self.rk4 if method == "rk4" else self.exact
        return int(np.count_nonzero(results.quality & quality))

    def disagreements(self, *, flagged: bool) -> Iterator[DifferingCell]:
        """The cells with two labels that the exact method flags, or those that it does not, in the grid's order.

        A label `a` is rk4's, `b` exact's.
        """
        return self.comparison.differing_cells(among=self.flagged == flagged)


def verify(
    study: Study,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
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
        parameter = dotted((*study.lash_places[0], "backlash_deg"))
        one = Axis(parameter=parameter, values=(study.lashes[0].backlash_deg,))
        grid = study.model_copy(update={"sweep": Sweep(axes=(one,))})
    cells = sweeping.cell_count(grid)
    results: list[Results] = []
    seconds: list[float] = []
    for k, method in enumerate(METHODS):
        sweeping.warm_up(by(study, method))

        def advance(done: int, _total: int, before: int = k * cells) -> None:
            if progress is not None:
                progress(before + done, len(METHODS) * cells)

        began = time.perf_counter()
        results.append(sweeping.sweep(by(grid, method), workers=workers, progress=advance))
        seconds.append(time.perf_counter() - began)
    rk4, exact = results
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
    """The study with this method in its solver."""
    return study.model_copy(update={"solver": study.solver.model_copy(update={"method": method})})


def pair_events(rk4: Trajectory, exact: Trajectory) -> tuple[EventPair, ...]:
    """The events of a run by both methods, in order of time.

    Two events are the same where they have one name, lash and flank and each is the other's nearest: an event that one
    method lacks does not shift all that follow.
    """
    pairs = []
    times = [_times_by_event(run) for run in (rk4, exact)]
    for event in {**times[0], **times[1]}:
        a, b = (np.array(by_event.get(event, [])) for by_event in times)
        apart = np.abs(a[:, None] - b)
        nearest = apart.argmin(axis=1) if b.size else np.empty(0, np.intp)  # of b, for each of a
        matched = [(k, m) for k, m in enumerate(nearest.tolist()) if apart[:, m].argmin() == k]
        pairs += [EventPair(*event, float(a[k]), float(b[m])) for k, m in matched]
        pairs += [EventPair(*event, time, math.nan) for time in np.delete(a, [k for k, _ in matched]).tolist()]
        pairs += [EventPair(*event, math.nan, time) for time in np.delete(b, [m for _, m in matched]).tolist()]
    return tuple(sorted(pairs, key=lambda pair: pair.rk4 if math.isnan(pair.exact) else pair.exact))


def _times_by_event(run: Trajectory) -> dict[tuple[str, str, str], list[float]]:
    times: dict[tuple[str, str, str], list[float]] = {}
    for k, time_of_event in enumerate(run.events["time"].tolist()):
        times.setdefault((run.kind_name(k), run.lash_name(k), run.flank_name(k)), []).append(time_of_event)
    return times


def _largest(rk4: Results, exact: Results, comparison: Comparison) -> Iterator[Largest]:
    """The largest differences over the cells with equal labels, whose primary impacts correspond one to one."""
    equal = ~(comparison.differs | comparison.failed_a | comparison.failed_b).ravel()
    for name in ("impact_time", "last_event_time", "severity", "impact_severity", "approach_velocity"):
        of_impacts = name in IMPACT_QUANTITIES
        # the cell of each value; with equal labels both methods have as many values in it
        cells_rk4, cells_exact = (
            np.repeat(np.arange(equal.size), each.primary_impacts.ravel() if of_impacts else 1) for each in (rk4, exact)
        )
        all_values = getattr(exact, name).ravel()
        a, b = getattr(rk4, name).ravel()[equal[cells_rk4]], all_values[equal[cells_exact]]
        defined = np.isfinite(a) & np.isfinite(b)
        if not defined.any():
            continue
        difference, size = np.abs(a - b)[defined], np.abs(b)[defined]
        largest, k = float(np.nanmax(np.abs(all_values))), int(difference.argmax())
        at = np.unravel_index(cells_exact[equal[cells_exact]][defined][k], exact.shape)
        counted = (size >= SMALL * largest) & (size > 0.0)
        yield Largest(
            quantity=name,
            difference=float(difference[k]),
            values=values_at(exact.axes, at, exact.coordinates),
            touches=(int(rk4.touches[at]), int(exact.touches[at])),
            of_largest=float(difference[k]) / largest if largest > 0.0 else 0.0,
            relative=float(np.max(difference[counted] / size[counted])) if counted.any() else math.nan,
        )
