"""One inertial sample: coefficients, closed forms, and the same bits in any lane."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.earth.frames import dcm_e_from_n, geodetic_to_ecef
from spoofgym.earth.wgs84 import EARTH_RATE, gravity
from spoofgym.receiver.state import LANES, ReceiverBuffers
from spoofgym.receiver.strapdown import rotation_coefficients, strapdown_step

from .batches import predict

ULP = 2.0**-53


@pytest.mark.nojit
@given(st.floats(1e-4, 1.0, exclude_min=True))
def test_coefficients_are_exact_to_rounding(angle):
    s, c, d = rotation_coefficients(angle * angle)
    assert s == pytest.approx(math.sin(angle) / angle, rel=4e-16)
    assert c == pytest.approx(0.5 * (math.sin(0.5 * angle) / (0.5 * angle)) ** 2, rel=6e-16)
    x = np.longdouble(angle) ** 2
    if angle > 0.1:
        closed = float((1 - np.sin(np.longdouble(angle)) / np.longdouble(angle)) / x)
    else:
        closed = float((1 - x / 20 * (1 - x / 42 * (1 - x / 72 * (1 - x / 110)))) / 6)
    assert d == pytest.approx(closed, rel=6e-16)


@pytest.mark.nojit
@given(st.floats(1e-8, 1e-4, exclude_min=True, exclude_max=True))
def test_a_small_angle_is_rounded_as_its_cosine_is(angle):
    s, c, d = rotation_coefficients(angle * angle)
    assert s == pytest.approx(1.0 - angle**2 / 6.0, rel=2e-16)
    assert d == pytest.approx(1.0 / 6.0, rel=1e-9)
    assert c * angle**2 == pytest.approx(1.0 - math.cos(angle), abs=1.01 * ULP)
    steps = c * angle**2 / ULP
    assert abs(steps - round(steps)) < 1e-6  # one less a double below one


@pytest.mark.nojit
@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 0.999e-8])
def test_what_turns_no_more_than_a_quantized_gyro_at_rest_does_not_turn(angle):
    assert rotation_coefficients(angle * angle) == (1.0, 0.0, 0.0)


def at(latitude_deg, height=0.0):
    latitude = math.radians(latitude_deg)
    r = geodetic_to_ecef(latitude, 0.4, height)
    return np.array(dcm_e_from_n(latitude, 0.4)), np.zeros(3), r


def run(C, v, r, f, w, dt, count):
    C, v, r = tuple(C.ravel()), tuple(v), tuple(r)
    for _ in range(count):
        C, v, r = strapdown_step(C, v, r, tuple(f), tuple(w), dt)
    return np.reshape(C, (3, 3)), np.array(v), np.array(r)


@pytest.mark.parametrize("latitude_deg", [-90.0, -40.0, 0.0, 55.0, 90.0])
def test_what_stands_still_stays_still(latitude_deg):
    """A minute on the turning Earth, with the samples that a perfect sensor gives."""
    C, v, r = at(latitude_deg)
    f = -C.T @ np.array(gravity(*r))
    w = C.T @ np.array([0.0, 0.0, EARTH_RATE])
    C_after, v_after, r_after = run(C, v, r, f, w, 0.01, 6000)
    np.testing.assert_allclose(C_after, C, rtol=0, atol=1e-11)
    # the rounded coefficient of small angles is worth up to 5e-9 of the specific force
    np.testing.assert_allclose(v_after, 0.0, rtol=0, atol=5e-9 * 9.8 * 60.0)
    np.testing.assert_allclose(r_after, r, rtol=0, atol=5e-9 * 9.8 * 60.0**2)


@pytest.mark.nojit
def test_free_fall_from_the_pole():
    C, v, r = at(90.0, 1000.0)
    _, v_after, r_after = run(C, v, r, np.zeros(3), np.zeros(3), 0.01, 100)
    assert v_after[2] == pytest.approx(-9.829, abs=2e-3)
    assert r[2] - r_after[2] == pytest.approx(0.5 * 9.829, abs=2e-3)
    np.testing.assert_allclose(v_after[:2], 0.0, atol=1e-9)


@pytest.mark.nojit
def test_a_full_turn_leads_back():
    C, v, r = at(30.0)
    w = C.T @ np.array([0.0, 0.0, EARTH_RATE]) + np.array([0.0, 0.0, 2.0 * math.pi])
    turned, _, _ = run(C, v, r, np.zeros(3), w, 0.01, 100)
    # about a body axis that turns with the Earth: all but the Earth's part of the turn
    np.testing.assert_allclose(turned, C, rtol=0, atol=1e-4)
    half, _, _ = run(C, v, r, np.zeros(3), w, 0.01, 50)
    np.testing.assert_allclose(half, C @ np.diag([-1.0, -1.0, 1.0]), rtol=0, atol=1e-4)


def test_without_forces_speed_turns_against_the_earth():
    """Coriolis: in a second, a velocity turns by twice the Earth's angle."""
    C, v, r = at(90.0)
    v = np.array([100.0, 0.0, 0.0])
    f = -C.T @ np.array(gravity(*r))
    _, v_after, _ = run(C, v, r, f, C.T @ np.array([0.0, 0.0, EARTH_RATE]), 0.01, 100)
    assert v_after[1] == pytest.approx(-2.0 * EARTH_RATE * 100.0, rel=1e-3)


def random_batch(receivers, channels=4, most=12):
    """Buffers of receivers that all fly differently, with different numbers of samples."""
    buffers = ReceiverBuffers(receivers, channels, most)
    interval = np.linspace(0.008, 0.012, 3 * most)
    for b in range(receivers):
        fill(buffers, b, b, interval)
    return buffers, interval


def fill(buffers, row, number, interval):
    """Make a row of a batch the receiver of a number."""
    rng = np.random.default_rng(number)
    state, measured = buffers.state, buffers.measured
    C, _, r = at(rng.uniform(-80.0, 80.0), rng.uniform(0.0, 1e4))
    state.C_eb[row] = C
    state.position_e[row], state.velocity_e[row] = r, rng.normal(0.0, 100.0, 3)
    state.accel_bias_b[row], state.gyro_bias_b[row] = rng.normal(0, 1e-3, 3), rng.normal(0, 1e-5, 3)
    state.clock[row] = rng.normal(0.0, 100.0, 2)
    root = rng.normal(0.0, 0.1, (17, 17))
    state.covariance[row] = root @ root.T
    buffers.noise_psd[row] = rng.uniform(0.0, 1.0, 17)
    count = int(rng.integers(1, buffers.samples.shape[1] + 1))
    buffers.put_samples(row, rng.normal(0.0, 1.0, (count, 6)) * np.repeat([10.0, 0.3], 3))
    first = int(rng.integers(0, 5))
    buffers.block[:, row] = first, count
    measured.interval[row] = interval[first : first + count].sum()
    measured.visible[row] = rng.uniform(size=buffers.channels) < 0.7
    measured.satellite_position[row] = r + rng.normal(0.0, 1e7, (buffers.channels, 3))
    measured.satellite_velocity[row] = rng.normal(0.0, 1e3, (buffers.channels, 3))
    measured.pseudorange[row] = rng.uniform(2e7, 2.5e7, buffers.channels)


def rows(buffers, row):
    return [np.array(a[row]) for part in (buffers.state, buffers.measured) for a in part]


@pytest.mark.parametrize("receivers", [2, 3, LANES - 1, LANES, LANES + 1, 2 * LANES + 5])
def test_a_receiver_takes_the_same_path_in_any_lane_of_any_batch(receivers):
    buffers, interval = random_batch(receivers)
    predict(buffers, interval)
    for b in range(receivers):
        alone = ReceiverBuffers(1, buffers.channels, buffers.samples.shape[1])
        fill(alone, 0, b, interval)
        predict(alone, interval)
        for together, single in zip(rows(buffers, b), rows(alone, 0), strict=True):
            assert together.tobytes() == single.tobytes()


def test_slices_of_whole_lanes_are_the_whole():
    whole, interval = random_batch(2 * LANES + 5)
    sliced, _ = random_batch(2 * LANES + 5)
    predict(whole, interval)
    for lo, hi in ((LANES, 2 * LANES), (2 * LANES, 2 * LANES + 5), (0, LANES)):
        predict(sliced, interval, lo, hi)
    assert whole.floats.tobytes() == sliced.floats.tobytes()


def test_lanes_go_the_steps_of_single_samples():
    buffers, interval = random_batch(LANES + 3)
    start, _ = random_batch(LANES + 3)
    predict(buffers, interval)
    for b in range(LANES + 3):
        samples = start.measured_samples(b)
        C, v, r = (
            tuple(a[b].ravel())
            for a in (start.state.C_eb, start.state.velocity_e, start.state.position_e)
        )
        delta = np.zeros(6)
        for i, sample in enumerate(samples):
            dt = interval[start.block[0, b] + i]
            f = sample[:3] - start.state.accel_bias_b[b]
            w = sample[3:] - start.state.gyro_bias_b[b]
            delta += np.concatenate([f, w]) * dt
            C, v, r = strapdown_step(C, v, r, tuple(f), tuple(w), dt)
        np.testing.assert_allclose(buffers.state.C_eb[b].ravel(), C, rtol=0, atol=1e-14)
        np.testing.assert_allclose(buffers.state.velocity_e[b], v, rtol=0, atol=1e-12)
        np.testing.assert_allclose(buffers.state.position_e[b], r, rtol=0, atol=2e-8)
        np.testing.assert_allclose(buffers.measured.imu_delta[b], delta, rtol=1e-12, atol=1e-15)


def test_the_last_specific_force_is_that_of_the_last_sample():
    """It enters the transition; lanes with fewer samples keep theirs while others go on."""
    buffers, interval = random_batch(LANES)
    start, _ = random_batch(LANES)
    predict(buffers, interval)
    for b in range(LANES):
        f = start.measured_samples(b)[-1, :3] - start.state.accel_bias_b[b]
        f_e = buffers.state.C_eb[b] @ f * buffers.measured.interval[b]
        Phi = buffers.measured.transition[b]
        np.testing.assert_allclose([Phi[5, 1], Phi[3, 2], Phi[4, 0]], -f_e, rtol=1e-12)
