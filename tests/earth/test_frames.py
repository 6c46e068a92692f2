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
        ((-math.pi / 2, 0.0, 0.0), (0.0, 0.0, -POLAR_RADIUS)),
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
    back = geodetic_to_ecef(*ecef_to_geodetic(position))
    np.testing.assert_allclose(back, position, rtol=0, atol=2e-8)
    found = ecef_to_geodetic(position)
    assert found[0] == pytest.approx(latitude, abs=1e-14)
    assert found[2] == pytest.approx(height, abs=2e-8)


@given(LATITUDES, LONGITUDES)
def test_a_step_up_is_along_minus_down(latitude, longitude):
    step = geodetic_to_ecef(latitude, longitude, 1000.0) - geodetic_to_ecef(latitude, longitude, 0)
    down = dcm_e_from_n(latitude, longitude)[:, 2]
    np.testing.assert_allclose(step, -1000.0 * down, rtol=0, atol=1e-8)


@given(LATITUDES, LONGITUDES)
def test_local_axes_are_a_right_handed_rotation(latitude, longitude):
    C_en = dcm_e_from_n(latitude, longitude)
    np.testing.assert_allclose(C_en.T @ C_en, np.eye(3), rtol=0, atol=1e-15)
    assert np.linalg.det(C_en) == pytest.approx(1.0, abs=1e-15)
    assert C_en[2, 1] == 0.0  # east is level with the equator


def test_local_axes_at_equator_and_pole():
    # at Greenwich on the equator: north is z, east is y, down is -x
    np.testing.assert_allclose(
        dcm_e_from_n(0.0, 0.0), [[0, 0, -1], [0, 1, 0], [1, 0, 0]], rtol=0, atol=1e-16
    )
    # at the pole on the meridian of Greenwich: north is -x
    np.testing.assert_allclose(
        dcm_e_from_n(math.pi / 2, 0.0), [[-1, 0, 0], [0, 1, 0], [0, 0, -1]], rtol=0, atol=1e-15
    )


def test_local_axes_are_the_derivatives_of_the_position():
    latitude, longitude, h = 0.6, -2.1, 1e-6
    north = geodetic_to_ecef(latitude + h, longitude, 0) - geodetic_to_ecef(
        latitude - h, longitude, 0
    )
    east = geodetic_to_ecef(latitude, longitude + h, 0) - geodetic_to_ecef(
        latitude, longitude - h, 0
    )
    C_en = dcm_e_from_n(latitude, longitude)
    np.testing.assert_allclose(north / np.linalg.norm(north), C_en[:, 0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(east / np.linalg.norm(east), C_en[:, 1], rtol=0, atol=1e-8)


def test_a_value_does_not_depend_on_the_others_computed_along_with_it():
    rng = np.random.default_rng(0)
    latitude, longitude = rng.uniform(-1.5, 1.5, 33), rng.uniform(-3.0, 3.0, 33)
    position = geodetic_to_ecef(latitude, longitude, 500.0)
    for i in (0, 7, 32):
        alone = geodetic_to_ecef(latitude[i : i + 1], longitude[i : i + 1], 500.0)[0]
        np.testing.assert_array_equal(position[i], alone)
        frame = dcm_e_from_n(latitude[i : i + 1], longitude[i : i + 1])[0]
        np.testing.assert_array_equal(dcm_e_from_n(latitude, longitude)[i], frame)


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
