"""Short duels, and detectors to play them with."""

from __future__ import annotations

from typing import Any

import numpy as np

from spoofgym import duel_v0
from spoofgym.tasks import get_task

SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 15.0, "time_to_alert_s": 2.0}
ONE_SKY = {"turn_on": "drawn"}
GAME = get_task("T3").world_kwargs
PAPERS = {"scenario": "zhong2025", "receiver": "paper", "domain": None}
"""The world of the papers, in which a receiver assumes the same however long an episode is."""
BRIEF = {**GAME, "timeline": SHORT, "domain": ONE_SKY}
"""Short, and in the world of T3 with one sky, which is made faster than with all of them."""
SATELLITES = 12
QUIET = np.r_[-1.0, np.ones(SATELLITES)]
"""Statistic 0, all weights 1."""
ALARM = np.ones(1 + SATELLITES)


def aec(**kwargs: Any) -> Any:
    return duel_v0.env(**{**BRIEF, "action": "full-command", **kwargs})


def parallel(**kwargs: Any) -> Any:
    return duel_v0.parallel_env(**{**BRIEF, "action": "full-command", **kwargs})


def wary(observation: np.ndarray) -> np.ndarray:
    average = np.abs(observation[:, 24 : 24 + SATELLITES].astype(np.float64))
    statistic = average.max(axis=1, keepdims=True) / 15.0 - 1.0
    return np.clip(np.hstack([statistic, 1.5 - average]), -1.0, 1.0)


def aec_epochs(duel, seed, push_of, decide):
    """Whose turns there were, displacements by epoch, and rewards of the spoofer at its turns."""
    turns, own, paid, last = [], [], [], {}
    duel.reset(seed=seed)
    for name in duel.agent_iter():
        observation, reward, over, _, _ = duel.last()
        if name == "spoofer_0":
            paid.append(reward)
        if over:
            duel.step(None)
            continue
        turns.append(name)
        if name == "spoofer_0":
            duel.step(push_of(len(own)))
        else:
            duel.step(decide(len(own), observation))
            last = duel.infos["spoofer_0"]
            own.append(last["displacement_m"])
    return turns, np.array(own), np.array(paid[1:]), last


def parallel_epochs(duel, seed, push_of, decide):
    """Whether the spoofer decides, displacements by epoch, and what it is told at the end."""
    own, due = [], []
    observations, infos = duel.reset(seed=seed)
    while duel.agents:
        due.append(infos["spoofer_0"].get("decides"))
        decision = decide(len(own), observations["detector_0"])
        actions = {"spoofer_0": push_of(len(own)), "detector_0": decision}
        observations, *_, infos = duel.step(actions)
        own.append(infos["spoofer_0"]["displacement_m"])
    return due, np.array(own), None, infos["spoofer_0"]


FORMS = (aec, aec_epochs), (parallel, parallel_epochs)
"""Without and with a delay."""
