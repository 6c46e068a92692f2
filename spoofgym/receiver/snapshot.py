r"""Snapshot receiver: position and clock of one epoch's pseudoranges, with no memory but a guess.

.. math:: \hat x^+ = \hat x + (G^T W G)^{-1} G^T W (\tilde\rho - \hat\rho(\hat x)), \qquad
    G = (-u, 1)

is iterated from the last fix.  Weights W come from a detector in the loop; those of excluded
satellites are 0.  For tests of innovations, the receiver also says what it expected: the last fix,
which it trusts so little that hardly anything but the residuals of the fit counts.

Source: `groves2013`, eqs. 9.141 and 9.143.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._jit import njit
from ..earth.ranging import range_and_rate
from .fits import PRODUCTS, add, solve, squared_residual, write_products
from .raim import STATES

FloatArray = NDArray[np.float64]

ITERATIONS = 20
TOLERANCE_M = 1e-4
EXPECTED_POSITION_SD_M = 1e3
EXPECTED_CLOCK_SD_M = 1e4
"""How little the last fix is trusted."""

FIXED, TOO_FEW, SINGULAR, DIVERGED = range(4)


class SnapshotFix(NamedTuple):
    """A fix of one epoch.

    - `position_e` (3,) ECEF [m];
    - `clock_bias_m`: receiver clock [m];
    - `residual` (n,) pseudorange minus what the fix predicts [m]; NaN for satellites that were left
      out;
    - `line_of_sight_e` (n, 3) unit vectors to the satellites, ECEF.
    """

    position_e: FloatArray
    clock_bias_m: float
    residual: FloatArray
    line_of_sight_e: FloatArray


@njit
def geometry(
    satellites: FloatArray, position: FloatArray, lines: FloatArray, distances: FloatArray
) -> None:
    """Lines and ranges of one receiver.

    `satellites` (n, 3) ECEF [m]; `position` (3,) ECEF [m]; `lines`, `distances` (n, 3), (n,),
    written: minus the lines of sight, and ranges [m].
    """
    for j in range(distances.shape[0]):
        distance, _, ux, uy, uz = range_and_rate(
            satellites[j, 0],
            satellites[j, 1],
            satellites[j, 2],
            0.0,
            0.0,
            0.0,
            position[0],
            position[1],
            position[2],
            0.0,
            0.0,
            0.0,
        )
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
    """Fix of one receiver; it keeps position and clock where there is none.

    `pseudorange`, `satellites`, `weights` (n,), (n, 3), (n,); what isn't finite has no weight;
    `position`, `clock` (3,) ECEF and (1,) [m], guess, overwritten by the fix; `lines`, `distances`
    (n, 3), (n,) scratch; `sums` (2, PRODUCTS) scratch.
    """
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
        solve(sums, 0, step)
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
    """Fixes of a batch.

    `pseudorange`, `satellites`, `weights` (B, n), (B, n, 3), (B, at least n); `position`, `clock`
    (B, 3), (B, 1) guesses, ECEF [m], overwritten by fixes where there are any; `status` (B,),
    written, as by `iterate`.
    """
    n = pseudorange.shape[1]
    lines, distances = np.empty((n, 3)), np.empty(n)
    sums = np.empty((2, PRODUCTS))
    for b in range(pseudorange.shape[0]):
        status[b] = iterate(
            pseudorange[b],
            satellites[b],
            weights[b],
            position[b],
            clock[b],
            lines,
            distances,
            sums,
        )


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


def snapshot_fix(
    pseudorange: ArrayLike, satellite_position_e: ArrayLike, guess_e: ArrayLike = (0.0, 0.0, 0.0)
) -> SnapshotFix:
    """Fix of one epoch of pseudoranges, all of the same weight.

    `pseudorange` (n,) [m]; what isn't finite is left out; `satellite_position_e` (n, 3) ECEF [m];
    `guess_e` (3,) first guess, ECEF [m]; the centre of the Earth does.

    Examples
    --------
    >>> import numpy as np
    >>> from spoofgym.receiver.snapshot import snapshot_fix
    >>> satellites = 2.6e7 * np.vstack([np.eye(3), -np.eye(3)])
    >>> round(snapshot_fix(np.full(6, 2.6e7 + 100.0), satellites).clock_bias_m)
    100
    """
    rho = np.ascontiguousarray(pseudorange, dtype=np.float64)
    satellites = np.ascontiguousarray(satellite_position_e, dtype=np.float64)
    if rho.ndim != 1 or satellites.shape != (len(rho), 3):
        raise ValueError(
            "`pseudorange` must be (n,) and `satellite_position_e` (n, 3), "
            f"got {rho.shape} and {satellites.shape}"
        )
    position, clock = np.array([guess_e], dtype=np.float64), np.zeros((1, 1))
    if position.shape != (1, 3) or not np.isfinite(position).all():
        raise ValueError(f"`guess_e` must be three finite numbers, got {guess_e!r}")
    usable = np.isfinite(rho) & np.isfinite(satellites).all(axis=1)
    lines, distances = np.empty((len(rho), 3)), np.empty(len(rho))
    status = np.zeros(1, dtype=np.int64)
    fix_receivers(rho[None], satellites[None], usable.astype(float)[None], position, clock, status)
    if status[0] == TOO_FEW:
        raise ValueError(f"a fix needs at least {STATES} satellites, got {usable.sum()}")
    if status[0] == SINGULAR:
        raise ValueError("the geometry of the satellites is singular")
    if status[0] == DIVERGED:
        raise ValueError(f"no convergence within {ITERATIONS} iterations")
    geometry(satellites, position[0], lines, distances)
    residual = np.where(usable, rho - distances - clock[0, 0], np.nan)
    return SnapshotFix(position[0], float(clock[0, 0]), residual, -lines)
