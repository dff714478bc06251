"""Tolerance maps: every cell of a grid, run for the same sample of the toleranced parameters, reduced to statistics.

Most draws have a system of their own, which all cells of a tile share. Of a cell's runs, only the labels are kept, each
with its number of runs, and the statistics of their severity.
"""

from collections import Counter
from typing import Any

import numpy as np

from clunk.core.arrays import StopFlag, record_of
from clunk.core.regimes import System
from clunk.core.status import Status
from clunk.results.labels import FAILED_CODE
from clunk.results.maps import QUANTILES, ToleranceMap
from clunk.study.arrays import Array, Cells, Floats, LabelCodes
from clunk.study.axes import ResultAxes, ResultAxis, parameters_of
from clunk.study.designs import along_run
from clunk.study.parameters import drawn_numbers, nominal_value, quantity, with_draws
from clunk.study.study import Study
from clunk.sweeping.cells import Grid, Layout, Tile, most_of_load
from clunk.sweeping.reduction import Reduction, heading_of, in_order, labels_of

TOLERANCE_CELL = record_of(
    outcomes="i4",  # number of the cell's OUTCOMEs
    nominal_status="u1",
    status="u1",  # of the first draw that failed, or OK
    severity_mean="f8",
    severity_quantiles=("f8", (len(QUANTILES),)),
)
# A label that a cell has in some draws, and in how many; the text is as long as the longest label of a tile. A cell's
# first OUTCOME is that of the nominal run, unless this failed, even if no draw has its label (0 runs then).
OUTCOME = np.dtype([("runs", "i4"), ("label", "S1")])

_TILE_RUNS = 1 << 16  # of a tile, at most: 1 MB, and about a second


class SampleGrid(Grid):
    """The cells of a study with tolerances, each run for every draw of the sample and nominally.

    drawn : the sample: the numbers that each tolerance has drawn, (draws,) each
    draws : int, size of the sample
    """

    def __init__(self, study: Study) -> None:
        super().__init__(study)
        self._tolerances = study.swept.tolerances
        keys = sorted({*parameters_of(self.design.parameters), *parameters_of(self._tolerances)})
        alone = study.but(sweep=None, solver=study.solver.but(margin_tolerance=0.0))
        self._of_runs = Grid(alone, along_run((key, np.zeros(1)) for key in keys))
        self.layout = Layout(TOLERANCE_CELL, OUTCOME, "outcomes", len(study.lashes))
        self.draws = study.swept.sampling.count
        self.drawn = drawn_numbers(study, self._tolerances)
        self.few_cells, self.pace[0] = 0, 1.0  # s: as a cell may take long, the first tiles have one cell each
        self.tile_cells = max(1, min(_TILE_RUNS, most_of_load(study)) // self.draws)

    def shared(self) -> System | None:
        """The system that all runs share, if they do."""
        return self._of_runs.shared()

    @property
    def sample(self) -> ResultAxes:
        """An axis of drawn numbers for each tolerance; where a key has several, their names also say what is drawn."""
        sample, count = [], Counter(parameters_of(self._tolerances))
        suffix = {"value": "", "factor": ": factor on its nominal value", "offset": ": offset from its nominal value"}
        for tolerance, numbers in zip(self._tolerances, self.drawn, strict=True):
            parameter, draws, known = tolerance.parameter, tolerance.draws, quantity(tolerance.parameter)
            unit = "1" if draws == "factor" else known.unit
            name = f"{parameter}.{draws}" if count[parameter] > 1 else parameter
            sample.append(ResultAxis(name, numbers, known.name + suffix[draws], known.symbol, unit))
        return tuple(sample)

    def tile_of(self, cells: Cells, stop: StopFlag) -> Tile:
        """Run cells for every draw and nominally; a tile that was stopped has no cells."""
        count = (self.draws + 1) * cells.size
        tile = self._of_runs.run_at(np.arange(count), self._values(cells), stop)
        if tile.cells.size < count:
            return Tile(cells[:0], np.zeros(0, TOLERANCE_CELL), np.zeros(0, OUTCOME))
        labels, codes = labels_of(tile.records, tile.details)
        order = self.layout.rows(tile.cells).argsort().reshape(self.draws + 1, -1).T  # (rows, draws), nominal last
        severity, status = tile.records["severity"], tile.records["status"]
        summaries = [_summary(codes[runs], severity[runs], status[runs]) for runs in order]
        outcomes = [(runs, labels[code].encode()) for _, counts in summaries for code, runs in counts.items()]
        longest = max(map(len, labels), default=1)
        details = np.array(outcomes, [("runs", "i4"), ("label", f"S{longest}")])
        return Tile(cells, np.array([record for record, _ in summaries], TOLERANCE_CELL), details)

    def _values(self, cells: Cells) -> dict[str, Floats]:
        """Values of the parameters in cells for one draw after the other, nominally at last: (draws cells + cells,)."""
        columns, values = self.design.columns(cells), {}
        drawn = with_draws(self.study, columns, self._tolerances, (numbers[:, None] for numbers in self.drawn))
        for key, of_draws in drawn.items():
            column = np.full((self.draws + 1, cells.size), columns.get(key, nominal_value(self.study, key)))
            column[:-1] = of_draws
            values[key] = column.ravel()
        return values


def tolerance_map(reduction: Reduction, attributes: dict[str, str]) -> ToleranceMap:
    """The tolerance map of all cells of a `SampleGrid`, with these attributes of its file."""
    grid, shape = reduction.grid, reduction.shape
    assert isinstance(grid, SampleGrid)
    records, outcomes = reduction.collected()
    texts, inverse = np.unique(outcomes["label"], return_inverse=True)
    labels, numbers = in_order([text.decode() for text in texts.tolist()])
    codes, count = numbers[inverse], records["outcomes"]
    runs = np.zeros((reduction.rows, len(labels) + 1), np.int32)
    runs[np.arange(reduction.rows).repeat(count), codes] = outcomes["runs"]
    runs[:, FAILED_CODE] = grid.draws - runs.sum(axis=1)
    sequence = runs.argmax(axis=1).astype(np.int16)  # of equally likely labels the first
    sequence[sequence == len(labels)] = FAILED_CODE
    is_known = records["nominal_status"] == Status.OK
    nominal = np.full(reduction.rows, FAILED_CODE, np.int16)
    nominal[is_known] = codes[(count.cumsum() - count)[is_known]]
    return ToleranceMap(
        axes=reduction.axes,
        **heading_of(reduction.study),
        labels=labels,
        sample=grid.sample,
        arrays={
            "probability": (runs / grid.draws).reshape(*shape, len(labels) + 1),
            "sequence": sequence.reshape(shape),
            "nominal_sequence": nominal.reshape(shape),
            "severity_mean": records["severity_mean"].reshape(shape),
            "severity_quantiles": records["severity_quantiles"].reshape(*shape, -1),
            "status": records["status"].reshape(shape),
        },
        attributes=attributes,
    )


def _summary(codes: LabelCodes, severity: Floats, status: Array) -> tuple[tuple[Any, ...], dict[int, int]]:
    """A row's TOLERANCE_CELL, and the number of draws with each label code, from its runs, the last one nominal."""
    nominal = int(codes[-1])
    runs = {} if nominal == FAILED_CODE else {nominal: 0}
    drawn_codes, counts = np.unique(codes[:-1][codes[:-1] != FAILED_CODE], return_counts=True)
    runs |= zip(drawn_codes.tolist(), counts.tolist(), strict=True)
    known = severity[:-1][np.isfinite(severity[:-1])]
    mean, quantiles = (known.mean(), np.quantile(known, QUANTILES)) if known.size else (np.nan, np.nan)
    first_failed = status[np.argmax(status[:-1] != Status.OK)]
    return (len(runs), status[-1], first_failed, mean, quantiles), runs
