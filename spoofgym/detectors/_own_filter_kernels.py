"""Kernels of a filter beside the victim's: its covariance cycle, and what the victim takes back."""

from __future__ import annotations

import numpy as np

from ..core.compile import njit
from ._solution_separation_kernels import append_rows, substitute_row, whitened_response
from .base import BoolArray, FloatArray, cholesky_of_rows


@njit
def propagate_augmented(
    P: FloatArray, top: FloatArray, rest: FloatArray, half: FloatArray, driving: FloatArray
) -> None:
    r"""Go on by one interval in place, :math:`P \leftarrow \Phi (P + Q/2) \Phi^T + Q/2 + D`.

    `P` (B, N, N); `top` (B, s, c) rows of the transition of the first s states, 0 beyond c; `rest`
    (N - s, N - s) those of the others; `half` (B, s) diagonal of Q/2; `driving` (N - s, N - s) D.
    """
    states, s = P.shape[1], top.shape[1]
    rows, ends = np.empty(states, dtype=np.int64), np.empty(states, dtype=np.int64)
    at, of = np.empty(states * states, dtype=np.int64), np.empty(states * states)
    moved = np.empty((states, states))
    others, taken = append_rows(rest, s, 0, 0, rows, ends, at, of)
    for b in range(P.shape[0]):
        mine = P[b]
        count, _ = append_rows(top[b], 0, others, taken, rows, ends, at, of)
        for i in range(s):
            mine[i, i] += half[b, i]
        for side in range(2):
            start = 0
            for c in range(count):
                row = moved[c]
                row[:] = 0.0
                for e in range(start, ends[c]):
                    a, other = of[e], mine[at[e]]
                    for k in range(states):
                        row[k] += a * other[k]
                start = ends[c]
            for c in range(count):
                mine[rows[c]] = moved[c]
            if side == 0:
                for i in range(states):
                    for k in range(i):
                        mine[i, k], mine[k, i] = mine[k, i], mine[i, k]
        for i in range(s):
            mine[i, i] += half[b, i]
        for i in range(s, states):
            row, more = mine[i], driving[i - s]
            for k in range(s, states):
                row[k] += more[k - s]


@njit
def project_augmented(
    P: FloatArray,
    H: FloatArray,
    variance: FloatArray,
    visible: BoolArray,
    A: FloatArray,
    S: FloatArray,
) -> None:
    """Write A = H P (B, m, N) and S = H P H' + R (B, m, m), 0 and the identity where a row is not
    visible. `H` (B, m, N); `variance` (B, m)."""
    receivers, m, states = H.shape
    n = visible.shape[1]
    ends, at = np.empty(m, dtype=np.int64), np.empty(m * states, dtype=np.int64)
    for b in range(receivers):
        size = 0
        for r in range(m):
            row, design = A[b, r], H[b, r]
            row[:] = 0.0
            for j in range(states if visible[b, r % n] else 0):
                h = design[j]
                if h != 0.0:
                    at[size] = j
                    size += 1
                    other = P[b, j]
                    for k in range(states):
                        row[k] += h * other[k]
            ends[r] = size
        for r in range(m):
            start = 0
            for c in range(m):
                total = 0.0
                for e in range(start, ends[c]):
                    total += A[b, r, at[e]] * H[b, c, at[e]]
                S[b, r, c] = total
                start = ends[c]
            S[b, r, r] += variance[b, r] if visible[b, r % n] else 1.0


@njit
def correct_augmented(
    P: FloatArray,
    A: FloatArray,
    S: FloatArray,
    innovation: FloatArray,
    visible: BoolArray,
    enough: BoolArray,
    change: FloatArray,
) -> None:
    r"""Update in place, :math:`P \leftarrow P - A^T S^{-1} A`, where there are enough satellites.
    `change` (B, N) written: :math:`A^T S^{-1} z`, infinite where S is not positive definite."""
    receivers, m, states = A.shape
    rows, factor = np.empty(m, dtype=np.int64), np.empty((m, m))
    white, y = np.empty((m + 3, states)), np.empty(m)
    for b in range(receivers):
        change[b] = 0.0
        count = 0
        if enough[b]:
            count = cholesky_of_rows(S[b], visible[b], 0, m, rows, factor)
            if count < 0:
                change[b] = np.inf
        for i in range(count):
            mine = white[i]
            mine[:] = A[b, rows[i]]
            y[i] = innovation[b, rows[i]]
            substitute_row(factor, i, white, y)
            for k in range(states):
                change[b, k] += y[i] * mine[k]
        white[count : count + 3] = 0.0  # four rows at a time
        for j in range(states):
            row = P[b, j]
            for i in range(0, count, 4):
                u, v, w, x = white[i], white[i + 1], white[i + 2], white[i + 3]
                uj, vj, wj, xj = u[j], v[j], w[j], x[j]
                for k in range(j, states):
                    row[k] -= uj * u[k] + vj * v[k] + wj * w[k] + xj * x[k]
            for k in range(j):
                row[k] = P[b, k, j]


@njit
def compute_feedback(
    P: FloatArray,
    H: FloatArray,
    innovation: FloatArray,
    S: FloatArray,
    visible: BoolArray,
    enough: BoolArray,
    feedback: FloatArray,
) -> None:
    r"""Write what each measurement moves the victim's states by, (B, s, m): the columns of its gain
    :math:`P H^T S^{-1}` times the innovations, to be multiplied with their weights."""
    receivers, m, states = H.shape
    rows, factor = np.empty(m, dtype=np.int64), np.empty((m, m))
    response, white = np.empty((m, states)), np.empty(m)
    for b in range(receivers):
        feedback[b] = 0.0
        if not enough[b]:
            continue
        z, seen = innovation[b], visible[b]
        count = whitened_response(P[b], H[b], z, S[b], seen, rows, factor, response, white)
        for i in range(count - 1, -1, -1):
            mine = response[i]
            for l in range(i + 1, count):
                f, other = factor[l, i], response[l]
                for k in range(states):
                    mine[k] -= f * other[k]
            for k in range(states):
                mine[k] *= factor[i, i]
            for k in range(states):
                feedback[b, k, rows[i]] = mine[k] * z[rows[i]]
