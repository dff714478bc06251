"""Regime maps: the reductions of one run of each cell to Results; whole, or with failed cells run again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from clunk.results.labels import FAILED_CODE
from clunk.results.quantities import REGIME_QUANTITIES, measured_quantities
from clunk.results.regimemap import Results
from clunk.study.arrays import Array, Cells
from clunk.study.config import study_from_text
from clunk.study.designs import Design
from clunk.study.errors import ClunkError
from clunk.study.study import Study, digest
from clunk.sweeping.cells import Grid
from clunk.sweeping.reduction import Reduction
from clunk.sweeping.tiles import Layout, Tile


class RegimeReduction(Reduction):
    """The arrays of Results.

    study : Study
    design : Design, by default that of the study's sweep
    grid : runs the cells, where there is one already
    heading : as of `Reduction`
    """

    def __init__(
        self,
        study: Study,
        design: Design | None = None,
        grid: Grid | None = None,
        heading: dict[str, str] | None = None,
    ) -> None:
        grid = grid or Grid(study, design)
        super().__init__(study, design or grid.design, grid, heading)
        self._codes: npt.NDArray[np.int32] = np.zeros(self.rows, np.int32)
        measured = measured_quantities(study.impacts.quantities, [dict(each) for each in study.measures])
        quantities = REGIME_QUANTITIES | measured
        self._of_impacts = {name: each for name, each in quantities.items() if each.dimension}
        self._fields: dict[str, Array] = {
            name: np.zeros(self.rows, each.dtype)
            for name, each in quantities.items()
            if not each.dimension and name != "sequence"
        }
        self._impacts: list[tuple[Cells, dict[str, Array]]] = []  # rows, and the impacts of each behind one another

    def fill(self, tile: Tile, rows: Cells) -> None:
        """See `Reduction.fill`."""
        self._codes[rows] = self.labels.codes_of(tile.records, [tile.details])
        for name, field in self._fields.items():
            field[rows] = tile.records[name]
        impacts = {
            name: np.ascontiguousarray(tile.details[name.removeprefix("impact_")], each.dtype)
            for name, each in self._of_impacts.items()
        }
        self._impacts.append((rows, impacts))

    def result(self, attributes: dict[str, str]) -> Results:
        """See `Reduction.result`."""
        assert self.known.all()
        labels, final = self.labels.ordered()
        arrays = {"sequence": final[self._codes], **self._fields}
        arrays = {name: values.reshape(self.shape) for name, values in arrays.items()}
        counts = self._fields["primary_impacts"]
        rows = np.concatenate([rows for rows, _ in self._impacts])
        begins = np.cumsum(counts) - counts  # of each row's impacts, among those of all
        count = counts[rows]
        places = np.repeat(begins[rows] - (np.cumsum(count) - count), count) + np.arange(count.sum())
        for name, quantity in self._of_impacts.items():
            arrays[name] = np.empty(places.size, quantity.dtype)
            arrays[name][places] = np.concatenate([impacts[name] for _, impacts in self._impacts])
        return Results(**self.heading(), labels=labels, arrays=arrays, attributes=attributes)


def failed_cells(results: Results) -> Cells:
    """Numbers of the cells that failed, in C order; all lashes of a cell fail together."""
    return np.flatnonzero(results.of_lash().sequence == FAILED_CODE)


def finished_cells(study: Study, results: Results, layout: Layout) -> Tile:
    """The cells of a study's finished sweep that have not failed, as they ran.

    Raises ClunkError where the results are of a study that differs in anything but [solver].
    """
    before = study_from_text(results.config, source="the results' config")
    if digest(before.model_copy(update={"solver": study.solver})) != digest(study):
        raise ClunkError("The failed cells of another config cannot be run again: only [solver] may differ.")
    is_finished = results.sequence.ravel() != FAILED_CODE
    records = np.zeros(results.sequence.size, layout.record)
    details = np.zeros(results.impact_flank.size, layout.detail)
    for name, quantity in results.quantities.items():
        if quantity.dimension:
            details[name.removeprefix("impact_")] = results.arrays[name]
        elif name != "sequence":
            records[name] = results.arrays[name].ravel()
    cells = np.flatnonzero(is_finished[:: layout.lashes])
    return Tile(cells, records[is_finished], details[np.repeat(is_finished, results.primary_impacts.ravel())])


def mended(earlier: Results, again: Results, study: Study) -> Results:
    """A finished sweep with its failed cells run again, of which the attribute `retried` tells; study : of these."""
    failed = failed_cells(earlier)
    solver = study_from_text(earlier.config).solver.model_dump()
    changes = [
        f"solver.{key} = {value} instead of {solver[key]}"
        for key, value in study.solver.model_dump().items()
        if value != solver[key]
    ]
    more = failed.size - 100
    cells = ", ".join(map(str, failed[:100])) + (f", … ({more} more)" if more > 0 else "")
    note = (
        f"{failed.size} failed cells run again with {', '.join(changes) or 'the same solver'}: "
        f"{failed_cells(again).size} failed again; cells {cells} in C order"
    )
    retried = "; ".join(text for text in (earlier.attributes.get("retried"), note) if text)
    attributes = {**again.attributes, "retried": retried}
    return replace(again, config=earlier.config, config_digest=earlier.config_digest, attributes=attributes)
