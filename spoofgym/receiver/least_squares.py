"""Single-epoch least-squares fix of position, velocity and clock."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..earth.wgs84 import EARTH_RATE, SPEED_OF_LIGHT

MAX_ITERATIONS = 20
TOLERANCE_M = 1e-5
MAX_GDOP = 1e6


class Fix(NamedTuple):
    """A least-squares solution.

    Attributes
    ----------
    position_e, velocity_e : ndarray
        (3,) ECEF [m], [m/s].
    clock_bias_m, clock_drift_mps : float
        Receiver clock [m], [m/s].
    """

    position_e: NDArray[np.float64]
    velocity_e: NDArray[np.float64]
    clock_bias_m: float
    clock_drift_mps: float


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
    use = np.isfinite(pr) & np.isfinite(rr) & np.isfinite(sp).all(-1) & np.isfinite(sv).all(-1)
    pr, rr, sp, sv = pr[use], rr[use], sp[use], sv[use]
    if len(pr) < 4:
        raise ValueError(f"a fix needs at least 4 satellites, got {len(pr)}")
    r, bias = np.array(guess_e, dtype=float), 0.0
    if r.shape != (3,) or not np.isfinite(r).all():
        raise ValueError(f"`guess_e` must be three finite numbers, got {guess_e!r}")
    for _ in range(MAX_ITERATIONS):
        u, distance = _geometry(sp, r)
        H = np.column_stack([-u, np.ones(len(u))])
        if not np.linalg.cond(H) < MAX_GDOP:
            raise ValueError("the geometry of the satellites is singular")
        dx = np.linalg.lstsq(H, pr - distance - bias, rcond=None)[0]
        r, bias = r + dx[:3], bias + dx[3]
        if np.abs(dx).max() < TOLERANCE_M:
            break
    else:
        raise ValueError(f"no convergence within {MAX_ITERATIONS} iterations")
    u, _ = _geometry(sp, r)
    a = EARTH_RATE * np.linalg.norm(sp - r, axis=-1) / SPEED_OF_LIGHT
    spin = np.array([0.0, 0.0, EARTH_RATE])
    moving = sv + np.cross(spin, sp)
    moving = moving + np.column_stack([a * moving[:, 1], -a * moving[:, 0], np.zeros(len(a))])
    H = np.column_stack([-u, np.ones(len(u))])
    predicted = np.einsum("ij,ij->i", u, moving - np.cross(spin, r))
    dv = np.linalg.lstsq(H, rr - predicted, rcond=None)[0]
    return Fix(r, dv[:3], float(bias), float(dv[3]))


def _geometry(
    satellites: NDArray[np.float64], r: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lines of sight and distances, Sagnac to first order."""
    a = EARTH_RATE * np.linalg.norm(satellites - r, axis=-1) / SPEED_OF_LIGHT
    shift = np.column_stack([a * satellites[:, 1], -a * satellites[:, 0], np.zeros(len(a))])
    turned = satellites + shift
    distance = np.linalg.norm(turned - r, axis=-1)
    return (turned - r) / distance[:, None], distance
