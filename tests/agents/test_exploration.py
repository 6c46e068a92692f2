"""The exploration's standard deviation over a training."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from agents.exploration import Exploration


class Log(BaseCallback):
    """Standard deviation by which every rollout explores."""

    def __init__(self):
        super().__init__()
        self.seen = []

    def _on_step(self):
        if self.num_timesteps % 64 == 1:
            self.seen.append(math.log(float(self.model.policy.log_std.detach().exp()[0])))
        return True


def test_it_falls_linearly_and_goes_on_where_a_training_goes_on():
    model, log = PPO("MlpPolicy", "Pendulum-v1", n_steps=64, batch_size=64, device="cpu"), Log()
    for steps in (128, 128, 128):
        noise = Exploration(-1.0, -3.0, 256)
        model.learn(steps, callback=[noise, log], reset_num_timesteps=False)
    assert log.seen == pytest.approx([-1.0, -1.5, -2.0, -2.5, -3.0, -3.0], abs=1e-5)
