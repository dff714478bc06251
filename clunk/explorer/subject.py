"""Subject of the explorer: results, their study, the map's axes, and maps and runs with other numbers of the config."""

import os
import time
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import replace

from clunk.analysis.boundaries import with_boundaries
from clunk.plot.plane import parted_axes
from clunk.results.maps import AnyMap, ToleranceMap
from clunk.simulation.history import History, sample, shown_until
from clunk.simulation.trajectory import simulate
from clunk.study.axes import LASH, RUN, parameters_of
from clunk.study.config import study_from_text
from clunk.study.designs import Design, design_of, nominal
from clunk.study.errors import ClunkError
from clunk.study.study import Study, replace_values, to_toml
from clunk.study.sweeps import Sweep
from clunk.sweeping.progress import Progress
from clunk.sweeping.sweep import sweep

_LONGEST = 5.0  # s, after which tracing the boundaries of a map is given up
_COARSE = 31  # most values of each axis in the coarse map that is shown first

Numbers = dict[str, float]  # dotted key -> value, in its unit


class Subject:
    """Explored results, and the maps and runs that are computed from their config, also with other numbers.

    results : over all axes and lashes
    name : with which the file name of a saved config begins
    study : of the results' config, with its sweep but without tolerances
    plane : the axes of the map, x first: two; one where only one changes; none where there is one cell. The dimension
        `run` is among them only where nothing else changes
    slices : the further axes, of which the map shows one value each
    swept : the parameters that differ from cell to cell

    Raises ClunkError where the results have no config, from which runs could be made, and ConfigError where this
    version does not allow their config.
    """

    def __init__(self, results: AnyMap, name: str | os.PathLike[str] = "map") -> None:
        if not results.config:
            raise ClunkError("These results have no config, so that no run can be made of a cell.")
        self.results, self.name = results, str(name)
        self.title = results.title.strip() or "Impact regimes"
        self._toleranced = study_from_text(results.config, "the results' config")
        self.study = nominal(self._toleranced)
        self._first = results.of_lash()  # the map of the first lash; all lashes have the same axes
        self._axes = self._first.axes
        changing = [axis for axis in self._axes if len(axis) > 1]
        grid = [axis for axis in changing if axis.parameter != RUN]  # the runs along `run` are in no order
        self.plane = tuple(parted_axes(grid or changing)[0])
        self.slices = tuple(axis for axis in changing if axis not in self.plane)
        self.swept = tuple(axis for axis in results.parameters if axis.parameter != LASH and len(axis) > 1)

    def values(self, cell: Numbers, but: Collection[str] = ()) -> Numbers:
        """Values of the swept keys in a cell, without the keys in `but`.

        cell : values of the axes, the number of a run among them; the nearest cell is taken
        """
        place = self._first.place(self._first.nearest(cell))
        return {parameter: float(value) for parameter, value in place.items() if parameter not in but}

    def likelihood(self, cell: Numbers, lash: str) -> str:
        """The probability of each label in a cell of a tolerance map; empty for a regime map."""
        if not isinstance(self.results, ToleranceMap):
            return ""
        part = self.results.of_lash(lash)
        shares = zip(part.coded_labels, part.probability[part.nearest(cell)].tolist(), strict=True)
        likely = sorted(((share, label) for label, share in shares if share), reverse=True)
        return f"of {part.draws:,} draws: " + ", ".join(f"{label} {100.0 * share:.3g} %" for share, label in likely)

    def run(self, cell: Numbers, numbers: Numbers) -> History:
        """History of the motion in a cell, with other numbers of the config.

        Raises ClunkError where there is no such run, or it fails, and ConfigError where no config may have the numbers.
        """
        trajectory = simulate(self._study_at(cell, numbers))
        return sample(trajectory, until=shown_until(trajectory))

    def config(self, cell: Numbers, numbers: Numbers) -> str:
        """TOML of a config of which `clunk sweep` makes the map that is shown, and `clunk simulate` the cell's run.

        Keys that a sampled design draws keep the values about which they are drawn; `clunk simulate --at run=N` makes
        the run that is shown of those.
        """
        if not self.plane:
            return to_toml(self._study_at(cell, numbers))
        swept, whole = self._study_of_map(cell, numbers).swept, self._toleranced.swept
        if whole.tolerances and not numbers:
            swept = swept.but(tolerances=whole.tolerances, sampling=whole.sampling)
        kept = self.values(cell, but=parameters_of(swept.samples))
        return to_toml(replace_values(self.study, kept | numbers).but(sweep=swept))

    def maps(self, slices: Numbers, numbers: Numbers, lash: str, progress: Progress) -> Iterator[AnyMap]:
        """Yield the map with other numbers in up to three states: coarse, in full, and in full with its boundaries.

        The coarse map has at most 31 values of each axis; it is left out where no axis has more, and for runs of a
        sample or of axes that are walked together. Boundaries are traced over two axes by the exact method only, and
        left out where tracing takes longer than 5 s.

        slices : values of the further axes
        progress : called with the number of runs done and in all
        """
        study = self._study_of_map(slices, numbers)
        if not self._has_runs and any(len(axis) > _COARSE for axis in self.plane):
            axes = tuple(replace(axis, values=axis.few(_COARSE)) for axis in design_of(study).axes)
            yield sweep(study, Design(axes), progress=progress)
        full = sweep(study, progress=progress)
        full = full.at(slices) if self._has_runs else full
        yield full
        if len(full.of_lash(lash).axes) == 2 and study.solver.method == "exact":
            began = time.monotonic()

            def count(runs: int, total: int) -> None:
                progress(runs, total)
                if time.monotonic() - began > _LONGEST:
                    raise ClunkError("The boundaries of this map take too long to follow a slider.")

            with suppress(ClunkError):
                yield with_boundaries(study, full, lash=lash if full.lashes else None, progress=count)

    @property
    def _has_runs(self) -> bool:
        return any(axis.parameter == RUN for axis in self._axes)

    def _study_at(self, cell: Numbers, numbers: Numbers) -> Study:
        return replace_values(self.study.but(sweep=None), self.values(cell) | numbers)

    def _study_of_map(self, cell: Numbers, numbers: Numbers) -> Study:
        """Study whose sweep is the map that is shown, with the further axes fixed at a cell's values.

        A design with the dimension `run` keeps its whole sweep.
        """
        shown = parameters_of(self.plane)
        fixed = self.values(cell, but=shown)
        if self._has_runs:
            fixed = {axis.parameter: fixed[axis.parameter] for axis in self._axes if axis.parameter in fixed}
        study = replace_values(self.study, fixed | numbers)
        axes = tuple(axis for axis in self.study.swept.axes if axis.parameter in shown)
        return study.but(sweep=self.study.sweep if self._has_runs else Sweep(axes=axes))
