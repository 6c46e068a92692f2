"""Manoeuvres: what was asked for is what is flown, smoothly."""

import math

import numpy as np
import pytest

from spoofgym.earth.wgs84 import geodetic_to_ecef
from spoofgym.truth.flight import inverse_kinematics
from spoofgym.truth.manoeuvres import (
    FLIGHTS,
    Accelerate,
    Climb,
    Straight,
    Turn,
    Until,
    car,
    fly,
    ke2022,
    zhong2025,
)

G = 9.80665


def flown(*manoeuvres, speed_mps=120.0, **changes):
    settings = {
        "latitude_deg": 47.0,
        "longitude_deg": 8.0,
        "height_m": 2000.0,
        "speed_mps": speed_mps,
        "heading_deg": 30.0,
    }
    return fly(manoeuvres, **(settings | changes))


def speed(flight):
    return np.linalg.norm(flight.velocity_n, axis=1)


@pytest.mark.parametrize("angle_deg", [5.0, -90.0, 360.0])
def test_a_turn_changes_the_heading_by_its_angle(angle_deg):
    flight = flown(Turn(angle_deg, bank_deg=25.0), Straight(1.0))
    roll, pitch, yaw = flight.euler
    yaw = np.degrees(np.unwrap(yaw))
    assert yaw[-1] - yaw[0] == pytest.approx(angle_deg, abs=1e-6)
    np.testing.assert_allclose(roll[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(pitch, 0.0, atol=1e-9)
    np.testing.assert_allclose(speed(flight), 120.0, rtol=1e-9)
    np.testing.assert_allclose(flight.geodetic[2], 2000.0, atol=1e-3)


def test_a_long_turn_holds_its_bank_and_after_an_acceleration_it_is_of_the_new_speed():
    flight = flown(Turn(180.0, bank_deg=30.0))
    middle = flight.time.size // 2
    assert math.degrees(flight.euler[0].max()) == pytest.approx(30.0, abs=1e-6)
    rate = np.gradient(np.unwrap(flight.euler[2]), flight.step)[middle]
    assert rate == pytest.approx(G * math.tan(math.radians(30.0)) / 120.0, rel=1e-6)
    short = flown(Turn(2.0, bank_deg=30.0, ramp_s=4.0))
    assert 0.0 < math.degrees(short.euler[0].max()) < 30.0
    assert short.duration == pytest.approx(8.0)
    flight = flown(Accelerate(60.0), Turn(90.0, bank_deg=20.0))
    roll, _, yaw = flight.euler
    rate = np.gradient(np.unwrap(yaw), flight.step)
    np.testing.assert_allclose(np.tan(roll), 180.0 * rate / G, atol=1e-4)


@pytest.mark.parametrize("height_m", [-300.0, 20.0])
def test_a_climb_changes_the_height_and_no_speed(height_m):
    flight = flown(Climb(height_m, rate_mps=8.0), Straight(1.0))
    height = flight.geodetic[2]
    assert height[-1] - height[0] == pytest.approx(height_m, abs=1e-3)
    assert np.abs(flight.velocity_n[:, 2]).max() < 8.0 + 1e-9
    np.testing.assert_allclose(speed(flight), 120.0, rtol=1e-9)
    np.testing.assert_allclose(
        np.sin(flight.euler[1]), -flight.velocity_n[:, 2] / speed(flight), atol=1e-9
    )


@pytest.mark.parametrize("change_mps", [-40.0, 0.5])
def test_an_acceleration_changes_the_speed(change_mps):
    flight = flown(Accelerate(change_mps, acceleration_mps2=2.0), Straight(1.0))
    assert speed(flight)[-1] - 120.0 == pytest.approx(change_mps, abs=1e-9)
    assert np.abs(np.gradient(speed(flight), flight.step)).max() < 2.0 + 1e-6


def test_until_ends_at_its_time_at_any_rate_and_the_antimeridian_is_any_meridian():
    plan = Straight(5.0), Turn(60.0), Until(60.0), Climb(200.0), Until(90.0)
    coarse, fine = (flown(*plan, rate_hz=rate_hz) for rate_hz in (50.0, 200.0))
    assert (coarse.duration, coarse.time.size, fine.time.size) == (90.0, 4501, 18001)
    assert np.linalg.norm(coarse.position_e[-1] - fine.position_e[-1]) < 0.01
    east, west = (flown(Turn(45.0), longitude_deg=degree) for degree in (179.999, -179.999))
    apart = east.geodetic[1] - west.geodetic[1]
    np.testing.assert_allclose(np.degrees(apart) % 360.0, 359.998, atol=1e-9)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: flown(), "at least one manoeuvre"),
        (lambda: flown(Straight(1.0), latitude_deg=91.0), "`latitude_deg`.*got 91"),
        (lambda: flown(Turn(10.0), speed_mps=0.0), "speed above 0 m/s"),
        (lambda: flown(Climb(100.0, rate_mps=20.0), speed_mps=10.0), "at most 8.66 m/s"),
        (lambda: flown(Accelerate(-130.0)), "`change_mps` must be at least -120 m/s"),
        (lambda: flown(Straight(9.0), Until(5.0)), "previous manoeuvre, 9 s, got 5 s"),
    ],
)
def test_what_cannot_be_flown_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


LONG = {"en-route", "terminal"}  # millions of numbers each
READY_MADE = [
    pytest.param(name, marks=[pytest.mark.nightly] if name in LONG else []) for name in FLIGHTS
]


@pytest.mark.parametrize("name", READY_MADE)
def test_every_ready_made_flight_is_smooth_and_gentle(name):
    flight = FLIGHTS[name]()
    trajectory = inverse_kinematics(flight)
    assert flight.name == name
    assert np.abs(trajectory.angular_rate_b).max() < math.radians(10.0)
    load = -trajectory.specific_force_b[:, 2] / G
    assert 0.6 < load.min() <= load.max() < 1.4
    assert np.abs(np.diff(trajectory.specific_force_b, axis=0)).max() < 0.05
    assert np.abs(np.diff(trajectory.angular_rate_b, axis=0)).max() < math.radians(0.2)


@pytest.mark.parametrize(
    ("make", "seconds", "climbed"),
    [
        (zhong2025, (0, 100, 200, 300, 418), (0, 500, 500)),
        (ke2022, (0, 150, 260, 450, 746), (0, 500, 1000)),
    ],
)
def test_flights_of_the_papers_are_two_turns_and_climbs(make, seconds, climbed):
    flight = make()
    assert (flight.duration, flight.time.size) == (seconds[-1], 100 * seconds[-1] + 1)
    at = [100 * second for second in seconds]
    assert np.degrees(flight.euler[2])[at] == pytest.approx([90, 135, 90, 90, 90], abs=1e-6)
    assert flight.geodetic[2][at] - 10000 == pytest.approx([0, 0, *climbed], abs=1.0)
    np.testing.assert_allclose(speed(flight), 200.0, rtol=1e-6)
    if make is zhong2025:
        start = [angle[0] for angle in flight.geodetic[:2]]
        assert np.degrees(start) == pytest.approx([50.425, -3.5958])
        assert -flight.velocity_n[:, 2].min() == pytest.approx(20.0)
        assert np.degrees(np.abs(flight.euler[0]).max()) == pytest.approx(14.04, abs=1e-6)


def test_the_car_starts_and_ends_at_rest():
    flight = car()
    assert flight.duration == 60.0
    np.testing.assert_allclose(flight.velocity_n[[0, -1]], 0.0, atol=1e-9)
    assert speed(flight).max() == pytest.approx(20.0)
    np.testing.assert_allclose(flight.euler[0], 0.0, atol=1e-9)


@pytest.mark.parametrize(("make", "file"), [(zhong2025, "Profile_3"), (car, "Profile_1")])
def test_ready_made_flights_follow_the_profiles_of_the_reference(data_folder, make, file):
    flight = make()
    profile = np.loadtxt(data_folder / f"groves_reference/{file}.csv.gz", delimiter=",")
    np.testing.assert_allclose(flight.time, profile[:, 0], atol=1e-9)
    position = geodetic_to_ecef(*np.radians(profile[:, 1:3]).T, profile[:, 3])
    assert np.linalg.norm(flight.position_e - position, axis=1).max() < 100.0
    # in the middle of the segments; at their edges the profile has steps
    middles = [10, 52, 100, 146, 190, 225, 330] if file == "Profile_3" else [5, 12, 20, 30, 40, 49]
    for second in middles:
        sample = round(100 * second)
        got = np.degrees([angle[sample] for angle in flight.euler])
        difference = (got - profile[sample, 7:10] + 180.0) % 360.0 - 180.0
        assert np.abs(difference).max() < 4.0, second
