"""What tolerances do to a map: how probable each label is in a cell, and how severe its impacts then are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from clunk.results.labels import double_sided
from clunk.results.results import FAILED, FAILED_CODE, OverAxes, check_axes, check_labels, count_labels, require, share
from clunk.study.axes import RUN, ResultAxis
from clunk.study.summaries import Rows, as_html, as_text, html_table

QUANTILES = (0.05, 0.5, 0.95)
CERTAIN = 0.95  # a cell whose most likely label is less probable lies in the band between regimes


@dataclass(frozen=True, eq=False)
class ToleranceMap(OverAxes):
    """Every cell of a grid, run for the same sample of the toleranced parameters.

    "Shape" is the axes' counts in order, N the size of the sample.

    title : str
    axes, coordinates : as those of `Results`
    labels : code -> label; the code -1 is a failed run
    sample : one `ResultAxis` for each toleranced parameter; its values are what was drawn, (N,): the parameter's
        values, factors on its nominal value or offsets from it
    runs : shape + (labels + 1,), int32: of the N runs of a cell, those with each label, and last those that failed
    nominal_sequence : shape, int16 codes of the runs without tolerances
    severity_mean : shape, mean Q of the runs that did not fail  [rad/s²]; without impacts Q is 0. NaN where it is not
        defined
    severity_quantiles : shape + (3,), the `QUANTILES` of the same Q, linear between order statistics (type 7 of
        Hyndman and Fan, doi:10.2307/2684934)
    status : shape, uint8, how the first run that failed ended (see `clunk.core.status`), 0 where none did
    config, config_digest, attributes : as those of `Results`

    Raises ValueError where an array's shape or dtype is not the one above, a code has no label, or a cell's runs are
    not N.
    """

    title: str
    axes: tuple[ResultAxis, ...]
    labels: tuple[str, ...]
    sample: tuple[ResultAxis, ...]
    runs: npt.NDArray[np.int32]
    nominal_sequence: npt.NDArray[np.int16]
    severity_mean: npt.NDArray[np.float64]
    severity_quantiles: npt.NDArray[np.float64]
    status: npt.NDArray[np.uint8]
    config: str
    config_digest: str
    attributes: dict[str, str]
    coordinates: tuple[ResultAxis, ...] = ()

    def __post_init__(self) -> None:
        check_axes(self.axes, self.coordinates)
        check_labels(self.labels, self.nominal_sequence)
        if not self.sample or len({len(each.values) for each in self.sample}) > 1:
            raise ValueError("the toleranced parameters need one sample")
        require("runs", self.runs, (*self.shape, len(self.labels) + 1), np.int32)
        require("nominal_sequence", self.nominal_sequence, self.shape, np.int16)
        require("severity_mean", self.severity_mean, self.shape, np.float64)
        require("severity_quantiles", self.severity_quantiles, (*self.shape, len(QUANTILES)), np.float64)
        require("status", self.status, self.shape, np.uint8)
        if self.runs.min() < 0 or (self.runs.sum(axis=-1) != self.draws).any():
            raise ValueError("the runs of a cell are not as many as the sample")

    def at(self, values: Mapping[str, float]) -> ToleranceMap:
        """The slice at some axes' values, the nearest of each; as `Results.at`."""
        part, along = self._part(values)
        names = ("runs", "nominal_sequence", "severity_mean", "severity_quantiles", "status")
        fields: dict[str, Any] = {name: np.ascontiguousarray(getattr(self, name)[part]) for name in names}
        return replace(self, **along, **fields)

    @property
    def draws(self) -> int:
        """The size of the sample, N."""
        return len(self.sample[0].values)

    @property
    def probability(self) -> npt.NDArray[np.float64]:
        """Shape + (labels + 1,): each label's share of a cell's runs, and last that of the failed ones."""
        return self.runs / self.draws

    @cached_property
    def sequence(self) -> npt.NDArray[np.int16]:
        """Shape, int16 codes of the most likely labels; of equally likely ones the first in the labels' order."""
        return most_likely(self.runs)

    @property
    def certainty(self) -> npt.NDArray[np.float64]:
        """Shape: the probability of the most likely label."""
        certainty: npt.NDArray[np.float64] = self.runs.max(axis=-1) / self.draws
        return certainty

    @property
    def double_sided(self) -> npt.NDArray[np.float64]:
        """Shape: the probability of a label with a double-sided impact."""
        crossing = [code for code, label in enumerate(self.labels) if double_sided(label)]
        probability: npt.NDArray[np.float64] = self.runs[..., crossing].sum(axis=-1) / self.draws
        return probability

    @property
    def failed(self) -> int:
        """How many of all runs failed."""
        return int(self.runs[..., FAILED_CODE].sum(dtype=np.int64))

    @property
    def uncertain(self) -> int:
        """In how many cells the most likely label is less probable than `CERTAIN`."""
        return int(np.count_nonzero(self.certainty < CERTAIN))

    def counts(self) -> dict[str, int]:
        """Number of cells in which each label is the most likely one; last of ``failed``."""
        return count_labels(self.labels, self.sequence)

    def shares(self) -> dict[str, float]:
        """Each label's share of all runs; last that of ``failed``."""
        total = self.runs.reshape(-1, self.runs.shape[-1]).sum(axis=0, dtype=np.int64)
        names = (*self.labels, FAILED)
        return {name: int(count) / int(total.sum()) for name, count in zip(names, total, strict=True)}

    def summary(self) -> Rows:
        """What was found, for people: (name, value) pairs."""
        rows = [(axis.parameter, axis.spread) for axis in self.axes]
        rows += [(axis.parameter, f"{axis.spread}, along {RUN}") for axis in self.coordinates]
        rows += [(each.parameter, f"drawn {each.spread}") for each in self.sample]
        rows.append((f"below {CERTAIN:.0%}", share(self.uncertain, self.sequence.size)))
        return rows

    def _label_rows(self) -> Rows:
        shares = self.shares().items()
        return [(label, f"{part:.4%} of all runs") for label, part in shares if part or label != FAILED]

    def __repr__(self) -> str:
        return as_text(f"clunk.ToleranceMap {self.title!r}", [*self.summary(), *self._label_rows()])

    def _repr_html_(self) -> str:
        return as_html(self.title, html_table(self.summary()), html_table(self._label_rows(), ("label", "probability")))


def most_likely(runs: npt.NDArray[np.int32]) -> npt.NDArray[np.int16]:
    """The codes of the labels with the most runs; of several, of the first; -1 where most failed."""
    code: npt.NDArray[np.int16] = np.argmax(runs, axis=-1).astype(np.int16)
    code[code == runs.shape[-1] - 1] = FAILED_CODE
    return code
