"""The ridge of a map: for each load the backlash at which a quantity is largest."""

import numpy as np

from clunk.study.arrays import Floats


def ridge_of(values: Floats) -> Floats:
    """Index along the second axis of the largest value in each row of the first, where that is an interior maximum.

    values : (nx, ny); returns (nx,) float, NaN where the largest value is not positive, lies on the border of the map,
    beside a value that is not known, or within 0.1 % of either end's: on a plateau rounding would choose the place.
    """
    ridge = np.full(len(values), np.nan)
    for row, column in enumerate(values):
        if np.isnan(column).all():
            continue
        top = int(np.nanargmax(column))
        interior = 0 < top < len(column) - 1 and np.isfinite(column[[top - 1, top + 1]]).all()
        if interior and column[top] > 0.0 and not (column[[0, -1]] > 0.999 * column[top]).any():
            ridge[row] = top
    return ridge
