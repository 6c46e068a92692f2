"""A flight: what it accepts, and that its views agree with what it was made from."""

import dataclasses
import math

import numpy as np
import pytest

from spoofgym.earth.wgs84 import radii_of_curvature
from spoofgym.truth.flight import Flight, flight_from_geodetic, flight_from_velocity

LATITUDE, LONGITUDE, HEIGHT = math.radians(50.0), math.radians(-3.0), 1000.0


def east_flight(speed=200.0, duration=60.0, step=0.01):
    count = round(duration / step) + 1
    velocity_n = np.tile([0.0, speed, 0.0], (count, 1))
    zero = np.zeros(count)
    return flight_from_velocity(
        "east", LATITUDE, LONGITUDE, HEIGHT, velocity_n, zero, zero, zero + math.pi / 2, step
    )


def test_flying_east_follows_the_parallel_by_the_trapezoid_rule():
    flight = east_flight(duration=418.0)
    np.testing.assert_array_equal(flight.time, np.arange(41801) * 0.01)
    assert (flight.step, flight.duration) == (0.01, 418.0)
    steps = 0.5 * flight.step * (flight.velocity_e[1:] + flight.velocity_e[:-1])
    np.testing.assert_allclose(np.diff(flight.position_e, axis=0), steps, atol=5e-9)
    latitude, longitude, height = flight.geodetic
    _, transverse = radii_of_curvature(LATITUDE)
    rate = 200.0 / ((transverse + HEIGHT) * math.cos(LATITUDE))
    np.testing.assert_allclose(latitude, LATITUDE, atol=1e-12)
    np.testing.assert_allclose(longitude, LONGITUDE + rate * flight.time, atol=1e-11)
    np.testing.assert_allclose(height, HEIGHT, atol=1e-4)


def test_views_return_what_the_flight_was_made_from_and_it_keeps_copies():
    time = np.arange(501) * 0.02
    rate = 1e-5 * np.array([2.0, -3.0])
    latitude = LATITUDE + rate[0] * time
    longitude = LONGITUDE + rate[1] * time
    height = HEIGHT + 3.0 * time
    meridian, transverse = np.vectorize(radii_of_curvature)(latitude)
    velocity_n = np.stack(
        [
            (meridian + height) * rate[0],
            (transverse + height) * np.cos(latitude) * rate[1],
            np.full_like(time, -3.0),
        ],
        axis=-1,
    )
    euler = 0.3 * np.sin(time), 0.1 * np.cos(time), 2.0 + 0.05 * time
    flight = flight_from_geodetic(
        "any", latitude, longitude, height, velocity_n, *euler, 0.02, tolerance=1e-3
    )
    for got, want in zip(flight.geodetic, (latitude, longitude, height), strict=True):
        np.testing.assert_allclose(got, want, atol=1e-3 if want is height else 1e-9)
    np.testing.assert_allclose(flight.velocity_n, velocity_n, atol=1e-6)
    for got, want in zip(flight.euler, euler, strict=True):
        np.testing.assert_allclose(got, want, atol=1e-9)
    flight = east_flight(duration=1.0)
    velocity = flight.velocity_e.copy()
    other = Flight("copy", flight.time, flight.position_e, velocity, flight.C_eb)
    velocity[:] = 0.0
    np.testing.assert_array_equal(other.velocity_e, flight.velocity_e)


@pytest.mark.parametrize(
    ("field", "change", "message"),
    [
        ("time", lambda t: t + 1.0, "start at 0 s, got 1"),
        ("time", lambda t: t**2, "uniform step"),
        ("position_e", lambda r: r[:-1], r"shape \(101, 3\), got \(100, 3\)"),
        ("position_e", lambda r: r * np.linspace(1.0, 1.0 + 1e-9, 101)[:, None], "integral"),
        ("velocity_e", lambda v: v * np.where(np.arange(101) == 0, np.nan, 1.0)[:, None], "finite"),
        ("C_eb", lambda C: 1.001 * C, "orthonormal"),
    ],
)
def test_what_is_no_flight_is_refused(field, change, message):
    flight = east_flight(duration=1.0)
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(flight, **{field: change(np.array(getattr(flight, field)))})
