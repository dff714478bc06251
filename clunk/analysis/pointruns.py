"""Runs of a study at points of some parameters, batch after batch, with a code for each label."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor

import numpy as np
import numpy.typing as npt

from clunk.core.sequence import label
from clunk.core.status import Status
from clunk.core.tile import EVENTS
from clunk.results.labels import FAILED_CODE, excursions
from clunk.results.quantities import measuring
from clunk.study.arrays import Codes, Floats, Records
from clunk.study.rules import count_of_regimes
from clunk.study.study import Study
from clunk.sweeping.reduction import flanks_of, long_sequences
from clunk.sweeping.runner import Runner
from clunk.sweeping.tiles import Tile

RUN_FIELDS = ("outcome", "measure", "touches")
RUN = np.dtype([*zip(RUN_FIELDS, ("i8", "f8", "i8"), strict=True)])
Runs = npt.NDArray[np.void]  # RUN: the label's code, the margin and the number of touches

Events = npt.NDArray[np.void]  # EVENT

_EVENT_MEMORY = 500_000  # events that there is room for at a time, in each thread: 28 MB
_STEPS = 20_000  # of rk4 in a run that counts as one: 2 s at the default step
_FEW = 50  # pairs: fewer are not worth a second thread


class PointRuns:
    """Runs at points of some parameters, and the codes of their labels.

    study : Study
    parameters : dotted keys
    lash : position of the one whose labels they are
    labels : those that have codes already; others get the next ones
    engine : of threads
    """

    def __init__(
        self, study: Study, parameters: Sequence[str], labels: Sequence[str], engine: Executor, lash: int = 0
    ) -> None:
        self._runner = Runner(measuring(study, ()), parameters, engine=engine)
        self.study, self.lash = self._runner.study, lash
        self._engine = engine
        self._codes = {text: code for code, text in enumerate(labels)}
        self._code_of_pattern: dict[int, int] = {}

    @property
    def cost(self) -> int:
        """How many runs of one common driveline, by exact or in `_STEPS` steps of rk4, take as long as one of these."""
        solver, structural = self.study.solver, self._runner.grid.structural
        steps = solver.end_time / solver.step if solver.method == "rk4" else 0.0
        return max(1, round(steps / _STEPS), count_of_regimes(self.study) // 2 if structural else 1)

    def __call__(self, values: Floats) -> Runs:
        """Run points; values : (n, parameters), in their units. Returns (n,) RUN."""
        runs = np.zeros(len(values), RUN)
        for tile in self._runner.tiles(values):
            runs[tile.cells] = self._described(tile)
        return runs

    def _described(self, tile: Tile) -> Runs:
        """RUN of each run of a tile."""
        records, lashes = tile.records, self._runner.grid.layout.lashes
        rows = records[self.lash :: lashes]
        runs = np.zeros(rows.size, RUN)
        runs["measure"], runs["touches"] = rows["margin"], rows["touches"]
        patterns, inverse = np.unique(rows["pattern"], return_inverse=True)
        runs["outcome"] = np.array([self._of_pattern(pattern) for pattern in patterns.tolist()])[inverse]
        for row, flanks in long_sequences(records, [tile.details]):
            if row % lashes == self.lash:
                runs["outcome"][row // lashes] = self._code(label(flanks))
        runs["outcome"][rows["status"] != Status.OK] = FAILED_CODE
        return runs

    def pairs(self, one: Floats, other: Floats) -> Iterator[tuple[Records, Events]]:
        """Run pairs of points, (n, parameters) each, and keep their events.

        Yields of some pairs after the others CELL (k, 2), and EVENT (k, 2, events), with times NaN behind the last one.
        """
        most = max(_EVENT_MEMORY // (2 * min(self.study.solver.max_events, EVENTS) + 2), 1)
        pieces = [*range(0, len(one), min(most, max(-(-len(one) // self._runner.workers), _FEW)))]
        keys = self._runner.keys

        def run(begin: int, end: int) -> tuple[Records, Events]:
            both = np.stack([one[begin:end], other[begin:end]], 1).reshape(-1, len(keys))
            records, logs = self._runner.grid.logged(dict(zip(keys, both.T, strict=True)), len(both))
            return records[:, self.lash].reshape(-1, 2), logs.reshape(end - begin, 2, -1)

        ends = [*pieces[1:], len(one)]
        return iter(self._engine.map(run, pieces, ends)) if len(pieces) > 1 else map(run, pieces, ends)

    def _of_pattern(self, pattern: int) -> int:
        if pattern == 0:  # failed, or too long for a pattern
            return FAILED_CODE
        if pattern not in self._code_of_pattern:
            self._code_of_pattern[pattern] = self._code(label(flanks_of(pattern)))
        return self._code_of_pattern[pattern]

    def _code(self, text: str) -> int:
        return self._codes.setdefault(text, len(self._codes))

    def numbered(self, known: int) -> tuple[tuple[str, ...], Codes]:
        """The labels and each code's number among them: those known before keep theirs, new ones follow in order."""
        words = list(self._codes)
        new = sorted(words[known:], key=lambda text: (excursions(text), text))
        labels = (*words[:known], *new)
        return labels, np.array([*(labels.index(text) for text in words), FAILED_CODE])
