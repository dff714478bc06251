"""Regime maps: the reductions of one run of each cell to Results; whole, or with failed cells run again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from clunk.results.labels import FAILED_CODE, primary_impacts
from clunk.results.quantities import REGIME_QUANTITIES, measured_quantities
from clunk.results.regimemap import Results
from clunk.study.arrays import Array, Cells
from clunk.study.config import study_from_text
from clunk.study.designs import Column, Design, design_of
from clunk.study.errors import ClunkError
from clunk.study.study import Study, digest
from clunk.sweeping.cells import Grid
from clunk.sweeping.reduction import Reduction
from clunk.sweeping.tiles import Tile


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
        self._codes[rows] = self.sequences.codes_of(tile.records, [tile.details])
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
        labels, final = self.sequences.labels()
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


def design_of_failed(study: Study, results: Results) -> Design:
    """The failed cells of a study's finished sweep as a design of their own.

    Raises ClunkError where the results are of a study that differs in anything but [solver].
    """
    before = study_from_text(results.config, source="the results' config")
    if digest(before.model_copy(update={"solver": study.solver})) != digest(study):
        raise ClunkError("The failed cells of another config cannot be run again: only [solver] may differ.")
    failed = failed_cells(results)
    columns = design_of(study).at(failed).items()
    return Design((failed.size,), tuple(Column(key, 0, values) for key, values in columns), run=0)


def mended(earlier: Results, again: Results, study: Study) -> Results:
    """Results with the runs `again` in the place of the failed cells, of which the attribute `retried` tells.

    study : of these runs
    """
    failed, lashes = failed_cells(earlier), len(earlier.lash_names)
    rows = (failed[:, None] * lashes + np.arange(lashes)).ravel()
    labels = tuple(sorted({*earlier.labels, *again.labels}, key=lambda text: (primary_impacts(text), text)))
    is_kept = np.repeat(earlier.sequence.ravel() != FAILED_CODE, earlier.primary_impacts.ravel())
    owners = np.repeat(np.arange(earlier.sequence.size), earlier.primary_impacts.ravel())[is_kept]
    order = np.argsort(np.concatenate([owners, np.repeat(rows, again.primary_impacts.ravel())]), kind="stable")
    arrays = {}
    for name, quantity in earlier.quantities.items():
        before, after = earlier.arrays[name], again.arrays[name]
        if quantity.dimension:
            arrays[name] = np.concatenate([before[is_kept], after])[order]
            continue
        if name == "sequence":
            before, after = (
                np.array([*(labels.index(text) for text in results.labels), FAILED_CODE], np.int16)[results.sequence]
                for results in (earlier, again)
            )
        arrays[name] = before.copy()
        arrays[name].reshape(-1)[rows] = after.ravel()
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
    return replace(earlier, labels=labels, arrays=arrays, attributes=attributes, boundaries=None)
