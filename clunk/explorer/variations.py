"""Maps and runs of what is explored, with other numbers than the config's."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from clunk.analysis.boundaries import BoundaryError, boundaries
from clunk.explorer.subject import Numbers, Subject
from clunk.results.labels import FAILED_CODE
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import AnyMap
from clunk.simulation.history import History, sample, shown_until
from clunk.simulation.trajectory import simulate
from clunk.study.axes import RUN
from clunk.study.config import study_from_text
from clunk.study.designs import Column, Design, design_of, has_tolerances, nominal
from clunk.study.parameters import nominal_value
from clunk.study.study import Study, replace_values, to_toml
from clunk.study.sweeps import Axis, Sweep
from clunk.sweeping.cells import compiling_note, warm_up
from clunk.sweeping.progress import Progress
from clunk.sweeping.sweep import sweep

_MOST_RUNS = 60_000  # along the boundaries of a map, a second or so
_COARSE, _TRACED = 31, 60  # values of an axis, of the map that is shown first, and of the one that is traced


class Variations:
    """The study of some results, and what is computed of it.

    study : its sweep included, without tolerances

    Raises ConfigError where the results' config is not allowed any more.
    """

    study: Study

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self._toleranced = study_from_text(subject.results.config, "the results' config")
        self.study = nominal(self._toleranced)

    def number(self, key: str) -> float:
        """The config's own value of a key; NaN where it has none."""
        return nominal_value(self.study, key) if key != RUN else math.nan

    def study_at(self, cell: Numbers, numbers: Numbers) -> Study:
        """The study of a cell's run, without a sweep. Raises ConfigError where a number is not allowed."""
        return replace_values(self.study.model_copy(update={"sweep": None}), {**self.subject.values(cell), **numbers})

    def run(self, cell: Numbers, numbers: Numbers) -> History:
        """The motion in a cell, with other numbers. Raises SimulationError, ConfigError."""
        trajectory = simulate(self.study_at(cell, numbers))
        until = shown_until(trajectory)
        events_end = trajectory.study.load.step_time + trajectory.end
        limit = trajectory.study.load.step_time + trajectory.study.solver.end_time
        return sample(trajectory, until=min(max(until, events_end), limit))

    def study_of_map(self, slices: Numbers, numbers: Numbers) -> Study:
        """The study whose sweep is the map that is shown, with other numbers."""
        fixed = {**self.subject.fixed, **_fixed(slices), **numbers}
        study = replace_values(self.study.model_copy(update={"sweep": None}), fixed)
        if self.subject.has_runs:
            return study.model_copy(update={"sweep": self.study.sweep})
        assert self.study.sweep is not None
        shown = {axis.parameter for axis in self.subject.plane}
        axes = tuple(axis for axis in self.study.sweep.axes if axis.parameter in shown)
        return study.model_copy(update={"sweep": Sweep(axes=axes)})

    def config(self, cell: Numbers, numbers: Numbers) -> str:
        """TOML with which `clunk sweep` gives the map that is shown, and `clunk simulate` the run of the cell."""
        if not self.subject.plane:
            return to_toml(self.study_at(cell, numbers))
        slices = {axis.parameter: cell[axis.parameter] for axis in self.subject.slices}
        swept, whole = self.study_of_map(slices, numbers).sweep, self._toleranced.sweep
        if has_tolerances(self._toleranced) and not numbers:
            assert swept is not None
            assert whole is not None
            swept = swept.model_copy(update={"tolerances": whole.tolerances, "sampling": whole.sampling})
        return to_toml(self.study_at(cell, numbers).model_copy(update={"sweep": swept}))

    def prepare(self, say: Callable[[str], None]) -> None:
        """Load what sweeps need, so that the first one does not wait for it; say : called before kernels compile."""
        if note := compiling_note(self.study):
            say(note)
        warm_up(self.study)
        if note:
            say("compiled")

    def coarse_map(self, slices: Numbers, numbers: Numbers, progress: Progress, most: int = _COARSE) -> Results | None:
        """The map of every few values of its axes, at most so many of each; None where all are few."""
        study = self.study_of_map(slices, numbers)
        if self.subject.has_runs or all(len(axis.values) <= most for axis in self.subject.plane):
            return None
        shape, columns = [], []
        for k, column in enumerate(design_of(study).columns):
            values = column.values[_every_few(len(column.values), most)]
            shape.append(len(values))
            columns.append(Column(column.parameter, k, values))
        return sweep(study, Design(tuple(shape), tuple(columns)), progress=progress)

    def full_map(self, slices: Numbers, numbers: Numbers, progress: Progress) -> Results:
        """The map at all values of its axes."""
        study = self.study_of_map(slices, numbers)
        if self.subject.has_runs:
            return sweep(study, progress=progress).at(slices)
        return sweep(study, progress=progress)

    def traced_map(self, slices: Numbers, numbers: Numbers, drawn: AnyMap, lash: str, progress: Progress) -> AnyMap:
        """A map that is shown, with its boundaries where the exact method traces them quickly; else as it is.

        They are traced from few cells: to follow the sliders, and no less exactly.
        """
        of_plane = isinstance(drawn, Results) and len(drawn.of_lash(lash).axes) == 2
        if not isinstance(drawn, Results) or not of_plane or self.study.solver.method != "exact":
            return drawn
        if drawn.of_lash(lash).boundaries is not None:
            return drawn

        def count(runs: int, total: int) -> None:
            progress(runs, total)
            if runs > _MOST_RUNS:
                raise BoundaryError("The boundaries of this map take too many runs to follow a slider.")

        study = self.study_of_map(slices, numbers)
        try:
            few = self.coarse_map(slices, numbers, progress, _TRACED) or drawn
            assert isinstance(few, Results)
            traced = boundaries(study, few, lash=lash if drawn.lashes else None, progress=count)
        except BoundaryError:
            return drawn
        labels = (*traced.labels, *(label for label in drawn.labels if label not in traced.labels))
        codes = np.array([*map(labels.index, drawn.labels), FAILED_CODE], np.int16)[drawn.sequence]
        arrays = {**drawn.arrays, "sequence": codes}
        return replace(drawn, labels=labels, arrays=arrays, boundaries=replace(traced, labels=labels))


def of_one_cell(study: Study) -> Study:
    """A study without a sweep as one of a single cell, so that it has results."""
    key = "solver.end_time"  # any key does that every study has
    axis = Axis(parameter=key, values=(nominal_value(study, key),))
    return study.model_copy(update={"sweep": Sweep(axes=(axis,))})


def _every_few(count: int, most: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Positions of at most `most` of `count` values, both ends among them."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(count, most))).astype(np.intp))


def _fixed(slices: Numbers) -> dict[str, float]:
    """The slices that are values of keys: a run's number is none."""
    return {parameter: value for parameter, value in slices.items() if parameter != RUN}
