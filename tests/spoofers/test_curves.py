"""Curves of the elements of an action."""

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.envs import attach
from spoofgym.spoofers import make_spoofer

OFFSETS = {
    "timeline": {"warmup_s": 40.0, "live_s": 20.0, "attack_s": 30.0, "time_to_alert_s": 5.0},
    "detector": "never",
    **{"control": "rate", "basis": "position+clock"},
    **{"decision_interval_s": 10.0, "between": "linear"},
}


def test_elements_follow_their_curves_and_the_others_stay_0():
    env = gym.make("spoofgym/Zhong2025-v0", **OFFSETS)
    curves = [[0.0, 0.3], [0.3, 0.0]]
    spoofer, played = attach({"name": "action-curves", "curves": curves, "amplitude": 2.0}, env), []
    observation, _ = env.reset(seed=1)
    for _ in range(3):
        played.append(spoofer.act(observation[None])[0])
        observation = env.step(played[-1])[0]
    expected = [[0.2, 0.4, 0, 0], [0.4, 0.2, 0, 0], [0.6, 0.0, 0, 0]]
    np.testing.assert_allclose(played, expected, atol=1e-12)
    env.close()


def test_curves_that_do_not_fit_are_refused():
    for curves in ([[0.0, 1.0], [1.0]], [[1.0]], [[0.0, float("nan")]], []):
        with pytest.raises(ValueError, match="curves"):
            make_spoofer({"name": "action-curves", "curves": curves})
    env = gym.make("spoofgym/Zhong2025-v0", **OFFSETS)
    with pytest.raises(ValueError, match=r"5 rows.*4 elements"):
        attach({"name": "action-curves", "curves": [[0.0, 1.0]] * 5}, env)
    env.close()
