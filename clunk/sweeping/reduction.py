"""The finished tiles of a sweep, collected into a map, which does not depend on the order of the tiles.

A grid runs the cells of a design, tile by tile; a reduction collects the tiles, of which a map is made. Regime maps,
made here, and tolerance maps (`clunk.sweeping.tolerances`) differ in the grid and in the map's arrays.
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
    impacts : IMPACT of all runs, in the order of their records
    """
    patterns = np.unique(records["pattern"])  # return_inverse would make it sort them all
    # the bits of a pattern behind its leading 1 are flanks; it is 0 where these are too many, or the run failed
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
    """Distinct labels among words, in `label_order`, and each word's index among them, -1 for ``failed``.

    Raises ClunkError where there are more labels than a map can hold.
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

    grid : Grid that runs the cells, tile by tile
    study, design : study and design of the grid
    axes, shape : of the map: those of the design and, behind them, the lashes if there are several
    rows : number of rows of all cells, one for each lash of a cell
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
        self._details: list[tuple[Cells, Records]] = []  # rows of a tile, and their details in this order

    def add(self, tile: Tile) -> None:
        """Add a tile's cells, none of which has been added before."""
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
        """Run and add the cells that have not been added yet; those that are running at an interrupt are lost.

        engine : see `run_tiles`
        progress : called in this thread with the numbers of added and of all cells, first at once, then after each tile
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
        """Records of all rows, and their details in the order of the rows; all cells must have been added."""
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
    """An array of zeros for each field of a record: to collect many records takes half the time in these."""
    return {name: np.zeros(size, record[name]) for name in record.names or ()}


@lru_cache(4)
def heading_of(study: Study) -> dict[str, Any]:
    """Title, config and digest for a study's maps, cached: to write a config takes as long as some fifty runs."""
    return {"title": study.title, "config": to_toml(study), "config_digest": digest(study)}


def regime_map(reduction: Reduction, attributes: dict[str, str]) -> Results:
    """The regime map of all cells of a `Grid`, with these attributes of its file."""
    records, impacts = reduction.collected()
    (labels, codes), heading = labels_of(records, impacts), heading_of(reduction.study)
    columns, arrays = {**records, "sequence": codes}, {}
    for name, quantity in quantities_of_config(heading["config"]).items():
        column = impacts[name.removeprefix("impact_")] if quantity.dimension else columns[name].reshape(reduction.shape)
        arrays[name] = column.astype(quantity.dtype, copy=False)
    return Results(axes=reduction.axes, **heading, labels=labels, arrays=arrays, attributes=attributes)
