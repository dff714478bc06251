"""A tolerance map: the probability of each label in a cell, and the severity of its impacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from clunk.results.labels import FAILED, FAILED_CODE
from clunk.results.maps import Map, share
from clunk.results.quantities import CHATTER, NOMINAL, OF_RUNS, TEXT, TOLERANCE_QUANTITIES, YES_NO, Quantity
from clunk.results.regimemap import Results
from clunk.study.arrays import Array, Floats
from clunk.study.records import Rows, counted

QUANTILES = (0.05, 0.5, 0.95)
_QUANTILE_NAMES = [f"severity_{100 * level:g}" for level in QUANTILES]
CERTAIN = 0.95  # a cell whose most likely label is less probable lies in the band between regimes


class ToleranceMap(Map):
    """A map whose every cell was run for the same sample of the toleranced parameters.

    Its fields are those of `Map`. N is the size of the sample.

    probability : shape + (labels + 1,), share of each label in the N runs of a cell, and last of the failed ones;
        other probabilities are of the runs that did not fail
    sequence : shape, codes of the most likely labels; of equally likely ones the first in the labels' order
    nominal_sequence : shape, codes of the runs without tolerances
    severity_mean : shape, mean Q of the runs that did not fail  [rad/s²]; without impacts Q is 0. NaN where it is not
        defined
    severity_quantiles : shape + (3,), the `QUANTILES` of the same Q, linear between order statistics (type 7 of
        Hyndman and Fan, doi:10.2307/2684934)
    status : shape, how the first run that failed ended (see `clunk.core.status`), 0 where none did
    """

    probability: Floats
    sequence: npt.NDArray[np.int16]
    nominal_sequence: npt.NDArray[np.int16]
    severity_mean: Floats
    severity_quantiles: Floats
    status: npt.NDArray[np.uint8]

    @property
    def quantities(self) -> dict[str, Quantity]:
        """The quantities of a tolerance map, in the order of their file."""
        return TOLERANCE_QUANTITIES

    @cached_property
    def quantities_of_cells(self) -> dict[str, Quantity]:
        """The most likely label, probabilities of what holds for labels, and the severity's mean and quantiles."""
        of_labels = {
            name: each
            for name, each in OF_RUNS.items()
            if each.type in (TEXT, YES_NO) and name not in (CHATTER, NOMINAL)
        }
        quantile = replace(self.quantities["severity_quantiles"], dimension="")
        quantiles = {
            name: replace(quantile, name=name, words=f"{100 * level:g} % {quantile.words}")
            for name, level in zip(_QUANTILE_NAMES, QUANTILES, strict=True)
        }
        mean = replace(self.quantities["severity_mean"], name="severity")
        return {**of_labels, "severity": mean, **quantiles}

    def plot_label(self, quantity: Quantity) -> str:
        """The quantity's name beside an axis: what holds for labels has a probability."""
        return f"Probability that {quantity.words}" if quantity.type == YES_NO else quantity.plot_label

    def of_labels(self, numbers: Sequence[float]) -> Floats:
        """Mean over the runs of each cell that did not fail: of 1 and 0 a share; NaN where all failed."""
        return self._of_finished(self.runs[..., :FAILED_CODE] @ np.asarray(numbers, np.float64))

    def _of_finished(self, runs: npt.NDArray[np.int32] | Floats) -> Floats:
        """Numbers of runs as shares of those of their cells that did not fail."""
        finished = self.draws - self.runs[..., FAILED_CODE]
        shares: Floats = np.divide(runs, finished, out=np.full(self.shape, np.nan), where=finished > 0)
        return shares

    def numbers(self, name: str) -> Floats:
        """The severity's mean or one of its quantiles in each cell."""
        if name in _QUANTILE_NAMES:
            return np.ascontiguousarray(self.severity_quantiles[..., _QUANTILE_NAMES.index(name)])
        return self.severity_mean

    @property
    def entries(self) -> dict[str, Array]:
        """The labels and ``failed``, the quantiles, and numbers of the draws."""
        draws = np.arange(1, self.draws + 1, dtype=np.int32)
        return {"label": np.array([*self.labels, FAILED]), "quantile": np.array(QUANTILES), "draw": draws}

    @property
    def draws(self) -> int:
        """Size of the sample, N."""
        return len(self.sample[0].values)

    @cached_property
    def runs(self) -> npt.NDArray[np.int32]:
        """Of the N runs of a cell, those with each label, and last those that failed: shape + (labels + 1,)."""
        return np.rint(self.probability * self.draws).astype(np.int32)

    @property
    def certainty(self) -> Floats:
        """Probability of the most likely label among the runs that did not fail, shape; NaN where all failed."""
        return self._of_finished(self.runs[..., :FAILED_CODE].max(axis=-1, initial=0))

    @property
    def caveats(self) -> list[str]:
        """Phrases on what the probabilities do not tell: runs that failed, which they leave out."""
        cells = self.of_lash().runs[..., FAILED_CODE]  # all lashes of a run fail together
        if not cells.any():
            return []
        affected = counted(int(np.count_nonzero(cells)), "cell")
        return [
            f"failed: up to {cells.max() / self.draws:.2g} of the runs in {affected}; probabilities are of the others"
        ]

    @property
    def failed(self) -> int:
        """Number of runs that failed, of all cells."""
        return int(self.runs[..., FAILED_CODE].sum(dtype=np.int64))

    @property
    def uncertain(self) -> int:
        """Number of cells whose most likely label is less probable than `CERTAIN`."""
        return int(np.count_nonzero(self.certainty < CERTAIN))

    def shares(self) -> dict[str, float]:
        """Share of each label in all runs; last that of ``failed``."""
        total = self.runs.reshape(-1, self.runs.shape[-1]).sum(axis=0, dtype=np.int64)
        names = (*self.labels, FAILED)
        return {name: int(count) / int(total.sum()) for name, count in zip(names, total, strict=True)}

    def label_table(self) -> list[dict[str, str]]:
        """See `Map.label_table`: the cells in which it is the most likely one, and its share of all runs."""
        counts = self.counts()
        return [
            {"label": label, "cells where it is most likely": f"{counts[label]:,}", "share of all runs": f"{part:.4%}"}
            for label, part in self.shares().items()
            if part
        ]

    @property
    def facts(self) -> Rows:
        """See `Map.facts`: how many cells are uncertain, have moved, or have runs that failed."""
        cells = self.sequence.size
        moved = int(np.count_nonzero(self.sequence != self.nominal_sequence))
        rows = [
            ("uncertain", f"{share(self.uncertain, cells)}: no label has {CERTAIN:.0%} of the {self.draws:,} draws"),
            ("moved", f"{share(moved, cells)}: another most likely label than without tolerances"),
        ]
        affected = counted(int((self.runs[..., FAILED_CODE] > 0).sum()), "cell")
        failed = ("failed", f"{self.failed:,} of {cells * self.draws:,} runs, in {affected}")
        return [*rows, failed] if self.failed else rows


def most_likely(runs: npt.NDArray[np.int32]) -> npt.NDArray[np.int16]:
    """Codes of the labels with the most runs; of several, of the first; -1 where most failed."""
    code: npt.NDArray[np.int16] = np.argmax(runs, axis=-1).astype(np.int16)
    code[code == runs.shape[-1] - 1] = FAILED_CODE
    return code


AnyMap = Results | ToleranceMap
