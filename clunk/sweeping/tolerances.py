"""Tolerance maps: every cell of a grid, run for the same sample of the toleranced parameters, reduced to statistics.

Most draws are systems of their own, which all cells of a tile share. Of a cell's runs only their outcomes are kept,
each with its number of runs, and the statistics of their severity.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.regimes import System
from clunk.core.status import Status
from clunk.results.labels import FAILED_CODE
from clunk.results.maps import QUANTILES, ToleranceMap, most_likely
from clunk.study.arrays import Cells, Codes, Floats
from clunk.study.axes import ResultAxis
from clunk.study.designs import along_run, design_of
from clunk.study.parameters import drawn_numbers, nominal_value, quantity
from clunk.study.study import Study
from clunk.sweeping.cells import Flag, Grid, Layout, Tile, most_of_load
from clunk.sweeping.reduction import Labels, Reduction, in_order

TOLERANCE_CELL = np.dtype(
    [
        ("outcomes", np.int32),  # number of labels
        ("nominal_status", np.uint8),
        ("status", np.uint8),  # of the first draw that failed
        ("severity_mean", np.float64),
        ("severity_quantiles", np.float64, (len(QUANTILES),)),
    ],
    align=True,
)
# A label that runs of a cell had, and how many; the text is as long as the longest of a tile. That of the nominal run,
# unless it failed, is the first of its cell, also where no draw had it.
OUTCOME = np.dtype([("runs", np.int32), ("label", "S1")])

_TILE_RUNS = 1 << 16  # 1 MB of them, in about a second


class SampleRunner:
    """Cells of a study with tolerances, run for every draw of the sample and nominally.

    design : of the nominal cells
    drawn : the sample, of each tolerance (draws,)
    draws : int, size of the sample
    tile_cells : int, the most cells of a tile, so that its memory does not depend on the size of the sample
    """

    def __init__(self, study: Study) -> None:
        assert study.sweep is not None
        nominal = study.model_copy(update={"sweep": None})
        self.design = design_of(study)
        self._tolerances = study.sweep.tolerances
        keys = dict.fromkeys(axis.parameter for axis in self.design.parameters)
        keys |= dict.fromkeys(draw.parameter for draw in self._tolerances)
        self._grid = Grid(nominal, along_run((key, np.zeros(1)) for key in keys))
        self.layout = Layout(TOLERANCE_CELL, OUTCOME, "outcomes", len(study.lashes))
        self.draws = study.sweep.sampling.count
        self.drawn = drawn_numbers(study, self._tolerances)
        self._at_a_time = min(_TILE_RUNS, most_of_load(nominal))
        self.tile_cells = max(1, self._at_a_time // self.draws)

    def ordered(self, cells: Cells) -> Cells:
        """Cells in the order of their systems."""
        return Grid(self._grid.study, self.design).ordered(cells)

    def shared(self) -> System | None:
        """The system that all runs share, if they do."""
        return self._grid.shared()

    def run(self, cells: Cells, stop: Flag) -> Tile:
        """Run cells; a tile that was stopped has none."""
        count = cells.size * self.layout.lashes
        codes = np.zeros((count, self.draws + 1), np.int32)  # the nominal run last
        severity = np.full((count, self.draws + 1), np.nan)
        status = np.zeros((count, self.draws + 1), np.uint8)
        seen = Labels()
        at_a_time = max(self._at_a_time // cells.size, 1)
        for begin in range(0, self.draws + 1, at_a_time):
            draws = np.arange(begin, min(begin + at_a_time, self.draws + 1))
            values = self._values(draws, cells)
            tile = self._grid.run_at(np.arange(draws.size * cells.size), values, stop)
            if tile.cells.size < draws.size * cells.size:
                return Tile(cells[:0], np.zeros(0, TOLERANCE_CELL), np.zeros(0, OUTCOME))
            codes[:, draws] = seen.codes_of(tile.records, tile.details).reshape(draws.size, -1).T
            severity[:, draws] = tile.records["severity"].reshape(draws.size, -1).T
            status[:, draws] = tile.records["status"].reshape(draws.size, -1).T
        labels, final = seen.ordered()
        summaries = [_summary(final[codes[k]], severity[k], status[k]) for k in range(count)]
        outcomes = [(runs, labels[code].encode()) for _, counts in summaries for code, runs in counts.items()]
        longest = max(map(len, labels), default=1)
        details = np.array(outcomes, [("runs", np.int32), ("label", f"S{longest}")])
        return Tile(cells, np.array([record for record, _ in summaries], TOLERANCE_CELL), details)

    def map_of(self, reduction: Reduction, attributes: dict[str, str]) -> ToleranceMap:
        """The map of the tiles, with these attributes."""
        records, outcomes = reduction.collected()
        texts, inverse = np.unique(outcomes["label"], return_inverse=True)
        words = [text.decode() for text in texts.tolist()]
        labels, numbers = in_order(words)
        codes = numbers[inverse.reshape(-1)]
        count, shape = records["outcomes"], reduction.shape
        runs = np.zeros((reduction.rows, len(labels) + 1), np.int32)
        runs[np.repeat(np.arange(reduction.rows), count), codes] = outcomes["runs"]
        runs[:, FAILED_CODE] = self.draws - runs.sum(axis=1)
        is_known = records["nominal_status"] == Status.OK
        nominal = np.full(reduction.rows, FAILED_CODE, np.int16)
        nominal[is_known] = codes[(np.cumsum(count) - count)[is_known]]
        return ToleranceMap(
            **reduction.heading(),
            labels=labels,
            sample=sample_of(reduction.study, self.drawn),
            arrays={
                "probability": (runs / self.draws).reshape(*shape, len(labels) + 1),
                "sequence": most_likely(runs).reshape(shape),
                "nominal_sequence": nominal.reshape(shape),
                "severity_mean": records["severity_mean"].reshape(shape),
                "severity_quantiles": records["severity_quantiles"].reshape(*shape, len(QUANTILES)),
                "status": records["status"].reshape(shape),
            },
            attributes=attributes,
        )

    def _values(self, draws: Cells, cells: Cells) -> dict[str, Floats]:
        """Values of the parameters in some cells at one draw after the other, (draws cells,); the last is nominal."""
        values = {key: np.tile(column, (draws.size, 1)) for key, column in self.design.columns(cells).items()}
        is_drawn = draws < self.draws
        for tolerance, numbers in zip(self._tolerances, self.drawn, strict=True):
            key = tolerance.parameter
            if key not in values:
                values[key] = np.full((draws.size, cells.size), nominal_value(self._grid.study, key))
            values[key][is_drawn] = tolerance.applied(numbers[draws[is_drawn], None], values[key][is_drawn])
        return {key: column.ravel() for key, column in values.items()}


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


def _summary(codes: Codes, severity: Floats, status: npt.NDArray[np.uint8]) -> tuple[tuple[Any, ...], dict[int, int]]:
    """A cell's TOLERANCE_CELL, and how many draws have each code; of its runs, the last is the nominal one."""
    nominal = int(codes[-1])
    runs = {} if nominal == FAILED_CODE else {nominal: 0}
    found, counts = np.unique(codes[:-1][codes[:-1] != FAILED_CODE], return_counts=True)
    runs |= dict(zip(found.tolist(), counts.tolist(), strict=True))
    known = severity[:-1][np.isfinite(severity[:-1])]
    mean, quantiles = (known.mean(), np.quantile(known, QUANTILES)) if known.size else (np.nan, np.nan)
    first_failed = int(status[np.argmax(status[:-1] != Status.OK)])
    return (len(runs), int(status[-1]), first_failed, mean, quantiles), runs
