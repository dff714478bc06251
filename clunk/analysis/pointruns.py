"""Runs of a study at points of some parameters, batch after batch, with a code for each outcome."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from clunk.analysis.search import POINT, Points
from clunk.core.status import Status
from clunk.results.labels import FAILED_CODE
from clunk.results.maps import Results
from clunk.results.quantities import CHATTER, TEXT, YES_NO, Quantity, measuring
from clunk.study.arrays import Floats
from clunk.study.rules import count_of_regimes
from clunk.study.study import Study
from clunk.sweeping.progress import Progress
from clunk.sweeping.runner import Runner

Word = str | bool | int  # an outcome: a label, whether something holds, or a count

_STEPS = 20_000  # of rk4 in a run that counts as one: 2 s at the default step


class PointRuns:
    """Runs at points of some parameters, and the codes of their outcomes.

    study : Study
    parameters : dotted keys
    outcome : Quantity
    lash : position of the one whose outcome it is
    engine : of threads
    words : outcomes that have codes already; others get the next ones
    progress : called after each batch with the numbers of points that have been run and that are expected
    """

    def __init__(
        self,
        study: Study,
        parameters: Sequence[str],
        outcome: Quantity,
        lash: int,
        engine: Executor,
        *,
        words: Sequence[Word] = (),
        progress: Progress | None = None,
    ) -> None:
        self.runner = Runner(measuring(study, [outcome]), parameters, engine=engine)
        self.study, self.outcome, self._lash = study, outcome, str(lash + 1)
        self._progress, self.count = progress, 0
        self.failures: dict[Status, int] = {}  # number of runs by cause
        self._codes = {word: code for code, word in enumerate(words)}

    @property
    def cost(self) -> int:
        """How many runs of one common driveline, by exact or in `_STEPS` steps of rk4, take as long as one of these."""
        solver, structural = self.study.solver, self.runner.grid.structural
        steps = solver.end_time / solver.step if solver.method == "rk4" else 0.0
        return max(1, round(steps / _STEPS), count_of_regimes(self.study) // 2 if structural else 1)

    def __call__(self, values: Floats, more: int = 0) -> Points:
        """Run points.

        values : (n, parameters), in their units
        more : number of points that are expected to follow; 0 if that is unknown, and so for progress the number of all
        """
        if not len(values):
            return np.zeros(0, POINT)
        results = self.runner.run(values).of_lash(self._lash)
        points = np.zeros(len(values), POINT)
        points["outcome"], points["measure"], points["touches"] = FAILED_CODE, np.nan, results.touches
        finished = results.status == Status.OK
        words, inverse = np.unique(self.outcome.of_runs(results)[finished], return_inverse=True)
        known = [self._codes.setdefault(self._word(word), len(self._codes)) for word in words.tolist()]
        points["outcome"][finished] = np.array(known, np.int64)[inverse.reshape(-1)]
        points["measure"][finished] = self._measure(results)[finished]
        for status, count in zip(*np.unique(results.status[~finished], return_counts=True), strict=True):
            self.failures[Status(status)] = self.failures.get(Status(status), 0) + int(count)
        self.count += len(values)
        if self._progress is not None:
            self._progress(self.count, self.count + more if more else 0)
        return points

    def _word(self, value: str | float) -> Word:
        return value if isinstance(value, str) else bool(value) if self.outcome.type == YES_NO else int(value)

    def _measure(self, results: Results) -> Floats:
        """A number of each run that changes sign where the outcome changes, as far as one is known; else NaN."""
        if self.outcome.name == CHATTER:
            return np.asarray(results.touches - results.primary_impacts - 0.5, np.float64)
        base = self.outcome if self.outcome.base is None else self.outcome.base
        if base.type in (TEXT, YES_NO):
            return results.margin
        return base.of_runs(results) - float(self.outcome.bound)

    @property
    def words(self) -> tuple[Word, ...]:
        """The outcome of each code."""
        return tuple(self._codes)
