"""The price of an alarm, which follows the budget."""

import numpy as np
import pytest

from agents.learning import LEAST, MOST, next_price, set_price
from spoofgym.sb3 import SpoofVecEnv

SHORT = {"warmup_s": 8, "live_s": 5, "attack_s": 10, "time_to_alert_s": 2}
WORLD = {"timeline": SHORT, "detector": "never", "seed": 0, "threads": 1}


@pytest.mark.parametrize(
    ("price", "amplitude", "gain", "expected"),
    [
        (2.0, 1.0, 1.5, 2.0),
        (2.0, 0.81, 0.5, 2.0 / 0.9),
        (3.0, 0.1, 1.5, 6.0),
        (4.0, 10.0, 1.5, 2.0),
        (7.0, 0.1, 1.5, MOST),
        (1.5, 10.0, 1.5, LEAST),
        (4.0, 0.0, 1.5, MOST),
        (60.0, 0.1, 0.0, 60.0),
    ],
)
def test_it_rises_where_a_policy_had_to_be_scaled_down(price, amplitude, gain, expected):
    assert next_price(price, amplitude, gain) == pytest.approx(expected, rel=1e-12)


def test_it_is_in_lengths_of_the_environment_and_leaves_a_reward_of_ones_own_alone():
    envs = SpoofVecEnv(2, length_m=20.0, **WORLD)
    set_price(envs, 3.0)
    (found,) = (term for key, term in envs.core._reward_parts if "alarm" in key)
    assert found.penalty_m == 60.0
    envs.close()
    own = SpoofVecEnv(2, reward="displacement-gain", **WORLD)
    own.reset()
    before = list(own.core._reward_parts)
    set_price(own, 3.0)
    assert own.core._reward_parts == before
    assert np.isfinite(own.step(np.zeros((2, 1), np.float32))[1]).all()
    own.close()
