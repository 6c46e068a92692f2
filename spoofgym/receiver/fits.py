r"""Least-squares fits of many subsets of the same satellites.

Every satellite has its products in a row, those of a subset are added up, and the fit takes a 4 x 4
elimination.  Sums are only ever added to, never subtracted from, so that one wild pseudorange does
not spoil the sets without it; and offsets are taken from their median, so that the clock costs no
digits.

What isn't finite is told by comparisons, here and in other kernels: ``math.isfinite`` takes a
number from itself, which the relaxed floating-point rules turn into 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._jit import inlined, njit

FloatArray = NDArray[np.float64]

SINGULAR = 1e-10
"""Pivots up to this make a geometry singular."""
PRODUCTS = 16
"""Columns of a satellite's row: 1 g y, the products of g, g y, y y, and one for alignment."""


@inlined
def write_products(
    lines: FloatArray, j: int, offset: float, weight: float, table: FloatArray, i: int
) -> None:
    """Products of one satellite.

    Rows are told by array and number here and below: a row as an array of its own costs more than
    what is done with it.

    `lines` (n, 3) g, minus the lines of sight; `offset`: y [m]; `table` (N, PRODUCTS), of which row
    i is written.
    """
    x, y, z = lines[j, 0], lines[j, 1], lines[j, 2]
    wx, wy, wz = weight * x, weight * y, weight * z
    table[i, 0], table[i, 1], table[i, 2], table[i, 3] = weight, wx, wy, wz
    table[i, 4], table[i, 14] = weight * offset, weight * offset * offset
    table[i, 5], table[i, 6], table[i, 7] = wx * x, wx * y, wx * z
    table[i, 8], table[i, 9], table[i, 10] = wy * y, wy * z, wz * z
    table[i, 11], table[i, 12], table[i, 13] = wx * offset, wy * offset, wz * offset
    table[i, 15] = 0.0


@inlined
def add(a: FloatArray, i: int, b: FloatArray, j: int, out: FloatArray, k: int) -> None:
    """Sum of two rows of products.

    `a` (N, PRODUCTS) one table; `b` (N, PRODUCTS) another one, or the same; `out` (N, PRODUCTS), of
    which row k is written.
    """
    for c in range(PRODUCTS):
        out[k, c] = a[i, c] + b[j, c]


@inlined
def eliminate(
    n: float,
    sx: float,
    sy: float,
    sz: float,
    s: float,
    xx: float,
    xy: float,
    xz: float,
    yy: float,
    yz: float,
    zz: float,
    bx: float,
    by: float,
    bz: float,
    ss: float,
) -> float:
    """Sum of the squared residuals of a least-squares fit, by elimination of its unknowns.

    Returns s^2 [m^2]; infinite where the geometry is singular.
    """
    inverse = 1.0 / n
    x, y, z, m = sx * inverse, sy * inverse, sz * inverse, s * inverse
    d1 = xx - sx * x
    if not d1 > SINGULAR:
        return np.inf
    a12, a13, a23 = xy - sx * y, xz - sx * z, yz - sy * z
    b1, b2, b3 = bx - sx * m, by - sy * m, bz - sz * m
    inverse = 1.0 / d1
    l21, l31 = a12 * inverse, a13 * inverse
    d2 = yy - sy * y - l21 * a12
    if not d2 > SINGULAR:
        return np.inf
    a23 -= l21 * a13
    over = 1.0 / d2
    l32 = a23 * over
    d3 = zz - sz * z - l31 * a13 - l32 * a23
    if not d3 > SINGULAR:
        return np.inf
    w2 = b2 - l21 * b1
    w3 = b3 - l31 * b1 - l32 * w2
    return ss - s * m - b1 * b1 * inverse - w2 * w2 * over - w3 * w3 / d3


@inlined
def squared_residual(a: FloatArray, i: int) -> float:
    """Sum of the squared residuals of a fit.

    `a` (N, PRODUCTS), of which row i holds sums over the satellites of the fit; returns s^2 [m^2];
    infinite where the geometry is singular.
    """
    return eliminate(
        a[i, 0],
        a[i, 1],
        a[i, 2],
        a[i, 3],
        a[i, 4],
        a[i, 5],
        a[i, 6],
        a[i, 7],
        a[i, 8],
        a[i, 9],
        a[i, 10],
        a[i, 11],
        a[i, 12],
        a[i, 13],
        a[i, 14],
    )


@inlined
def squared_residual_of_both(a: FloatArray, i: int, b: FloatArray, j: int) -> float:
    """Sum of the squared residuals of a fit to two sets of satellites together.

    `a` (N, PRODUCTS), of which row i holds sums over one set; `b` (N, PRODUCTS), of which row j
    holds sums over the other; returns s^2 [m^2]; infinite where the geometry is singular.
    """
    return eliminate(
        a[i, 0] + b[j, 0],
        a[i, 1] + b[j, 1],
        a[i, 2] + b[j, 2],
        a[i, 3] + b[j, 3],
        a[i, 4] + b[j, 4],
        a[i, 5] + b[j, 5],
        a[i, 6] + b[j, 6],
        a[i, 7] + b[j, 7],
        a[i, 8] + b[j, 8],
        a[i, 9] + b[j, 9],
        a[i, 10] + b[j, 10],
        a[i, 11] + b[j, 11],
        a[i, 12] + b[j, 12],
        a[i, 13] + b[j, 13],
        a[i, 14] + b[j, 14],
    )


@njit
def solve(sums: FloatArray, i: int, x: FloatArray) -> None:
    """Least-squares solution, of a geometry that isn't singular.

    `sums` (N, PRODUCTS), of which row i holds sums over the satellites of the fit; `x` (4,),
    written: position and clock [m].
    """
    a = sums[i]
    n = a[0]
    d1 = a[5] - a[1] * a[1] / n
    a12, a13, a23 = a[6] - a[1] * a[2] / n, a[7] - a[1] * a[3] / n, a[9] - a[2] * a[3] / n
    b1, b2, b3 = a[11] - a[1] * a[4] / n, a[12] - a[2] * a[4] / n, a[13] - a[3] * a[4] / n
    l21, l31 = a12 / d1, a13 / d1
    d2 = a[8] - a[2] * a[2] / n - l21 * a12
    a23 -= l21 * a13
    l32 = a23 / d2
    d3 = a[10] - a[3] * a[3] / n - l31 * a13 - l32 * a23
    w2 = b2 - l21 * b1
    x[2] = (b3 - l31 * b1 - l32 * w2) / d3
    x[1] = w2 / d2 - l32 * x[2]
    x[0] = b1 / d1 - l21 * x[1] - l31 * x[2]
    x[3] = (a[4] - a[1] * x[0] - a[2] * x[1] - a[3] * x[2]) / n


@njit
def tabulate(n: int, lines: FloatArray, offsets: FloatArray, table: FloatArray) -> float:
    """Products of all satellites, with the offsets taken from their median, and their fit.

    `n`: number of satellites, at least 1; `lines` (N, 3) g of the first n; `offsets` (N,) y of the
    first n [m], overwritten with y minus its median; `table` (N + 1, PRODUCTS), written: n rows,
    and the sum of them in the last one; returns s^2 of all [m^2]; infinite where the geometry is
    singular.
    """
    last = table.shape[0] - 1
    for i in range(n):  # sorted into a column that is not in use yet
        k = i
        while k > 0 and table[k - 1, 0] > offsets[i]:
            table[k, 0] = table[k - 1, 0]
            k -= 1
        table[k, 0] = offsets[i]
    middle = table[n // 2, 0]
    for j in range(PRODUCTS):
        table[last, j] = 0.0
    for i in range(n):
        offsets[i] -= middle
        write_products(lines, i, offsets[i], 1.0, table, i)
        add(table, last, table, i, table, last)
    return squared_residual(table, last)
