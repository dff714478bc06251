"""Tolerances: every cell of a grid, run for the same sample of the toleranced parameters, and what comes of it.

A tile runs its cells draw by draw, since most draws are systems of their own, which all cells of a tile then share.
Of a cell's runs only their outcomes are kept, each with its number of runs, and the statistics of their severity.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.exact.flows import Flows
from clunk.core.regimes import System
from clunk.core.rk4.propagator import Steps
from clunk.core.sequence import INITIAL, OPPOSITE, label
from clunk.core.status import Status
from clunk.core.tile import LONGEST_PATTERN
from clunk.results.labels import FAILED_CODE
from clunk.results.tolerancemap import QUANTILES, ToleranceMap
from clunk.study.axes import ResultAxis
from clunk.study.config import Study, digest, nominal_value, quantity, to_toml
from clunk.study.designs import design_of, drawn_numbers
from clunk.sweeping.cells import DRIVING, KEPT_SYSTEMS, Grid
from clunk.sweeping.tiles import Tile

FloatArray = npt.NDArray[np.float64]
Cells = npt.NDArray[np.int64]
Flanks = tuple[int, ...]

# A cell of a tolerance map; in a tile its outcomes stand where those of a map have impacts.
TOLERANCE_CELL = np.dtype(
    [
        ("outcomes", np.int32),
        ("status", np.uint8),  # of the first draw that failed
        ("mean", np.float64),  # of the severity; so are these quantiles
        ("low", np.float64),
        ("median", np.float64),
        ("high", np.float64),
    ],
    align=True,
)
# An outcome: up to 62 primaries' flanks as `pattern` of `clunk.core.tile` has them (0: failed), how many runs had it,
# and whether the nominal run did. What is longer goes on in entries of `_GOES_ON` runs.
OUTCOME = np.dtype([("pattern", np.uint64), ("runs", np.int32), ("nominal", np.int8)], align=True)

_GOES_ON = -1
_GOLDEN = 0.6180339887498949
_LONG = 1 << 63  # from here on, a pattern is the number of a sequence that is too long for one
_TILE_RUNS = 1 << 16  # 1 MB of them, in about a second
_MOST_TILE_RUNS = 1 << 22  # 64 MB: where more systems are drawn than are kept, many cells must share each
_NO_CELLS = Tile(np.zeros(0, np.int64), np.zeros(0, TOLERANCE_CELL), np.zeros(0, OUTCOME))


class ToleranceGrid(Grid):
    """The cells of a study with tolerances; running one runs it for every draw of the sample, and nominally.

    drawn : what is drawn, by parameter, each (draws,)
    draws : int, the size of the sample
    """

    record, detail = TOLERANCE_CELL, OUTCOME

    def __init__(self, study: Study, shared: tuple[System, Steps | Flows] | None = None) -> None:
        assert study.sweep is not None
        super().__init__(study.model_copy(update={"sweep": None}), design_of(study), shared)
        self._whole = study
        self._tolerances = study.sweep.tolerances
        self.draws = self.runs = study.sweep.sampling.count
        self.drawn = {
            own.parameter: numbers
            for own, numbers in zip(self._tolerances, drawn_numbers(study, self._tolerances), strict=True)
        }
        self._new_systems = any(parameter not in DRIVING for parameter in self.drawn)

    @property
    def tile_cells(self) -> int:
        """How many cells a tile has at most; its memory does not depend on the size of the sample."""
        room = _MOST_TILE_RUNS if self._new_systems and self.draws > KEPT_SYSTEMS else _TILE_RUNS
        return max(1, room // self.draws)

    def ordered(self, cells: Cells) -> Cells:
        """These cells, those that share their systems beside each other."""
        return np.concatenate([cells[:0], *(cells[mine] for _, mine in self.groups(cells))])

    def shared(self) -> tuple[System, Steps | Flows] | None:
        """The system and tables that all runs share, if they do."""
        return None if self._new_systems else super().shared()

    def recipe(self) -> tuple[type[Grid], tuple[Any, ...]]:
        """See `Grid.recipe`."""
        return type(self), (self._whole, self.shared())

    def run(self, cells: Cells, stop: npt.NDArray[np.uint8]) -> Tile:
        """Run cells; as `Grid.run`, but a tile that was stopped has no cells."""
        at = self.design.at(cells)
        patterns = np.zeros((cells.size, self.draws + 1), np.uint64)  # the nominal run last
        severity = np.full((cells.size, self.draws + 1), np.nan)
        status = np.zeros((cells.size, self.draws + 1), np.uint8)
        long: list[Flanks] = []
        buffer = self.impact_buffer(cells.size)
        # tiles that run at the same time begin far apart, so that each prepares systems for the others
        begin = int(_GOLDEN * (cells[0] // cells.size) * self.draws)
        order = [self.draws, *((begin + np.arange(self.draws)) % self.draws)]
        for values, mine in self.groups(cells):
            own = {parameter: column[mine] for parameter, column in at.items()}
            for draw in order:
                system, driving = (dict(values), own) if draw == self.draws else self._at(draw, values, own)
                records, impacts = self.run_group(system, self.drive(driving, mine.size), buffer, stop)
                if records.size < mine.size:
                    return _NO_CELLS
                severity[mine, draw], status[mine, draw] = records["severity"], records["status"]
                patterns[mine, draw] = _numbered(records, impacts, long)
        found = [_summary(patterns[k], severity[k], status[k], long) for k in range(cells.size)]
        records = np.array([record for record, _ in found], TOLERANCE_CELL)
        outcomes = np.array([outcome for _, outcomes in found for outcome in outcomes], OUTCOME)
        return Tile(cells, records, outcomes)

    def _at(
        self, draw: int, system: Mapping[str, float], cells: Mapping[str, FloatArray]
    ) -> tuple[dict[str, float], dict[str, FloatArray]]:
        """What makes the system, and what drives the cells, at a draw: each value around that of its cell."""
        system, cells = dict(system), dict(cells)
        for own in self._tolerances:
            parameter, drawn = own.parameter, self.drawn[own.parameter][draw]
            if parameter in DRIVING:
                cells[parameter] = own.applied(drawn, cells.get(parameter, nominal_value(self.study, parameter)))
            else:
                system[parameter] = float(
                    own.applied(drawn, system.get(parameter, nominal_value(self.study, parameter)))
                )
        return system, cells


class ToleranceAssembly:
    """The arrays of a tolerance map, filled tile by tile.

    done : cells that are known
    """

    def __init__(self, study: Study, grid: ToleranceGrid) -> None:
        self._study = study
        self._grid = grid
        self.done = 0
        self._known = np.zeros(grid.cells, bool)
        self._mean = np.zeros(grid.cells)
        self._quantiles = np.zeros((grid.cells, len(QUANTILES)))
        self._status = np.zeros(grid.cells, np.uint8)
        self._codes: dict[Flanks | None, int] = {None: FAILED_CODE}  # of the primaries' flanks, as they turned up
        self._nominal = np.zeros(grid.cells, np.int64)
        self._runs: list[tuple[Cells, Cells, Cells]] = []  # cells, codes, and how many runs

    def missing(self) -> Cells:
        """The cells that have not been run, in ascending order."""
        return np.flatnonzero(~self._known).astype(np.int64)

    def add(self, tile: Tile) -> None:
        """Take a tile's cells; those that are there already are passed over."""
        new = ~self._known[tile.cells]
        for name, own in zip(("low", "median", "high"), self._quantiles.T, strict=True):
            own[tile.cells] = tile.records[name]
        self._mean[tile.cells], self._status[tile.cells] = tile.records["mean"], tile.records["status"]
        entries = []
        owners = np.repeat(np.arange(tile.cells.size), tile.records["outcomes"])
        for owner, flanks, count, nominal in _outcomes(owners, tile.impacts):
            if new[owner]:
                code = self._codes.setdefault(flanks, len(self._codes) - 1)
                entries.append((tile.cells[owner], code, count))
                if nominal:
                    self._nominal[tile.cells[owner]] = code
        cells, codes, runs = np.array(entries, np.int64).reshape(-1, 3).T
        self._runs.append((cells, codes, runs))
        self._known[tile.cells] = True
        self.done += int(np.count_nonzero(new))

    def results(self, attributes: dict[str, str]) -> ToleranceMap:
        """The finished map; every cell has been run.

        Codes are by (number of primaries, label), so that they do not depend on who finished first.
        """
        assert self._known.all()
        names = {label(flanks): len(flanks) for flanks in self._codes if flanks is not None}
        labels = tuple(sorted(names, key=lambda text: (names[text], text)))
        final = [FAILED_CODE if flanks is None else labels.index(label(flanks)) for flanks in self._codes]
        code = np.array([*final[1:], FAILED_CODE], np.int16)  # failed is code -1, and so the last
        runs = np.zeros((self._grid.cells, len(labels) + 1), np.int32)
        for cells, codes, count in self._runs:
            np.add.at(runs, (cells, code[codes]), count.astype(np.int32))
        shape = self._grid.shape
        return ToleranceMap(
            title=self._study.title,
            axes=self._grid.design.axes,
            coordinates=self._grid.design.coordinates,
            labels=labels,
            sample=sample_of(self._study, self._grid.drawn),
            runs=runs.reshape(*shape, len(labels) + 1),
            nominal_sequence=code[self._nominal].reshape(shape),
            severity_mean=self._mean.reshape(shape),
            severity_quantiles=self._quantiles.reshape(*shape, len(QUANTILES)),
            status=self._status.reshape(shape),
            config=to_toml(self._study),
            config_digest=digest(self._study),
            attributes=attributes,
        )


def sample_of(study: Study, drawn: Mapping[str, FloatArray]) -> tuple[ResultAxis, ...]:
    """What was drawn, each parameter's with its name and unit."""
    assert study.sweep is not None
    found = []
    for own in study.sweep.tolerances:
        known = quantity(own.parameter)
        what = {"value": "", "factor": ": factor on its nominal value", "offset": ": offset from its nominal value"}
        unit = "1" if own.draws == "factor" else known.unit
        found.append(ResultAxis(own.parameter, drawn[own.parameter], known.name + what[own.draws], known.symbol, unit))
    return tuple(found)


def _numbered(
    records: npt.NDArray[np.void], impacts: list[npt.NDArray[np.void]], long: list[Flanks]
) -> npt.NDArray[np.uint64]:
    """The runs' patterns; where a sequence is too long for one, `_LONG` and its number in `long`, which grows."""
    patterns: npt.NDArray[np.uint64] = records["pattern"].copy()
    too_long = np.flatnonzero((patterns == 0) & (records["status"] == Status.OK))
    if too_long.size:
        flanks = np.concatenate(impacts)["flank"]
        ends = np.cumsum(records["primary_impacts"])
        for k in too_long:
            own = tuple(flanks[ends[k] - records["primary_impacts"][k] : ends[k]].tolist())
            if own not in long:
                long.append(own)
            patterns[k] = _LONG + long.index(own)
    return patterns


def _summary(
    patterns: npt.NDArray[np.uint64], severity: FloatArray, status: npt.NDArray[np.uint8], long: list[Flanks]
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


def _outcomes(owners: Cells, entries: npt.NDArray[np.void]) -> Iterator[tuple[int, Flanks | None, int, bool]]:
    """(owner, flanks or None where it failed, runs, whether nominal) of each outcome."""
    begins = np.flatnonzero(entries["runs"] != _GOES_ON)
    for begin, end in zip(begins, [*begins[1:], len(entries)], strict=True):
        words = entries["pattern"][begin:end].tolist()
        bits = "".join(bin(word)[3:] for word in words)
        flanks = tuple(OPPOSITE if bit == "1" else INITIAL for bit in bits) if words[0] else None
        yield int(owners[begin]), flanks, int(entries["runs"][begin]), bool(entries["nominal"][begin])
