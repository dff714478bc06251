"""Each operation of the lanes against numpy's, with NaN, infinities and zeros of either sign among the numbers."""

from fractions import Fraction

import numpy as np
import pytest

from clunk.core.jit import compiled
from clunk.core.lanes import vectors
from clunk.core.lanes.vectors import WIDTH

RANDOM = np.random.default_rng(1)
NAN, INF = np.nan, np.inf
# as many as there are lanes, eight or sixteen
A = np.array([[*RANDOM.normal(size=7), 1.0, 2.0, NAN, 3.0, NAN, INF, -INF, 0.0, -0.0]])[:, -WIDTH:]
B = np.array([[*RANDOM.normal(size=7), 1.0, NAN, 2.0, INF, NAN, INF, INF, -0.0, 2.0]])[:, -WIDTH:]
ALL = (1 << WIDTH) - 1
BITS = (0, 1, ALL, 1 << WIDTH - 1, 0b1010_0110_0000_1001 & ALL)


@compiled
def fuse(a, b, c, x, results):
    p, q, r = vectors.load(a, 0), vectors.load(b, 0), vectors.load(c, 0)
    vectors.store(results, 0, vectors.fused(p, q, r))
    vectors.store(results, 1, vectors.fused(x, q, r))
    vectors.store(results, 2, vectors.fused(p, x, r))
    vectors.store(results, 3, vectors.fused(p, q, x))


@compiled
def apply(a, b, x, bits, results):
    p, q = vectors.load(a, 0), vectors.load(b, 0)
    vectors.store(results, 0, vectors.larger(p, q))
    vectors.store(results, 1, vectors.smaller(p, q))
    vectors.store(results, 2, vectors.magnitude(p))
    vectors.store(results, 3, vectors.root(p))
    vectors.store(results, 4, -p)
    vectors.store(results, 5, vectors.splat(x))
    vectors.store(results, 6, vectors.choose(bits, p, q))
    vectors.store(results, 7, vectors.choose(bits, p, x))
    vectors.store(results, 8, vectors.choose(bits, x, q))
    vectors.store(results, 9, vectors.choose(bits, x, -x))


def holds(bits):
    """(WIDTH,): of each lane its bit."""
    return np.array([bits >> k & 1 for k in range(WIDTH)], bool)


def same(lanes, expected):
    """Bit by bit, but for the kind of NaN."""
    return np.array_equal(lanes, expected, equal_nan=True) and np.array_equal(
        np.signbit(lanes[~np.isnan(lanes)]), np.signbit(expected[~np.isnan(expected)])
    )


@pytest.mark.parametrize("bits", [*BITS, ~BITS[-1], -1, 1 << WIDTH])  # what is beyond the lanes does not matter
def test_functions_are_those_of_each_lane(bits):
    """Of two, the second is larger and smaller where either is NaN."""
    results, x = np.zeros((10, WIDTH)), 0.7
    apply(A, B, x, bits, results)
    with np.errstate(invalid="ignore"):
        expected = [np.where(A[0] > B[0], A[0], B[0]), np.where(A[0] < B[0], A[0], B[0])]
        expected += [np.abs(A[0]), np.sqrt(A[0]), -A[0], np.full(WIDTH, x)]
    expected += [np.where(holds(bits), *pair) for pair in ((A[0], B[0]), (A[0], x), (x, B[0]), (x, -x))]
    assert all(same(*pair) for pair in zip(results, expected, strict=True))


def test_a_product_and_a_sum_are_rounded_once():
    """Where all but the rounding of the product cancels, as elsewhere; one of the three may be a number."""
    p, q = RANDOM.normal(size=(2, 1, WIDTH))
    for r in (RANDOM.normal(size=(1, WIDTH)), -p * q):
        results, x = np.zeros((4, WIDTH)), 0.7
        fuse(p, q, r, x, results)
        for found, sides in zip(results, ((p, q, r), (x, q, r), (p, x, r), (p, q, x)), strict=True):
            numbers = [map(Fraction, np.broadcast_to(side, (1, WIDTH))[0].tolist()) for side in sides]
            assert found.tolist() == [float(a * b + c) for a, b, c in zip(*numbers, strict=True)]
    assert np.any(results[0] != 0.0)  # as the product rounded by itself, less that, would be
