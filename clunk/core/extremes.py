"""Extremes and integrals of a polynomial over an interval that begins at zero."""

import numpy as np
import numpy.typing as npt

from clunk.core.jit import part

FloatArray = npt.NDArray[np.float64]

_NARROWEST = 2.0**-20  # of the interval: the extremes between are then those of the ends, to rounding
_HALVINGS = 30  # of an interval with a turn: to 1e-9 of it, the value there to the square of that
_ROUNDING = 1e-15  # relative: a polynomial that moves less is constant
NODES = 12  # of Gauss and Legendre: exact up to degree 23, and to rounding for the square of a series over a step
_FROM_MIDDLE, _WEIGHTS = np.polynomial.legendre.leggauss(NODES)
_PLACES = 0.5 + 0.5 * _FROM_MIDDLE  # of the interval


@part
def value_at(series: FloatArray, at: float) -> float:
    """Value of the polynomial with coefficients `series`, lowest order first."""
    value = 0.0
    for k in range(series.size - 1, -1, -1):
        value = value * at + series[k]
    return value


@part
def integral(series: FloatArray, length: float) -> float:
    """Integral of a polynomial from 0 to `length`."""
    total = 0.0
    for k in range(series.size - 1, -1, -1):
        total = (total + series[k] / (k + 1)) * length
    return total


@part
def integral_of_square(series: FloatArray, length: float, values: FloatArray) -> float:
    """Integral of a polynomial's square from 0 to `length`; `values` (NODES,) is scratch."""
    for n in range(NODES):
        values[n] = 0.0
    for k in range(series.size - 1, -1, -1):
        for n in range(NODES):
            values[n] = values[n] * (length * _PLACES[n]) + series[k]
    total = 0.0
    for n in range(NODES):
        total += _WEIGHTS[n] * values[n] ** 2
    return 0.5 * length * total


@part
def widened(series: FloatArray, length: float, low: float, high: float) -> tuple[float, float]:
    """The range from `low` to `high`, widened by all values of a polynomial from 0 to `length`.

    A part of the interval is done with where bounds of the polynomial lie in the range already, or where bounds of its
    slope or curvature leave room for one turn at most; else it is halved.

    Parameters
    ----------
    series : (K,) float64
        Coefficients, lowest order first; overwritten.
    """
    begin, width = 0.0, length
    low, high = min(low, series[0]), max(high, series[0])
    while begin < length:
        width = min(width, length - begin)
        reach, slope, curvature, power = 0.0, 0.0, 0.0, 1.0
        for k in range(1, series.size):
            power *= width
            term = abs(series[k]) * power
            reach += term
            slope += k * term
            curvature += k * (k - 1) * term
        if low <= series[0] - reach and series[0] + reach <= high:
            pass
        elif 2.0 * abs(series[1]) * width >= slope or reach <= _ROUNDING * abs(series[0]):  # no turn
            end = value_at(series, width)
            low, high = min(low, end), max(high, end)
        elif 4.0 * abs(series[2]) * width**2 >= curvature or width <= _NARROWEST * length:  # one turn at most
            turn, end = value_at(series, _turn(series, width)), value_at(series, width)
            low, high = min(low, turn, end), max(high, turn, end)
        else:
            width *= 0.5
            continue
        begin += width
        if begin < length:
            _shift(series, width)
            width *= 2.0
    return low, high


@part
def _turn(series: FloatArray, width: float) -> float:
    """Place where the slope of a polynomial changes its sign between 0 and `width`; 0 where it does not."""
    first, last, slope = 0.0, width, 0.0
    for k in range(series.size - 1, 0, -1):
        slope = slope * width + k * series[k]
    if (series[1] > 0.0) == (slope > 0.0):
        return 0.0
    for _ in range(_HALVINGS):
        at, slope = 0.5 * (first + last), 0.0
        for k in range(series.size - 1, 0, -1):
            slope = slope * at + k * series[k]
        if (slope > 0.0) == (series[1] > 0.0):
            first = at
        else:
            last = at
    return first


@part
def _shift(series: FloatArray, by: float) -> None:
    """Expand a polynomial about another place."""
    for k in range(series.size - 1):
        for j in range(series.size - 2, k - 1, -1):
            series[j] += by * series[j + 1]
