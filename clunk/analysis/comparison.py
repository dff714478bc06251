"""Comparison of two regime maps of the same grid, cell by cell: labels that differ, and how far other quantities do.

`verify` compares the maps of one study by the methods `rk4` and `exact`, which share the model and nothing else. `rk4`
steps in time. `exact` follows the modes of each regime and is guarded: for this model it cannot skip an event, to
rounding; and it knows how near each run came to another label. So labels may differ only in cells that are flagged as
undecided or grazing; where they differ elsewhere, the step is too coarse.
"""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from clunk.core.status import QUALITY_GRAZING, QUALITY_UNDECIDED
from clunk.results.labels import FAILED_CODE
from clunk.results.maps import Results
from clunk.results.netcdf import content_digest
from clunk.results.quantities import REGIME_QUANTITIES
from clunk.results.store import dataset_of
from clunk.study.arrays import Bools, Positions
from clunk.study.axes import ResultAxes
from clunk.study.designs import with_cells
from clunk.study.document import leaves
from clunk.study.errors import ClunkError
from clunk.study.records import SENTENCE, Record, counted, percent, tells, told
from clunk.study.study import Study, takes_study
from clunk.sweeping.progress import ShowProgress
from clunk.sweeping.sweep import sweep

METHODS = ("rk4", "exact")
_SAME_AXIS = 1e-9  # of an axis's smallest step: the same values, computed in another way, differ by rounding
_ROUNDING = 1e-14  # of a value, the tolerance where it is more: steps between drawn values may be as small as rounding

Unlike = dict[str, dict[str, Any]]  # key -> its value in A and in B


class Transition(Record):
    """A label in A and another one in B, and the number of cells that have these two."""

    a: str = told("A")
    b: str = told("B")
    cells: int = told("cells")


class DifferingCell(Record):
    """A cell that has different labels in A and in B.

    index : position on each axis
    at : value of each parameter
    a, b : the labels
    flagged : whether the run is flagged as undecided or grazing in A or in B
    """

    index: tuple[int, ...]
    at: dict[str, float | str] = told("at")
    a: str = told("A")
    b: str = told("B")
    flagged: bool = told("flagged")


class Difference(Record):
    """The largest difference of a quantity, over the cells with equal labels.

    quantity : of `Results`
    unit : of the quantity and of the difference
    over_largest : the difference over B's largest value
    at : the cell that has the difference
    """

    quantity: str = told("quantity")
    difference: float = told("difference", form=".1e")
    unit: str = told("unit")
    over_largest: float = told("share", form=".1e")
    at: dict[str, float | str] = told("at")


class Comparison(Record, eq=False, repr=False):
    """Differences between two maps of the same grid, A and B.

    maps : A and B
    labels : those of both maps, A's first
    codes_a, codes_b : int, in the maps' shape: position of the cell's label in `labels`, or -1 where the cell failed
    differs : bool, in the maps' shape: whether a cell's labels differ
    flagged : bool, in the maps' shape: whether a run is undecided or grazing in A or in B
    identical : whether the files of the maps hold the same arrays, bit for bit
    configs_equal : whether the digests of the configs are equal, and so is everything that decides the results
    largest_differences : for each quantity that is defined somewhere
    config_differences : keys of the configs whose values differ, also the title; None where a config has no such key
    provenance_differences : versions and machines that differ, by name
    verdict : whether the labels are the same, in a sentence
    titles : of A and of B
    cells : number of cells that have a label in both maps; only these are compared
    differing, differing_elsewhere : number of these whose labels differ, and of those in which no run is flagged
    touches_equal : number of compared cells with as many touches in A as in B
    failed : number of cells without a label in A only, in B only, and in both
    same_regimes : whether the two agree in every cell: the same label, or failed in both; never if nothing was compared
    transitions : pairs of labels in the cells that have two, the most frequent first
    """

    maps: tuple[Results, Results]
    labels: tuple[str, ...]
    codes_a: Positions
    codes_b: Positions
    differs: Bools
    flagged: Bools
    identical: bool = told("identical bit for bit")
    configs_equal: bool = told("configs are the same")
    largest_differences: tuple[Difference, ...] = told(
        "largest differences in cells with equal labels, and share of B's largest"
    )
    config_differences: Unlike = told("configs")
    provenance_differences: Unlike = told("computed with or on other")
    verdict: str = told(SENTENCE)
    titles: dict[str, str] = told()
    cells: int = told("cells", key="cells_compared")
    differing: int = told("labels differ in", key="cells_differing")
    differing_elsewhere: int = told("of these, neither run is flagged in")
    touches_equal: int = told("numbers of touches are the same in")
    failed: dict[str, int] = told("failed, not compared")
    same_regimes: bool = told()
    transitions: tuple[Transition, ...] = told("labels that differ")

    @property
    @tells("cells with two labels")
    def differing_cells(self) -> list[DifferingCell]:
        """The cells whose labels differ, in the grid's order, those without a flag first."""
        a, cells = self.maps[0], []
        for index in map(tuple, np.argwhere(self.differs).tolist()):
            at = a.place(index)
            labels = self.labels[self.codes_a[index]], self.labels[self.codes_b[index]]
            cells.append(DifferingCell(index, at, *labels, bool(self.flagged[index])))
        return sorted(cells, key=lambda cell: cell.flagged)


def compare(a: Results, b: Results) -> Comparison:
    """Compare two maps of the same grid, by their labels' text: codes depend on what else is in a file.

    Raises
    ------
    ClunkError
        Where the axes are not the same, or one is no regime map.

    Examples
    --------
    >>> import clunk
    >>> maps = [clunk.sweep(clunk.load_study("configs/smoke.toml", [f"solver.step={h}"])) for h in (2e-4, 1e-4)]
    >>> clunk.compare(*maps).differing
    0
    """
    maps = a, b
    for each in maps:
        if not isinstance(each, Results):
            raise ClunkError(f"Two regime maps are compared; a {type(each).__name__} is none.")
    _require_same_axes(a.parameters, b.parameters)
    _require_same_axes(a.axes, b.axes)
    labels = tuple(dict.fromkeys((*a.labels, *b.labels)))
    # the code among all labels for each code of a map; the code of a failed cell, -1, takes the last entry
    among = (np.array([*map(labels.index, each.labels), FAILED_CODE], np.intp) for each in maps)
    codes_a, codes_b = (codes[each.sequence] for codes, each in zip(among, maps, strict=True))
    failed_a, failed_b = codes_a == FAILED_CODE, codes_b == FAILED_CODE
    compared = ~(failed_a | failed_b)
    differs = compared & (codes_a != codes_b)
    flagged = ((a.quality | b.quality) & (QUALITY_UNDECIDED | QUALITY_GRAZING)) != 0
    cells, differing, elsewhere = _count(compared), _count(differs), _count(differs & ~flagged)
    pairs = zip(codes_a[differs].tolist(), codes_b[differs].tolist(), strict=True)
    transitions = Counter(sorted(pairs)).most_common()  # equally frequent ones in the order of `labels`
    identical = content_digest(dataset_of(a)) == content_digest(dataset_of(b))
    return Comparison(
        maps=maps,
        labels=labels,
        codes_a=codes_a,
        codes_b=codes_b,
        differs=differs,
        flagged=flagged,
        identical=identical,
        configs_equal=a.config_digest == b.config_digest,
        largest_differences=() if identical else tuple(_largest_differences(a, b, compared & ~differs)),
        config_differences=_unlike(*(dict(leaves(each.tables)) for each in maps)),
        provenance_differences=_unlike(a.attributes | {"created": ""}, b.attributes | {"created": ""}),
        verdict=_verdict(cells, differing, elsewhere),
        titles={"a": a.title, "b": b.title},
        cells=cells,
        differing=differing,
        differing_elsewhere=elsewhere,
        touches_equal=_count(compared & (a.touches == b.touches)),
        failed={
            "a_only": _count(failed_a & ~failed_b),
            "b_only": _count(failed_b & ~failed_a),
            "both": _count(failed_a & failed_b),
        },
        same_regimes=cells > 0 and np.array_equal(codes_a, codes_b),
        transitions=tuple(Transition(labels[i], labels[j], count) for (i, j), count in transitions),
    )


def _count(cells: Bools) -> int:
    return int(np.count_nonzero(cells))


def _verdict(cells: int, differing: int, elsewhere: int) -> str:
    """Whether the labels are the same, in a sentence."""
    if not cells:
        return "No cell has a label in both maps."
    if not differing:
        return f"The labels are the same in {counted(cells, 'cell')}."
    differ = f"The labels of {differing:,} of {cells:,} cells differ ({percent(differing, cells)})"
    return f"{differ}, of {elsewhere:,} of them where no run is flagged as undecided or grazing."


@takes_study
def verify(study: Study, *, progress: ShowProgress = False, workers: int | None = None) -> Comparison:
    """Run a study by both methods, rk4 (A) and exact (B), whichever its config names, and compare the maps.

    Parameters
    ----------
    study : Study
        Without axes its single run is compared; with tolerances, the nominal runs.
    progress, workers
        As in `clunk.sweep`; the cells of each method are counted separately.

    Returns
    -------
    Comparison
        Where `differing_elsewhere` is not 0, the step is too coarse.

    Raises
    ------
    ClunkError
        Where no cell can run.

    Examples
    --------
    >>> import clunk
    >>> methods = clunk.verify(clunk.load_study("configs/smoke.toml"))
    >>> methods.cells, methods.differing
    (441, 0)
    """
    grid = with_cells(study)
    solvers = (study.solver.but(method=method) for method in METHODS)
    return compare(*(sweep(grid.but(solver=solver), workers=workers, progress=progress) for solver in solvers))


def _require_same_axes(a: ResultAxes, b: ResultAxes) -> None:
    swept = [
        ", ".join(f"{axis.parameter} ({axis.spread if axis.words else f'{len(axis)} values'})" for axis in axes)
        for axes in (a, b)
    ]
    if swept[0] != swept[1]:
        raise ClunkError(f"The maps cannot be compared: they sweep {swept[0]} in A and {swept[1]} in B.")
    for axis_a, axis_b in zip(a, b, strict=True):
        steps = np.diff(np.unique(axis_a.values))
        smallest = steps.min() if steps.size else abs(axis_a.values[0])
        tolerance = np.maximum(_SAME_AXIS * smallest, _ROUNDING * abs(axis_a.values))
        apart = abs(axis_a.values - axis_b.values) > tolerance
        if apart.any():
            k = apart.argmax()
            raise ClunkError(
                f"The maps cannot be compared: value {k + 1} of {axis_a.parameter} is {axis_a.values[k]:.10g} in A and "
                f"{axis_b.values[k]:.10g} in B."
            )


def _largest_differences(a: Results, b: Results, equal: Bools) -> Iterator[Difference]:
    """Largest difference of each quantity over the cells with equal labels: primary impacts correspond one to one."""
    for name in ("impact_time", "last_event_time", "severity", "impact_severity", "approach_velocity"):
        values = []
        for each in (a, b):
            counts = each.primary_impacts.ravel() if REGIME_QUANTITIES[name].dimension else 1
            compared = equal.ravel().repeat(counts)
            values.append(each.values(name).ravel()[compared])
        # the cell of each value; with equal labels both maps have as many values in it
        cells = np.arange(equal.size).repeat(counts)[compared]
        difference = abs(np.subtract(*values))
        if np.isnan(difference).all():
            continue
        k, largest = int(np.nanargmax(difference)), float(np.nanmax(abs(b.values(name))))
        yield Difference(
            quantity=name,
            difference=float(difference[k]),
            unit=REGIME_QUANTITIES[name].unit_symbol,
            over_largest=float(difference[k]) / largest if largest > 0.0 else 0.0,
            at=b.place(np.unravel_index(cells[k], b.shape)),
        )


def _unlike(a: dict[str, Any], b: dict[str, Any]) -> Unlike:
    """Keys whose values differ in two mappings, with both values."""
    return {key: {"a": a.get(key), "b": b.get(key)} for key in a | b if a.get(key) != b.get(key)}
