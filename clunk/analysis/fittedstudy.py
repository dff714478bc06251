"""The study that a fit makes of its config: with the estimate's values, and with the ensemble as its tolerances."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from clunk.analysis.fitparts import FitError
from clunk.analysis.fitting import Fitted
from clunk.study.document import with_value
from clunk.study.parameters import located, nominal_value
from clunk.study.study import Study, content

_SEED = 2  # of the picked draws, beside the fit's


def fitted_study(fitted: Fitted, draws: int = 0) -> Study:
    """The study with the best candidate's values, without [fit].

    Values of measured keys, that of the config and those on its axes, are taken for measured ones: fitted factors and
    offsets are applied to them.

    draws : number of the ensemble's draws to be tolerances around the estimate; 0 for none

    Raises FitError where one key is fitted by a factor and an offset, which are no single tolerance; ConfigError where
    the config does not allow the values.
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


def require_single_draws(study: Study) -> None:
    """Refuse a key that is fitted by a factor and an offset, which are no single tolerance. Raises FitError."""
    names = Counter(prior.parameter for prior in study.fit.parameters) if study.fit is not None else Counter()
    twice = [name for name, count in names.items() if count > 1]
    if twice:
        raise FitError(f"{twice[0]} is fitted by a factor and an offset, and a tolerance is one of them.")


def _value_at(document: dict[str, Any], place: tuple[Any, ...], value: float) -> float:
    """Value at a place of a document; `value` where it has none."""
    node: Any = document
    for step in place:
        node = node[step] if isinstance(step, int) else node.get(step)
    return value if node is None else float(node)


def _with_tolerances(fitted: Fitted, sweep: dict[str, Any], draws: int) -> dict[str, Any]:
    """A sweep's table whose tolerances are draws of the ensemble, relative to the estimate."""
    require_single_draws(fitted.study)
    generator = np.random.default_rng([fitted.fit.seed, _SEED])
    picked = fitted.draws[generator.choice(len(fitted.weights), size=draws, p=fitted.weights)]
    tolerances = []
    for prior, estimate, numbers in zip(fitted.priors, fitted.estimate, picked.T, strict=True):
        relative = {"factor": numbers / estimate, "offset": numbers - estimate}.get(prior.draws, numbers)
        table = {"parameter": prior.parameter, "distribution": "listed", "draws": prior.draws}
        tolerances.append(table | {"values": tuple(relative.tolist())})
    without = {key: value for key, value in sweep.items() if key not in ("samples", "tolerances")}
    return without | {"tolerances": tuple(tolerances), "sampling": {"count": draws}}


def as_comment(fitted: Fitted) -> str:
    """Comment lines of TOML on what was fitted."""
    met = f"{fitted.met} of {len(fitted.points)} labels"
    lines = [f"# Fitted to {fitted.experiment.name}: {met}."]
    for prior, number, (low, high) in zip(fitted.priors, fitted.estimate, fitted.intervals(), strict=True):
        measured = " of the measured value" if prior.parameter in fitted.axes else ""
        nominal = nominal_value(fitted.study, prior.parameter)
        before = "" if measured or prior.draws == "value" else f" of {nominal:g}"
        lines.append(f"# {prior.parameter}: {prior.draws} {number:.6g} [{low:.4g}, {high:.4g}]{measured or before}")
    return "\n".join(lines) + "\n"
