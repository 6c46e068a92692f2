"""Normalized innovation squared."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._jit import inlined, njit
from .._simd import LANES, lane, lanes_of, load, select, set_lane, splat, sqrt, store


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

    By Cholesky's factor: :math:`S = L L^T`, :math:`q = |L^{-1} z|^2`.
    """
    out = np.empty(innovation.shape[0])
    rows = (last - first + 1) * (last - first + 2) // 2
    part, belief = innovation[:, first:last], innovation_cov[:, first:last, first:last]
    if innovation.shape[0] == 1:
        _square_all(part, belief, np.empty(rows), out)
    else:
        _square_all(part, belief, np.empty((rows, LANES)), out)
    return out


@inlined
def _square_all(
    innovation: NDArray[np.float64],
    innovation_cov: NDArray[np.float64],
    work: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """All receivers, as many side by side as the lane array `work` has lanes. Its rows are the
    lower triangle of S, line after line, and z as one more line."""
    receivers, size = innovation.shape
    for group in range(0, receivers, lanes_of(work)):
        for k in range(lanes_of(work)):
            b, row = min(group + k, receivers - 1), 0
            for i in range(size):
                for j in range(i + 1):
                    set_lane(work, row, k, innovation_cov[b, i, j])
                    row += 1
            for i in range(size):
                set_lane(work, row + i, k, innovation[b, i])
        _square(work, size)
        for k in range(min(lanes_of(work), receivers - group)):
            out[group + k] = lane(work, 0, k)


@inlined
def _square(work: NDArray[np.float64], size: int) -> None:
    """Write the squares into row 0; the factor takes the place of S, its diagonal inverted."""
    total = splat(0.0, work)
    for i in range(size + 1):
        row = i * (i + 1) // 2
        for j in range(min(i + 1, size)):
            other = j * (j + 1) // 2
            value = load(work, row + j)
            for k in range(j):
                value -= load(work, row + k) * load(work, other + k)
            if i > j:
                store(work, row + j, value * load(work, other + j))
            else:
                sound = value > 0.0
                inverse = 1.0 / sqrt(select(sound, value, 1.0))
                store(work, row + j, select(sound, inverse, 0.0))
                total = select(sound, total, np.inf)
    last = size * (size + 1) // 2
    for i in range(size):
        total += load(work, last + i) * load(work, last + i)
    store(work, 0, total)
