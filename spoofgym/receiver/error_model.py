"""The 17 states of the error-state filter, and how their errors grow between two epochs.

Order: attitude (ECEF axes), velocity, position, accelerometer biases, gyro biases, clock bias,
clock drift.  The state is the error of the estimate: estimate minus truth, but for the clock,
which is estimated as it is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from ..earth.wgs84 import EARTH_RATE, geocentric_surface_radius, gravity

STATES = 17
ATTITUDE, VELOCITY, POSITION, ACCEL_BIAS, GYRO_BIAS = 0, 3, 6, 9, 12
CLOCK_BIAS, CLOCK_DRIFT = 15, 16


@njit
def fill_transition(
    Phi: NDArray[np.float64],
    C: NDArray[np.float64],
    r: NDArray[np.float64],
    fx: float,
    fy: float,
    fz: float,
    tau: float,
) -> None:
    r"""Write the transition matrix of one interval, first order in its length.

    .. math::
        \Phi = \begin{pmatrix}
        I - \Omega\tau & 0 & 0 & 0 & C\tau & 0\\
        -[f_e\times]\tau & I - 2\Omega\tau & G\tau & C\tau & 0 & 0\\
        0 & I\tau & I & 0 & 0 & 0\\
        0 & 0 & 0 & I & 0 & 0\\
        0 & 0 & 0 & 0 & I & 0\\
        0 & 0 & 0 & 0 & 0 & \begin{smallmatrix}1 & \tau\\ 0 & 1\end{smallmatrix}
        \end{pmatrix}, \qquad G = -\frac{2 g(r)\, r^T}{r_{eS} |r|}

    Parameters
    ----------
    Phi : ndarray
        (17, 17), written in place; entries that are always 0 or 1 must hold those already.
    C : ndarray
        (3, 3) `C_eb` at the end of the interval.
    r : ndarray
        (3,) position at the end of the interval, ECEF [m].
    fx, fy, fz : float
        Last bias-corrected specific force of the interval, body axes [m/s^2].
    tau : float
        Length of the interval [s].

    Notes
    -----
    Groves (2013), eqs. 14.48 to 14.50.
    """
    w = EARTH_RATE * tau
    Phi[0, 1], Phi[1, 0] = w, -w
    Phi[3, 4], Phi[4, 3] = 2.0 * w, -2.0 * w
    ex = (C[0, 0] * fx + C[0, 1] * fy + C[0, 2] * fz) * tau
    ey = (C[1, 0] * fx + C[1, 1] * fy + C[1, 2] * fz) * tau
    ez = (C[2, 0] * fx + C[2, 1] * fy + C[2, 2] * fz) * tau
    Phi[3, 1], Phi[3, 2] = ez, -ey
    Phi[4, 0], Phi[4, 2] = -ez, ex
    Phi[5, 0], Phi[5, 1] = ey, -ex
    gx, gy, gz = gravity(r[0], r[1], r[2])
    norm = math.sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    k = -2.0 * tau / (geocentric_surface_radius(r[0], r[1], r[2]) * norm)
    for j in range(3):
        Phi[3, 6 + j] = k * gx * r[j]
        Phi[4, 6 + j] = k * gy * r[j]
        Phi[5, 6 + j] = k * gz * r[j]
        for i in range(3):
            Phi[i, 12 + j] = C[i, j] * tau
            Phi[3 + i, 9 + j] = C[i, j] * tau
        Phi[6 + j, 3 + j] = tau
    Phi[15, 16] = tau


@njit
def transition_product(
    Phi: NDArray[np.float64], X: NDArray[np.float64], Y: NDArray[np.float64]
) -> None:
    r"""Write :math:`Y = (\Phi X)^T`, using the zeros of the transition matrix.

    Twice applied it gives the propagated covariance, :math:`\Phi P \Phi^T`.

    Parameters
    ----------
    Phi : ndarray
        (17, 17), as `fill_transition` writes it.
    X : ndarray
        (17, 17).
    Y : ndarray
        (17, 17), written; not the memory of `X`.
    """
    w, w2, tau = Phi[0, 1], Phi[3, 4], Phi[15, 16]
    for j in range(17):
        a0, a1, a2 = X[0, j], X[1, j], X[2, j]
        v0, v1, v2 = X[3, j], X[4, j], X[5, j]
        p0, p1, p2 = X[6, j], X[7, j], X[8, j]
        b0, b1, b2 = X[9, j], X[10, j], X[11, j]
        g0, g1, g2 = X[12, j], X[13, j], X[14, j]
        Y[j, 0] = a0 + w * a1 + Phi[0, 12] * g0 + Phi[0, 13] * g1 + Phi[0, 14] * g2
        Y[j, 1] = a1 - w * a0 + Phi[1, 12] * g0 + Phi[1, 13] * g1 + Phi[1, 14] * g2
        Y[j, 2] = a2 + Phi[2, 12] * g0 + Phi[2, 13] * g1 + Phi[2, 14] * g2
        Y[j, 3] = (
            (Phi[3, 1] * a1 + Phi[3, 2] * a2)
            + (v0 + w2 * v1)
            + (Phi[3, 6] * p0 + Phi[3, 7] * p1 + Phi[3, 8] * p2)
            + (Phi[3, 9] * b0 + Phi[3, 10] * b1 + Phi[3, 11] * b2)
        )
        Y[j, 4] = (
            (Phi[4, 0] * a0 + Phi[4, 2] * a2)
            + (v1 - w2 * v0)
            + (Phi[4, 6] * p0 + Phi[4, 7] * p1 + Phi[4, 8] * p2)
            + (Phi[4, 9] * b0 + Phi[4, 10] * b1 + Phi[4, 11] * b2)
        )
        Y[j, 5] = (
            (Phi[5, 0] * a0 + Phi[5, 1] * a1)
            + v2
            + (Phi[5, 6] * p0 + Phi[5, 7] * p1 + Phi[5, 8] * p2)
            + (Phi[5, 9] * b0 + Phi[5, 10] * b1 + Phi[5, 11] * b2)
        )
        Y[j, 6] = p0 + tau * v0
        Y[j, 7] = p1 + tau * v1
        Y[j, 8] = p2 + tau * v2
        Y[j, 9], Y[j, 10], Y[j, 11] = b0, b1, b2
        Y[j, 12], Y[j, 13], Y[j, 14] = g0, g1, g2
        Y[j, 15] = X[15, j] + tau * X[16, j]
        Y[j, 16] = X[16, j]


@njit
def propagate_covariance(
    P: NDArray[np.float64],
    Phi: NDArray[np.float64],
    noise_psd: NDArray[np.float64],
    tau: float,
    work: NDArray[np.float64],
) -> None:
    r"""Propagate the covariance over one interval, in place.

    .. math:: P \leftarrow \Phi (P + Q/2) \Phi^T + Q/2

    Parameters
    ----------
    P : ndarray
        (17, 17) symmetric covariance; overwritten.
    Phi : ndarray
        (17, 17) transition matrix.
    noise_psd : ndarray
        (17,) power spectral density of the noise on each state; Q = PSD tau.
    tau : float
        Length of the interval [s].
    work : ndarray
        (17, 17) scratch memory.

    Notes
    -----
    Groves (2013), eq. 3.46.
    """
    for i in range(17):
        P[i, i] += 0.5 * tau * noise_psd[i]
    transition_product(Phi, P, work)
    transition_product(Phi, work, P)
    for i in range(17):
        P[i, i] += 0.5 * tau * noise_psd[i]
        for j in range(i):
            P[i, j] = P[j, i]
