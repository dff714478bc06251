"""What a fit makes of its config: a study with the estimate's values and the ensemble as its tolerances, and maps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from clunk.analysis.comparison import codes_among
from clunk.analysis.fitted import Fitted
from clunk.results.regimemap import Results
from clunk.study.arrays import Floats
from clunk.study.axes import ResultAxis
from clunk.study.document import with_value
from clunk.study.errors import ClunkError
from clunk.study.keys import key_at
from clunk.study.parameters import located
from clunk.study.study import Study, content
from clunk.study.sweeps import Axis, Sweep
from clunk.sweeping.sweep import sweep

_SEED = 2  # of the picked draws, beside the fit's

WHICH = ("nominal", "fitted")
_COUNT = 81  # values of an axis that the config does not sweep
_BEYOND = 0.15  # of the measured span, on either side of it


def fitted_study(fitted: Fitted, draws: int = 0) -> Study:
    """The study with the best candidate's values, without [fit].

    Values of measured keys, that of the config and those on its axes, are taken for measured ones: fitted factors and
    offsets are applied to them.

    Parameters
    ----------
    fitted : Fitted
    draws : int
        Number of the ensemble's draws to be tolerances around the estimate; 0 for none.

    Raises
    ------
    ConfigError
        Where the config does not allow the values.

    Examples
    --------
    >>> import clunk
    >>> study = clunk.load_study("configs/fit_table_4_1.toml", ["fit.candidates=64", "fit.draws=512"])
    >>> tolerant = clunk.fitted_study(clunk.fit(study, "table_4_1"), draws=32)
    >>> [each.draws for each in tolerant.sweep.tolerances]
    ['factor', 'offset']
    """
    study = fitted.study
    document = content(study.model_copy(update={"fit": None}))
    for prior, number in zip(fitted.priors, fitted.estimate, strict=True):
        place, _, value = located(study, prior.parameter)
        before = _value_at(document, place, value)
        document = with_value(document, place, float(prior.applied(number, before)))
        for axis in document.get("sweep", {}).get("axes", ()):
            if axis["parameter"] == prior.parameter and prior.draws != "value":
                for key in {"start", "stop"} & axis.keys():
                    axis[key] = float(prior.applied(number, axis[key]))
                if "values" in axis:
                    axis["values"] = tuple(prior.applied(number, axis["values"]).tolist())
    if draws:
        document["sweep"] = _with_tolerances(fitted, document.get("sweep", {}), draws)
    return Study.model_validate(document)


def _value_at(document: dict[str, Any], place: tuple[Any, ...], value: float) -> float:
    """Value at a place of a document; `value` where it has none."""
    node: Any = document
    for step in place:
        node = node[step] if isinstance(step, int) else node.get(step)
    return value if node is None else float(node)


def _with_tolerances(fitted: Fitted, sweep: dict[str, Any], draws: int) -> dict[str, Any]:
    """A sweep's table whose tolerances are draws of the ensemble, relative to the estimate.

    Factors and offsets of a key make the value v to a v + b, and those of the estimate made it to e v + f: so that the
    fitted value is to be multiplied by a/e, and then b - f a/e added.
    """
    generator = np.random.default_rng([fitted.fit.seed, _SEED])
    picked = fitted.draws[generator.choice(len(fitted.weights), size=draws, p=fitted.weights)]
    tolerances = []
    for key in dict.fromkeys(prior.parameter for prior in fitted.priors):
        ways = {prior.draws for prior in fitted.priors if prior.parameter == key}
        if "value" in ways:
            relative = {"value": _apply_fit(fitted, key, 0.0, picked)}
        else:
            (b, a), (f, e) = ([_apply_fit(fitted, key, v, n) for v in (0.0, 1.0)] for n in (picked, fitted.estimate))
            factor = (a - b) / (e - f) if "factor" in ways else np.ones(draws)
            relative = {"factor": factor, "offset": b - f * factor}
        for way, numbers in relative.items():
            if way in ways:
                table = {"parameter": key, "distribution": "listed", "draws": way}
                tolerances.append(table | {"values": tuple(numbers.tolist())})
    without = {key: value for key, value in sweep.items() if key not in ("samples", "tolerances")}
    return without | {"tolerances": tuple(tolerances), "sampling": {"count": draws}}


def _apply_fit(fitted: Fitted, key: str, value: float, numbers: Floats) -> Floats:
    """Value of a key after a fit's numbers, (…, d), have been applied to this one."""
    made: Floats = np.full(numbers.shape[:-1], value)
    for prior, column in zip(fitted.priors, np.moveaxis(numbers, -1, 0), strict=True):
        if prior.parameter == key:
            made = prior.applied(column, made)
    return made


# --- Maps -------------------------------------------------------------------------------------------------------------


def fit_maps(fitted: Fitted, workers: int | None = None) -> Results:
    """Map of the two measured parameters, as they were measured, before and after the fit along a first axis, `fit`.

    Raises ClunkError unless two parameters were measured, each at two values or more.
    """
    axes = tuple(_axis(fitted, k) for k in range(len(fitted.axes)) if np.ptp(fitted.points[:, k]) > 0.0)
    if len(axes) != 2:
        raise ClunkError(f"A map has two measured parameters that vary; {fitted.experiment.name} has {len(axes)}.")
    first = zip(fitted.axes, fitted.points[0].tolist(), strict=True)
    varying = [axis.parameter for axis in axes]
    fixed = tuple(Axis(parameter=key, values=(value,)) for key, value in first if key not in varying)
    study = fitted.study.model_copy(update={"sweep": Sweep(axes=(*axes, *fixed))})
    studies = study.model_copy(update={"fit": None}), fitted_study(replace(fitted, study=study))
    before, after = (sweep(each, workers=workers).of_lash(fitted.lash) for each in studies)
    return _stacked(before, replace(after, axes=before.axes))


def _axis(fitted: Fitted, k: int) -> Axis:
    """The config's axis over a measured parameter, or one that reaches a little beyond the measured values."""
    parameter, values = fitted.axes[k], fitted.points[:, k]
    sweep = fitted.study.sweep
    for axis in sweep.axes if sweep is not None and sweep.design == "grid" else ():
        if axis.parameter == parameter and axis.count_of_values > 1:
            return axis
    key = key_at(located(fitted.study, parameter)[0])
    assert key is not None
    beyond = _BEYOND * float(np.ptp(values))
    start, stop = max(values.min() - beyond, key.lowest), min(values.max() + beyond, key.highest)
    if key.above and start == key.lowest:
        start = float(values.min())
    return Axis(parameter=parameter, start=float(start), stop=float(stop), count=_COUNT)


def _stacked(before: Results, after: Results) -> Results:
    """Two maps of the same axes behind one another, with labels in common."""
    labels = tuple(dict.fromkeys((*before.labels, *after.labels)))
    parts: dict[str, Any] = {
        name: (np.concatenate if quantity.dimension else np.stack)([before.values(name), after.values(name)])
        for name, quantity in before.quantities.items()
    }
    parts["sequence"] = np.stack([codes_among(each, labels) for each in (before, after)]).astype(np.int16)
    which = ResultAxis("fit", np.array([1.0, 2.0]), "candidate", "", "1", WHICH)
    return replace(before, axes=(which, *before.axes), labels=labels, arrays=parts)
