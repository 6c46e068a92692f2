"""The measurement update, on the eight sums that hold all the information of a set of satellites.

A pseudorange sees position and clock bias through the row g = (u, 1), a range rate sees velocity
and clock drift through the same row.  With E the choice of these eight states and D the block
diagonal of the stacked rows, H = D E, and because the measurement noise R is diagonal,

    A = D' R^-1 D (8 x 8),  y = D' R^-1 W z (8),  Pe = E P E',
    K W z = P E' (I + A Pe)^-1 y,   K H P = P E' (I + A Pe)^-1 A E P

by the push-through identity.  No m x m matrix is factored, and any number of satellites, also
none, costs the same 8 x 8 solution.

All functions are of lane arrays (`core.simd`), one group of receivers at a time.  A lower triangle
of 4 x 4 is stored in ten rows, column by column: 00 10 20 30 11 21 31 22 32 33.
"""

import numpy as np

from ..core.compile import inline_njit, njit
from ..core.simd import (
    LANES,
    any_lane,
    count_lanes,
    lane,
    load,
    select,
    set_lane,
    splat,
    sqrt,
    store,
)
from .states import INDEX

OBSERVED = np.array([6, 7, 8, 15, 3, 4, 5, 16])  # E: position, clock bias; velocity, clock drift

PLAIN, UNWEIGHTED, GENERAL = 0, 1, 2
COVARIANCE_UPDATES = {"plain": PLAIN, "unweighted": UNWEIGHTED, "general": GENERAL}
NO_INFORMATION = 1e-12  # part of a pivot that rounding may leave of one without information
# Rows of scratch memory: y, L, the correction and V Pe y, F and C, F L, Q, V, A1, A2.
Y, L, X, F, M, Q, V, A1, A2, REST = 0, 8, 28, 60, 124, 188, 324, 388, 408, 428
WORK = REST + 6 * 64 + 8 * 17  # rows of scratch memory that `update` needs


@inline_njit
def _store_every(out, first, step, x):
    """Write four rows, so many apart."""
    store(out, first, x[0])
    store(out, first + step, x[1])
    store(out, first + 2 * step, x[2])
    store(out, first + 3 * step, x[3])


@inline_njit
def _store_triangle(out, first, a):
    _store_every(out, first, 1, a[:4])
    _store_every(out, first + 4, 1, a[4:8])
    store(out, first + 8, a[8])
    store(out, first + 9, a[9])


@inline_njit
def _load_column(P, first, half, column):
    """A column of a half of the rows E of a packed covariance."""
    o = 4 * half
    a, b = INDEX[OBSERVED[o], column], INDEX[OBSERVED[o + 1], column]
    c, d = INDEX[OBSERVED[o + 2], column], INDEX[OBSERVED[o + 3], column]
    return load(P, first + a), load(P, first + b), load(P, first + c), load(P, first + d)


@njit
def information(x, u, z, precision, weights, half, n, power, work):
    r"""Sum a half of :math:`D^T R^{-1} W^p D`, as a lower triangle; with the power p = 0 also y.

    `x`: lane array; `u`, `z`: first rows in it of lines of sight (3 n) and innovations (2 n);
    `precision`: 2 n rows, 1 / R where a satellite takes part, else 0; `weights`: 2 n rows; `half`:
    0 for pseudoranges, 1 for range rates; `work`: of `update`, where A, or A1 or A2, is written.
    """
    zero = splat(0.0, x)
    a00, a10, a20, a30, a11 = zero, zero, zero, zero, zero
    a21, a31, a22, a32, a33 = zero, zero, zero, zero, zero
    y0, y1, y2, y3 = zero, zero, zero, zero
    for s in range(n):
        k = s + half * n
        p, w = load(precision, k), load(weights, k)
        gx, gy, gz = load(x, u + 3 * s), load(x, u + 3 * s + 1), load(x, u + 3 * s + 2)
        if power == 0:
            t = p * w * load(x, z + k)
            y0 += gx * t
            y1 += gy * t
            y2 += gz * t
            y3 += t
        elif power == 1:
            p = p * w
        else:
            p = p * (w * w)
        px, py, pz = p * gx, p * gy, p * gz
        a00 += px * gx
        a10 += px * gy
        a20 += px * gz
        a30 += px
        a11 += py * gy
        a21 += py * gz
        a31 += py
        a22 += pz * gz
        a32 += pz
        a33 += p
    if power == 0:
        _store_every(work, Y + 4 * half, 1, (y0, y1, y2, y3))
    first = (L if power == 0 else (A1 if power == 1 else A2)) + 10 * half
    _store_triangle(work, first, (a00, a10, a20, a30, a11, a21, a31, a22, a32, a33))


@inline_njit
def _pivot(value, whole):
    """Root of a pivot of Cholesky's factor and its inverse; 0 without information."""
    informed = value > NO_INFORMATION * whole
    root = sqrt(select(informed, value, 1.0))
    return select(informed, root, 0.0), select(informed, 1.0 / root, 0.0)


@njit
def factor_block(work, first):
    f = first
    a00, a10, a20, a30 = load(work, f), load(work, f + 1), load(work, f + 2), load(work, f + 3)
    a11, a21, a31 = load(work, f + 4), load(work, f + 5), load(work, f + 6)
    a22, a32, a33 = load(work, f + 7), load(work, f + 8), load(work, f + 9)
    l00, i0 = _pivot(a00, a00)
    l10, l20, l30 = a10 * i0, a20 * i0, a30 * i0
    l11, i1 = _pivot(a11 - l10 * l10, a11)
    l21, l31 = (a21 - l20 * l10) * i1, (a31 - l30 * l10) * i1
    l22, i2 = _pivot(a22 - l20 * l20 - l21 * l21, a22)
    l32 = (a32 - l30 * l20 - l31 * l21) * i2
    l33, _ = _pivot(a33 - l30 * l30 - l31 * l31 - l32 * l32, a33)
    _store_triangle(work, f, (l00, l10, l20, l30, l11, l21, l31, l22, l32, l33))


@inline_njit
def _times_factor(work, half, q):
    b, (q0, q1, q2, q3) = L + 10 * half, q
    return (
        load(work, b) * q0
        + load(work, b + 1) * q1
        + load(work, b + 2) * q2
        + load(work, b + 3) * q3,
        load(work, b + 4) * q1 + load(work, b + 5) * q2 + load(work, b + 6) * q3,
        load(work, b + 7) * q2 + load(work, b + 8) * q3,
        load(work, b + 9) * q3,
    )


@njit
def _factor(P, first, work):
    r"""Write C with :math:`C C^T = I + L^T P_e L`, lower triangle with inverse diagonal, into F."""
    for half in range(2):
        for j in range(8):
            x = _times_factor(work, half, _load_column(P, first, half, OBSERVED[j]))
            _store_every(work, F + 32 * half + j, 8, x)
    for i in range(8):  # F L, row by row, as L' times its columns
        for half in range(2):
            o = F + 8 * i + 4 * half
            q = load(work, o), load(work, o + 1), load(work, o + 2), load(work, o + 3)
            _store_every(work, o + M - F, 1, _times_factor(work, half, q))
    for i in range(8):
        for j in range(i):
            value = load(work, M + 8 * i + j)
            for k in range(j):
                value -= load(work, F + 8 * i + k) * load(work, F + 8 * j + k)
            store(work, F + 8 * i + j, value * load(work, F + 9 * j))
        value = 1.0 + load(work, M + 9 * i)
        for k in range(i):
            f = load(work, F + 8 * i + k)
            value -= f * f
        store(work, F + 9 * i, 1.0 / sqrt(value))


@njit
def _substitute(work, first, columns):
    for j in range(columns):
        for i in range(8):
            value = load(work, first + columns * i + j)
            for k in range(i):
                value -= load(work, F + 8 * i + k) * load(work, first + columns * k + j)
            store(work, first + columns * i + j, value * load(work, F + 9 * i))


@njit
def update(P, first, covariance_update, work):
    r"""Correct the covariance in place, and write the correction of the state.

    With :math:`A = L L^T` block by block, :math:`C C^T = I + L^T P_e L` and
    :math:`V = C^{-1} L^T`, the matrix of the gain is :math:`T = (I + A P_e)^{-1} = I - N P_e`,
    :math:`N = T A = V^T V`, and with :math:`P_c = P E^T`

    .. math::
        \delta x &= P_c T y \\
        \text{plain:}\quad P &\leftarrow P - P_c\, \mathrm{sym}(T A_1)\, P_c^T
        \quad\text{(the symmetric part of } (I - K W H) P\text{)} \\
        \text{unweighted:}\quad P &\leftarrow P - P_c N P_c^T \\
        \text{general:}\quad P &\leftarrow P - P_c \left(T A_1 + A_1 T^T
        - T (A_1 P_e A_1 + A_2) T^T\right) P_c^T

    The third is :math:`(I - KWH) P (I - KWH)^T + KW R W^T K^T`, right for any gain.

    `P`, `first`: lane array and first row of the packed covariance, predicted before and updated
    after; `work`: scratch memory of `WORK` rows, with y from `Y` on and the lower triangles of A
    from `L` on; for the other two updates also those of A1 and A2.  The correction is in its first
    17 rows from `X` on.
    """
    for half in range(2):
        factor_block(work, L + 10 * half)
    _factor(P, first, work)
    for half in range(2):  # Q = C^-1 L' Pc'
        for j in range(17):
            x = _times_factor(work, half, _load_column(P, first, half, j))
            _store_every(work, Q + 68 * half + j, 17, x)
    _substitute(work, Q, 17)
    # dx = Pc (y - V' V Pe y) = Pc y - Q' (V Pe y), where V Pe are columns E of Q
    zero = splat(0.0, P)
    for i in range(8):
        value = zero
        for k in range(8):
            value += load(work, Q + 17 * i + OBSERVED[k]) * load(work, Y + k)
        store(work, X + 17 + i, value)
    for j in range(17):
        value = zero
        for k in range(8):
            value += load(P, first + INDEX[OBSERVED[k], j]) * load(work, Y + k)
        for k in range(8):
            value -= load(work, Q + 17 * k + j) * load(work, X + 17 + k)
        store(work, X + j, value)
    if covariance_update == UNWEIGHTED:
        _subtract_square(P, first, work)
    else:
        _update_with_weights(P, first, covariance_update, work)


@njit
def _subtract_square(P, first, work):
    """P -= Q' Q, on and above the diagonal."""
    k = first
    for i in range(17):
        n0, n1 = load(work, Q + i), load(work, Q + 17 + i)
        n2, n3 = load(work, Q + 34 + i), load(work, Q + 51 + i)
        n4, n5 = load(work, Q + 68 + i), load(work, Q + 85 + i)
        n6, n7 = load(work, Q + 102 + i), load(work, Q + 119 + i)
        for j in range(i, 17):
            q = Q + j
            change = (
                (n0 * load(work, q) + n1 * load(work, q + 17))
                + (n2 * load(work, q + 34) + n3 * load(work, q + 51))
            ) + (
                (n4 * load(work, q + 68) + n5 * load(work, q + 85))
                + (n6 * load(work, q + 102) + n7 * load(work, q + 119))
            )
            store(P, k, load(P, k) - change)
            k += 1


@inline_njit
def _lower(work, first, i, j):
    """Element of a symmetric block-diagonal matrix that is stored as two lower triangles."""
    high, low = max(i, j) % 4, min(i, j) % 4
    return load(work, first + 10 * (i // 4) + 4 * low - low * (low - 1) // 2 + high - low)


@njit
def _expand(work, first, out):
    zero = splat(0.0, work)
    for i in range(8):
        for j in range(8):
            value = zero
            if i // 4 == j // 4:
                value = _lower(work, first, i, j)
            store(out, 8 * i + j, value)


@njit
def _multiply(a, b, c, transposed):
    zero = splat(0.0, a)
    for i in range(8):
        for j in range(8):
            total = zero
            for k in range(8):
                total += load(a, 8 * i + k) * load(b, 8 * j + k if transposed else 8 * k + j)
            store(c, 8 * i + j, total)


@njit
def _update_with_weights(P, first, covariance_update, work):
    """P -= Pc X Pc', where X is what the two weighted updates have there."""
    rest = work[REST:]
    T, first_sum, second_sum = rest[:64], rest[64:128], rest[128:192]
    N, Pe, product, columns = rest[192:256], rest[256:320], rest[320:384], rest[384:520]
    zero = splat(0.0, P)
    for i in range(8):  # V = C^-1 L', by columns of L'
        for j in range(8):
            value = zero
            if i // 4 == j // 4 and j >= i:
                value = _lower(work, L, j, i)
            store(work, V + 8 * i + j, value)
            store(Pe, 8 * i + j, load(P, first + INDEX[OBSERVED[i], OBSERVED[j]]))
    _substitute(work, V, 8)
    for i in range(8):
        for j in range(8):
            total = zero
            for k in range(8):
                total += load(work, V + 8 * k + i) * load(work, V + 8 * k + j)
            store(N, 8 * i + j, total)
    _multiply(N, Pe, T, False)
    for i in range(8):  # T = I - N Pe
        for j in range(8):
            store(T, 8 * i + j, (1.0 if i == j else 0.0) - load(T, 8 * i + j))
    _expand(work, A1, first_sum)
    _multiply(T, first_sum, product, False)  # T A1
    if covariance_update == GENERAL:
        _expand(work, A2, second_sum)
        _multiply(Pe, first_sum, N, False)
        _multiply(first_sum, N, Pe, False)
        for k in range(64):  # A1 Pe A1 + A2
            store(Pe, k, load(Pe, k) + load(second_sum, k))
        _multiply(T, Pe, N, False)
        _multiply(N, T, Pe, True)
    for i in range(8):
        for j in range(8):
            value = load(product, 8 * i + j) + load(product, 8 * j + i)
            if covariance_update == PLAIN:
                value = 0.5 * value
            else:
                value -= load(Pe, 8 * i + j)
            store(N, 8 * i + j, value)
    for i in range(8):  # Q = X Pc'
        for j in range(17):
            total = zero
            for k in range(8):
                total += load(N, 8 * i + k) * load(P, first + INDEX[OBSERVED[k], j])
            store(work, Q + 17 * i + j, total)
    for k in range(8):
        for j in range(17):
            store(columns, 17 * k + j, load(P, first + INDEX[OBSERVED[k], j]))
    p = first
    for i in range(17):
        for j in range(i, 17):
            total = load(P, p)
            for k in range(8):
                total -= load(columns, 17 * k + i) * load(work, Q + 17 * k + j)
            store(P, p, total)
            p += 1


@njit
def innovation_covariance(x, P, u, noise, R, visible, n, S, t):
    r"""Write the innovation covariance :math:`S = H P H^T + R`, on and above the diagonal.

    `x`: lane array; `P`, `u`, `visible`: first rows in it of the packed covariance, lines of sight
    (3 n rows), and of n rows that are above 0 where a satellite is visible; `noise`, `R`: lane
    array and first row of the noise variances (2 n); an invisible slot has the row and column of
    the identity; `S`: lane array of 4 n^2 rows, row by row; `t`: scratch memory of 8 rows.
    """
    m = 2 * n
    for k in range(m):
        for j in range(k, m):
            store(S, k * m + j, 1.0 if j == k else 0.0)
    for k in range(m):
        s, half = k % n, k // n
        seen = load(x, visible + s) > 0.0
        if not any_lane(seen):
            continue
        ux, uy, uz = load(x, u + 3 * s), load(x, u + 3 * s + 1), load(x, u + 3 * s + 2)
        for i in range(8):  # the row of H P
            p = _load_column(x, P, half, OBSERVED[i])
            store(t, i, (ux * p[0] + uy * p[1]) + (uz * p[2] + p[3]))
        for j in range(k, m):
            a, b = u + 3 * (j % n), 4 * (j // n)
            both = seen & (load(x, visible + j % n) > 0.0)
            value = (load(x, a) * load(t, b) + load(x, a + 1) * load(t, b + 1)) + (
                load(x, a + 2) * load(t, b + 2) + load(t, b + 3)
            )
            if j == k:
                value += load(noise, R + k)
            store(S, k * m + j, select(both, value, load(S, k * m + j)))


@njit
def innovation_variance(x, P, u, noise, R, visible, n, out):
    """Write the diagonal of S, 2 n rows; the others as in `innovation_covariance`."""
    for half in range(2):
        o = 4 * half
        p00, p01, p02, p03 = _load_column(x, P, half, OBSERVED[o])
        _, p11, p12, p13 = _load_column(x, P, half, OBSERVED[o + 1])
        _, _, p22, p23 = _load_column(x, P, half, OBSERVED[o + 2])
        _, _, _, p33 = _load_column(x, P, half, OBSERVED[o + 3])
        for s in range(n):
            ux, uy, uz = load(x, u + 3 * s), load(x, u + 3 * s + 1), load(x, u + 3 * s + 2)
            t0 = (ux * p00 + uy * p01) + (uz * p02 + p03)
            t1 = (ux * p01 + uy * p11) + (uz * p12 + p13)
            t2 = (ux * p02 + uy * p12) + (uz * p22 + p23)
            t3 = (ux * p03 + uy * p13) + (uz * p23 + p33)
            k = s + half * n
            value = ((ux * t0 + uy * t1) + (uz * t2 + t3)) + load(noise, R + k)
            store(out, k, select(load(x, visible + s) > 0.0, value, 1.0))


@njit
def normalized_innovation_squared(innovation, innovation_cov, first, last):
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
        square_all(part, belief, np.empty(rows), out)
    else:
        square_all(part, belief, np.empty((rows, LANES)), out)
    return out


@inline_njit
def square_all(innovation, innovation_cov, work, out):
    """All receivers, as many side by side as the lane array `work` has lanes. Its rows are the
    lower triangle of S, line after line, and z as one more line."""
    receivers, size = innovation.shape
    for group in range(0, receivers, count_lanes(work)):
        for k in range(count_lanes(work)):
            b, row = min(group + k, receivers - 1), 0
            for i in range(size):
                for j in range(i + 1):
                    set_lane(work, row, k, innovation_cov[b, i, j])
                    row += 1
            for i in range(size):
                set_lane(work, row + i, k, innovation[b, i])
        _square(work, size)
        for k in range(min(count_lanes(work), receivers - group)):
            out[group + k] = lane(work, 0, k)


@inline_njit
def _square(work, size):
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
