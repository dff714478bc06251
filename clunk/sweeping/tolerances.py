"""Tolerance maps: every cell of a grid, run for the same sample of the toleranced parameters, reduced to statistics.

Most draws are systems of their own, which all cells of a tile share. Of a cell's runs only their outcomes are kept,
each with its number of runs, and the statistics of their severity.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from clunk.core.regimes import System
from clunk.core.sequence import OPPOSITE
from clunk.core.status import Status
from clunk.core.tile import LONGEST_PATTERN
from clunk.results.labels import FAILED_CODE
from clunk.results.tolerancemap import QUANTILES, ToleranceMap, most_likely
from clunk.study.arrays import Cells, Floats, Records
from clunk.study.axes import ResultAxis
from clunk.study.designs import design_of, drawn_numbers
from clunk.study.parameters import nominal_value, quantity
from clunk.study.study import Study
from clunk.sweeping.cells import KEPT_SYSTEMS, Flag, Grid, leaves_system
from clunk.sweeping.reduction import Flanks, Reduction, flanks_of, long_sequences
from clunk.sweeping.tiles import Layout, Tile

_QUANTILE_FIELDS = [f"severity_{100 * quantile:g}" for quantile in QUANTILES]

TOLERANCE_CELL = np.dtype(
    [
        ("outcomes", np.int32),
        ("status", np.uint8),  # of the first draw that failed
        ("severity_mean", np.float64),
        *((name, np.float64) for name in _QUANTILE_FIELDS),
    ],
    align=True,
)
# An outcome: up to 62 primaries' flanks as `pattern` of `clunk.core.tile` has them (0: failed), how many runs had it,
# and whether the nominal run did. Longer sequences go on in entries of `_GOES_ON` runs.
OUTCOME = np.dtype([("pattern", np.uint64), ("runs", np.int32), ("nominal", np.int8)], align=True)

_GOES_ON = -1
_GOLDEN = 0.6180339887498949
_LONG = 1 << 63  # from here on, a pattern is the number of a sequence that is too long for one
_TILE_RUNS = 1 << 16  # 1 MB of them, in about a second
_MOST_TILE_RUNS = 1 << 22  # 64 MB: where more systems are drawn than are kept, many cells must share each


class SampleRunner:
    """Cells of a study with tolerances, run for every draw of the sample and nominally.

    grid : Grid of the nominal cells
    drawn : the sample, of each tolerance (draws,)
    draws : int, size of the sample
    tile_cells : int, the most cells of a tile, so that its memory does not depend on the size of the sample
    """

    def __init__(self, study: Study) -> None:
        assert study.sweep is not None
        self.grid = Grid(study.model_copy(update={"sweep": None}), design_of(study))
        self.layout = Layout(TOLERANCE_CELL, OUTCOME, "outcomes", len(study.lashes))
        self._tolerances = study.sweep.tolerances
        self.draws = self.runs = study.sweep.sampling.count
        self.drawn = drawn_numbers(study, self._tolerances)
        self._new_systems = not all(leaves_system(study, each.parameter) for each in self._tolerances)
        self.method = self.grid.method
        room = _MOST_TILE_RUNS if self._new_systems and self.draws > KEPT_SYSTEMS else _TILE_RUNS
        self.tile_cells = max(1, room // self.draws)

    def ordered(self, cells: Cells) -> Cells:
        """Cells in the order of their systems."""
        return cells[np.argsort(self.grid.points(self.grid.design.at(cells), cells.size)[1], kind="stable")]

    def shared(self) -> System | None:
        """The system that all runs share, if they do."""
        return None if self._new_systems else self.grid.shared()

    def run(self, cells: Cells, stop: Flag) -> Tile:
        """Run cells; a tile that was stopped has none."""
        count = cells.size * self.layout.lashes
        patterns = np.zeros((count, self.draws + 1), np.uint64)  # the nominal run last
        severity = np.full((count, self.draws + 1), np.nan)
        status = np.zeros((count, self.draws + 1), np.uint8)
        long: list[Flanks] = []
        # tiles that run at the same time begin far apart, so that each prepares systems for the others
        begin = int(_GOLDEN * (cells[0] // cells.size) * self.draws)
        order = np.concatenate([[self.draws], (begin + np.arange(self.draws)) % self.draws])
        at_a_time = max(_TILE_RUNS // cells.size, 1)
        nominal = self.grid.design.at(cells)
        points, point_of = self.grid.points(nominal, cells.size)
        of_points = dict(zip(self.grid.structural, points.T, strict=True))
        of_cells = {key: column for key, column in nominal.items() if key not in of_points}
        for draws in (order[k : k + at_a_time] for k in range(0, order.size, at_a_time)):
            structural = self._at(draws, of_points, len(points), True)
            driving = self._at(draws, of_cells, cells.size, False)
            points_of = (np.arange(draws.size)[:, None] * len(points) + point_of).ravel()
            driving |= {key: column[:, point_of] for key, column in structural.items()}
            cases = self.grid.cases({key: column.ravel() for key, column in driving.items()}, points_of.size)
            drawn = np.array([*structural.values()]).reshape(len(structural), draws.size * len(points)).T
            _, records, impacts = self.grid.run_cases(tuple(structural), drawn, points_of, cases, stop)
            if records.size < draws.size * count:
                return Tile(cells[:0], np.zeros(0, TOLERANCE_CELL), np.zeros(0, OUTCOME))
            severity[:, draws] = records["severity"].reshape(draws.size, -1).T
            status[:, draws] = records["status"].reshape(draws.size, -1).T
            patterns[:, draws] = _numbered(records, [impacts], long).reshape(draws.size, -1).T
        summaries = [_summary(patterns[k], severity[k], status[k], long) for k in range(count)]
        records = np.array([record for record, _ in summaries], TOLERANCE_CELL)
        return Tile(cells, records, np.array([each for _, outcomes in summaries for each in outcomes], OUTCOME))

    def _at(self, draws: Cells, nominal: Mapping[str, Floats], count: int, structural: bool) -> dict[str, Floats]:
        """Values at some draws, (draws, count), around nominal ones, (count,); the last draw is these.

        structural : whether of the parameters with which the system differs, or of the others
        """
        values = {key: np.tile(column, (draws.size, 1)) for key, column in nominal.items()}
        is_drawn = draws < self.draws
        for tolerance, numbers in zip(self._tolerances, self.drawn, strict=True):
            key = tolerance.parameter
            if leaves_system(self.grid.study, key) != structural:
                around = values.get(key, np.full((draws.size, count), nominal_value(self.grid.study, key)))
                around[is_drawn] = tolerance.applied(numbers[draws[is_drawn], None], around[is_drawn])
                values[key] = around
        return values


class ToleranceReduction(Reduction[ToleranceMap]):
    """The arrays of a tolerance map."""

    def __init__(self, study: Study) -> None:
        self._sample = SampleRunner(study)
        super().__init__(study, self._sample.grid.design, self._sample)
        self._records = np.zeros(self.rows, TOLERANCE_CELL)
        self._nominal = np.zeros(self.rows, np.int64)  # codes
        self._runs: list[tuple[Cells, Cells, Cells]] = []  # rows, codes, and numbers of runs

    def fill(self, tile: Tile, rows: Cells) -> None:
        """See `Reduction.fill`."""
        self._records[rows] = tile.records
        entries = []
        rows_of_outcomes = np.repeat(rows, tile.records["outcomes"]).tolist()
        for row, flanks, count, nominal in _outcomes(rows_of_outcomes, tile.details):
            code = FAILED_CODE if flanks is None else self.sequences.code(flanks)
            entries.append((row, code, count))
            if nominal:
                self._nominal[row] = code
        of_rows, codes, runs = np.array(entries, np.int64).reshape(-1, 3).T
        self._runs.append((of_rows, codes, runs))

    def result(self, attributes: dict[str, str]) -> ToleranceMap:
        """See `Reduction.result`."""
        assert self.known.all()
        labels, final = self.sequences.labels()
        shape = self.shape
        runs = np.zeros((self.rows, len(labels) + 1), np.int32)  # failed is code -1, and so the last
        for rows, codes, count in self._runs:
            np.add.at(runs, (rows, final[codes]), count.astype(np.int32))
        quantiles = np.stack([self._records[name] for name in _QUANTILE_FIELDS], axis=-1)
        return ToleranceMap(
            **self.heading(),
            labels=labels,
            sample=sample_of(self.study, self._sample.drawn),
            arrays={
                "probability": (runs / self._sample.draws).reshape(*shape, len(labels) + 1),
                "sequence": most_likely(runs).reshape(shape),
                "nominal_sequence": final[self._nominal].reshape(shape),
                "severity_mean": self._records["severity_mean"].copy().reshape(shape),
                "severity_quantiles": quantiles.reshape(*shape, len(QUANTILES)),
                "status": self._records["status"].copy().reshape(shape),
            },
            attributes=attributes,
        )


def sample_of(study: Study, drawn: Sequence[Floats]) -> tuple[ResultAxis, ...]:
    """The sample as axes of results: the drawn numbers of each tolerance, with name and unit.

    Those of a key with a factor and an offset are named after these, too.
    """
    assert study.sweep is not None
    sample = []
    count = Counter(each.parameter for each in study.sweep.tolerances)
    for tolerance, numbers in zip(study.sweep.tolerances, drawn, strict=True):
        parameter, draws, known = tolerance.parameter, tolerance.draws, quantity(tolerance.parameter)
        suffix = {"value": "", "factor": ": factor on its nominal value", "offset": ": offset from its nominal value"}
        unit = "1" if draws == "factor" else known.unit
        name = f"{parameter}.{draws}" if count[parameter] > 1 else parameter
        sample.append(ResultAxis(name, numbers, known.name + suffix[draws], known.symbol, unit))
    return tuple(sample)


def _numbered(records: Records, impacts: list[Records], long: list[Flanks]) -> npt.NDArray[np.uint64]:
    """The runs' patterns; where a sequence is too long for one, `_LONG` and its number in `long`, which grows."""
    patterns: npt.NDArray[np.uint64] = records["pattern"].copy()
    for k, flanks in long_sequences(records, impacts):
        if flanks not in long:
            long.append(flanks)
        patterns[k] = _LONG + long.index(flanks)
    return patterns


def _summary(
    patterns: npt.NDArray[np.uint64], severity: Floats, status: npt.NDArray[np.uint8], long: list[Flanks]
) -> tuple[tuple[float, ...], list[tuple[int, int, int]]]:
    """A cell's TOLERANCE_CELL and its OUTCOMEs, from its runs; the last of them is the nominal one."""
    nominal = int(patterns[-1])
    unique, counts = np.unique(patterns[:-1], return_counts=True)
    runs = dict.fromkeys([nominal], 0) | dict(zip(unique.tolist(), counts.tolist(), strict=True))
    outcomes = []
    for pattern, count in runs.items():
        words = [pattern] if pattern < _LONG else _words(long[pattern - _LONG])
        outcomes.append((words[0], count, int(pattern == nominal)))
        outcomes += [(word, _GOES_ON, 0) for word in words[1:]]
    known = severity[:-1][np.isfinite(severity[:-1])]
    statistics = (known.mean(), *np.quantile(known, QUANTILES)) if known.size else (np.nan,) * (1 + len(QUANTILES))
    first_failed = int(status[np.argmax(status[:-1] != Status.OK)])
    return (len(outcomes), first_failed, *statistics), outcomes


def _words(flanks: Flanks) -> list[int]:
    """Flanks as patterns of up to 62 each."""
    parts = [flanks[start : start + LONGEST_PATTERN] for start in range(0, len(flanks), LONGEST_PATTERN)]
    return [int("1" + "".join("1" if flank == OPPOSITE else "0" for flank in part), 2) for part in parts]


def _outcomes(rows: list[int], entries: Records) -> Iterator[tuple[int, Flanks | None, int, bool]]:
    """(row, flanks or None where it failed, runs, whether nominal) of each outcome; rows : of the entries."""
    begins = np.flatnonzero(entries["runs"] != _GOES_ON)
    for begin, end in zip(begins, [*begins[1:], len(entries)], strict=True):
        words = entries["pattern"][begin:end].tolist()
        flanks = tuple(flank for word in words for flank in flanks_of(word)) if words[0] else None
        yield rows[begin], flanks, int(entries["runs"][begin]), bool(entries["nominal"][begin])
