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
from ._own_filter_kernels import add_squares, as_vectors, combine_rows, mirror, propagate_wide
from ._solution_separation_kernels import append_rows, compute_age, propagate_bank
from .base import FloatArray, IntArray


@njit
def move_anchor(
    age: IntArray, reach: FloatArray, since: FloatArray, s: FloatArray, V: FloatArray
) -> None:
    """Let solutions catch up, and the anchor be here; those of the age 1 at the next epoch restart.
    `age` (J,); `reach`, `since`, `s`, `V` of one receiver as of `advance_anchored`."""
    d, bank = s.shape
    rows, ends = np.empty(d, dtype=np.int64), np.empty(d, dtype=np.int64)
    at, of = np.empty(d * d, dtype=np.int64), np.empty(d * d)
    moved, shifted = np.empty((d, d * bank)), np.empty((d, bank))
    count, _ = append_rows(reach[:, :d], 0, 0, 0, rows, ends, at, of)
    propagate_bank(V, s, count, rows, ends, at, of, moved, shifted)
    for j in range(bank):
        keep = age[j] != 1
        for i in range(d):
            s[i, j] = s[i, j] + since[i, d] if keep else 0.0
            for k in range(d):
                V[i, k, j] = V[i, k, j] + since[min(i, k), max(i, k)] if keep else 0.0
    for i in range(d):
        for k in range(d + 1):
            since[i, k] = 0.0
            reach[i, k] = 1.0 if i == k else 0.0


@njit
def locate_bank(
    reach: FloatArray,
    since: FloatArray,
    s: FloatArray,
    V: FloatArray,
    sums: FloatArray,
    place: FloatArray,
    spread: FloatArray,
) -> None:
    """Write `place` (3, J) and `spread` (3, 3, J): separations of position, and covariances. `V` as
    2 x 2 blocks, those off the diagonal once for two; d is even; `sums` (3, d J) scratch."""
    d, bank = s.shape
    flat = V.reshape((d, d * bank))
    sums[:] = 0.0
    for i in range(0, d, 2):
        upper, lower, first, last = flat[i], flat[i + 1], i * bank, (i + 2) * bank
        for a in range(3):
            x, y, total = reach[POSITION + a, i], reach[POSITION + a, i + 1], sums[a]
            for k in range(first, last):
                total[k] += x * upper[k] + y * lower[k]
            x, y = 2.0 * x, 2.0 * y
            for k in range(last, d * bank):
                total[k] += x * upper[k] + y * lower[k]
    for a in range(3):
        row = POSITION + a
        for j in range(bank):
            place[a, j] = since[row, d]
            for c in range(3):
                spread[a, c, j] = since[min(row, POSITION + c), max(row, POSITION + c)]
    for a in range(3):
        for k in range(d):
            part = 0.5 * reach[POSITION + a, k]
            for j in range(bank):
                place[a, j] += reach[POSITION + a, k] * s[k, j]
            for c in range(3):
                one, other, total = spread[a, c], spread[c, a], sums[c, k * bank : (k + 1) * bank]
                for j in range(bank):
                    one[j] += part * total[j]
                for j in range(bank):
                    other[j] += part * total[j]


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
    `epochs` (B,) so far, `separation` (B, d, J) and `covariance` (B, d, d, J) at the anchor, and in
    wide rows (B, d, W) `reach`, the transition since then, and `since`, W with sigma behind it.
    Written: `place` (B, 3, J), `spread` (B, 3, 3, J).
    """
    d, bank = separation.shape[1:]
    m, width = white.shape[1], reach.shape[2]
    wide = width // LANES
    M, moved, turned = (
        np.zeros((d, width)),
        np.zeros((d, width)),
        np.zeros((d, width)),
    )
    corner, A, sums = np.zeros((1, width)), np.zeros((m, width)), np.empty((3, d * bank))
    rows, ends = np.empty(d, dtype=np.int64), np.empty(d, dtype=np.int64)
    at, of = np.empty(d * d, dtype=np.int64), np.empty(d * d)
    age = np.empty(bank, dtype=np.int64)
    others, taken = append_rows(rest, top.shape[1], 0, 0, rows, ends, at, of)
    for b in receivers:
        s, V, reached, mine = separation[b], covariance[b], reach[b], since[b]
        if epochs[b] % spacing == 0:
            for j in range(bank):
                age[j] = compute_age(epochs[b], firsts[j], periods[j])
            move_anchor(age, reached, mine, s, V)
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
        propagate_wide(M, d, count, rows, ends, at, of, moved, turned, corner)
        for i in range(counts[b]):
            for k in range(d + 1):
                A[i, k] = white[b, i, k]
        add_squares(1.0, A, counts[b], M)
        for i in range(d):
            for k in range(i, d + 1):
                mine[i, k] = M[i, k]
            if counts[b] < 0:
                mine[i, d] = np.inf
        locate_bank(reached, mine, s, V, sums, place[b], spread[b])
        epochs[b] += 1
