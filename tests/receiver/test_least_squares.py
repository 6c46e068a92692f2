"""The single-epoch fix: exact where it can be, refused where it cannot."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spoofgym.earth.wgs84 import geodetic_to_ecef, range_and_rate
from spoofgym.receiver import least_squares_fix
from spoofgym.truth.satellites import CircularConstellation

ORBIT = 2.656e7


def measure(r, v, clock, satellites, velocities):
    ranges = np.array(
        [range_and_rate(s, sv, r, v)[:2] for s, sv in zip(satellites, velocities, strict=True)]
    )
    return ranges[:, 0] + clock[0], ranges[:, 1] + clock[1]


def in_view(r, count=8):
    states = CircularConstellation(satellites=36).states([100.0])
    s, sv = states.position_e[0], states.velocity_e[0]
    highest = np.argsort(-((s - r) @ r) / np.linalg.norm(s - r, axis=1))[:count]
    return s[highest], sv[highest]


R = geodetic_to_ecef(0.8, 0.2, 5000.0)
V = np.array([-50.0, 180.0, 20.0])
S, SV = in_view(R)
RANGES, RATES = measure(R, V, (3e5, -70.0), S, SV)


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


def test_four_satellites_suffice_and_three_do_not():
    fix = least_squares_fix(RANGES[:4], RATES[:4], S[:4], SV[:4])
    np.testing.assert_allclose(fix.position_e, R, rtol=0, atol=1e-4)
    with pytest.raises(ValueError, match="a fix needs at least 4 satellites, got 3"):
        least_squares_fix(RANGES[:3], RATES[:3], S[:3], SV[:3])


@pytest.mark.parametrize("where", range(4))
def test_a_satellite_with_a_nan_anywhere_is_left_out(where):
    arrays = [RANGES.copy(), RATES.copy(), S.copy(), SV.copy()]
    arrays[where][2] = np.nan
    fix = least_squares_fix(*arrays)
    without = least_squares_fix(*(np.delete(a, 2, axis=0) for a in (RANGES, RATES, S, SV)))
    np.testing.assert_array_equal(fix.position_e, without.position_e)
    np.testing.assert_allclose(fix.position_e, R, rtol=0, atol=1e-5)
    arrays[0][3:7] = np.nan
    with pytest.raises(ValueError, match="at least 4 satellites, got 3"):
        least_squares_fix(*arrays)


def test_the_fix_is_that_of_least_squares():
    """With noise, the residuals are orthogonal to the geometry."""
    rng = np.random.default_rng(0)
    noisy = RANGES + rng.normal(0.0, 5.0, 8), RATES + rng.normal(0.0, 0.1, 8)
    fix = least_squares_fix(*noisy, S, SV)
    predicted, u = [], []
    for s, sv in zip(S, SV, strict=True):
        rho, rate, *sight = range_and_rate(s, sv, fix.position_e, fix.velocity_e)
        predicted.append((rho + fix.clock_bias_m, rate + fix.clock_drift_mps))
        u.append(sight)
    H = np.column_stack([-np.array(u), np.ones(8)])
    residual = np.array(noisy).T - predicted
    assert np.abs(residual[:, 0]).max() > 0.1
    np.testing.assert_allclose(H.T @ residual, 0.0, atol=1e-4)


def test_the_guess_does_not_matter():
    far = least_squares_fix(RANGES, RATES, S, SV)
    for guess in (R, R + 1e5, -0.5 * R):
        near = least_squares_fix(RANGES, RATES, S, SV, guess_e=guess)
        np.testing.assert_allclose(near.position_e, far.position_e, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    "satellites",
    [
        np.tile([ORBIT, 0.0, 0.0], (6, 1)),
        np.array([[ORBIT * np.cos(a), ORBIT * np.sin(a), 0.0] for a in np.linspace(0.0, 6.0, 6)]),
    ],
    ids=["one place", "a plane with the centre of the Earth"],
)
def test_a_singular_geometry_is_refused(satellites):
    with pytest.raises(ValueError, match="the geometry of the satellites is singular"):
        least_squares_fix(np.full(6, 2e7), np.zeros(6), satellites, np.zeros((6, 3)))


def test_nonsense_is_refused():
    rng = np.random.default_rng(2)
    for _ in range(5):
        with pytest.raises(ValueError, match=r"is singular|no convergence"):
            least_squares_fix(rng.uniform(-1e9, 1e9, 8), RATES, S, SV)
