"""The duel as PettingZoo environments: AEC, the exact order, and parallel, one epoch late."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo import AECEnv, ParallelEnv

from ..core.registry import check_keywords
from ..envs import options as opt
from .duel import SETTINGS, DuelStep, make_duel, refuse_to_draw

Observation = NDArray[np.float32]
SPOOFER, DETECTOR = "spoofer_0", "detector_0"
AGENTS = (SPOOFER, DETECTOR)
FORMS = ("env", "parallel_env")  # forms of the duel, by their `decision_delay`
SEEN = ("time_s", "alarm", "statistic", "threshold", "decision_delay")
"""Information of a step that the detector gets: nothing that it can't see itself."""


class _Form:
    """One duel of one receiver, as both forms need it: agents, spaces, seeds, information."""

    def _make(self, decision_delay: int, render_mode: None, settings: dict[str, Any]) -> None:
        form = f"duel_v0.{FORMS[decision_delay]}"
        refuse_to_draw(form, render_mode)
        if "decision_delay" in settings:
            raise TypeError(
                f"{form} takes no `decision_delay`: it is 0 in duel_v0.env and 1 in "
                "duel_v0.parallel_env, which are two games"
            )
        valid = [name for name in SETTINGS if name != "decision_delay"]
        check_keywords(form, settings, [*valid, "render_mode"])
        self.duel = make_duel(1, decision_delay=decision_delay, threads=1, **settings)
        core, agent = self.duel.core, self.duel.agent
        self.action_names = {SPOOFER: core.action_names, DETECTOR: agent.action_names}
        self.observation_names = {SPOOFER: core.observation_names, DETECTOR: agent.observer.names}
        self.observation_spaces: dict[str, spaces.Space[Any]] = {
            SPOOFER: opt.observation_space(core),
            DETECTOR: spaces.Box(agent.observer.low, agent.observer.high, dtype=np.float32),
        }
        self.action_spaces: dict[str, spaces.Space[Any]] = {
            SPOOFER: opt.action_space(core),
            DETECTOR: spaces.Box(-1.0, 1.0, (len(agent.action_names),), dtype=np.float32),
        }
        self.render_mode = None
        self.possible_agents, self.agents = list(AGENTS), list[str]()
        self._rng: np.random.Generator | None = None
        self._halfway = False

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        return self.action_spaces[agent]

    def close(self) -> None:
        self.duel.close()

    @property
    def decides(self) -> bool:
        return bool(self.duel.deciding[0])

    def _start_episode(self, seed: int | None, options: dict[str, Any] | None) -> None:
        with opt.whole_reset(self):
            opt.warn_unknown(options, ("domain",))
            given = opt.domain_option(options)
            seed = opt.checked_seed(seed)
            if seed is not None or self._rng is None:
                self._rng = seeding.np_random(seed)[0]
            self.duel.reset([self._rng], given=given)
        self.agents = list(AGENTS)

    def _check_running(self) -> None:
        if self._halfway:
            raise RuntimeError(opt.HALFWAY)
        if not self.agents:
            raise RuntimeError("the episode is over: call reset() before step()")

    def _check_action(self, agent: str, action: Any) -> NDArray[np.float64]:
        names = self.action_names[agent]
        try:
            return opt.checked_action(action, (len(names),), names)[None]
        except (TypeError, ValueError) as error:
            raise ValueError(f"{agent}: {error}") from error

    def _observe(self) -> dict[str, Observation]:
        spoofer = self.duel.core.observer.observe(self.duel.snapshot())
        return {SPOOFER: spoofer[0], DETECTOR: self.duel.observe_detector()[0]}

    def _due(self) -> dict[str, bool]:
        """Whether the spoofer's next action is a decision, where it acts without one, too."""
        late, idle = self.duel.decision_delay == 1, self.duel.within or self.duel.setup.repeat > 1
        return {"decides": self.decides} if late and idle else {}

    def _reset_infos(self) -> dict[str, dict[str, Any]]:
        """Information of a reset; nature's choice is hidden from the detector."""
        both = {"time_s": self.duel.time_s()[0].item(), "decision_delay": self.duel.decision_delay}
        own = {**both, "attacked": bool(self.duel.attacked[0]), **self._due()}
        return {SPOOFER: own, DETECTOR: both}

    def _step_infos(self, turn: DuelStep) -> dict[str, dict[str, Any]]:
        all_: dict[str, Any] = {name: array.item() for name, array in turn.info.items()}
        all_["decision_delay"] = self.duel.decision_delay
        return {SPOOFER: {**all_, **self._due()}, DETECTOR: {name: all_[name] for name in SEEN}}


def _rewards(turn: DuelStep) -> dict[str, float]:
    return {SPOOFER: float(turn.spoofer_reward[0]), DETECTOR: float(turn.detector_reward[0])}


class DuelAEC(_Form, AECEnv[str, Observation, Observation]):
    """Spoofer moves, measurements arrive, detector decides on them, filter updates.

    Where the spoofer decides every n-th epoch only, the detector has n turns between two of its.
    `settings` are those of `duel_v0.env`.
    """

    def __init__(self, *, render_mode: None = None, **settings: Any) -> None:
        super().__init__()
        self._make(0, render_mode, settings)
        self.metadata = {
            "name": "duel_v0",
            "render_modes": [],
            "is_parallelizable": False,
            "decision_delay": 0,
        }

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> None:
        self._start_episode(seed, options)
        self.agent_selection = SPOOFER
        self._skip_agent_selection = None
        self.rewards = dict.fromkeys(AGENTS, 0.0)
        self._cumulative_rewards = dict.fromkeys(AGENTS, 0.0)
        self.terminations = dict.fromkeys(AGENTS, False)
        self.truncations = dict.fromkeys(AGENTS, False)
        self.infos = self._reset_infos()
        self._observations = self._observe()
        if not self.decides:
            self._arrive(None)

    def observe(self, agent: str) -> Observation:
        """What an agent observes: the spoofer the game before its move, the detector the epoch.
        Returns (o,) float32, a new array."""
        return self._observations[agent].copy()

    def step(self, action: Any) -> None:
        """Act for the agent whose turn it is. `action` (a,) in [-1, 1]; None for an agent whose
        episode is over."""
        self._check_running()
        agent = self.agent_selection
        if self.terminations[agent]:
            self._was_dead_step(action)
            return
        given = self._check_action(agent, action)
        self._halfway = True
        self._cumulative_rewards[agent] = 0.0
        self._clear_rewards()
        if agent == SPOOFER:
            self._arrive(given)
        else:
            self._decide(given)
            self.agent_selection = SPOOFER
            if not (self.terminations[SPOOFER] or self.decides):
                self._arrive(None)
        self._accumulate_rewards()
        self._halfway = False

    def _arrive(self, given: NDArray[np.float64] | None) -> None:
        self.duel.arrive(given)
        self._observations[DETECTOR] = self.duel.observe_detector()[0]
        self.agent_selection = DETECTOR

    def _decide(self, given: NDArray[np.float64]) -> None:
        turn = self.duel.decide(given)
        self.rewards = _rewards(turn)
        self.terminations = dict.fromkeys(AGENTS, bool(turn.terminated[0]))
        self.infos = self._step_infos(turn)
        self._observations = self._observe()


class DuelParallel(_Form, ParallelEnv[str, Observation, Observation]):
    """Both act at once: the detector's decision on the last epoch is applied to the next one.

    A step is an epoch.  Where the spoofer decides every n-th epoch only, its actions in between
    have no effect: ``infos["spoofer_0"]["decides"]`` says whether its next one has.  `settings` are
    those of `duel_v0.parallel_env`.
    """

    def __init__(self, *, render_mode: None = None, **settings: Any) -> None:
        self._make(1, render_mode, settings)
        self.metadata = {"name": "duel_v0", "render_modes": [], "decision_delay": 1}

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        self._start_episode(seed, options)
        return self._observe(), self._reset_infos()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Act for both agents, and run one epoch. `actions` (a,) in [-1, 1] by agent."""
        self._check_running()
        if set(actions) != set(AGENTS):
            raise ValueError(
                f"`actions` must be of {' and '.join(AGENTS)}, got those of "
                f"{', '.join(map(str, actions)) or 'none'}"
            )
        given = {agent: self._check_action(agent, actions[agent]) for agent in AGENTS}
        self._halfway = True
        self.duel.arrive(given[SPOOFER])
        turn = self.duel.decide(given[DETECTOR])
        self._halfway = False
        over = bool(turn.terminated[0])
        if over:
            self.agents = []
        ends = dict.fromkeys(AGENTS, over), dict.fromkeys(AGENTS, False)
        return self._observe(), _rewards(turn), *ends, self._step_infos(turn)
