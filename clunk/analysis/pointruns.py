"""Runs of a study at arbitrary points of some parameters, batch after batch, without making a map of each batch."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor

import numpy as np
import numpy.typing as npt

from clunk.core.sequence import label
from clunk.core.status import Status
from clunk.results.labels import FAILED_CODE, excursions
from clunk.results.machine import available_cores
from clunk.results.quantities import measuring
from clunk.study.arrays import Codes, Floats, Records
from clunk.study.designs import Column, Design
from clunk.study.study import Study
from clunk.sweeping.assembly import flanks_of, long_sequences
from clunk.sweeping.cells import Grid

RUN_FIELDS = ("outcome", "measure", "touches")
RUN = np.dtype([*zip(RUN_FIELDS, ("i8", "f8", "i8"), strict=True)])
Runs = npt.NDArray[np.void]  # RUN: the label's code, the margin and the number of touches

Events = npt.NDArray[np.void]  # EVENT

_EVENT_MEMORY = 500_000  # events that there is room for at a time, in each thread: 28 MB
_ALONE = 100  # runs: fewer are not worth a second thread


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
        self.study, self.parameters = measuring(study, ()).model_copy(update={"sweep": None}), tuple(parameters)
        self.lash = lash
        self._engine, self._workers = engine, getattr(engine, "_max_workers", None) or available_cores()
        self._codes = {text: code for code, text in enumerate(labels)}
        self._code_of_pattern: dict[int, int] = {}
        design = Design((1,), tuple(Column(key, 0, np.zeros(1)) for key in self.parameters), run=0)
        self._grid = Grid(self.study, design)  # one for all batches, so that a driveline is prepared once

    def _values(self, values: Floats) -> tuple[dict[str, Floats], int]:
        """Values of each parameter at points, (n, parameters), and the number of points."""
        return dict(zip(self.parameters, values.T, strict=True)), len(values)

    def __call__(self, values: Floats) -> Runs:
        """Run points; values : (n, parameters), in their units. Returns (n,) RUN."""
        grid, stop, size = self._grid, np.zeros(1, np.uint8), len(values)

        def run(part: Floats) -> tuple[Records, Records]:
            at = self._values(part)
            return grid.run_cases(grid.structural, *grid.points(*at), grid.cases(*at), stop)[1:]

        parts = np.array_split(values, self._workers) if size > _ALONE else [values] if size else []
        try:
            finished = [run(part) for part in parts] if len(parts) < 2 else [*self._engine.map(run, parts)]
        finally:
            stop[0] = 1
        return np.concatenate([np.zeros(0, RUN), *(self._described(*part) for part in finished)])

    def _described(self, records: Records, impacts: Records) -> Runs:
        """RUN of the records of runs, and of their impacts."""
        lashes, rows = self._grid.layout.lashes, records[self.lash :: self._grid.layout.lashes]
        runs = np.zeros(rows.size, RUN)
        runs["measure"], runs["touches"] = rows["margin"], rows["touches"]
        patterns, inverse = np.unique(rows["pattern"], return_inverse=True)
        runs["outcome"] = np.array([self._of_pattern(pattern) for pattern in patterns.tolist()])[inverse]
        for row, flanks in long_sequences(records, [impacts]):
            if row % lashes == self.lash:
                runs["outcome"][row // lashes] = self._code(label(flanks))
        runs["outcome"][rows["status"] != Status.OK] = FAILED_CODE
        return runs

    def pairs(self, one: Floats, other: Floats) -> Iterator[tuple[Records, Events]]:
        """Run pairs of points, (n, parameters) each, and keep their events.

        Yields of some pairs after the others CELL (k, 2), and EVENT (k, 2, events), with times NaN behind the last one.
        """
        most = max(_EVENT_MEMORY // (2 * self.study.solver.max_events + 2), 1)
        pieces = [*range(0, len(one), min(most, max(-(-len(one) // self._workers), _ALONE // 2)))]

        def run(begin: int, end: int) -> tuple[Records, Events]:
            both = np.stack([one[begin:end], other[begin:end]], 1).reshape(-1, len(self.parameters))
            records, logs = self._grid.logged(*self._values(both))
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
