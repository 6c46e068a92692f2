"""Normalized innovation squared."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .._jit import njit


@njit
def normalized_innovation_squared(
    innovation: NDArray[np.float64],
    innovation_cov: NDArray[np.float64],
    first: int,
    last: int,
) -> NDArray[np.float64]:
    r"""Normalized innovation squared of a range of rows.

    .. math:: q = z^T S^{-1} z

    `innovation` (B, m); `innovation_cov` (B, m, m); returns (B,) q; chi-square distributed with one
    degree of freedom for each visible row where the filter's belief is right, and infinite where S
    is not positive definite.

    Notes
    -----
    By Cholesky's factor: :math:`S = L L^T`, :math:`q = |L^{-1} z|^2`.
    """
    receivers, size = innovation.shape[0], last - first
    factor = np.empty((size, size))
    y = np.empty(size)
    out = np.empty(receivers)
    for b in range(receivers):
        total = 0.0
        for i in range(size):
            for j in range(i + 1):
                value = innovation_cov[b, first + i, first + j]
                for k in range(j):
                    value -= factor[i, k] * factor[j, k]
                if i > j:
                    factor[i, j] = value * factor[j, j]
                elif value > 0.0:
                    factor[i, i] = 1.0 / math.sqrt(value)  # the inverse: no division below
                else:
                    total = np.inf
                    factor[i, i] = 0.0
            value = innovation[b, first + i]
            for k in range(i):
                value -= factor[i, k] * y[k]
            y[i] = value * factor[i, i]
            total += y[i] * y[i]
        out[b] = total
    return out
