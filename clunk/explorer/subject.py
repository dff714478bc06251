"""What is explored: the results of a file, and the maps and runs of its study with other numbers.

What runs is imported when it is first needed: the stored map is on the page by then, half a second earlier.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from clunk.results.maps import parameters_of, values_at
from clunk.results.regimemap import Results
from clunk.study.axes import LASH, RUN, ResultAxis
from clunk.study.config import study_from_text
from clunk.study.designs import Column, Design, design_of, nominal
from clunk.study.errors import ClunkError
from clunk.study.parameters import nominal_value
from clunk.study.study import Study, replace_values, to_toml
from clunk.study.sweeps import Sweep

if TYPE_CHECKING:
    from clunk.simulation.history import History
    from clunk.sweeping.progress import Progress

_USUAL = ("load.ratio", "lash.backlash_deg")  # stay on the map where there are more axes
_COARSE = 41  # values of an axis, of the map that is shown first

Numbers = Mapping[str, float]  # dotted key -> value, in its unit


class ExplorerError(ClunkError):
    """Something that cannot be explored; its text is one sentence for the user."""


@dataclass(frozen=True, eq=False)
class Subject:
    """A study, its results, and the one or two axes of the map.

    results : of all axes and lashes
    study : of the results, its sweep included
    name : for files that are saved
    """

    results: Results
    study: Study
    name: str

    @classmethod
    def of(cls, results: Results, name: str | os.PathLike[str] = "map") -> Subject:
        """The subject of some results. Raises ExplorerError where no run can be made of their config."""
        if not results.config:
            raise ExplorerError("These results have no config, so that no run can be made of a cell.")
        return cls(results, nominal(study_from_text(results.config, "the results' config")), str(name))

    @cached_property
    def plane(self) -> tuple[ResultAxis, ...]:
        """The axes of the map, x first: two, or one where no more than one changes."""
        changing = [axis for axis in self._axes if len(axis.values) > 1] or self._axes[:1]
        ranked = sorted(changing, key=lambda axis: (axis.parameter == RUN, axis.parameter not in _USUAL))
        chosen = [axis for k, axis in enumerate(ranked[:2]) if k == 0 or axis.parameter != RUN]  # runs have no order
        return tuple(sorted(chosen, key=lambda axis: (axis.parameter != "load.ratio", self._axes.index(axis))))

    @cached_property
    def slices(self) -> tuple[ResultAxis, ...]:
        """The further axes, of which the map shows one value each."""
        return tuple(axis for axis in self._axes if axis not in self.plane)

    @property
    def has_runs(self) -> bool:
        """Whether some parameters lie together along `run`."""
        return any(axis.parameter == RUN for axis in self.results.axes)

    def number(self, key: str) -> float:
        """The config's own value of a key; NaN where it has none."""
        return nominal_value(self.study, key) if key != RUN else math.nan

    def stored(self, slices: Numbers) -> Results:
        """The stored map at values of the further axes."""
        return self.results.at(slices) if slices else self.results

    def values(self, cell: Numbers) -> dict[str, float]:
        """Values of the swept keys in a cell, from values of the axes, `run` included."""
        at = [axis.nearest(cell[axis.parameter]) for axis in self._axes]
        swept = values_at(self._axes, at, self.results.coordinates)
        names = [axis.parameter for axis in parameters_of(self._axes, self.results.coordinates)]
        return dict(zip(names, swept, strict=True))

    @cached_property
    def _axes(self) -> tuple[ResultAxis, ...]:
        return tuple(axis for axis in self.results.axes if axis.parameter != LASH)

    def study_at(self, cell: Numbers, numbers: Numbers) -> Study:
        """The study of a cell's run, without a sweep. Raises ConfigError where a number is not allowed."""
        return replace_values(self.study.model_copy(update={"sweep": None}), {**self.values(cell), **numbers})

    def run(self, cell: Numbers, numbers: Numbers) -> History:
        """The motion in a cell, with other numbers. Raises SimulationError, ConfigError."""
        from clunk.simulation.history import sample, shown_until
        from clunk.simulation.trajectory import simulate

        trajectory = simulate(self.study_at(cell, numbers))
        until = shown_until(trajectory)
        events_end = trajectory.study.load.step_time + trajectory.end
        limit = trajectory.study.load.step_time + trajectory.study.solver.end_time
        return sample(trajectory, until=min(max(until, events_end), limit))

    def study_of_map(self, slices: Numbers, numbers: Numbers) -> Study:
        """The study whose sweep is the map that is shown, with other numbers."""
        study = replace_values(self.study.model_copy(update={"sweep": None}), {**_fixed(slices), **numbers})
        if self.has_runs:
            return study.model_copy(update={"sweep": self.study.sweep})
        assert self.study.sweep is not None
        shown = {axis.parameter for axis in self.plane}
        axes = tuple(axis for axis in self.study.sweep.axes if axis.parameter in shown)
        return study.model_copy(update={"sweep": Sweep(axes=axes)})

    def config(self, cell: Numbers, numbers: Numbers) -> str:
        """TOML with which `clunk sweep` gives the map that is shown, and `clunk simulate` the run of the cell."""
        slices = {axis.parameter: cell[axis.parameter] for axis in self.slices}
        swept = self.study_of_map(slices, numbers).sweep
        return to_toml(self.study_at(cell, numbers).model_copy(update={"sweep": swept}))

    def prepare(self, say: Callable[[str], None]) -> None:
        """Load what sweeps need, so that the first one does not wait for it; say : called before kernels compile."""
        from clunk.sweeping.cells import compiling_note, warm_up

        if note := compiling_note(self.study):
            say(note)
        warm_up(self.study)
        if note:
            say("compiled")

    def coarse_map(self, slices: Numbers, numbers: Numbers, progress: Progress, *, refine: bool) -> Results | None:
        """The map of every few values of its axes; None where all are few."""
        from clunk.sweeping.sweep import sweep

        study = self.study_of_map(slices, numbers)
        if self.has_runs or all(len(axis.values) <= _COARSE for axis in self.plane):
            return None
        shape, columns = [], []
        for k, column in enumerate(design_of(study).columns):
            values = column.values[_every_few(len(column.values))]
            shape.append(len(values))
            columns.append(Column(column.parameter, k, values))
        return sweep(study, Design(tuple(shape), tuple(columns)), refine=refine, progress=progress)

    def full_map(self, slices: Numbers, numbers: Numbers, progress: Progress, *, refine: bool) -> Results:
        """The map at all values of its axes; refine : whether to infer cells whose neighbours tell their labels."""
        from clunk.sweeping.sweep import sweep

        study = self.study_of_map(slices, numbers)
        if self.has_runs:
            return sweep(study, progress=progress).at(slices)
        return sweep(study, refine=refine, progress=progress)


def _every_few(count: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """Positions of at most `_COARSE` of `count` values, both ends among them."""
    return np.unique(np.rint(np.linspace(0, count - 1, min(count, _COARSE))).astype(np.intp))


def _fixed(slices: Numbers) -> dict[str, float]:
    """The slices that are values of keys: a run's number is none."""
    return {parameter: value for parameter, value in slices.items() if parameter != RUN}
