"""Predictions of labels by an ensemble: of all measurements, of each from the others, and by naive rules."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clunk.analysis.fitensemble import effective_size, weights_of
from clunk.study.arrays import Bools, Floats, Patterns, Records
from clunk.study.fits import Fit

_PRIOR_WEIGHT = 10.0  # measurements that the expected share of wrong labels is worth


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
