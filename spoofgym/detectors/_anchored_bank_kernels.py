r"""Kernels of a bank of coasting solutions that moves on at its restarts alone.

All its solutions start at epochs of one grid. Since the last of them, the anchor, all have gone the
same way, so that with a solution :math:`(\sigma, W)` that starts there, and
:math:`\Lambda = \Phi_k \cdots \Phi_{a + 1}`,

.. math:: s_k = \Lambda s_a + \sigma_k, \qquad V_k = \Lambda V_a \Lambda^T + W_k,

of which the rows of the position are wanted: an epoch reads half of V, and writes none.
"""

from __future__ import annotations

import numpy as np

from ..core.compile import njit
from ..core.simd import LANES, load, splat, store
from ..receiver.states import POSITION
from ._own_filter_kernels import (
    as_vectors,
    combine_rows,
    mirror,
    propagate_wide,
    scratch_shape,
    subtract_squares,
    wide_shape,
)
from ._solution_separation_kernels import append_rows, compute_age, propagate_bank
from .base import BoolArray, FloatArray, IntArray


def anchored_shapes(bank: int, d: int) -> dict[str, tuple[int, ...]]:
    """What is remembered of J solutions of d states, as of `advance_anchored`."""
    groups, wide = -(-bank // LANES), wide_shape(d)
    return {
        "separation": (groups, d, LANES),
        "covariance": (groups, d * (d + 1) // 2, LANES),
        "reach": wide,
        "since": wide,
        "place": (3, groups * LANES),
        "spread": (3, 3, groups * LANES),
    }


@njit
def move_anchor(
    restart: BoolArray, reach: FloatArray, since: FloatArray, s: FloatArray, V: FloatArray
) -> None:
    """Let eight solutions catch up, so that the anchor is here, and those that `restart` (8,) be 0.
    `reach`, `since` of one receiver, `s` (d, 8), `V` (d (d + 1) / 2, 8): `advance_anchored`."""
    d = len(s)
    rows, ends = np.empty(d, dtype=np.int64), np.empty(d, dtype=np.int64)
    at, of = np.empty(d * d, dtype=np.int64), np.empty(d * d)
    moved, shifted = np.empty((d, d * LANES)), np.empty((d, LANES))
    whole, n = np.empty((d, d, LANES)), 0
    for i in range(d):
        for k in range(i + 1):
            for j in range(LANES):
                whole[i, k, j] = whole[k, i, j] = V[n, j]
            n += 1
    count, _ = append_rows(reach[:d, :d], 0, 0, 0, rows, ends, at, of)
    propagate_bank(whole, s, count, rows, ends, at, of, moved, shifted)
    n = 0
    for i in range(d):
        for j in range(LANES):
            s[i, j] = 0.0 if restart[j] else s[i, j] - since[i, d]
        for k in range(i + 1):
            for j in range(LANES):
                V[n, j] = 0.0 if restart[j] else whole[i, k, j] - since[k, i]
            n += 1


@njit
def locate_bank(
    reach: FloatArray,
    since: FloatArray,
    s: FloatArray,
    V: FloatArray,
    sums: FloatArray,
    groups: int,
    g: int,
    place: FloatArray,
    spread: FloatArray,
) -> None:
    """Write what eight solutions have of `place` and `spread`, lane arrays in rows of `groups`, of
    which theirs is `g`. `s`, `V` as of `move_anchor`; `sums` (3, 8) scratch."""
    d, n = len(s), 0
    x, y, z = reach[POSITION], reach[POSITION + 1], reach[POSITION + 2]
    for a in range(3):
        store(place, a * groups + g, -since[POSITION + a, d])
        for c in range(3):
            other = -since[POSITION + min(a, c), POSITION + max(a, c)]
            store(spread, (3 * a + c) * groups + g, other)
    for k in range(d):
        first = second = third = splat(0.0, sums)
        for i in range(k):
            v = load(V, n + i)
            first += x[i] * v
            second += y[i] * v
            third += z[i] * v
        v = 0.5 * load(V, n + k)  # the diagonal counts once for two
        first, second, third = first + x[k] * v, second + y[k] * v, third + z[k] * v
        n += k + 1
        store(sums, 0, first)
        store(sums, 1, second)
        store(sums, 2, third)
        for a in range(3):
            mine = reach[POSITION + a, k]
            row = a * groups + g
            store(place, row, load(place, row) + mine * load(s, k))
            for c in range(a, 3):
                more = reach[POSITION + c, k] * load(sums, a) + mine * load(sums, c)
                row = (3 * a + c) * groups + g
                store(spread, row, load(spread, row) + more)
    for a in range(3):
        for c in range(a):
            store(spread, (3 * a + c) * groups + g, load(spread, (3 * c + a) * groups + g))


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
    `epochs` (B,) so far; at the anchor, eight solutions after the other, `separation` (B, G, d, 8)
    and the lower half of `covariance` (B, G, d (d + 1) / 2, 8); in wide rows (B, d, W) `reach`, the
    transition since then, and `since`, -W with -sigma behind it.
    Written: `place` (B, 3, 8 G), `spread` (B, 3, 3, 8 G).
    """
    groups, d = separation.shape[1:3]
    m, width, wide = white.shape[1], reach.shape[2], reach.shape[2] // LANES
    moved, A = np.zeros(scratch_shape(d, width)), np.zeros((m, width))
    tall = moved.shape[1] // LANES
    sums, restart = np.empty((3, LANES)), np.zeros(groups * LANES, dtype=np.bool_)
    rows, ends = np.empty(d, dtype=np.int64), np.empty(d, dtype=np.int64)
    at, of = np.empty(d * d, dtype=np.int64), np.empty(d * d)
    others, taken = append_rows(rest, top.shape[1], 0, 0, rows, ends, at, of)
    for b in receivers:
        reached, mine = reach[b], since[b]
        if epochs[b] % spacing == 0:
            for j in range(len(firsts)):
                restart[j] = compute_age(epochs[b], firsts[j], periods[j]) == 1
            for g in range(groups):
                these = restart[g * LANES : (g + 1) * LANES]
                move_anchor(these, reached, mine, separation[b, g], covariance[b, g])
            for i in range(d):
                for k in range(width):
                    mine[i, k] = 0.0
                    reached[i, k] = 1.0 if i == k else 0.0
        count, _ = append_rows(top[b], 0, others, taken, rows, ends, at, of)
        first, R, X = 0, as_vectors(reached), as_vectors(moved)
        for c in range(count):
            combine_rows(R, wide, at, of, first, ends[c], X, c * tall)
            first = ends[c]
        for c in range(count):
            r = rows[c]
            for k in range(width):
                reached[r, k] = moved[c, k]
        mirror(mine, d)
        propagate_wide(mine, d, count, rows, ends, at, of, moved)
        for i in range(counts[b]):
            for k in range(d + 1):
                A[i, k] = white[b, i, k]
        subtract_squares(A, counts[b], mine)
        if counts[b] < 0:
            for i in range(d):
                mine[i, d] = np.inf
        placed, spreading = as_vectors(place[b]), as_vectors(spread[b])
        for g in range(groups):
            s, V = separation[b, g], covariance[b, g]
            locate_bank(reached, mine, s, V, sums, groups, g, placed, spreading)
        epochs[b] += 1
