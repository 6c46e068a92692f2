"""The robot: its course, dead reckoning that drifts as it should, and errors of the fixes."""

import math

import numpy as np
import pytest

from spoofgym.truth._kernels import measure_fix, measure_odometry
from spoofgym.truth.noise import BLOCK
from spoofgym.truth.robot import FixErrors, Odometer, RobotLoop, episode_keys

SAMPLES = 10


def generators(count, first=0):
    return [np.random.default_rng(first + i) for i in range(count)]


def draw_keys(rngs):
    episodes = [episode_keys(rng.bit_generator.seed_seq.spawn(1)[0]) for rng in rngs]
    return tuple(np.array(each) for each in zip(*episodes, strict=True))


def dead_reckoning(odometer, epochs, receivers=1, loop=None):
    """(K+1, B, 2) position by dead reckoning from the truth on, and (K+1, 2) truth."""
    track = (loop or RobotLoop()).track(epochs * SAMPLES, odometer.sample_interval_s)
    left, right = track.wheels(odometer.wheel_base_m)
    keys, phase = draw_keys(generators(receivers))
    increment, yaw, noise = np.empty((receivers, 2)), np.zeros(receivers), np.empty(BLOCK)
    degrees = odometer.hard_iron_deg, odometer.yaw_noise_deg
    errors = odometer.count_m, *map(math.radians, degrees), phase
    way = np.zeros(receivers, dtype=np.int64), left, right, track.yaw, SAMPLES
    found = [np.zeros((receivers, 2))]
    for k in range(epochs + 1):
        measure_odometry(keys, np.full(receivers, k), *way, *errors, noise, yaw, increment)
        found.append(found[-1] + increment)
    return np.array(found[1:]), track.position_ne[::SAMPLES]


def test_dead_reckoning_follows_the_truth_but_for_the_noise_of_the_heading():
    odometer = Odometer(hard_iron_deg=0.0, yaw_noise_deg=0.0)
    found, truth = dead_reckoning(odometer, 150)
    # a count of each wheel, and the turns that a sample of 5 cm cuts
    assert np.abs(found[:, 0] - truth).max() < 0.01
    odometer = Odometer(hard_iron_deg=0.0, yaw_noise_deg=5.0, counts_per_turn=100_000)
    loop = RobotLoop(heading_deg=0.0, length_m=100.0, width_m=100.0)
    found, truth = dead_reckoning(odometer, 60, receivers=400, loop=loop)
    # the mean of two ends: neighbours share one, so that the sum has n draws of the full size
    expected = 0.05 * math.radians(5.0) * math.sqrt(600)
    assert (found[-1, :, 1] - truth[-1, 1]).std() == pytest.approx(expected, rel=0.15)


def test_hard_iron_drives_it_off_by_the_same_vector_every_lap():
    A = math.radians(2.0)
    loop = RobotLoop(corner_radius_m=0.01)
    odometer = Odometer(hard_iron_deg=2.0, yaw_noise_deg=0.0)
    lap = 2.0 * (13.4 + 6.1) - (8.0 - 2.0 * math.pi) * 0.01
    found, truth = dead_reckoning(odometer, 312, loop=loop)
    error = found[:, 0] - truth
    psi = math.radians(248.0)
    # a side of length L and its opposite: twice -A sin(psi) L across its direction
    across = np.zeros(2)
    for length, side in ((13.4, psi), (6.1, psi + 0.5 * math.pi)):
        across += -2.0 * A * math.sin(side) * length * np.array([-math.sin(side), math.cos(side)])
    for laps in (1, 2, 3, 4):
        now = error[round(lap * laps / 0.5)]
        np.testing.assert_allclose(now, laps * across, atol=0.03 * laps + 0.03)


def fixes(errors, epochs, receivers, offset=0.0, available=None):
    keys, _ = draw_keys(generators(receivers))
    correlated, noise = np.zeros((receivers, 2)), np.empty(BLOCK)
    out, first = np.empty((epochs, receivers, 2)), np.zeros(receivers, dtype=np.int64)
    available = np.ones(epochs, dtype=np.bool_) if available is None else available
    track = first, np.tile([1.0, -2.0], (epochs, 1)), available
    sizes = errors.correlated_sd_m, errors.decay(1.0), errors.white_sd_m
    offsets = np.full((receivers, 2), offset)
    for k in range(epochs):
        now = np.full(receivers, k)
        measure_fix(keys, now, *track, *sizes, offsets, noise, correlated, out[k])
    return out


def test_fixes_have_the_stated_errors_and_a_spoofer_moves_them():
    found = fixes(FixErrors(), 120, 2000) - [1.0, -2.0]
    assert np.abs(found.mean(axis=(0, 1))).max() < 0.05
    np.testing.assert_allclose(found.std(axis=1), math.hypot(1.0, 0.2), rtol=0.08)
    lag = (found[60:] * found[:-60]).mean()
    assert lag == pytest.approx(math.exp(-1.0), abs=0.05)
    step = np.diff(found, axis=0).var()
    assert step == pytest.approx(2.0 * (1.0 - math.exp(-1.0 / 60.0)) + 2.0 * 0.2**2, rel=0.03)
    plain, moved = fixes(FixErrors(), 4, 3), fixes(FixErrors(), 4, 3, offset=7.0)
    np.testing.assert_allclose(moved - plain, 7.0, atol=1e-12)
    available = np.array([True, True, False, True])
    found = fixes(FixErrors(), 4, 3, available=available)
    assert np.isnan(found[2]).all()
    np.testing.assert_array_equal(found[available], plain[available])


@pytest.mark.nojit
def test_keys_belong_to_receivers_and_episodes():
    rngs = generators(3)
    first, phase = draw_keys(rngs)
    second, _ = draw_keys(rngs)
    alone, own_phase = draw_keys([np.random.default_rng(2)])
    np.testing.assert_array_equal(first[2], alone[0])
    np.testing.assert_array_equal(phase[2], own_phase[0])
    assert len({tuple(row) for row in np.concatenate([first, second]).reshape(-1, 2)}) == 12
    assert ((phase >= 0.0) & (phase < 1.0)).all()


@pytest.mark.parametrize(("heading", "radius"), [(0.0, 0.05), (248.0, 0.3), (90.0, 3.05)])
def test_a_lap_ends_where_it_began(heading, radius):
    loop = RobotLoop(heading_deg=heading, corner_radius_m=radius)
    lap = 2.0 * (loop.length_m + loop.width_m) - (8.0 - 2.0 * math.pi) * radius
    track = loop.track(400, lap / loop.speed_mps / 100.0)
    for k in range(1, 5):
        np.testing.assert_allclose(track.position_ne[100 * k], 0.0, atol=1e-9)
        assert track.yaw[100 * k] - track.yaw[0] == pytest.approx(2.0 * math.pi * k)


def test_position_is_the_integral_of_velocity_and_the_course_has_the_stated_size():
    step = 1e-3
    track = RobotLoop().track(100_000, step)
    mean = 0.5 * (track.velocity_ne[1:] + track.velocity_ne[:-1])
    moved = np.diff(track.position_ne, axis=0)
    # where a side meets a corner, the mean of the ends is off by a quarter of the step's turn
    np.testing.assert_allclose(moved, mean * step, atol=0.3 * 0.5 * step * (0.5 / 0.3 * step))
    np.testing.assert_allclose(np.hypot(*track.velocity_ne.T), 0.5, rtol=1e-12)
    direction = np.stack([np.cos(track.yaw), np.sin(track.yaw)], axis=1)
    np.testing.assert_allclose(track.velocity_ne, 0.5 * direction, atol=1e-9)
    assert np.diff(track.yaw).max() <= 0.5 / 0.3 * step + 1e-9  # speed over the radius
    track = RobotLoop(heading_deg=0.0).track(8000, 0.01)
    assert np.ptp(track.position_ne[:, 0]) == pytest.approx(13.4, abs=1e-3)
    assert np.ptp(track.position_ne[:, 1]) == pytest.approx(6.1, abs=1e-3)
    heading = math.radians(248.0)
    side = 5.0 * np.array([math.cos(heading), math.sin(heading)])
    np.testing.assert_allclose(RobotLoop().track(100, 0.1).position_ne[100], side, atol=1e-12)
    left, right = track.wheels(0.2)  # the outer one rolls farther
    np.testing.assert_allclose(0.5 * (left + right), track.distance)
    np.testing.assert_allclose(left - right, 0.2 * (track.yaw - track.yaw[0]))
    assert not RobotLoop(speed_mps=0.0).track(10, 0.1).position_ne.any()


def test_corners_fit_into_the_shorter_side():
    with pytest.raises(ValueError, match=r"`corner_radius_m` must be at most 3\.05, .* got 3\.1"):
        RobotLoop(corner_radius_m=3.1)
