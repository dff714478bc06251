"""Runs of a study at arbitrary points of some parameters, batch after batch, without making a map of each batch."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np
import numpy.typing as npt

from clunk.analysis.brackets import Codes, Floats
from clunk.core.sequence import label
from clunk.core.status import Status
from clunk.results.labels import FAILED_CODE, excursions
from clunk.study.designs import Column, Design
from clunk.study.study import Study
from clunk.sweeping.assembly import flanks_of, long_sequences
from clunk.sweeping.cells import Grid, Systems
from clunk.sweeping.engines import Stop, available_cores, run_tile

RUN = np.dtype([("outcome", "i8"), ("measure", "f8"), ("touches", "i8")])
Runs = npt.NDArray[np.void]  # RUN: the label's code, the margin and the number of touches

_ALONE = 200  # runs: fewer are not worth a second thread


class PointRuns:
    """Runs at points of some parameters, and the codes of their labels.

    study : Study
    parameters : dotted keys
    labels : those that have codes already; others get the next ones
    engine : of threads
    count : number of runs so far
    """

    def __init__(self, study: Study, parameters: Sequence[str], labels: Sequence[str], engine: Executor) -> None:
        self.study, self.parameters = study.model_copy(update={"sweep": None}), tuple(parameters)
        self.count = 0
        self._engine = engine
        self._codes = {text: code for code, text in enumerate(labels)}
        self._code_of_pattern: dict[int, int] = {}
        self._systems = Systems(self.study)  # so that a driveline is prepared once for all batches

    def grid(self, values: Floats) -> Grid:
        """The cells at some points; values : (n, parameters), in their units."""
        columns = tuple(Column(key, 0, values[:, k]) for k, key in enumerate(self.parameters))
        design = Design((len(values),), columns, run=0)
        return Grid(self.study, design, self._systems)

    def __call__(self, values: Floats) -> Runs:
        """Run points; values : (n, parameters), in their units. Returns (n,) RUN."""
        runs = np.zeros(len(values), RUN)
        if not runs.size:
            return runs
        grid, stop = self.grid(values), Stop()
        workers = getattr(self._engine, "_max_workers", None) or available_cores()
        pieces = np.array_split(np.arange(runs.size), workers if runs.size > _ALONE else 1)
        try:
            each = map if len(pieces) == 1 else self._engine.map
            tiles = list(each(lambda cells: run_tile(grid, cells, stop), pieces))
        finally:
            stop.set()
        for cells, tile in zip(pieces, tiles, strict=True):
            records = tile.records
            part = runs[cells[0] : cells[-1] + 1]
            part["measure"], part["touches"] = records["margin"], records["touches"]
            patterns, inverse = np.unique(records["pattern"], return_inverse=True)
            part["outcome"] = np.array([self._of_pattern(pattern) for pattern in patterns.tolist()])[inverse]
            for k, flanks in long_sequences(records, [tile.details]):
                part["outcome"][k] = self._code(label(flanks))
            part["outcome"][records["status"] != Status.OK] = FAILED_CODE
        self.count += runs.size
        return runs

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
