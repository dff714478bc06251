"""Cells of a sweep's design: their systems, torques and gaps, and their runs by the kernel."""

from __future__ import annotations

import contextlib
import re
import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core import tile as kernel
from clunk.core.channels import Channels
from clunk.core.events import EVENT
from clunk.core.exact import run as exact
from clunk.core.exact.flows import Flows
from clunk.core.measures import OF_IMPACTS, measure_runs
from clunk.core.regimes import System
from clunk.core.rk4 import run as rk4
from clunk.core.rk4.propagator import Steps
from clunk.core.switching import MOST_STAGES
from clunk.simulation import driveline
from clunk.simulation.batches import MOST, prepare_many
from clunk.simulation.load import loads_of
from clunk.simulation.measures import channels_of
from clunk.study.designs import Cells, Design, FloatArray, design_of
from clunk.study.document import dotted
from clunk.study.measures import OF_IMPACTS as IMPACT_MEASURES
from clunk.study.study import Study, replace_values
from clunk.sweeping.tiles import Layout, Tile

Records = npt.NDArray[np.void]
Flag = npt.NDArray[np.uint8]  # (1,); set by another thread, it ends the work within a run
Prepared = tuple[System, Steps | Flows]  # a system and its method's tables
Group = tuple[dict[str, float], npt.NDArray[np.intp]]  # structural values, and positions of cells that have them

CELL, IMPACT = kernel.CELL, kernel.IMPACT

_BACKLASH = re.compile(r"lash(\[\d+\])?\.backlash_deg")
_RATES = {"smooth": "load.duration", "lag": "load.time_constant", "sine": "load.frequency"}  # how fast a wave swings
KEPT_SYSTEMS = 4096  # about 30 KB each
_TILE_CELLS = {"rk4": 512, "exact": 4096}  # 0.1 s of the report's driveline: progress is smooth, overhead small
_COMPILING = {"rk4": (40, 50), "exact": (60, 80)}  # s, for one lash and nothing else, and in general
_KERNELS: dict[str, tuple[Any, Any]] = {"rk4": (kernel.by_rk4, rk4.run), "exact": (kernel.by_exact, exact.run)}
_OF_GENERAL = " for drivelines with stages, friction or several lashes"
_NO_LOGS, _NO_STATES = np.zeros((0, 0), EVENT), np.zeros((0, 0, 0))
_STATES = 1 << 16  # events whose states there is room for at a time: 8 MB, which the caches nearly hold
_TILE_POINTS = 2**19  # of tabulated loads: 20 MB where each cell has its own


def leaves_system(study: Study, parameter: str) -> bool:
    """Whether cells that differ in a parameter have the same system: only the load's pieces or the gap change."""
    is_load = parameter.startswith("load.") and parameter not in ("load.on", _RATES.get(study.load.profile))
    return is_load or _BACKLASH.fullmatch(parameter) is not None


class Systems:
    """The systems of a study and their tables, by values of structural parameters; the latest ones are kept.

    study : Study
    shared : those without other values than the study's, where they are known already
    """

    def __init__(self, study: Study, shared: Prepared | None = None) -> None:
        self._study = study
        self._kept: OrderedDict[tuple[tuple[str, float], ...], Prepared] = OrderedDict()
        if shared is not None:
            self._kept[()] = shared
        self._channels: Channels | None = None  # without other values
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._study, self._kept.get(()))

    def prepared(self, values: Mapping[str, float]) -> Prepared:
        """The system and tables with these values of structural parameters."""
        key = tuple(values.items())
        with self._lock:
            if (kept := self._kept.get(key)) is not None:
                self._kept.move_to_end(key)
                return kept
        prepared = driveline.prepare(replace_values(self._study, values) if values else self._study)
        with self._lock:
            self._kept[key] = prepared
            if len(self._kept) > KEPT_SYSTEMS:
                self._kept.popitem(last=False)
        return prepared

    def prepare(self, points: Sequence[Mapping[str, float]]) -> None:
        """Prepare the systems at some values of structural parameters together, for `prepared` to return them."""
        with self._lock:
            missing = {key: None for point in points if (key := tuple(point.items())) not in self._kept}
        if len(missing) < 2:
            return
        parameters = [parameter for parameter, _ in next(iter(missing))]
        values = np.array([[value for _, value in key] for key in missing])
        prepared = prepare_many(self._study, parameters, values)
        with self._lock:
            self._kept |= zip(missing, prepared, strict=True)
            while len(self._kept) > KEPT_SYSTEMS:
                self._kept.popitem(last=False)

    def channels(self, values: Mapping[str, float]) -> Channels:
        """The channels of the study's measures with these values of structural parameters."""
        with self._lock:
            if not values and self._channels is not None:
                return self._channels
        study = replace_values(self._study, values) if values else self._study
        channels = channels_of(study, self.prepared(values)[0])
        if not values:
            self._channels = channels
        return channels


class Grid:
    """The cells of a study's design, run once each.

    study : Study
    design : Design, by default that of the study's sweep
    systems : of this study, where some are known already
    """

    runs = 1  # of each cell

    def __init__(self, study: Study, design: Design | None = None, systems: Systems | None = None) -> None:
        self.study = study
        self.systems = systems or Systems(study)
        self.design = design or design_of(study)
        self.method: str = study.solver.method
        self.layout = layout_of(study)
        self.tile_cells = min(_TILE_CELLS[self.method], max(_TILE_POINTS // len(study.load.times or (0,)), 1))
        self._structural = [each.parameter for each in self.design.columns if not leaves_system(study, each.parameter)]

    def __reduce__(self) -> tuple[Any, ...]:  # the shared system goes along, so that all processes have its bits
        self.shared()
        return type(self), (self.study, self.design, self.systems)

    def ordered(self, cells: Cells) -> Cells:
        """Cells in the order in which they are best cut into tiles."""
        return cells

    def shared(self) -> Prepared | None:
        """The system and tables that all cells share, if they do."""
        return None if self._structural else self.systems.prepared({})

    def cases(self, values: Mapping[str, float | FloatArray], count: int) -> kernel.Cases:
        """Torques and gaps of `count` cells with these values of parameters."""
        swept = {key.removeprefix("load."): values[key] for key in values if key.startswith("load.")}
        before, pieces = loads_of(self.study.load, count, **swept)
        gaps = np.empty((count, len(self.study.lashes)))
        for k, (place, lash) in enumerate(zip(self.study.lash_places, self.study.lashes, strict=True)):
            gaps[:, k] = values.get(dotted((*place, "backlash_deg")), lash.backlash_deg)
        return kernel.cases_of(before, np.deg2rad(gaps) / 2, pieces)

    def groups(self, cells: Cells) -> Iterator[Group]:
        """Cut cells into groups of the same structural values; yields these values and the positions in `cells`."""
        if not self._structural:
            yield {}, np.arange(cells.size)
            return
        at = self.design.at(cells)
        combinations = np.stack([at[parameter] for parameter in self._structural], axis=1)
        unique, group_of = np.unique(combinations, axis=0, return_inverse=True)
        order = np.argsort(group_of.reshape(-1), kind="stable")
        ends = np.cumsum(np.bincount(group_of.reshape(-1), minlength=len(unique)))
        for values, end, begin in zip(unique.tolist(), ends, [0, *ends[:-1]], strict=True):
            yield dict(zip(self._structural, values, strict=True)), order[begin:end]

    def _prepared(self, groups: Sequence[Group]) -> Iterator[Group]:
        """Groups, whose systems are prepared many at a time."""
        for begin in range(0, len(groups), MOST):
            some = groups[begin : begin + MOST]
            self.systems.prepare([values for values, _ in some])
            yield from some

    def run(self, cells: Cells, stop: Flag) -> Tile:
        """Run cells; the tile has those that were done before `stop` was set."""
        cases = self.cases(self.design.at(cells), cells.size)
        buffer = self.impact_buffer(cells.size)
        run_group = self.measured_group if self.study.measured else self.run_group
        none = np.zeros(0, self.layout.detail)
        if not self._structural:
            records, pieces = run_group({}, cases, buffer, stop)
            return Tile(cells[: records.size // self.layout.lashes], records, np.concatenate([none, *pieces]))
        groups = list(self.groups(cells))
        every = np.concatenate([positions for _, positions in groups])
        cases, begin = cases.at(every), 0
        rows: list[Records] = [np.zeros(0, self.layout.record)]
        impacts: list[Records] = [none]
        done: list[npt.NDArray[np.intp]] = []
        for values, positions in self._prepared(groups):
            if stop[0]:
                break
            finished, pieces = run_group(values, _part(cases, begin, begin + positions.size), buffer, stop)
            begin += positions.size
            done.append(positions[: finished.size // self.layout.lashes])
            rows.append(finished)
            impacts += pieces
        # with the type, which numpy would otherwise find anew for each piece
        records = np.concatenate(rows, dtype=self.layout.record)
        details = np.concatenate(impacts, dtype=self.layout.detail)
        return self._in_order(cells, np.concatenate([every[:0], *done]), records, details)

    def _in_order(self, cells: Cells, positions: npt.NDArray[np.intp], records: Records, details: Records) -> Tile:
        """The tile of those cells that are at some positions, from their records and impacts in the order of these."""
        first, order = np.argsort(positions), np.empty_like(positions)
        order[first] = np.arange(positions.size)
        owners = np.repeat(self.layout.rows(order), records["primary_impacts"])
        in_order = np.argsort(owners, kind="stable")
        return Tile(cells[positions[first]], records[self.layout.rows(first)], details[in_order])

    def logged(self, cells: Cells) -> tuple[Records, Records]:
        """Run cells and keep their events: CELL (n, lashes), and EVENT (n, events), times NaN behind the last one."""
        cases, buffer = self.cases(self.design.at(cells), cells.size), self.impact_buffer(cells.size)
        records = np.zeros((cells.size, self.layout.lashes), CELL)
        logs = np.zeros((cells.size, self.study.solver.max_events + 1), EVENT)
        logs["time"] = np.nan
        for values, positions in self._prepared(list(self.groups(cells))):
            part, events = cases.at(positions), logs[positions]
            output = kernel.Output(self._cells(len(positions)), buffer, events, _NO_STATES)
            rows, _ = self._run(values, part, output, np.zeros(1, np.uint8))
            records[positions], logs[positions] = rows.reshape(len(positions), -1), events
        return records, logs[:, : int((~np.isnan(logs["time"])).sum(axis=1).max(initial=0))]

    def impact_buffer(self, runs: int) -> Records:
        """Room for the primary impacts of up to `runs` runs, IMPACT; see `run_group`."""
        return np.zeros(8 * runs + self.study.solver.max_events, IMPACT)

    def run_group(
        self, values: Mapping[str, float], cases: kernel.Cases, buffer: Records, stop: Flag
    ) -> tuple[Records, list[Records]]:
        """Records and impacts of runs of one system, lash by lash, of those that were done before `stop` was set.

        values : of the structural parameters
        cases : torques and gap of each run
        buffer : IMPACT, to work in; see `impact_buffer`

        Returns CELL, one of each run and lash, and IMPACT, in pieces.
        """
        output = kernel.Output(self._cells(len(cases.before)), buffer, _NO_LOGS, _NO_STATES)
        return self._run(values, cases, output, stop)

    def measured_group(
        self, values: Mapping[str, float], cases: kernel.Cases, buffer: Records, stop: Flag
    ) -> tuple[Records, list[Records]]:
        """`run_group` with the measures of the study: records and impacts as the grid's layout has them."""
        system, _ = self.systems.prepared(values)
        channels = self.systems.channels(values)
        has_stages = system.regimes.size > system.strides[len(system.lashes)]
        capacity = (self.study.solver.max_events + 1) * (MOST_STAGES if has_stages else 1)
        runs, size = len(cases.before), system.rates.shape[1]
        each = min(max(_STATES // capacity, 1), runs)
        logs, states = np.zeros((each, capacity), EVENT), np.empty((each, capacity, size))
        records, impacts = [np.zeros(0, self.layout.record)], [np.zeros(0, self.layout.detail)]
        for begin in range(0, runs, each):
            part = _part(cases, begin, begin + each)
            logs["time"] = np.nan
            output = kernel.Output(self._cells(len(part.before)), buffer, logs, states)
            rows, pieces = self._run(values, part, output, stop)
            cells, details = rows.reshape(-1, self.layout.lashes), np.concatenate([buffer[:0], *pieces])
            totals = np.full((*cells.shape, OF_IMPACTS + len(self.study.measures)), np.nan)
            of_impacts = np.full((details.size, OF_IMPACTS), np.nan)
            measure_runs(system, channels, part, cells, logs, states, totals, of_impacts)
            names = self.study.impacts.quantities
            columns = [*(IMPACT_MEASURES.index(name) for name in names), *range(OF_IMPACTS, totals.shape[2])]
            records.append(_joined(rows, self.layout.record, totals[..., columns].reshape(rows.size, -1)))
            impacts.append(_joined(details, self.layout.detail, of_impacts[:, columns[: len(names)]]))
            if len(cells) < len(part.before):
                break
        return np.concatenate(records), impacts

    def _run(
        self, values: Mapping[str, float], cases: kernel.Cases, output: kernel.Output, stop: Flag
    ) -> tuple[Records, list[Records]]:
        system, tables = self.systems.prepared(values)
        solver = self.study.solver
        done, impacts = 0, []
        while done < len(output.cells) and not stop[0]:
            done, written = kernel.run_tile(
                system, tables, solver.margin_tolerance, cases, done, solver.max_events, output, stop
            )
            impacts.append(output.impacts[:written].copy())
        return output.cells[:done].ravel(), impacts

    def _cells(self, runs: int) -> Records:
        return np.zeros((runs, self.layout.lashes), CELL)


def layout_of(study: Study) -> Layout:
    """Layout of the tiles of a study: what is measured follows what every run has."""
    names = study.impacts.quantities
    measures = [(name, "f8") for name in (*names, *(each.name for each in study.measures))]
    return Layout(_with(CELL, measures), _with(IMPACT, measures[: len(names)]), "primary_impacts", len(study.lashes))


def _part(cases: kernel.Cases, begin: int, end: int) -> kernel.Cases:
    """The cells from one position to before another."""
    loads = cases.loads if len(cases.loads) == 1 else cases.loads[begin:end]
    return kernel.Cases(cases.before[begin:end], loads)


def _with(record: np.dtype[np.void], fields: list[tuple[str, str]]) -> np.dtype[np.void]:
    """A type of records with further fields."""
    return np.dtype([*((name, record[name]) for name in record.names or ()), *fields], align=True) if fields else record


def _joined(records: Records, layout: np.dtype[np.void], columns: FloatArray) -> Records:
    """Records of a type with further fields, whose values are columns."""
    joined = np.zeros(records.size, layout)
    known = records.dtype.names or ()
    for name in known:
        joined[name] = records[name]
    for name, column in zip((layout.names or ())[len(known) :], columns.T, strict=True):
        joined[name] = column
    return joined


def compiling_note(*studies: Study, single: bool = False) -> str:
    """Sentence on the time that the kernels of these studies take to compile; empty where that has been done.

    single : whether for single runs, and not for sweeps
    """
    cold = {}
    for study in studies:
        (system, _), method = driveline.prepare(study), study.solver.method
        if not _is_compiled(_KERNELS[method][single], system):
            cold[method + _OF_GENERAL * len(system.general)] = _COMPILING[method][len(system.general)]
    if not cold:
        return ""
    return f"compiling {' and '.join(cold)}, once for this installation (about {sum(cold.values())} s) …"


def _is_compiled(dispatcher: Any, system: System) -> bool:
    """Whether a kernel is compiled for systems of such a type, in this process or on the disk."""
    signatures = [*dispatcher.overloads]
    with contextlib.suppress(Exception):  # whatever reading a damaged index raises: the kernel is compiled again then
        signatures += [signature for signature, *_ in dispatcher._cache._cache_file._load_index()]
    return any(signature[0] == dispatcher.typeof_pyval(system) for signature in signatures)


def warm_up(study: Study) -> None:
    """Compile the kernel of a study's method, or load it, before a sweep rather than in the middle of it."""
    system, tables = driveline.prepare(study)
    cases, output = (
        Grid(study).cases({}, 0),
        kernel.Output(np.zeros((0, 1), CELL), np.zeros(0, IMPACT), _NO_LOGS, _NO_STATES),
    )
    kernel.run_tile(system, tables, 0.0, cases, 0, 1, output, np.zeros(1, np.uint8))
