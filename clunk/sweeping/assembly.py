"""Regime maps: the reductions of one run of each cell to Results; whole, or with failed cells run again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.jit import compiled
from clunk.core.sequence import INITIAL, OPPOSITE
from clunk.core.status import Status
from clunk.results.labels import FAILED_CODE
from clunk.results.machine import available_cores
from clunk.results.quantities import REGIME_QUANTITIES, measured_quantities
from clunk.results.regimemap import Results
from clunk.study.arrays import Array, Cells, Records
from clunk.study.config import study_from_text
from clunk.study.designs import Design
from clunk.study.study import Study, digest
from clunk.sweeping.cells import Grid
from clunk.sweeping.reduction import Flanks, Reduction, SweepError
from clunk.sweeping.scratch import Scratch
from clunk.sweeping.signals import Threads
from clunk.sweeping.tiles import Tile

_SHORT = 1 << 12  # patterns below it, of up to eleven primaries, are looked up in a table
_MANY = 10_000  # rows: fewer are not worth a second thread
_UNSEEN = -2  # the code there of a pattern that has not turned up yet


class RegimeReduction(Reduction[Results]):
    """The arrays of Results.

    study : Study
    design : Design, by default that of the study's sweep
    scratch : maker of the arrays, by default in memory
    grid : runs the cells, where there is one already
    heading : as of `Reduction`
    """

    def __init__(
        self,
        study: Study,
        design: Design | None = None,
        scratch: Scratch | None = None,
        grid: Grid | None = None,
        heading: dict[str, str] | None = None,
    ) -> None:
        grid = grid or Grid(study, design)
        super().__init__(study, design or grid.design, grid, heading)
        self._scratch = scratch or Scratch()
        self._code_of = np.full(_SHORT + 1, _UNSEEN, np.int32)  # of a pattern; the last is of all longer ones
        self._code_of[0] = FAILED_CODE
        self.codes: npt.NDArray[np.int32] = self._scratch.empty(self.rows, np.int32)
        measured = measured_quantities(study.impacts.quantities, [dict(each) for each in study.measures])
        quantities = REGIME_QUANTITIES | measured
        self.of_cells = {name: each for name, each in quantities.items() if not each.dimension}
        self.of_impacts = {name: each for name, each in quantities.items() if each.dimension}
        self.fields = {
            name: self._scratch.empty(self.rows, each.dtype)
            for name, each in self.of_cells.items()
            if name != "sequence"
        }
        self._impacts: list[tuple[Cells, dict[str, npt.NDArray[np.generic]]]] = []

    def fill(self, tile: Tile, index: slice | Cells) -> None:
        """See `Reduction.fill`."""
        self.codes[index] = self._codes_of(tile)
        for name, field in self.fields.items():
            field[index] = tile.records[name]
        self.keep_impacts(
            self.runner.layout.rows(tile.cells),
            {
                name: np.ascontiguousarray(tile.details[name.removeprefix("impact_")], each.dtype)
                for name, each in self.of_impacts.items()
            },
        )

    def keep_impacts(self, rows: Cells, impacts: dict[str, npt.NDArray[np.generic]]) -> None:
        """Keep the impacts of some rows, in the order of the rows, until all are known."""
        kept = {name: self._scratch.keep(values) for name, values in impacts.items()}
        self._impacts.append((self._scratch.keep(rows), kept))

    def result(self, attributes: dict[str, str]) -> Results:
        """See `Reduction.result`."""
        assert self.known.all()
        labels, final = self.final_codes()
        counts = self.fields["primary_impacts"]
        first = np.zeros(counts.size + 1, np.int64)
        np.cumsum(counts, out=first[1:])

        def finished(name: str) -> Array:
            if name == "sequence":
                values = self._scratch.empty(self.codes.size, np.int16)
                return np.take(final, self.codes, out=values, mode="wrap")  # -1 is the last
            values = self._scratch.empty(int(first[-1]), self.of_impacts[name].dtype)
            for rows, impacts in self._impacts:
                _put(values, first, rows, impacts[name])
            return values

        made = self.for_each(finished, ("sequence", *self.of_impacts))
        fields = {**self.fields, "sequence": made.pop("sequence")}
        made |= {name: field.reshape(self.shape) for name, field in fields.items()}
        return Results(**self.heading(), labels=labels, arrays=made, attributes=attributes)

    def for_each(self, function: Callable[[str], Any], names: Sequence[str]) -> dict[str, Any]:
        """Call a function with each name, of many rows in several threads; returns its values by name."""
        if self.rows < _MANY:
            return {name: function(name) for name in names}
        with Threads(available_cores()) as pool:
            return dict(zip(names, pool.map(function, names), strict=True))

    def _codes_of(self, tile: Tile) -> npt.NDArray[np.int32]:
        """The codes of a tile's rows."""
        pattern = np.ascontiguousarray(tile.records["pattern"])
        codes: npt.NDArray[np.int32] = self._code_of[np.minimum(pattern, _SHORT)]
        unseen = np.flatnonzero(codes == _UNSEEN)
        if unseen.size:
            patterns, inverse = np.unique(pattern[unseen], return_inverse=True)
            new = np.array([self.code(flanks_of(each)) for each in patterns.tolist()], np.int32)
            codes[unseen] = new[inverse.reshape(-1)]
            short = patterns < _SHORT
            self._code_of[patterns[short]] = new[short]
        for k, flanks in long_sequences(tile.records, [tile.details]):
            codes[k] = self.code(flanks)
        return codes


class MendedReduction(RegimeReduction):
    """The arrays of finished Results of which the failed cells are run again, with another [solver].

    The other cells stay as they are, and so do the config and its digest; the attribute `retried` describes the runs.

    Raises SweepError where the study differs in anything but [solver].
    """

    plan = "the failed cells again"

    def __init__(self, study: Study, earlier: Results, scratch: Scratch | None = None) -> None:
        self._before = study_from_text(earlier.config, source="the results' config")
        if digest(self._before.model_copy(update={"solver": study.solver})) != digest(study):
            raise SweepError("The failed cells of another config cannot be run again: only [solver] may differ.")
        super().__init__(study, None, scratch)
        self._earlier = earlier
        sequence, first = earlier.sequence.ravel(), earlier.first_impact
        codes = np.full(len(earlier.labels) + 1, FAILED_CODE, np.int32)  # the last is of the failed, -1
        for code, cell in zip(*np.unique(sequence, return_index=True), strict=True):
            if code != FAILED_CODE:
                codes[code] = self.code(tuple(earlier.impact_flank[first[cell] : first[cell + 1]].tolist()))
        rows = np.flatnonzero(sequence != FAILED_CODE).astype(np.int64)
        self.codes[rows] = codes[sequence[rows]]
        for name, field in self.fields.items():
            field[rows] = earlier.values(name).ravel()[rows]
        not_failed = np.repeat(sequence != FAILED_CODE, np.diff(first))
        self.keep_impacts(rows, {name: earlier.values(name)[not_failed] for name in self.of_impacts})
        self.known[rows // self.runner.layout.lashes] = True
        self.done = int(self.known.sum())
        self._failed = self.first()

    def result(self, attributes: dict[str, str]) -> Results:
        """See `Reduction.result`."""
        mended, earlier = super().result(attributes), self._earlier
        more = self._failed.size - 100
        of_first = mended.sequence.reshape(self.design.cells, -1)[:, 0]  # all lashes of a cell fail
        failed_again = int(np.count_nonzero(of_first[self._failed] == FAILED_CODE))
        changes = [
            f"solver.{key} = {value} instead of {getattr(self._before.solver, key)}"
            for key, value in self.study.solver.model_dump().items()
            if value != getattr(self._before.solver, key)
        ]
        cells = ", ".join(map(str, self._failed[:100])) + (f", … ({more} more)" if more > 0 else "")
        note = (
            f"{self._failed.size} failed cells run again with {', '.join(changes) or 'the same solver'}: "
            f"{failed_again} failed again; cells {cells} in C order"
        )
        retried = "; ".join(text for text in (earlier.attributes.get("retried"), note) if text)
        return replace(
            mended,
            title=earlier.title,
            config=earlier.config,
            config_digest=earlier.config_digest,
            attributes={**attributes, "retried": retried},
        )


@compiled
def _put(values: Array, first: Cells, rows: Cells, impacts: Array) -> None:
    """Put the impacts of some rows into C order; `first` has the position of each row's first one."""
    done = 0
    for row in rows:
        for at in range(first[row], first[row + 1]):
            values[at] = impacts[done]
            done += 1


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
