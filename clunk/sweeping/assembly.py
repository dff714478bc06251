"""Regime maps: the reductions of one run of each cell to Results; whole, refined, or with failed cells run again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.core.jit import compiled
from clunk.core.sequence import INITIAL, OPPOSITE
from clunk.core.status import QUALITY_GRAZING, QUALITY_UNDECIDED, Status
from clunk.results.labels import FAILED_CODE
from clunk.results.quantities import REGIME_QUANTITIES, measured_quantities
from clunk.results.regimemap import Results
from clunk.study.arrays import Array, Bools, Cells, Records
from clunk.study.config import study_from_text
from clunk.study.designs import Design
from clunk.study.study import Study, digest
from clunk.sweeping.cells import Grid, Systems
from clunk.sweeping.engines import available_cores
from clunk.sweeping.reduction import Flanks, Reduction, SweepError
from clunk.sweeping.refinement import DOUBTFUL, Refinement, coarse_spacing
from clunk.sweeping.scratch import Scratch
from clunk.sweeping.signals import Threads
from clunk.sweeping.tiles import Tile

_SHORT = 1 << 12  # patterns below it, of up to eleven primaries, are looked up in a table
_UNSEEN = -2  # the code there of a pattern that has not turned up yet


class RegimeReduction(Reduction[Results]):
    """The arrays of Results.

    study : Study
    design : Design, by default that of the study's sweep
    scratch : maker of the arrays, by default in memory
    systems : of this study, where some are known already
    """

    def __init__(
        self,
        study: Study,
        design: Design | None = None,
        scratch: Scratch | None = None,
        systems: Systems | None = None,
    ) -> None:
        grid = Grid(study, design, systems)
        super().__init__(study, grid.design, grid)
        self._scratch = scratch or Scratch()
        self._code_of = np.full(_SHORT + 1, _UNSEEN, np.int32)  # of a pattern; the last is of all longer ones
        self._code_of[0] = FAILED_CODE
        self.codes: npt.NDArray[np.int32] = self._scratch.empty(self.rows, np.int32)
        self.measured = measured_quantities(study.impacts.quantities, [dict(each) for each in study.measures])
        quantities = REGIME_QUANTITIES | self.measured
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
            if self.done < self.design.cells:
                self._fill_inferred(values, first)
            for rows, impacts in self._impacts:
                _put(values, first, rows, impacts[name])
            return values

        made = self.for_each(finished, ("sequence", *self.of_impacts))
        fields = {**self.fields, "sequence": made.pop("sequence")}
        made |= {name: field.reshape(self.shape) for name, field in fields.items()}
        measured = {name: made.pop(name) for name in self.measured}
        return Results(**self.heading(), labels=labels, **made, measured=measured, attributes=attributes)

    def for_each(self, function: Callable[[str], Any], names: Sequence[str]) -> dict[str, Any]:
        """Call a function with each name, in several threads; returns its values by name."""
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

    def _fill_inferred(self, values: Array, first: Cells) -> None:
        """Set the impacts' flanks of cells that have not been run by their regime, and other quantities to NaN."""
        if values.dtype.kind == "f":
            values.fill(np.nan)
            return
        of_sequence = np.zeros((len(self.sequences), max(map(len, self.sequences))), np.int8)
        for sequence, code in self.sequences.items():
            of_sequence[code, : len(sequence)] = sequence
        _write_flanks(self.codes, first, of_sequence, values)


class RefinedReduction(RegimeReduction):
    """The arrays of Results of which only a coarse grid is run and the cells that `Refinement` asks for.

    The remaining cells get label, flanks and initial flank of their neighbours, and no quantities: NaN, -1 touches.
    """

    may_grow = True

    def __init__(self, study: Study, design: Design | None = None, scratch: Scratch | None = None) -> None:
        super().__init__(study, design, scratch)
        self._spacing = coarse_spacing(self.design)
        self._refinement = Refinement(self.design.shape, self._spacing)
        self.plan = f"what --refine needs (from spacing {max(self._spacing, default=1)})"
        self._lashes = self.runner.layout.lashes
        self._regimes: dict[tuple[int, ...], int] = {}  # the lashes' regimes -> number from 1 of the cell's, of several

    def first(self) -> Cells:
        """See `Reduction.first`."""
        return self.next(np.flatnonzero(self.known).astype(np.int64, copy=False))

    def next(self, cells: Cells) -> Cells:
        """See `Reduction.next`."""
        rows = self.runner.layout.rows(cells)
        codes = self.codes[rows]
        of_lashes: npt.NDArray[np.int32] = 3 * codes + 2 + self.fields["initial_side"][rows]
        vague = (self.fields["quality"][rows] & (QUALITY_UNDECIDED | QUALITY_GRAZING)) != 0
        of_lashes[(codes == FAILED_CODE) | vague] = DOUBTFUL
        touches = self.fields["touches"][rows].reshape(-1, self._lashes).sum(axis=1, dtype=np.int32)
        return self._refinement.take(cells, self._of_cells(of_lashes.reshape(-1, self._lashes)), touches)

    def _of_cells(self, of_lashes: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
        """Regimes of cells, (n,), of which two are equal where those of all lashes, (n, lashes), are."""
        if self._lashes == 1:
            return of_lashes[:, 0]
        unique, inverse = np.unique(of_lashes, axis=0, return_inverse=True)
        numbers = [
            DOUBTFUL if DOUBTFUL in each else self._regimes.setdefault(each, len(self._regimes) + 1)
            for each in map(tuple, unique.tolist())
        ]
        return np.array(numbers, np.int32)[inverse.reshape(-1)]

    def result(self, attributes: dict[str, str]) -> Results:
        """See `Reduction.result`."""
        self._infer(self._refinement.regimes())
        steps = " x ".join(str(step) for step in self._spacing)
        note = (
            f"{self.done} of {self.design.cells} cells run, the others inferred from their neighbours; coarse grid "
            f"every {steps} cells: regimes that none of its cells shows, nor any line followed from them, are missed"
        )
        return super().result({**attributes, "refinement": note})

    def _infer(self, regimes: npt.NDArray[np.int32]) -> None:
        """Set label, initial flank and number of primaries of cells that have not been run by their regimes."""
        inferred = np.repeat(~self.known, self._lashes)
        if self._lashes > 1:
            regimes = np.array([[0] * self._lashes, *self._regimes], np.int32)[np.maximum(regimes, 0)].ravel()
        codes, sides = np.divmod(np.arange(3 * len(self.sequences)), 3)
        lengths = np.array([len(sequence) for sequence in self.sequences])
        of_regime = {"sequence": codes, "initial_side": sides - 1, "primary_impacts": lengths[codes]}

        def finish(name: str) -> None:
            values = self.codes if name == "sequence" else self.fields[name]
            value = self.of_cells[name].inferred
            if value is None:
                _fill(values, inferred, regimes, of_regime[name].astype(values.dtype))
            else:
                np.copyto(values, value, where=inferred, casting="unsafe")

        self.for_each(finish, list(self.of_cells))
        self.known[:] = True


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
        notes = {key: value for key, value in earlier.attributes.items() if key == "refinement"}
        notes["retried"] = "; ".join(text for text in (earlier.attributes.get("retried"), note) if text)
        return replace(
            mended,
            title=earlier.title,
            config=earlier.config,
            config_digest=earlier.config_digest,
            attributes={**attributes, **notes},
        )


@compiled
def _put(values: Array, first: Cells, rows: Cells, impacts: Array) -> None:
    """Put the impacts of some rows into C order; `first` has the position of each row's first one."""
    done = 0
    for row in rows:
        for at in range(first[row], first[row + 1]):
            values[at] = impacts[done]
            done += 1


@compiled
def _fill(
    values: Array,
    inferred: Bools,
    regimes: npt.NDArray[np.int32],
    of_regime: Array,
) -> None:
    """Set inferred cells to the value of their regime, which is a number from 1."""
    for cell, regime in enumerate(regimes):
        if inferred[cell]:
            values[cell] = of_regime[regime - 1]


@compiled
def _write_flanks(
    codes: npt.NDArray[np.int32], first: Cells, of_sequence: npt.NDArray[np.int8], flanks: npt.NDArray[np.int8]
) -> None:
    """Write the flanks of each cell's sequence, in the order of the cells; none of failed cells."""
    for cell, code in enumerate(codes):
        if code >= 0:
            begin = first[cell]
            for k in range(first[cell + 1] - begin):
                flanks[begin + k] = of_sequence[code, k]


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
