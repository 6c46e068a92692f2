"""Range, range rate and line of sight over the turning Earth."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.earth.wgs84 import EARTH_RATE, SPEED_OF_LIGHT, STILL, geodetic_to_ecef, range_and_rate

pytestmark = pytest.mark.nojit
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
