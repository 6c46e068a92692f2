r"""Snapshot receiver: position and clock of one epoch's pseudoranges, with no memory but a guess.

.. math:: \hat x^+ = \hat x + (G^T W G)^{-1} G^T W (\tilde\rho - \hat\rho(\hat x)), \qquad
    G = (-u, 1)

is iterated from the last fix (`fix_receivers`).  Weights W come from a detector in the loop; those
of excluded satellites are 0.  For tests of innovations, the receiver also has a prediction: the
last fix, which it trusts so little that hardly anything but the residuals of the fit counts.

Every satellite has its products in a row, those of a subset are added up, and the fit takes a 4 x 4
elimination.  Sums are only ever added to, so that one wild pseudorange does not spoil the sets
without it; and offsets are taken from their median, so that the clock costs no digits.

Source: `groves2013`, eqs. 9.141 and 9.143.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.compile import inline_njit, njit
from ..core.registry import require
from ..earth.wgs84 import STILL, range_and_rate

STATES = 4  # position and clock
SMALLEST_PIVOT = 1e-10  # pivots up to this make a geometry singular
PRODUCTS = 16  # columns of a satellite's row: 1 g y, products of g, g y, y y, one for alignment
ITERATIONS = 20
TOLERANCE_M = 1e-4
FIXED, TOO_FEW, SINGULAR, DIVERGED = range(4)  # outcome of a fix


@inline_njit
def write_products(
    lines: FloatArray, j: int, offset: float, weight: float, table: FloatArray, i: int
) -> None:
    """Products of one satellite. Rows are given by array and number here and below: a row as an
    array of its own costs more than what is done with it. `lines` (n, 3) g, minus the lines of
    sight; `offset`: y [m]; `table` (N, PRODUCTS), of which row i is written."""
    x, y, z = lines[j, 0], lines[j, 1], lines[j, 2]
    wx, wy, wz = weight * x, weight * y, weight * z
    table[i, 0], table[i, 1], table[i, 2], table[i, 3] = weight, wx, wy, wz
    table[i, 4], table[i, 14] = weight * offset, weight * offset * offset
    table[i, 5], table[i, 6], table[i, 7] = wx * x, wx * y, wx * z
    table[i, 8], table[i, 9], table[i, 10] = wy * y, wy * z, wz * z
    table[i, 11], table[i, 12], table[i, 13] = wx * offset, wy * offset, wz * offset
    table[i, 15] = 0.0


@inline_njit
def add(a: FloatArray, i: int, b: FloatArray, j: int, out: FloatArray, k: int) -> None:
    """Sum of two rows of products. `a` (N, PRODUCTS) one table; `b` (N, PRODUCTS) another one, or
    the same; `out` (N, PRODUCTS), of which row k is written."""
    for c in range(PRODUCTS):
        out[k, c] = a[i, c] + b[j, c]


@inline_njit
def eliminate(sums: tuple[float, ...]) -> float:
    """Sum of the squared residuals of a fit, s^2 [m^2], by elimination of its unknowns; `sums`: a
    row of products, without the last; infinite where the geometry is singular."""
    n, sx, sy, sz, s, xx, xy, xz, yy, yz, zz, bx, by, bz, ss = sums
    inverse = 1.0 / n
    x, y, z, m = sx * inverse, sy * inverse, sz * inverse, s * inverse
    d1 = xx - sx * x
    if not d1 > SMALLEST_PIVOT:
        return np.inf
    a12, a13, a23 = xy - sx * y, xz - sx * z, yz - sy * z
    b1, b2, b3 = bx - sx * m, by - sy * m, bz - sz * m
    inverse = 1.0 / d1
    l21, l31 = a12 * inverse, a13 * inverse
    d2 = yy - sy * y - l21 * a12
    if not d2 > SMALLEST_PIVOT:
        return np.inf
    a23 -= l21 * a13
    over = 1.0 / d2
    l32 = a23 * over
    d3 = zz - sz * z - l31 * a13 - l32 * a23
    if not d3 > SMALLEST_PIVOT:
        return np.inf
    w2 = b2 - l21 * b1
    w3 = b3 - l31 * b1 - l32 * w2
    return ss - s * m - b1 * b1 * inverse - w2 * w2 * over - w3 * w3 / d3


@inline_njit
def _five(a: FloatArray, i: int, c: int) -> tuple[float, ...]:
    return a[i, c], a[i, c + 1], a[i, c + 2], a[i, c + 3], a[i, c + 4]


@inline_njit
def _five_of_both(a: FloatArray, i: int, b: FloatArray, j: int, c: int) -> tuple[float, ...]:
    x, y, z = a[i, c] + b[j, c], a[i, c + 1] + b[j, c + 1], a[i, c + 2] + b[j, c + 2]
    return x, y, z, a[i, c + 3] + b[j, c + 3], a[i, c + 4] + b[j, c + 4]


@inline_njit
def squared_residual(a: FloatArray, i: int) -> float:
    """`eliminate` of row i of `a` (N, PRODUCTS), sums over the satellites of the fit."""
    return eliminate(_five(a, i, 0) + _five(a, i, 5) + _five(a, i, 10))


@inline_njit
def squared_residual_of_both(a: FloatArray, i: int, b: FloatArray, j: int) -> float:
    """`eliminate` of two sets of satellites together: row i of `a` (N, PRODUCTS), and j of `b`."""
    first, second = _five_of_both(a, i, b, j, 0), _five_of_both(a, i, b, j, 5)
    return eliminate(first + second + _five_of_both(a, i, b, j, 10))


@njit
def solve_fix(sums: FloatArray, i: int, x: FloatArray) -> None:
    """Least-squares solution, of a geometry that isn't singular. `sums` (N, PRODUCTS), of which row
    i holds sums over the satellites of the fit; `x` (4,), written: position and clock [m]."""
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


@njit
def geometry(
    satellites: FloatArray, position: FloatArray, lines: FloatArray, distances: FloatArray
) -> None:
    """Lines and ranges of one receiver. `satellites` (n, 3) ECEF [m]; `position` (3,) ECEF [m];
    `lines`, `distances` (n, 3), (n,), written: minus the lines of sight, and ranges [m]."""
    here = position[0], position[1], position[2]
    for j in range(distances.shape[0]):
        place = satellites[j, 0], satellites[j, 1], satellites[j, 2]
        distance, _, ux, uy, uz = range_and_rate(place, STILL, here, STILL)
        lines[j, 0], lines[j, 1], lines[j, 2] = -ux, -uy, -uz
        distances[j] = distance


@njit
def iterate(
    pseudorange: FloatArray,
    satellites: FloatArray,
    weights: FloatArray,
    position: FloatArray,
    clock: FloatArray,
    lines: FloatArray,
    distances: FloatArray,
    sums: FloatArray,
) -> int:
    """Fix of one receiver; without a fix it keeps position and clock. `pseudorange`,
    `satellites`, `weights` (n,), (n, 3), (n,); what isn't finite has no weight; `position`, `clock`
    (3,) ECEF and (1,) [m], guess, overwritten by the fix; `lines`, `distances` (n, 3), (n,)
    scratch; `sums` (2, PRODUCTS) scratch."""
    r, step = position.copy(), np.zeros(4)
    bias, used = clock[0], 0
    for j in range(pseudorange.shape[0]):
        used += weights[j] > 0.0 and abs(pseudorange[j]) < np.inf
    if used < STATES:
        return TOO_FEW
    for _ in range(ITERATIONS):
        geometry(satellites, r, lines, distances)
        sums[:] = 0.0
        for j in range(pseudorange.shape[0]):
            if weights[j] > 0.0 and abs(pseudorange[j]) < np.inf:
                offset = pseudorange[j] - distances[j] - bias
                write_products(lines, j, offset, weights[j], sums, 1)
                add(sums, 0, sums, 1, sums, 0)
        if not squared_residual(sums, 0) < np.inf:
            return SINGULAR
        solve_fix(sums, 0, step)
        largest = abs(step[3])
        bias += step[3]
        for i in range(3):
            r[i] += step[i]
            largest = max(largest, abs(step[i]))
        if largest < TOLERANCE_M:
            position[:] = r
            clock[0] = bias
            return FIXED
    return DIVERGED


@njit
def fix_receivers(
    pseudorange: FloatArray,
    satellites: FloatArray,
    weights: FloatArray,
    position: FloatArray,
    clock: FloatArray,
    status: NDArray[np.int64],
) -> None:
    """Fixes of a batch. `pseudorange`, `satellites`, `weights` (B, n), (B, n, 3), (B, at least n);
    `position`, `clock` (B, 3), (B, 1) guesses, ECEF [m], overwritten by fixes where there are any;
    `status` (B,), written, as by `iterate`."""
    n = pseudorange.shape[1]
    lines, distances = np.empty((n, 3)), np.empty(n)
    sums = np.empty((2, PRODUCTS))
    for b in range(pseudorange.shape[0]):
        measured, fix = (pseudorange[b], satellites[b], weights[b]), (position[b], clock[b])
        status[b] = iterate(*measured, *fix, lines, distances, sums)


class Fix(NamedTuple):
    """A least-squares solution.

    Attributes
    ----------
    position_e, velocity_e : ndarray
        (3,) ECEF [m], [m/s].
    clock_bias_m, clock_drift_mps : float
        Receiver clock [m], [m/s].
    """

    position_e: FloatArray
    velocity_e: FloatArray
    clock_bias_m: float
    clock_drift_mps: float


@njit
def fit_rates(
    range_rate: FloatArray,
    satellites: FloatArray,
    velocities: FloatArray,
    r: FloatArray,
    step: FloatArray,
) -> None:
    """Velocity and clock drift at a position, of all satellites. `range_rate`, `satellites`,
    `velocities` (n,), (n, 3), (n, 3); `r` (3,) ECEF [m]; `step` (4,), written [m/s]."""
    lines, sums = np.empty((1, 3)), np.zeros((2, PRODUCTS))
    for j in range(range_rate.shape[0]):
        s, v = satellites[j], velocities[j]
        _, rate, ux, uy, uz = range_and_rate(s, v, r, STILL)
        lines[0, 0], lines[0, 1], lines[0, 2] = -ux, -uy, -uz
        write_products(lines, 0, range_rate[j] - rate, 1.0, sums, 1)
        add(sums, 0, sums, 1, sums, 0)
    solve_fix(sums, 0, step)


def least_squares_fix(
    pseudorange: ArrayLike,
    range_rate: ArrayLike,
    satellite_position_e: ArrayLike,
    satellite_velocity_e: ArrayLike,
    *,
    guess_e: ArrayLike = (0.0, 0.0, 0.0),
) -> Fix:
    r"""Fix of one epoch by iterated, equally weighted least squares.

    .. math:: \hat x^+ = \hat x^- + (H^T H)^{-1} H^T (\tilde z - \hat z), \qquad H = (-u, 1)

    first on the pseudoranges, then, with their geometry, on the range rates.

    Parameters
    ----------
    pseudorange, range_rate : array_like
        (n,) [m], [m/s]; a satellite with a NaN anywhere is left out.
    satellite_position_e, satellite_velocity_e : array_like
        (n, 3) ECEF [m], [m/s].
    guess_e : array_like
        (3,) first guess, ECEF [m]; the centre of the Earth does.

    Returns
    -------
    Fix
        Position, velocity and clock.

    Raises
    ------
    ValueError
        With fewer than 4 satellites, a singular geometry, no convergence, or a wrong guess.

    Notes
    -----
    Groves (2013), eqs. 9.133 and 9.141; the Sagnac effect to first order.
    """
    pr, rr = np.asarray(pseudorange, dtype=float), np.asarray(range_rate, dtype=float)
    sp = np.asarray(satellite_position_e, dtype=float)
    sv = np.asarray(satellite_velocity_e, dtype=float)
    require(
        pr.ndim == 1 and rr.shape == pr.shape and sp.shape == sv.shape == (len(pr), 3),
        "`pseudorange` and `range_rate` must be (n,), satellites' positions and velocities "
        f"(n, 3), got {pr.shape}, {rr.shape}, {sp.shape} and {sv.shape}",
    )
    use = np.isfinite(pr) & np.isfinite(rr) & np.isfinite(sp).all(-1) & np.isfinite(sv).all(-1)
    pr, rr, sp, sv = pr[use], rr[use], sp[use], sv[use]
    position, clock, drift = np.array([guess_e], dtype=float), np.zeros((1, 1)), np.empty(4)
    require(
        position.shape == (1, 3) and np.isfinite(position).all(),
        f"`guess_e` must be three finite numbers, got {guess_e!r}",
    )
    status = np.empty(1, dtype=np.int64)
    fix_receivers(pr[None], sp[None], np.ones((1, len(pr))), position, clock, status)
    require(status[0] != TOO_FEW, f"a fix needs at least {STATES} satellites, got {len(pr)}")
    require(status[0] != SINGULAR, "the geometry of the satellites is singular")
    require(status[0] != DIVERGED, f"no convergence within {ITERATIONS} iterations")
    fit_rates(rr, sp, sv, position[0], drift)
    return Fix(position[0], drift[:3], float(clock[0, 0]), float(drift[3]))


FloatArray = NDArray[np.float64]

EXPECTED_POSITION_SD_M = 1e3
EXPECTED_CLOCK_SD_M = 1e4  # how little the last fix is trusted


@njit
def expect(
    pseudorange: FloatArray,
    satellites: FloatArray,
    position: FloatArray,
    clock: FloatArray,
    noise_variance: float,
    innovation: FloatArray,
    innovation_cov: FloatArray,
    design: FloatArray,
) -> None:
    r"""Innovations against the last fix, and what they are believed to be.

    .. math:: S = G P G^T + R, \qquad
        P = \mathrm{diag}(\sigma_r^2, \sigma_r^2, \sigma_r^2, \sigma_c^2)

    `pseudorange`, `satellites` (B, n), (B, n, 3), all visible; `position`, `clock` (B, 3), (B, 1)
    last fix, ECEF [m]; `noise_variance`: R of one pseudorange [m^2]; `innovation`,
    `innovation_cov`, `design` (B, 2n), (B, 2n, 2n), (B, 2n, 4), written: pseudoranges; the rows of
    range rates, which this receiver doesn't measure, are those of invisible satellites.
    """
    n = pseudorange.shape[1]
    lines, distances = np.empty((n, 3)), np.empty(n)
    place, time = EXPECTED_POSITION_SD_M**2, EXPECTED_CLOCK_SD_M**2
    innovation[:] = 0.0
    innovation_cov[:] = 0.0
    design[:] = 0.0
    for b in range(pseudorange.shape[0]):
        geometry(satellites[b], position[b], lines, distances)
        for j in range(n):
            innovation[b, j] = pseudorange[b, j] - distances[j] - clock[b, 0]
            design[b, j, :3] = lines[j]
            design[b, j, 3] = 1.0
            for i in range(n):
                along = lines[j, 0] * lines[i, 0] + lines[j, 1] * lines[i, 1]
                along += lines[j, 2] * lines[i, 2]
                innovation_cov[b, j, i] = place * along + time
            innovation_cov[b, j, j] += noise_variance
            innovation_cov[b, n + j, n + j] = 1.0
