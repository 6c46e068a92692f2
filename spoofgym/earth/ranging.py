"""Range, range rate and line of sight to a satellite over the turning Earth."""

from __future__ import annotations

from .._jit import inlined
from .._simd import sqrt
from .wgs84 import EARTH_RATE, SPEED_OF_LIGHT


@inlined
def range_and_rate(
    sx: float,
    sy: float,
    sz: float,
    svx: float,
    svy: float,
    svz: float,
    rx: float,
    ry: float,
    rz: float,
    vx: float,
    vy: float,
    vz: float,
) -> tuple[float, float, float, float, float]:
    r"""Range, range rate and line of sight, with the Sagnac effect to first order.

    .. math::
        \rho &= |C\, r_s - r|, \qquad C = \begin{pmatrix}1 & a & 0\\ -a & 1 & 0\\ 0 & 0 & 1
        \end{pmatrix}, \qquad a = \omega_{ie} |r_s - r| / c \\
        \dot\rho &= u^T \left(C (v_s + \Omega_{ie} r_s) - (v + \Omega_{ie} r)\right)

    `sx`, `sy`, `sz`, `svx`, `svy`, `svz`: satellite position [m] and velocity [m/s], ECEF; `rx`,
    `ry`, `rz`, `vx`, `vy`, `vz`: antenna position [m] and velocity [m/s], ECEF; returns `range`,
    `range_rate` [m] and [m/s], without clocks; `ux`, `uy`, `uz`: unit vector from the antenna to
    the satellite, ECEF.

    Notes
    -----
    Groves (2013), eqs. 8.35, 8.40 and 9.165.
    """
    dx, dy, dz = sx - rx, sy - ry, sz - rz
    a = (EARTH_RATE / SPEED_OF_LIGHT) * sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy = sx + a * sy - rx, sy - a * sx - ry
    distance = sqrt(dx * dx + dy * dy + dz * dz)
    inverse = 1.0 / distance
    ux, uy, uz = dx * inverse, dy * inverse, dz * inverse
    # inertial velocities of the satellite and of the antenna, resolved in ECEF axes
    ix, iy = svx - EARTH_RATE * sy, svy + EARTH_RATE * sx
    rate = (
        ux * (ix + a * iy - (vx - EARTH_RATE * ry))
        + uy * (iy - a * ix - (vy + EARTH_RATE * rx))
        + uz * (svz - vz)
    )
    return distance, rate, ux, uy, uz
