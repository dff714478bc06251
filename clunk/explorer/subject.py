"""Subject of the explorer: results and their study, the axes of the map, and maps and runs with other numbers."""

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

_LONGEST = 5.0  # s, of tracing the boundaries of a map
_COARSE = 31  # values of an axis, of the map that is shown first

Numbers = dict[str, float]  # dotted key -> value, in its unit


class Subject:
    """Results, the axes of the map, and what is computed with other numbers than the config's.

    results : of all axes and lashes
    name : for the config that is saved
    study : its sweep included, without tolerances
    plane : the axes of the map, x first: two, one where no more than one changes, or none where there is one cell
    slices : the further axes, of which the map shows one value each
    swept : the parameters that differ from cell to cell

    Raises ClunkError where no run can be made of a cell, ConfigError where the config is not allowed any more.
    """

    def __init__(self, results: AnyMap, name: str | os.PathLike[str] = "map") -> None:
        if not results.config:
            raise ClunkError("These results have no config, so that no run can be made of a cell.")
        self.results, self.name = results, str(name)
        self.title = results.title.strip() or "Impact regimes"
        self._toleranced = study_from_text(results.config, "the results' config")
        self.study = nominal(self._toleranced)
        self._first = results.of_lash()  # whose axes are those of all lashes
        self._axes = self._first.axes
        changing = [axis for axis in self._axes if len(axis) > 1]
        grid = [axis for axis in changing if axis.parameter != RUN]  # runs have no order
        self.plane = tuple(parted_axes(grid or changing)[0])
        self.slices = tuple(axis for axis in changing if axis not in self.plane)
        self.swept = tuple(axis for axis in results.parameters if axis.parameter != LASH and len(axis) > 1)

    def values(self, cell: Numbers, but: Collection[str] = ()) -> Numbers:
        """Values of the swept keys in a cell, but for some, from values of the axes, `run` included."""
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
        """The motion in a cell, with other numbers. Raises ClunkError, ConfigError."""
        trajectory = simulate(self._study_at(cell, numbers))
        return sample(trajectory, until=shown_until(trajectory))

    def config(self, cell: Numbers, numbers: Numbers) -> str:
        """TOML with which `clunk sweep` gives the map that is shown, and `clunk simulate` the run of the cell.

        What a sampled design draws stays what it is drawn about: of its runs, `clunk simulate --at` gives the one.
        """
        if not self.plane:
            return to_toml(self._study_at(cell, numbers))
        swept, whole = self._study_of_map(cell, numbers).swept, self._toleranced.swept
        if whole.tolerances and not numbers:
            swept = swept.but(tolerances=whole.tolerances, sampling=whole.sampling)
        kept = self.values(cell, but=parameters_of(swept.samples))
        return to_toml(replace_values(self.study, kept | numbers).but(sweep=swept))

    def maps(self, slices: Numbers, numbers: Numbers, lash: str, progress: Progress) -> Iterator[AnyMap]:
        """Yield the map with other numbers, better and better: every few values, all of them, and with its lines.

        Axes that are walked together are computed at once; lines are traced where the exact method does so quickly.
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
        """The study whose sweep is the map that is shown, at a cell's values of the other axes."""
        shown = parameters_of(self.plane)
        fixed = self.values(cell, but=shown)
        if self._has_runs:
            fixed = {axis.parameter: fixed[axis.parameter] for axis in self._axes if axis.parameter in fixed}
        study = replace_values(self.study, fixed | numbers)
        axes = tuple(axis for axis in self.study.swept.axes if axis.parameter in shown)
        return study.but(sweep=self.study.sweep if self._has_runs else Sweep(axes=axes))
