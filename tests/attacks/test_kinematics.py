"""Commanded offsets: closed forms, limits, and a plain definition of one step."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.attacks._kernels import kinematic_step

pytestmark = pytest.mark.nojit
ACTIONS = st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=4)


def step(action, hold=False, tau=0.5, vector=False, by_rate=False, scale=0.05, limit=5.0, at=None):
    displacement, rate = at if at is not None else (np.zeros(len(action)), np.zeros(len(action)))
    kinematic_step(
        np.array(action, dtype=float), hold, tau, vector, by_rate, scale, limit, displacement, rate
    )
    return displacement, rate


def plain(action, tau, vector, by_rate, scale, limit, displacement, rate):
    """The same by whole vectors."""
    action = np.array(action, dtype=float)
    size = np.linalg.norm(action)
    u = action / size if vector and size > 1.0 else np.clip(action, -1.0, 1.0)
    if by_rate:
        new = scale * u
        return displacement + new * tau, new
    new = rate + scale * u * tau
    size = np.linalg.norm(new)
    if not vector:
        new = np.clip(new, -limit, limit)
    elif size > limit:
        new = new * (limit / size)
    return displacement + 0.5 * (rate + new) * tau, new


@given(ACTIONS, st.booleans(), st.booleans(), st.floats(0.01, 2.0), st.integers(0, 1000))
def test_a_step_is_that_of_its_definition(action, vector, by_rate, tau, seed):
    rng = np.random.default_rng(seed)
    at = rng.normal(0.0, 10.0, len(action)), rng.normal(0.0, 0.5, len(action))
    want = plain(action, tau, vector, by_rate, 0.7, 1.0, *at)
    got = step(action, False, tau, vector, by_rate, 0.7, 1.0, (at[0].copy(), at[1].copy()))
    np.testing.assert_allclose(got[0], want[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(got[1], want[1], rtol=1e-12, atol=1e-12)


def test_constant_acceleration_is_a_parabola_until_the_limit():
    at = (np.zeros(1), np.zeros(1))
    for k in range(1, 401):
        step([1.0], at=at)
        t = 0.5 * k
        if t <= 100.0:
            assert at[0][0] == pytest.approx(0.5 * 0.05 * t**2, rel=1e-12)
            assert at[1][0] == pytest.approx(0.05 * t, rel=1e-12)
    # 100 s to the limit of 5 m/s, then straight on
    assert at[1][0] == 5.0
    assert at[0][0] == pytest.approx(250.0 + 5.0 * 100.0, rel=1e-12)


@given(ACTIONS, st.integers(0, 1000))
def test_a_hold_keeps_the_rate(action, seed):
    rng = np.random.default_rng(seed)
    at = rng.normal(0.0, 10.0, len(action)), rng.normal(0.0, 0.5, len(action))
    before = at[0].copy(), at[1].copy()
    step(action, hold=True, at=at)
    np.testing.assert_array_equal(at[1], before[1])
    np.testing.assert_allclose(at[0], before[0] + 0.5 * before[1], rtol=1e-13, atol=1e-13)


@given(st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=3), st.integers(0, 1000))
def test_a_vector_keeps_within_both_limits(action, seed):
    """Shortening to the limit of the rate never takes more than the limit of acceleration."""
    rng = np.random.default_rng(seed)
    at = np.zeros(len(action)), np.zeros(len(action))
    for _ in range(30):
        before = at[1].copy()
        step(np.array(action) * rng.uniform(-2.0, 2.0), vector=True, scale=1.0, limit=1.5, at=at)
        assert np.linalg.norm(at[1]) <= 1.5 * (1.0 + 1e-12)
        assert np.linalg.norm(at[1] - before) <= 1.0 * 0.5 * (1.0 + 1e-12)


def test_a_vector_is_shortened_and_not_bent():
    displacement, rate = step([3.0, 4.0], vector=True, by_rate=True, scale=2.0)
    np.testing.assert_allclose(rate, [1.2, 1.6], rtol=1e-15)
    np.testing.assert_allclose(displacement, [0.6, 0.8], rtol=1e-15)
    _, rate = step([3.0, 0.5], by_rate=True, scale=2.0)  # each for itself
    np.testing.assert_allclose(rate, [2.0, 1.0], rtol=1e-15)


@pytest.mark.parametrize("vector", [True, False])
@pytest.mark.parametrize("by_rate", [True, False])
def test_no_command_from_rest_is_no_offset(vector, by_rate):
    displacement, rate = step([0.0, 0.0], vector=vector, by_rate=by_rate)
    np.testing.assert_array_equal(displacement, 0.0)
    np.testing.assert_array_equal(rate, 0.0)
