"""The cells of a study's grid, and running some of them: the one place of a sweep that calls the kernel."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict

import numpy as np
import numpy.typing as npt

from clunk import driveline
from clunk.config import Study, replace_values
from clunk.core import tile as kernel
from clunk.core.flows import Flows
from clunk.core.regimes import System
from clunk.core.status import Status
from clunk.core.steps import Steps
from clunk.load import load_step
from clunk.tiles import Tile

FloatArray = npt.NDArray[np.float64]

CELL, IMPACT = kernel.CELL, kernel.IMPACT

# Parameters that only change what drives a system, not the system: these fly.
_DRIVING = {
    "load.ratio",
    "load.static_torque",
    "load.initial_torque",
    "load.final_torque",
    "load.step_time",
    "lash.backlash_deg",
}
_KEPT_SYSTEMS = 4096  # about 10 KB each


class Grid:
    """The cells of a study: each one's system, torques and gap.

    shared : of another `Grid.shared`, so that it need not be prepared again
    """

    def __init__(self, study: Study, shared: tuple[System, Steps | Flows] | None = None) -> None:
        assert study.sweep is not None
        self.study = study
        self.axes = study.sweep.axes
        self.shape = tuple(axis.count_of_values for axis in self.axes)
        self.cells = math.prod(self.shape)
        self.structural = [k for k, axis in enumerate(self.axes) if axis.parameter not in _DRIVING]
        self._kept: OrderedDict[tuple[int, ...], tuple[System, Steps | Flows]] = OrderedDict()
        if shared is not None:
            self._kept[()] = shared
        self._lock = threading.Lock()

    def complaint(self) -> str | None:
        """Why no cell at all can run, where that is known beforehand."""
        if self.structural:
            return None
        status = Status(self.prepared(())[0].status)
        return None if status == Status.OK else status.sentence

    def shared(self) -> tuple[System, Steps | Flows] | None:
        """The system and tables that all cells share, if they do."""
        return None if self.structural else self.prepared(())

    def prepared(self, at: tuple[int, ...]) -> tuple[System, Steps | Flows]:
        """The system and its method's tables at these positions on the structural axes; kept for other tiles."""
        with self._lock:
            found = self._kept.get(at)
            if found is not None:
                self._kept.move_to_end(at)
                return found
        values = {
            self.axes[axis].parameter: float(self.axes[axis].grid[position])
            for axis, position in zip(self.structural, at, strict=True)
        }
        prepared = driveline.prepare(replace_values(self.study, values) if values else self.study)
        with self._lock:
            self._kept[at] = prepared
            if len(self._kept) > _KEPT_SYSTEMS:
                self._kept.popitem(last=False)
        return prepared

    def drive(self, positions: tuple[npt.NDArray[np.intp], ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Torques before and after [N m] and half gap [rad] of the cells at these positions, each (cells,)."""
        swept: dict[str, FloatArray] = {
            axis.parameter: axis.grid[position] for axis, position in zip(self.axes, positions, strict=True)
        }
        torques = {key.removeprefix("load."): value for key, value in swept.items() if key.startswith("load.")}
        shape = positions[0].shape
        before, after = (
            np.broadcast_to(side, shape).astype(np.float64) for side in load_step(self.study.load, **torques)
        )
        gap = np.broadcast_to(swept.get("lash.backlash_deg", self.study.lash.backlash_deg), shape)
        return before, after, np.deg2rad(gap) / 2

    def run(self, cells: npt.NDArray[np.int64], stop: npt.NDArray[np.uint8]) -> Tile:
        """Run cells. Their results depend on nothing but their parameters.

        Parameters
        ----------
        cells : (n,) int64
            Numbers in C order of the grid.
        stop : (1,) uint8
            Set by another thread, it ends the work within a run; the tile then has the cells that are done.
        """
        positions = np.unravel_index(cells, self.shape)
        before, after, half_gap = self.drive(positions)
        if self.structural:
            combinations = np.stack([positions[axis] for axis in self.structural], axis=1)
            unique, system_of = np.unique(combinations, axis=0, return_inverse=True)
        else:
            unique, system_of = np.zeros((1, 0), np.int64), np.zeros(cells.size, np.int64)
        solver = self.study.solver
        records = np.zeros(cells.size, CELL)
        known = np.zeros(cells.size, bool)
        impacts: list[npt.NDArray[np.void]] = [np.zeros(0, IMPACT)]
        owners: list[npt.NDArray[np.int64]] = [np.zeros(0, np.int64)]
        buffer = np.zeros(8 * cells.size + solver.max_events, IMPACT)
        for k, at in enumerate(unique):
            mine = np.flatnonzero(system_of.reshape(-1) == k)
            system, tables = self.prepared(tuple(int(position) for position in at))
            drive = before[mine], after[mine], half_gap[mine]
            own, done = np.zeros(mine.size, CELL), 0
            while done < mine.size and not stop[0]:
                begun = done
                done, written = kernel.run_tile(
                    system, tables, solver.margin_tolerance, *drive, done, solver.max_events, own, buffer, stop
                )
                impacts.append(buffer[:written].copy())
                owners.append(np.repeat(mine[begun:done], own["primary_impacts"][begun:done]))
            records[mine], known[mine[:done]] = own, True
        in_order = np.argsort(np.concatenate(owners), kind="stable")
        return Tile(cells[known], records[known], np.concatenate(impacts)[in_order])


def warm_up(study: Study) -> None:
    """Compile the kernel, or load it: what a first call of it would otherwise do in the middle of a sweep."""
    nothing = np.zeros(0)
    system, tables = driveline.prepare(study)
    records, impacts, stop = np.zeros(0, CELL), np.zeros(0, IMPACT), np.zeros(1, np.uint8)
    kernel.run_tile(system, tables, 0.0, nothing, nothing, nothing, 0, 1, records, impacts, stop)
