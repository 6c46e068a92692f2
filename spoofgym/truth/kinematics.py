"""Kernel of the inverse kinematics: inertial samples from a motion."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..core.compile import njit
from ..earth.wgs84 import EARTH_RATE, gravity

SMALL_ANGLE = 1e-8  # rotation of a sample [rad] up to which the mechanization takes I + A and I
SERIES_ANGLE = 0.1  # rotation [rad] up to which (1 - sin(a) / a) / a^2 is taken from its series


@njit
def velocity_coefficients(angle: float) -> tuple[float, float]:
    r"""Coefficients of the specific-force transformation.

    .. math::
        c = \frac{1 - \cos a}{a^2}, \qquad d = \frac{1 - \sin a / a}{a^2}

    `angle`: a [rad].

    Notes
    -----
    c cancels on purpose: at 1e-6 rad it is off by up to 1e-4 of itself, just as in the forward
    step of the reference software, and only the same error leads back to the flight (0.3 instead
    of 3 micrometres over 418 s).  d cancels harmlessly, but has a series.
    """
    if angle <= SMALL_ANGLE:
        return 0.0, 0.0
    x = angle * angle
    c = (1.0 - math.cos(angle)) / x
    if angle <= SERIES_ANGLE:
        return c, (1.0 - x / 20.0 * (1.0 - x / 42.0 * (1.0 - x / 72.0))) / 6.0
    return c, (1.0 - math.sin(angle) / angle) / x


@njit
def invert_samples(
    step: float,
    position_e: NDArray[np.float64],
    velocity_e: NDArray[np.float64],
    C_eb: NDArray[np.float64],
    specific_force_b: NDArray[np.float64],
    angular_rate_b: NDArray[np.float64],
) -> float:
    r"""Fill the inertial samples between consecutive states.

    With a = omega_ie dt, the rotation of the body over a sample is
    :math:`M = C^{-\prime} R_z(a)' C^+ = I + \sin|\alpha| / |\alpha|\,A + ...`, whose antisymmetric
    part holds :math:`\alpha \sin|\alpha| / |\alpha|` without cancellation.

    `step`: interval of the samples [s]; `position_e`, `velocity_e` (N+1, 3) ECEF [m] and [m/s];
    `C_eb` (N+1, 3, 3), to ECEF from body axes; `specific_force_b`, `angular_rate_b` (N, 3) outputs,
    body axes [m/s^2] and [rad/s]; returns largest rotation of a sample [rad].
    """
    a = EARTH_RATE * step
    sin_a, cos_a = math.sin(a), math.cos(a)
    largest = 0.0
    for i in range(position_e.shape[0] - 1):
        c00, c01, c02 = C_eb[i, 0, 0], C_eb[i, 0, 1], C_eb[i, 0, 2]
        c10, c11, c12 = C_eb[i, 1, 0], C_eb[i, 1, 1], C_eb[i, 1, 2]
        c20, c21, c22 = C_eb[i, 2, 0], C_eb[i, 2, 1], C_eb[i, 2, 2]

        # new attitude with the turn of the Earth taken back: R_z(a)' C+
        n00 = cos_a * C_eb[i + 1, 0, 0] - sin_a * C_eb[i + 1, 1, 0]
        n01 = cos_a * C_eb[i + 1, 0, 1] - sin_a * C_eb[i + 1, 1, 1]
        n02 = cos_a * C_eb[i + 1, 0, 2] - sin_a * C_eb[i + 1, 1, 2]
        n10 = sin_a * C_eb[i + 1, 0, 0] + cos_a * C_eb[i + 1, 1, 0]
        n11 = sin_a * C_eb[i + 1, 0, 1] + cos_a * C_eb[i + 1, 1, 1]
        n12 = sin_a * C_eb[i + 1, 0, 2] + cos_a * C_eb[i + 1, 1, 2]
        n20, n21, n22 = C_eb[i + 1, 2, 0], C_eb[i + 1, 2, 1], C_eb[i + 1, 2, 2]

        # M = C-' N: twice its antisymmetric part, and its trace
        px = c02 * n01 + c12 * n11 + c22 * n21 - (c01 * n02 + c11 * n12 + c21 * n22)
        py = c00 * n02 + c10 * n12 + c20 * n22 - (c02 * n00 + c12 * n10 + c22 * n20)
        pz = c01 * n00 + c11 * n10 + c21 * n20 - (c00 * n01 + c10 * n11 + c20 * n21)
        trace = c00 * n00 + c10 * n10 + c20 * n20 + c01 * n01 + c11 * n11 + c21 * n21
        trace += c02 * n02 + c12 * n12 + c22 * n22
        sine = 0.5 * math.sqrt(px * px + py * py + pz * pz)
        angle = math.atan2(sine, 0.5 * (trace - 1.0))
        scale = 0.5 if sine <= SMALL_ANGLE else 0.5 * angle / sine
        ax, ay, az = scale * px, scale * py, scale * pz
        largest = max(largest, angle)

        # specific force in ECEF axes that brings about the change of velocity
        rx, ry, rz = position_e[i, 0], position_e[i, 1], position_e[i, 2]
        vx, vy, vz = velocity_e[i, 0], velocity_e[i, 1], velocity_e[i, 2]
        gx, gy, gz = gravity(rx, ry, rz)
        ex = (velocity_e[i + 1, 0] - vx) / step - gx - 2.0 * EARTH_RATE * vy
        ey = (velocity_e[i + 1, 1] - vy) / step - gy + 2.0 * EARTH_RATE * vx
        ez = (velocity_e[i + 1, 2] - vz) / step - gz

        # average attitude T = C- (I + c A + d A^2) - [(0, 0, a / 2) x] C-
        c, d = velocity_coefficients(math.sqrt(ax * ax + ay * ay + az * az))
        xx, yy, zz, xy, xz, yz = ax * ax, ay * ay, az * az, ax * ay, ax * az, ay * az
        g00, g01, g02 = 1.0 - d * (yy + zz), d * xy - c * az, d * xz + c * ay
        g10, g11, g12 = d * xy + c * az, 1.0 - d * (xx + zz), d * yz - c * ax
        g20, g21, g22 = d * xz - c * ay, d * yz + c * ax, 1.0 - d * (xx + yy)
        half = 0.5 * a
        t00 = c00 * g00 + c01 * g10 + c02 * g20 + half * c10
        t01 = c00 * g01 + c01 * g11 + c02 * g21 + half * c11
        t02 = c00 * g02 + c01 * g12 + c02 * g22 + half * c12
        t10 = c10 * g00 + c11 * g10 + c12 * g20 - half * c00
        t11 = c10 * g01 + c11 * g11 + c12 * g21 - half * c01
        t12 = c10 * g02 + c11 * g12 + c12 * g22 - half * c02
        t20 = c20 * g00 + c21 * g10 + c22 * g20
        t21 = c20 * g01 + c21 * g11 + c22 * g21
        t22 = c20 * g02 + c21 * g12 + c22 * g22

        # T f = e by Cramer's rule; T is a rotation but for 1 + O(angle^2)
        k00, k01, k02 = t11 * t22 - t12 * t21, t02 * t21 - t01 * t22, t01 * t12 - t02 * t11
        k10, k11, k12 = t12 * t20 - t10 * t22, t00 * t22 - t02 * t20, t02 * t10 - t00 * t12
        k20, k21, k22 = t10 * t21 - t11 * t20, t01 * t20 - t00 * t21, t00 * t11 - t01 * t10
        determinant = t00 * k00 + t01 * k10 + t02 * k20
        specific_force_b[i, 0] = (k00 * ex + k01 * ey + k02 * ez) / determinant
        specific_force_b[i, 1] = (k10 * ex + k11 * ey + k12 * ez) / determinant
        specific_force_b[i, 2] = (k20 * ex + k21 * ey + k22 * ez) / determinant
        angular_rate_b[i, 0] = ax / step
        angular_rate_b[i, 1] = ay / step
        angular_rate_b[i, 2] = az / step
    return largest
