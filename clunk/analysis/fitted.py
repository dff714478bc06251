"""Outcome of a fit: the best candidate, the ensemble, and what they say of parameters, labels and predictions.

The ensemble's draws are weighted by their likelihood: of the measured labels as they are met, or of some of them, from
which the others are predicted. Why a label is missed is told by the two events that would have to change their order.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
from typing import Any

import numpy as np

from clunk.analysis.fitruns import axes_of, label_of, numbers_at, patterns_of
from clunk.analysis.measurements import Experiment
from clunk.core.sequence import INITIAL
from clunk.results.labels import flanks_of_label
from clunk.study.arrays import Bools, Floats, Patterns, Records
from clunk.study.fits import Fit
from clunk.study.parameters import nominal_value
from clunk.study.records import Record, tells, told
from clunk.study.study import Study
from clunk.study.sweeps import Draw
from clunk.sweeping.reduction import flanks_of

INTERVAL = (0.05, 0.95)  # quantiles of the ensemble that bound a parameter

_PRIOR_WEIGHT = 10.0  # measurements that the expected share of wrong labels is worth


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Record):
    """A parameter's number: a value, a factor or an offset.

    interval, prior_interval : 5 and 95 % quantiles, of the ensemble and of the prior
    prior : its distribution
    """

    parameter: str = told("parameter")
    draws: str = told("draws")
    estimate: float = told("estimate", form=".4g")
    interval: list[float] = told("5 to 95 %", form=".4g")
    prior_interval: list[float] = told("of the prior", form=".4g")
    prior: dict[str, Any] = told()


@dataclass(frozen=True, eq=False, repr=False)
class Combination(Record):
    """A combination of parameters, and how much of the prior's spread the data leave to it.

    direction : of each parameter, in standard deviations of its prior
    """

    spread: float = told("spread left", form=".0%")
    direction: list[float] = told("direction (in the priors' standard deviations)", form="+.2f")


@dataclass(frozen=True, eq=False, repr=False)
class Measured(Record):
    """A measured label, and what the fit makes of it.

    computed : by the best candidate
    probabilities : of labels, in the ensemble
    met_by_some : whether any draw of the ensemble meets it
    reason : sentences on why the best candidate misses it; empty where it does not
    """

    at: dict[str, float] = told("at")
    label: str = told("measured")
    computed: str = told("computed")
    probabilities: dict[str, float] = told()
    met_by_some: bool = told("met by some draw")
    reason: str = told("why")


@dataclass(frozen=True, eq=False)
class Prediction:
    """Labels predicted without the measurements themselves.

    left_out : at a time: measurement, or a measured parameter all of whose equal values were
    predicted : (points,) uint64 patterns
    majority, nearest : as the ensemble, by the most frequent label of the others, and by that of the nearest one
    effective : the least effective size of an ensemble that is left
    """

    left_out: str
    predicted: Patterns
    majority: Patterns
    nearest: Patterns
    effective: float


@dataclass(frozen=True, eq=False, repr=False)
class Fitted(Record):
    """Outcome of a fit of d parameters to n measurements.

    study : Study, with its [fit]
    experiment : Experiment
    lash : name of the lash that was measured
    estimate : (d,) numbers of the best candidate: values, factors or offsets, as the priors draw
    estimate_matches, nominal_matches : (n,) MATCH, of the best candidate and of the config as it is
    coordinates : (N, d) of the ensemble's draws, in which the prior is standard normal
    matches : (N, n) MATCH, of the ensemble's draws
    log_density : (N,) of their proposals, over the prior
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
    axis: int
    failed: int
    candidates: int = told("candidates")

    @property
    @tells()
    def title(self) -> str:
        """The study's title."""
        return self.study.title

    @property
    @tells("measurements")
    def measurements(self) -> str:
        """Name of the file of the measurements."""
        return self.experiment.name

    @property
    @tells("measured labels", key="points")
    def count(self) -> int:
        """Number of measurements."""
        return len(self.points)

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
    @tells("ensemble's draws", key="draws")
    def ensemble_size(self) -> int:
        """Number of the ensemble's draws."""
        return len(self.weights)

    @property
    @tells("which are worth", form=".0f", key="effective_draws")
    def effective(self) -> float:
        """Effective size of the ensemble."""
        return effective_size(self.weights)

    def hits(self, patterns: Patterns) -> int:
        """Number of measured labels that some patterns, (n,), meet."""
        return int(np.count_nonzero(patterns == self.wanted))

    @property
    @tells("met by the best candidate")
    def met(self) -> int:
        """Number of labels that the best candidate meets."""
        return self.hits(self.estimate_matches["pattern"])

    @property
    @tells("met by the config as it is")
    def met_by_config(self) -> int:
        """Number of labels that the config's own values meet."""
        return self.hits(self.nominal_matches["pattern"])

    @property
    @tells("most probable in the ensemble")
    def most_probable(self) -> int:
        """Number of measured labels that are the most probable ones of the ensemble."""
        pairs = zip(self.probabilities, self.experiment.measurements, strict=True)
        return sum(next(iter(shares)) == measurement.label for shares, measurement in pairs)

    @property
    @tells("parameters", key="parameters")
    def estimates(self) -> list[Estimate]:
        """Each parameter's estimate and intervals."""
        numbers = zip(self.priors, self.estimate, self.intervals(), self.prior_intervals(), strict=True)
        return [
            Estimate(prior.parameter, prior.draws, float(number), within.tolist(), before.tolist(), prior.model_dump())
            for prior, number, within, before in numbers
        ]

    @property
    @tells("what the data leave undetermined", key="combinations")
    def undetermined(self) -> list[Combination]:
        """The combinations of parameters, the least determined first."""
        pairs = zip(*self.combinations, strict=True)
        return [Combination(float(spread), direction.tolist()) for spread, direction in pairs]

    @property
    @tells("labels predicted from the other measurements", key="predictions")
    def predicted_labels(self) -> list[dict[str, Any]]:
        """Number of labels that are predicted without some measurements, by the ensemble and by simple rules."""
        return [
            {"left_out": each.left_out}
            | {name: self.hits(getattr(each, name)) for name in ("predicted", "majority", "nearest")}
            | {"effective_draws": each.effective}
            for each in self.predictions
        ]

    @property
    @tells()
    def measured(self) -> list[Measured]:
        """Each measured label."""
        return [
            Measured(
                at=dict(zip(self.axes, measurement.values, strict=True)),
                label=measurement.label,
                computed=label_of(int(match["pattern"])),
                probabilities=shares,
                met_by_some=bool(met),
                reason=self.reasons.get(k, ""),
            )
            for k, (measurement, match, shares, met) in enumerate(
                zip(
                    self.experiment.measurements,
                    self.estimate_matches,
                    self.probabilities,
                    (self.matches["pattern"] == self.wanted).any(axis=0),
                    strict=True,
                )
            )
        ]

    @property
    @tells("not met by the best candidate")
    def missed(self) -> list[Measured]:
        """The labels that the best candidate misses."""
        return [each for each in self.measured if each.reason]

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

    @property
    @tells()
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


# --- Weights and predictions ------------------------------------------------------------------------------------------


def weights_of(losses: Floats, log_density: Floats, flattening: float = 1.0) -> Floats:
    """Weights of draws, which add up to 1; flattening : power of the likelihood."""
    exponents = -flattening * losses - log_density
    weights = np.exp(exponents - exponents.max())
    return np.asarray(weights / weights.sum())


def effective_size(weights: Floats) -> float:
    """Number of equally weighted draws that would be as good."""
    return float(1.0 / (weights**2).sum())


def losses(matches: Records, wanted: Patterns, fit: Fit, rows: Bools | slice = slice(None)) -> Floats:
    """Minus the logarithm of candidates' likelihood, up to a constant.

    A label that is not met costs its distance over the scatter. Besides, labels are wrong with a probability that is
    not known: its beta distribution is integrated over, so that one miss more costs much where few labels are missed
    and little where many are.

    Parameters
    ----------
    matches : (n, points) MATCH
    wanted : (points,) uint64, patterns of the measured labels
    rows : of the measurements that count
    """
    from scipy.special import betaln

    matches, wanted = matches[:, rows], wanted[rows]
    missed = matches["pattern"] != wanted
    misses, count = missed.sum(axis=1), matches.shape[1]
    wrong, right = _PRIOR_WEIGHT * fit.wrong_labels, _PRIOR_WEIGHT * (1.0 - fit.wrong_labels)
    of_labels = betaln(wrong, count + right) - betaln(misses + wrong, count - misses + right)
    of_distances = np.where(missed, matches["distance"], 0.0).sum(axis=1) / fit.scatter
    return np.asarray(of_labels + of_distances + matches["misfit"].sum(axis=1))


def probabilities(patterns: Patterns, weights: Floats) -> list[dict[int, float]]:
    """Probability of each pattern at each point, the largest first; patterns : (n, points), weights : (n,)."""
    every = []
    for column in patterns.T:
        unique, inverse = np.unique(column, return_inverse=True)
        shares = np.bincount(inverse.reshape(-1), weights, unique.size)
        order = np.lexsort((unique, -shares))
        every.append({int(unique[k]): float(shares[k]) for k in order})
    return every


def predict_left_out(
    matches: Records,
    log_density: Floats,
    wanted: Patterns,
    points: Floats,
    fit: Fit,
    groups: Sequence[int],
    left_out: str,
) -> Prediction:
    """Predict the labels of each group of measurements from all others.

    Parameters
    ----------
    matches : (n, points) MATCH, of the ensemble
    log_density : (n,) of the ensemble's proposals
    points : (points, axes), measured values
    groups : (points,) number of each measurement's group
    """
    predicted, majority, nearest = (np.zeros_like(wanted) for _ in range(3))
    effective = np.inf
    spans = np.maximum(np.ptp(points, axis=0), 1e-300)
    for group in sorted(set(groups)):
        out = np.array([each == group for each in groups])
        weights = weights_of(losses(matches, wanted, fit, ~out), log_density)
        effective = min(effective, effective_size(weights))
        for at in np.flatnonzero(out):
            predicted[at] = next(iter(probabilities(matches["pattern"][:, [at]], weights)[0]))
            counts = Counter(wanted[~out].tolist())
            majority[at] = min(counts, key=lambda pattern: (-counts[pattern], pattern))
            distance = (((points[~out] - points[at]) / spans) ** 2).sum(axis=1)
            nearest[at] = wanted[~out][distance.argmin()]
    return Prediction(left_out, predicted, majority, nearest, effective)


def left_out_groups(points: Floats, axes: Sequence[str]) -> dict[str, list[int]]:
    """Ways to leave measurements out: each alone, and all that share a value of an axis with some others."""
    every = {"measurement": list(range(len(points)))}
    for axis, column in zip(axes, points.T, strict=True):
        values, group = np.unique(column, return_inverse=True)
        if 1 < values.size < len(points):
            every[axis] = group.reshape(-1).tolist()
    return every


# --- Reasons ----------------------------------------------------------------------------------------------------------


def reason_of(label: str, match: np.void, axis: str) -> str:
    """Sentences on why a run, MATCH, misses a measured label; axis : key of the value that was changed."""
    if match["pattern"] == 0:
        return "The run failed."
    events = order_of_events(flanks_of_label(label), flanks_of(int(match["pattern"])))
    if match["change"] == 0.0:
        return f"{events} No change of {axis} alone brings about the measured label."
    return f"{events} At {math.exp(match['change']):.2f} times {axis} it would be the measured label."


def order_of_events(measured: tuple[int, ...], computed: tuple[int, ...]) -> str:
    """Sentence on the first impact in which two sequences differ: which event would have to come before which."""
    pairs = enumerate(zip_longest(measured, computed), 1)
    number, wanted, there = next((n, *pair) for n, pair in pairs if pair[0] != pair[1])
    before = "the initial flank" if number == 1 else f"the flank of impact {number - 1}"
    if wanted is None:
        return f"The lash would have to stay at {before} instead of parting from it before impact {number}."
    if there is None:
        return f"The lash would have to part from {before} once more before it comes to rest there."
    if wanted == INITIAL:
        return f"Impact {number} would have to be on the initial flank, before the gap is crossed."
    return f"Impact {number} would have to be on the opposite flank, before the gap turns back."
