"""The cells of a study's grid, and running some of them: the one place of a sweep that calls the kernel."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core import tile as kernel
from clunk.core.exact.flows import Flows
from clunk.core.jit import is_cold
from clunk.core.regimes import System
from clunk.core.rk4.propagator import Steps
from clunk.core.status import Status
from clunk.simulation import driveline
from clunk.simulation.load import load_step
from clunk.study.config import Study, replace_values
from clunk.study.designs import Design, design_of
from clunk.sweeping.tiles import Tile

FloatArray = npt.NDArray[np.float64]

CELL, IMPACT = kernel.CELL, kernel.IMPACT

_BACKLASH = "lash.backlash_deg"
_TORQUES = {"load.ratio", "load.static_torque", "load.initial_torque", "load.final_torque"}
DRIVING = {*_TORQUES, "load.step_time", _BACKLASH}  # of these a system stays the same
KEPT_SYSTEMS = 4096  # about 20 KB each
_TILE_CELLS = {"rk4": 512, "exact": 4096}  # 0.1 s of the report's driveline: progress is smooth, overhead small


class Grid:
    """The cells of a study: each one's system, torques and gap.

    design : of which cells; by default the study's
    shared : of another `Grid.shared`, so that it need not be prepared again
    """

    record, detail = CELL, IMPACT  # of its tiles
    runs = 1  # of each cell

    def __init__(
        self, study: Study, design: Design | None = None, shared: tuple[System, Steps | Flows] | None = None
    ) -> None:
        self.study = study
        self.design = design or design_of(study)
        self.structural = [column for column in self.design.columns if column.parameter not in DRIVING]
        self._dimensions = sorted({column.dimension for column in self.structural})
        self._kept: OrderedDict[tuple[float, ...], tuple[System, Steps | Flows]] = OrderedDict()
        if shared is not None:
            self._kept[()] = shared
        self._lock = threading.Lock()

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each dimension."""
        return self.design.shape

    @property
    def cells(self) -> int:
        """How many cells there are."""
        return self.design.cells

    @property
    def tile_cells(self) -> int:
        """How many cells a tile has at most."""
        return _TILE_CELLS[self.study.solver.method]

    def ordered(self, cells: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """These cells in the order in which they are best cut into tiles."""
        return cells

    def complaint(self) -> str | None:
        """Why no cell at all can run, where that is known beforehand."""
        shared = self.shared()
        status = Status.OK if shared is None else Status(shared[0].status)
        return None if status == Status.OK else status.sentence

    def shared(self) -> tuple[System, Steps | Flows] | None:
        """The system and tables that all cells share, if they do."""
        return None if self.structural else self.prepared({})

    def recipe(self) -> tuple[type[Grid], tuple[Any, ...]]:
        """What another process makes the same grid of: its type and what that is called with."""
        return type(self), (self.study, self.design, self.shared())

    def prepared(self, values: Mapping[str, float]) -> tuple[System, Steps | Flows]:
        """The system and its method's tables with these values of what is structural; kept for other tiles."""
        at = tuple(values.values())  # the keys are always the same, in the same order
        with self._lock:
            found = self._kept.get(at)
            if found is not None:
                self._kept.move_to_end(at)
                return found
        prepared = driveline.prepare(replace_values(self.study, values) if values else self.study)
        with self._lock:
            self._kept[at] = prepared
            if len(self._kept) > KEPT_SYSTEMS:
                self._kept.popitem(last=False)
        return prepared

    def drive(self, values: Mapping[str, FloatArray], count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Torques before and after [N m] and half gap [rad] of `count` cells with these values, each (count,)."""
        torques = {key.removeprefix("load."): values[key] for key in values if key in _TORQUES}
        before, after = (
            np.broadcast_to(side, count).astype(np.float64) for side in load_step(self.study.load, **torques)
        )
        gap = np.broadcast_to(values.get(_BACKLASH, self.study.lash.backlash_deg), count)
        return before, after, np.deg2rad(gap) / 2

    def groups(self, cells: npt.NDArray[np.int64]) -> Iterator[tuple[dict[str, float], npt.NDArray[np.intp]]]:
        """Those of these cells, by their index, that have one system, with the values that make it."""
        if not self.structural:
            yield {}, np.arange(cells.size)
            return
        positions = np.unravel_index(cells, self.shape)
        combinations = np.stack([positions[dimension] for dimension in self._dimensions], axis=1)
        unique, group_of = np.unique(combinations, axis=0, return_inverse=True)
        order = np.argsort(group_of.reshape(-1), kind="stable")
        ends = np.cumsum(np.bincount(group_of.reshape(-1), minlength=len(unique)))
        for at, end, begin in zip(unique, ends, [0, *ends[:-1]], strict=True):
            position = dict(zip(self._dimensions, at, strict=True))
            values = {own.parameter: float(own.values[position[own.dimension]]) for own in self.structural}
            yield values, order[begin:end]

    def run(self, cells: npt.NDArray[np.int64], stop: npt.NDArray[np.uint8]) -> Tile:
        """Run cells. Their results depend on nothing but their parameters.

        Parameters
        ----------
        cells : (n,) int64
            Numbers in C order of the grid.
        stop : (1,) uint8
            Set by another thread, it ends the work within a run; the tile then has the cells that are done.
        """
        before, after, half_gap = self.drive(self.design.at(cells), cells.size)
        impacts: list[npt.NDArray[np.void]] = [np.zeros(0, IMPACT)]
        buffer = self.impact_buffer(cells.size)
        if not self.structural:
            records, pieces = self.run_group({}, (before, after, half_gap), buffer, stop)
            whole = pieces[0] if len(pieces) == 1 else np.concatenate(impacts + pieces)
            return Tile(cells[: records.size], records, whole)
        records = np.zeros(cells.size, CELL)
        known = np.zeros(cells.size, bool)
        owners: list[npt.NDArray[np.int64]] = [np.zeros(0, np.int64)]
        for values, mine in self.groups(cells):
            if stop[0]:
                break
            own, pieces = self.run_group(values, (before[mine], after[mine], half_gap[mine]), buffer, stop)
            done = mine[: own.size]
            records[done], known[done] = own, True
            impacts += pieces
            owners.append(np.repeat(done, own["primary_impacts"]))
        in_order = np.argsort(np.concatenate(owners), kind="stable")
        return Tile(cells[known], records[known], np.concatenate(impacts)[in_order])

    def impact_buffer(self, runs: int) -> npt.NDArray[np.void]:
        """IMPACT, where the kernel puts the primary impacts of up to this many runs."""
        return np.zeros(8 * runs + self.study.solver.max_events, IMPACT)

    def run_group(
        self,
        values: Mapping[str, float],
        drive: tuple[FloatArray, FloatArray, FloatArray],
        buffer: npt.NDArray[np.void],
        stop: npt.NDArray[np.uint8],
    ) -> tuple[npt.NDArray[np.void], list[npt.NDArray[np.void]]]:
        """Runs of one system.

        Parameters
        ----------
        values
            What makes the system; see `prepared`.
        drive : torques before and after [N m] and half gap [rad], each (n,)
        buffer : (capacity,) IMPACT
            To work in.
        stop : (1,) uint8

        Returns
        -------
        records, impacts
            Of the runs that were done before `stop` was set: CELL, one each, and IMPACT, in pieces.
        """
        system, tables = self.prepared(values)
        solver = self.study.solver
        records, done = np.zeros(drive[0].size, CELL), 0
        impacts = []
        while done < records.size and not stop[0]:
            done, written = kernel.run_tile(
                system, tables, solver.margin_tolerance, *drive, done, solver.max_events, records, buffer, stop
            )
            impacts.append(buffer[:written].copy())
        return records[:done], impacts


def compiling_note(*methods: str) -> str:
    """What to tell whoever waits for these methods' kernels to be compiled; nothing where they are already."""
    cold = [method for method in dict.fromkeys(methods) if is_cold(method)]
    if not cold:
        return ""
    seconds = 20 * len(cold) + 20 * ("exact" in cold)
    return f"compiling {' and '.join(cold)}, once for this installation (about {seconds} s) …"


def warm_up(study: Study) -> None:
    """Compile the kernel, or load it: what a first call of it would otherwise do in the middle of a sweep."""
    nothing = np.zeros(0)
    system, tables = driveline.prepare(study)
    records, impacts, stop = np.zeros(0, CELL), np.zeros(0, IMPACT), np.zeros(1, np.uint8)
    kernel.run_tile(system, tables, 0.0, nothing, nothing, nothing, 0, 1, records, impacts, stop)
