"""A tolerance map: the probability of each label in a cell, and the severity of its impacts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from clunk.results.labels import FAILED, FAILED_CODE, double_sided
from clunk.results.maps import Index, Map, require_array, require_codes, share
from clunk.results.quantities import TOLERANCE_QUANTITIES, Quantity
from clunk.results.regimemap import Results
from clunk.study.arrays import Array, Floats
from clunk.study.summaries import Rows

QUANTILES = (0.05, 0.5, 0.95)
CERTAIN = 0.95  # a cell whose most likely label is less probable lies in the band between regimes


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ToleranceMap(Map):
    """A map whose every cell was run for the same sample of the toleranced parameters.

    "Shape" is the axes' counts in order, N the size of the sample.

    title, axes, coordinates, labels, config, config_digest, attributes, sample : as those of `Map`
    runs : shape + (labels + 1,), int32: of the N runs of a cell, those with each label, and last those that failed
    nominal_sequence : shape, int16 codes of the runs without tolerances
    severity_mean : shape, mean Q of the runs that did not fail  [rad/s²]; without impacts Q is 0. NaN where it is not
        defined
    severity_quantiles : shape + (3,), the `QUANTILES` of the same Q, linear between order statistics (type 7 of
        Hyndman and Fan, doi:10.2307/2684934)
    status : shape, uint8, how the first run that failed ended (see `clunk.core.status`), 0 where none did

    Raises ValueError where an array's shape or dtype is not the one above, a code has no label, or a cell's runs are
    not N.
    """

    _measure: ClassVar[str] = "probability"

    runs: npt.NDArray[np.int32]
    nominal_sequence: npt.NDArray[np.int16]
    severity_mean: Floats
    severity_quantiles: Floats
    status: npt.NDArray[np.uint8]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.sample or len({len(each.values) for each in self.sample}) > 1:
            raise ValueError("the toleranced parameters need one sample")
        require_array("runs", self.runs, (*self.shape, len(self.labels) + 1), np.int32)
        for name in ("nominal_sequence", "severity_mean", "status"):
            require_array(name, getattr(self, name), self.shape, TOLERANCE_QUANTITIES[name].dtype)
        require_array("severity_quantiles", self.severity_quantiles, (*self.shape, len(QUANTILES)), np.float64)
        require_codes(self.labels, self.nominal_sequence)
        if self.runs.min() < 0 or (self.runs.sum(axis=-1) != self.draws).any():
            raise ValueError("the runs of a cell are not as many as the sample")

    def _arrays_at(self, index: Index) -> dict[str, Any]:
        names = ("runs", "nominal_sequence", "severity_mean", "severity_quantiles", "status")
        return {name: np.ascontiguousarray(getattr(self, name)[index]) for name in names}

    @property
    def quantities(self) -> dict[str, Quantity]:
        """The quantities of a tolerance map, in the order of their file."""
        return TOLERANCE_QUANTITIES

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
    def probability(self) -> Floats:
        """Share of each label in the runs of a cell, and last of the failed ones: shape + (labels + 1,)."""
        return self.runs / self.draws

    @cached_property
    def sequence(self) -> npt.NDArray[np.int16]:
        """Codes of the most likely labels, shape, int16; of equally likely ones the first in the labels' order."""
        return most_likely(self.runs)

    @property
    def certainty(self) -> Floats:
        """Probability of the most likely label, shape."""
        certainty: Floats = self.runs.max(axis=-1) / self.draws
        return certainty

    @property
    def double_sided(self) -> Floats:
        """Probability of a label with a double-sided impact, shape."""
        crossing = [code for code, label in enumerate(self.labels) if double_sided(label)]
        probability: Floats = self.runs[..., crossing].sum(axis=-1) / self.draws
        return probability

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

    def summary(self) -> Rows:
        """Pairs of a name and a value that describe the map, for people."""
        drawn = [(each.parameter, f"drawn {each.spread}") for each in self.sample]
        return [*super().summary(), *drawn, (f"below {CERTAIN:.0%}", share(self.uncertain, self.sequence.size))]

    def _label_rows(self) -> Rows:
        shares = self.shares().items()
        return [(label, f"{part:.4%} of all runs") for label, part in shares if part]


def most_likely(runs: npt.NDArray[np.int32]) -> npt.NDArray[np.int16]:
    """Codes of the labels with the most runs; of several, of the first; -1 where most failed."""
    code: npt.NDArray[np.int16] = np.argmax(runs, axis=-1).astype(np.int16)
    code[code == runs.shape[-1] - 1] = FAILED_CODE
    return code


AnyMap = Results | ToleranceMap
