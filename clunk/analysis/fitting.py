"""Fit of parameters to measured sequences of impacts: the best candidate, and an ensemble of all that are probable."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from clunk.analysis.fitensemble import Population, effective_size, sample, sobol_points, weights_of
from clunk.analysis.fitpredictions import losses, predict_left_out
from clunk.analysis.fitruns import CandidateRuns, Worth, axes_of, numbers_at, patterns_of
from clunk.analysis.fitted import Fewer, Fitted
from clunk.analysis.measurements import Experiment
from clunk.core.status import Status
from clunk.study.arrays import Bools, Floats, Patterns, Records
from clunk.study.errors import ClunkError
from clunk.study.fits import Fit
from clunk.study.keys import key_at
from clunk.study.lashes import lash_position
from clunk.study.parameters import located, nominal_value
from clunk.study.rules import load_complaint
from clunk.study.study import Study
from clunk.study.sweeps import Draw
from clunk.sweeping.progress import Progress
from clunk.sweeping.sweep import engine_of

_NEGLIGIBLE = 30.0  # logarithm of how much less likely than the best a candidate is whose distances do not matter
_SEARCHED = 16  # candidates of a population of the search, for each parameter


class FitError(ClunkError):
    """A fit that cannot start; its text is one sentence for the user."""


@dataclass
class Populations:
    """Runs of one population of candidates after the other, with their progress.

    runs : CandidateRuns
    progress, planned : called with the number of candidates so far, and this number in all
    candidates : number of them so far
    """

    runs: CandidateRuns
    progress: Progress | None = None
    planned: int = 0
    candidates: int = 0

    def __call__(self, candidates: Floats, worth: Worth) -> Records:
        """Run a population; parameters and result as of `CandidateRuns`."""
        matches = self.runs(candidates, worth)
        self.candidates += len(candidates)
        if self.progress is not None:
            self.progress(self.candidates, max(self.planned, self.candidates))
        return matches


@dataclass
class _Best:
    """The best candidate so far, and how near any has come to each measurement."""

    wanted: Patterns
    loss: float = math.inf
    numbers: Floats = field(default_factory=lambda: np.zeros(0))
    matches: Records | None = None
    distances: Floats | float = math.inf
    failed: int = 0

    def take(self, candidates: Floats, matches: Records, values: Floats) -> None:
        """Take candidates into account, with these values of the loss."""
        k = int(values.argmin())
        if values[k] < self.loss:
            self.loss, self.numbers, self.matches = float(values[k]), candidates[k], matches[k]
        met = matches["pattern"] == self.wanted
        # what is not met, and has no distance, was not looked for
        distances = np.where(met, 0.0, np.where(matches["distance"] > 0.0, matches["distance"], np.inf))
        self.distances = np.minimum(self.distances, distances.min(axis=0))
        self.failed += int((matches["status"] != Status.OK).any(axis=1).sum())


def fit(
    study: Study,
    experiment: Experiment,
    *,
    lash: str | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Fitted:
    """Fit the parameters of a study's [fit] to measured sequences of impacts.

    Parameters
    ----------
    study : Study
        With [[fit.parameters]]; its sweep is left aside.
    experiment : Experiment
    lash : str, optional
        Of several lashes, the one that was measured, by name or number; by default the first.
    workers : int, optional
        Threads; by default one for each core that this process may use.
    progress : callable(done, total), optional
        Called with the number of candidates after each population.

    Raises
    ------
    FitError, ExperimentError
        Where the measurements do not go with the study, or a prior with them.
    """
    check(study, experiment)
    assert study.fit is not None
    settings, priors = study.fit, study.fit.parameters
    position = lash_position(lash, study.lash_names)
    with engine_of(None, workers) as engine:
        runs = CandidateRuns(study, experiment, priors, engine, position)
        populations = Populations(runs, progress, planned(settings))
        best = _Best(runs.wanted)
        nominal = np.array([nominal_number(study, prior) for prior in priors])
        nominal_matches = populations(nominal[None], lambda matches: np.ones(1, bool))[0]
        _search(study, populations, best, nominal)
        ensemble, matches = draw_ensemble(study, populations, best, nominal, len(priors))
        fewer = []
        for count in range(1, len(priors)):
            part, of_part = draw_ensemble(study, populations, None, nominal, count)
            predicted = predict_left_out(
                of_part, part.log_density, runs.wanted, runs.points, settings, range(len(runs.points)), ""
            ).predicted
            hits = of_part["pattern"] == runs.wanted
            weights = weights_of(part.losses, part.log_density)
            fewer.append(
                Fewer(
                    count,
                    int(hits.sum(axis=1).max()),
                    int((predicted == runs.wanted).sum()),
                    effective_size(weights),
                )
            )
        if progress is not None:
            progress(populations.candidates, populations.candidates)
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
        best_distances=np.asarray(best.distances),
        fewer=tuple(fewer),
        axis=runs.axis,
        candidates=populations.candidates,
        failed=best.failed,
    )


def _search(study: Study, populations: Populations, best: _Best, nominal: Floats) -> None:
    """Look for the best candidate by differential evolution, a population a sweep."""
    from scipy.optimize import differential_evolution
    from scipy.stats import norm

    settings = study.fit
    assert settings is not None
    priors, wanted = settings.parameters, best.wanted
    size = min(max(_SEARCHED * len(priors), 32), settings.candidates)
    if size < 5:  # of which no differential evolution is possible
        return
    first = sobol_points(size, len(priors), np.random.default_rng([settings.seed, 0, 1]))
    first[0] = [_share_below(study, prior, number) for prior, number in zip(priors, nominal, strict=True)]
    parents = np.full(size, np.inf)

    def loss(trials: Floats) -> Floats:
        nonlocal parents
        shares = np.clip(trials.T, 1e-12, 1.0 - 1e-12)
        candidates = numbers_at(study, priors, np.asarray(norm.ppf(shares)))
        # a trial that cannot replace its parent whatever its distances are is not looked at further
        matches = populations(candidates, lambda near: losses(near, wanted, settings) <= parents[: len(near)])
        values = losses(matches, wanted, settings)
        best.take(candidates, matches, values)
        parents = np.minimum(parents, values)
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


def draw_ensemble(
    study: Study, populations: Populations, best: _Best | None, nominal: Floats, count: int
) -> tuple[Population, Records]:
    """Ensemble of the first parameters, the others being nominal, and its draws' MATCH."""
    settings = study.fit
    assert settings is not None
    priors, wanted = settings.parameters, populations.runs.wanted
    every: list[Records] = []
    least = np.inf

    def loss(draws: Floats) -> Floats:
        nonlocal least
        candidates = np.tile(nominal, (len(draws), 1))
        candidates[:, :count] = numbers_at(study, priors[:count], draws)

        def matters(near: Records) -> Bools:
            bounds = losses(near, wanted, settings)
            return np.asarray(bounds <= min(least, bounds.min()) + _NEGLIGIBLE)

        matches = populations(candidates, matters)
        values = losses(matches, wanted, settings)
        if best is not None:
            best.take(candidates, matches, values)
        every.append(matches)
        least = min(least, float(values.min()))
        return values

    population = sample(loss, count, settings.effective_draws, settings.draws, settings.seed)
    return population, np.concatenate(every)


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
    """Refuse measurements that do not go with a study. Raises FitError, ExperimentError."""
    if study.fit is None:
        raise FitError(
            "There is nothing to fit: the config has no [[fit.parameters]], one for each parameter (clunk help fit)."
        )
    if len(experiment.measurements) < 2:
        raise FitError(
            f"{experiment.name} has one measurement; a fit needs two or more, to predict each from the others."
        )
    axes = axes_of(study, experiment)
    patterns_of(experiment)
    for axis in axes:
        if (text := load_complaint(axis, study)) is not None:
            raise FitError(f"{experiment.name}: {text}.")
    for measurement in experiment.measurements:
        if "impact_severity" in measurement.impacts and study.lashes[0].contact.model == "restitution":
            raise FitError("impact_severity is not defined for the restitution model; impact_closing_speed is.")
        for axis, value in zip(axes, measurement.values, strict=True):
            _check_axis(study, axis, value, f"{experiment.name}, line {measurement.line}")


def _check_axis(study: Study, axis: str, value: float, where: str) -> None:
    """Refuse a measured value that its key does not allow, or at which a prior makes it one. Raises FitError."""
    assert study.fit is not None
    key = key_at(located(study, axis)[0])
    assert key is not None
    if not key.allows(value):
        raise FitError(f"{where}: found {axis} = {value:g}; it must be {key.must_be}.")
    priors = [prior for prior in study.fit.parameters if prior.parameter == axis]
    for prior in priors:
        if prior.draws == "value":
            raise FitError(
                f'{axis} is measured: what is fitted must act on the measured values; set draws = "factor" or "offset".'
            )
    for numbers in product(*(prior.quantiles([0.0, 1.0], value) for prior in priors)):
        changed = value
        for prior, number in zip(priors, numbers, strict=True):
            changed = float(prior.applied(number, changed))
        if not key.allows(changed):
            raise FitError(
                f"{where}: the prior allows {axis} = {changed:.6g}, and it must be {key.must_be}; bound it with low "
                "and high."
            )


def planned(settings: Fit) -> int:
    """Number of candidates that a fit may take."""
    return settings.candidates + settings.draws * len(settings.parameters)
