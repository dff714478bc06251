"""Reductions: maps of the finished tiles of a sweep, which do not depend on the order of the tiles.

A sweep is a design, the cells of which a runner runs to tiles, and a reduction that makes a map of the tiles. Regime
maps (`clunk.sweeping.assembly`) and tolerance maps (`clunk.sweeping.tolerances`) differ in these two and in no more.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from clunk.core.sequence import label
from clunk.results.labels import FAILED_CODE
from clunk.results.tolerancemap import AnyMap
from clunk.study.arrays import Bools, Cells
from clunk.study.axes import ResultAxis, lash_axis
from clunk.study.designs import Design
from clunk.study.errors import ClunkError
from clunk.study.study import Study, digest, to_toml
from clunk.sweeping.engines import Runner
from clunk.sweeping.tiles import Tile

SomeMap = TypeVar("SomeMap", bound=AnyMap, covariant=True)
Flanks = tuple[int, ...]  # of a run's primary impacts in order, +1 opposite, -1 initial


class SweepError(ClunkError):
    """A sweep that cannot start; its text is one sentence for the user."""


class Reduction(ABC, Generic[SomeMap]):
    """The arrays of a map, filled tile by tile.

    study, design : of the cells
    runner : makes the tiles
    heading : title and config of the map, where they are known already
    plan : which cells are run, for people
    rows : number of rows of all cells, one for each lash
    known : (cells,) bool, whether a cell has been added
    done : number of cells that have been added
    """

    plan = "every cell"

    def __init__(self, study: Study, design: Design, runner: Runner, heading: dict[str, str] | None = None) -> None:
        self.study, self.design, self.runner = study, design, runner
        self._heading = heading
        self.rows = design.cells * runner.layout.lashes
        self.known: Bools = np.zeros(design.cells, bool)
        self.done = 0
        self.sequences: dict[Flanks, int] = {}  # flanks -> code, in the order in which they were seen first

    def add(self, tile: Tile) -> None:
        """Add a tile's cells; those that are there already are passed over."""
        new, layout = ~self.known[as_index(tile.cells)], self.runner.layout
        if not new.all():
            rows = np.repeat(new, layout.lashes)
            tile = Tile(
                tile.cells[new], tile.records[rows], tile.details[np.repeat(rows, tile.records[layout.counted_by])]
            )
        self.fill(tile, as_index(layout.rows(tile.cells)))
        self.known[as_index(tile.cells)] = True
        self.done += tile.cells.size

    @abstractmethod
    def fill(self, tile: Tile, index: slice | Cells) -> None:
        """Put a tile of new cells into the arrays; `index` is where its rows are in these."""

    def first(self) -> Cells:
        """Cells to run, in ascending order: those that have not been added."""
        return np.flatnonzero(~self.known).astype(np.int64, copy=False)

    @abstractmethod
    def result(self, attributes: dict[str, str]) -> SomeMap:
        """The finished map, with these attributes and perhaps others."""

    def code(self, flanks: Flanks) -> int:
        """The code of a sequence of primary impacts; a new one where it has not been seen yet."""
        return self.sequences.setdefault(flanks, len(self.sequences))

    def final_codes(self) -> tuple[tuple[str, ...], npt.NDArray[np.int16]]:
        """The labels, and each code's number among them; the last is that of -1.

        They are sorted by (number of primaries, label), so that they do not depend on which cell finished first.
        """
        lengths = {label(flanks): len(flanks) for flanks in self.sequences}
        labels = tuple(sorted(lengths, key=lambda text: (lengths[text], text)))
        return labels, np.array([*(labels.index(label(flanks)) for flanks in self.sequences), FAILED_CODE], np.int16)

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


def as_index(cells: Cells) -> slice | Cells:
    """Cells as an index; where they follow one another, as a slice, which is quicker."""
    if cells.size and np.all(cells[1:] - cells[:-1] == 1):
        return slice(int(cells[0]), int(cells[-1]) + 1)
    return cells
