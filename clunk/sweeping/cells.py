"""Cells of a sweep's design: their systems, torques and gaps, and their runs by the kernels, tile by tile.

A tile has a row for each lash of each cell; the rows of a cell follow one another. A row has one record and any number
of details: for a regime map a CELL and its IMPACTs, for a tolerance map a TOLERANCE_CELL and its OUTCOMEs.
"""

import math
import re
import time
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.lib.recfunctions import require_fields

from clunk.core.arrays import RecordType, StopFlag, record_of
from clunk.core.events import EVENT
from clunk.core.exact.flows import Flows
from clunk.core.measures import OF_IMPACTS, measure_runs
from clunk.core.regimes import System
from clunk.core.status import QUALITY_UNDECIDED, Status
from clunk.core.switching import MOST_STAGES
from clunk.core.tile import CELL, EVENTS, IMPACT, MORE, Batch, Cases, Output, capacity_of, run_tile
from clunk.simulation.batches import most_prepared, of_system, prepare_many, prepare_one
from clunk.simulation.load import WAVES, cases_of
from clunk.study.arrays import Array, Cells, Floats, Records
from clunk.study.designs import Design, design_of
from clunk.study.models import OF_IMPACTS as IMPACT_MEASURES
from clunk.study.study import Study
from clunk.sweeping.machine import remove_old_kernels

_Part = tuple[Batch, Cells]  # drivelines, and the index in them of each one asked for, or -1
Runs = tuple[Cells, Records, Records, Records]  # positions of runs, their records, impacts and events

_BACKLASH = re.compile(r"lash(\[\d+\])?\.backlash_deg")

_KEPT = 2  # batches of drivelines that are kept for later calls
_TILE_BATCHES = 8  # of drivelines in a tile, at most, where each cell has its own driveline
_TILE_CELLS = {"rk4": 512, "exact": 4096}  # 0.1 s of the report's driveline: progress is smooth, overhead small
FEW = 8  # cells that are run first, to tell by their time whether the others are worth threads
_SLOWER = 4  # times as long a run takes among FEW runs as among many: where they are in many regimes, lanes are empty
_FEW_STEPS = 50_000  # most steps of a run by rk4 (0.5 ms) with which FEW cells are run first
_COMPILING = {"rk4": 15, "exact": 40}  # s that the kernels of a method take to compile
_IMPACTS = 16  # of a run at a lash for which there is room at first
# Touches of a run from which on rounding may decide its impacts: if each touch magnifies a difference 1.9 times, 1e-16
# of the gap has become the gap. Of 75,713 runs of 700 random studies, in 49 of which rounding decides some run, none
# with fewer than 59 touches has other impacts from inputs that differ by _NUDGED.
MANY_TOUCHES = 56
_NUDGED = 1.0 + 1e-12  # factor on inputs, 1e4 times rounding: with 1e2 times, some chaotic runs do not change
_OUTCOME = ["pattern", "touches"]  # fields of CELL that change if a run has other impacts
_MOVED = 1e-6  # relative change of a time that counts as another time: 1e6 times that of inputs that are _NUDGED
_THE_ONLY = np.zeros(1, np.int64)  # index of the driveline in a batch of one
_AT_ONCE = 1 << 23  # events that all runs of a call have room for: 134 MB if every second event is an impact
_STATES = 1 << 16  # events that all runs of a call have room for with states: 8 MB, which the caches nearly hold
_MEASURED, _MORE_MEASURED = 512, 8  # `EVENTS` and `MORE` for runs with states: less room, so that many run at a time
_TILE_POINTS = 2**19  # of tabulated loads in a tile: 20 MB where each cell has its own load


class Layout(NamedTuple):
    """Types of a tile's arrays.

    record, detail : dtype
    counted_by : field of a record with the number of its details
    lashes : number of lashes, and of rows of each cell
    """

    record: RecordType
    detail: RecordType
    counted_by: str
    lashes: int

    def rows(self, cells: Array) -> Array:
        """Numbers of the rows of some cells, in their order, from the cells' numbers."""
        return (cells[:, None] * self.lashes + np.arange(self.lashes)).ravel()


class Tile(NamedTuple):
    """Results of some cells.

    cells : (n,) int64, numbers in C order of the design; in any order, consecutive or not
    records : (n lashes,) of the layout's record type
    details : (N,) of the layout's detail type, in the order of the rows that they belong to
    """

    cells: Cells
    records: Records
    details: Records


def most_of_load(study: Study) -> int:
    """Most runs at a time, so that their loads have `_TILE_POINTS` points at most if each run has its own load."""
    return max(_TILE_POINTS // len(study.load.times or study.load.levels or (0,)), 1)


def leaves_system(study: Study, parameter: str) -> bool:
    """Whether a parameter leaves the system as it is, and changes only the load's pieces or a gap."""
    of_wave = f"load.{WAVES.get(study.load.profile)}"
    is_load = parameter.startswith("load.") and parameter not in ("load.on", of_wave)
    return is_load or _BACKLASH.fullmatch(parameter) is not None


class Grid:
    """The cells of a study's design, run once each.

    study : Study
    design : Design, by default that of the study's sweep
    layout : Layout of the tiles
    tile_cells : the most cells of a tile
    few_cells : number of cells that are run in so short a time that a signal can wait for it; 0 if these take long, too
    pace : one number in a list, the time that a cell takes  [s]: measured in the latest tile of more than FEW cells, or
        less, by a smaller tile since; infinite before the first tile
    structural : the parameters of the design that change the system
    """

    def __init__(self, study: Study, design: Design | None = None) -> None:
        self.study = study
        self.design = design or design_of(study)
        self.layout = layout_of(study)
        self.structural = tuple(
            each.parameter for each in self.design.parameters if not leaves_system(study, each.parameter)
        )
        self.tile_cells = min(_TILE_CELLS[study.solver.method], most_of_load(study))
        if self.structural:
            self.tile_cells = min(self.tile_cells, _TILE_BATCHES * most_prepared(study))
        solver = study.solver
        is_slow = solver.method == "rk4" and solver.end_time > _FEW_STEPS * solver.step
        self.few_cells = 0 if is_slow or self._is_large() else min(FEW, self.tile_cells)
        self.pace = [math.inf]  # a list, which grids of other designs share (`with_design`)
        self._kept: dict[bytes, tuple[Batch, int]] = {}  # batch and index in it of a driveline, by its point's bytes

    def __getstate__(self) -> dict[str, Any]:
        self.shared()  # prepared here and sent along to other processes, so that all of them have the same bits
        return self.__dict__ | {"_kept": {}}

    def with_design(self, design: Design) -> "Grid":
        """Grid of another design with the same parameters; it shares the drivelines that have been prepared."""
        grid = object.__new__(type(self))
        grid.__dict__.update(self.__dict__ | {"design": design})
        if grid._is_large():
            grid.few_cells = 0
        return grid

    def _is_large(self) -> bool:
        """Whether there are many drivelines, so that to prepare the first few apart takes long beside preparing all."""
        return bool(self.structural) and self.design.cells > FEW

    def ordered(self, cells: Cells) -> Cells:
        """Cells in the order in which they are best cut into tiles: those with the same system follow one another."""
        if not self.structural:
            return cells
        values = self.design.columns(cells)
        return cells[np.lexsort([values[parameter] for parameter in self.structural])]

    @cached_property
    def _nominal(self) -> Batch:
        """The driveline with the study's own values of structural parameters."""
        return prepare_one(of_system(self.study))

    def steps(self) -> float:
        """Number of steps from start to end of a run: of rk4, or of the exact method in a flow without modes.

        Such a flow takes the shortest span only; 0 by the exact method where all flows have modes.
        """
        tables, step = self._nominal.tables, self.study.solver.step
        if isinstance(tables, Flows):
            step = np.where(tables.modal, np.inf, tables.span[..., 0]).min()
        return self.study.solver.end_time / step

    def shared(self) -> System | None:
        """The system that all cells share; None where it differs between them."""
        return None if self.structural else self._nominal.system

    def drivelines(self, points: Floats) -> Iterator[_Part]:
        """Prepare the drivelines at D points of the structural parameters; the latest are kept for later calls.

        points : (D, parameters)

        Yields batches, each with the index in it of every point's driveline, (D,), or -1 for those in other batches.
        """
        if not self.structural:
            yield self._nominal, np.zeros(1, np.int64)
            return
        rows = np.ascontiguousarray(points).view(f"V{points.shape[1] * points.itemsize}").ravel().tolist()  # as bytes
        members: dict[int, _Part] = {}
        unknown = []
        for k, row in enumerate(rows):
            if known := self._kept.get(row):  # one look-up, as other threads may clear it
                batch, number = known
                members.setdefault(id(batch), (batch, np.full(len(rows), -1)))[1][k] = number
            else:
                unknown.append(k)
        yield from members.values()
        missing = np.array(unknown, np.int64)
        for positions, batch in prepare_many(self.study, self.structural, points[missing]):
            numbers = np.full(len(rows), -1)
            numbers[missing[positions]] = np.arange(positions.size)
            if len(self._kept) >= _KEPT * most_prepared(self.study):
                self._kept.clear()
            self._kept |= {rows[k]: (batch, number) for number, k in enumerate(missing[positions].tolist())}
            yield batch, numbers

    def run(self, cells: Cells, stop: StopFlag) -> Tile:
        """Run cells, and measure the pace; the tile has the cells that were done before `stop` was set."""
        began = time.perf_counter()
        tile = self.tile_of(cells, stop)
        pace = (time.perf_counter() - began) / max(cells.size, 1)
        fewer = 4 * FEW if self.structural else _SLOWER  # few drivelines take as long to prepare as many
        self.pace[0] = pace if cells.size > FEW else min(pace / fewer, self.pace[0])
        return tile

    def tile_of(self, cells: Cells, stop: StopFlag) -> Tile:
        """Run cells as `run` does, but without measuring the pace."""
        return self.run_at(cells, self.design.columns(cells), stop)

    def run_at(self, cells: Cells, values: Mapping[str, Floats], stop: StopFlag) -> Tile:
        """Run cells with these values of the design's parameters, (cells,) each, instead of the design's own."""
        layout = self.layout
        done, rows, pieces = [np.zeros(0, np.int64)], [np.zeros(0, layout.record)], [np.zeros(0, layout.detail)]
        for positions, records, impacts, _ in self._runs(values, cells.size, stop):
            done.append(positions)
            rows.append(records)
            pieces.append(impacts)
        # with dtype given, as numpy would otherwise work it out anew for each piece
        records, details = np.concatenate(rows, dtype=layout.record), np.concatenate(pieces, dtype=layout.detail)
        return Tile(cells[np.concatenate(done)], records, details)

    def logged(self, values: Mapping[str, Floats], count: int) -> tuple[Records, Records]:
        """Run `count` cells with these values of parameters, and keep their events.

        Returns CELL (count, lashes), and EVENT (count, events), with NaN as time behind the last event of a run, and
        without any event for a run that failed.
        """
        records, pieces = np.zeros((count, self.layout.lashes), CELL), []
        for positions, rows, _, logs in self._runs(values, count, np.zeros(1, np.uint8), keeps_events=True):
            records[positions] = rows.reshape(-1, self.layout.lashes)
            ok = records["status"][positions, 0] == Status.OK
            pieces.append((positions[ok], logs[ok, : (~np.isnan(logs["time"][ok])).sum(axis=1).max(initial=0)]))
        events = np.zeros((count, max((logs.shape[1] for _, logs in pieces), default=0)), EVENT)
        events["time"] = np.nan
        for positions, logs in pieces:
            events[positions, : logs.shape[1]] = logs
        return records, events

    def _runs(
        self, values: Mapping[str, Floats], count: int, stop: StopFlag, *, keeps_events: bool = False
    ) -> Iterator[Runs]:
        """Run cells with room for few events at first; those that need more are run again, with more room.

        keeps_events : whether to yield the events of runs, and not to evaluate what the config measures
        """
        lashes, measures = self.layout.lashes, self.study.measured and not keeps_events
        for of_batch in self._by_batches(values, count):
            batch, positions, cases = of_batch
            most = self.study.solver.max_events
            if measures and batch.systems.regimes.size > batch.systems.regime_strides[lashes]:
                most += MOST_STAGES  # changes of stage need room too
            first, more = (_MEASURED, _MORE_MEASURED) if measures else (EVENTS, MORE)
            room = min(first, most)
            while positions.size and not stop[0]:
                if (cases.drivelines == cases.drivelines[0]).all():  # several times faster than a driveline for each
                    batch = batch.at(cases.drivelines[:1]) if len(batch.systems.rates) > 1 else batch
                    cases = cases._replace(drivelines=_THE_ONLY)
                at_once = min(positions.size, max((_STATES if measures else _AT_ONCE) // room, 1))
                capacity = capacity_of(room, lashes)
                logs = np.zeros((at_once, capacity) if measures or keeps_events else (0, 0), EVENT)
                states = np.empty((at_once, capacity, batch.systems.rates.shape[-1]) if measures else (0, 0, 0))
                again = []
                for begin in range(0, positions.size, at_once):
                    part = positions[begin : begin + at_once]
                    logs["time"] = np.nan
                    some = cases.at(slice(begin, begin + at_once))
                    rows, impacts = self._run(batch, some, stop, room, logs[: part.size], states[: part.size])
                    full = (rows["status"][::lashes] == Status.EVENT_BUFFER_FULL) & (room < most)
                    again.append(begin + np.flatnonzero(full))
                    events = logs[: full.size][~full] if keeps_events else logs[:0]
                    yield part[: full.size][~full], rows[np.repeat(~full, lashes)], impacts, events
                    if full.size < part.size:
                        break
                left = np.concatenate(again)
                positions, cases, room = positions[left], cases.at(left), min(more * room, most)

    def _by_batches(self, values: Mapping[str, Floats], count: int) -> Iterator[tuple[Batch, Cells, Cases]]:
        """Cut cells by the batches that their drivelines are in, and so that their loads are of a bounded size.

        values : (count,) values of each parameter

        Yields batches, each with the positions of its cells and their torques and gaps.
        """
        points, point_of = np.zeros((1, 0)), np.zeros(count, np.int64)
        if self.structural:
            combinations = np.stack([values[parameter] for parameter in self.structural], axis=1)
            points, point_of = np.unique(combinations, axis=0, return_inverse=True)
        most = most_of_load(self.study)
        for batch, numbers in self.drivelines(points):
            of_cells = numbers[point_of.ravel()]
            all_positions = np.flatnonzero(of_cells >= 0)
            for begin in range(0, all_positions.size, most):
                positions = all_positions[begin : begin + most]
                some = {key: column[positions] for key, column in values.items()}
                cases = cases_of(self.study, some, positions.size)
                yield batch, positions, cases._replace(drivelines=of_cells[positions])

    def _run(
        self, batch: Batch, cases: Cases, stop: StopFlag, room: int, logs: Records, states: Floats
    ) -> tuple[Records, Records]:
        """Records and impacts, in the grid's layout, of the runs that were done before `stop` was set.

        A run of MANY_TOUCHES or more may have magnified rounding to the size of the gap. By the exact method, and with
        a margin tolerance, it is repeated from a torque and gaps that differ by a little more than rounding (_NUDGED):
        if that has other impacts, or its last event at another time, the run is undecided.

        room : number of events for which each run has room
        logs, states : buffers of `Output`, or empty ones; with states, what the config measures is evaluated
        """
        cells, details = self._followed(batch, cases, stop, room, logs, states)
        if self.study.solver.method == "exact" and self.study.solver.margin_tolerance:
            long = np.flatnonzero(cells["touches"].sum(axis=1) >= MANY_TOUCHES)
            if long.size:
                again = cases.at(long)
                again = again._replace(before=again.before * _NUDGED)
                others, _ = self._followed(batch, again, stop, room, logs[:0], states[:0])
                if len(others) < long.size:
                    cells, details = cells[:0], details[:0]
                else:
                    ends, other_ends = cells["last_event_time"][long], others["last_event_time"]
                    differ = (cells[_OUTCOME][long] != others[_OUTCOME]) | (abs(ends - other_ends) > _MOVED * ends)
                    cells["quality"][long[differ.any(axis=1)]] |= QUALITY_UNDECIDED
        if not len(states):
            return cells.ravel(), details
        return self._measured(batch, cases, Output(cells, details, logs, states), stop)

    def _followed(
        self, batch: Batch, cases: Cases, stop: StopFlag, room: int, logs: Records, states: Floats
    ) -> tuple[Records, Records]:
        """CELL (n, lashes) and IMPACT of the first n runs, which were done before `stop` was set; see `_run`.

        Runs whose impacts do not fit are run again, with twice the room for each.
        """
        solver, runs, lashes = self.study.solver, len(cases.before), self.layout.lashes
        most = min(room, solver.max_events)
        cells, done, impacts, each = np.zeros((runs, lashes), CELL), 0, [np.zeros(0, IMPACT)], _IMPACTS * lashes
        while done < runs and not stop[0]:
            # with some more room, so that a few runs with many impacts need not be run again
            buffer = np.zeros(each * (runs - done) + 3 * most, IMPACT)
            output = Output(cells, buffer, logs, states)
            done, written = run_tile(batch, solver.margin_tolerance, cases, done, most, output, stop)
            impacts.append(buffer[:written].copy())
            each *= 2
        return cells[:done], np.concatenate(impacts, dtype=IMPACT)

    def _measured(self, batch: Batch, cases: Cases, output: Output, stop: StopFlag) -> tuple[Records, Records]:
        """Records and impacts of runs with what the config measures added; empty where `stop` is set."""
        names, details = self.study.impacts.quantities, output.impacts
        totals = np.full((*output.cells.shape, OF_IMPACTS + len(self.study.measures)), np.nan)
        of_impacts = np.zeros((details.size, OF_IMPACTS))
        measure_runs(batch, cases, output, totals, of_impacts, stop)
        columns = [*(IMPACT_MEASURES.index(name) for name in names), *range(OF_IMPACTS, totals.shape[2])]
        records = _joined(output.cells.ravel(), self.layout.record, totals[..., columns].reshape(-1, len(columns)))
        impacts = _joined(details, self.layout.detail, of_impacts[:, columns[: len(names)]])
        return (records[:0], impacts[:0]) if stop[0] else (records, impacts)


def layout_of(study: Study) -> Layout:
    """Layout of the tiles of a study: the fields of every run, and behind them those that the config measures."""
    names, measures = study.impacts.quantities, (each.name for each in study.measures)
    return Layout(_with(CELL, *names, *measures), _with(IMPACT, *names), "primary_impacts", len(study.lashes))


def _with(record: RecordType, *names: str) -> RecordType:
    """Type of records with further fields of float64 with these names."""
    fields = {name: record[name] for name in record.names or ()}
    return record_of(**fields, **dict.fromkeys(names, "f8"))


def _joined(records: Records, layout: RecordType, columns: Floats) -> Records:
    """Records extended to a type with further fields, whose values are the columns, (records, fields)."""
    joined = require_fields(records, layout)
    for name, column in zip((layout.names or ())[len(records.dtype.names or ()) :], columns.T, strict=True):
        joined[name] = column
    return joined


def compiling_note(*studies: Study) -> str:
    """Sentence on the time that the kernels of these studies take to compile; empty where that has been done."""
    kept = Path(numba.config.CACHE_DIR)  # type: ignore[attr-defined]  # numba sets it at run time
    methods = sorted({study.solver.method for study in studies})
    cold = [method for method in methods if not any(kept.glob(f"**/tile.by_{method}-*.nbi"))]
    seconds = sum(_COMPILING[method] for method in cold)
    return f"compiling {' and '.join(cold)}, once for this installation (about {seconds} s) …" if cold else ""


def warm_up(study: Study) -> None:
    """Compile the kernels of a study, or load them, before a sweep rather than in the middle of it."""
    remove_old_kernels()
    Grid(study.but(sweep=None)).run(np.arange(1), np.zeros(1, np.uint8))
