"""Distributions of a drawn parameter, and the seeded points at which they are read.

Points of a space-filling design in the unit cube go through each distribution's quantile function: the marginals are
exact, and the same seed gives the same sample.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

Kind = Literal["uniform", "normal", "lognormal", "triangular"]
Sampler = Literal["sobol", "latin-hypercube"]

# What each distribution is given by, and what may bound it besides.
NEEDS: dict[str, tuple[str, ...]] = {
    "uniform": ("low", "high"),
    "normal": ("mean", "std"),
    "lognormal": ("median", "sigma"),
    "triangular": ("low", "mode", "high"),
}
BOUNDS = ("low", "high")
NUMBERS = ("low", "mode", "high", "mean", "std", "median", "sigma")

_NEAREST_TO_EDGE = 2.0**-54  # a point at 0 or 1 itself would be an infinite normal value


@dataclass(frozen=True)
class Distribution:
    """One random number.

    kind : "uniform" from low to high; "normal" by mean and standard deviation; "lognormal" by its median and `sigma`,
        the standard deviation of the logarithm; "triangular" with its peak at `mode`
    low, high : bounds; a normal or lognormal number is drawn from what lies between them
    """

    kind: Kind
    low: float | None = None
    mode: float | None = None
    high: float | None = None
    mean: float | None = None
    std: float | None = None
    median: float | None = None
    sigma: float | None = None

    def ppf(self, probability: npt.ArrayLike) -> FloatArray:
        """The quantile function: the value below which a number lies with this probability."""
        frozen = self._frozen()
        u = np.clip(np.asarray(probability, np.float64), _NEAREST_TO_EDGE, 1.0 - 2.0 * _NEAREST_TO_EDGE)
        if self.kind in ("normal", "lognormal"):
            below = 0.0 if self.low is None else float(frozen.cdf(self.low))
            above = 0.0 if self.high is None else float(frozen.sf(self.high))
            u = below + u * (1.0 - below - above)
        values: FloatArray = np.asarray(frozen.ppf(u), np.float64)
        # the inverse of a distribution function is rounded: no value may leave the bounds for that
        return np.clip(values, self.low, self.high) if (self.low, self.high) != (None, None) else values

    def _frozen(self) -> Any:
        from scipy import stats  # most of a second: only where something is drawn

        if self.kind == "uniform":
            assert self.low is not None
            assert self.high is not None
            return stats.uniform(self.low, self.high - self.low)
        if self.kind == "normal":
            return stats.norm(self.mean, self.std)
        if self.kind == "lognormal":
            return stats.lognorm(self.sigma, scale=self.median)
        assert self.low is not None
        assert self.high is not None
        assert self.mode is not None
        span = self.high - self.low
        return stats.triang((self.mode - self.low) / span, self.low, span)


def unit_points(sampler: Sampler, count: int, dimensions: int, seed: int) -> FloatArray:
    """(count, dimensions) float64 in [0, 1): scrambled Sobol points, or a Latin hypercube, by this seed."""
    from scipy.stats import qmc

    generator = np.random.default_rng(seed)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "The balance properties of Sobol", UserWarning)  # of other counts than 2^m
        if sampler == "sobol":
            points = qmc.Sobol(dimensions, scramble=True, seed=generator).random(count)
        else:
            points = qmc.LatinHypercube(dimensions, seed=generator).random(count)
    return np.asarray(points, np.float64)
