"""The WGS-84 ellipsoid: constants, radii of curvature, gravity.

The values are those of Groves, "Principles of GNSS, Inertial, and Multisensor Integrated
Navigation Systems", 2nd edition, section 2.4 (`groves2013` in references.bib).
"""

from __future__ import annotations

import math
from typing import Any

from .._jit import inlined
from .._simd import select, sqrt

SPEED_OF_LIGHT = 299792458.0
"""Speed of light [m/s]."""
EARTH_RATE = 7.292115e-5
"""Rotation rate of the Earth [rad/s]."""
EQUATORIAL_RADIUS = 6378137.0
"""Equatorial radius R_0 [m]."""
ECCENTRICITY = 0.0818191908425
"""Eccentricity e of the ellipsoid."""
ECCENTRICITY_SQUARED = ECCENTRICITY * ECCENTRICITY
POLAR_RATIO = math.sqrt(1.0 - ECCENTRICITY_SQUARED)
"""Polar over equatorial radius."""
GRAVITATIONAL_CONSTANT = 3.986004418e14
"""Geocentric gravitational constant mu [m^3/s^2]."""
J2 = 1.082627e-3
"""Second zonal harmonic of the geopotential."""
STANDARD_GRAVITY = 9.80665
"""1 g [m/s^2]."""


@inlined
def radii_of_curvature(latitude: float) -> tuple[float, float]:
    r"""Meridian and transverse radii of curvature.

    .. math::
        R_N = \frac{R_0 (1 - e^2)}{(1 - e^2 \sin^2 L)^{3/2}}, \qquad
        R_E = \frac{R_0}{(1 - e^2 \sin^2 L)^{1/2}}

    `latitude`: geodetic latitude L [rad]; returns `meridian`, `transverse`: R_N and R_E [m].

    Notes
    -----
    Groves (2013), eqs. 2.105 and 2.106.
    """
    s = math.sin(latitude)
    w = 1.0 - ECCENTRICITY_SQUARED * s * s
    transverse = EQUATORIAL_RADIUS / math.sqrt(w)
    return transverse * (1.0 - ECCENTRICITY_SQUARED) / w, transverse


@inlined
def geocentric_surface_radius(x: Any, y: Any, z: Any) -> Any:
    r"""Distance from the centre of the Earth to the surface below a point, r_eS.

    .. math::
        r_{eS} = R_E(L) \sqrt{\cos^2 L + (1 - e^2)^2 \sin^2 L}

    `x`, `y`, `z`: position, ECEF [m]; returns r_eS at the geodetic latitude of the point [m].

    Notes
    -----
    Groves (2013), eq. 2.137.  The latitude is Bowring's closed form, good to 1e-11 rad up to
    30 km of height.
    """
    p = sqrt(x * x + y * y)
    polar_radius = EQUATORIAL_RADIUS * POLAR_RATIO
    # tan of the parametric latitude, kept as a sine-cosine pair so that poles are no exception
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


@inlined
def gravity(x: float, y: float, z: float) -> tuple[float, float, float]:
    r"""Acceleration due to gravity, ECEF axes: attraction and centrifugal force.

    .. math::
        g = -\frac{\mu}{r^3}\left(\mathbf r + \frac32 J_2 \frac{R_0^2}{r^2}
        \begin{pmatrix}(1 - 5 z^2/r^2)\,x\\ (1 - 5 z^2/r^2)\,y\\ (3 - 5 z^2/r^2)\,z\end{pmatrix}
        \right) + \omega_{ie}^2 \begin{pmatrix}x\\y\\0\end{pmatrix}

    `x`, `y`, `z`: position, ECEF [m]; returns `gx`, `gy`, `gz`: acceleration, ECEF [m/s^2]; zero at
    the centre of the Earth.

    Notes
    -----
    Groves (2013), eqs. 2.142 and 2.133.
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
