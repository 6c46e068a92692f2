"""Kernels of a bank of coasting solutions: move on by an epoch, and judge."""

from __future__ import annotations

import math

import numpy as np

from ..core.compile import inline_njit, njit
from ..earth.wgs84 import ECCENTRICITY_SQUARED, EQUATORIAL_RADIUS
from .base import BoolArray, FloatArray, IntArray, cholesky_of_rows

SINGULAR = 1e-9
"""Determinant of a covariance over the square of its trace, below which nothing is judged."""


@inline_njit
def compute_age(epochs: int, first: int, period: int) -> int:
    """Age of a solution at the epoch after so many [epochs]; 0 before its first start."""
    since = epochs - first
    return since % period + 1 if since >= 0 else 0


@njit
def substitute_row(factor: FloatArray, i: int, rows: FloatArray, values: FloatArray) -> None:
    """Solve with Cholesky's factor, whose diagonal is inverted, for row i of `rows` (m, d) and of
    `values` (m,) in place; those before it are solved."""
    mine = rows[i]
    for l in range(i):
        f, other = factor[i, l], rows[l]
        values[i] -= f * values[l]
        for k in range(len(mine)):
            mine[k] -= f * other[k]
    values[i] *= factor[i, i]
    for k in range(len(mine)):
        mine[k] *= factor[i, i]


@njit
def whitened_response(
    predicted_cov: FloatArray,
    design: FloatArray,
    innovation: FloatArray,
    innovation_cov: FloatArray,
    visible: BoolArray,
    rows: IntArray,
    factor: FloatArray,
    response: FloatArray,
    white: FloatArray,
) -> int:
    r"""Write of one receiver what gives the gain times anything.

    .. math:: A = L^{-1} H P, \quad y = L^{-1} z, \quad S = L L^T; \qquad
        K z = A^T y, \quad K S K^T = A^T A

    `response` (m, d), the first d states of A, and `white` (m,), y, are written in as many rows as
    are returned; -1 where S is not positive definite.  `rows` (m,), `factor` (m, m): scratch.
    """
    states, tracked = design.shape[1], response.shape[1]
    count = cholesky_of_rows(innovation_cov, visible, 0, len(innovation), rows, factor)
    for i in range(count):
        r, mine = rows[i], response[i]
        white[i] = innovation[r]
        for k in range(tracked):
            mine[k] = 0.0
        for j in range(states):
            h = design[r, j]
            if h != 0.0:
                P = predicted_cov[j]
                for k in range(tracked):
                    mine[k] += h * P[k]
        substitute_row(factor, i, response, white)
    return count


@njit
def append_rows(
    matrix: FloatArray,
    first: int,
    count: int,
    size: int,
    rows: IntArray,
    ends: IntArray,
    at: IntArray,
    of: FloatArray,
) -> tuple[int, int]:
    """Append rows of a transition but for those of the identity: states in `rows`, where each ends
    in `ends`, and places and values of what is not 0 in `at`, `of`. `matrix` (r, c): part of it
    that begins on the diagonal at state `first`; `count`, `size`: how many there are already;
    returned with the new."""
    for i in range(matrix.shape[0]):
        before, same = size, matrix[i, i] == 1.0
        for j in range(matrix.shape[1]):
            if matrix[i, j] != 0.0:
                at[size], of[size] = first + j, matrix[i, j]
                size += 1
                same = same and i == j
        if same:
            size = before
        else:
            rows[count], ends[count] = first + i, size
            count += 1
    return count, size


@njit
def propagate_bank(
    V: FloatArray,
    s: FloatArray,
    count: int,
    rows: IntArray,
    ends: IntArray,
    at: IntArray,
    of: FloatArray,
    moved: FloatArray,
    shifted: FloatArray,
) -> None:
    r"""Go on by one interval in place, with all solutions side by side.

    .. math:: s \leftarrow \Phi s, \qquad V \leftarrow \Phi V \Phi^T

    `V` (d, d, J), `s` (d, J); `count`, `rows`, `ends`, `at`, `of` as of `append_rows`; `moved`
    (d, d J) and `shifted` (d, J), overwritten: the rows of Phi V and Phi s that are not those of V
    and s.
    """
    size, bank = s.shape
    flat, whole = V.reshape((size, size * bank)), moved.reshape((size, size, bank))
    width, first = size * bank, 0
    for c in range(count):
        row, shift = moved[c], shifted[c]
        row[:] = 0.0
        shift[:] = 0.0
        for i in range(first, ends[c]):
            a, column, part = of[i], flat[at[i]], s[at[i]]
            for j in range(bank):
                shift[j] += a * part[j]
            for k in range(width):
                row[k] += a * column[k]
        first = ends[c]
    for c in range(count):
        r = rows[c]
        for j in range(bank):
            s[r, j] = shifted[c, j]
        for k in range(size):
            mine = whole[c, k]
            for j in range(bank):
                V[k, r, j] = mine[j]
    for c in range(count):
        row, column = moved[c], flat[rows[c]]
        for k in range(width):
            column[k] = row[k]
    for c in range(count):
        first = 0
        for o in range(count):
            total = V[rows[c], rows[o]]
            total[:] = 0.0
            for i in range(first, ends[o]):
                a, part = of[i], whole[c, at[i]]
                for j in range(bank):
                    total[j] += a * part[j]
            first = ends[o]


@njit
def advance_bank(
    receivers: IntArray,
    transition: FloatArray,
    predicted_cov: FloatArray,
    design: FloatArray,
    innovation: FloatArray,
    innovation_cov: FloatArray,
    visible: BoolArray,
    fewest: int,
    firsts: IntArray,
    periods: IntArray,
    epochs: IntArray,
    separation: FloatArray,
    covariance: FloatArray,
) -> None:
    """Advance all solutions of some receivers by one epoch. `fewest`: least satellites for an
    update; `firsts`, `periods` (J,) of the starts of the solutions [epochs]; memory: `epochs` (B,)
    so far, `separation` (B, d, J) s, `covariance` (B, d, d, J) V. Where `innovation_cov` is not
    positive definite, s is infinite."""
    m, (tracked, bank) = innovation.shape[1], separation.shape[1:]
    scratch, factor = np.empty(m, dtype=np.int64), np.empty((m, m))
    A, y = np.empty((m, tracked)), np.empty(m)
    gained, added = np.empty(tracked), np.empty((tracked, tracked))
    rows, ends = np.empty(tracked, dtype=np.int64), np.empty(tracked, dtype=np.int64)
    at, of = np.empty(tracked * tracked, dtype=np.int64), np.empty(tracked * tracked)
    moved, shifted, begun = (
        np.empty((tracked, tracked * bank)),
        np.empty((tracked, bank)),
        np.empty(bank),
    )
    for b in receivers:
        P, H, z, S = predicted_cov[b], design[b], innovation[b], innovation_cov[b]
        seen = 0
        for j in range(visible.shape[1]):
            seen += visible[b, j]
        count = 0
        if seen >= fewest:
            count = whitened_response(P, H, z, S, visible[b], scratch, factor, A, y)
        gained[:] = 0.0 if count >= 0 else np.inf
        added[:] = 0.0
        for j in range(tracked):
            row = added[j]
            for i in range(count):
                a, mine = A[i, j], A[i]
                gained[j] += a * y[i]
                for k in range(tracked):
                    row[k] += a * mine[k]
        inertial = transition[b, :tracked, :tracked]
        changed, _ = append_rows(inertial, 0, 0, 0, rows, ends, at, of)
        s, V = separation[b], covariance[b]
        for j in range(bank):
            age = compute_age(epochs[b], firsts[j], periods[j])
            begun[j] = 1.0 if age > 0 else 0.0
            if age == 1:
                s[:, j] = 0.0
                V[:, :, j] = 0.0
        propagate_bank(V, s, changed, rows, ends, at, of, moved, shifted)
        for i in range(tracked):
            for j in range(bank):
                if begun[j] > 0.0:
                    s[i, j] -= gained[i]
            for k in range(tracked):
                more, row = added[i, k], V[i, k]
                for j in range(bank):
                    row[j] += more * begun[j]
        epochs[b] += 1


@njit
def horizontal_axes(position_e: FloatArray) -> tuple[FloatArray, FloatArray]:
    """North and east unit vectors at a position, ECEF, by Bowring's latitude."""
    x, y, z = position_e[0], position_e[1], position_e[2]
    p, ratio = math.hypot(x, y), math.sqrt(1.0 - ECCENTRICITY_SQUARED)
    beta, longitude = math.atan2(z, p * ratio), math.atan2(y, x)
    polar = ECCENTRICITY_SQUARED / ratio * EQUATORIAL_RADIUS
    latitude = math.atan2(
        z + polar * math.sin(beta) ** 3,
        p - ECCENTRICITY_SQUARED * EQUATORIAL_RADIUS * math.cos(beta) ** 3,
    )
    up, out = math.sin(latitude), math.cos(latitude)
    north = np.array([-up * math.cos(longitude), -up * math.sin(longitude), out])
    return north, np.array([-math.sin(longitude), math.cos(longitude), 0.0])


@njit
def project_covariance(V: FloatArray, j: int, u: FloatArray, w: FloatArray) -> float:
    """Element u' V w of the covariance of the position of solution j; `V` (3, 3, J)."""
    total = 0.0
    for i in range(3):
        for k in range(3):
            total += u[i] * V[i, k, j] * w[k]
    return total


@njit
def horizontal_part(
    separation: FloatArray, V: FloatArray, j: int, north: FloatArray, east: FloatArray
) -> tuple[float, float, float, float, float]:
    """North and east of the separation (3, J) of solution j, and their covariance: nn, ne, ee."""
    s = separation[:, j]
    nn, ee = project_covariance(V, j, north, north), project_covariance(V, j, east, east)
    ne = project_covariance(V, j, north, east)
    n = north[0] * s[0] + north[1] * s[1] + north[2] * s[2]
    e = east[0] * s[0] + east[1] * s[1] + east[2] * s[2]
    return n, e, nn, ne, ee


@njit
def judge_bank(
    receivers: IntArray,
    separation: FloatArray,
    covariance: FloatArray,
    epochs: IntArray,
    firsts: IntArray,
    periods: IntArray,
    position_e: FloatArray,
    largest_sd: FloatArray,
    statistic: FloatArray,
) -> None:
    """Compare the horizontal part of all solutions of some receivers with its covariance.
    `separation` (B, 3, J), `covariance` (B, 3, 3, J) of the position.
    `largest_sd` (B, J) written: root of the largest eigenvalue of V_h [m], infinite where a
    solution is not judged; `statistic` (B,) written: largest q."""
    bank = separation.shape[2]
    for b in receivers:
        north, east = horizontal_axes(position_e[b])
        statistic[b] = 0.0
        for j in range(bank):
            largest_sd[b, j] = np.inf
            if compute_age(epochs[b] - 1, firsts[j], periods[j]) == 0:
                continue
            n, e, nn, ne, ee = horizontal_part(separation[b], covariance[b], j, north, east)
            half, det = 0.5 * (nn + ee), nn * ee - ne * ne
            if det <= SINGULAR * 4.0 * half * half:
                if half == 0.0:  # no update since it began, so that nothing can have moved
                    largest_sd[b, j] = 0.0
                continue
            q = (ee * n * n - 2.0 * ne * n * e + nn * e * e) / det
            statistic[b] = max(statistic[b], q)
            largest_sd[b, j] = math.sqrt(half + math.sqrt(max(half * half - det, 0.0)))


@njit
def whiten_bank(
    separation: FloatArray,
    covariance: FloatArray,
    epochs: IntArray,
    firsts: IntArray,
    periods: IntArray,
    position_e: FloatArray,
    whitened: FloatArray,
) -> None:
    """Horizontal parts of all solutions, whitened to unit covariance, so that q = |w|^2.
    `whitened` (B, J, 2) written, 0 where `judge_bank` does not judge."""
    receivers, bank = len(separation), separation.shape[2]
    for b in range(receivers):
        north, east = horizontal_axes(position_e[b])
        for j in range(bank):
            whitened[b, j, :] = 0.0
            if compute_age(epochs[b] - 1, firsts[j], periods[j]) == 0:
                continue
            n, e, nn, ne, ee = horizontal_part(separation[b], covariance[b], j, north, east)
            half, det = 0.5 * (nn + ee), nn * ee - ne * ne
            if det <= SINGULAR * 4.0 * half * half:
                continue
            whitened[b, j, 0] = n / math.sqrt(nn)
            whitened[b, j, 1] = (e - ne / nn * n) / math.sqrt(det / nn)
