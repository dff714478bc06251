"""Outcome of a fit: the best candidate, the ensemble, and what they say of parameters, labels and predictions.

The ensemble's draws are weighted by their likelihood under all measurements, or under some of them, from which the
labels of the others are predicted. The reason why a label is missed names the two events that would have to change
their order. The fitted study is the config with the estimate's values.
"""

import math
from dataclasses import replace
from itertools import zip_longest
from typing import Any

import numpy as np

from clunk.analysis.measurements import IMPACT_QUANTITIES, Experiment
from clunk.core.sequence import INITIAL
from clunk.results.labels import FAILED, FAILED_CODE, flanks_of_label
from clunk.results.maps import Results
from clunk.results.quantities import REGIME_QUANTITIES
from clunk.study.arrays import Codes, Floats, Positions, Records
from clunk.study.document import with_value
from clunk.study.errors import ClunkError
from clunk.study.models import Fit
from clunk.study.parameters import located, nominal_value, with_draws
from clunk.study.records import Record, counted, tells, told
from clunk.study.study import Study, content, study_of_document
from clunk.study.sweeps import Axis, Draw, Sweep
from clunk.sweeping.sweep import sweep

INTERVAL = (0.05, 0.95)  # quantiles of the ensemble that bound a parameter
FAR = 4.0  # standard deviations: a measured value that is further off is not met
_PRIOR_WEIGHT = 10.0  # number of measurements that the expected share of wrong labels is worth
_COUNT = 81  # values of a map's axis
_BEYOND = 0.15  # of the measured span, by which a map's axis reaches beyond it on either side


class Estimate(Record):
    """Estimate of a parameter: its value, or a factor or an offset, as its prior draws.

    interval, prior_interval : 5 and 95 % quantiles, of the ensemble and of the prior
    """

    parameter: str = told("parameter")
    draws: str = told("draws")
    estimate: float = told("estimate", form=".4g")
    interval: list[float] = told("5 to 95 %", form=".4g")
    prior_interval: list[float] = told("of the prior", form=".4g")


class Combination(Record):
    """A combination of parameters, and how much of the prior's spread the data leave to it.

    spread : standard deviation in the ensemble, as a share of the prior's
    direction : component of each parameter, in standard deviations of its prior
    """

    spread: float = told("of the prior's spread", form=".0%")
    direction: list[float] = told("direction (in the priors' standard deviations)", form="+.2f")


class Measured(Record):
    """A measured label beside the label that the best candidate has there.

    at : measured values, by key
    label : measured
    computed : label by the best candidate
    met_by_some : whether any draw of the ensemble meets it
    reason : sentences on why the best candidate misses it; empty where it does not
    """

    at: dict[str, float] = told("at")
    label: str = told("measured")
    computed: str = told("computed")
    met_by_some: bool = told("met by some draw")
    reason: str = told("why")


class Fitted(Record, eq=False, repr=False):
    """Outcome of a fit of d parameters to n measurements.

    study : Study, with its [fit]
    experiment : Experiment
    lash : name of the lash that was measured
    axes : dotted keys of the measured columns
    points : (n, axes) measured values
    labels : label of each code; the last is that of failed runs, whose code is -1
    wanted : (n,) codes of the measured labels
    estimate : (d,) numbers of the best candidate: values, factors or offsets, as the priors draw
    estimate_matches, nominal_matches : (n,) MATCH, of the best candidate and of the config as it is
    coordinates, draws : (N, d) each, the ensemble in coordinates in which the prior is standard normal, and as values,
        factors or offsets
    matches : (N, n) MATCH, of the ensemble's draws
    log_density : (N,) logarithm of the density that proposed the draws, over the prior's
    weights : (N,) of the draws, which add up to 1
    candidates : number of candidates and draws that have been run
    failed : number of these of which some run failed
    """

    study: Study
    experiment: Experiment
    lash: str
    axes: tuple[str, ...]
    points: Floats
    labels: tuple[str, ...]
    wanted: Codes
    estimate: Floats
    estimate_matches: Records
    nominal_matches: Records
    coordinates: Floats
    draws: Floats
    matches: Records
    log_density: Floats
    weights: Floats
    failed: int
    candidates: int = told("candidates and draws")

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

    @property
    @tells("ensemble's draws", key="draws")
    def ensemble_size(self) -> int:
        """Number of the ensemble's draws."""
        return len(self.weights)

    @property
    @tells("worth independent draws", form=".0f", key="effective_draws")
    def effective(self) -> float:
        """Effective size of the ensemble."""
        return effective_size(self.weights)

    def hits(self, codes: Codes) -> int:
        """Number of measurements whose label has the code that is given for them, (n,)."""
        return int(np.count_nonzero(codes == self.wanted))

    @property
    @tells("met by the best candidate")
    def met(self) -> int:
        """Number of labels that the best candidate meets."""
        return self.hits(self.estimate_matches["label"])

    @property
    @tells("met by the config as it is")
    def met_by_config(self) -> int:
        """Number of labels that the config's own values meet."""
        return self.hits(self.nominal_matches["label"])

    @property
    @tells("values of impacts, and how many the best candidate meets", key="impacts")
    def met_impacts(self) -> list[dict[str, Any]]:
        """For each measured quantity of impacts the number of values, and of those no further off than `FAR`."""
        rows, each = [], self.experiment.measurements
        for name, far in zip(IMPACT_QUANTITIES, self.estimate_matches["far"].sum(axis=0).tolist(), strict=True):
            if count := sum(len(measurement.impacts.get(name, ())) for measurement in each):
                rows.append({"quantity": name, "measured": count, "met": count - far})
        return rows

    @property
    @tells("parameters", key="parameters")
    def estimates(self) -> list[Estimate]:
        """Each parameter's estimate and intervals."""
        rows = []
        for prior, number, within in zip(self.priors, self.estimate, self.intervals().tolist(), strict=True):
            before = prior.quantiles(INTERVAL, nominal_value(self.study, prior.parameter)).tolist()
            rows.append(Estimate(prior.parameter, prior.draws, float(number), within, before))
        return rows

    @property
    @tells("combinations of parameters, and the spread that the data leave to each", key="combinations")
    def undetermined(self) -> list[Combination]:
        """The ensemble's principal axes, the widest first, in coordinates in which the prior is standard normal."""
        offsets = self.coordinates - self.weights @ self.coordinates
        variances, directions = np.linalg.eigh((offsets * self.weights[:, None]).T @ offsets)
        spreads = np.sqrt(np.maximum(variances, 0.0)).tolist()
        return [*map(Combination, spreads, directions.T.tolist())][::-1]

    @property
    @tells("labels predicted from the other measurements")
    def predictions(self) -> list[dict[str, Any]]:
        """Number of labels predicted rightly from the other measurements, by the ensemble and by two simple rules.

        Measurements are left out one at a time, and then all with the same value of a measured parameter.
        """
        ways = {"measurement": np.arange(self.count)}
        for axis, column in zip(self.axes, self.points.T, strict=True):
            values, groups = np.unique(column, return_inverse=True)
            if 1 < values.size < self.count:
                ways[axis] = groups
        return [{"left_out": left_out} | self._predicted(groups) for left_out, groups in ways.items()]

    def _predicted(self, groups: Positions) -> dict[str, float]:
        """Number of labels predicted rightly where each group of measurements, by its number (n,), is left out in turn.

        Labels are predicted by the ensemble, by the most frequent label of the other measurements, and by that of the
        nearest one. `effective_draws` is the least effective size of the ensemble without a group.
        """
        hits, effective = dict.fromkeys(("predicted", "majority", "nearest"), 0), math.inf
        spans = np.maximum(np.ptp(self.points, axis=0), 1e-300)
        for group in np.unique(groups):
            out = groups == group
            rest = np.flatnonzero(~out)  # of records, `take` needs a tenth of the time of indexing
            rest_codes = self.wanted[rest]
            weights = weights_of(losses(self.matches.take(rest, 1), rest_codes, self.fit), self.log_density)
            effective = min(effective, effective_size(weights))
            for at in np.flatnonzero(out).tolist():
                distances = (((self.points[rest] - self.points[at]) / spans) ** 2).sum(axis=1)
                likely = np.bincount(self.matches["label"][:, at] - FAILED_CODE, weights).argmax() + FAILED_CODE
                hits["predicted"] += int(likely == self.wanted[at])
                hits["majority"] += int(np.bincount(rest_codes).argmax() == self.wanted[at])
                hits["nearest"] += int(rest_codes[distances.argmin()] == self.wanted[at])
        return hits | {"effective_draws": effective}

    @property
    @tells()
    def measured(self) -> list[Measured]:
        """Each measured label beside the best candidate's."""
        met_by_some = (self.matches["label"] == self.wanted).any(axis=0).tolist()
        return [
            Measured(
                at=dict(zip(self.axes, measurement.values, strict=True)),
                label=measurement.label,
                computed=self.labels[match["label"]],
                met_by_some=is_met,
                reason=self._reason(measurement.label, match),
            )
            for measurement, match, is_met in zip(
                self.experiment.measurements, self.estimate_matches, met_by_some, strict=True
            )
        ]

    @property
    @tells("not met by the best candidate")
    def missed(self) -> list[Measured]:
        """The labels that the best candidate misses."""
        return [each for each in self.measured if each.reason]

    def _reason(self, label: str, match: np.void) -> str:
        """Sentences on why a run, MATCH, misses a measured label; empty where it does not."""
        computed, axis = self.labels[match["label"]], self.axes[match["axis"]]
        if computed == label:
            return ""
        if computed == FAILED:
            return "The run failed."
        events = order_of_events(flanks_of_label(label), flanks_of_label(computed))
        if match["change"] == 0.0:
            return f"{events} No factor that was tried on one measured value brings about the measured label."
        return f"{events} At {math.exp(match['change']):.4g} times {axis} it would be the measured label."

    def intervals(self) -> Floats:
        """(d, 2) 5 and 95 % quantiles of each parameter in the ensemble."""
        return np.quantile(self.draws, INTERVAL, axis=0, weights=self.weights, method="inverted_cdf").T

    @property
    @tells()
    def warnings(self) -> list[str]:
        """Sentences on what makes the fit doubtful."""
        sentences = []
        parameters = len(self.priors)
        if parameters > self.count:
            sentences.append(f"There are more parameters, {parameters}, than measurements, {self.count}.")
        if self.effective < self.fit.effective_draws:
            sentences.append(
                f"The ensemble is worth {counted(round(self.effective), 'draw')}, not {self.fit.effective_draws}: its "
                "intervals are rough; raise fit.draws."
            )
        for each in self.met_impacts:
            name, count, met = each.values()
            if 2 * met < count:
                sentences.append(
                    f"The best candidate meets {met} of {count} values of {name}, within {FAR:g} standard deviations: "
                    f"are they in {REGIME_QUANTITIES[name].unit_symbol}?"
                )
        if self.failed:
            sentences.append(f"{self.failed:,} candidates failed at some operating points, which count as missed.")
        return sentences


# --- Weights and predictions ------------------------------------------------------------------------------------------


def losses(matches: Records, wanted: Codes, fit: Fit) -> Floats:
    """Minus the logarithm of candidates' likelihood, up to a constant.

    A label that is missed costs its distance over `fit.scatter`. Besides, each label is wrong with an unknown
    probability, over whose beta distribution the likelihood is integrated: one miss more costs much where few labels
    are missed, and little where many are.

    Parameters
    ----------
    matches : (n, points) MATCH
    wanted : (points,) codes of the measured labels
    """
    from scipy.special import betaln

    missed = matches["label"] != wanted
    misses, count = missed.sum(axis=1), matches.shape[1]
    wrong, right = _PRIOR_WEIGHT * fit.wrong_labels, _PRIOR_WEIGHT * (1.0 - fit.wrong_labels)
    of_labels = betaln(wrong, count + right) - betaln(misses + wrong, count - misses + right)
    of_distances = np.where(missed, matches["distance"], 0.0).sum(axis=1) / fit.scatter
    return of_labels + of_distances + matches["misfit"].sum(axis=1)


def weights_of(losses: Floats, log_density: Floats) -> Floats:
    """Weights of draws, (N,), which add up to 1, by their losses and the density that proposed them, (N,) each."""
    from scipy.special import softmax

    return softmax(-losses - log_density)


def effective_size(weights: Floats) -> float:
    """Effective size of weighted draws, 1 / sum(w**2): the number of equally weighted draws that would be as good."""
    return 1.0 / (weights**2).sum()


# --- Reasons ----------------------------------------------------------------------------------------------------------


def order_of_events(measured: tuple[int, ...], computed: tuple[int, ...]) -> str:
    """Sentence on the first impact in which two sequences differ: which event would have to come before which."""
    pairs = enumerate(zip_longest(measured, computed), 1)
    number, wanted, present = next((n, *pair) for n, pair in pairs if pair[0] != pair[1])
    before = "the initial flank" if number == 1 else f"the flank of impact {number - 1}"
    if wanted is None:
        return f"The lash would have to stay at {before} instead of parting from it before impact {number}."
    if present is None:
        return f"The lash would have to part from {before} once more before it comes to rest there."
    flank = "initial" if wanted == INITIAL else "opposite"
    event = "is crossed" if wanted == (INITIAL, *measured)[number - 1] else "turns back"
    return f"Impact {number} would have to be on the {flank} flank, before the gap {event}."


# --- Studies and maps -------------------------------------------------------------------------------------------------


def fitted_study(fitted: Fitted) -> Study:
    """The study with the best candidate's values, without [fit].

    Fitted factors and offsets are applied to the config's values of their keys, and to those on its axes, as if these
    were measured values.

    Raises
    ------
    ConfigError
        Where the config does not allow the values.

    Examples
    --------
    >>> import clunk
    >>> study = clunk.load_study("configs/fit_table_4_1.toml", ["fit.candidates=64", "fit.draws=64"])
    >>> rig = clunk.fitted_study(clunk.fit(study, "table_4_1"))
    >>> rig.lash.backlash_deg > study.lash.backlash_deg
    True
    """
    study, priors = fitted.study, fitted.priors
    document = content(study.but(fit=None))
    for key, value in with_draws(study, {}, priors, fitted.estimate).items():
        document = with_value(document, located(study, key)[0], float(value))
    acted_on = {each.parameter for each in priors} - {each.parameter for each in priors if each.draws == "value"}
    for axis, swept in zip(document.get("sweep", {}).get("axes", ()), study.swept.axes, strict=True):
        if swept.parameter not in acted_on:
            continue
        if swept.scale == "log":  # with an offset the values have no equal ratios any more
            axis.clear()
            axis |= {"parameter": swept.parameter, "values": swept.grid}
        for end in {"start", "stop", "values"} & axis.keys():
            measured = {swept.parameter: np.array(axis[end])}
            values = with_draws(study, measured, priors, fitted.estimate)[swept.parameter].tolist()
            axis[end] = tuple(values) if end == "values" else values
    return study_of_document(document)


def fit_maps(fitted: Fitted) -> tuple[Results, Results]:
    """Maps over two measured parameters before and after the fit, both with measured values on their axes.

    Raises ClunkError unless exactly two parameters were measured at two values or more.
    """
    varies = np.ptp(fitted.points, axis=0) > 0.0
    if varies.sum() != 2:
        raise ClunkError(f"A map has two measured parameters that vary; {fitted.experiment.name} has {varies.sum()}.")
    axes = [_axis(fitted, k) for k in np.flatnonzero(varies).tolist()]
    axes += [Axis(parameter=fitted.axes[k], values=(float(fitted.points[0, k]),)) for k in np.flatnonzero(~varies)]
    study = fitted.study.but(sweep=Sweep(axes=tuple(axes)))
    studies = study.but(fit=None), fitted_study(replace(fitted, study=study))
    before, after = (sweep(each).of_lash(fitted.lash) for each in studies)
    return before, replace(after, axes=before.axes)


def _axis(fitted: Fitted, k: int) -> Axis:
    """An axis that reaches a little beyond the values of a measured parameter, where that is allowed."""
    parameter, values = fitted.axes[k], fitted.points[:, k]
    key, beyond = located(fitted.study, parameter)[1], _BEYOND * np.ptp(values)
    ends = ((values.min(), values.min() - beyond), (values.max(), values.max() + beyond))

    def is_allowed(value: float) -> bool:
        after = with_draws(fitted.study, {parameter: np.array([value])}, fitted.priors, fitted.estimate)
        return key.allows(value) and key.allows(after[parameter].item())

    start, stop = (float(wide if is_allowed(wide) else end) for end, wide in ends)
    return Axis(parameter=parameter, start=start, stop=stop, count=_COUNT)
