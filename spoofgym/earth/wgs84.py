"""The WGS-84 ellipsoid, its gravity, ECEF (e) and north-east-down (n) frames, line of sight.

Values and equations are those of Groves (2013), `groves2013` in references.bib.  NumPy functions
broadcast over leading axes; angles are in radians.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.compile import inline_njit
from ..core.simd import select, sqrt

SPEED_OF_LIGHT = 299792458.0  # speed of light [m/s]
EARTH_RATE = 7.292115e-5  # rotation rate of the Earth [rad/s]
EQUATORIAL_RADIUS = 6378137.0  # equatorial radius R_0 [m]
ECCENTRICITY = 0.0818191908425  # eccentricity e of the ellipsoid
ECCENTRICITY_SQUARED = ECCENTRICITY * ECCENTRICITY
POLAR_RATIO = math.sqrt(1.0 - ECCENTRICITY_SQUARED)  # polar over equatorial radius
GRAVITATIONAL_CONSTANT = 3.986004418e14  # geocentric gravitational constant mu [m^3/s^2]
J2 = 1.082627e-3  # second zonal harmonic of the geopotential
STANDARD_GRAVITY = 9.80665  # 1 g [m/s^2]
MICRO_G = STANDARD_GRAVITY * 1e-6  # [m/s^2]
DEGREE = math.pi / 180.0  # [rad]


@inline_njit
def radii_of_curvature(latitude: float) -> tuple[float, float]:
    r"""Meridian and transverse radii of curvature.

    .. math::
        R_N = \frac{R_0 (1 - e^2)}{(1 - e^2 \sin^2 L)^{3/2}}, \qquad
        R_E = \frac{R_0}{(1 - e^2 \sin^2 L)^{1/2}}

    `latitude`: geodetic L [rad]; returns R_N and R_E [m]. Groves (2013), eqs. 2.105 and 2.106.
    """
    s = math.sin(latitude)
    w = 1.0 - ECCENTRICITY_SQUARED * s * s
    transverse = EQUATORIAL_RADIUS / math.sqrt(w)
    return transverse * (1.0 - ECCENTRICITY_SQUARED) / w, transverse


@inline_njit
def geocentric_surface_radius(x: Any, y: Any, z: Any) -> Any:
    r"""Distance from the centre of the Earth to the surface below a point, r_eS.

    .. math::
        r_{eS} = R_E(L) \sqrt{\cos^2 L + (1 - e^2)^2 \sin^2 L}

    `x`, `y`, `z`: position, ECEF [m]; returns r_eS at the geodetic latitude of the point [m], which
    is Bowring's closed form, good to 1e-11 rad up to 30 km of height. Groves (2013), eq. 2.137.
    """
    p = sqrt(x * x + y * y)
    polar_radius = EQUATORIAL_RADIUS * POLAR_RATIO
    # tan of the parametric latitude, stored as a sine-cosine pair so that poles are no exception
    a = z * EQUATORIAL_RADIUS
    b = p * polar_radius
    h = sqrt(a * a + b * b)
    s, c = a / h, b / h
    second = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)
    u = z + second * polar_radius * s * s * s
    v = p - ECCENTRICITY_SQUARED * EQUATORIAL_RADIUS * c * c * c
    squared = u * u + v * v
    sin2 = u * u / squared
    cos2 = v * v / squared
    flat = (1.0 - ECCENTRICITY_SQUARED) * (1.0 - ECCENTRICITY_SQUARED)
    return EQUATORIAL_RADIUS * sqrt(cos2 + flat * sin2) / sqrt(1.0 - ECCENTRICITY_SQUARED * sin2)


@inline_njit
def gravity(x: float, y: float, z: float) -> tuple[float, float, float]:
    r"""Acceleration due to gravity, ECEF axes: attraction and centrifugal force.

    .. math::
        g = -\frac{\mu}{r^3}\left(\mathbf r + \frac32 J_2 \frac{R_0^2}{r^2}
        \begin{pmatrix}(1 - 5 z^2/r^2)\,x\\ (1 - 5 z^2/r^2)\,y\\ (3 - 5 z^2/r^2)\,z\end{pmatrix}
        \right) + \omega_{ie}^2 \begin{pmatrix}x\\y\\0\end{pmatrix}

    `x`, `y`, `z`: position, ECEF [m]; returns the acceleration, ECEF [m/s^2]; zero at the centre of
    the Earth. Groves (2013), eqs. 2.142 and 2.133.
    """
    r2 = x * x + y * y + z * z
    r2 = select(r2 > 0.0, r2, 1.0)
    r = sqrt(r2)
    cube = 1.0 / (r2 * r)  # the only division: this runs for every inertial sample
    k = -GRAVITATIONAL_CONSTANT * cube
    j = (1.5 * J2 * EQUATORIAL_RADIUS * EQUATORIAL_RADIUS) * r * cube
    t = 5.0 * z * z * (r * cube)
    horizontal = k * (1.0 + j * (1.0 - t)) + EARTH_RATE * EARTH_RATE
    return horizontal * x, horizontal * y, k * (1.0 + j * (3.0 - t)) * z


def geodetic_to_ecef(
    latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike
) -> NDArray[np.float64]:
    r"""Position in ECEF axes from geodetic coordinates.

    .. math::
        r = \begin{pmatrix}(R_E + h)\cos L\cos\lambda\\ (R_E + h)\cos L\sin\lambda\\
        ((1 - e^2) R_E + h)\sin L\end{pmatrix}

    `latitude`, `longitude` [rad], any shape S; `height` above the ellipsoid [m]; returns (S, 3)
    position, ECEF [m]. Groves (2013), eq. 2.112.
    """
    latitude, longitude, height = np.broadcast_arrays(latitude, longitude, height)
    sin_latitude = np.sin(latitude)
    transverse = EQUATORIAL_RADIUS / np.sqrt(1.0 - ECCENTRICITY_SQUARED * sin_latitude**2)
    horizontal = (transverse + height) * np.cos(latitude)
    return np.stack(
        [
            horizontal * np.cos(longitude),
            horizontal * np.sin(longitude),
            ((1.0 - ECCENTRICITY_SQUARED) * transverse + height) * sin_latitude,
        ],
        axis=-1,
    )


def ecef_to_geodetic(
    position_e: ArrayLike,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Geodetic coordinates from a position in ECEF axes. Bowring's closed form followed by two
    fixed-point steps; exact to rounding between the surface and satellite orbits, poles included.
    `position_e` (..., 3) position, ECEF [m]; returns `latitude`, `longitude`, `height` [rad],
    [rad], [m]; shape of the leading axes."""
    x, y, z = np.moveaxis(np.asarray(position_e, dtype=np.float64), -1, 0)
    p = np.hypot(x, y)
    ratio = np.sqrt(1.0 - ECCENTRICITY_SQUARED)
    beta = np.arctan2(z, p * ratio)
    second = ECCENTRICITY_SQUARED / (1.0 - ECCENTRICITY_SQUARED)
    for _ in range(3):
        latitude = np.arctan2(
            z + second * EQUATORIAL_RADIUS * ratio * np.sin(beta) ** 3,
            p - ECCENTRICITY_SQUARED * EQUATORIAL_RADIUS * np.cos(beta) ** 3,
        )
        beta = np.arctan2(ratio * np.sin(latitude), np.cos(latitude))
    sin_latitude, cos_latitude = np.sin(latitude), np.cos(latitude)
    w = np.sqrt(1.0 - ECCENTRICITY_SQUARED * sin_latitude**2)
    height = p * cos_latitude + z * sin_latitude - EQUATORIAL_RADIUS * w
    return latitude, np.arctan2(y, x), height


def dcm_e_from_n(latitude: ArrayLike, longitude: ArrayLike) -> NDArray[np.float64]:
    """`C_en` (S, 3, 3), to ECEF from north-east-down axes, its columns; `latitude`, `longitude`
    [rad], any shape S. Transpose of Groves (2013), eq. 2.150."""
    latitude, longitude = np.broadcast_arrays(latitude, longitude)
    sl, cl = np.sin(latitude), np.cos(latitude)
    so, co = np.sin(longitude), np.cos(longitude)
    north = np.stack([-sl * co, -sl * so, cl], axis=-1)
    east = np.stack([-so, co, np.zeros_like(sl)], axis=-1)
    down = np.stack([-cl * co, -cl * so, -sl], axis=-1)
    return np.stack([north, east, down], axis=-1)


def look_angles(
    satellites: NDArray[np.float64], position_e: NDArray[np.float64], C_en: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Elevation and azimuth [rad], (K, n), of satellites (K, n, 3) seen from (K, 3), ECEF [m], with
    `C_en` (K, 3, 3) there. Sums are written out, so that a row has the same bits among any
    others."""
    x, y, z = np.moveaxis(satellites - position_e[:, None, :], -1, 0)
    C = C_en[:, None]
    north, east, down = (C[..., 0, i] * x + C[..., 1, i] * y + C[..., 2, i] * z for i in range(3))
    return np.arctan2(-down, np.hypot(north, east)), np.arctan2(east, north)


def turning_of_local_axes(position_e: ArrayLike, velocity_e: ArrayLike) -> NDArray[np.float64]:
    r"""Rate of change of the local axes of a moving point, `C_en` by time.

    .. math:: \dot C_{en} = C_{en} [\omega_{en}^n \times], \qquad \omega_{en}^n =
        \left(\tfrac{v_E}{R_E + h}, -\tfrac{v_N}{R_N + h},
        -\tfrac{v_E \tan L}{R_E + h}\right)

    `position_e`, `velocity_e` (..., 3) ECEF [m], [m/s]; returns (..., 3, 3) [1/s]. Groves (2013),
    eqs. 5.43 and 5.44.
    """
    latitude, longitude, height = ecef_to_geodetic(position_e)
    C_en = dcm_e_from_n(latitude, longitude)
    speed = np.asarray(velocity_e, dtype=np.float64)
    north, east, _ = np.moveaxis(np.einsum("...ij,...i->...j", C_en, speed), -1, 0)
    w = 1.0 - ECCENTRICITY_SQUARED * np.sin(latitude) ** 2
    transverse = EQUATORIAL_RADIUS / np.sqrt(w)
    meridian = transverse * (1.0 - ECCENTRICITY_SQUARED) / w
    x, y = east / (transverse + height), -north / (meridian + height)
    z, none = -x * np.tan(latitude), np.zeros_like(x)
    cross = np.stack([none, -z, y, z, none, -x, -y, x, none], axis=-1)
    return np.asarray(C_en @ cross.reshape(*x.shape, 3, 3))


Vector = tuple[Any, Any, Any] | NDArray[np.float64]
STILL = 0.0, 0.0, 0.0


@inline_njit
def range_and_rate(s: Vector, vs: Vector, r: Vector, v: Vector) -> tuple[Any, Any, Any, Any, Any]:
    r"""Range, range rate and line of sight, with the Sagnac effect to first order.

    .. math::
        \rho &= |C\, r_s - r|, \qquad C = \begin{pmatrix}1 & a & 0\\ -a & 1 & 0\\ 0 & 0 & 1
        \end{pmatrix}, \qquad a = \omega_{ie} |r_s - r| / c \\
        \dot\rho &= u^T \left(C (v_s + \Omega_{ie} r_s) - (v + \Omega_{ie} r)\right)

    `s`, `vs`: satellite's position [m] and velocity [m/s], `r`, `v`: antenna's, ECEF; returns range
    [m] and range rate [m/s] without clocks, and the unit vector u from the antenna to the
    satellite, ECEF. Groves (2013), eqs. 8.35, 8.40 and 9.165.
    """
    (sx, sy, sz), (rx, ry, rz) = (s[0], s[1], s[2]), (r[0], r[1], r[2])
    dx, dy, dz = sx - rx, sy - ry, sz - rz
    a = (EARTH_RATE / SPEED_OF_LIGHT) * sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy = sx + a * sy - rx, sy - a * sx - ry
    distance = sqrt(dx * dx + dy * dy + dz * dz)
    inverse = 1.0 / distance
    ux, uy, uz = dx * inverse, dy * inverse, dz * inverse
    # inertial velocities of the satellite and of the antenna, resolved in ECEF axes
    ix, iy = vs[0] - EARTH_RATE * sy, vs[1] + EARTH_RATE * sx
    rate = (
        ux * (ix + a * iy - (v[0] - EARTH_RATE * ry))
        + uy * (iy - a * ix - (v[1] + EARTH_RATE * rx))
        + uz * (vs[2] - v[2])
    )
    return distance, rate, ux, uy, uz
