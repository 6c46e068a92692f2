"""Short duels, and detectors to play them with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from spoofgym import duel_v0
from spoofgym.detectors import DetectorContext, Verdict
from spoofgym.detectors.charts import Ewma

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 2.0}
ONE_SKY = {"turn_on": "drawn"}
PAPERS = {"scenario": "zhong2025", "domain": None}
"""The world of the papers, in which a receiver assumes the same however long an episode is."""
BRIEF = {"timeline": SHORT, "domain": ONE_SKY}
"""Short, and in the default world with one sky, which is made faster than with all of them."""
SATELLITES = 12
QUIET = np.r_[-1.0, np.ones(SATELLITES)]
"""Statistic 0, all weights 1."""
ALARM = np.ones(1 + SATELLITES)


def aec(**kwargs: Any) -> Any:
    return duel_v0.env(**{**BRIEF, "action": "full-command", **kwargs})


def parallel(**kwargs: Any) -> Any:
    return duel_v0.parallel_env(**{**BRIEF, "action": "full-command", **kwargs})


def as_action(verdict: Verdict) -> np.ndarray:
    """Action of an agent that says what a detector of one receiver says."""
    alarm = 1.0 if verdict.alarm.any() else -1.0
    return np.r_[alarm, 2.0 * verdict.weights[0, :SATELLITES] - 1.0]


@dataclass
class PerSatellite(Ewma):
    """EWMA with weights as an agent can give them: the same for range and rate, rounded alike."""

    def judge(self, epoch):
        verdict = super().judge(epoch)
        weight = verdict.weights[:, : epoch.visible.shape[1]]
        rounded = 0.5 * ((2.0 * weight - 1.0) + 1.0)
        return verdict._replace(weights=np.concatenate([rounded, rounded], axis=1))


@dataclass
class Late(PerSatellite):
    """The same, one epoch late."""

    def bind(self, context):
        super().bind(context)
        b, n = context.receivers, context.channels
        self.memory.declare("weights", np.ones((b, 2 * n)))
        self.memory.declare("alarm", np.zeros((b, n), dtype=np.bool_))

    def judge(self, epoch):
        verdict = super().judge(epoch)
        late = verdict._replace(weights=self.memory["weights"], alarm=self.memory["alarm"])
        self.memory["weights"], self.memory["alarm"] = verdict.weights, verdict.alarm
        return late


def bound(detector, duel, receivers: int = 1):
    """Detector for the receivers of a duel."""
    setup = duel.setup
    detector.bind(
        DetectorContext(
            receivers,
            setup.world.channels,
            setup.interval_s,
            setup.combinations[0].noise_variance,
            setup.world.satellite_ids,
        )
    )
    return detector


def wary(observation: np.ndarray) -> np.ndarray:
    """Policy of the largest average innovation, which trusts satellites with small ones."""
    average = np.abs(observation[:, 24 : 24 + SATELLITES].astype(np.float64))
    statistic = average.max(axis=1, keepdims=True) / 15.0 - 1.0
    return np.clip(np.hstack([statistic, 1.5 - average]), -1.0, 1.0)
