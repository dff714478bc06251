"""Maps of a fit over the measured parameters: of the config as it is, and of the best candidate."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from clunk.analysis.comparison import codes_among
from clunk.analysis.fitted import Fitted
from clunk.analysis.fittedstudy import fitted_study
from clunk.results.regimemap import Results
from clunk.study.axes import ResultAxis
from clunk.study.errors import ClunkError
from clunk.study.keys import key_at
from clunk.study.parameters import located
from clunk.study.sweeps import Axis, Sweep
from clunk.sweeping.sweep import sweep

WHICH = ("nominal", "fitted")
_COUNT = 81  # values of an axis that the config does not sweep
_BEYOND = 0.15  # of the measured span, on either side of it


class FitMapError(ClunkError):
    """A fit of which no map over two parameters can be made; its text is one sentence for the user."""


def fit_maps(fitted: Fitted, workers: int | None = None) -> Results:
    """Map of the two measured parameters, as they were measured, before and after the fit along a first axis, `fit`.

    Raises FitMapError unless two parameters were measured, each at two values or more.
    """
    axes = tuple(_axis(fitted, k) for k in range(len(fitted.axes)) if np.ptp(fitted.points[:, k]) > 0.0)
    if len(axes) != 2:
        raise FitMapError(f"A map has two measured parameters that vary; {fitted.experiment.name} has {len(axes)}.")
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
