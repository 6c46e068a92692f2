"""A flight: what it accepts, its views, and the inverse kinematics that sensors must feel."""

import dataclasses
import math

import numpy as np
import pytest
import scipy.io

from spoofgym.earth.attitude import euler_to_dcm
from spoofgym.earth.wgs84 import (
    EARTH_RATE,
    dcm_e_from_n,
    geodetic_to_ecef,
    gravity,
    radii_of_curvature,
)
from spoofgym.truth.flight import (
    Flight,
    flight_from_geodetic,
    flight_from_velocity,
    inverse_kinematics,
)
from spoofgym.truth.manoeuvres import Straight, Turn, fly, zhong2025

from ..receiver.reference import mechanize

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


def strapdown(position, velocity, C, force, rate, step):
    states = [(C, velocity, position)]
    for sample in zip(force, rate, strict=True):
        states.append(mechanize(*states[-1], *sample, step))
    return (np.array(column) for column in list(zip(*states, strict=True))[::-1])


def still(latitude_deg=45.0):
    zero = np.zeros(11)
    attitude = zero + 0.1, zero - 0.2, zero + 1.0
    start = math.radians(latitude_deg), 0.5, 100.0
    return flight_from_velocity("still", *start, np.zeros((11, 3)), *attitude, 0.1)


def test_samples_lead_back_along_the_flight_of_zhong2025():
    """Through its first turn."""
    flight, part = zhong2025(), slice(9_500, 12_500)
    found = inverse_kinematics(flight)
    names, errors = ("position_e", "velocity_e", "C_eb"), (1e-6, 1e-8, 1e-11)
    start = [getattr(found, name)[part.start] for name in names]
    samples = found.specific_force_b[part], found.angular_rate_b[part]
    states = strapdown(*start, *samples, found.step)
    for name, state, error in zip(names, states, errors, strict=True):
        np.testing.assert_array_equal(getattr(found, name), getattr(flight, name))
        apart = state - getattr(found, name)[part.start : part.stop + 1]
        assert np.abs(apart).max() < error, name
    np.testing.assert_array_equal(found.time, flight.time)


@pytest.mark.nojit
@pytest.mark.parametrize("size", [0.0, 1e-12, 2e-8, 1e-6, 0.099, 0.101, 1.5])
def test_any_samples_are_recovered_from_the_motion_they_cause(size):
    rng = np.random.default_rng(1)
    step, count = 0.01, 50
    axis = rng.standard_normal((count, 3))
    rate = size / step * axis / np.linalg.norm(axis, axis=1)[:, None]
    force = 20.0 * rng.standard_normal((count, 3))
    position = geodetic_to_ecef(0.7, -1.2, 5000.0)
    C = dcm_e_from_n(0.7, -1.2) @ euler_to_dcm(0.4, -0.3, 2.0)
    motion = strapdown(position, np.array([100.0, -50.0, 30.0]), C, force, rate, step)
    flight = Flight("random", np.arange(count + 1) * step, *motion)
    trajectory = inverse_kinematics(flight)
    np.testing.assert_allclose(trajectory.angular_rate_b, rate, atol=1e-13 / step)
    np.testing.assert_allclose(trajectory.specific_force_b, force, atol=1e-9)


@pytest.mark.nojit
@pytest.mark.parametrize("latitude_deg", [-90.0, 0.0, 45.0])
def test_at_rest_sensors_feel_gravity_and_the_turn_of_the_earth(latitude_deg):
    flight = still(latitude_deg)
    trajectory = inverse_kinematics(flight)
    C_be = flight.C_eb[0].T
    force = -C_be @ np.array(gravity(*flight.position_e[0]))
    np.testing.assert_allclose(trajectory.specific_force_b, np.tile(force, (10, 1)), atol=1e-6)
    rate = C_be @ np.array([0.0, 0.0, EARTH_RATE])
    np.testing.assert_allclose(trajectory.angular_rate_b, np.tile(rate, (10, 1)), atol=1e-14)


def force_of(manoeuvre, heading_deg=0.0):
    flight = fly(
        [manoeuvre],
        latitude_deg=50.0,
        longitude_deg=20.0,
        height_m=10000.0,
        speed_mps=200.0,
        heading_deg=heading_deg,
    )
    return flight, inverse_kinematics(flight).specific_force_b


@pytest.mark.parametrize("heading_deg", [90.0, 270.0])
def test_level_flight_weighs_gravity_less_the_lift_of_eotvos(heading_deg):
    flight, force = force_of(Straight(10.0), heading_deg)
    east = 200.0 * math.sin(math.radians(heading_deg))
    _, transverse = radii_of_curvature(math.radians(50.0))
    cosine = math.cos(math.radians(50.0))
    lift = 2.0 * EARTH_RATE * east * cosine + east**2 / (transverse + 10000.0)
    weight = np.linalg.norm(gravity(*flight.position_e[0]))
    np.testing.assert_allclose(-force[:, 2], weight - lift, atol=1e-4)


def test_a_coordinated_turn_weighs_the_secant_of_the_bank():
    _, force = force_of(Turn(180.0, bank_deg=30.0))
    middle = force[len(force) // 2]
    assert -middle[2] / 9.80665 == pytest.approx(1.0 / math.cos(math.radians(30.0)), rel=0.01)
    assert abs(middle[1]) < 0.03 * 9.80665


def test_a_somersault_within_a_sample_is_refused():
    flight = still()
    C_eb = flight.C_eb.copy()
    C_eb[1] = C_eb[1] @ euler_to_dcm(math.radians(100.0), 0.0, 0.0)
    tumbling = Flight("tumbling", flight.time, flight.position_e, flight.velocity_e, C_eb)
    with pytest.raises(ValueError, match="at most 90 deg in a sample, got 100 deg"):
        inverse_kinematics(tumbling)


@pytest.mark.parametrize(
    "name", ["golden_aviation_profile1_1Hz", "golden_tactical_profile3_first120s_1Hz"]
)
def test_true_samples_are_those_of_the_reference_software(data_folder, name):
    run = scipy.io.loadmat(data_folder / f"groves_reference/{name}.mat")
    profile, imu = run["profile_used"], run["imu_true_meas"]
    columns = profile[:, 1], profile[:, 2], profile[:, 3], profile[:, 4:7], *profile[:, 7:10].T
    trajectory = inverse_kinematics(flight_from_geodetic(name, *columns))
    # where a sample turns by 1e-6 rad, the last bit of cos a is 5e-9 of the force
    np.testing.assert_allclose(trajectory.specific_force_b, imu[:, 0:3], atol=1e-8)
    np.testing.assert_allclose(trajectory.angular_rate_b, imu[:, 3:6], atol=1e-11)
