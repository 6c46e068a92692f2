"""Kernels of a filter beside the victim's: its covariance cycle, and what the victim takes back.

A symmetric matrix is worked on in *wide* rows, whose columns are filled up with zeros to pairs of
vectors. Of what is remembered of it the upper half counts. In the column behind its last one stands
an error with this covariance, which so goes on, and is corrected, as the covariance is.
"""

from __future__ import annotations

import math

import numpy as np

from ..core.compile import njit
from ..core.simd import LANES, load_pair, splat, store
from ..receiver._augmented_kernels import append_entry, append_signals
from ..receiver.augmented import FIRST
from ..receiver.states import CLOCK_BIAS, CLOCK_DRIFT, POSITION, STATES, VELOCITY
from ._solution_separation_kernels import (
    SINGULAR,
    append_rows,
    horizontal_axes,
    substitute_row,
)
from .base import BoolArray, FloatArray, IntArray, cholesky_of_rows

BLOCK = 4  # rows that are corrected together


@njit
def wide_shape(n: int) -> tuple[int, int]:
    """Shape of a matrix (n, n) and an error behind it in wide rows, whole blocks of them."""
    return -(-n // BLOCK) * BLOCK, -(-(n + 1) // (2 * LANES)) * 2 * LANES


@njit
def scratch_shape(n: int, width: int) -> tuple[int, int]:
    """Shape of scratch whose columns are read: no power of two lies between two rows."""
    return n, width + 2 * LANES * (width // (2 * LANES) % 2 == 0)


@njit
def as_vectors(matrix: FloatArray) -> FloatArray:
    """Lane array of a matrix of wide rows."""
    return matrix.reshape((matrix.size // LANES, LANES))


@njit
def append_part(part: FloatArray, first: int, size: int, at: IntArray, of: FloatArray) -> int:
    """`append_entry` of a row, from state `first` on."""
    for j in range(len(part)):
        size = append_entry(first + j, part[j], size, at, of)
    return size


@njit
def combine_rows(
    matrix: FloatArray,
    wide: int,
    at: IntArray,
    of: FloatArray,
    first: int,
    last: int,
    target: FloatArray,
    place: int,
) -> None:
    """Write a row of `target`, which begins at vector `place`: rows `at` of a matrix times `of`,
    from `first` to `last`, summed. Lane arrays of rows of `wide` vectors."""
    for k in range(0, wide, 4):
        l = min(k + 2, wide - 2)  # a second sum, so that one need not wait for the other
        total = other = splat(0.0, load_pair(matrix, k))
        for e in range(first, last):
            total += of[e] * load_pair(matrix, at[e] * wide + k)
            other += of[e] * load_pair(matrix, at[e] * wide + l)
        store(target, place + k, total)
        store(target, place + l, other)


@njit
def whiten_rows(factor: FloatArray, count: int, wide: int, rows: FloatArray) -> None:
    """Solve with Cholesky's factor, whose diagonal is inverted, for rows of a lane array."""
    for i in range(count):
        for k in range(0, wide, 2):
            total = load_pair(rows, i * wide + k)
            for l in range(i):
                total -= factor[i, l] * load_pair(rows, l * wide + k)
            store(rows, i * wide + k, total * factor[i, i])


@njit
def subtract_squares(white: FloatArray, count: int, matrix: FloatArray) -> None:
    """Subtract A' A of some rows A (count, W) from the upper half of a matrix (n, W), of which n is
    a multiple of `BLOCK`."""
    wide = matrix.shape[1] // LANES
    M, A = as_vectors(matrix), as_vectors(white)
    for j in range(0, len(matrix), BLOCK):
        for k in range(j // (2 * LANES) * 2, wide, 2):
            place = j * wide + k
            first, second = load_pair(M, place), load_pair(M, place + wide)
            third, fourth = load_pair(M, place + 2 * wide), load_pair(M, place + 3 * wide)
            for i in range(count):
                row, mine = load_pair(A, i * wide + k), white[i]
                first -= mine[j] * row
                second -= mine[j + 1] * row
                third -= mine[j + 2] * row
                fourth -= mine[j + 3] * row
            store(M, place, first)
            store(M, place + wide, second)
            store(M, place + 2 * wide, third)
            store(M, place + 3 * wide, fourth)


@njit
def mirror(matrix: FloatArray, n: int) -> None:
    """Copy the upper half of a matrix (n, n) into its lower one."""
    for i in range(n):
        for k in range(i):
            matrix[i, k] = matrix[k, i]


@njit
def propagate_wide(
    matrix: FloatArray,
    n: int,
    count: int,
    rows: IntArray,
    ends: IntArray,
    at: IntArray,
    of: FloatArray,
    moved: FloatArray,
) -> None:
    r"""Go on by one interval in place, :math:`P \leftarrow \Phi P \Phi^T`, and the column behind P.
    `matrix` (n or more, W); `count`, `rows`, `ends`, `at`, `of` as of `append_rows`; `moved`, as
    of `scratch_shape`."""
    wide, tall = matrix.shape[1] // LANES, moved.shape[1] // LANES
    M, X = as_vectors(matrix), as_vectors(moved)
    for side in range(2):  # P Phi', then its rows
        first = 0
        for c in range(count):
            combine_rows(M, wide, at, of, first, ends[c], X, c * tall)
            first = ends[c]
        if side == 0:
            for k in range(n):
                for c in range(count):
                    matrix[k, rows[c]] = moved[c, k]
        else:
            for c in range(count):
                for k in range(0, wide, 2):
                    store(M, rows[c] * wide + k, load_pair(X, c * tall + k))


@njit
def compute_sines(position_e: FloatArray, design: FloatArray, sine: FloatArray) -> None:
    """Write sines of elevations (B, n) at positions (B, 3), ECEF; lines of sight are those of
    pseudoranges in `design` (B, 2n, 17)."""
    for b in range(len(sine)):
        north, east = horizontal_axes(position_e[b])
        x = east[1] * north[2] - east[2] * north[1]
        y = east[2] * north[0] - east[0] * north[2]
        z = east[0] * north[1] - east[1] * north[0]
        for s in range(sine.shape[1]):
            sight = design[b, s, POSITION : POSITION + 3]
            sine[b, s] = sight[0] * x + sight[1] * y + sight[2] * z


@njit
def advance_filters(
    filters: FloatArray,
    feedback: FloatArray,
    weights: FloatArray,
    top: FloatArray,
    rest: FloatArray,
    half: FloatArray,
    driven: IntArray,
    driving: FloatArray,
    design: FloatArray,
    mapping: FloatArray,
    first: IntArray,
    smoothed: FloatArray,
    rate: float,
    visible: BoolArray,
    innovation: FloatArray,
    variance: FloatArray,
    fewest: int,
    z: FloatArray,
    S: FloatArray,
    white: FloatArray,
    counts: IntArray,
) -> None:
    r"""Advance filters beside B victims by one epoch.

    .. math:: P \leftarrow \Phi (P + Q/2) \Phi^T + Q/2 + D, \quad A = L^{-1} H P, \quad
        S = H P H^T + R = L L^T, \quad P \leftarrow P - A^T A

    Memory: `filters` (B, N, W), P and behind it the errors of all states. `feedback` (B, 17, m) of
    the last epoch, and its `weights` (B, m); `top` (B, 17, c) first rows of the transition, 0
    beyond; `rest` (N - 17, N - 17) of the others; `half` (B, 17) diagonal of Q/2; `driven` (k, 2)
    places, `driving` (k,) values of D; `design` (B, m, 17) of H, of whose other columns `mapping`
    (B, n, 6), `first`, `smoothed`, `rate` are, as of `append_signals`; `innovation` (B, m) of the
    victim; `variance` (m,) R. Written: `z` (B, m), `S` (B, m, m), 0 and the identity where not
    visible; `white` (B, m, d + 1) first columns of A, and behind them :math:`-L^{-1} z`, in
    `counts` (B,) rows, -1 where S is not positive definite: all errors
    are then infinite.
    """
    receivers, width = len(filters), filters.shape[2]
    states, m, n = STATES + len(rest), z.shape[1], visible.shape[1]
    wide, d, moved = width // LANES, white.shape[2] - 1, np.zeros(scratch_shape(states, width))
    A, factor = np.zeros((m, width)), np.empty((m, m))
    rows, ends = np.empty(states, dtype=np.int64), np.empty(states, dtype=np.int64)
    at, of = np.empty(states * states, dtype=np.int64), np.empty(states * states)
    seen, until = np.empty(m, dtype=np.int64), np.zeros(m + 1, dtype=np.int64)
    places, values = np.empty(m * states, dtype=np.int64), np.empty(m * states)
    AV = as_vectors(A)
    others, taken = append_rows(rest, STATES, 0, 0, rows, ends, at, of)
    for b in range(receivers):
        M = filters[b]
        mirror(M, states)
        for i in range(STATES):
            M[i, i] += half[b, i]
            for r in range(m):
                M[i, states] -= weights[b, r] * feedback[b, i, r]
        count, _ = append_rows(top[b], 0, others, taken, rows, ends, at, of)
        propagate_wide(M, states, count, rows, ends, at, of, moved)
        for i in range(STATES):
            M[i, i] += half[b, i]
        for i in range(len(driving)):
            M[FIRST + driven[i, 0], FIRST + driven[i, 1]] += driving[i]

        size, count = 0, 0
        for r in range(m):
            z[b, r] = 0.0
            for c in range(m):
                S[b, r, c] = 0.0
            S[b, r, r] = 1.0
            if not visible[b, r % n]:
                continue
            size = append_part(design[b, r], 0, size, places, values)
            size = append_signals(mapping[b], first, smoothed, rate, r, FIRST, size, places, values)
            seen[count], until[count + 1] = r, size
            combine_rows(as_vectors(M), wide, places, values, until[count], size, AV, count * wide)
            A[count, states] -= innovation[b, r]
            z[b, r] = -A[count, states]
            for c in range(count + 1):
                total = 0.0
                for e in range(until[c], until[c + 1]):
                    total += A[count, places[e]] * values[e]
                S[b, r, seen[c]] = S[b, seen[c], r] = total
            S[b, r, r] += variance[r]
            count += 1

        count = 0
        if visible[b].sum() >= fewest:
            count = cholesky_of_rows(S[b], visible[b], 0, m, seen, factor)
        counts[b] = count
        whiten_rows(factor, count, wide, AV)
        subtract_squares(A, count, M)
        for i in range(count):
            for k in range(d):
                white[b, i, k] = A[i, k]
            white[b, i, d] = A[i, states]
        if count < 0:
            for i in range(states):
                M[i, states] = np.inf


@njit
def compute_feedback(
    P: FloatArray,
    H: FloatArray,
    innovation: FloatArray,
    S: FloatArray,
    visible: BoolArray,
    fewest: int,
    feedback: FloatArray,
) -> None:
    r"""Write what each measurement moves the victim's states by, (B, s, m): the columns of
    its gain :math:`P H^T S^{-1}` times the innovations, to be multiplied with their weights."""
    receivers, m, states = H.shape
    width = wide_shape(states)[1]
    wide, M, A = width // LANES, np.zeros((states, width)), np.zeros((m, width))
    MV, AV = as_vectors(M), as_vectors(A)
    rows, factor = np.empty(m, dtype=np.int64), np.empty((m, m))
    at, of = np.empty(states, dtype=np.int64), np.empty(states)
    for b in range(receivers):
        feedback[b] = 0.0
        if visible[b].sum() < fewest:
            continue
        for i in range(states):
            for k in range(states):
                M[i, k] = P[b, i, k]
        count = cholesky_of_rows(S[b], visible[b], 0, m, rows, factor)
        for i in range(count):
            size = append_part(H[b, rows[i]], 0, 0, at, of)
            combine_rows(MV, wide, at, of, 0, size, AV, i * wide)
        whiten_rows(factor, count, wide, AV)
        for i in range(count - 1, -1, -1):
            for k in range(0, wide, 2):
                total = load_pair(AV, i * wide + k)
                for l in range(i + 1, count):
                    total -= factor[l, i] * load_pair(AV, l * wide + k)
                store(AV, i * wide + k, total * factor[i, i])
            for k in range(states):
                feedback[b, k, rows[i]] = A[i, k] * innovation[b, rows[i]]


@njit
def write_root(F: FloatArray, k: int, score: FloatArray, out: FloatArray) -> None:
    """Divide elements k and k + 1 of a score by the symmetric root of their covariance, a block of
    `F`; `out` (2,) written, 0 where that is singular."""
    a, c, d = F[k, k], F[k, k + 1], F[k + 1, k + 1]
    det = a * d - c * c
    if det > SINGULAR * (a + d) ** 2:
        root = math.sqrt(det)
        scale = 1.0 / (root * math.sqrt(a + d + 2.0 * root))
        out[0] = scale * ((d + root) * score[k] - c * score[k + 1])
        out[1] = scale * ((a + root) * score[k + 1] - c * score[k])


@njit
def whiten_shifts(
    design: FloatArray,
    innovation: FloatArray,
    innovation_cov: FloatArray,
    visible: BoolArray,
    position_e: FloatArray,
    fewest: int,
    out: FloatArray,
) -> None:
    """Write white shifts (B, 4) of velocity, then of position, north and east each: of their score
    :math:`J^T S^{-1} z` what is left when clock and height are free, and then, of the position,
    the velocity. 0 with fewer satellites than `fewest`, or where S is not positive definite."""
    m = innovation.shape[1]
    rows, factor = np.empty(m, dtype=np.int64), np.empty((m, m))
    A, y = np.empty((m, 8)), np.empty(m)
    F, score = np.empty((8, 8)), np.empty(8)
    for b in range(len(innovation)):
        out[b] = 0.0
        if visible[b].sum() < fewest:
            continue
        count = cholesky_of_rows(innovation_cov[b], visible[b], 0, m, rows, factor)
        north, east = horizontal_axes(position_e[b])
        up = np.cross(east, north)
        for i in range(count):
            H = design[b, rows[i]]
            y[i] = innovation[b, rows[i]]
            A[i, 0], A[i, 1] = H[CLOCK_BIAS], H[CLOCK_DRIFT]
            v, p = H[VELOCITY : VELOCITY + 3], H[POSITION : POSITION + 3]
            A[i, 2], A[i, 3] = v @ up, p @ up
            A[i, 4], A[i, 5] = v @ north, v @ east
            A[i, 6], A[i, 7] = p @ north, p @ east
            substitute_row(factor, i, A, y)
        if count < 0:
            continue
        for i in range(8):
            score[i] = 0.0
            for l in range(count):
                score[i] += A[l, i] * y[l]
            for k in range(8):
                F[i, k] = 0.0
                for l in range(count):
                    F[i, k] += A[l, i] * A[l, k]
        for j in range(6):
            if j == 4:
                write_root(F, 4, score, out[b, :2])
            for i in range(j + 1, 8):
                part = F[i, j] / F[j, j] if F[j, j] > 0.0 else 0.0
                score[i] -= part * score[j]
                for k in range(j, 8):
                    F[i, k] -= part * F[j, k]
        write_root(F, 6, score, out[b, 2:])
