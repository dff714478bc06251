"""How alike several quantities order the cells of a map, and where each of them is largest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import rankdata

from clunk.analysis.ridge import ridge_of
from clunk.results.quantities import Quantity
from clunk.results.regimemap import Results
from clunk.study.arrays import Floats

_ROWS = 5  # values of the first axis at which ridges are told


@dataclass(frozen=True, eq=False)
class Ranks:
    """Rank correlations and ridges of the quantities of one map.

    quantities : those that tell how hard impacts are, and are defined and not constant in the cells
    cells : number of cells that are compared: those with a primary impact in which all quantities are defined
    correlation : (k, k), Spearman's rank correlation of each two
    places : (r,) values of a map's first axis, from the least to the greatest
    ridges : (k, r), value of its second axis at which a quantity is largest there, NaN where it is so at an end; of
        maps of another number of axes r is 0
    """

    quantities: tuple[Quantity, ...]
    cells: int
    correlation: Floats
    places: Floats
    ridges: Floats


def ranks_of(results: Results) -> Ranks:
    """Rank correlations and ridges of severity, approach velocity and what was measured, over a map of one lash."""
    names = ["severity", "approach_velocity", *results.measured_quantities]
    quantities = [results.quantities[name] for name in names if not results.quantities[name].dimension]
    struck = (results.status == 0) & (results.primary_impacts > 0)
    quantities = [each for each in quantities if np.isfinite(results.values(each.name)[struck]).any()]
    known = struck & np.all([np.isfinite(results.values(each.name)) for each in quantities], axis=0)
    quantities = [each for each in quantities if len(np.unique(results.values(each.name)[known])) > 1]
    values = np.array([results.values(each.name)[known] for each in quantities]).reshape(len(quantities), -1)
    correlation = np.atleast_2d(np.corrcoef(rankdata(values, axis=1))) if len(quantities) else np.zeros((0, 0))
    rows = np.zeros(0, np.intp)
    if len(results.shape) == 2:
        rows = np.unique(np.linspace(0, results.shape[0] - 1, _ROWS + 1).round().astype(np.intp))[1:]
    ridges = np.full((len(quantities), rows.size), np.nan)
    for k, each in enumerate(quantities if rows.size else ()):
        ridge = ridge_of(results.values(each.name)[rows])
        inside = np.isfinite(ridge)
        ridges[k, inside] = results.axes[1].values[ridge[inside].astype(np.intp)]
    places = results.axes[0].values[rows]
    return Ranks(tuple(quantities), int(known.sum()), correlation, places, ridges)
