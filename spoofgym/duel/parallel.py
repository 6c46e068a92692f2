"""The duel as a PettingZoo parallel environment: the decision is applied one epoch late."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from ..envs.options import HALFWAY, whole_reset
from .rules import AGENTS, DETECTOR, SPOOFER, Rules

Observation = NDArray[np.float32]


class DuelParallel(ParallelEnv[str, Observation, Observation]):
    """Both act at once: the detector's decision on the last epoch is applied to the next one.

    A step is an epoch.  Where the spoofer decides every n-th epoch only, its actions in between are
    not looked at: ``infos["spoofer_0"]["decides"]`` says whether its next one is.

    Parameters
    ----------
    **settings
        As in `duel_v0.parallel_env`.

    Attributes
    ----------
    rules : Rules
        Duel, spaces and names.
    """

    def __init__(self, **settings: Any) -> None:
        self.rules = Rules(1, **settings)
        self.metadata = {"name": "duel_v0", "render_modes": [], "decision_delay": 1}
        self.render_mode = None
        self.possible_agents: list[str] = list(AGENTS)
        self.agents: list[str] = []
        self._halfway = False
        self.observation_spaces = self.rules.observation_spaces
        self.action_spaces = self.rules.action_spaces

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        return self.rules.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        return self.rules.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        with whole_reset(self):
            self.rules.begin(seed, options)
        self.agents = list(AGENTS)
        return self.rules.observe(), self.rules.reset_infos()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Act for both agents, and run one epoch. `actions` (a,) in [-1, 1] by agent, in any
        order."""
        if self._halfway:
            raise RuntimeError(HALFWAY)
        if not self.agents:
            raise RuntimeError("the episode is over: call reset() before step()")
        if set(actions) != set(AGENTS):
            raise ValueError(
                f"`actions` must be of {' and '.join(AGENTS)}, got those of "
                f"{', '.join(map(str, actions)) or 'nobody'}"
            )
        given = {agent: self.rules.checked(agent, actions[agent]) for agent in AGENTS}
        self._halfway = True
        self.rules.duel.arrive(given[SPOOFER])
        turn = self.rules.duel.decide(given[DETECTOR])
        self._halfway = False
        over = bool(turn.terminated[0])
        if over:
            self.agents = []
        rewards = {
            SPOOFER: float(turn.spoofer_reward[0]),
            DETECTOR: float(turn.detector_reward[0]),
        }
        return (
            self.rules.observe(),
            rewards,
            dict.fromkeys(AGENTS, over),
            dict.fromkeys(AGENTS, False),
            self.rules.infos(turn),
        )

    def close(self) -> None:
        self.rules.duel.close()
