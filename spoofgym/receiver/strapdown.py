"""ECEF strapdown mechanization: one sample of the inertial sensors."""

from __future__ import annotations

from ..core.compile import inline_njit
from ..core.simd import floor, select
from ..earth.wgs84 import EARTH_RATE, gravity

NO_ROTATION = 1e-16  # squared rotation angle [rad^2] up to which a sample counts as not turning
ROUNDING_LIMIT = 1e-8  # the same, up to which ``1 - cos a`` is rounded as in the reference
TINY = 1e-300  # keeps 0 / 0 away
UNITS_PER_TWO = 2.0**52  # half the number of doubles between one half and one
LARGEST_ROTATION = 1.0  # of one sample [rad]: up to it the series are exact to rounding


@inline_njit
def _nest_series(x: float, a: float, b: float, c: float, rest: float) -> float:
    """First factors of a Taylor series: 1 - a x (1 - b x (1 - c x rest))."""
    return 1.0 - x * a * (1.0 - x * b * (1.0 - x * c * rest))


@inline_njit
def rotation_coefficients(squared_angle: float) -> tuple[float, float, float]:
    r"""Coefficients of Rodrigues' formula and of its integral.

    .. math::
        \frac{\sin a}{a}, \qquad \frac{1 - \cos a}{a^2}, \qquad \frac{1 - \sin a / a}{a^2}

    `squared_angle`: a^2 [rad^2], at most 1.

    Notes
    -----
    Up to 1 rad the Taylor series are exact to rounding, do not cancel as the closed forms do, and
    vectorize.  Below 1e-4 rad two conventions of the reference software apply, since
    most samples of a quantized gyro lie there: up to 1e-8 rad a sample does not turn, and
    ``1 - cos a`` is rounded as double precision rounds it.  Either moves the specific force by at
    most 5e-9 of itself, which shows at 1e-8 m/s in a tactical golden run.
    """
    x = squared_angle
    s = _nest_series(x, 1 / 72, 1 / 110, 1 / 156, 1.0 - x * (1 / 210) * (1.0 - x * (1 / 272)))
    s = _nest_series(x, 1 / 6, 1 / 20, 1 / 42, s)
    c = _nest_series(x, 1 / 90, 1 / 132, 1 / 182, 1.0 - x * (1 / 240))
    c = 0.5 * _nest_series(x, 1 / 12, 1 / 30, 1 / 56, c)
    d = _nest_series(x, 1 / 110, 1 / 156, 1 / 210, 1.0 - x * (1 / 272))
    d = _nest_series(x, 1 / 20, 1 / 42, 1 / 72, d)
    # the units in the last place below one that 1 - cos a leaves of x / 2
    units = floor(x * (1.0 - x * (1 / 12)) * UNITS_PER_TWO + 0.5)
    rounded = units / (2.0 * UNITS_PER_TWO * x + TINY)
    turns = x > NO_ROTATION
    c = select(turns, select(x > ROUNDING_LIMIT, c, rounded), 0.0)
    return s, c, select(turns, d * (1 / 6), 0.0)


Three = tuple[float, float, float]


@inline_njit
def _row_times(row: Three, m0: Three, m1: Three, m2: Three) -> Three:
    x = row[0] * m0[0] + row[1] * m1[0] + row[2] * m2[0]
    y = row[0] * m0[1] + row[1] * m1[1] + row[2] * m2[1]
    return x, y, row[0] * m0[2] + row[1] * m1[2] + row[2] * m2[2]


@inline_njit
def strapdown_step(
    C: tuple[float, ...], v: Three, r: Three, f: Three, w: Three, dt: float
) -> tuple[tuple[float, ...], Three, Three]:
    r"""Advance attitude, velocity and position over one sample.

    .. math::
        C^+ &= R_z(a)\, C^- \left(I + \tfrac{\sin\alpha}{\alpha} A
               + \tfrac{1 - \cos\alpha}{\alpha^2} A^2\right) \\
        f_e &= \left(C^- \left[I + \tfrac{1 - \cos\alpha}{\alpha^2} A
               + \tfrac{1 - \sin\alpha/\alpha}{\alpha^2} A^2\right]
               - \tfrac12 [(0, 0, a) \times] C^-\right) f \\
        v^+ &= v^- + \Delta t\,(f_e + g(r^-) - 2 \omega_{ie} \times v^-) \\
        r^+ &= r^- + \tfrac12 \Delta t\,(v^- + v^+)

    with :math:`\alpha = \omega \Delta t`, :math:`A = [\alpha\times]`,
    :math:`a = \omega_{ie} \Delta t` and :math:`R_z(a)` the turn of the Earth.

    `C`: `C_eb`, to ECEF from body axes, row by row; `v`, `r`: velocity [m/s] and position [m],
    ECEF; `f`, `w`: specific force [m/s^2] and angular rate [rad/s] over the sample, body axes;
    `dt`: length of the sample [s]. Groves (2013), section 5.5.
    """
    c00, c01, c02, c10, c11, c12, c20, c21, c22 = C
    vx, vy, vz = v
    rx, ry, rz = r
    fx, fy, fz = f
    ax, ay, az = w[0] * dt, w[1] * dt, w[2] * dt
    s, c, d = rotation_coefficients(ax * ax + ay * ay + az * az)
    xx, yy, zz = ax * ax, ay * ay, az * az
    xy, xz, yz = ax * ay, ax * az, ay * az

    # specific force, turned to ECEF with the average attitude: f + c A f + d A^2 f, then C
    tx, ty, tz = ay * fz - az * fy, az * fx - ax * fz, ax * fy - ay * fx
    ux, uy, uz = ay * tz - az * ty, az * tx - ax * tz, ax * ty - ay * tx
    px, py, pz = fx + c * tx + d * ux, fy + c * ty + d * uy, fz + c * tz + d * uz
    a = EARTH_RATE * dt
    ex = c00 * px + c01 * py + c02 * pz + 0.5 * a * (c10 * fx + c11 * fy + c12 * fz)
    ey = c10 * px + c11 * py + c12 * pz - 0.5 * a * (c00 * fx + c01 * fy + c02 * fz)
    ez = c20 * px + c21 * py + c22 * pz

    gx, gy, gz = gravity(rx, ry, rz)
    nx = vx + dt * (ex + gx + 2.0 * EARTH_RATE * vy)
    ny = vy + dt * (ey + gy - 2.0 * EARTH_RATE * vx)
    nz = vz + dt * (ez + gz)
    half = 0.5 * dt
    position = (rx + half * (vx + nx), ry + half * (vy + ny), rz + half * (vz + nz))

    # M = I + s A + c A^2
    m0 = 1.0 - c * (yy + zz), c * xy - s * az, c * xz + s * ay
    m1 = c * xy + s * az, 1.0 - c * (xx + zz), c * yz - s * ax
    m2 = c * xz - s * ay, c * yz + s * ax, 1.0 - c * (xx + yy)
    b0 = _row_times((c00, c01, c02), m0, m1, m2)
    b1 = _row_times((c10, c11, c12), m0, m1, m2)
    b2 = _row_times((c20, c21, c22), m0, m1, m2)
    # a is below 1e-4 rad for any sample up to a second: two terms are exact to rounding
    sa, ca = a * (1.0 - a * a * (1.0 / 6.0)), 1.0 - 0.5 * a * a
    first = ca * b0[0] + sa * b1[0], ca * b0[1] + sa * b1[1], ca * b0[2] + sa * b1[2]
    second = ca * b1[0] - sa * b0[0], ca * b1[1] - sa * b0[1], ca * b1[2] - sa * b0[2]
    return first + second + b2, (nx, ny, nz), position
