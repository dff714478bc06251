"""Fit of parameters to measured sequences of impacts: the best candidate, and an ensemble of all that are probable.

The best candidate is looked for by differential evolution, the ensemble drawn by adaptive importance sampling:
populations whose proposals follow the ones before.

Draws are in the coordinates in which the prior is standard normal. Each population is proposed by Gaussian kernels at
draws picked by their weights, and by the prior for a share, so that no region is shut out; all draws then have the
mixture of all proposals as their density (deterministic mixture weights, Owen & Zhou 2000, doi:10.1080/01621459.2000.
10473909; adapted as by Cornuet et al. 2012, doi:10.1111/j.1467-9469.2011.00756.x). While few draws count, the kernels
follow a likelihood that is flattened until enough do.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from clunk.analysis.fitruns import CandidateRuns, axes_of, numbers_at, patterns_of
from clunk.analysis.fitted import Fitted, effective_size, losses, weights_of
from clunk.analysis.measurements import Experiment, read_experiment
from clunk.core.status import Status
from clunk.study.arrays import Floats, Records
from clunk.study.errors import ClunkError
from clunk.study.keys import key_at
from clunk.study.lashes import lash_position
from clunk.study.parameters import located, nominal_value
from clunk.study.rules import load_complaint
from clunk.study.study import Study
from clunk.study.sweeps import Draw
from clunk.sweeping.progress import Progress, reporting
from clunk.sweeping.sweep import engine_of

_SEARCHED = 16  # candidates of a population of the search, for each parameter

POPULATION = 512  # draws of the ensemble
_KERNELS = 64  # of a proposal
_OF_PRIOR = 0.1  # share of a population that the prior proposes
_COUNTING = 0.1  # share of the draws that are to count for the kernels to follow the likelihood as it is
_RIDGE = 1e-6  # least width of a kernel, of the prior's


@dataclass
class _Best:
    """The best candidate so far, and the number of those that failed at some point."""

    loss: float = math.inf
    numbers: Floats = field(default_factory=lambda: np.zeros(0))
    matches: Records | None = None
    failed: int = 0

    def take(self, candidates: Floats, matches: Records, values: Floats) -> None:
        """Take candidates into account, with these values of the loss."""
        k = int(values.argmin())
        if values[k] < self.loss:
            self.loss, self.numbers, self.matches = float(values[k]), candidates[k], matches[k]
        self.failed += int((matches["status"] != Status.OK).any(axis=1).sum())


def fit(
    study: Study,
    measurements: str | os.PathLike[str] | Experiment,
    *,
    progress: bool | Progress = False,
    workers: int | None = None,
    lash: str | None = None,
) -> Fitted:
    """Fit the parameters of a study to measured sequences of impacts.

    Parameters
    ----------
    study : Study
        With [[fit.parameters]]; its sweep is left aside.
    measurements : path of a CSV file
        Operating points, their labels and what else was measured, as ``clunk help fit`` tells; or ``table_4_1``, the
        report's.
    lash : str, optional
        Of several lashes, the one that was measured, by name or number; by default the first.
    progress, workers
        As of `clunk.sweep`; candidates are counted.

    Returns
    -------
    Fitted
        `estimate` and `intervals()` of the parameters, `met` labels, `predictions`, `reasons` for the labels that are
        not met, `warnings` and all draws of the ensemble with their `weights`. `clunk.draw` makes its pictures, and
        `clunk.fitted_study` the study that it gives.

    Raises
    ------
    ClunkError
        Where the measurements cannot be read or do not go with the study, or a prior with them.

    Examples
    --------
    >>> import clunk
    >>> study = clunk.load_study("configs/fit_table_4_1.toml", ["fit.candidates=64", "fit.draws=512"])
    >>> fitted = clunk.fit(study, "table_4_1")
    >>> fitted.met, fitted.met_by_config
    (15, 2)
    >>> factor, offset = fitted.intervals()  # of 5 and 95 %
    """
    experiment = measurements if isinstance(measurements, Experiment) else read_experiment(measurements)
    check(study, experiment)
    assert study.fit is not None
    settings, priors = study.fit, study.fit.parameters
    position, most = lash_position(lash, study.lash_names), settings.candidates + settings.draws
    plain = study.model_copy(update={"sweep": None})
    with engine_of(None, workers) as engine, reporting(progress, most, plain, what="candidates") as report:
        runs = CandidateRuns(study, experiment, priors, engine, position, report, most)
        best = _Best()
        nominal = np.array([nominal_number(study, prior) for prior in priors])
        nominal_matches = runs(nominal[None])[0]
        _search(study, runs, best, nominal)
        ensemble, matches = draw_ensemble(study, runs, best)
        if report is not None:
            report(runs.candidates, runs.candidates)
    assert best.matches is not None
    return Fitted(
        study=study,
        experiment=experiment,
        lash=study.lash_names[position],
        estimate=best.numbers,
        estimate_matches=best.matches,
        nominal_matches=nominal_matches,
        coordinates=ensemble.draws,
        matches=matches,
        log_density=ensemble.log_density,
        axis=runs.axis,
        candidates=runs.candidates,
        failed=best.failed,
    )


def _search(study: Study, runs: CandidateRuns, best: _Best, nominal: Floats) -> None:
    """Look for the best candidate by differential evolution, a population a sweep."""
    from scipy.optimize import differential_evolution
    from scipy.stats import norm

    settings = study.fit
    assert settings is not None
    priors, wanted = settings.parameters, runs.wanted
    size = min(max(_SEARCHED * len(priors), 32), settings.candidates)
    if size < 5:  # of which no differential evolution is possible
        return
    first = sobol_points(size, len(priors), np.random.default_rng([settings.seed, 0, 1]))
    first[0] = [_share_below(study, prior, number) for prior, number in zip(priors, nominal, strict=True)]

    def loss(trials: Floats) -> Floats:
        shares = np.clip(trials.T, 1e-12, 1.0 - 1e-12)
        candidates = numbers_at(study, priors, np.asarray(norm.ppf(shares)))
        matches = runs(candidates)
        values = losses(matches, wanted, settings)
        best.take(candidates, matches, values)
        return values

    differential_evolution(
        loss,
        [(0.0, 1.0)] * len(priors),
        init=first,
        maxiter=max(settings.candidates // size - 1, 0),
        tol=1e-3,
        polish=False,
        vectorized=True,
        updating="deferred",
        seed=np.random.default_rng([settings.seed, 0, 2]),
    )


def draw_ensemble(study: Study, runs: CandidateRuns, best: _Best) -> tuple[Population, Records]:
    """Ensemble of candidates, and its draws' MATCH."""
    settings = study.fit
    assert settings is not None
    priors, wanted = settings.parameters, runs.wanted
    every: list[Records] = []

    def loss(draws: Floats) -> Floats:
        candidates = numbers_at(study, priors, draws)

        matches = runs(candidates)
        values = losses(matches, wanted, settings)
        best.take(candidates, matches, values)
        every.append(matches)
        return values

    population = sample(loss, len(priors), settings.effective_draws, settings.draws, settings.seed)
    return population, np.concatenate(every)


# --- Importance sampling ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Proposal:
    """A mixture of Gaussian kernels and the prior; without kernels the prior alone.

    centres : (k, d)
    root : (d, d) lower triangular, of the kernels' covariance
    """

    centres: Floats
    root: Floats

    def over_prior(self, draws: Floats) -> Floats:
        """Density at some draws, (n, d), as a multiple of the prior's."""
        if not len(self.centres):
            return np.ones(len(draws))
        inverse = np.linalg.inv(self.root)
        whitened = draws @ inverse.T, self.centres @ inverse.T
        squares = ((whitened[0][:, None, :] - whitened[1][None, :, :]) ** 2).sum(axis=2)
        exponents = ((draws**2).sum(axis=1)[:, None] - squares) / 2.0 - np.log(np.diag(self.root)).sum()
        return np.asarray(_OF_PRIOR + (1.0 - _OF_PRIOR) * np.exp(np.minimum(exponents, 600.0)).mean(axis=1))

    def draw(self, count: int, generator: np.random.Generator) -> Floats:
        """Draw from the mixture, (count, d)."""
        normal = generator.standard_normal((count, self.root.shape[0]))
        kernel = generator.integers(len(self.centres), size=count)
        of_prior = generator.random(count) < _OF_PRIOR
        return np.where(of_prior[:, None], normal, self.centres[kernel] + normal @ self.root.T)


@dataclass
class Population:
    """Draws of all populations so far.

    draws : (n, d), in the coordinates of the standard normal prior
    losses : (n,) minus the logarithm of their likelihood
    proposals : of each population
    """

    draws: Floats
    losses: Floats
    proposals: list[Proposal] = field(default_factory=list)
    counts: list[int] = field(default_factory=list)

    @property
    def log_density(self) -> Floats:
        """(n,) logarithm of the density that proposed the draws, as a multiple of the prior's."""
        densities = [
            count * each.over_prior(self.draws) for each, count in zip(self.proposals, self.counts, strict=True)
        ]
        return np.asarray(np.log(np.sum(densities, axis=0) / sum(self.counts)))


def sample(loss_of: Callable[[Floats], Floats], dimensions: int, effective: float, most: int, seed: int) -> Population:
    """Draw populations until they are worth `effective` draws, or are `most`.

    Parameters
    ----------
    loss_of : of draws, (n, dimensions), minus the logarithm of their likelihood, (n,)
    """
    from scipy.stats import norm

    first = sobol_points(min(POPULATION, most), dimensions, np.random.default_rng([seed, 0]))
    draws = np.asarray(norm.ppf(np.clip(first, 1e-12, 1.0 - 1e-12)), np.float64)
    population = Population(draws, loss_of(draws), [Proposal(draws[:0], np.eye(dimensions))], [len(draws)])
    while len(population.draws) < most:
        density = population.log_density
        if effective_size(weights_of(population.losses, density)) >= effective:
            break
        generator = np.random.default_rng([seed, len(population.counts)])
        proposal = proposal_after(population, density, generator)
        draws = proposal.draw(min(POPULATION, most - len(population.draws)), generator)
        population.losses = np.concatenate([population.losses, loss_of(draws)])
        population.draws = np.concatenate([population.draws, draws])
        population.proposals.append(proposal)
        population.counts.append(len(draws))
    return population


def sobol_points(count: int, dimensions: int, generator: np.random.Generator) -> Floats:
    """The first points, (count, dimensions), of a scrambled Sobol sequence."""
    from scipy.stats import qmc

    return np.asarray(qmc.Sobol(dimensions, seed=generator).random_base2((count - 1).bit_length())[:count])


def proposal_after(population: Population, log_density: Floats, generator: np.random.Generator) -> Proposal:
    """The kernels that follow the weights of the draws so far, flattened until enough draws count."""
    enough, losses = _COUNTING * POPULATION, population.losses
    low, high = 0.0, 1.0
    weights = weights_of(losses, log_density)
    if effective_size(weights) < enough:
        for _ in range(40):
            middle = (low + high) / 2.0
            if effective_size(weights_of(losses, log_density, middle)) < enough:
                high = middle
            else:
                low = middle
        weights = weights_of(losses, log_density, low)
    dimensions = population.draws.shape[1]
    offsets = population.draws - weights @ population.draws
    covariance = (offsets * weights[:, None]).T @ offsets
    width = (4.0 / ((dimensions + 2) * effective_size(weights))) ** (1.0 / (dimensions + 4))  # Silverman's rule
    root = np.linalg.cholesky(width**2 * covariance + _RIDGE**2 * np.eye(dimensions))
    picked = generator.choice(len(weights), size=_KERNELS, p=weights)
    return Proposal(population.draws[picked], root)


# --- Parameters and their priors -------------------------------------------------------------------------------------


def nominal_number(study: Study, prior: Draw) -> float:
    """Number of a prior at which its parameter has the config's value."""
    return {"factor": 1.0, "offset": 0.0}.get(prior.draws, nominal_value(study, prior.parameter))


def _share_below(study: Study, prior: Draw, number: float) -> float:
    """Cumulative probability of a prior at a number."""
    shares = np.linspace(0.0, 1.0, 1025)
    return float(np.interp(number, prior.quantiles(shares, nominal_value(study, prior.parameter)), shares))


# --- What is refused before anything runs ----------------------------------------------------------------------------


def check(study: Study, experiment: Experiment) -> None:
    """Refuse measurements that do not go with a study. Raises ClunkError."""
    if study.fit is None:
        raise ClunkError(
            "There is nothing to fit: the config has no [[fit.parameters]], one for each parameter (clunk help fit)."
        )
    if len(experiment.measurements) < 2:
        raise ClunkError(
            f"{experiment.name} has one measurement; a fit needs two or more, to predict each from the others."
        )
    axes = axes_of(study, experiment)
    patterns_of(experiment)
    for axis in axes:
        if (text := load_complaint(axis, study)) is not None:
            raise ClunkError(f"{experiment.name}: {text}.")
    for measurement in experiment.measurements:
        if "impact_severity" in measurement.impacts and study.lashes[0].contact.model == "restitution":
            raise ClunkError("impact_severity is not defined for the restitution model; impact_closing_speed is.")
        for axis, value in zip(axes, measurement.values, strict=True):
            _check_axis(study, axis, value, f"{experiment.name}, line {measurement.line}")


def _check_axis(study: Study, axis: str, value: float, where: str) -> None:
    """Refuse a measured value that its key does not allow, or at which a prior makes it one. Raises ClunkError."""
    assert study.fit is not None
    key = key_at(located(study, axis)[0])
    assert key is not None
    if not key.allows(value):
        raise ClunkError(f"{where}: found {axis} = {value:g}; it must be {key.must_be}.")
    priors = [prior for prior in study.fit.parameters if prior.parameter == axis]
    for prior in priors:
        if prior.draws == "value":
            raise ClunkError(
                f'{axis} is measured: what is fitted must act on the measured values; set draws = "factor" or "offset".'
            )
    for numbers in product(*(prior.quantiles([0.0, 1.0], value) for prior in priors)):
        changed = value
        for prior, number in zip(priors, numbers, strict=True):
            changed = float(prior.applied(number, changed))
        if not key.allows(changed):
            raise ClunkError(
                f"{where}: the prior allows {axis} = {changed:.6g}, and it must be {key.must_be}; bound it with low "
                "and high."
            )
