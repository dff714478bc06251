"""Curves of tens of thousands of points, thinned to what a screen shows."""

from __future__ import annotations

import numpy as np

from clunk.study.arrays import Floats


def thinned(time: Floats, values: Floats, begin: float, end: float, columns: int) -> tuple[Floats, Floats]:
    """The part of a curve between two times, with no more points than a screen tells apart.

    Each of `columns` equal spans of time keeps its first and last point and its extremes, so that no peak is lost and
    nothing moves by more than a span.

    Parameters
    ----------
    time, values : (M,) float64
        Time does not decrease.
    begin, end : float
        One point beyond each is kept, so that the line leaves the picture as it should.
    columns : int

    Returns
    -------
    time, values : (m,) float64, m at most 4 columns + 8
    """
    first = max(0, int(np.searchsorted(time, begin)) - 1)
    last = min(time.size, int(np.searchsorted(time, end, side="right")) + 1)
    time, values = time[first:last], values[first:last]
    if time.size <= 4 * columns or not end > begin:
        return time, values
    column = np.clip(np.floor((time - begin) * (columns / (end - begin))), -1, columns).astype(np.int64)
    starts = np.flatnonzero(np.diff(column, prepend=column[0] - 1))
    stops = np.append(starts[1:], time.size)
    by_value = np.lexsort((values, column))  # within each span ascending; spans stay where they are
    kept = np.unique(np.concatenate([starts, stops - 1, by_value[starts], by_value[stops - 1]]))
    return time[kept], values[kept]
