"""The measurement update, on the eight sums that hold all the information of a set of satellites.

A pseudorange sees position and clock bias through the row g = (u, 1), a range rate sees velocity
and clock drift through the same row.  With E the choice of these eight states and D the block
diagonal of the stacked rows, H = D E, and because the measurement noise R is diagonal,

    A = D' R^-1 D (8 x 8),  y = D' R^-1 W z (8),  Pe = E P E',
    K W z = P E' (I + A Pe)^-1 y,   K H P = P E' (I + A Pe)^-1 A E P

by the push-through identity.  No m x m matrix is factored, and any number of satellites, also
none, costs the same 8 x 8 solution.
"""

from __future__ import annotations

import math

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

    `u` (n, 3) lines of sight, ECEF; `z`, `R`, `weights` (2n,) innovations [m, m/s], noise
    variances, and weights in [0, 1]; `covariance_update`: with `UNWEIGHTED` the sums A1 and A2 are
    not needed, and not written; `A`, `A1`, `A2` (8, 8), written: :math:`D^T R^{-1} W^k D` for k =
    0, 1, 2; `y` (8,), written: :math:`D^T R^{-1} W z`.
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

    `M` (k, k), regular; `B` (k, c) right-hand sides; `columns`: how many of the right-hand sides to
    solve for, at most c.
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
    t: NDArray[np.float64],
    S: NDArray[np.float64],
) -> None:
    r"""Write the innovation covariance :math:`S = H P H^T + R` of one receiver.

    `P` (289,) predicted covariance, row by row; `u` (n, 3) lines of sight, ECEF; `R` (2n,) noise
    variances; `visible` (n,) bool; an invisible slot has the row and column of the identity; `t`
    (17,) scratch memory; `S` (2n, 2n), written.
    """
    n = u.shape[0]
    for k in range(2 * n):
        row = S[k]
        for j in range(2 * n):
            row[j] = 0.0
        row[k] = 1.0
    for s in range(n):
        if not visible[s]:
            continue
        ux, uy, uz = u[s, 0], u[s, 1], u[s, 2]
        for half in range(2):
            k = s + half * n
            o, clock = (17 * 3, 17 * 16) if half else (17 * 6, 17 * 15)
            for j in range(17):  # the row of H P
                t[j] = (ux * P[o + j] + uy * P[o + 17 + j]) + (uz * P[o + 34 + j] + P[clock + j])
            row = S[k]
            for j in range(s, n):
                if visible[j]:
                    value = (u[j, 0] * t[6] + u[j, 1] * t[7]) + (u[j, 2] * t[8] + t[15])
                    rate = (u[j, 0] * t[3] + u[j, 1] * t[4]) + (u[j, 2] * t[5] + t[16])
                    row[j] = value
                    row[n + j] = rate
                    S[j, k] = value
                    S[n + j, k] = rate
            row[k] += R[k]


@njit
def innovation_variance(
    P: NDArray[np.float64],
    u: NDArray[np.float64],
    R: NDArray[np.float64],
    visible: NDArray[np.bool_],
    variance: NDArray[np.float64],
) -> None:
    """Write the diagonal of `innovation_covariance` alone, (2n,), with the same bits."""
    n = u.shape[0]
    for k in range(2 * n):
        s = k % n
        variance[k] = 1.0
        if visible[s]:
            x, clock = (3, 16) if k >= n else (6, 15)
            value = u[s, 0] * _row_of_hp(P, u[s], x, clock, x)
            value += u[s, 1] * _row_of_hp(P, u[s], x, clock, x + 1)
            last = u[s, 2] * _row_of_hp(P, u[s], x, clock, x + 2)
            variance[k] = value + (last + _row_of_hp(P, u[s], x, clock, clock)) + R[k]


@njit
def _row_of_hp(P: NDArray[np.float64], u: NDArray[np.float64], x: int, clock: int, j: int) -> float:
    """Element j of the row of H P: of a line of sight at the states from x on, and of a clock."""
    value: float = (u[0] * P[17 * x + j] + u[1] * P[17 * (x + 1) + j]) + (
        u[2] * P[17 * (x + 2) + j] + P[17 * clock + j]
    )
    return value


@njit
def factor(
    P: NDArray[np.float64],
    A: NDArray[np.float64],
    F: NDArray[np.float64],
    M: NDArray[np.float64],
    V: NDArray[np.float64],
    Pc: NDArray[np.float64],
) -> None:
    r"""Write V with :math:`V^T V = (I + A P_e)^{-1} A`, and the rows of P that it acts on.

    With :math:`A = L L^T` block by block, :math:`V = C^{-1} L^T` where
    :math:`C C^T = I + L^T P_e L`, which is well conditioned for any number of satellites.

    `P` (289,) predicted covariance, row by row; `A` (8, 8) block diagonal, positive semidefinite;
    `F`, `M` (8, 8) scratch memory; `V` (64,), written, row by row; `Pc` (136,), written: rows
    `OBSERVED` of P.
    """
    e = OBSERVED
    for k in range(8):
        for j in range(17):
            Pc[17 * k + j] = P[17 * e[k] + j]
    # L, block by block, into M; a pivot of rounding size has no information
    for o in (0, 4):
        for i in range(o, o + 4):
            for j in range(o, i + 1):
                value = A[i, j]
                for k in range(o, j):
                    value -= M[i, k] * M[j, k]
                if i > j:
                    M[i, j] = value / M[j, j] if M[j, j] > 0.0 else 0.0
                else:
                    M[i, i] = math.sqrt(value) if value > 1e-12 * A[i, i] else 0.0
    # V = L', F = L' Pe
    for i in range(8):
        o = 4 * (i // 4)
        for j in range(8):
            V[8 * i + j] = 0.0
            F[i, j] = 0.0
        for k in range(i, o + 4):
            f = M[k, i]
            V[8 * i + k] = f
            for j in range(8):
                F[i, j] += f * Pc[17 * k + e[j]]
    # M = I + F L, its factor C into F
    for i in range(8):
        for j in range(i + 1):
            value = 1.0 if i == j else 0.0
            for k in range(j, 4 * (j // 4) + 4):
                value += F[i, k] * V[8 * j + k]
            M[i, j] = value
    for i in range(8):
        for j in range(i):
            value = M[i, j]
            for k in range(j):
                value -= F[i, k] * F[j, k]
            F[i, j] = value * F[j, j]
        value = M[i, i]
        for k in range(i):
            value -= F[i, k] * F[i, k]
        F[i, i] = 1.0 / math.sqrt(value)  # the inverse: no division below
    # forward substitution, row by row
    for i in range(8):
        for k in range(i):
            f = F[i, k]
            for j in range(8):
                V[8 * i + j] -= f * V[8 * k + j]
        f = F[i, i]
        for j in range(8):
            V[8 * i + j] *= f


@njit
def gain_solution(
    P: NDArray[np.float64],
    A: NDArray[np.float64],
    A1: NDArray[np.float64],
    A2: NDArray[np.float64],
    y: NDArray[np.float64],
    covariance_update: int,
    F: NDArray[np.float64],
    M: NDArray[np.float64],
    V: NDArray[np.float64],
    Pc: NDArray[np.float64],
    Q: NDArray[np.float64],
    dx: NDArray[np.float64],
) -> None:
    r"""Correct the covariance in place and write the correction of the state.

    With :math:`T = (I + A P_e)^{-1} = I - N P_e`, :math:`N = T A = V^T V` and
    :math:`P_c = P E^T`,

    .. math::
        \delta x &= P_c T y \\
        \text{plain:}\quad P &\leftarrow P - P_c\, \mathrm{sym}(T A_1)\, P_c^T
        \quad\text{(the symmetric part of } (I - K W H) P\text{)} \\
        \text{unweighted:}\quad P &\leftarrow P - P_c N P_c^T \\
        \text{general:}\quad P &\leftarrow P - P_c \left(T A_1 + A_1 T^T
        - T (A_1 P_e A_1 + A_2) T^T\right) P_c^T

    The third is :math:`(I - KWH) P (I - KWH)^T + KW R W^T K^T`, right for any gain.

    `P` (289,) predicted covariance, row by row, overwritten by the updated one; `F`, `M` (8, 8)
    scratch memory; `V` (64,) scratch memory; `Pc`, `Q` (136,) scratch memory; `dx` (17,), written.
    """
    e = OBSERVED
    factor(P, A, F, M, V, Pc)
    # x = T y = y - V' V Pe y
    x, v = F[0], F[1]
    for i in range(8):
        x[i] = 0.0
        for j in range(8):
            x[i] += Pc[17 * i + e[j]] * y[j]
    for i in range(8):
        v[i] = 0.0
        for j in range(8):
            v[i] += V[8 * i + j] * x[j]
    for i in range(8):
        x[i] = y[i]
    for k in range(8):
        for i in range(8):
            x[i] -= V[8 * k + i] * v[k]
    for j in range(17):
        dx[j] = 0.0
    for k in range(8):
        for j in range(17):
            dx[j] += x[k] * Pc[17 * k + j]
    if covariance_update == UNWEIGHTED:
        product(V, Pc, Q)
        subtract(P, Q, Q)
    else:
        weighted_information(A1, A2, Pc, V, covariance_update, F, M)
        product(V, Pc, Q)
        subtract(P, Pc, Q)


@njit
def weighted_information(
    A1: NDArray[np.float64],
    A2: NDArray[np.float64],
    Pc: NDArray[np.float64],
    V: NDArray[np.float64],
    covariance_update: int,
    X: NDArray[np.float64],
    N: NDArray[np.float64],
) -> None:
    r"""Replace V by what is between :math:`P_c` and :math:`P_c^T` in a weighted update.

    `A1`, `A2` (8, 8) as `accumulate` writes them; both are overwritten; `Pc` (136,) rows `OBSERVED`
    of P; `V` (64,) as `factor` writes it; overwritten by the symmetric result; `X`, `N` (8, 8)
    scratch memory.
    """
    T = V.reshape((8, 8))
    Pe = Pc.reshape((8, 17))[:, OBSERVED].copy()
    for i in range(8):  # N = V' V
        for j in range(8):
            total = 0.0
            for k in range(8):
                total += T[k, i] * T[k, j]
            N[i, j] = total
    _multiply(N, Pe, X)  # T = I - N Pe
    for i in range(8):
        for j in range(8):
            T[i, j] = (1.0 if i == j else 0.0) - X[i, j]
    _multiply(T, A1, X)
    if covariance_update == PLAIN:
        for i in range(8):
            for j in range(8):
                T[i, j] = 0.5 * (X[i, j] + X[j, i])
        return
    _multiply(Pe, A1, N)
    _multiply(A1, N, Pe)  # Pe becomes A1 Pe A1 + A2, the middle of the third term
    for i in range(8):
        for j in range(8):
            Pe[i, j] += A2[i, j]
    _multiply(T, Pe, N)
    for i in range(8):  # A1 = X + X' - N T'
        for j in range(8):
            total = X[i, j] + X[j, i]
            for k in range(8):
                total -= N[i, k] * T[j, k]
            A1[i, j] = total
    for i in range(8):
        for j in range(8):
            T[i, j] = A1[i, j]


@njit
def _multiply(A: NDArray[np.float64], B: NDArray[np.float64], C: NDArray[np.float64]) -> None:
    """``C = A B``, all (8, 8)."""
    for i in range(8):
        for j in range(8):
            total = 0.0
            for k in range(8):
                total += A[i, k] * B[k, j]
            C[i, j] = total


@njit
def product(N: NDArray[np.float64], Pc: NDArray[np.float64], Q: NDArray[np.float64]) -> None:
    """Write ``Q = N Pc``; (8, 8), (8, 17) and (8, 17), all flat.

    `N`, `Pc` (64,) and (136,); `Q` (136,), written.
    """
    for k in range(8):
        o = 8 * k
        n0, n1, n2, n3 = N[o], N[o + 1], N[o + 2], N[o + 3]
        n4, n5, n6, n7 = N[o + 4], N[o + 5], N[o + 6], N[o + 7]
        q = Q[17 * k : 17 * k + 17]
        for j in range(17):
            q[j] = (
                (n0 * Pc[j] + n1 * Pc[17 + j])
                + (n2 * Pc[34 + j] + n3 * Pc[51 + j])
                + (n4 * Pc[68 + j] + n5 * Pc[85 + j])
                + (n6 * Pc[102 + j] + n7 * Pc[119 + j])
            )


@njit
def subtract(P: NDArray[np.float64], X: NDArray[np.float64], Y: NDArray[np.float64]) -> None:
    """``P -= X' Y`` in place, where the product is symmetric; kept exactly so.

    `P` (289,), overwritten; `X`, `Y` (136,), (8, 17) row by row.
    """
    for i in range(17):
        n0, n1, n2, n3 = X[i], X[17 + i], X[34 + i], X[51 + i]
        n4, n5, n6, n7 = X[68 + i], X[85 + i], X[102 + i], X[119 + i]
        p = P[17 * i : 17 * i + 17]
        for j in range(17):
            p[j] -= (
                (n0 * Y[j] + n1 * Y[17 + j])
                + (n2 * Y[34 + j] + n3 * Y[51 + j])
                + (n4 * Y[68 + j] + n5 * Y[85 + j])
                + (n6 * Y[102 + j] + n7 * Y[119 + j])
            )
    for i in range(17):
        for j in range(i):
            P[17 * i + j] = P[17 * j + i]
