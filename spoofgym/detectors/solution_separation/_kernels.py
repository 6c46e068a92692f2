"""Kernels of a bank of coasting solutions: move on by an epoch, and judge."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..._jit import inlined, njit
from ...earth.wgs84 import ECCENTRICITY_SQUARED, EQUATORIAL_RADIUS
from ...receiver.error_model import POSITION
from ..innovation_test import cholesky_of_rows

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
SINGULAR = 1e-9
"""Determinant of a covariance over the square of its trace, below which nothing is judged."""


@inlined
def age_of(epochs: int, number: int, spacing: int, bank: int) -> int:
    """Age of a solution in its bank at the epoch after so many [epochs]; 0 before it has begun."""
    since = epochs - number * spacing
    return since % (bank * spacing) + 1 if since >= 0 else 0


@njit
def whitened_response(
    predicted_cov: FloatArray,
    design: FloatArray,
    innovation: FloatArray,
    innovation_cov: FloatArray,
    visible: NDArray[np.bool_],
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
    states, kept = design.shape[1], response.shape[1]
    count = cholesky_of_rows(innovation_cov, visible, 0, len(innovation), rows, factor)
    for i in range(count):
        r, mine = rows[i], response[i]
        white[i] = innovation[r]
        for k in range(kept):
            mine[k] = 0.0
        for j in range(states):
            h = design[r, j]
            if h != 0.0:
                P = predicted_cov[j]
                for k in range(kept):
                    mine[k] += h * P[k]
        for l in range(i):
            f, other = factor[i, l], response[l]
            white[i] -= f * white[l]
            for k in range(kept):
                mine[k] -= f * other[k]
        white[i] *= factor[i, i]
        for k in range(kept):
            mine[k] *= factor[i, i]
    return count


@njit
def changed_rows(
    transition: FloatArray, kept: int, rows: IntArray, ends: IntArray, at: IntArray, of: FloatArray
) -> int:
    """Find the rows of the first `kept` states of a transition that are not the identity's.

    `rows`, `ends` (d,) written: their numbers, and where each ends in `at`, `of` (d * d,): places
    and values of what is not 0; returns how many rows.
    """
    count, size = 0, 0
    for i in range(kept):
        before, same = size, transition[i, i] == 1.0
        for j in range(kept):
            if transition[i, j] != 0.0:
                at[size], of[size] = j, transition[i, j]
                size += 1
                same = same and i == j
        if same:
            size = before
        else:
            rows[count], ends[count] = i, size
            count += 1
    return count


@njit
def propagate(
    V: FloatArray,
    s: FloatArray,
    count: int,
    rows: IntArray,
    ends: IntArray,
    at: IntArray,
    of: FloatArray,
    moved: FloatArray,
) -> None:
    r"""Go on by one interval in place.

    .. math:: s \leftarrow \Phi s, \qquad V \leftarrow \Phi V \Phi^T

    `V` (d, d), `s` (d,); `count`, `rows`, `ends`, `at`, `of` as of `changed_rows`; `moved`
    (d, d + 1), overwritten: the rows of Phi V and Phi s that are not those of V and s.
    """
    size, first = len(s), 0
    for c in range(count):
        row = moved[c]
        for k in range(size + 1):
            row[k] = 0.0
        for i in range(first, ends[c]):
            a, column = of[i], V[at[i]]
            row[size] += a * s[at[i]]
            for k in range(size):
                row[k] += a * column[k]
        first = ends[c]
    for c in range(count):
        r = rows[c]
        s[r] = moved[c, size]
        for k in range(size):
            V[k, r] = moved[c, k]
    for c in range(count):
        row = V[rows[c]]
        for k in range(size):
            row[k] = moved[c, k]
    for c in range(count):
        first = 0
        for o in range(count):
            total = 0.0
            for i in range(first, ends[o]):
                total += of[i] * moved[c, at[i]]
            first = ends[o]
            V[rows[c], rows[o]] = total


@njit
def advance_bank(
    transition: FloatArray,
    predicted_cov: FloatArray,
    design: FloatArray,
    innovation: FloatArray,
    innovation_cov: FloatArray,
    visible: NDArray[np.bool_],
    fewest: int,
    spacing: int,
    epochs: IntArray,
    separation: FloatArray,
    covariance: FloatArray,
) -> None:
    """Move all solutions on by one epoch.

    `fewest`: satellites for an update; `spacing`: D; `epochs` (B,), `separation` (B, J, d),
    `covariance` (B, J, d, d) memory, overwritten: epochs so far, s and V.  Where S is not positive
    definite, s is infinite.
    """
    (receivers, m), (bank, kept) = innovation.shape, separation.shape[1:]
    scratch, factor = np.empty(m, dtype=np.int64), np.empty((m, m))
    A, y = np.empty((m, kept)), np.empty(m)
    gained, added = np.empty(kept), np.empty((kept, kept))
    rows, ends = np.empty(kept, dtype=np.int64), np.empty(kept, dtype=np.int64)
    at, of = np.empty(kept * kept, dtype=np.int64), np.empty(kept * kept)
    moved = np.empty((kept, kept + 1))
    for b in range(receivers):
        P, H, z, S = predicted_cov[b], design[b], innovation[b], innovation_cov[b]
        seen = 0
        for j in range(visible.shape[1]):
            seen += visible[b, j]
        count = 0
        if seen >= fewest:
            count = whitened_response(P, H, z, S, visible[b], scratch, factor, A, y)
        gained[:] = 0.0 if count >= 0 else np.inf
        added[:] = 0.0
        for i in range(count):
            mine = A[i]
            for j in range(kept):
                a, row = mine[j], added[j]
                gained[j] += a * y[i]
                for k in range(kept):
                    row[k] += a * mine[k]
        changed = changed_rows(transition[b], kept, rows, ends, at, of)
        for j in range(bank):
            age = age_of(epochs[b], j, spacing, bank)
            s, V = separation[b, j], covariance[b, j]
            if age == 1:
                s[:] = 0.0
                V[:] = 0.0
            elif age > 1:
                propagate(V, s, changed, rows, ends, at, of, moved)
            if age > 0:
                for i in range(kept):
                    s[i] -= gained[i]
                    row, more = V[i], added[i]
                    for k in range(kept):
                        row[k] += more[k]
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
def along(V: FloatArray, u: FloatArray, w: FloatArray) -> float:
    """Element u' V w of the covariance of the position (3, 3)."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += u[i] * V[POSITION + i, POSITION + j] * w[j]
    return total


@njit
def judge_bank(
    separation: FloatArray,
    covariance: FloatArray,
    epochs: IntArray,
    spacing: int,
    position_e: FloatArray,
    largest_sd: FloatArray,
    statistic: FloatArray,
) -> None:
    """Compare the horizontal part of all solutions with its covariance.

    `largest_sd` (B, J) memory, overwritten: root of the largest eigenvalue of V_h [m], infinite
    where a solution is not judged; `statistic` (B,) written: largest q.
    """
    receivers, bank = separation.shape[:2]
    for b in range(receivers):
        north, east = horizontal_axes(position_e[b])
        statistic[b] = 0.0
        for j in range(bank):
            largest_sd[b, j] = np.inf
            if age_of(epochs[b] - 1, j, spacing, bank) == 0:
                continue
            s, V = separation[b, j], covariance[b, j]
            nn, ne, ee = along(V, north, north), along(V, north, east), along(V, east, east)
            half, det = 0.5 * (nn + ee), nn * ee - ne * ne
            if det <= SINGULAR * 4.0 * half * half:
                if half == 0.0:  # no update since it began, so that nothing can have moved
                    largest_sd[b, j] = 0.0
                continue
            n = north[0] * s[POSITION] + north[1] * s[POSITION + 1] + north[2] * s[POSITION + 2]
            e = east[0] * s[POSITION] + east[1] * s[POSITION + 1] + east[2] * s[POSITION + 2]
            q = (ee * n * n - 2.0 * ne * n * e + nn * e * e) / det
            statistic[b] = max(statistic[b], q)
            largest_sd[b, j] = math.sqrt(half + math.sqrt(max(half * half - det, 0.0)))


@njit
def whiten_bank(
    separation: FloatArray,
    covariance: FloatArray,
    epochs: IntArray,
    spacing: int,
    position_e: FloatArray,
    whitened: FloatArray,
) -> None:
    """Horizontal parts of all solutions with the covariance of the identity, so that q = |w|^2.

    `whitened` (B, J, 2) written, 0 where `judge_bank` does not judge.
    """
    receivers, bank = separation.shape[:2]
    for b in range(receivers):
        north, east = horizontal_axes(position_e[b])
        for j in range(bank):
            whitened[b, j, :] = 0.0
            if age_of(epochs[b] - 1, j, spacing, bank) == 0:
                continue
            s, V = separation[b, j], covariance[b, j]
            nn, ne, ee = along(V, north, north), along(V, north, east), along(V, east, east)
            half, det = 0.5 * (nn + ee), nn * ee - ne * ne
            if det <= SINGULAR * 4.0 * half * half:
                continue
            n = north[0] * s[POSITION] + north[1] * s[POSITION + 1] + north[2] * s[POSITION + 2]
            e = east[0] * s[POSITION] + east[1] * s[POSITION + 1] + east[2] * s[POSITION + 2]
            whitened[b, j, 0] = n / math.sqrt(nn)
            whitened[b, j, 1] = (e - ne / nn * n) / math.sqrt(det / nn)
