"""One step of commanded offsets against its definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.attacks._kernels import kinematic_step

SCALE, LIMIT = 0.7, 1.0


def plain(action, hold, tau, vector, by_rate, displacement, rate):
    if hold:
        return displacement + tau * rate, rate
    size = np.linalg.norm(action)
    u = action / size if vector and size > 1.0 else np.clip(action, -1.0, 1.0)
    if by_rate:
        new = SCALE * u
        return displacement + new * tau, new
    new = rate + SCALE * u * tau
    size = np.linalg.norm(new)
    if not vector:
        new = np.clip(new, -LIMIT, LIMIT)
    elif size > LIMIT:
        new = new * (LIMIT / size)
    return displacement + 0.5 * (rate + new) * tau, new


@pytest.mark.nojit
@pytest.mark.parametrize("hold", [False, True])
@given(
    st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=4),
    st.booleans(),
    st.booleans(),
    st.floats(0.01, 2.0),
    st.integers(0, 1000),
)
def test_a_step_is_that_of_its_definition(hold, action, vector, by_rate, tau, seed):
    rng, action = np.random.default_rng(seed), np.array(action)
    at = rng.normal(0.0, 10.0, len(action)), rng.normal(0.0, 0.5, len(action))
    want = plain(action, hold, tau, vector, by_rate, *at)
    kinematic_step(action, hold, tau, vector, by_rate, SCALE, LIMIT, *at)
    np.testing.assert_allclose(at, want, rtol=1e-12, atol=1e-12)
