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

import os
from collections.abc import Callable
from itertools import product

import numpy as np

from clunk.analysis.fitruns import Candidates, axes_of, losses
from clunk.analysis.fitted import Fitted, effective_size, weights_of
from clunk.analysis.measurements import Experiment, read_experiment
from clunk.study.arrays import Floats
from clunk.study.errors import ClunkError
from clunk.study.keys import key_at
from clunk.study.models import lash_position
from clunk.study.parameters import located, nominal_value
from clunk.study.rules import load_complaint
from clunk.study.study import Study
from clunk.sweeping.progress import Progress, reporting
from clunk.sweeping.sweep import engine_of

_SEARCHED = 16  # candidates of a population of the search, for each parameter
_POPULATION = 512  # draws of the ensemble
_KERNELS = 64  # of a proposal
_OF_PRIOR = 0.1  # share of a population that the prior proposes
_COUNTING = 50.0  # draws that are to count for the kernels to follow the likelihood as it is


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
        `estimate` and `intervals()` of the parameters, `met` labels, `predictions`, `missed` labels with reasons,
        `warnings` and all draws of the ensemble with their `weights`. `clunk.draw` makes its pictures, and
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
    name, plain = study.lash_names[lash_position(lash, study.lash_names)], study.model_copy(update={"sweep": None})
    most = settings.candidates + settings.draws
    with engine_of(None, workers) as engine, reporting(progress, most, plain, what="candidates") as report:
        candidates = Candidates(study, experiment, name, engine, report)
        nominal = [{"factor": 1.0, "offset": 0.0}.get(p.draws, nominal_value(study, p.parameter)) for p in priors]
        nominal_matches = candidates.run(np.array([nominal]))[0]
        _search(candidates)
        draws, values, log_density = sample(
            candidates, len(priors), settings.effective_draws, settings.draws, settings.seed
        )
        count = len(candidates.matches)
        if report is not None:
            report(count, count)
    best = int(losses(candidates.matches, candidates.wanted, settings).argmin())
    return Fitted(
        study=study,
        experiment=experiment,
        lash=name,
        axes=candidates.axes,
        points=candidates.points,
        wanted=candidates.wanted,
        estimate=candidates.numbers(candidates.coordinates[[best]])[0],
        estimate_matches=candidates.matches[best],
        nominal_matches=nominal_matches,
        coordinates=draws,
        draws=candidates.numbers(draws),
        matches=candidates.matches[-len(draws) :],
        log_density=log_density,
        weights=weights_of(values, log_density),
        candidates=count,
        failed=int((candidates.matches["pattern"] == 0).any(axis=1).sum()),
    )


def _search(candidates: Candidates) -> None:
    """Look for the best candidate by differential evolution, a population a sweep."""
    from scipy.optimize import differential_evolution
    from scipy.stats import norm

    settings, count = candidates.fit, len(candidates.priors)
    populations = settings.candidates // (_SEARCHED * count)
    if populations:
        differential_evolution(
            lambda shares: candidates(np.asarray(norm.ppf(np.clip(shares.T, 1e-12, 1.0 - 1e-12)))),
            [(0.0, 1.0)] * count,
            init="sobol",
            popsize=_SEARCHED,
            maxiter=populations - 1,
            tol=1e-3,
            polish=False,
            vectorized=True,
            updating="deferred",
            seed=np.random.default_rng([settings.seed, 0]),
        )


def sample(
    loss_of: Callable[[Floats], Floats], dimensions: int, effective: float, most: int, seed: int
) -> tuple[Floats, Floats, Floats]:
    """Draw populations until they are worth `effective` draws, or are `most`.

    Parameters
    ----------
    loss_of : of draws, (n, dimensions), minus the logarithm of their likelihood, (n,)

    Returns
    -------
    draws : (N, dimensions), in the coordinates of the standard normal prior
    losses : (N,)
    log_density : (N,) logarithm of the density that proposed the draws, as a multiple of the prior's
    """
    from scipy.stats import gaussian_kde, norm

    generator = np.random.default_rng([seed, 1])
    draws = generator.standard_normal((min(_POPULATION, most), dimensions))
    values, counts, kernels = loss_of(draws), [len(draws)], list[gaussian_kde]()
    while True:
        over_prior = [each(draws.T) / norm.pdf(draws).prod(axis=1) for each in kernels]
        densities = [np.ones(len(draws)), *(_OF_PRIOR + (1.0 - _OF_PRIOR) * each for each in over_prior)]
        log_density = np.log(np.average(densities, axis=0, weights=counts))
        if len(draws) >= most or effective_size(weights_of(values, log_density)) >= effective:
            return draws, values, log_density
        picked = generator.choice(len(draws), _KERNELS, p=_flattened(values, log_density))
        kernels.append(gaussian_kde(draws[picked].T, "silverman"))
        counts.append(min(_POPULATION, most - len(draws)))
        of_prior = generator.standard_normal((counts[-1], dimensions))
        is_of_prior = generator.random((counts[-1], 1)) < _OF_PRIOR
        more = np.where(is_of_prior, of_prior, kernels[-1].resample(counts[-1], generator).T)
        values, draws = np.concatenate([values, loss_of(more)]), np.concatenate([draws, more])


def _flattened(values: Floats, log_density: Floats) -> Floats:
    """Weights of draws by a power of their likelihood, the greatest up to 1 for which enough of them count."""
    from scipy.optimize import brentq

    def surplus(power: float) -> float:
        return effective_size(weights_of(power * values, log_density)) - _COUNTING

    power = brentq(surplus, 0.0, 1.0) if surplus(0.0) > 0.0 > surplus(1.0) else 1.0
    return weights_of(power * values, log_density)


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
    for axis in axes:
        if (text := load_complaint(axis, study)) is not None:
            raise ClunkError(f"{experiment.name}: {text}.")
        if any(prior.parameter == axis and prior.draws == "value" for prior in study.fit.parameters):
            raise ClunkError(
                f'{axis} is measured: what is fitted must act on the measured values; set draws = "factor" or "offset".'
            )
    has_severity = any("impact_severity" in each.impacts for each in experiment.measurements)
    if has_severity and study.lashes[0].contact.model == "restitution":
        raise ClunkError("impact_severity is not defined for the restitution model; impact_closing_speed is.")
    for measurement in experiment.measurements:
        for (axis, measured), share in product(zip(axes, measurement.values, strict=True), (0.0, 1.0)):
            value = measured
            for prior in study.fit.parameters:
                if prior.parameter == axis:
                    value = float(prior.applied(prior.quantiles(share, measured), value))
            key = key_at(located(study, axis)[0])
            assert key is not None
            if not key.allows(value):
                raise ClunkError(
                    f"{experiment.name}, line {measurement.line}: {axis} is {value:.6g}, as measured or at an end of "
                    f"its prior, and must be {key.must_be}; low and high bound a prior."
                )
