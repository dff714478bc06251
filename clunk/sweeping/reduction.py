"""Reductions: maps of the finished tiles of a sweep, which do not depend on the order of the tiles.

A sweep is a design, the cells of which a runner runs to tiles, and a reduction that makes a map of the tiles. Regime
maps, here, and tolerance maps (`clunk.sweeping.tolerances`) differ in these two and in no more.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.sequence import INITIAL, OPPOSITE, label
from clunk.core.status import Status
from clunk.results.labels import FAILED_CODE, label_order
from clunk.results.quantities import REGIME_QUANTITIES, measured_quantities
from clunk.results.regimemap import Results
from clunk.results.tolerancemap import AnyMap
from clunk.study.arrays import Array, Bools, Cells, Records
from clunk.study.axes import ResultAxis, lash_axis
from clunk.study.config import study_from_text
from clunk.study.designs import Design
from clunk.study.errors import ClunkError
from clunk.study.study import Study, digest, to_toml
from clunk.sweeping.cells import Grid
from clunk.sweeping.engines import Runner
from clunk.sweeping.tiles import Layout, Tile

Flanks = tuple[int, ...]  # of a run's primary impacts in order, +1 opposite, -1 initial


def flanks_of(pattern: int) -> Flanks:
    """The flanks that the bits of a pattern stand for, behind its leading 1."""
    return tuple(OPPOSITE if bit == "1" else INITIAL for bit in bin(pattern)[3:])


def long_sequences(records: Records, impacts: Sequence[Records]) -> Iterator[tuple[int, Flanks]]:
    """Positions and flanks of the runs whose sequences are too long for a pattern; impacts : IMPACT, in pieces."""
    long = np.flatnonzero(records["pattern"] == 0)
    long = long[records["status"][long] == Status.OK]
    if long.size:
        flanks, ends = np.concatenate(impacts)["flank"], np.cumsum(records["primary_impacts"])
        for k in long.tolist():
            yield k, tuple(flanks[ends[k] - records["primary_impacts"][k] : ends[k]].tolist())


class Labels:
    """Labels of runs, each with a code: its number in the order in which they were seen first."""

    def __init__(self) -> None:
        self._codes: dict[str, int] = {}

    def code(self, text: str) -> int:
        """The code of a label; a new one where it has not been seen yet."""
        return self._codes.setdefault(text, len(self._codes))

    def codes_of(self, records: Records, impacts: Sequence[Records]) -> npt.NDArray[np.int32]:
        """The code of each run's label, -1 where it failed; records : CELL; impacts : IMPACT of them, in pieces."""
        patterns, inverse = np.unique(records["pattern"], return_inverse=True)
        of_patterns = [self.code(label(flanks_of(each))) if each else FAILED_CODE for each in patterns.tolist()]
        codes = np.array(of_patterns, np.int32)[inverse.reshape(-1)]
        for k, flanks in long_sequences(records, impacts):
            codes[k] = self.code(label(flanks))
        return codes

    def ordered(self) -> tuple[tuple[str, ...], npt.NDArray[np.int16]]:
        """The labels, and each code's number among them; the last is that of -1.

        They are in `label_order`, so that they do not depend on which cell finished first.
        """
        labels = tuple(sorted(self._codes, key=label_order))
        return labels, np.array([*map(labels.index, self._codes), FAILED_CODE], np.int16)


class Reduction(ABC):
    """The arrays of a map, filled tile by tile.

    study, design : of the cells
    runner : makes the tiles
    heading : title and config of the map, where they are known already
    rows : number of rows of all cells, one for each lash
    known : (cells,) bool, whether a cell has been added
    done : number of cells that have been added
    labels : of the runs
    """

    def __init__(self, study: Study, design: Design, runner: Runner, heading: dict[str, str] | None = None) -> None:
        self.study, self.design, self.runner = study, design, runner
        self._heading = heading
        self.rows = design.cells * runner.layout.lashes
        self.known: Bools = np.zeros(design.cells, bool)
        self.done = 0
        self.labels = Labels()

    def add(self, tile: Tile) -> None:
        """Add a tile's cells; those that are there already are passed over."""
        new, layout = ~self.known[tile.cells], self.runner.layout
        if not new.all():
            rows = np.repeat(new, layout.lashes)
            tile = Tile(
                tile.cells[new], tile.records[rows], tile.details[np.repeat(rows, tile.records[layout.counted_by])]
            )
        self.fill(tile, layout.rows(tile.cells))
        self.known[tile.cells] = True
        self.done += tile.cells.size

    @abstractmethod
    def fill(self, tile: Tile, rows: Cells) -> None:
        """Put a tile of new cells into the arrays; `rows` are its rows in these."""

    @abstractmethod
    def result(self, attributes: dict[str, str]) -> AnyMap:
        """The finished map, with these attributes."""

    @cached_property
    def axes(self) -> tuple[ResultAxis, ...]:
        """The axes of the map: those of the design and, of several lashes, theirs."""
        names = self.study.lash_names
        return (*self.design.axes, lash_axis(names)) if len(names) > 1 else self.design.axes

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """The shape of the map."""
        return tuple(len(axis.values) for axis in self.axes)

    def heading(self) -> dict[str, Any]:
        """Title, axes and config: the fields that all maps have in common."""
        heading = self._heading or heading_of(self.study)
        return {"axes": self.axes, "coordinates": self.design.coordinates, **heading}


def heading_of(study: Study) -> dict[str, str]:
    """Title and config of a study's maps."""
    return {"title": study.title, "config": to_toml(study), "config_digest": digest(study)}


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
