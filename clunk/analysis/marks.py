"""Marks on maps: load ratios at which impacts appear as the backlash vanishes (report §3.2), and ridges."""

import numpy as np

from clunk.results.maps import Map
from clunk.study.arrays import Floats
from clunk.study.config import study_from_text
from clunk.study.study import replace_values


def thresholds_of(results: Map) -> list[float]:
    """Load ratios at which one more impact appears as the backlash vanishes, by all modes of the locked driveline.

    They end with the 32nd impact; with damping below 3 % there are more of them below a load ratio of 1000.

    Keys of which the results have one value take that value, all others the config's. There are no such load ratios
    where the load ratio is not swept or the load is no step, where shafts have friction, which is not linear, and for
    several lashes, which do not open one by one.
    """
    if results.lashes or "load.ratio" not in [axis.parameter for axis in results.axes if len(axis) > 1]:
        return []
    study = study_from_text(results.config, "the results file's config")
    if study.load.profile != "step" or any(shaft.friction for shaft in study.driveline.shafts):
        return []
    from clunk.simulation.small_gap import rigid_contact_thresholds  # takes 0.3 s, which other maps need not

    fixed = {axis.parameter: axis.values[0] for axis in results.parameters if len(axis) == 1}
    return rigid_contact_thresholds(replace_values(study, fixed), 32).tolist()


def ridge_of(values: Floats) -> Floats:
    """Index along the second axis of the largest value in each row of the first, where that is an interior maximum.

    values : (nx, ny); returns (nx,) float, NaN where the largest value is not positive, lies on the border of the map,
    beside a value that is not known, or within 0.1 % of either end's: on a plateau rounding would choose the place.
    """
    ridge = np.full(len(values), np.nan)
    for row, column in enumerate(values):
        if np.isnan(column).all():
            continue
        top = np.nanargmax(column)
        interior = 0 < top < len(column) - 1 and np.isfinite(column[[top - 1, top + 1]]).all()
        if interior and column[top] > 0.0 and not (column[[0, -1]] > 0.999 * column[top]).any():
            ridge[row] = top
    return ridge
