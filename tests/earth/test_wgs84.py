"""The ellipsoid and its gravity against closed forms and published values."""

import math

import numpy as np
import pytest
from hypothesis import given
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


def test_radii_of_curvature_at_equator_and_pole():
    meridian, transverse = radii_of_curvature(0.0)
    assert meridian == pytest.approx(POLAR_RADIUS**2 / EQUATORIAL_RADIUS, rel=1e-14)
    assert transverse == EQUATORIAL_RADIUS
    for pole in (math.pi / 2, -math.pi / 2):
        polar = EQUATORIAL_RADIUS**2 / POLAR_RADIUS
        assert radii_of_curvature(pole) == pytest.approx((polar, polar), rel=1e-14)


@given(LATITUDES)
def test_radii_of_curvature_are_those_of_the_surface(latitude):
    # an arc of the meridian, and the distance from the axis
    h = 1e-4
    south, north = geodetic_to_ecef([latitude - h, latitude + h], 0.3, 0.0)
    meridian, transverse = radii_of_curvature(latitude)
    assert np.linalg.norm(north - south) / (2.0 * h) == pytest.approx(meridian, rel=1e-7)
    x, y, _ = geodetic_to_ecef(latitude, 0.3, 0.0)
    assert math.hypot(x, y) == pytest.approx(transverse * math.cos(latitude), abs=1e-8)


@given(LATITUDES, st.floats(-math.pi, math.pi), st.floats(0.0, 3e4))
def test_the_surface_radius_is_the_distance_of_the_point_below(latitude, longitude, height):
    x, y, z = geodetic_to_ecef(latitude, longitude, height)
    below = np.linalg.norm(geodetic_to_ecef(latitude, longitude, 0.0))
    assert geocentric_surface_radius(x, y, z) == pytest.approx(below, rel=1e-12)


def test_the_surface_radius_at_equator_and_pole():
    assert geocentric_surface_radius(7e6, 0.0, 0.0) == pytest.approx(EQUATORIAL_RADIUS, rel=1e-15)
    for z in (6.5e6, -6.5e6):
        assert geocentric_surface_radius(0.0, 0.0, z) == pytest.approx(POLAR_RADIUS, rel=1e-15)


def normal_gravity(latitude):
    """Somigliana's formula of the WGS-84 normal gravity, Groves (2013), eq. 2.134."""
    s2 = math.sin(latitude) ** 2
    return 9.7803253359 * (1.0 + 0.001931853 * s2) / math.sqrt(1.0 - ECCENTRICITY_SQUARED * s2)


def test_gravity_at_equator_and_pole():
    assert gravity(EQUATORIAL_RADIUS, 0.0, 0.0) == pytest.approx((-9.780, 0.0, 0.0), abs=5e-4)
    assert gravity(0.0, -EQUATORIAL_RADIUS, 0.0) == pytest.approx((0.0, 9.780, 0.0), abs=5e-4)
    assert gravity(0.0, 0.0, POLAR_RADIUS) == pytest.approx((0.0, 0.0, -9.832), abs=5e-4)
    assert gravity(0.0, 0.0, -POLAR_RADIUS) == pytest.approx((0.0, 0.0, 9.832), abs=5e-4)


def test_gravity_in_closed_form_on_the_axes():
    r = 7e6
    ratio = 1.5 * J2 * (EQUATORIAL_RADIUS / r) ** 2
    equator = -GRAVITATIONAL_CONSTANT / r**2 * (1.0 + ratio) + EARTH_RATE**2 * r
    assert gravity(r, 0.0, 0.0)[0] == pytest.approx(equator, rel=1e-14)
    pole = -GRAVITATIONAL_CONSTANT / r**2 * (1.0 - 2.0 * ratio)
    assert gravity(0.0, 0.0, r)[2] == pytest.approx(pole, rel=1e-14)
    assert gravity(0.0, 0.0, 0.0) == (0.0, 0.0, 0.0)


@given(LATITUDES, st.floats(-math.pi, math.pi))
def test_gravity_stands_upright_on_the_ellipsoid(latitude, longitude):
    g = np.array(gravity(*geodetic_to_ecef(latitude, longitude, 0.0)))
    # J2 alone leaves out terms of 1e-6 g and more than that in the direction
    assert np.linalg.norm(g) == pytest.approx(normal_gravity(latitude), abs=2e-4)
    up = np.array(
        [
            math.cos(latitude) * math.cos(longitude),
            math.cos(latitude) * math.sin(longitude),
            math.sin(latitude),
        ]
    )
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
