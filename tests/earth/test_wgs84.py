"""The ellipsoid and its gravity against closed forms and published values."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from spoofgym.earth.wgs84 import (
    EARTH_RATE,
    ECCENTRICITY,
    ECCENTRICITY_SQUARED,
    EQUATORIAL_RADIUS,
    GRAVITATIONAL_CONSTANT,
    J2,
    geocentric_surface_radius,
    geodetic_to_ecef,
    gravity,
    radii_of_curvature,
)

pytestmark = pytest.mark.nojit
POLAR_RADIUS = EQUATORIAL_RADIUS * math.sqrt(1.0 - ECCENTRICITY_SQUARED)
LATITUDES = st.floats(-math.pi / 2, math.pi / 2)


def test_the_ellipsoid_is_that_of_wgs84():
    assert abs(POLAR_RADIUS - 6356752.3142) < 1e-3
    assert pytest.approx(298.257223563, rel=1e-9) == 1.0 / (1.0 - POLAR_RADIUS / EQUATORIAL_RADIUS)
    assert ECCENTRICITY**2 == ECCENTRICITY_SQUARED


@given(LATITUDES)
@example(0.0)
@example(math.pi / 2)
def test_radii_of_curvature_are_those_of_the_surface(latitude):
    # an arc of the meridian, and the distance from the axis
    h = 1e-4
    south, north = geodetic_to_ecef([latitude - h, latitude + h], 0.3, 0.0)
    meridian, transverse = radii_of_curvature(latitude)
    assert np.linalg.norm(north - south) / (2.0 * h) == pytest.approx(meridian, rel=1e-7)
    x, y, _ = geodetic_to_ecef(latitude, 0.3, 0.0)
    assert math.hypot(x, y) == pytest.approx(transverse * math.cos(latitude), abs=1e-8)


@given(LATITUDES, st.floats(-math.pi, math.pi), st.floats(0.0, 3e4))
@example(0.0, 0.0, 0.0)
@example(-math.pi / 2, 0.0, 1e4)
def test_the_surface_radius_is_the_distance_of_the_point_below(latitude, longitude, height):
    x, y, z = geodetic_to_ecef(latitude, longitude, height)
    below = np.linalg.norm(geodetic_to_ecef(latitude, longitude, 0.0))
    assert geocentric_surface_radius(x, y, z) == pytest.approx(below, rel=1e-12)


@given(LATITUDES, st.floats(-math.pi, math.pi))
@example(0.0, 0.0)
@example(math.pi / 2, 0.0)
def test_gravity_stands_upright_on_the_ellipsoid(latitude, longitude):
    """By Somigliana's formula of the WGS-84 normal gravity, Groves (2013), eq. 2.134."""
    g = np.array(gravity(*geodetic_to_ecef(latitude, longitude, 0.0)))
    s2 = math.sin(latitude) ** 2
    normal = 9.7803253359 * (1.0 + 0.001931853 * s2) / math.sqrt(1.0 - ECCENTRICITY_SQUARED * s2)
    # J2 alone leaves out terms of 1e-6 g and more than that in the direction
    assert np.linalg.norm(g) == pytest.approx(normal, abs=2e-4)
    x, y = math.cos(latitude) * math.cos(longitude), math.cos(latitude) * math.sin(longitude)
    up = np.array([x, y, math.sin(latitude)])
    assert np.linalg.norm(g + np.linalg.norm(g) * up) < 2e-4


@given(LATITUDES, st.floats(0.0, 2e7))
def test_gravity_is_the_gradient_of_its_potential(latitude, height):
    point = geodetic_to_ecef(latitude, 1.0, height)

    def potential(r):
        n = np.linalg.norm(r)
        attraction = 1.0 - J2 * (EQUATORIAL_RADIUS / n) ** 2 * (1.5 * (r[2] / n) ** 2 - 0.5)
        spin = 0.5 * EARTH_RATE**2 * (r[0] ** 2 + r[1] ** 2)
        return GRAVITATIONAL_CONSTANT / n * attraction + spin

    h = 30.0
    steps = h * np.eye(3)
    gradient = [(potential(point + s) - potential(point - s)) / (2.0 * h) for s in steps]
    np.testing.assert_allclose(gravity(*point), gradient, rtol=0, atol=1e-8)
    assert gravity(0.0, 0.0, 0.0) == (0.0, 0.0, 0.0)
