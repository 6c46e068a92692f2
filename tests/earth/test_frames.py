"""Geodetic, ECEF and local coordinates: closed forms and round trips."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.earth.wgs84 import (
    ECCENTRICITY_SQUARED,
    EQUATORIAL_RADIUS,
    dcm_e_from_n,
    ecef_to_geodetic,
    geodetic_to_ecef,
    turning_of_local_axes,
)

POLAR_RADIUS = EQUATORIAL_RADIUS * math.sqrt(1.0 - ECCENTRICITY_SQUARED)
LATITUDES = st.floats(-math.pi / 2, math.pi / 2)
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


def test_a_position_on_the_surface_satisfies_the_ellipsoid_s_equation():
    latitude = np.linspace(-math.pi / 2, math.pi / 2, 91)
    x, y, z = np.moveaxis(geodetic_to_ecef(latitude, 0.7, 0.0), -1, 0)
    form = (x**2 + y**2) / EQUATORIAL_RADIUS**2 + z**2 / POLAR_RADIUS**2
    np.testing.assert_allclose(form, 1.0, rtol=1e-14)


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
