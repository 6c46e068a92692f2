"""Flights through tracks: tracks sampled from known flights lead back to them."""

import dataclasses
import json
import math
from datetime import UTC, datetime

import numpy as np
import pytest

from spoofgym.data import track_fit
from spoofgym.data.cleaning import clean_track
from spoofgym.data.track_fit import POSITION_SD, VELOCITY_SD, Track, coordinated_attitude, fit_track
from spoofgym.data.tracks import read_track
from spoofgym.earth.wgs84 import STANDARD_GRAVITY
from spoofgym.truth.flight import inverse_kinematics
from spoofgym.truth.manoeuvres import Accelerate, Climb, Straight, Turn, Until, fly


def flown(*manoeuvres, speed_mps=120.0, longitude_deg=8.0):
    return fly(
        manoeuvres,
        latitude_deg=46.0,
        longitude_deg=longitude_deg,
        height_m=2500.0,
        speed_mps=speed_mps,
        heading_deg=200.0,
        name="true",
    )


def true_flight(longitude_deg=8.0):
    return flown(
        Straight(30.0),
        Turn(90.0, bank_deg=20.0),
        Until(100.0),
        Climb(400.0, rate_mps=8.0),
        Until(180.0),
        Turn(-120.0, bank_deg=25.0),
        Accelerate(-20.0, acceleration_mps2=0.8),
        Until(300.0),
        longitude_deg=longitude_deg,
    )


@pytest.fixture(scope="module")
def true():
    return true_flight()


@pytest.fixture(scope="module")
def fitted(true):
    return fit_track(sampled(true))


def sampled(flight, interval=5.0, error_m=0.0, seed=0):
    rows = np.arange(0, flight.time.size, round(interval / flight.step))
    latitude, longitude, height = (value[rows] for value in flight.geodetic)
    north, east, _ = flight.velocity_n[rows].T
    off = error_m / 6.4e6 * np.random.default_rng(seed).standard_normal((2, rows.size))
    return Track(
        flight.name,
        datetime(2024, 1, 1, tzinfo=UTC),
        flight.time[rows],
        latitude + off[0],
        longitude + off[1] / np.cos(latitude),
        height,
        np.hypot(north, east),
        np.arctan2(east, north),
    )


def distance(flight, other):
    return np.linalg.norm(flight.position_e - other.position_e[: flight.time.size], axis=1)


def test_a_track_without_errors_leads_back_to_its_flight_and_the_report_says_what_it_does(
    true, fitted
):
    flight, report = fitted
    assert flight.duration == true.duration
    assert distance(flight, true).max() < 0.5 * POSITION_SD
    assert np.abs(flight.velocity_n - true.velocity_n).max() < 2.5 * VELOCITY_SD
    off = np.degrees(np.angle(np.exp(1j * (flight.euler[2] - true.euler[2]))))
    assert np.sqrt(np.mean(off**2)) < 1.0
    assert report.position_rms_m < 0.2 * POSITION_SD
    assert report.speed_rms_mps < VELOCITY_SD
    assert report.doubted == 0
    # well inside the long turn the bank is held
    middle = round(205.0 / flight.step)
    bank = flight.euler[0][middle], true.euler[0][middle]
    assert np.degrees(bank[0]) == pytest.approx(np.degrees(bank[1]), abs=3.0)
    flight, report = fitted
    trajectory = inverse_kinematics(flight)
    load = -trajectory.specific_force_b[:, 2] / STANDARD_GRAVITY
    speed = np.hypot(*flight.velocity_n[:, :2].T)
    assert (report.load_min_g, report.load_max_g) == (load.min(), load.max())
    assert (report.speed_min_mps, report.speed_max_mps) == (speed.min(), speed.max())
    assert report.start_utc == "2024-01-01T00:00:00+00:00"
    assert json.loads(json.dumps(report.as_dict()))["fixes"] == report.fixes == 61
    assert f"{report.position_rms_m:.0f} m" in " ".join(report.lines())


def test_the_fitted_flight_is_coordinated_and_smooth_wherever_it_is(fitted):
    trajectory = inverse_kinematics(fitted[0])
    force, rate = trajectory.specific_force_b, trajectory.angular_rate_b
    # what remains is the Earth's rotation, 2 omega v
    assert np.abs(force[:, 1]).max() < 3.0 * 7.3e-5 * 120.0
    assert np.abs(np.diff(force, axis=0)).max() < 0.05
    assert np.abs(np.diff(rate, axis=0)).max() < math.radians(0.2)
    there = inverse_kinematics(fit_track(sampled(true_flight(179.95)))[0])
    np.testing.assert_allclose(there.specific_force_b, force, atol=1e-4)
    np.testing.assert_allclose(there.angular_rate_b, rate, atol=1e-5)


def test_errors_of_fixes_are_smoothed_out_and_a_wild_speed_bends_nothing(true, fitted):
    flight, report = fit_track(sampled(true, error_m=POSITION_SD))
    assert np.sqrt(np.mean(distance(flight, true) ** 2)) < POSITION_SD
    assert 0.7 < report.position_rms_m / (math.sqrt(2.0) * POSITION_SD) < 1.3
    track = sampled(true)
    speed = track.groundspeed.copy()
    speed[20] += 60.0
    flight, report = fit_track(dataclasses.replace(track, groundspeed=speed))
    assert report.doubted == 1
    assert np.abs(flight.velocity_n - fitted[0].velocity_n).max() < 2.5 * VELOCITY_SD


@pytest.mark.parametrize("missing", [["track_angle"], ["groundspeed"]])
def test_speeds_and_courses_may_be_missing(true, missing):
    track = sampled(true)
    nothing = np.full(track.time.size, np.nan)
    flight, report = fit_track(dataclasses.replace(track, **dict.fromkeys(missing, nothing)))
    assert distance(flight, true).max() < 2.0 * POSITION_SD
    said = " ".join(report.lines())
    assert "nan" not in said
    for field, told in (("groundspeed", "speed_rms_mps"), ("track_angle", "course_rms_deg")):
        assert math.isnan(getattr(report, told)) == (field in missing)
        assert (report.as_dict()[told] is None) == (field in missing)
        assert (f"; {told.split('_')[0]} not reported" in said) == (field in missing)


def test_attitude_on_a_circle_and_on_a_climb():
    speed, rate = 100.0, 0.05
    roll, pitch, yaw = coordinated_attitude(
        np.array([[speed, 0.0, 0.0], [0.0, speed, -10.0], [-speed, 0.0, 0.0]]),
        np.array([[0.0, speed * rate, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
    )
    assert math.tan(roll[0]) == pytest.approx(speed * rate / STANDARD_GRAVITY)
    np.testing.assert_allclose(roll[1:], 0.0, atol=1e-12)
    np.testing.assert_allclose(pitch, [0.0, math.atan(0.1), 0.0], atol=1e-12)
    np.testing.assert_allclose(yaw, [0.0, math.pi / 2, math.pi], atol=1e-12)


def test_what_is_no_track_and_what_no_airliner_flies_is_refused(true, monkeypatch):
    aerobatics = Straight(20.0), Turn(720.0, bank_deg=72.0, ramp_s=4.0)
    for flight, interval, message in (
        (flown(*aerobatics, speed_mps=150.0), 1.0, r"0.3 and 2.5 g, got \d\.\d\d g .* into 'true"),
        (flown(Straight(60.0), speed_mps=5.0), 5.0, r"above 15 m/s for a heading, got 5\.\d m/s"),
        (true, 70.0, "at least 6 fixes, got 5"),
    ):
        with pytest.raises(ValueError, match=message):
            fit_track(sampled(flight, interval))
    track = sampled(true)
    for changes, message in (
        ({"time": np.zeros(61)}, "rise from fix to fix"),
        ({"latitude": np.full(61, math.radians(89.5))}, "within 89 deg.*got 89.5"),
        ({"height": np.full(61, np.nan)}, "`height` must be finite"),
        ({"groundspeed": np.full(61, np.inf)}, "`groundspeed` must be finite or NaN"),
        ({"start_utc": datetime(2024, 1, 1)}, "time zone"),
    ):
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(track, **changes)
    with pytest.raises(ValueError, match="`rate_hz`"):
        fit_track(track, rate_hz=0.0)
    monkeypatch.setattr(track_fit, "RATE_LIMIT", math.radians(1.0))
    with pytest.raises(ValueError, match=r"at most 1 deg/s, got \d\.\d deg/s \d+\.\d s into"):
        fit_track(track)


@pytest.mark.parametrize(
    ("name", "reports_velocity"),
    [("ajaccio", True), ("airbus_tree", True), ("inflight_refuelling", False)],
)
def test_recorded_flights_become_flyable(data_folder, name, reports_velocity):
    pytest.importorskip("pandas")
    track, _ = clean_track(read_track(data_folder / f"adsb_flights/{name}.json.gz"))
    flight, report = fit_track(track)
    assert 550.0 < flight.duration <= 600.0
    assert 0.3 < report.load_min_g <= report.load_max_g < 2.5
    assert report.rate_max_degps < 20.0
    # times of fixes are late by up to half of ajaccio's 5 s, and by a second elsewhere
    lateness_s = 2.5 if name == "ajaccio" else 1.0
    assert report.position_rms_m < lateness_s * report.speed_max_mps
    if reports_velocity:
        assert report.speed_rms_mps < VELOCITY_SD
        assert report.course_rms_deg < 2.0
