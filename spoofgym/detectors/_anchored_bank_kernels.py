r"""Kernels of a bank of coasting solutions that moves on at its restarts alone.

All its solutions start at epochs of one grid. Since the last of them, the anchor, all have gone the
same way, so that with a solution :math:`(\sigma, W)` that starts there, and
:math:`\Lambda = \Phi_k \cdots \Phi_{a + 1}`,

.. math:: s_k = \Lambda s_a + \sigma_k, \qquad V_k = \Lambda V_a \Lambda^T + W_k,

of which the rows of the position are wanted. This reads half of V at an epoch, and writes none.
"""

from __future__ import annotations

import numpy as np

from ..core.compile import njit
from ..core.simd import LANES
from ..receiver.states import POSITION
from ._own_filter_kernels import (
    as_vectors,
    combine_rows,
    mirror,
    propagate_wide,
    subtract_squares,
)
from ._solution_separation_kernels import append_rows, compute_age, propagate_bank
from .base import FloatArray, IntArray


@njit
def move_anchor(
    age: IntArray, reach: FloatArray, since: FloatArray, s: FloatArray, half: FloatArray
) -> None:
    """Let solutions catch up, and the anchor be here; those of the age 1 at the next epoch restart.
    `age` (J,); `reach`, `since`, `s`, `half` of one receiver as of `advance_anchored`."""
    d, bank = s.shape
    rows, ends = np.empty(d, dtype=np.int64), np.empty(d, dtype=np.int64)
    at, of = np.empty(d * d, dtype=np.int64), np.empty(d * d)
    moved, shifted = np.empty((d, d * bank)), np.empty((d, bank))
    count, _ = append_rows(reach[:, :d], 0, 0, 0, rows, ends, at, of)
    for i in range(d):
        for k in range(i + 1):
            same = 2.0 if i // 2 == k // 2 else 1.0
            for j in range(bank):
                half[i, k, j] = half[k, i, j] = same * half[k, i, j]
    propagate_bank(half, s, count, rows, ends, at, of, moved, shifted)
    for i in range(d):
        for j in range(bank):
            s[i, j] = s[i, j] - since[i, d] if age[j] != 1 else 0.0
        for k in range(d):
            same, more = 0.5 if i // 2 == k // 2 else 1.0, since[min(i, k), max(i, k)]
            for j in range(bank):
                half[i, k, j] = same * (half[i, k, j] - more) if age[j] != 1 else 0.0
    for i in range(d):
        for k in range(d + 1):
            since[i, k] = 0.0
            reach[i, k] = 1.0 if i == k else 0.0


@njit
def add_rows(x: float, row: FloatArray, y: float, other: FloatArray, total: FloatArray) -> None:
    for k in range(len(total)):
        total[k] += x * row[k] + y * other[k]


@njit
def locate_bank(
    reach: FloatArray,
    since: FloatArray,
    s: FloatArray,
    half: FloatArray,
    sums: FloatArray,
    place: FloatArray,
    spread: FloatArray,
) -> None:
    """Write `place` (3, J) and `spread` (3, 3, J): separations of position, and covariances. `sums`
    (3, d J): scratch."""
    d, bank = s.shape
    flat, parts = half.reshape((d, d * bank)), sums.reshape((3, d, bank))
    sums[:] = 0.0
    for i in range(0, d, 2):
        upper, lower = flat[i, i * bank :], flat[i + 1, i * bank :]
        for a in range(3):
            x, y = reach[POSITION + a, i], reach[POSITION + a, i + 1]
            add_rows(x, upper, y, lower, sums[a, i * bank :])
    for j in range(bank):
        for a in range(3):
            row, total = POSITION + a, 0.0
            for k in range(d):
                total += reach[row, k] * s[k, j]
            place[a, j] = total - since[row, d]
            for c in range(a, 3):
                column, total = POSITION + c, 0.0
                for k in range(d):
                    total += reach[row, k] * parts[c, k, j] + reach[column, k] * parts[a, k, j]
                spread[a, c, j] = spread[c, a, j] = total - since[row, column]


@njit
def advance_anchored(
    receivers: IntArray,
    top: FloatArray,
    rest: FloatArray,
    white: FloatArray,
    counts: IntArray,
    spacing: int,
    firsts: IntArray,
    periods: IntArray,
    epochs: IntArray,
    separation: FloatArray,
    covariance: FloatArray,
    reach: FloatArray,
    since: FloatArray,
    place: FloatArray,
    spread: FloatArray,
) -> None:
    """Advance the solutions of some receivers by one epoch of a filter beside the victim's.

    `top`, `white`, `counts` as of `advance_filters`; `rest` rows of the transition of the other
    inertial states; `spacing` of the grid of starts, `firsts`, `periods` (J,) [epochs]. Memory:
    `epochs` (B,) so far, at the anchor `separation` (B, d, J) and `covariance` (B, d, d, J), of
    which the upper half counts, with half of each 2 x 2 block on the diagonal (d is even); in wide rows (B, d, W) `reach`, the transition since then, and `since`, -W with -sigma behind it.
    Written: `place` (B, 3, J), `spread` (B, 3, 3, J).
    """
    d, bank = separation.shape[1:]
    m, width = white.shape[1], reach.shape[2]
    wide = width // LANES
    M, moved, A = np.zeros((d, width)), np.zeros((d, width)), np.zeros((m, width))
    sums = np.empty((3, d * bank))
    rows, ends = np.empty(d, dtype=np.int64), np.empty(d, dtype=np.int64)
    at, of = np.empty(d * d, dtype=np.int64), np.empty(d * d)
    age = np.empty(bank, dtype=np.int64)
    others, taken = append_rows(rest, top.shape[1], 0, 0, rows, ends, at, of)
    for b in receivers:
        s, half, reached, mine = separation[b], covariance[b], reach[b], since[b]
        if epochs[b] % spacing == 0:
            for j in range(bank):
                age[j] = compute_age(epochs[b], firsts[j], periods[j])
            move_anchor(age, reached, mine, s, half)
        count, _ = append_rows(top[b], 0, others, taken, rows, ends, at, of)
        first = 0
        for c in range(count):
            combine_rows(
                as_vectors(reached), wide, at, of, first, ends[c], as_vectors(moved), c
            )
            first = ends[c]
        for c in range(count):
            for k in range(d):
                reached[rows[c], k] = moved[c, k]
        mirror(mine, M)
        for i in range(d):
            M[i, d] = mine[i, d]
        propagate_wide(M, d, count, rows, ends, at, of, moved)
        for i in range(counts[b]):
            for k in range(d + 1):
                A[i, k] = white[b, i, k]
        subtract_squares(A, counts[b], M)
        for i in range(d):
            for k in range(i, d + 1):
                mine[i, k] = M[i, k]
            if counts[b] < 0:
                mine[i, d] = np.inf
        locate_bank(reached, mine, s, half, sums, place[b], spread[b])
        epochs[b] += 1
