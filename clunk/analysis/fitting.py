"""Fit of parameters to measured sequences of impacts: the best candidate, and an ensemble of all that are probable.

The best candidate is looked for by differential evolution. The ensemble is drawn by adaptive importance sampling: in
populations, each of which is proposed on the grounds of the draws before it.

Draws have coordinates in which the prior is standard normal. Each population is proposed by Gaussian kernels at draws
picked by their weights, and a share of it by the prior, so that no region is shut out; all draws then have the mixture
of all proposals as their density (deterministic mixture weights, Owen & Zhou 2000, doi:10.1080/01621459.2000.10473909;
adapted as by Cornuet et al. 2012, doi:10.1111/j.1467-9469.2011.00756.x). While the ensemble's effective size is small,
the draws for kernels are picked by a flattened likelihood, a power of it that makes the effective size large enough.

A candidate whose run misses a measured label is run at neighbouring operating points too, where one measured value is a
little smaller or greater. The least change of a value, in its logarithm, that brings about the measured label is the
run's distance from it. A run's margin would not do: it says how near *any* other label is, and saturates.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from itertools import product

import numpy as np

from clunk.analysis.fitted import FAR, Fitted, effective_size, losses, weights_of
from clunk.analysis.measurements import IMPACT_QUANTITIES, Experiment, read_experiment
from clunk.results.labels import FAILED, FAILED_CODE, flanks_of_label
from clunk.results.maps import Results
from clunk.results.quantities import measuring
from clunk.study.arrays import Codes, Floats, Positions, Records, record_of
from clunk.study.axes import parameters_of, variable_of
from clunk.study.document import FilePath
from clunk.study.errors import ClunkError, nearest, shorten
from clunk.study.models import WhichLash, lash_position
from clunk.study.parameters import located, nominal_value, spellings, with_draws
from clunk.study.rules import complaint
from clunk.study.study import Study, takes_study
from clunk.sweeping.progress import Progress, ShowProgress, reporting, unseen
from clunk.sweeping.runner import Runner
from clunk.sweeping.sweep import engine_of

# A candidate's run at a measured operating point: the code of its label (-1: failed); its distance from the measured
# label; the position of the measured value, and the signed change of its logarithm, that bring about the measured label
# (0: none does); the misfit of the impacts' measured quantities; and the number of values of each of these quantities
# that are further off than `FAR`.
MATCH = record_of(
    label="i8",
    distance="f8",
    axis="i8",
    change="f8",
    misfit="f8",
    far=("i8", len(IMPACT_QUANTITIES)),
)

_CHANGES = 0.05, 0.1, 0.2, 0.3, 0.45, 0.65, 0.9  # of the logarithm of a measured value, tried either way
_TOGETHER = 4_000  # candidates run together, times measured values: with all changes of these it takes a second
_OUTLIERS = 0.02  # expected share of outliers among measured quantities of impacts
_OUTLIER_SCALE = 10.0  # standard deviations, the scale of outliers' Cauchy distribution


class Candidates:
    """Runs of candidates for the numbers of a fit's d priors, at the n operating points of an experiment.

    study : Study, with [fit]
    experiment : Experiment
    lash : name of the lash that was measured
    engine : of threads
    progress : called with the number of candidates so far, and the most candidates and draws that may be run
    axes : dotted keys of the measured columns
    points : (n, axes) measured values
    labels : label of each code, the measured ones first
    wanted : (n,) codes of the measured labels
    coordinates, matches : of all candidates called so far, (N, d) coordinates in which the priors are standard normal,
        and (N, n) MATCH
    """

    def __init__(
        self, study: Study, experiment: Experiment, lash: str, engine: Executor, progress: Progress = unseen
    ) -> None:
        assert study.fit is not None
        self.study, self.fit, self.priors = study, study.fit, study.fit.parameters
        self.experiment, self.lash, self._engine, self._progress = experiment, lash, engine, progress
        self.axes = axes_of(study, experiment)
        self.points = np.array([each.values for each in experiment.measurements])
        measured = [each.label for each in experiment.measurements]  # in the notation of the runs' labels
        self.labels = [*dict.fromkeys(measured)]
        self.wanted = np.array([*map(self.labels.index, measured)])
        self.coordinates = np.zeros((0, len(self.priors)))
        self.matches = np.zeros((0, len(self.points)), MATCH)

    def __call__(self, coordinates: Floats) -> Floats:
        """Run candidates, (n, d) in coordinates; returns their losses, (n,)."""
        matches = self.run(self.numbers(coordinates))
        self.coordinates = np.concatenate([self.coordinates, coordinates])
        self.matches = np.concatenate([self.matches, matches])
        return losses(matches, self.wanted, self.fit)

    def numbers(self, coordinates: Floats) -> Floats:
        """Values, factors or offsets, (n, d), at coordinates in which the priors are standard normal."""
        from scipy.stats import norm

        columns = zip(self.priors, norm.cdf(coordinates.T), strict=True)
        return np.stack([prior.quantiles(u, nominal_value(self.study, prior.parameter)) for prior, u in columns], 1)

    def run(self, numbers: Floats) -> Records:
        """Run candidates, (n, d), at all operating points; returns MATCH, (n, points)."""
        together = max(1, _TOGETHER // self.points.size)
        parts = []
        for k in range(0, len(numbers), together):
            done = len(self.matches) + k
            self._progress(done, max(done, self.fit.candidates + self.fit.draws))
            parts.append(self._run_some(numbers[k : k + together]))
        return np.concatenate(parts)

    def _run_some(self, numbers: Floats) -> Records:
        """Run candidates, (n, d), few enough for all their runs to be in memory; returns MATCH, (n, points)."""
        keys = {*self.axes, *parameters_of(self.priors)}
        # a new one each time, as there are too many drivelines to keep
        runner = Runner(measuring(self.study, ()), sorted(keys), engine=self._engine)
        matches = np.zeros((len(numbers), len(self.points)), MATCH)
        flat, (candidate, point) = matches.ravel(), np.indices(matches.shape).reshape(2, -1)
        flat["label"], results = self._run(runner, numbers[candidate], self.points[point])
        self._compare_impacts(flat, point, results)
        missed = np.flatnonzero(flat["label"] != self.wanted[point])
        if missed.size:
            flat[missed] = self._look_around(runner, flat[missed], numbers[candidate[missed]], point[missed])
        return matches

    def _look_around(self, runner: Runner, matches: Records, numbers: Floats, point: Positions) -> Records:
        """Set the distance from the measured label in matches, (m,), of runs that missed it; returns these.

        Greater changes of measured values are tried only for runs that no smaller change brings to the measured label.
        """
        directions = np.kron(np.eye(len(self.axes)), [[-1.0], [1.0]])  # (m, axes)
        fewest, missed = np.full(point.size, np.inf), np.arange(point.size)
        for size in _CHANGES:
            at, changes = missed.repeat(len(directions)), np.tile(size * directions, (missed.size, 1))
            codes, _ = self._run(runner, numbers[at], self.points[point[at]] * np.exp(changes))
            edits = self._edits(self.wanted[point[at]], codes).reshape(missed.size, -1)
            fewest[missed] = np.minimum(fewest[missed], edits.min(axis=1))
            met, nearest = fewest[missed] == 0.0, edits.argmin(axis=1)
            reached, nearest = missed[met], nearest[met]
            matches["distance"][reached], matches["axis"][reached] = size, nearest // 2
            matches["change"][reached] = size * directions[nearest].sum(axis=1)
            missed = missed[~met]
            if not missed.size:
                break
        matches["distance"][missed] = _CHANGES[-1] + fewest[missed]  # 1 for each impact too many or too few
        return matches

    def _run(self, runner: Runner, numbers: Floats, measured: Floats) -> tuple[Codes, Results]:
        """Run candidates at measured values; returns the codes of the labels, (m,), and the results.

        numbers : (m, d) values, factors or offsets
        measured : (m, axes) measured values, changed or not
        """
        values = with_draws(self.study, dict(zip(self.axes, measured.T, strict=True)), self.priors, numbers.T)
        for key in self.axes:  # a changed value with an offset on it may leave the key's range
            allowed = located(self.study, key)[1]
            least = np.nextafter(allowed.lowest, np.inf) if allowed.above else allowed.lowest
            values[key] = values[key].clip(least, allowed.highest)
        results = runner(runner.values(values)).of_lash(self.lash)
        self.labels += [each for each in results.labels if each not in self.labels]
        codes = np.array([*map(self.labels.index, results.labels), FAILED_CODE])  # -1, of a failed run, takes the last
        return codes[results.sequence], results

    def _compare_impacts(self, matches: Records, point: Positions, results: Results) -> None:
        """Set `far`, and `misfit`, minus the logarithm of the likelihood of impacts' measured quantities, in matches.

        A measured impact that has no partner among the computed ones is compared with 0.
        """
        codes = matches["label"]
        for at, measurement in enumerate(self.experiment.measurements):
            for code in np.unique(codes[point == at]).tolist() if measurement.impacts else ():
                runs = np.flatnonzero((point == at) & (codes == code))
                partner = partners(flanks_of_label(measurement.label), self._flanks(code))
                for name, measured in measurement.impacts.items():
                    for number, value in measured.items():
                        computed: Floats | float = 0.0
                        if number in partner:
                            computed = results.values(name)[results.first_impact[runs] + partner[number]]
                        off = (value - computed) / measurement.std[name]
                        matches["misfit"][runs] += outlier_misfit(off)
                        matches["far"][runs, IMPACT_QUANTITIES.index(name)] += np.abs(off) > FAR

    def _edits(self, wanted: Codes, codes: Codes) -> Floats:
        """Number of impacts that runs have too many or too few for wanted labels, (n,); a failed run lacks them all."""
        pairs, inverse = np.unique([wanted, codes], axis=1, return_inverse=True)
        sequences = [(self._flanks(one), self._flanks(other)) for one, other in pairs.T.tolist()]
        edits = [len(a) + len(b) - 2.0 * len(partners(a, b)) for a, b in sequences]
        return np.array(edits)[inverse.ravel()]

    def _flanks(self, code: int) -> tuple[int, ...]:
        return () if code == FAILED_CODE else flanks_of_label(self.labels[code])


def axes_of(study: Study, experiment: Experiment) -> tuple[str, ...]:
    """Dotted keys of the measured columns. Raises ClunkError where the study has no such parameter."""
    known = {variable_of(name): key for name, key in spellings(study).items()}
    for column in experiment.columns:
        if column not in known:
            hint = f"; did you mean {likely}?" if (likely := nearest(column, (*known, "impact_time_1"))) else "."
            raise ClunkError(f"The column {shorten(column)} of {experiment.name} is no parameter of this config{hint}")
    return tuple(known[column] for column in experiment.columns)


def partners(measured: Sequence[int], computed: Sequence[int]) -> dict[int, int]:
    """Impacts that correspond in two sequences of flanks: number of the measured one -> number of the computed one.

    They are the longest common subsequence, and the earliest of several. Numbers count from 0.
    """
    m, n = len(measured), len(computed)
    most = [[0] * (n + 1) for _ in range(m + 1)]  # length of the longest from impact a of one and b of the other on
    for a, b in product(reversed(range(m)), reversed(range(n))):
        alike = measured[a] == computed[b]
        most[a][b] = 1 + most[a + 1][b + 1] if alike else max(most[a + 1][b], most[a][b + 1])
    partner, a, b = {}, 0, 0
    while a < m and b < n:
        if measured[a] == computed[b]:
            partner[a] = b
            a, b = a + 1, b + 1
        elif most[a + 1][b] > most[a][b + 1]:
            a += 1
        else:
            b += 1
    return partner


def outlier_misfit(deviation: Floats | float) -> Floats:
    """Minus the logarithm of a normal density with a few outliers, relative to its value at 0.

    It grows as the square near 0 and as the logarithm far away, so that one bad value decides nothing.

    deviation : in standard deviations
    """
    from scipy.stats import cauchy, norm

    z = np.stack([np.clip(deviation, -_FARTHEST, _FARTHEST), np.zeros(np.shape(deviation))])
    density = (1.0 - _OUTLIERS) * norm.pdf(z) + _OUTLIERS * cauchy.pdf(z, scale=_OUTLIER_SCALE)
    return np.log(density[1] / density[0])


_FARTHEST = 1e100  # standard deviations, to which larger ones are clipped: squares of those beyond 1e154 are infinite
_SEARCHED = 16  # candidates of a population of the search, for each parameter
_POPULATION = 512  # draws of a population of the ensemble
_KERNELS = 64  # Gaussian kernels of a proposal
_OF_PRIOR = 0.1  # share of a population that the prior proposes
_COUNTING = 50.0  # least effective number of draws with which kernels are picked by the likelihood as it is


@takes_study
def fit(
    study: Study,
    measurements: FilePath | Experiment,
    *,
    progress: ShowProgress = False,
    workers: int | None = None,
    lash: WhichLash = None,
) -> Fitted:
    """Fit the parameters of a study to measured sequences of impacts.

    Parameters
    ----------
    study : Study
        With [[fit.parameters]]; its sweep is ignored.
    measurements : path of a CSV file
        Operating points with their labels and measured quantities of impacts, in the format that ``clunk help fit``
        describes; or ``table_4_1``, the report's table.
    lash : str, optional
        Of several lashes, the one that was measured, by name or number; by default the first.
    progress, workers
        As in `clunk.sweep`; progress counts candidates.

    Returns
    -------
    Fitted
        `estimate` and `intervals()` of the parameters, `met` labels, `predictions`, `missed` labels with reasons,
        `warnings` and all draws of the ensemble with their `weights`. `clunk.draw` makes its pictures, and
        `clunk.fitted_study` returns the study with the estimate's values.

    Raises
    ------
    ClunkError
        Where the measurements cannot be read, or do not go with the study or with a prior.

    Examples
    --------
    >>> import clunk
    >>> study = clunk.load_study("configs/fit_table_4_1.toml", ["fit.candidates=64", "fit.draws=64"])
    >>> fitted = clunk.fit(study, "table_4_1")
    >>> fitted.met, fitted.met_by_config
    (15, 2)
    >>> factor, offset = fitted.intervals()  # of 5 and 95 %
    """
    experiment = measurements if isinstance(measurements, Experiment) else read_experiment(measurements)
    check(study, experiment)
    name = study.lash_names[lash_position(lash, study.lash_names)]
    with engine_of(None, workers) as engine, reporting(progress, study, what="candidates") as report:
        candidates = Candidates(study, experiment, name, engine, report)
        settings, priors = candidates.fit, candidates.priors
        nominal = [{"factor": 1.0, "offset": 0.0}.get(p.draws, nominal_value(study, p.parameter)) for p in priors]
        nominal_matches = candidates.run(np.array([nominal]))
        _search(candidates)
        draws, values, log_density = sample(
            candidates, len(priors), settings.effective_draws, settings.draws, settings.seed
        )
        count = len(candidates.matches)
        report(count, count)
    matches = np.concatenate([nominal_matches, candidates.matches])  # the config is a candidate, if the priors allow it
    numbers = np.vstack([nominal, candidates.numbers(candidates.coordinates)])
    ends = candidates.numbers(np.outer([-np.inf, np.inf], [1.0] * len(priors)))
    is_allowed = (numbers.clip(*ends) == numbers).all(axis=1)
    unlikely = np.append(0.0, _unlikely(candidates.coordinates))  # the config is taken as the middle of its priors
    best = np.where(is_allowed, losses(matches, candidates.wanted, settings) + unlikely, np.inf).argmin()
    return Fitted(
        study=study,
        experiment=experiment,
        lash=name,
        axes=candidates.axes,
        points=candidates.points,
        labels=(*candidates.labels, FAILED),
        wanted=candidates.wanted,
        estimate=numbers[best],
        estimate_matches=matches[best],
        nominal_matches=nominal_matches[0],
        coordinates=draws,
        draws=candidates.numbers(draws),
        matches=candidates.matches[-len(draws) :],
        log_density=log_density,
        weights=weights_of(values, log_density),
        candidates=count,
        failed=int((candidates.matches["label"] == FAILED_CODE).any(axis=1).sum()),
    )


def _search(candidates: Candidates) -> None:
    """Look for the best candidate by differential evolution, one population after the other, kept in `candidates`."""
    from scipy.optimize import differential_evolution
    from scipy.stats import norm

    def improbability(shares: Floats) -> Floats:
        coordinates = norm.ppf(shares.T.clip(1e-12, 1.0 - 1e-12))
        return candidates(coordinates) + _unlikely(coordinates)

    settings, count = candidates.fit, len(candidates.priors)
    populations = settings.candidates // (_SEARCHED * count)
    if populations:
        differential_evolution(
            improbability,
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


def _unlikely(coordinates: Floats) -> Floats:
    """Minus the logarithm of the priors' density, up to a constant, at coordinates (n, d), standard normal."""
    return 0.5 * np.square(coordinates).sum(axis=1)


def sample(
    loss_of: Callable[[Floats], Floats], dimensions: int, effective: float, most: int, seed: int
) -> tuple[Floats, Floats, Floats]:
    """Draw populations until their effective size is `effective`, or their number of draws is `most`.

    Parameters
    ----------
    loss_of : returns minus the logarithm of the likelihood, (n,), of draws, (n, dimensions)

    Returns
    -------
    draws : (N, dimensions), in the coordinates of the standard normal prior
    losses : (N,)
    log_density : (N,) logarithm of the density that proposed the draws, as a multiple of the prior's
    """
    from scipy.stats import gaussian_kde, norm

    def density(count: int, kernel: gaussian_kde, draws: Floats) -> Floats:
        """Density at draws of a proposal by kernels and the prior, over the prior's, times the number that it drew."""
        return count * (_OF_PRIOR + (1.0 - _OF_PRIOR) * (kernel(draws.T) / norm.pdf(draws).prod(axis=1)))

    generator, first = np.random.default_rng([seed, 1]), min(_POPULATION, most)
    draws = generator.standard_normal((first, dimensions))
    # proposed : (N,) density at the draws of the mixture of all proposals, over the prior's, times N
    values, proposed, kernels = loss_of(draws), np.full(first, float(first)), list[tuple[int, gaussian_kde]]()
    while True:
        log_density = np.log(proposed / len(draws))
        if len(draws) >= most or effective_size(weights_of(values, log_density)) >= effective:
            return draws, values, log_density
        picked = generator.choice(len(draws), _KERNELS, p=_flattened(values, log_density))
        count, kernel = min(_POPULATION, most - len(draws)), gaussian_kde(draws[picked].T, "silverman")
        kernels.append((count, kernel))
        of_prior = generator.standard_normal((count, dimensions))
        is_of_prior = generator.random((count, 1)) < _OF_PRIOR
        more = np.where(is_of_prior, of_prior, kernel.resample(count, generator).T)
        of_more = sum((density(*each, more) for each in kernels), np.full(count, float(first)))
        proposed = np.concatenate([proposed + density(count, kernel, draws), of_more])
        values, draws = np.concatenate([values, loss_of(more)]), np.concatenate([draws, more])


def _flattened(values: Floats, log_density: Floats) -> Floats:
    """Weights of draws by a power of their likelihood, the greatest up to 1 with an effective size of `_COUNTING`.

    Where no power has it, the weights are those by the likelihood itself.
    """
    from scipy.optimize import brentq

    def surplus(power: float) -> float:
        return effective_size(weights_of(power * values, log_density)) - _COUNTING

    power = brentq(surplus, 0.0, 1.0) if surplus(0.0) > 0.0 > surplus(1.0) else 1.0
    return weights_of(power * values, log_density)


def check(study: Study, experiment: Experiment) -> None:
    """Raise ClunkError where measurements do not go with a study or its priors."""
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
        if (text := complaint(axis, study)) is not None:
            raise ClunkError(f"{experiment.name}: {text}.")
        if any(prior.parameter == axis and prior.draws == "value" for prior in study.fit.parameters):
            raise ClunkError(
                f'{axis} is measured: what is fitted must act on the measured values; set draws = "factor" or "offset".'
            )
    has_severity = any("impact_severity" in each.impacts for each in experiment.measurements)
    if has_severity and study.has_rigid_flanks:
        raise ClunkError("impact_severity is not defined for the restitution model; impact_closing_speed is.")
    if whole := next((axis for axis in axes if located(study, axis)[1].whole), None):
        raise ClunkError(
            f"{whole} is an inertia's number, beside which a fit cannot look for a label; leave out its column."
        )
    for measurement in experiment.measurements:
        if max(measurement.impacts.get("impact_time", {}).values(), default=0.0) > study.solver.end_time:
            raise ClunkError(
                f"{experiment.name}, line {measurement.line}: an impact_time is greater than solver.end_time, "
                f"{study.solver.end_time:g} s."
            )
        for (axis, measured), share in product(zip(axes, measurement.values, strict=True), (0.0, 1.0)):
            value = measured
            for prior in study.fit.parameters:
                if prior.parameter == axis:
                    value = float(prior.applied(prior.quantiles(share, measured), value))
            key = located(study, axis)[1]
            if not key.allows(value):
                raise ClunkError(
                    f"{experiment.name}, line {measurement.line}: {axis} is {value:.6g}, as measured or at an end of "
                    f"its prior, and must be {key.must_be}; low and high bound a prior."
                )
