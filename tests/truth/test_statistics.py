"""The simulated sensors against those of the reference's golden runs, and against theory."""

import math

import numpy as np
import pytest
from scipy import stats

from spoofgym.detectors import Never
from spoofgym.earth.wgs84 import dcm_e_from_n, ecef_to_geodetic, range_and_rate
from spoofgym.receiver import TightlyCoupled
from spoofgym.simulation import TightlyCoupledSetup, Timeline
from spoofgym.truth.flight import flight_from_geodetic
from spoofgym.truth.gnss_errors import ERRORS
from spoofgym.truth.satellites import CircularConstellation
from spoofgym.truth.scenario import Scenario
from spoofgym.truth.sensors import IMU_GRADES

from ..golden import reference
from .sensing import modelled, run_of, sensors_of
from .sensing import sensed as measured_by

STANDARD_ERRORS = 4.5
"""One comparison in 150,000 is further off by chance."""


@pytest.fixture(params=sorted(reference.RUNS))
def grade(request):
    return request.param


@pytest.fixture
def run(grade, data_folder):
    return reference.load(data_folder, grade)


def constants_of(sheet):
    names = ("accel_bias", "gyro_bias", "accel_matrix", "gyro_matrix", "g_dependence")
    return {name: getattr(sheet, name) for name in names}


def sensed(sheet, truth, interval, rng):
    """(N, 6) measured samples of true ones."""
    sensors = sensors_of(imu_noise=sheet.noise, **constants_of(sheet))
    return measured_by(sensors, run_of(truth.T, interval), rng.standard_normal(truth.T.shape)).T


def lag_one(errors):
    errors = errors - errors.mean(axis=0)
    return (errors[1:] * errors[:-1]).sum(axis=0) / (errors**2).sum(axis=0)


def test_inertial_errors_are_distributed_as_the_references(run, grade):
    sheet = IMU_GRADES[grade]
    truth, measured = run["imu_true_meas"][:, :6], run["imu_true_meas"][:, 6:]
    interval = np.diff(run["profile_used"][:, 0])
    ours = sensed(sheet, truth, interval, np.random.default_rng(5))
    levels = np.repeat(sheet.noise[2:], 3)
    for samples in (measured, ours):
        np.testing.assert_allclose(samples / levels, np.round(samples / levels), atol=1e-6)
    exact = modelled(constants_of(sheet), truth.T).T
    theirs, ours = measured - exact, ours - exact
    n = len(truth)
    # rounding carries its rest, so that the mean is that of the white noise
    noise = np.repeat(sheet.noise[:2], 3) / math.sqrt(interval.mean())
    for errors in (theirs, ours):
        assert (np.abs(errors.mean(axis=0)) < STANDARD_ERRORS * noise / math.sqrt(n)).all()
    ratio = theirs.std(axis=0) / ours.std(axis=0)
    np.testing.assert_allclose(ratio, 1.0, atol=STANDARD_ERRORS / math.sqrt(n))
    # down to -0.47 where the quantization is coarser than the noise
    np.testing.assert_allclose(
        lag_one(theirs), lag_one(ours), atol=STANDARD_ERRORS * math.sqrt(2.0 / n)
    )


def test_the_attitude_begins_with_the_references_error(run, grade):
    profile = run["profile_used"]  # angles in radians
    flight = flight_from_geodetic(
        "profile", *profile[:, 1:4].T, profile[:, 4:7], *profile[:, 7:10].T, tolerance=1e-3
    )
    setup = TightlyCoupledSetup(
        scenario=Scenario(flight=flight, imu=grade),
        receiver=TightlyCoupled(grade=grade),
        detector=Never(),
        timeline=Timeline(warmup_s=5.0, live_s=0.0, attack_s=5.0),
    )
    # the reference takes the local axes at its first fix, some 6 m away: 1e-6 rad
    np.testing.assert_allclose(
        setup.combinations.first_C_eb(np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64))[0],
        run["init_C"],
        atol=2e-6,
    )


def test_pseudorange_errors_are_distributed_as_the_references(run):
    rows, bias, truth = run["gnss_meas"], run["gnss_bias"][0], run["true_ecef"]
    clock, errors = ERRORS["groves"].clock, ERRORS["groves"]
    satellites = CircularConstellation().states([0.0]).position_e[0]
    first = rows[rows[:, 9] == 1]
    ids = [int(np.linalg.norm(satellites - row[3:6], axis=1).argmin()) for row in first]
    np.testing.assert_allclose(satellites[ids], first[:, 3:6], atol=1e-3)
    white = []
    for k, row in enumerate(rows):
        sample = round(row[0] * 100.0)
        distance = range_and_rate(row[3:6], row[6:9], truth[sample, :3], truth[sample, 3:])[0]
        offset = clock.offset_m + clock.drift_mps * row[0] + bias[ids[k % len(ids)]]
        white.append(row[1] - distance - offset)
    low, high = stats.chi2.ppf([1e-4, 1.0 - 1e-4], len(white))
    assert low < np.sum(np.square(white)) / errors.code_sd_m**2 < high
    # the constant part, by elevation
    position = truth[0, :3]
    latitude, longitude, _ = ecef_to_geodetic(position)
    sight = (satellites[ids] - position) @ dcm_e_from_n(latitude, longitude)
    elevation = np.arcsin(-sight[:, 2] / np.linalg.norm(sight, axis=1))
    low, high = stats.chi2.ppf([1e-4, 1.0 - 1e-4], len(ids))
    assert low < np.sum((bias[ids] / errors.bias_sd(elevation)) ** 2) < high
