"""A regime map: label, severity and outcome of every cell, and every primary impact."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.status import QUALITY_COMPLETE, QUALITY_MEANINGS, Status
from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.maps import Map, share, tables_of, values_at
from clunk.results.quantities import (
    LABEL,
    NOMINAL,
    OF_RUNS,
    REGIME_QUANTITIES,
    Quantity,
    measured_quantities,
    named_numbers,
)
from clunk.study.arrays import Array, Bools, Floats
from clunk.study.records import Rows, counted


class Results(Map):
    """A regime map: a label for each cell, its quantities and its primary impacts.

    Its fields are those of `Map`. Of its arrays, those that the config asks for besides are found by `values`.

    sequence : shape, codes into `labels`
    severity : shape, Q  [rad/s²], NaN where it is not defined
    approach_velocity : shape, V  [rad/s]
    last_event_time : shape  [s after the load step], NaN where nothing happened
    primary_impacts, touches : shape
    status, quality : shape; see `clunk.core.status`
    initial_side : shape, sign of θ_i - θ_j on the initial flank (0: none)
    margin : shape, dimensionless: how near the run came to another label, positive for what did not happen and negative
        for what did (see `clunk.core.exact.run`); NaN where the method knows none
    impact_time : (N,)  [s after the load step]; cells in C order, cell k owns `primary_impacts[k]` consecutive entries
    impact_flank : (N,), +1 opposite, -1 initial
    impact_closing_speed : (N,)  [rad/s]
    impact_severity : (N,) Q_i  [rad/s²]
    """

    sequence: npt.NDArray[np.int16]
    severity: Floats
    approach_velocity: Floats
    last_event_time: Floats
    primary_impacts: npt.NDArray[np.int32]
    touches: npt.NDArray[np.int32]
    status: npt.NDArray[np.uint8]
    quality: npt.NDArray[np.uint8]
    initial_side: npt.NDArray[np.int8]
    margin: Floats
    impact_time: Floats
    impact_flank: npt.NDArray[np.int8]
    impact_closing_speed: Floats
    impact_severity: Floats

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """The quantities of these results, in the order of their file."""
        return quantities_of_config(self.config)

    @cached_property
    def quantities_of_cells(self) -> dict[str, Quantity]:
        """The label, numbers, and what holds or not."""
        holding = {name: each for name, each in OF_RUNS.items() if name != NOMINAL}
        return {LABEL: OF_RUNS[LABEL]} | named_numbers(self.quantities) | holding

    def of_labels(self, numbers: Sequence[float]) -> Floats:
        """The number of the label of each cell; NaN where the run failed."""
        return np.array([*numbers, np.nan], np.float64)[self.sequence]  # the code of failed cells, -1, is the last

    def numbers(self, name: str) -> Floats:
        """A quantity of cells as float64, NaN where the run failed."""
        return np.where(self.sequence == FAILED_CODE, np.nan, self.values(name).astype(np.float64))

    @property
    def cut_off(self) -> Bools:
        """Cells whose run ended at ``solver.end_time`` before it was proved that nothing follows, shape."""
        return np.asarray((self.status == Status.OK) & (self.quality & QUALITY_COMPLETE == 0))

    @property
    def caveats(self) -> list[str]:
        """Phrases on what the labels do not tell: runs that were cut off."""
        run = self.of_lash()  # all lashes of a run end together
        count = int(np.count_nonzero(run.cut_off))
        cells = counted(run.sequence.size, "run")
        return [f"{count:,} of {cells} ended at solver.end_time with more to follow"] if count else []

    @property
    def entries(self) -> dict[str, Array]:
        """Numbers of the primary impacts."""
        return {"impact": np.arange(1, self.max_impacts + 1, dtype=np.int32)}

    @cached_property
    def max_impacts(self) -> int:
        """Length of the file's `impact` dimension: the most primary impacts of any cell, at least 1."""
        return max(1, int(self.primary_impacts.max()))

    @property
    def label_map(self) -> npt.NDArray[np.str_]:
        """Label of each cell, shape; ``failed`` where the run failed."""
        return np.array([*self.labels, FAILED])[self.sequence]  # the code -1 is the last

    def cell(self, values: Mapping[str, float]) -> dict[str, Any]:
        """Label, quantities and primary impacts of the cell nearest to these values, by name.

        Parameters
        ----------
        values : by parameter, for every axis, in its unit

        Returns
        -------
        dict
            The value of each parameter in this cell; its `label`; each quantity of a cell, by name; the names of its
            `status` and `quality` in the place of their codes; and each quantity of its primary impacts, in arrays.

        Raises
        ------
        ValueError
            Where an axis is not named, or something that is none; or a value lies beyond an axis.

        Examples
        --------
        >>> import clunk
        >>> results = clunk.sweep(clunk.load_study("configs/smoke.toml"))
        >>> cell = results.cell({"load.ratio": 5.0, "lash.backlash_deg": 6.0})
        >>> cell["label"], cell["touches"], cell["quality"]
        ('DS(1)SS(1)', 9, ['complete'])
        >>> cell["impact_time"].round(4)  # s after the load step
        array([0.1191, 0.2613, 0.565 ])
        """
        names = [axis.parameter for axis in self.axes]
        if set(values) != set(names):
            raise ValueError(f"A cell is named by {' and '.join(names)}, not by {', '.join(values) or 'nothing'}.")
        at = tuple(axis.nearest(values[axis.parameter]) for axis in self.axes)
        number = int(np.ravel_multi_index(at, self.shape))
        impacts = slice(*self.first_impact[number : number + 2])
        cell: dict[str, Any] = dict(zip(names, values_at(self.axes, at), strict=True))
        swept = values_at(self.axes, at, self.coordinates)
        cell |= {axis.parameter: value for axis, value in zip(self.parameters, swept, strict=True)}
        cell["label"] = [*self.labels, FAILED][self.sequence[at]]
        cell |= {name: self.values(name)[at].item() for name, each in self.quantities.items() if not each.dimension}
        cell["status"] = Status(cell["status"]).name.lower()
        cell["quality"] = [name for bit, name in QUALITY_MEANINGS.items() if cell["quality"] & bit]
        return cell | {name: self.values(name)[impacts] for name, each in self.quantities.items() if each.dimension}

    def label_table(self) -> list[dict[str, str]]:
        """See `Map.label_table`: the number of cells, and their share."""
        cells = self.sequence.size
        counts = self.counts().items()
        return [{"label": label, "cells": f"{n:,}", "share": f"{n / cells:.1%}"} for label, n in counts if n]

    @property
    def facts(self) -> Rows:
        """See `Map.facts`: the range of the severity, and how many cells have each quality."""
        rows = []
        if np.isfinite(self.severity).any():
            quantity = REGIME_QUANTITIES["severity"]
            spread = f"{np.nanmin(self.severity):.0f} to {np.nanmax(self.severity):.0f} {quantity.unit_symbol}"
            rows.append((quantity.heading, spread))
        counts = {name: int(np.count_nonzero(self.quality & bit)) for bit, name in QUALITY_MEANINGS.items()}
        rows += [(name, share(count, self.sequence.size)) for name, count in counts.items() if count]
        return rows if self.boundaries is None else [*rows, *self.boundaries.summary()]


def quantities_of_config(config: str) -> dict[str, Quantity]:
    """Quantities of the results of a resolved config: those that all runs have, and those that it asks for besides."""
    tables = tables_of(config)
    measured = measured_quantities(tables.get("impacts", {}).get("quantities", ()), tables.get("measures", ()))
    return REGIME_QUANTITIES | measured
