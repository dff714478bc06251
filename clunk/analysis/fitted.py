"""Outcome of a fit: the best candidate, the ensemble, and what they say of parameters, labels and predictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from clunk.analysis.fitensemble import effective_size, weights_of
from clunk.analysis.fitpredictions import Prediction, left_out_groups, losses, predict_left_out, probabilities
from clunk.analysis.fitreasons import reason_of
from clunk.analysis.fitruns import axes_of, label_of, numbers_at, patterns_of
from clunk.analysis.measurements import Experiment
from clunk.study.arrays import Floats, Patterns, Records
from clunk.study.fits import Fit
from clunk.study.parameters import nominal_value
from clunk.study.study import Study
from clunk.study.summaries import as_text
from clunk.study.sweeps import Draw

INTERVAL = (0.05, 0.95)  # quantiles of the ensemble that bound a parameter
UNDETERMINED = 0.7  # standard deviation, of the prior's, from which on the data leave a combination undetermined


@dataclass(frozen=True, eq=False)
class Fewer:
    """A fit of the first parameters alone, the others being nominal.

    parameters : number of them
    met : most labels met by any of its draws
    predicted : number of labels predicted from the other measurements
    effective : effective size of its ensemble
    """

    parameters: int
    met: int
    predicted: int
    effective: float


@dataclass(frozen=True, eq=False)
class Fitted:
    """Outcome of a fit of d parameters to n measurements.

    study : Study, with its [fit]
    experiment : Experiment
    lash : name of the lash that was measured
    estimate : (d,) numbers of the best candidate: values, factors or offsets, as the priors draw
    estimate_matches, nominal_matches : (n,) MATCH, of the best candidate and of the config as it is
    coordinates : (N, d) of the ensemble's draws, in which the prior is standard normal
    matches : (N, n) MATCH, of the ensemble's draws
    log_density : (N,) of their proposals, over the prior
    best_distances : (n,) least distance of any candidate's label from the measured one; 0 where one has met it
    fewer : fits of fewer parameters
    axis : number of the measured column along which labels change most
    candidates : number that have been run
    failed : number of candidates of which some run failed
    """

    study: Study
    experiment: Experiment
    lash: str
    estimate: Floats
    estimate_matches: Records
    nominal_matches: Records
    coordinates: Floats
    matches: Records
    log_density: Floats
    best_distances: Floats
    fewer: tuple[Fewer, ...]
    axis: int
    candidates: int
    failed: int

    @property
    def fit(self) -> Fit:
        """The study's [fit]."""
        assert self.study.fit is not None
        return self.study.fit

    @property
    def priors(self) -> tuple[Draw, ...]:
        """The prior of each parameter."""
        return self.fit.parameters

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Dotted keys of the measured columns."""
        return axes_of(self.study, self.experiment)

    @cached_property
    def points(self) -> Floats:
        """(n, axes) measured values."""
        return np.array([each.values for each in self.experiment.measurements])

    @cached_property
    def wanted(self) -> Patterns:
        """(n,) patterns of the measured labels."""
        return patterns_of(self.experiment)

    @cached_property
    def weights(self) -> Floats:
        """(N,) weights of the draws."""
        return weights_of(losses(self.matches, self.wanted, self.fit), self.log_density)

    @cached_property
    def draws(self) -> Floats:
        """(N, d) numbers of the ensemble's draws."""
        return numbers_at(self.study, self.priors, self.coordinates)

    @property
    def effective(self) -> float:
        """Effective size of the ensemble."""
        return effective_size(self.weights)

    def hits(self, patterns: Patterns) -> int:
        """Number of measured labels that some patterns, (n,), meet."""
        return int(np.count_nonzero(patterns == self.wanted))

    @property
    def met(self) -> int:
        """Number of labels that the best candidate meets."""
        return self.hits(self.estimate_matches["pattern"])

    def intervals(self, shares: Sequence[float] = INTERVAL) -> Floats:
        """(d, shares) quantiles of each parameter in the ensemble."""
        return weighted_quantiles(self.draws, self.weights, shares)

    def prior_intervals(self, shares: Sequence[float] = INTERVAL) -> Floats:
        """(d, shares) quantiles of each prior."""
        nominal = [nominal_value(self.study, prior.parameter) for prior in self.priors]
        return np.array([prior.quantiles(shares, value) for prior, value in zip(self.priors, nominal, strict=True)])

    @cached_property
    def combinations(self) -> tuple[Floats, Floats]:
        """Spread, (d,), and direction, (d, d) by row, of the ensemble's principal axes, the widest first.

        Both are in the coordinates in which the prior is standard normal: a spread of 1 is the prior's.
        """
        offsets = self.coordinates - self.weights @ self.coordinates
        variances, directions = np.linalg.eigh((offsets * self.weights[:, None]).T @ offsets)
        return np.sqrt(np.maximum(variances[::-1], 0.0)), directions.T[::-1]

    @cached_property
    def probabilities(self) -> list[dict[str, float]]:
        """Probability of each label at each measured point, the largest first."""
        every = probabilities(self.matches["pattern"], self.weights)
        return [{label_of(pattern): share for pattern, share in each.items()} for each in every]

    @cached_property
    def predictions(self) -> list[Prediction]:
        """Labels predicted from other measurements, for each way to leave some out."""
        return [
            predict_left_out(self.matches, self.log_density, self.wanted, self.points, self.fit, groups, left_out)
            for left_out, groups in left_out_groups(self.points, self.axes).items()
        ]

    @cached_property
    def reasons(self) -> dict[int, str]:
        """Sentences on why the best candidate misses a label, by the measurement's number from 0."""
        return {
            k: reason_of(measurement.label, match, self.axes[self.axis])
            for k, (measurement, match) in enumerate(
                zip(self.experiment.measurements, self.estimate_matches, strict=True)
            )
            if match["pattern"] != self.wanted[k]
        }

    def __repr__(self) -> str:
        intervals = zip(self.priors, self.estimate, self.intervals(), strict=True)
        rows = [
            ("labels met", f"{self.met} of {len(self.points)}; predicted {self.hits(self.predictions[0].predicted)}"),
            ("ensemble", f"{len(self.weights):,} draws, effectively {self.effective:.0f}"),
            *((each.parameter, f"{each.draws} {n:.4g}, {low:.4g} to {high:.4g}") for each, n, (low, high) in intervals),
        ]
        return as_text(f"clunk.Fitted {self.study.title!r}", rows)

    def warnings(self) -> list[str]:
        """Sentences on what makes the fit doubtful."""
        sentences = []
        count, parameters = len(self.points), len(self.priors)
        if parameters > count:
            sentences.append(f"There are more parameters, {parameters}, than measurements, {count}.")
        if self.effective < self.fit.effective_draws:
            sentences.append(
                f"The ensemble is worth {self.effective:.0f} draws, not {self.fit.effective_draws}: its intervals are "
                "rough; raise fit.draws."
            )
        predicted = self.hits(self.predictions[0].predicted)
        best = max(self.fewer, key=lambda each: (each.predicted, -each.parameters), default=None)
        if best is not None and best.predicted >= predicted:
            first = "first parameter alone predicts" if best.parameters == 1 else f"first {best.parameters} predict"
            sentences.append(
                f"More parameters predict no better: all {parameters} predict {predicted} of {count} labels from the "
                f"other measurements, the {first} {best.predicted}."
            )
        for rule in ("majority", "nearest"):
            by_rule = self.hits(getattr(self.predictions[0], rule))
            if by_rule >= predicted:
                words = {"majority": "the most frequent label", "nearest": "the label of the nearest measurement"}[rule]
                sentences.append(f"The fit predicts {predicted} of {count} labels, and {words} predicts {by_rule}.")
        if self.failed:
            sentences.append(f"{self.failed:,} candidates failed at some operating points, which count as missed.")
        return sentences


def weighted_quantiles(values: Floats, weights: Floats, shares: Sequence[float]) -> Floats:
    """(d, shares) quantiles of the columns of values, (n, d), with weights, (n,)."""
    quantiles = np.empty((values.shape[1], len(shares)))
    for k, column in enumerate(values.T):
        order = np.argsort(column, kind="stable")
        middle = np.cumsum(weights[order]) - weights[order] / 2.0
        quantiles[k] = np.interp(shares, middle, column[order])
    return quantiles
