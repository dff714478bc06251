"""Matrix exponentials by numpy alone, of many matrices at once."""

import numpy as np

from clunk.core.arrays import FloatArray

_TERMS = 20  # of the power series, up to a norm of 1/2: the next one is 4e-25


def exponentials(matrices: FloatArray, sizes: FloatArray) -> FloatArray:
    """exp(matrix), by the power series of a part of it that is squared again and again: (…, Z, Z).

    Parameters
    ----------
    matrices : (…, Z, Z) float64
    sizes : (…,) float64
        A norm of each, or as much: so many halvings make it 1/2.
    """
    squarings = np.maximum(0, np.ceil(np.log2(np.maximum(2.0 * sizes, 1e-300))).astype(np.int64))[..., None, None]
    part = matrices * np.ldexp(1.0, -squarings)
    total = power = np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape)
    for k in range(1, _TERMS):
        power = power @ part / k
        total = total + power
    for k in range(squarings.max(initial=0)):
        total = np.where(squarings > k, total @ total, total)
    return np.asarray(total, np.float64)
