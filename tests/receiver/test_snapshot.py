"""Fixes of one epoch: exact where they can be, refused where they cannot."""

from functools import cache, partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofgym.earth.wgs84 import geodetic_to_ecef, range_and_rate
from spoofgym.receiver import least_squares_fix
from spoofgym.receiver.snapshot import expect, fix_receivers
from spoofgym.truth._kernels import measure_snapshot
from spoofgym.truth.noise import pad_count
from spoofgym.truth.run import make_sky
from spoofgym.truth.satellites import CircularConstellation

from ..lazily import Lazily

ORBIT = 2.656e7


def measure(r, v, clock, satellites, velocities):
    ranges = [range_and_rate(s, sv, r, v)[:2] for s, sv in zip(satellites, velocities, strict=True)]
    return np.ascontiguousarray(np.transpose(ranges) + np.reshape(clock, (2, 1)))


def in_view(r, count=8):
    states = CircularConstellation(satellites=36).states([100.0])
    s, sv = states.position_e[0], states.velocity_e[0]
    highest = np.argsort(-((s - r) @ r) / np.linalg.norm(s - r, axis=1))[:count]
    return s[highest], sv[highest]


R = geodetic_to_ecef(0.8, 0.2, 5000.0)
S, SV = in_view(R)


@cache
def measured():
    """Pseudoranges, range rates, satellites and their velocities."""
    return *measure(R, np.array([-50.0, 180.0, 20.0]), (3e5, -70.0), S, SV), S, SV


def some(which):
    return [array[which] for array in measured()]


@settings(max_examples=30, deadline=None)
@given(
    st.floats(-1.5, 1.5),
    st.floats(-3.0, 3.0),
    st.floats(-100.0, 2e4),
    st.tuples(*[st.floats(-300.0, 300.0)] * 3),
    st.tuples(st.floats(-1e6, 1e6), st.floats(-1e3, 1e3)),
)
def test_perfect_measurements_are_solved(latitude, longitude, height, v, clock):
    r = geodetic_to_ecef(latitude, longitude, height)
    s, sv = in_view(r)
    fix = least_squares_fix(*measure(r, v, clock, s, sv), s, sv)
    np.testing.assert_allclose(fix.position_e, r, rtol=0, atol=1e-5)
    np.testing.assert_allclose(fix.velocity_e, v, rtol=0, atol=1e-6)
    assert fix.clock_bias_m == pytest.approx(clock[0], abs=1e-5)
    assert fix.clock_drift_mps == pytest.approx(clock[1], abs=1e-6)


@pytest.mark.parametrize("where", range(4))
def test_a_satellite_with_a_nan_anywhere_is_left_out(where):
    arrays = [array.copy() for array in measured()]
    arrays[where][2] = np.nan
    fix = least_squares_fix(*arrays)
    without = least_squares_fix(*some([0, 1, 3, 4, 5, 6, 7]))
    np.testing.assert_array_equal(fix.position_e, without.position_e)
    np.testing.assert_allclose(fix.position_e, R, rtol=0, atol=1e-5)
    arrays[0][3:7] = np.nan
    with pytest.raises(ValueError, match="at least 4 satellites, got 3"):
        least_squares_fix(*arrays)


def test_the_fix_is_that_of_least_squares_four_suffice_and_the_guess_does_not_matter():
    noisy = np.array(measured()[:2]) + np.random.default_rng(0).normal(0.0, [[5.0], [0.1]], (2, 8))
    fix = least_squares_fix(*noisy, S, SV)
    own = fix.position_e, fix.velocity_e
    rho, rate, *u = np.transpose([range_and_rate(S[j], SV[j], *own) for j in range(8)])
    H = np.column_stack([-np.transpose(u), np.ones(8)])
    residual = noisy - [rho + fix.clock_bias_m, rate + fix.clock_drift_mps]
    assert np.abs(residual[0]).max() > 0.1
    np.testing.assert_allclose(residual @ H, 0.0, atol=1e-4)
    fix = least_squares_fix(*some(slice(4)))
    np.testing.assert_allclose(fix.position_e, R, rtol=0, atol=1e-4)
    far = least_squares_fix(*measured())
    for guess in (R, R + 1e5, -0.5 * R):
        near = least_squares_fix(*measured(), guess_e=guess)
        np.testing.assert_allclose(near.position_e, far.position_e, rtol=0, atol=1e-5)


CIRCLE = [[ORBIT * np.cos(a), ORBIT * np.sin(a), 0.0] for a in np.linspace(0.0, 6.0, 6)]


def in_space(satellites):
    return np.full(6, 2e7), np.zeros(6), satellites, np.zeros((6, 3))


ABSURD = np.random.default_rng(2).uniform(-1e9, 1e9, 8)


@pytest.mark.parametrize(
    ("arrays", "guess", "said"),
    [
        (lambda: some(slice(3)), {}, "a fix needs at least 4 satellites, got 3"),
        # all in one place, and in a plane with the centre of the Earth
        (lambda: in_space([CIRCLE[0]] * 6), {}, "is singular"),
        (lambda: in_space(CIRCLE), {}, "is singular"),
        (lambda: (ABSURD, *measured()[1:]), {}, r"is singular|no convergence"),
        (
            lambda: (measured()[0][1:], *measured()[1:]),
            {},
            r"got \(7,\), \(8,\), \(8, 3\) and \(8, 3\)",
        ),
        # too short a guess would be read beyond its end
        (measured, {"guess_e": (0.0, 0.0)}, "`guess_e` must be three finite numbers, got"),
        (measured, {"guess_e": (np.nan, 0.0, 0.0)}, "`guess_e` must be three finite numbers, got"),
    ],
)
def test_what_gives_no_fix_is_refused(arrays, guess, said):
    with pytest.raises(ValueError, match=said):
        least_squares_fix(*map(np.asarray, arrays()), **guess)


SKY = Lazily(partial(make_sky, 3, 1.0, 12, speed_mps=50.0), CircularConstellation(satellites=36))


def pseudoranges(noise_m, receivers, spoofed=(), displacement=(0.0, 0.0, 0.0, 0.0)):
    """(B, 12) pseudoranges at the first epoch, with a clock of 1000 m."""
    b = receivers
    rho, satellites = np.empty((b, 12)), np.empty((b, 12, 3))
    episode = np.zeros(b, dtype=np.int64), np.arange(2 * b, dtype=np.uint64).reshape(b, 2)
    each = [1000.0, 5.0], np.array(displacement, dtype=float), np.isin(np.arange(12), spoofed)
    clock_and_attack = [np.tile(value, (b, 1)) for value in each]
    sky = SKY.time, SKY.position_e, SKY.C_en, SKY.satellite_position_e
    noise = noise_m, np.empty(pad_count(12))
    measure_snapshot(*episode, *clock_and_attack, *sky, *noise, rho, satellites)
    return rho, satellites


def test_noise_is_white_and_innovations_belong_to_their_belief():
    clean, _ = pseudoranges(0.0, 2000)
    noise = pseudoranges(4.0, 2000)[0] - clean
    assert noise.std() == pytest.approx(4.0, rel=0.02)
    assert np.abs(np.corrcoef(noise.T) - np.eye(12)).max() < 0.1
    rho, satellites = pseudoranges(4.0, 1)

    def expected(position, clock):
        z, S, G = np.empty((1, 24)), np.empty((1, 24, 24)), np.empty((1, 24, 4))
        expect(rho, satellites, position[None], np.array([[clock]]), 16.0, z, S, G)
        return z[0], S[0], G[0]

    z, S, G = expected(SKY.position_e[0].copy(), 1000.0)
    for axis in range(4):
        step = 1.0 * (np.arange(4) == axis)
        other, _, _ = expected(SKY.position_e[0] + step[:3], 1000.0 + step[3])
        np.testing.assert_allclose((z - other)[:12], G[:12, axis], atol=1e-5)
    want = G @ np.diag([1e6, 1e6, 1e6, 1e8]) @ G.T + np.diag(np.repeat([16.0, 1.0], 12))
    np.testing.assert_allclose(S, want, rtol=1e-12, atol=1e-6)
    assert not z[12:].any()


@pytest.mark.parametrize("displacement", [np.zeros(4), np.array([300.0, -200.0, 50.0, 40.0])])
def test_all_spoofed_by_one_position_give_that_position(displacement):
    (rho,), (satellites,) = pseudoranges(0.0, 1, range(12), displacement)
    known = satellites, np.zeros((12, 3))
    fix = least_squares_fix(rho, np.zeros(12), *known, guess_e=np.zeros(3))
    moved = SKY.C_en.T @ (fix.position_e - SKY.position_e[0])
    np.testing.assert_allclose(moved, displacement[:3], atol=1e-4)
    assert fix.clock_bias_m == pytest.approx(1000.0 + displacement[3], abs=1e-4)


def test_weights_leave_satellites_out_and_without_a_fix_the_last_one_stays():
    rho, satellites = pseudoranges(4.0, 3, [2], [0.0, 0.0, 0.0, 900.0])
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
