"""Fixes of one epoch's pseudoranges."""

import numpy as np
import pytest
from scipy import optimize

from spoofgym.earth.wgs84 import EARTH_RATE, SPEED_OF_LIGHT
from spoofgym.receiver import least_squares_fix
from spoofgym.receiver.snapshot import expect, fix_receivers
from spoofgym.truth._kernels import measure_snapshot
from spoofgym.truth.noise import pad_count
from spoofgym.truth.run import make_sky
from spoofgym.truth.satellites import CircularConstellation

SKY = make_sky(3, 1.0, 12, CircularConstellation(satellites=36), speed_mps=50.0)


def pseudoranges(noise_m=0.0, receivers=1, spoofed=None, displacement=(0.0, 0.0, 0.0, 0.0)):
    """(B, 12) pseudoranges at the first epoch, with a clock of 1000 m."""
    b = receivers
    rho, satellites = np.empty((b, 12)), np.empty((b, 12, 3))
    measure_snapshot(
        np.zeros(b, dtype=np.int64),
        np.arange(2 * b, dtype=np.uint64).reshape(b, 2),
        np.tile([1000.0, 5.0], (b, 1)),
        np.tile(displacement, (b, 1)).astype(float),
        np.tile(np.isin(np.arange(12), [] if spoofed is None else spoofed), (b, 1)),
        SKY.time,
        SKY.position_e,
        SKY.C_en,
        SKY.satellite_position_e,
        noise_m,
        np.empty(pad_count(12)),
        rho,
        satellites,
    )
    return rho, satellites


def fix_of(pseudorange, satellites, guess_e=(0.0, 0.0, 0.0)):
    n = len(pseudorange)
    return least_squares_fix(
        pseudorange, np.zeros(n), satellites, np.zeros((len(satellites), 3)), guess_e=guess_e
    )


def test_without_noise_the_fix_is_the_truth():
    rho, satellites = pseudoranges()
    fix = fix_of(rho[0], satellites[0])
    np.testing.assert_allclose(fix.position_e, SKY.position_e[0], atol=1e-4)
    assert fix.clock_bias_m == pytest.approx(1000.0, abs=1e-4)


def test_it_is_the_fix_of_scipys_solver():
    """Residuals by plain NumPy, minimised by a general solver."""
    rho, satellites = pseudoranges(noise_m=4.0)

    def residual(x):
        apart = np.linalg.norm(satellites[0] - x[:3], axis=1)
        a = EARTH_RATE * apart / SPEED_OF_LIGHT
        zero = np.zeros(12)
        shift = np.column_stack([a * satellites[0, :, 1], -a * satellites[0, :, 0], zero])
        return rho[0] - np.linalg.norm(satellites[0] + shift - x[:3], axis=1) - x[3]

    start = np.append(SKY.position_e[0], 0.0)
    scale = [1e6, 1e6, 1e6, 1e3]
    other = optimize.least_squares(residual, start, x_scale=scale, xtol=1e-15, ftol=1e-15)
    fix = fix_of(rho[0], satellites[0])
    np.testing.assert_allclose(fix.position_e, other.x[:3], atol=1e-3)
    assert fix.clock_bias_m == pytest.approx(other.x[3], abs=1e-3)


def test_noise_is_white_and_of_its_size():
    clean, _ = pseudoranges(receivers=2000)
    noisy, _ = pseudoranges(noise_m=4.0, receivers=2000)
    noise = noisy - clean
    assert noise.std() == pytest.approx(4.0, rel=0.02)
    assert np.abs(np.corrcoef(noise.T) - np.eye(12)).max() < 0.1


def test_all_spoofed_by_one_position_give_that_position():
    displacement = np.array([300.0, -200.0, 50.0, 40.0])
    rho, satellites = pseudoranges(spoofed=range(12), displacement=displacement)
    fix = fix_of(rho[0], satellites[0])
    moved = SKY.C_en.T @ (fix.position_e - SKY.position_e[0])
    np.testing.assert_allclose(moved, displacement[:3], atol=1e-4)
    assert fix.clock_bias_m == pytest.approx(1040.0, abs=1e-4)


def test_bad_input_is_refused():
    rho, satellites = pseudoranges()
    with pytest.raises(ValueError, match=r"got \(11,\), \(11,\), \(12, 3\) and \(12, 3\)"):
        fix_of(rho[0, 1:], satellites[0])
    for guess in ((0.0, 0.0), (np.nan, 0.0, 0.0)):  # too short a one would be read beyond its end
        with pytest.raises(ValueError, match="`guess_e` must be three finite numbers, got"):
            fix_of(rho[0], satellites[0], guess)
    absurd = rho[0, :4] + 2e7 * np.random.default_rng(57).standard_normal(4)
    with pytest.raises(ValueError, match="no convergence within 20 iterations"):
        fix_of(absurd, satellites[0, :4])


def test_weights_leave_satellites_out_and_without_a_fix_the_last_one_stays():
    rho, satellites = pseudoranges(
        noise_m=4.0, receivers=3, spoofed=[2], displacement=[0, 0, 0, 900]
    )
    weights = np.ones((3, 12))
    weights[1, 2] = 0.0
    weights[2, 3:] = 0.0
    position, clock = np.tile(SKY.position_e[0] + 7.0, (3, 1)), np.full((3, 1), 3.0)
    status = np.empty(3, dtype=np.int64)
    fix_receivers(rho, satellites, weights, position, clock, status)
    off = np.linalg.norm(position - SKY.position_e[0], axis=1)
    assert list(status) == [0, 0, 1]
    assert off[0] > 100.0
    assert off[1] < 30.0
    np.testing.assert_array_equal(position[2], SKY.position_e[0] + 7.0)
    assert clock[2, 0] == 3.0


def test_innovations_belong_to_their_belief():
    """Derivative of the predicted pseudorange by position and clock, and S = G P G' + R."""
    rho, satellites = pseudoranges(noise_m=4.0)
    position, clock = SKY.position_e[:1].copy(), np.array([[1000.0]])
    z, S, G = np.empty((1, 24)), np.empty((1, 24, 24)), np.empty((1, 24, 4))
    expect(rho, satellites, position, clock, 16.0, z, S, G)
    for axis in range(4):
        moved, late = position.copy(), clock.copy()
        if axis < 3:
            moved[0, axis] += 1.0
        else:
            late[0, 0] += 1.0
        other = np.empty((1, 24))
        expect(rho, satellites, moved, late, 16.0, other, S.copy(), G.copy())
        np.testing.assert_allclose((z - other)[0, :12], G[0, :12, axis], atol=1e-5)
    P = np.diag([1e6, 1e6, 1e6, 1e8])
    expected = np.block([[16.0 * np.eye(12), np.zeros((12, 12))], [np.zeros((12, 12)), np.eye(12)]])
    expected += G[0] @ P @ G[0].T
    np.testing.assert_allclose(S[0], expected, rtol=1e-12, atol=1e-6)
    assert not z[0, 12:].any()
