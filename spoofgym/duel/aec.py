"""The duel as a PettingZoo AEC environment: the exact order."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import AECEnv

from ..envs.options import HALFWAY, whole_reset
from .rules import AGENTS, DETECTOR, SPOOFER, Rules


class DuelAEC(AECEnv[str, NDArray[np.float32], NDArray[np.float32]]):
    """Spoofer moves, measurements arrive, detector decides on them, filter updates.

    Where the spoofer decides every n-th epoch only, the detector has n turns between two of its.

    Parameters
    ----------
    **settings
        As in `duel_v0.env`.

    Attributes
    ----------
    rules : Rules
        Duel, spaces and names.
    """

    def __init__(self, **settings: Any) -> None:
        super().__init__()
        self.rules = Rules(0, **settings)
        self.metadata = {
            "name": "duel_v0",
            "render_modes": [],
            "is_parallelizable": False,
            "decision_delay": 0,
        }
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

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        with whole_reset(self):
            self.rules.begin(seed, options)
        self.agents = list(AGENTS)
        self.agent_selection = SPOOFER
        self._skip_agent_selection = None
        self.rewards = dict.fromkeys(AGENTS, 0.0)
        self._cumulative_rewards = dict.fromkeys(AGENTS, 0.0)
        self.terminations = dict.fromkeys(AGENTS, False)
        self.truncations = dict.fromkeys(AGENTS, False)
        self.infos = self.rules.reset_infos()
        self._observations = self.rules.observe()

    def observe(self, agent: str) -> NDArray[np.float32]:
        """What an agent observes: the spoofer the game before its move, the detector the epoch.
        Returns (o,) float32, a new array."""
        return self._observations[agent].copy()

    def step(self, action: Any) -> None:
        """Act for the agent whose turn it is. `action` (a,) in [-1, 1]; None for an agent whose
        episode is over."""
        if self._halfway:
            raise RuntimeError(HALFWAY)
        if not self.agents:
            raise RuntimeError("the episode is over: call reset() before step()")
        agent = self.agent_selection
        if self.terminations[agent]:
            self._was_dead_step(action)
            return
        given = self.rules.checked(agent, action)
        self._halfway = True
        self._cumulative_rewards[agent] = 0.0
        self._clear_rewards()
        if agent == SPOOFER:
            self._arrive(given)
        else:
            self._decide(given)
            self.agent_selection = SPOOFER
            if not (self.terminations[SPOOFER] or self.rules.decides):
                self._arrive(None)
        self._accumulate_rewards()
        self._halfway = False

    def _arrive(self, given: NDArray[np.float64] | None) -> None:
        self.rules.duel.arrive(given)
        self._observations[DETECTOR] = self.rules.duel.observe_detector()[0]
        self.agent_selection = DETECTOR

    def _decide(self, given: NDArray[np.float64]) -> None:
        turn = self.rules.duel.decide(given)
        self.rewards = {
            SPOOFER: float(turn.spoofer_reward[0]),
            DETECTOR: float(turn.detector_reward[0]),
        }
        self.terminations = dict.fromkeys(AGENTS, bool(turn.terminated[0]))
        self.infos = self.rules.infos(turn)
        self._observations = self.rules.observe()

    def close(self) -> None:
        self.rules.duel.close()
