"""Short episodes for tests: the physics is that of the long ones.

All elements of the attack are commanded as they are, so that every victim takes the same actions.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

import spoofgym  # noqa: F401  (registers the ids)
from spoofgym.detectors import Detector, DetectorContext, Verdict
from spoofgym.envs import SpoofVectorEnv
from spoofgym.receiver.epoch import Epoch

ID = "spoofgym/Zhong2025-v0"
LIVE, STEPS, HOLD = 20, 30, 10
"""Epochs of the monitored warm-up, the commands and the time to alert of a short episode."""
VICTIMS = {"Zhong2025": 0.5, "LooselyCoupled": 0.1, "Snapshot": 1.0, "WheeledRobot": 1.0}
"""Every victim, and the interval of its epochs [s]."""
SMALL = tuple(kind for kind in VICTIMS if kind != "Zhong2025")


def timeline_of(kind: str) -> dict[str, float]:
    epochs = {"warmup_s": 2 * LIVE, "live_s": LIVE, "attack_s": STEPS, "time_to_alert_s": HOLD}
    return {name: round(count * VICTIMS[kind], 6) for name, count in epochs.items()}


SHORT = timeline_of("Zhong2025")


def settings_of(kind: str, **settings: Any) -> dict[str, Any]:
    """Settings of a short episode, with a detector that can alarm in it."""
    settings.setdefault("timeline", timeline_of(kind))
    settings.setdefault("action", "full-command")
    if kind == "LooselyCoupled":
        settings.setdefault("detector", {"name": "windowed-chi2", "window": 8})
    return settings


def victim(kind: str, **settings: Any) -> gym.Env:
    return gym.make(f"spoofgym/{kind}-v0", **settings_of(kind, **settings))


def victims(kind: str, num_envs: int, **settings: Any) -> Any:
    made = gym.make_vec(f"spoofgym/{kind}-v0", num_envs=num_envs, **settings_of(kind, **settings))
    return made.unwrapped


class AlarmAt(Detector):
    """Alarms once, a number of epochs after it was reset."""

    paper = "groves2013"
    scope = "receiver"
    measures = "any"

    def __init__(self, epoch: int) -> None:
        self.epoch = epoch

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        self.memory.declare("seen", np.zeros(context.receivers))

    def judge(self, epoch: Epoch) -> Verdict:
        self.memory["seen"] = self.memory["seen"] + 1.0
        alarm = (self.memory["seen"] == self.epoch)[:, None]
        return Verdict(alarm * 2.0, np.ones(alarm.shape), alarm)


def single(**kwargs: Any) -> gym.Env:
    return gym.make(ID, **{"timeline": SHORT, "action": "full-command", **kwargs})


def vector(num_envs: int, **kwargs: Any) -> SpoofVectorEnv:
    return SpoofVectorEnv(num_envs, **{"timeline": SHORT, "action": "full-command", **kwargs})


class LooksAtEpochs(gym.Wrapper):
    """A detector as an ordinary wrapper; what it makes of the epochs is its `look`."""

    def reset(self, **kwargs):
        observation, info = super().reset(**kwargs)
        return observation, info | self.look(info["epochs"])

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        info |= self.look(info["epochs"])
        return observation, reward, terminated or info["alarm"], truncated, info
