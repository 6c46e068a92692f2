"""The robot's course: closed, smooth, and of the stated speed."""

import math

import numpy as np
import pytest

from spoofgym.truth.robot import RobotLoop


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
