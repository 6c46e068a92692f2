"""The 17 states of the error-state filter, and how their errors grow between two epochs.

Order: attitude (ECEF axes), velocity, position, accelerometer biases, gyro biases, clock bias,
clock drift.  The state is the error of the estimate: estimate minus truth for attitude, velocity
and position, truth minus estimate for biases and clock.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .._jit import inlined, njit
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

    `Phi` (17, 17), written in place; entries that are always 0 or 1 must hold those already; `C`
    (3, 3) `C_eb` at the end of the interval; `r` (3,) position at the end of the interval, ECEF
    [m]; `fx`, `fy`, `fz`: last bias-corrected specific force of the interval, body axes [m/s^2];
    `tau`: length of the interval [s].

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


@inlined
def transition_product(
    Phi: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    row: int,
    column: int,
    count: int,
) -> None:
    r"""Write :math:`Y = \Phi X`, using the zeros of the transition matrix.

    `Phi` (17, 17), as `fill_transition` writes it.
    """
    w, w2, tau = Phi[0, 1], Phi[3, 4], Phi[15, 16]
    f0_12, f0_13, f0_14 = Phi[0, 12], Phi[0, 13], Phi[0, 14]
    f1_12, f1_13, f1_14 = Phi[1, 12], Phi[1, 13], Phi[1, 14]
    f2_12, f2_13, f2_14 = Phi[2, 12], Phi[2, 13], Phi[2, 14]
    f3_1, f3_2 = Phi[3, 1], Phi[3, 2]
    f3_6, f3_7, f3_8 = Phi[3, 6], Phi[3, 7], Phi[3, 8]
    f3_9, f3_10, f3_11 = Phi[3, 9], Phi[3, 10], Phi[3, 11]
    f4_0, f4_2 = Phi[4, 0], Phi[4, 2]
    f4_6, f4_7, f4_8 = Phi[4, 6], Phi[4, 7], Phi[4, 8]
    f4_9, f4_10, f4_11 = Phi[4, 9], Phi[4, 10], Phi[4, 11]
    f5_0, f5_1 = Phi[5, 0], Phi[5, 1]
    f5_6, f5_7, f5_8 = Phi[5, 6], Phi[5, 7], Phi[5, 8]
    f5_9, f5_10, f5_11 = Phi[5, 9], Phi[5, 10], Phi[5, 11]
    for j in range(count):
        a0, a1, a2 = x[j * column], x[row + j * column], x[2 * row + j * column]
        v0, v1, v2 = x[3 * row + j * column], x[4 * row + j * column], x[5 * row + j * column]
        p0, p1, p2 = x[6 * row + j * column], x[7 * row + j * column], x[8 * row + j * column]
        b0, b1, b2 = x[9 * row + j * column], x[10 * row + j * column], x[11 * row + j * column]
        g0, g1, g2 = x[12 * row + j * column], x[13 * row + j * column], x[14 * row + j * column]
        c0, c1 = x[15 * row + j * column], x[16 * row + j * column]
        y[j * column] = (a0 + w * a1) + (f0_12 * g0 + f0_13 * g1 + f0_14 * g2)
        y[row + j * column] = (a1 - w * a0) + (f1_12 * g0 + f1_13 * g1 + f1_14 * g2)
        y[2 * row + j * column] = a2 + (f2_12 * g0 + f2_13 * g1 + f2_14 * g2)
        y[3 * row + j * column] = (
            (f3_1 * a1 + f3_2 * a2)
            + (v0 + w2 * v1)
            + (f3_6 * p0 + f3_7 * p1 + f3_8 * p2)
            + (f3_9 * b0 + f3_10 * b1 + f3_11 * b2)
        )
        y[4 * row + j * column] = (
            (f4_0 * a0 + f4_2 * a2)
            + (v1 - w2 * v0)
            + (f4_6 * p0 + f4_7 * p1 + f4_8 * p2)
            + (f4_9 * b0 + f4_10 * b1 + f4_11 * b2)
        )
        y[5 * row + j * column] = (
            (f5_0 * a0 + f5_1 * a1)
            + v2
            + (f5_6 * p0 + f5_7 * p1 + f5_8 * p2)
            + (f5_9 * b0 + f5_10 * b1 + f5_11 * b2)
        )
        y[6 * row + j * column] = p0 + tau * v0
        y[7 * row + j * column] = p1 + tau * v1
        y[8 * row + j * column] = p2 + tau * v2
        y[9 * row + j * column], y[10 * row + j * column], y[11 * row + j * column] = b0, b1, b2
        y[12 * row + j * column], y[13 * row + j * column], y[14 * row + j * column] = g0, g1, g2
        y[15 * row + j * column], y[16 * row + j * column] = c0 + tau * c1, c1


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

    `P` (289,) symmetric covariance, row by row; overwritten; `Phi` (17, 17) transition matrix;
    `noise_psd` (17,) power spectral density of the noise on each state; Q = PSD tau; `tau`: length
    of the interval [s]; `work` (289,) scratch memory.

    Notes
    -----
    Groves (2013), eq. 3.46.
    """
    for i in range(17):
        P[18 * i] += 0.5 * tau * noise_psd[i]
    transition_product(Phi, P, work, 17, 1, 17)
    for i in range(17):  # each row of Phi P as a column, since (Phi P) Phi' is symmetric
        transition_product(Phi, work[17 * i : 17 * i + 17], P[17 * i : 17 * i + 17], 1, 1, 1)
    for i in range(17):
        P[18 * i] += 0.5 * tau * noise_psd[i]
        for j in range(i):
            P[17 * i + j] = P[17 * j + i]
