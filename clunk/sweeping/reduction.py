"""Finished tiles of a sweep, collected, and the map of them, which does not depend on the order of the tiles.

A sweep is a design, the cells of which a grid runs to tiles, and a map that is made of the tiles. Regime maps, here,
and tolerance maps (`clunk.sweeping.tolerances`) differ in the grid and in the map's arrays.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from functools import lru_cache
from typing import Any

import numpy as np

from clunk.core.sequence import INITIAL, OPPOSITE, label
from clunk.core.status import Status
from clunk.results.labels import FAILED, FAILED_CODE, label_order
from clunk.results.maps import Results, quantities_of_config
from clunk.study.arrays import Array, Cells, LabelCodes, Records, RecordType
from clunk.study.axes import lash_axis
from clunk.study.designs import Design
from clunk.study.errors import ClunkError
from clunk.study.study import Study, digest, to_toml
from clunk.sweeping.cells import Grid, Tile
from clunk.sweeping.engines import run_tiles
from clunk.sweeping.progress import Progress

Columns = Mapping[str, Array]  # fields of records, by name


def labels_of(records: Records | Columns, impacts: Records | Columns) -> tuple[tuple[str, ...], LabelCodes]:
    """Labels of runs in `label_order`, and each run's code among them, -1 where it failed.

    records : CELL
    impacts : IMPACT, of all runs behind one another
    """
    patterns = np.unique(records["pattern"])  # with its inverse it would sort them all
    # the bits of a pattern behind its leading 1 are flanks; it is 0 where they are too many, or the run failed
    words = [
        label([OPPOSITE if bit == "1" else INITIAL for bit in bin(pattern)[3:]]) if pattern else FAILED
        for pattern in patterns.tolist()
    ]
    word_of, ends = patterns.searchsorted(records["pattern"]), records["primary_impacts"].cumsum()
    for k in np.flatnonzero((records["pattern"] == 0) & (records["status"] == Status.OK)).tolist():
        word_of[k] = len(words)
        words.append(label(impacts["flank"][ends[k] - records["primary_impacts"][k] : ends[k]]))
    labels, codes = in_order(words)
    return labels, codes[word_of]


def in_order(words: Sequence[str]) -> tuple[tuple[str, ...], LabelCodes]:
    """Labels in `label_order`, and each word's number there, -1 of ``failed``.

    Raises ClunkError where they are more than a map holds.
    """
    labels, most = tuple(sorted(set(words) - {FAILED}, key=label_order)), np.iinfo(np.int16).max
    if len(labels) > most:
        raise ClunkError(
            f"The runs have {len(labels):,} labels, and a map can hold {most:,}: shorten solver.end_time, or run fewer "
            "cells."
        )
    numbers = {FAILED: FAILED_CODE} | {word: number for number, word in enumerate(labels)}
    return labels, np.array([numbers[word] for word in words], np.int16)


class Reduction:
    """The cells of a map, collected tile by tile.

    grid : runs the cells to tiles
    study, design : of the cells
    axes, shape : of the map: those of the design and, of several lashes, theirs
    rows : number of rows of all cells, one for each lash
    known : (cells,) bool, whether a cell has been added
    done : number of cells that have been added
    """

    def __init__(self, grid: Grid) -> None:
        self.grid, self.study, self.design = grid, grid.study, grid.design
        names, axes = self.study.lash_names, self.design.axes
        self.axes = (*axes, lash_axis(names)) if len(names) > 1 else axes
        self.shape = Design(self.axes).shape
        self.rows = self.design.cells * grid.layout.lashes
        self.known = np.zeros(self.design.cells, bool)
        self.done = 0
        self._records = _columns(self.rows, grid.layout.record)
        self._details: list[tuple[Cells, Records]] = []  # rows, and the details of these behind one another

    def add(self, tile: Tile) -> None:
        """Add a tile's cells, none of which is there already."""
        rows = self.grid.layout.rows(tile.cells)
        for name, column in self._records.items():
            column[rows] = tile.records[name]
        self._details.append((rows, tile.details))
        self.known[tile.cells] = True
        self.done += tile.cells.size

    def run(
        self,
        engine: Executor,
        progress: Progress,
        keep: Callable[[Tile], None] | None = None,
    ) -> None:
        """Run the cells that have not been added; of these, none that runs at an interrupt.

        engine : see `run_tiles`
        progress : called in this thread with the number of cells, first of those added before, then after each tile
        keep : called with each tile that has been added
        """
        with closing(run_tiles(self.grid, np.flatnonzero(~self.known), engine)) as tiles:
            progress(self.done, self.design.cells)
            for tile in tiles:
                self.add(tile)
                if keep is not None:
                    keep(tile)
                progress(self.done, self.design.cells)

    def collected(self) -> tuple[Columns, Columns]:
        """Records of all rows, and their details, those of each row behind those of the row before it."""
        assert self.known.all()
        counts = self._records[self.grid.layout.counted_by]
        ends = counts.cumsum(dtype=np.int64)
        columns = _columns(ends[-1], np.result_type(*{details.dtype for _, details in self._details}))
        for rows, details in self._details:
            of_rows = counts[rows]
            places = np.repeat(ends[rows] - of_rows.cumsum(), of_rows) + np.arange(details.size)
            for name, column in columns.items():
                column[places] = details[name]
        return self._records, columns


def _columns(size: int, record: RecordType) -> Columns:
    """An array of zeros for each field of a record: many records take half the time to make of these."""
    return {name: np.zeros(size, record[name]) for name in record.names or ()}


@lru_cache(4)
def heading_of(study: Study) -> dict[str, Any]:
    """Title and config of a study's maps; the latest are kept: to write a config takes as long as some fifty runs."""
    return {"title": study.title, "config": to_toml(study), "config_digest": digest(study)}


def regime_map(reduction: Reduction, attributes: dict[str, str]) -> Results:
    """The map of the tiles of a `Grid`, with these attributes."""
    records, impacts = reduction.collected()
    (labels, codes), heading = labels_of(records, impacts), heading_of(reduction.study)
    columns, arrays = {**records, "sequence": codes}, {}
    for name, quantity in quantities_of_config(heading["config"]).items():
        column = impacts[name.removeprefix("impact_")] if quantity.dimension else columns[name].reshape(reduction.shape)
        arrays[name] = column.astype(quantity.dtype, copy=False)
    return Results(axes=reduction.axes, **heading, labels=labels, arrays=arrays, attributes=attributes)
