"""A quartic on one step: detection of a zero, its resolution, the extremes, each alone.

The reference is the companion matrix (numpy.roots). A simple zero that lies at least `APART` from the others is known
to about 1e-16 / APART^3 of the interval, by that matrix as by the quartic's own rounding; 1e-6 has room for both.
"""

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st

from clunk.core.rk4.quartic import extremes, first_negative

APART = 1e-3
COEFFICIENT = st.floats(-1.0, 1.0).map(lambda c: round(c, 6))  # no denormals: their products underflow
COEFFICIENTS = st.tuples(*[COEFFICIENT] * 5)
LENGTH = st.sampled_from([1.0, 0.3, 2.5])


def value(coefficients, s):
    return np.polynomial.polynomial.polyval(s, coefficients)


def rounding(coefficients, length):
    """What Horner's rule can be off by: 8 roundings of terms no larger than this sum."""
    return 8 * np.finfo(float).eps * np.dot(np.abs(coefficients), length ** np.arange(len(coefficients)))


def from_roots(roots, scale):
    """Ascending coefficients of the quartic with these zeros."""
    return scale * np.real(np.poly(roots))[::-1]


def real_zeros(coefficients, length):
    """Zeros in (0, length), by the companion matrix."""
    roots = np.roots(np.asarray(coefficients)[::-1])
    real = roots[np.abs(roots.imag) < 1e-9].real
    return np.sort(real[(real > 0.0) & (real < length)])


FOUR_ZEROS = st.tuples(st.floats(-0.5, 1.0), *[st.floats(2 * APART, 0.7)] * 3).map(np.cumsum)


@given(FOUR_ZEROS, st.sampled_from([1.0, -1.0, 1e-6, -1e6]))
def test_the_first_crossing_is_that_of_the_companion_matrix(roots, scale):
    assume(np.all(np.abs(roots) > APART))
    assume(np.all(np.abs(roots - 1.0) > APART))
    coefficients = from_roots(roots, scale)
    found = first_negative(coefficients, 1.0)
    if coefficients[0] < 0.0:
        assert found == 0.0
        return
    inside = real_zeros(coefficients, 1.0)
    expected = inside[0] if inside.size else -1.0
    assert found == pytest.approx(expected, abs=1e-6)


@given(COEFFICIENTS, LENGTH)
def test_nothing_is_negative_before_the_first_crossing(coefficients, length):
    found = first_negative(coefficients, length)
    end = length if found < 0.0 else found
    samples = value(coefficients, np.linspace(0.0, end, 401))
    assert found == 0.0 or samples.min() >= -rounding(coefficients, length)


@pytest.mark.parametrize("margin", [1e-6, 1e-10, 1e-14])
def test_a_tangency_missed_or_cut_by_a_margin_is_told_apart(margin):
    """And one at 1/2, which is exact in floating point, is no crossing."""
    parabola = (0.25, -1.0, 1.0, 0.0, 0.0)
    assert first_negative(parabola, 1.0) == -1.0
    assert first_negative((parabola[0] + margin, *parabola[1:]), 1.0) == -1.0
    cut = first_negative((parabola[0] - margin, *parabola[1:]), 1.0)
    # zeros at 1/2 ± sqrt(margin); the relative error of the margin itself is eps / margin
    assert cut == pytest.approx(0.5 - margin**0.5, abs=margin**0.5 * (1e-9 + 1e-16 / margin))


@given(COEFFICIENTS, LENGTH)
def test_the_extremes_bound_the_polynomial_and_are_taken(coefficients, length):
    largest, smallest = extremes(coefficients, length)
    inner = np.roots(np.polynomial.polynomial.polyder(coefficients)[::-1]) if any(coefficients[1:]) else np.empty(0)
    inner = inner.real[(np.abs(inner.imag) < 1e-6) & (inner.real > 0.0) & (inner.real < length)]
    exact = value(coefficients, np.concatenate([[0.0, length], inner]))
    slack = rounding(coefficients, length)
    assert largest == pytest.approx(exact.max(), abs=slack)  # a zero of p' off by d moves p by d² only
    assert smallest == pytest.approx(exact.min(), abs=slack)
    samples = value(coefficients, np.linspace(0.0, length, 401))
    assert largest >= samples.max() - slack
    assert smallest <= samples.min() + slack
