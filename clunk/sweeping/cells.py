"""Cells of a sweep's design: their systems, torques and gaps, and their runs by the kernel, tile by tile.

A tile has a row for each lash of each cell, a cell's rows behind one another: one record and any number of details, of
a regime map its CELL and its impacts, of a tolerance map its TOLERANCE_CELL and its OUTCOMEs.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core import tile as kernel
from clunk.core.events import EVENT
from clunk.core.jit import is_cold
from clunk.core.measures import OF_IMPACTS, measure_runs
from clunk.core.regimes import System
from clunk.core.status import Status
from clunk.core.switching import MOST_STAGES
from clunk.simulation.batches import most_prepared, prepare_many, prepare_one
from clunk.simulation.load import WAVES, loads_of
from clunk.study.arrays import Array, Cells, Floats, Records
from clunk.study.designs import Design, design_of
from clunk.study.document import dotted
from clunk.study.models import OF_IMPACTS as IMPACT_MEASURES
from clunk.study.study import Study

Flag = npt.NDArray[np.uint8]  # (1,); set by another thread, it ends the work within a run
_Part = tuple[kernel.Batch, Cells]  # drivelines, and the number among them of each of those that were asked for
Runs = tuple[Cells, Records, list[Records]]  # positions of runs, their records, and their impacts in pieces

CELL, IMPACT = kernel.CELL, kernel.IMPACT

_BACKLASH = re.compile(r"lash(\[\d+\])?\.backlash_deg")

_KEPT = 2  # batches of drivelines
_TILE_BATCHES = 8  # of a tile whose cells have a driveline each
_TILE_CELLS = {"rk4": 512, "exact": 4096}  # 0.1 s of the report's driveline: progress is smooth, overhead small
_COMPILING = {"rk4": 15, "exact": 40}  # s
_IMPACTS = 8  # of a run in a lash, that there is room for at first
_NO_LOGS, _NO_STATES = np.zeros((0, 0), EVENT), np.zeros((0, 0, 0))
_THE_ONLY = np.zeros(1, np.int64)  # driveline of a batch of one
_STATES = 1 << 16  # events whose states there is room for at a time: 8 MB, which the caches nearly hold
_TILE_POINTS = 2**19  # of tabulated loads: 20 MB where each cell has its own


@dataclass(frozen=True)
class Layout:
    """Types of a tile's arrays.

    record, detail : dtype
    counted_by : field of a record with the number of its details
    lashes : number of rows of each cell
    """

    record: np.dtype[np.void]
    detail: np.dtype[np.void]
    counted_by: str
    lashes: int = 1

    def rows(self, cells: Array) -> Array:
        """Numbers of the rows of some cells, in their order, from the cells' numbers."""
        return cells if self.lashes == 1 else (cells[:, None] * self.lashes + np.arange(self.lashes)).ravel()


@dataclass(frozen=True, eq=False)
class Tile:
    """Results of some cells.

    cells : (n,) int64, numbers in C order of the design; in any order, consecutive or not
    records : (n lashes,) of the layout's record type
    details : (N,) of its detail type, those of each row behind those of the row before it
    """

    cells: Cells
    records: Records
    details: Records


def most_of_load(study: Study) -> int:
    """Most runs at a time whose loads, if each has its own, are of a bounded size."""
    return max(_TILE_POINTS // len(study.load.times or (0,)), 1)


def leaves_system(study: Study, parameter: str) -> bool:
    """Whether cells that differ in a parameter have the same system: only the load's pieces or the gap change."""
    of_wave = f"load.{WAVES.get(study.load.profile)}"
    is_load = parameter.startswith("load.") and parameter not in ("load.on", of_wave)
    return is_load or _BACKLASH.fullmatch(parameter) is not None


class Grid:
    """The cells of a study's design, run once each.

    study : Study
    design : Design, by default that of the study's sweep
    shared : the system that cells without structural parameters share, where it is known already
    structural : the parameters that differ between the cells and with which the system does
    """

    def __init__(self, study: Study, design: Design | None = None, shared: kernel.Batch | None = None) -> None:
        self.study = study
        self.design = design or design_of(study)
        self.layout = layout_of(study)
        parameters = (each.parameter for each in self.design.parameters)
        self.structural = tuple(key for key in parameters if not leaves_system(study, key))
        self.tile_cells = min(_TILE_CELLS[study.solver.method], most_of_load(study))
        if self.structural:
            self.tile_cells = min(self.tile_cells, _TILE_BATCHES * most_prepared(study))
        self._kept: dict[bytes, tuple[kernel.Batch, int]] = {}  # drivelines, by the bytes of their points
        if shared is not None:
            self._nominal = shared

    def __reduce__(self) -> tuple[Any, ...]:  # the shared system goes along, so that all processes have its bits
        return type(self), (self.study, self.design, None if self.structural else self._nominal)

    def with_design(self, design: Design) -> Grid:
        """The cells of another design with the same parameters, run with the same drivelines."""
        grid = Grid(self.study, design, None if self.structural else self._nominal)
        grid._kept = self._kept
        return grid

    def ordered(self, cells: Cells) -> Cells:
        """Cells in the order in which they are best cut into tiles: those of one system behind one another."""
        if not self.structural:
            return cells
        values = self.design.columns(cells)
        return cells[np.lexsort([values[parameter] for parameter in self.structural])]

    @cached_property
    def _nominal(self) -> kernel.Batch:
        """The driveline with the study's own values of structural parameters."""
        return prepare_one(self.study)

    def shared(self) -> System | None:
        """The system that all cells share, if they do."""
        return None if self.structural else self._nominal.system

    def drivelines(self, points: Floats) -> Iterator[_Part]:
        """The drivelines at some values of structural parameters; the latest are kept for later calls.

        points : (D, parameters)

        Yields batches, each with the number in it of every driveline, (D,), or -1.
        """
        if not self.structural:
            yield self._nominal, np.zeros(1, np.int64)
            return
        rows = [row.tobytes() for row in points]
        known = [self._kept.get(row) for row in rows]
        members: dict[int, _Part] = {}
        for k, (batch, number) in ((k, each) for k, each in enumerate(known) if each is not None):
            members.setdefault(id(batch), (batch, np.full(len(rows), -1)))[1][k] = number
        yield from members.values()
        missing = np.array([k for k, each in enumerate(known) if each is None], np.int64)
        for positions, batch in prepare_many(self.study, self.structural, points[missing]):
            numbers = np.full(len(rows), -1)
            numbers[missing[positions]] = np.arange(positions.size)
            if len(self._kept) >= _KEPT * most_prepared(self.study):
                self._kept.clear()
            self._kept |= {rows[k]: (batch, number) for number, k in enumerate(missing[positions].tolist())}
            yield batch, numbers

    def cases(self, values: Mapping[str, float | Floats], count: int) -> kernel.Cases:
        """Torques and gaps of `count` cells with these values of parameters."""
        swept = {key.removeprefix("load."): values[key] for key in values if key.startswith("load.")}
        before, pieces = loads_of(self.study.load, count, **swept)
        gaps = np.empty((count, len(self.study.lashes)))
        for k, (place, lash) in enumerate(zip(self.study.lash_places, self.study.lashes, strict=True)):
            gaps[:, k] = values.get(dotted((*place, "backlash_deg")), lash.backlash_deg)
        return kernel.cases_of(before, np.deg2rad(gaps) / 2, pieces)

    def run(self, cells: Cells, stop: Flag) -> Tile:
        """Run cells; the tile has those that were done before `stop` was set."""
        return self.run_at(cells, self.design.columns(cells), stop)

    def run_at(self, cells: Cells, values: Mapping[str, Floats], stop: Flag) -> Tile:
        """Run cells with these values of the design's parameters, whatever the design's are."""
        layout, run = self.layout, self._measured if self.study.measured else self._run
        done, rows, pieces = [np.zeros(0, np.int64)], [np.zeros(0, layout.record)], [np.zeros(0, layout.detail)]
        for batch, positions, part in self._by_batches(values, cells.size):
            for finished, records, impacts in self._with_room(run, batch, positions, part, stop, self.study.measured):
                done.append(finished[: records.size // layout.lashes])
                rows.append(records)
                pieces += impacts
        # with the type, which numpy would otherwise find anew for each piece
        places, records = np.concatenate(done), np.concatenate(rows, dtype=layout.record)
        details = np.concatenate(pieces, dtype=layout.detail)
        if (places[1:] < places[:-1]).any():
            order = np.argsort(places)
            rank = np.empty_like(order)
            rank[order] = np.arange(order.size)
            owners = np.repeat(layout.rows(rank), records["primary_impacts"])
            places, records, details = (
                places[order],
                records[layout.rows(order)],
                details[np.argsort(owners, kind="stable")],
            )
        return Tile(cells[places], records, details)

    def _with_room(
        self,
        run: Callable[[kernel.Batch, kernel.Cases, Flag, int], tuple[Records, list[Records]]],
        batch: kernel.Batch,
        positions: Cells,
        cases: kernel.Cases,
        stop: Flag,
        writes_stages: bool = False,
    ) -> Iterator[Runs]:
        """Runs with room for few events at first; those that find too little are run again, with more.

        run : by batch, cases, stop and the room for events; those that find too little have no impacts
        writes_stages : whether changes of stage need room too
        """
        lashes, most = self.layout.lashes, self.study.solver.max_events
        if writes_stages and batch.system.regimes.size > batch.system.regime_strides[lashes]:
            most += MOST_STAGES
        room = min(kernel.EVENTS, most)
        while positions.size and not stop[0]:
            if (cases.drivelines == cases.drivelines[0]).all():  # several times faster than each with its own
                batch = batch.at(cases.drivelines[:1]) if len(batch.each.rates) > 1 else batch
                cases = cases._replace(drivelines=_THE_ONLY)
            rows, impacts = run(batch, cases, stop, room)
            full = (rows["status"][::lashes] == Status.EVENT_BUFFER_FULL) & (room < most)
            yield positions[: full.size][~full], rows[np.repeat(~full, lashes)], impacts
            again = np.flatnonzero(full)
            positions, cases, room = positions[again], cases.at(again), min(kernel.MORE * room, most)

    def _by_batches(
        self, values: Mapping[str, Floats], count: int
    ) -> Iterator[tuple[kernel.Batch, Cells, kernel.Cases]]:
        """Cut cells by the batches of their drivelines.

        values : of each parameter in `count` cells
        """
        cases = self.cases(values, count)
        points, point_of = np.zeros((1, 0)), np.zeros(count, np.int64)
        if self.structural:
            combinations = np.stack([values[parameter] for parameter in self.structural], axis=1)
            points, point_of = np.unique(combinations, axis=0, return_inverse=True)
        for batch, numbers in self.drivelines(points):
            of_cells = numbers[point_of.reshape(-1)]
            positions = np.flatnonzero(of_cells >= 0)
            used = of_cells[positions]
            if used.size:
                yield batch, positions, cases.at(positions)._replace(drivelines=used)

    def logged(self, values: Mapping[str, Floats], count: int) -> tuple[Records, Records]:
        """Run cells with these values of parameters and keep their events.

        Returns CELL (count, lashes), and EVENT (count, events), times NaN behind the last one.
        """
        stop, logs = np.zeros(1, np.uint8), []
        records = np.zeros((count, self.layout.lashes), CELL)
        for batch, positions, part in self._by_batches(values, count):
            for done, rows, (events,) in self._with_room(self._logged, batch, positions, part, stop):
                records[done] = rows.reshape(-1, self.layout.lashes)
                logs.append((done[records["status"][done, 0] == Status.OK], events))
        joined = np.zeros((count, max((events.shape[1] for _, events in logs), default=0)), EVENT)
        joined["time"] = np.nan
        for done, events in logs:
            joined[done, : events.shape[1]] = events
        return records, joined

    def _logged(self, batch: kernel.Batch, cases: kernel.Cases, stop: Flag, room: int) -> tuple[Records, list[Records]]:
        """Records of runs, and the events of those that have not failed, with times NaN behind the last one."""
        logs = np.zeros((len(cases.before), room + 1), EVENT)
        logs["time"] = np.nan
        rows, _ = self._run(batch, cases, stop, room, logs)
        logs = logs[rows["status"][:: self.layout.lashes] == Status.OK]
        return rows, [logs[:, : int((~np.isnan(logs["time"])).sum(axis=1).max(initial=0))]]

    def _measured(
        self, batch: kernel.Batch, cases: kernel.Cases, stop: Flag, room: int
    ) -> tuple[Records, list[Records]]:
        """Records and impacts of runs with measures, as the grid's layout has them."""
        runs, size, capacity = len(cases.before), batch.system.rates.shape[1], room + 1
        each = min(max(_STATES // capacity, 1), runs)
        logs, states = np.zeros((each, capacity), EVENT), np.empty((each, capacity, size))
        records, impacts = [np.zeros(0, self.layout.record)], [np.zeros(0, self.layout.detail)]
        for begin in range(0, runs, each):
            part = cases.at(slice(begin, begin + each))
            logs["time"] = np.nan
            rows, pieces = self._run(batch, part, stop, room, logs, states)
            cells, details = rows.reshape(-1, self.layout.lashes), np.concatenate([np.zeros(0, IMPACT), *pieces])
            totals = np.full((*cells.shape, OF_IMPACTS + len(self.study.measures)), np.nan)
            of_impacts = np.zeros((details.size, OF_IMPACTS))
            output = kernel.Output(cells, details, logs, states)
            measure_runs(batch, part, output, totals, of_impacts)
            names = self.study.impacts.quantities
            columns = [*(IMPACT_MEASURES.index(name) for name in names), *range(OF_IMPACTS, totals.shape[2])]
            records.append(_joined(rows, self.layout.record, totals[..., columns].reshape(rows.size, -1)))
            impacts.append(_joined(details, self.layout.detail, of_impacts[:, columns[: len(names)]]))
            if len(cells) < len(part.before):
                break
        return np.concatenate(records), impacts

    def _run(
        self,
        batch: kernel.Batch,
        cases: kernel.Cases,
        stop: Flag,
        room: int,
        logs: Records = _NO_LOGS,
        states: Floats = _NO_STATES,
    ) -> tuple[Records, list[Records]]:
        """CELL, one of each run and lash, of those that were done before `stop` was set; and IMPACT, in pieces.

        Runs whose impacts find no room are run again, so that the room for each is doubled then.

        room : for the events of each
        """
        solver, runs, lashes = self.study.solver, len(cases.before), self.layout.lashes
        most = min(room, solver.max_events)
        cells, done, impacts, each = np.zeros((runs, lashes), CELL), 0, [], _IMPACTS * lashes
        while done < runs and not stop[0]:
            found = np.zeros(each * (runs - done) + most, IMPACT)
            output = kernel.Output(cells, found, logs, states)
            done, written = kernel.run_tile(batch, solver.margin_tolerance, cases, done, most, output, stop)
            impacts.append(found[:written].copy())
            each *= 2
        return cells[:done].ravel(), impacts


def layout_of(study: Study) -> Layout:
    """Layout of the tiles of a study: what is measured follows what every run has."""
    names = study.impacts.quantities
    measures = [(name, "f8") for name in (*names, *(each.name for each in study.measures))]
    return Layout(_with(CELL, measures), _with(IMPACT, measures[: len(names)]), "primary_impacts", len(study.lashes))


def _with(record: np.dtype[np.void], fields: list[tuple[str, str]]) -> np.dtype[np.void]:
    """A type of records with further fields."""
    return np.dtype([*((name, record[name]) for name in record.names or ()), *fields], align=True) if fields else record


def _joined(records: Records, layout: np.dtype[np.void], columns: Floats) -> Records:
    """Records of a type with further fields, whose values are columns."""
    joined = np.zeros(records.size, layout)
    known = records.dtype.names or ()
    for name in known:
        joined[name] = records[name]
    for name, column in zip((layout.names or ())[len(known) :], columns.T, strict=True):
        joined[name] = column
    return joined


def compiling_note(*studies: Study) -> str:
    """Sentence on the time that the kernels of these studies take to compile; empty where that has been done."""
    cold = {}
    for study in studies:
        method = study.solver.method
        if is_cold(method):
            cold[method] = _COMPILING[method]
    if not cold:
        return ""
    return f"compiling {' and '.join(cold)}, once for this installation (about {sum(cold.values())} s) …"


def warm_up(study: Study) -> None:
    """Compile the kernels of a study, or load them, before a sweep rather than in the middle of it."""
    Grid(study.model_copy(update={"sweep": None})).run_at(np.arange(1), {}, np.zeros(1, np.uint8))
