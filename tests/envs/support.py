"""Short episodes for tests: the physics is that of the long ones."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.envs import SpoofVectorEnv

ID = "spoofgym/TightlyCoupled-v0"
SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 5.0}


def single(**kwargs: Any) -> gym.Env:
    return gym.make(ID, **{"timeline": SHORT, **kwargs})


def vector(num_envs: int, **kwargs: Any) -> SpoofVectorEnv:
    return SpoofVectorEnv(num_envs, **{"timeline": SHORT, **kwargs})


class Squeezed(gym.Env):
    """A vector environment of one, seen as a single one."""

    def __init__(self, **kwargs: Any) -> None:
        self.env = vector(1, autoreset_mode="next_step", **kwargs)
        self.observation_space = self.env.single_observation_space
        self.action_space = self.env.single_action_space
        self.render_mode = None

    @staticmethod
    def _plain(info: dict[str, Any]) -> dict[str, Any]:
        return {name: info[name].item() for name in info if not name.startswith("_")}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        observation, info = self.env.reset(seed=seed)
        return observation[0], self._plain(info)

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(np.asarray(action)[None])
        return (
            observation[0],
            float(reward[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            self._plain(info),
        )
