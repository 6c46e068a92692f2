"""The measurement update, on the eight sums that hold all a set of satellites can tell.

A pseudorange sees position and clock bias through the row g = (u, 1), a range rate sees velocity
and clock drift through the same row.  With E the choice of these eight states and D the block
diagonal of the stacked rows, H = D E, and because the measurement noise R is diagonal,

    A = D' R^-1 D (8 x 8),  y = D' R^-1 W z (8),  Pe = E P E',
    K W z = P E' (I + A Pe)^-1 y,   K H P = P E' (I + A Pe)^-1 A E P

by the push-through identity.  No m x m matrix is factored, and any number of satellites, also
none, costs the same 8 x 8 solution.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._jit import njit

OBSERVED = np.array([6, 7, 8, 15, 3, 4, 5, 16])
"""E: the states of position and clock bias, then of velocity and clock drift."""

PLAIN, UNWEIGHTED, GENERAL = 0, 1, 2
COVARIANCE_UPDATES = {"plain": PLAIN, "unweighted": UNWEIGHTED, "general": GENERAL}


@njit
def accumulate(
    u: NDArray[np.float64],
    z: NDArray[np.float64],
    R: NDArray[np.float64],
    weights: NDArray[np.float64],
    visible: NDArray[np.bool_],
    covariance_update: int,
    A: NDArray[np.float64],
    A1: NDArray[np.float64],
    A2: NDArray[np.float64],
    y: NDArray[np.float64],
) -> None:
    r"""Sum the information of all visible satellites.

    Parameters
    ----------
    u : ndarray
        (n, 3) lines of sight, ECEF.
    z, R, weights : ndarray
        (2n,) innovations [m, m/s], noise variances, and weights in [0, 1].
    visible : ndarray
        (n,) bool.
    covariance_update : int
        With `UNWEIGHTED` the sums A1 and A2 are not needed, and not written.
    A, A1, A2 : ndarray
        (8, 8), written: :math:`D^T R^{-1} W^k D` for k = 0, 1, 2.
    y : ndarray
        (8,), written: :math:`D^T R^{-1} W z`.
    """
    n = u.shape[0]
    for half in range(2):
        o = 4 * half
        for power in range(1 if covariance_update == UNWEIGHTED else 3):
            a00, a01, a02, a03, a11, a12, a13, a22, a23, a33 = (0.0,) * 10
            y0, y1, y2, y3 = 0.0, 0.0, 0.0, 0.0
            for s in range(n):
                if not visible[s]:
                    continue
                k = s + half * n
                p = 1.0 / R[k]
                gx, gy, gz = u[s, 0], u[s, 1], u[s, 2]
                if power == 0:
                    t = p * weights[k] * z[k]
                    y0 += gx * t
                    y1 += gy * t
                    y2 += gz * t
                    y3 += t
                elif power == 1:
                    p *= weights[k]
                else:
                    p *= weights[k] * weights[k]
                px, py, pz = p * gx, p * gy, p * gz
                a00 += px * gx
                a01 += px * gy
                a02 += px * gz
                a03 += px
                a11 += py * gy
                a12 += py * gz
                a13 += py
                a22 += pz * gz
                a23 += pz
                a33 += p
            if power == 0:
                y[o], y[o + 1], y[o + 2], y[o + 3] = y0, y1, y2, y3
            target = A if power == 0 else (A1 if power == 1 else A2)
            for i in range(4):
                for j in range(4):
                    target[o + i, 4 - o + j] = 0.0
            target[o, o], target[o, o + 1] = a00, a01
            target[o, o + 2], target[o, o + 3] = a02, a03
            target[o + 1, o], target[o + 1, o + 1] = a01, a11
            target[o + 1, o + 2], target[o + 1, o + 3] = a12, a13
            target[o + 2, o], target[o + 2, o + 1] = a02, a12
            target[o + 2, o + 2], target[o + 2, o + 3] = a22, a23
            target[o + 3, o], target[o + 3, o + 1] = a03, a13
            target[o + 3, o + 2], target[o + 3, o + 3] = a23, a33


@njit
def solve_in_place(M: NDArray[np.float64], B: NDArray[np.float64], columns: int) -> None:
    """Solve ``M X = B`` by elimination with partial pivoting; `B` becomes X, `M` is destroyed.

    Parameters
    ----------
    M : ndarray
        (k, k), regular.
    B : ndarray
        (k, c) right-hand sides.
    columns : int
        How many of the right-hand sides to solve for, at most c.
    """
    k, c = M.shape[0], columns
    for p in range(k):
        best = p
        for i in range(p + 1, k):
            if abs(M[i, p]) > abs(M[best, p]):
                best = i
        if best != p:
            for j in range(p, k):
                M[p, j], M[best, j] = M[best, j], M[p, j]
            for j in range(c):
                B[p, j], B[best, j] = B[best, j], B[p, j]
        inverse = 1.0 / M[p, p]
        for i in range(p + 1, k):
            f = M[i, p] * inverse
            if f != 0.0:
                for j in range(p + 1, k):
                    M[i, j] -= f * M[p, j]
                for j in range(c):
                    B[i, j] -= f * B[p, j]
    for p in range(k - 1, -1, -1):
        inverse = 1.0 / M[p, p]
        for j in range(c):
            total = B[p, j]
            for i in range(p + 1, k):
                total -= M[p, i] * B[i, j]
            B[p, j] = total * inverse


@njit
def innovation_covariance(
    P: NDArray[np.float64],
    u: NDArray[np.float64],
    R: NDArray[np.float64],
    visible: NDArray[np.bool_],
    S: NDArray[np.float64],
) -> None:
    r"""Write the innovation covariance :math:`S = H P H^T + R` of one receiver.

    Parameters
    ----------
    P : ndarray
        (17, 17) predicted covariance.
    u : ndarray
        (n, 3) lines of sight, ECEF.
    R : ndarray
        (2n,) noise variances.
    visible : ndarray
        (n,) bool; an invisible slot has the row and column of the identity.
    S : ndarray
        (2n, 2n), written.
    """
    n = u.shape[0]
    for s in range(n):
        for k in (s, s + n):
            for j in range(2 * n):
                S[k, j] = 0.0
            S[k, k] = 1.0
    for s in range(n):
        if not visible[s]:
            continue
        for half in range(2):
            k, o = s + half * n, 3 if half else 6
            clock = 16 if half else 15
            # t = Pe h', the row of H P on the eight observed states
            t0 = u[s, 0] * P[o, 6] + u[s, 1] * P[o + 1, 6] + u[s, 2] * P[o + 2, 6] + P[clock, 6]
            t1 = u[s, 0] * P[o, 7] + u[s, 1] * P[o + 1, 7] + u[s, 2] * P[o + 2, 7] + P[clock, 7]
            t2 = u[s, 0] * P[o, 8] + u[s, 1] * P[o + 1, 8] + u[s, 2] * P[o + 2, 8] + P[clock, 8]
            t3 = (
                u[s, 0] * P[o, 15] + u[s, 1] * P[o + 1, 15] + u[s, 2] * P[o + 2, 15] + P[clock, 15]
            )
            t4 = u[s, 0] * P[o, 3] + u[s, 1] * P[o + 1, 3] + u[s, 2] * P[o + 2, 3] + P[clock, 3]
            t5 = u[s, 0] * P[o, 4] + u[s, 1] * P[o + 1, 4] + u[s, 2] * P[o + 2, 4] + P[clock, 4]
            t6 = u[s, 0] * P[o, 5] + u[s, 1] * P[o + 1, 5] + u[s, 2] * P[o + 2, 5] + P[clock, 5]
            t7 = (
                u[s, 0] * P[o, 16] + u[s, 1] * P[o + 1, 16] + u[s, 2] * P[o + 2, 16] + P[clock, 16]
            )
            for j in range(s, n):
                if visible[j]:
                    value = t0 * u[j, 0] + t1 * u[j, 1] + t2 * u[j, 2] + t3
                    rate = t4 * u[j, 0] + t5 * u[j, 1] + t6 * u[j, 2] + t7
                    S[k, j] = value
                    S[j, k] = value
                    S[k, n + j] = rate
                    S[n + j, k] = rate
            S[k, k] += R[k]


@njit
def gain_solution(
    P: NDArray[np.float64],
    A: NDArray[np.float64],
    A1: NDArray[np.float64],
    A2: NDArray[np.float64],
    y: NDArray[np.float64],
    covariance_update: int,
    M: NDArray[np.float64],
    B: NDArray[np.float64],
    Pc: NDArray[np.float64],
    dx: NDArray[np.float64],
) -> None:
    r"""Correct the covariance in place and write the correction of the state.

    With :math:`T = (I + A P_e)^{-1}` and :math:`P_c = P E^T`,

    .. math::
        \delta x &= P_c T y \\
        \text{plain:}\quad P &\leftarrow P - P_c\, \mathrm{sym}(T A_1)\, P_c^T
        \quad\text{(the symmetric part of } (I - K W H) P\text{)} \\
        \text{unweighted:}\quad P &\leftarrow P - P_c T A P_c^T \\
        \text{general:}\quad P &\leftarrow P - P_c \left(T A_1 + A_1 T^T
        - T (A_1 P_e A_1 + A_2) T^T\right) P_c^T

    The third is :math:`(I - KWH) P (I - KWH)^T + KW R W^T K^T`, right for any gain.

    Parameters
    ----------
    P : ndarray
        (17, 17) predicted covariance, overwritten by the updated one.
    A, A1, A2, y : ndarray
        As `accumulate` writes them.
    covariance_update : int
        `PLAIN`, `UNWEIGHTED` or `GENERAL`; the same thing where all weights are 1.
    M, B, Pc : ndarray
        (8, 8), (8, 17) and (8, 17) scratch memory.
    dx : ndarray
        (17,), written.
    """
    e = OBSERVED
    columns = 17 if covariance_update == GENERAL else 9
    for k in range(8):
        row = P[e[k]]
        for j in range(17):
            Pc[k, j] = row[j]
    for i in range(8):
        o = 4 * (i // 4)
        for j in range(8):
            total = 1.0 if i == j else 0.0
            for k in range(o, o + 4):
                total += A[i, k] * Pc[k, e[j]]
            M[i, j] = total
            B[i, 1 + j] = A[i, j] if covariance_update == UNWEIGHTED else A1[i, j]
            if covariance_update == GENERAL:
                B[i, 9 + j] = 1.0 if i == j else 0.0
        B[i, 0] = y[i]
    solve_in_place(M, B, columns)
    for j in range(17):
        dx[j] = 0.0
    for k in range(8):
        t = B[k, 0]
        for j in range(17):
            dx[j] += t * Pc[k, j]
    if covariance_update == GENERAL:
        # A becomes A1 Pe A1 + A2; M becomes T times that; A becomes the bracket
        for i in range(8):
            o = 4 * (i // 4)
            for j in range(8):
                q = 4 * (j // 4)
                total = A2[i, j]
                for k in range(o, o + 4):
                    for m in range(q, q + 4):
                        total += A1[i, k] * Pc[k, e[m]] * A1[m, j]
                A[i, j] = total
        for i in range(8):
            for j in range(8):
                total = 0.0
                for k in range(8):
                    total += B[i, 9 + k] * A[k, j]
                M[i, j] = total
        for i in range(8):
            for j in range(8):
                total = B[i, 1 + j] + B[j, 1 + i]
                for k in range(8):
                    total -= M[i, k] * B[j, 9 + k]
                A[i, j] = total
    else:
        for i in range(8):
            for j in range(8):
                A[i, j] = 0.5 * (B[i, 1 + j] + B[j, 1 + i])
    _subtract_quadratic(P, A, Pc, B)


@njit
def _subtract_quadratic(
    P: NDArray[np.float64],
    N: NDArray[np.float64],
    Pc: NDArray[np.float64],
    work: NDArray[np.float64],
) -> None:
    """``P -= Pc' N Pc`` in place, kept exactly symmetric; `Pc` and `work` are (8, 17)."""
    for k in range(8):
        n0, n1, n2, n3 = N[k, 0], N[k, 1], N[k, 2], N[k, 3]
        n4, n5, n6, n7 = N[k, 4], N[k, 5], N[k, 6], N[k, 7]
        for j in range(17):
            work[k, j] = (
                (n0 * Pc[0, j] + n1 * Pc[1, j])
                + (n2 * Pc[2, j] + n3 * Pc[3, j])
                + (n4 * Pc[4, j] + n5 * Pc[5, j])
                + (n6 * Pc[6, j] + n7 * Pc[7, j])
            )
    for i in range(17):
        n0, n1, n2, n3 = Pc[0, i], Pc[1, i], Pc[2, i], Pc[3, i]
        n4, n5, n6, n7 = Pc[4, i], Pc[5, i], Pc[6, i], Pc[7, i]
        for j in range(17):
            P[i, j] -= (
                (n0 * work[0, j] + n1 * work[1, j])
                + (n2 * work[2, j] + n3 * work[3, j])
                + (n4 * work[4, j] + n5 * work[5, j])
                + (n6 * work[6, j] + n7 * work[7, j])
            )
    for i in range(17):
        for j in range(i):
            P[i, j] = P[j, i]
