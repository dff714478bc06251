"""Tiles, in whatever order they come, put together to Results that do not depend on that order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.jit import compiled
from clunk.core.sequence import OPPOSITE, label
from clunk.core.status import QUALITY_GRAZING, QUALITY_UNDECIDED, Status
from clunk.results.labels import FAILED_CODE
from clunk.results.quantities import CELL_QUANTITIES, IMPACT_QUANTITIES
from clunk.results.regimemap import Results
from clunk.study.config import Study, digest, to_toml
from clunk.study.designs import Design, design_of
from clunk.sweeping.refinement import DOUBTFUL
from clunk.sweeping.scratch import Scratch
from clunk.sweeping.tiles import Tile

Cells = npt.NDArray[np.int64]

_SHORT = 1 << 12  # patterns below it, of up to eleven primaries, are looked up in a table
_UNSEEN = -2  # the code there of a pattern that has not turned up yet


class Assembly:
    """The results' arrays, filled tile by tile.

    scratch : where they are made; by default in memory
    design : of the cells; by default the study's
    threads : how many may make the finished arrays
    done : cells that are known
    """

    def __init__(
        self, study: Study, scratch: Scratch | None = None, design: Design | None = None, *, threads: int = 1
    ) -> None:
        self._study = study
        self._design = design or design_of(study)
        self.shape = self._design.shape
        cells = self._design.cells
        self.done = 0
        self._scratch = scratch or Scratch()
        self._threads = threads
        self._sequences: dict[tuple[int, ...], int] = {}  # the primaries' flanks -> code, in the order they turned up
        self._code_of = np.full(_SHORT + 1, _UNSEEN, np.int32)  # of a pattern; the last is of all longer ones
        self._code_of[0] = FAILED_CODE
        self._codes: npt.NDArray[np.int32] = self._scratch.empty(cells, np.int32)
        self._known = np.zeros(cells, bool)
        self._fields = {
            name: self._scratch.empty(cells, each.dtype) for name, each in CELL_QUANTITIES.items() if name != "sequence"
        }
        self._impacts: list[tuple[Cells, dict[str, npt.NDArray[np.generic]]]] = []

    def add(self, tile: Tile) -> None:
        """Take a tile's results; cells that are there already are passed over."""
        where = _where(tile.cells)
        new = ~self._known[where]
        if not new.all():
            owned = np.repeat(new, tile.records["primary_impacts"])
            tile = Tile(tile.cells[new], tile.records[new], tile.impacts[owned])
            where = _where(tile.cells)
        flanks = tile.impacts["flank"]
        self._codes[where] = self._codes_of(tile.records, flanks)
        for name, field in self._fields.items():
            field[where] = tile.records[name]
        columns = {
            name: np.ascontiguousarray(tile.impacts[name.removeprefix("impact_")], each.dtype)
            for name, each in IMPACT_QUANTITIES.items()
        }
        self._take(tile.cells, where, columns)

    def add_results(self, results: Results) -> None:
        """Take over all cells of finished results that have not failed."""
        sequence, first = results.sequence.ravel(), results.first_impact
        codes = np.full(len(results.labels) + 1, FAILED_CODE, np.int32)  # the last is of the failed, -1
        for code, cell in zip(*np.unique(sequence, return_index=True), strict=True):
            if code != FAILED_CODE:
                flanks = results.impact_flank[first[cell] : first[cell + 1]]
                codes[code] = self._code(tuple(int(flank) for flank in flanks))
        cells = np.flatnonzero(sequence != FAILED_CODE).astype(np.int64)
        self._codes[cells] = codes[sequence[cells]]
        for name, field in self._fields.items():
            field[cells] = getattr(results, name).ravel()[cells]
        owned = np.repeat(sequence != FAILED_CODE, np.diff(first))
        self._take(cells, cells, {name: getattr(results, name)[owned] for name in IMPACT_QUANTITIES})

    def known(self) -> Cells:
        """The cells that have been run, in ascending order."""
        return np.flatnonzero(self._known).astype(np.int64, copy=False)

    def missing(self) -> Cells:
        """The cells that have not been run, in ascending order."""
        return np.flatnonzero(~self._known).astype(np.int64, copy=False)

    def kinds(self, cells: Cells) -> npt.NDArray[np.int32]:
        """What refinement compares of cells that have been run: int32, alike where flanks and initial flank are."""
        codes = self._codes[cells]
        kinds: npt.NDArray[np.int32] = 3 * codes + 2 + self._fields["initial_side"][cells]
        vague = (self._fields["quality"][cells] & (QUALITY_UNDECIDED | QUALITY_GRAZING)) != 0
        kinds[(codes == FAILED_CODE) | vague] = DOUBTFUL
        return kinds

    def touches(self, cells: Cells) -> npt.NDArray[np.int32]:
        """The number of touches of cells that have been run."""
        touches: npt.NDArray[np.int32] = self._fields["touches"][cells]
        return touches

    def infer(self, kinds: npt.NDArray[np.int32]) -> None:
        """Give cells that have not been run what their kind tells: label, flanks, initial flank and no quantity.

        kinds : (cells,), as `kinds` has them
        """
        inferred = ~self._known
        codes, sides = np.divmod(np.arange(3 * len(self._sequences)), 3)
        lengths = np.array([len(sequence) for sequence in self._sequences])
        of_kind = {"sequence": codes, "initial_side": sides - 1, "primary_impacts": lengths[codes]}

        def finish(name: str) -> None:
            values = self._codes if name == "sequence" else self._fields[name]
            value = CELL_QUANTITIES[name].inferred
            if value is None:
                _fill(values, inferred, kinds, of_kind[name].astype(values.dtype))
            else:
                np.copyto(values, value, where=inferred, casting="unsafe")

        self._each(finish, list(CELL_QUANTITIES))
        self._known[:] = True

    def results(self, attributes: dict[str, str]) -> Results:
        """The finished map; every cell has been run or inferred.

        Codes are by (number of primaries, label), so that they do not depend on who finished first.
        """
        assert self._known.all()
        names = {label(flanks): len(flanks) for flanks in self._sequences}
        labels = tuple(sorted(names, key=lambda text: (names[text], text)))
        code = np.array([labels.index(label(flanks)) for flanks in self._sequences] + [FAILED_CODE], np.int16)
        counts = self._fields["primary_impacts"]
        first = np.zeros(counts.size + 1, np.int64)
        _add_up(counts, first)

        def finished(name: str) -> npt.NDArray[Any]:
            if name == "sequence":
                values = self._scratch.empty(self._codes.size, np.int16)
                return np.take(code, self._codes, out=values, mode="wrap")  # -1 is the last
            values = self._scratch.empty(int(first[-1]), IMPACT_QUANTITIES[name].dtype)
            if self.done < counts.size:
                self._fill_inferred(values, first)
            for cells, impacts in self._impacts:
                _put(values, first, cells, impacts[name])
            return values

        made = self._each(finished, ("sequence", *IMPACT_QUANTITIES))
        fields = {**self._fields, "sequence": made.pop("sequence")}
        return Results(
            title=self._study.title,
            axes=self._design.axes,
            coordinates=self._design.coordinates,
            labels=labels,
            **{name: field.reshape(self.shape) for name, field in fields.items()},
            **made,
            config=to_toml(self._study),
            config_digest=digest(self._study),
            attributes=attributes,
        )

    def _codes_of(self, records: npt.NDArray[np.void], flanks: npt.NDArray[np.int8]) -> npt.NDArray[np.int32]:
        """Each record's code; flanks : (N,), of all of their impacts."""
        own = np.ascontiguousarray(records["pattern"])
        codes: npt.NDArray[np.int32] = self._code_of[np.minimum(own, _SHORT)]
        others = np.flatnonzero(codes == _UNSEEN)
        if others.size:
            patterns, inverse = np.unique(own[others], return_inverse=True)
            found = np.array([self._code(_flanks(pattern)) for pattern in patterns.tolist()], np.int32)
            codes[others] = found[inverse.reshape(-1)]
            short = patterns < _SHORT
            self._code_of[patterns[short]] = found[short]
        # sequences too long for a pattern are told from their flanks
        long = np.flatnonzero((records["pattern"] == 0) & (records["status"] == Status.OK))
        if long.size:
            ends = np.cumsum(records["primary_impacts"])
            for k in long:
                own = flanks[ends[k] - records["primary_impacts"][k] : ends[k]]
                codes[k] = self._code(tuple(int(flank) for flank in own))
        return codes

    def _code(self, flanks: Sequence[int]) -> int:
        return self._sequences.setdefault(tuple(flanks), len(self._sequences))

    def _take(self, cells: Cells, where: slice | Cells, impacts: dict[str, npt.NDArray[np.generic]]) -> None:
        kept = {name: self._scratch.keep(values) for name, values in impacts.items()}
        self._impacts.append((self._scratch.keep(cells), kept))
        self._known[where] = True
        self.done += cells.size

    def _fill_inferred(self, values: npt.NDArray[Any], first: Cells) -> None:
        """What the impacts of cells that have not been run are: their regime's flanks, and no quantity."""
        if values.dtype.kind == "f":
            values.fill(np.nan)
            return
        of_sequence = np.zeros((len(self._sequences), max(map(len, self._sequences))), np.int8)
        for sequence, code in self._sequences.items():
            of_sequence[code, : len(sequence)] = sequence
        _write_flanks(self._codes, first, of_sequence, values)

    def _each(self, function: Callable[[str], Any], names: Sequence[str]) -> dict[str, Any]:
        """What a function gives for each name."""
        with ThreadPoolExecutor(self._threads) as pool:
            return dict(zip(names, pool.map(function, names), strict=True))


@compiled
def _add_up(counts: npt.NDArray[np.int32], first: Cells) -> None:
    """Put in `first`, after its 0, the sum of the counts up to and with each."""
    for cell, count in enumerate(counts):
        first[cell + 1] = first[cell] + count


@compiled
def _put(values: npt.NDArray[Any], first: Cells, cells: Cells, impacts: npt.NDArray[Any]) -> None:
    """Put these cells' impacts, one's behind the other's, where they are in C order."""
    done = 0
    for cell in cells:
        for at in range(first[cell], first[cell + 1]):
            values[at] = impacts[done]
            done += 1


@compiled
def _fill(
    values: npt.NDArray[Any], inferred: npt.NDArray[np.bool_], kinds: npt.NDArray[np.int32], of_kind: npt.NDArray[Any]
) -> None:
    """Give cells that were inferred what there is of their kind, from 1."""
    for cell, kind in enumerate(kinds):
        if inferred[cell]:
            values[cell] = of_kind[kind - 1]


@compiled
def _write_flanks(
    codes: npt.NDArray[np.int32], first: Cells, of_sequence: npt.NDArray[np.int8], flanks: npt.NDArray[np.int8]
) -> None:
    """Write each cell's flanks behind those of the cell before it; of failed cells none are written."""
    for cell, code in enumerate(codes):
        if code >= 0:
            begin = first[cell]
            for k in range(first[cell + 1] - begin):
                flanks[begin + k] = of_sequence[code, k]


def _where(cells: Cells) -> slice | Cells:
    """These cells as an index; where they follow one another, as a slice, which is quicker."""
    if cells.size and np.all(cells[1:] - cells[:-1] == 1):
        return slice(int(cells[0]), int(cells[-1]) + 1)
    return cells


def _flanks(pattern: int) -> tuple[int, ...]:
    """The flanks that a pattern's bits stand for, behind its leading 1."""
    return tuple(OPPOSITE if bit == "1" else -OPPOSITE for bit in bin(pattern)[3:])
