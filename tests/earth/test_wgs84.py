"""Ellipsoid, gravity, frames, ranges and rates: closed forms, round trips, published values."""

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
    SPEED_OF_LIGHT,
    STILL,
    dcm_e_from_n,
    ecef_to_geodetic,
    geocentric_surface_radius,
    geodetic_to_ecef,
    gravity,
    radii_of_curvature,
    range_and_rate,
    turning_of_local_axes,
)

pytestmark = pytest.mark.nojit
POLAR_RADIUS = EQUATORIAL_RADIUS * math.sqrt(1.0 - ECCENTRICITY_SQUARED)
LATITUDES = st.floats(-math.pi / 2, math.pi / 2)


def test_the_ellipsoid_is_that_of_wgs84_and_positions_on_the_surface_satisfy_its_equation():
    assert abs(POLAR_RADIUS - 6356752.3142) < 1e-3
    assert pytest.approx(298.257223563, rel=1e-9) == 1.0 / (1.0 - POLAR_RADIUS / EQUATORIAL_RADIUS)
    assert ECCENTRICITY**2 == ECCENTRICITY_SQUARED
    latitude = np.linspace(-math.pi / 2, math.pi / 2, 91)
    x, y, z = np.moveaxis(geodetic_to_ecef(latitude, 0.7, 0.0), -1, 0)
    form = (x**2 + y**2) / EQUATORIAL_RADIUS**2 + z**2 / POLAR_RADIUS**2
    np.testing.assert_allclose(form, 1.0, rtol=1e-14)


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


LONGITUDES = st.floats(-math.pi, math.pi)


@pytest.mark.parametrize(
    ("geodetic", "position"),
    [
        ((0.0, 0.0, 0.0), (EQUATORIAL_RADIUS, 0.0, 0.0)),
        ((0.0, math.pi / 2, 100.0), (0.0, EQUATORIAL_RADIUS + 100.0, 0.0)),
        ((0.0, math.pi, 0.0), (-EQUATORIAL_RADIUS, 0.0, 0.0)),
        ((math.pi / 2, 0.0, 50.0), (0.0, 0.0, POLAR_RADIUS + 50.0)),
    ],
)
def test_positions_on_the_axes(geodetic, position):
    np.testing.assert_allclose(geodetic_to_ecef(*geodetic), position, rtol=0, atol=2e-9)
    latitude, longitude, height = ecef_to_geodetic(position)
    assert latitude == pytest.approx(geodetic[0], abs=1e-15)
    assert height == pytest.approx(geodetic[2], abs=2e-9)
    if abs(geodetic[0]) < 1.0:
        assert longitude == pytest.approx(geodetic[1], abs=1e-15)


@given(LATITUDES, LONGITUDES, st.floats(-1e4, 3e7))
def test_to_ecef_and_back(latitude, longitude, height):
    position = geodetic_to_ecef(latitude, longitude, height)
    found = ecef_to_geodetic(position)
    np.testing.assert_allclose(geodetic_to_ecef(*found), position, rtol=0, atol=2e-8)
    assert found[0] == pytest.approx(latitude, abs=1e-14)
    assert found[2] == pytest.approx(height, abs=2e-8)


@given(LATITUDES, LONGITUDES)
def test_local_axes_are_north_east_and_down(latitude, longitude):
    C_en = dcm_e_from_n(latitude, longitude)
    np.testing.assert_allclose(C_en.T @ C_en, np.eye(3), rtol=0, atol=1e-15)
    assert np.linalg.det(C_en) == pytest.approx(1.0, abs=1e-15)
    assert C_en[2, 1] == 0.0  # east is level with the equator
    up = geodetic_to_ecef(latitude, longitude, 1000.0) - geodetic_to_ecef(latitude, longitude, 0)
    np.testing.assert_allclose(up, -1000.0 * C_en[:, 2], rtol=0, atol=1e-8)
    h = 1e-6
    south, north = geodetic_to_ecef([latitude - h, latitude + h], longitude, 0.0)
    along = (north - south) / np.linalg.norm(north - south)
    np.testing.assert_allclose(along, C_en[:, 0], rtol=0, atol=1e-7)


def test_local_axes_turn_as_their_differences_say():
    rng = np.random.default_rng(4)
    latitude, longitude = rng.uniform((-1.3, -3.0), (1.3, 3.0), (20, 2)).T
    position = geodetic_to_ecef(latitude, longitude, rng.uniform(0.0, 2e4, 20))
    velocity = rng.normal(0.0, 200.0, (20, 3))

    def axes(seconds):
        return dcm_e_from_n(*ecef_to_geodetic(position + seconds * velocity)[:2])

    change = (axes(0.5) - axes(-0.5)) / 1.0
    np.testing.assert_allclose(turning_of_local_axes(position, velocity), change, atol=1e-11)
    one = turning_of_local_axes(position[3], velocity[3])
    np.testing.assert_allclose(one, turning_of_local_axes(position, velocity)[3], rtol=1e-13)


ORBIT = 2.656e7
SPIN = np.array([0.0, 0.0, EARTH_RATE])
DIRECTIONS = st.tuples(st.floats(-1.4, 1.4), st.floats(-3.0, 3.0))
ANTENNAS = st.tuples(st.floats(-1.5, 1.5), st.floats(-3.0, 3.0), st.floats(0.0, 2e4))
VELOCITIES = st.tuples(*[st.floats(-300.0, 300.0)] * 3)


def satellite(direction):
    latitude, longitude = direction
    x, y = math.cos(latitude) * math.cos(longitude), math.cos(latitude) * math.sin(longitude)
    return ORBIT * np.array([x, y, math.sin(latitude)])


def turned(vector, distance):
    """A vector of the Earth's axes when a signal has travelled so far."""
    a = EARTH_RATE * distance / SPEED_OF_LIGHT
    c, s = math.cos(a), math.sin(a)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ vector


def light_time_range(satellite_e, antenna_e):
    """Range when the Earth turns while the signal travels, exact but for rounding."""
    distance = np.linalg.norm(satellite_e - antenna_e)
    for _ in range(10):
        distance = np.linalg.norm(turned(satellite_e, distance) - antenna_e)
    return distance


@given(DIRECTIONS, ANTENNAS, VELOCITIES)
def test_range_and_rate_are_those_in_inertial_axes(direction, antenna, v):
    s, r, v = satellite(direction), geodetic_to_ecef(*antenna), np.array(v)
    sv = np.cross([1e-4, 0.3e-4, 0.8e-4], s)
    rho, rate, *u = range_and_rate(s, sv, r, v)
    assert rho == pytest.approx(light_time_range(s, r), abs=1e-3)
    inertial = turned(sv + np.cross(SPIN, s), rho) - (v + np.cross(SPIN, r))
    assert rate == pytest.approx(np.array(u) @ inertial, abs=1e-6)


@given(DIRECTIONS, ANTENNAS)
def test_the_line_of_sight_is_a_unit_vector_to_the_satellite(direction, antenna):
    s, r = satellite(direction), geodetic_to_ecef(*antenna)
    rho, _, *u = range_and_rate(s, STILL, r, STILL)
    assert np.linalg.norm(u) == pytest.approx(1.0, abs=1e-15)
    assert np.linalg.norm(r + rho * np.array(u) - s) < 2.0 * EARTH_RATE * ORBIT * 0.1


@given(DIRECTIONS, ANTENNAS, VELOCITIES, VELOCITIES)
def test_the_range_rate_is_the_derivative_of_the_range(direction, antenna, v, sv):
    s, r, sv, v = satellite(direction), geodetic_to_ecef(*antenna), np.array(sv), np.array(v)
    sv = 10.0 * sv  # some km/s
    h = 0.5
    ranges = [range_and_rate(s + t * sv, STILL, r + t * v, STILL)[0] for t in (-h, h)]
    _, rate, *u = range_and_rate(s, sv, r, v)
    difference = (ranges[1] - ranges[0]) / (2.0 * h)
    # the angle that the Earth turns in the travel time is taken for a constant, and is not quite
    travel = EARTH_RATE * rate / SPEED_OF_LIGHT * (u[0] * s[1] - u[1] * s[0])
    assert rate + travel == pytest.approx(difference, abs=1e-5)
    assert abs(travel) <= EARTH_RATE / SPEED_OF_LIGHT * abs(rate) * ORBIT
