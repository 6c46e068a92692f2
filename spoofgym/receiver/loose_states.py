r"""The 15 states of the loosely coupled filter, and how their errors grow between two epochs.

Order: attitude, velocity and position in local-level axes (east, north, up), then gyro and
accelerometer biases in body axes.  The first nine are estimate minus truth, the attitude by
:math:`\hat C = (I - [\phi\times]) C`; the biases are truth minus estimate.  Position errors are in
metres along the axes, not radians of latitude and longitude.

.. math:: \dot x = \begin{pmatrix}
    F_{11} & F_{12} & F_{13} & -C & 0\\
    F_{21} & F_{22} & F_{23} & 0 & C\\
    0 & I & F_{33} & 0 & 0\\
    0 & 0 & 0 & 0 & 0\\
    0 & 0 & 0 & 0 & 0
    \end{pmatrix} x

The blocks are those of the appendix of `shadmehri2025`, with its position columns divided by
:math:`R_M + h` and :math:`(R_N + h) \cos L`, and with these corrections:

1. :math:`F_{13}`, row 2: :math:`-v_E / (R_N + h)^2`, where the paper prints :math:`v_N`.
2. :math:`F_{33}` without the factor :math:`[v\times]`, which has the wrong dimension.
3. :math:`F_{33}` has the terms of the turning and stretching metre scales, which the change from
   angles to metres brings.
4. :math:`F_{23}` has the gradient of gravity with height, :math:`2 g / R`, without which the
   vertical channel is not unstable.
"""

import math

from ..core.compile import inline_njit, njit
from ..earth.wgs84 import (
    EARTH_RATE,
    ECCENTRICITY_SQUARED,
    EQUATORIAL_RADIUS,
    gravity,
    radii_of_curvature,
)

STATES = 15
ATTITUDE, VELOCITY, POSITION, GYRO_BIAS, ACCEL_BIAS = 0, 3, 6, 9, 12


@inline_njit
def geodetic_point(x, y, z):
    r"""Latitude, longitude and height of a position. Bowring's closed form, good to 1e-11 rad up to
    30 km of height. `x`, `y`, `z`: ECEF [m], not at a pole; returns `latitude`, `longitude`,
    `height` [rad], [rad], [m]."""
    p = math.sqrt(x * x + y * y)
    ratio = math.sqrt(1.0 - ECCENTRICITY_SQUARED)
    a, b = z, p * ratio
    h = math.sqrt(a * a + b * b)
    s, c = a / h, b / h
    second = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)
    u = z + second * EQUATORIAL_RADIUS * ratio * s * s * s
    v = p - ECCENTRICITY_SQUARED * EQUATORIAL_RADIUS * c * c * c
    latitude = math.atan2(u, v)
    sine = math.sin(latitude)
    w = math.sqrt(1.0 - ECCENTRICITY_SQUARED * sine * sine)
    height = p * math.cos(latitude) + z * sine - EQUATORIAL_RADIUS * w
    return latitude, math.atan2(y, x), height


@njit
def fill_local_axes(latitude, longitude, C_el):
    """Write the matrix to ECEF from local east-north-up axes. `latitude`, `longitude`: geodetic
    [rad]; `C_el` (3, 3), written; its columns are east, north and up."""
    sl, cl = math.sin(latitude), math.cos(latitude)
    so, co = math.sin(longitude), math.cos(longitude)
    C_el[0, 0], C_el[0, 1], C_el[0, 2] = -so, -sl * co, cl * co
    C_el[1, 0], C_el[1, 1], C_el[1, 2] = co, -sl * so, cl * so
    C_el[2, 0], C_el[2, 1], C_el[2, 2] = 0.0, cl, sl


@inline_njit
def _put_skew(F, row, column, x, y, z):
    F[row, column], F[row, column + 1], F[row, column + 2] = 0.0, -z, y
    F[row + 1, column], F[row + 1, column + 1], F[row + 1, column + 2] = z, 0.0, -x
    F[row + 2, column], F[row + 2, column + 1], F[row + 2, column + 2] = -y, x, 0.0


@inline_njit
def _add_cross(F, column, v, t):
    F[3, column] += v[1] * t[2] - v[2] * t[1]
    F[4, column] += v[2] * t[0] - v[0] * t[2]
    F[5, column] += v[0] * t[1] - v[1] * t[0]


@njit
def fill_dynamics(F, v, f, latitude, height, down):
    """Write the derivative of the first nine states with respect to themselves. `F` (9, 9),
    written; `v`, `f`: velocity with respect to the Earth [m/s] and specific force [m/s^2], east,
    north, up; `latitude`, `height`: geodetic [rad], [m]; `down`: size of gravity [m/s^2]."""
    vE, vN, vU = v
    meridian, transverse = radii_of_curvature(latitude)
    RM, RN = meridian + height, transverse + height
    s, c = math.sin(latitude), math.cos(latitude)
    t = s / c
    ie_N, ie_U = EARTH_RATE * c, EARTH_RATE * s
    en_E, en_N, en_U = -vN / RM, vE / RN, vE * t / RN
    F[:] = 0.0
    # turn of the axes: with the velocity, and with the position (north, up)
    by_vE, by_vN = (0.0, 1.0 / RN, t / RN), (-1.0 / RM, 0.0, 0.0)
    by_N = (0.0, 0.0, vE / (c * c * RN * RM))
    by_U = (vN / (RM * RM), -vE / (RN * RN), -vE * t / (RN * RN))
    earth = (0.0, -ie_U / RM, ie_N / RM)  # of the turn of the Earth, by the position north
    _put_skew(F, 0, 0, -en_E, -(ie_N + en_N), -(ie_U + en_U))
    for i in range(3):
        F[i, 3], F[i, 4] = by_vE[i], by_vN[i]
        F[i, 7], F[i, 8] = earth[i] + by_N[i], by_U[i]
    _put_skew(F, 3, 0, f[0], f[1], f[2])
    _put_skew(F, 3, 3, -en_E, -(2.0 * ie_N + en_N), -(2.0 * ie_U + en_U))
    _add_cross(F, 3, v, by_vE)
    _add_cross(F, 4, v, by_vN)
    _add_cross(F, 7, v, (2.0 * earth[0], 2.0 * earth[1] + by_N[1], 2.0 * earth[2] + by_N[2]))
    _add_cross(F, 8, v, by_U)
    F[5, 8] += 2.0 * down / RM
    F[6, 3], F[7, 4], F[8, 5] = 1.0, 1.0, 1.0
    F[6, 6], F[6, 7], F[6, 8] = vU / RN - vN * t / RM, vE * t / RM, -vE / RN
    F[7, 7], F[7, 8] = vU / RM, -vN / RM


@njit
def fill_transition(Phi, F, C, C_el, tau):
    r"""Write the transition matrix of one interval, second order in its length.

    .. math:: \Phi = I + F \tau + \tfrac12 F^2 \tau^2

    `Phi` (15, 15), written; its rows of the biases must hold those of the identity; `F` (9, 9) as
    `fill_dynamics` writes it, in the middle of the interval; `C` (3, 3) `C_eb` in the middle of the
    interval; `C_el` (3, 3) local axes; `tau`: length of the interval [s].
    """
    half = 0.5 * tau * tau
    for i in range(9):
        for j in range(9):
            total = 0.0
            for k in range(9):
                total += F[i, k] * F[k, j]
            Phi[i, j] = tau * F[i, j] + half * total
        Phi[i, i] += 1.0
    for j in range(3):
        c0 = C_el[0, 0] * C[0, j] + C_el[1, 0] * C[1, j] + C_el[2, 0] * C[2, j]
        c1 = C_el[0, 1] * C[0, j] + C_el[1, 1] * C[1, j] + C_el[2, 1] * C[2, j]
        c2 = C_el[0, 2] * C[0, j] + C_el[1, 2] * C[1, j] + C_el[2, 2] * C[2, j]
        for i in range(9):
            Phi[i, 9 + j] = -half * (F[i, 0] * c0 + F[i, 1] * c1 + F[i, 2] * c2)
            Phi[i, 12 + j] = half * (F[i, 3] * c0 + F[i, 4] * c1 + F[i, 5] * c2)
        Phi[0, 9 + j] -= tau * c0
        Phi[1, 9 + j] -= tau * c1
        Phi[2, 9 + j] -= tau * c2
        Phi[3, 12 + j] += tau * c0
        Phi[4, 12 + j] += tau * c1
        Phi[5, 12 + j] += tau * c2


@inline_njit
def gravity_size(x, y, z):
    gx, gy, gz = gravity(x, y, z)
    return math.sqrt(gx * gx + gy * gy + gz * gz)
