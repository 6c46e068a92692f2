"""The vector environment: the same game for B receivers in step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from .._registry import check_choice
from ..attacks import Attack
from ..detectors import Detector
from ..receiver import TightlyCoupled
from ..sim.scenario import Scenario
from .observations import ObservationTerm
from .presets import DEFAULT_ATTACK, make_game, make_setup
from .rewards import RewardTerm
from .setup import Timeline
from .spaces import action_space, checked_action, observation_space

AUTORESET_MODES = {
    "next_step": AutoresetMode.NEXT_STEP,
    "same_step": AutoresetMode.SAME_STEP,
}
Array = NDArray[Any]


class SpoofVectorEnv(VectorEnv[Array, Array, Array]):
    """Vector environment of `SpoofEnv`; receiver i is the single one seeded with ``seed + i``.

    Parameters
    ----------
    num_envs : int
        Receivers, at least 1.
    autoreset_mode : {"next_step", "same_step"} or AutoresetMode
        When a finished receiver begins its next episode.
    threads : int, optional
        Threads of the engine; as many as processors by default.
    prefetch : bool
        Whether one more thread warms up every receiver's next episode while the present one runs,
        also with ``threads=1``.  The bits are the same, unless those of the detector depend on the
        size of the batch: such a one cannot be reproduced with it; see `Engine`.
    scenario, detector, attack, receiver, timeline, knowledge, observation, reward
        As in `SpoofEnv`.
    alarm_penalty_m, end_at_alarm, target_heading_deg, render_mode
        As in `SpoofEnv`.

    Attributes
    ----------
    observation_names, action_names : tuple of str
        Name of every element.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> envs = gym.make_vec("spoofgym/TightlyCoupled-v0", num_envs=4, detector="never")
    >>> envs.single_action_space
    Box(-1.0, 1.0, (2,), float32)
    >>> envs.close()
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  (declared so by Gymnasium)
        "render_modes": [],
        "render_fps": 2,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        prefetch: bool = True,
        scenario: str | Mapping[str, Any] | Scenario = "zhong2025",
        detector: str | Mapping[str, Any] | Detector | None = None,
        attack: str | Mapping[str, Any] | Attack = DEFAULT_ATTACK,
        receiver: Mapping[str, Any] | TightlyCoupled | None = None,
        timeline: Mapping[str, float] | Timeline | None = None,
        knowledge: str = "tracking",
        observation: Sequence[ObservationTerm] | None = None,
        reward: Sequence[RewardTerm] | None = None,
        alarm_penalty_m: float = 10.0,
        end_at_alarm: bool = True,
        target_heading_deg: float = 90.0,
        render_mode: None = None,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"`num_envs` must be at least 1, got {num_envs}")
        if render_mode is not None:
            raise ValueError(
                f"`render_mode` must be None, there is nothing to render; got {render_mode!r}"
            )
        if isinstance(autoreset_mode, str):
            word = autoreset_mode.lower().removeprefix("autoresetmode.")
            check_choice("autoreset mode", word, AUTORESET_MODES)
            autoreset_mode = AUTORESET_MODES[word]
        if autoreset_mode not in AUTORESET_MODES.values():
            raise ValueError(
                f"`autoreset_mode` must be one of {', '.join(AUTORESET_MODES)}, "
                f"got {autoreset_mode}"
            )
        self.autoreset_mode = autoreset_mode
        self.metadata = {**type(self).metadata, "autoreset_mode": autoreset_mode}
        self.num_envs, self.render_mode = num_envs, None
        setup = make_setup(
            scenario=scenario,
            receiver=receiver,
            attack=attack,
            detector=detector,
            timeline=timeline,
        )
        self.game = make_game(
            num_envs,
            setup,
            knowledge=knowledge,
            observation=observation,
            reward=reward,
            alarm_penalty_m=alarm_penalty_m,
            end_at_alarm=end_at_alarm,
            target_heading_deg=target_heading_deg,
            threads=threads,
            prefetch=prefetch,
        )
        self.observation_names = self.game.observer.names
        self.action_names = setup.attack.action_names(setup.world)
        self.single_observation_space = observation_space(self.game)
        self.single_action_space = action_space(self.game)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._rngs: list[np.random.Generator] = []
        self._over = np.ones(num_envs, dtype=np.bool_)
        self._all = np.ones(num_envs, dtype=np.bool_)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        """Begin an episode in every receiver.

        Parameters
        ----------
        seed : int or sequence of int, optional
            Receiver i is seeded with ``seed + i``, or with its element; without it the next
            episodes of the same streams begin.
        options : dict, optional
            Not used.

        Returns
        -------
        observation : ndarray
            (B, o) float32.
        info : dict
            Arrays, and masks of who has them.
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        if seed is None:
            seeds: list[int | None] = [None] * self.num_envs
        elif isinstance(seed, int | np.integer):
            seeds = [int(seed) + i for i in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ValueError(f"`seed` must have {self.num_envs} elements, got {len(seeds)}")
        if not self._rngs:
            self._rngs = [np.random.default_rng(s) for s in seeds]
        else:
            self._rngs = [
                rng if s is None else np.random.default_rng(s)
                for rng, s in zip(self._rngs, seeds, strict=True)
            ]
        self.game.reset(self._rngs)
        self._over[:] = False
        return self.game.observe(), self._masked(self.game.begin_info(), self._all)

    def _restart(self, mask: NDArray[np.bool_]) -> None:
        rows = np.flatnonzero(mask)
        self.game.reset([self._rngs[row] for row in rows], rows)
        self._over[rows] = False

    @staticmethod
    def _masked(info: dict[str, Array], mask: NDArray[np.bool_]) -> dict[str, Any]:
        """Arrays with the masks that tell which receivers have them."""
        result: dict[str, Any] = dict(info)
        masks = np.tile(mask, (len(info), 1))  # a row each, so that none is shared
        for name, row in zip(info, masks, strict=True):
            result[f"_{name}"] = row
        return result

    def step(self, actions: Any) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Give one command to every receiver, and run one epoch.

        Parameters
        ----------
        actions : array_like
            (B, a) in [-1, 1].

        Returns
        -------
        observation : ndarray
            (B, o) float32.
        reward : ndarray
            (B,) float64.
        terminated, truncated : ndarray
            (B,) bool.
        info : dict
            Arrays, and masks of who has them.
        """
        if not self._rngs:
            raise RuntimeError("call reset() before step()")
        shape = (self.num_envs, len(self.action_names))
        given = checked_action(actions, shape, self.action_names)
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:
            return self._next_step(given)
        return self._same_step(given)

    def _next_step(self, given: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        restarting = self._over.copy()
        if restarting.all():
            self._restart(restarting)
            zeros = np.zeros(self.num_envs)
            info = self._masked(self.game.begin_info(), self._all)
            return (
                self.game.observe(),
                zeros,
                np.zeros_like(restarting),
                np.zeros_like(restarting),
                info,
            )
        turn = self.game.step(given)
        reward, terminated, values = turn.reward, turn.terminated, turn.info
        if restarting.any():
            # these receivers ran one epoch more than their episode; it is thrown away
            self._restart(restarting)
            reward[restarting] = 0.0
            terminated[restarting] = False
            begin = self.game.begin_info()
            for name, array in values.items():
                array[restarting] = begin[name][restarting] if name in begin else 0
        self._over = terminated.copy()
        info = self._masked(values, ~restarting)
        for name in ("time_s", "warmup_alarm", "coasting"):
            info[f"_{name}"] = self._all.copy()
        return self.game.observe(), reward, terminated, np.zeros_like(terminated), info

    def _same_step(self, given: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        turn = self.game.step(given)
        terminated = turn.terminated
        observation = self.game.observe()
        if not terminated.any():
            info = self._masked(turn.info, self._all)
            return observation, turn.reward, terminated, np.zeros_like(terminated), info
        final = np.full(self.num_envs, None, dtype=object)
        for row in np.flatnonzero(terminated):
            final[row] = observation[row].copy()
        last = {name: np.where(terminated, array, 0) for name, array in turn.info.items()}
        self._restart(terminated)
        begin = self.game.begin_info()
        values = {
            name: np.where(terminated, begin.get(name, 0), array)
            for name, array in turn.info.items()
        }
        info = self._masked(values, ~terminated)
        for name in begin:
            info[f"_{name}"] = self._all.copy()
        info["final_obs"], info["_final_obs"] = final, terminated.copy()
        info["final_info"] = self._masked(last, terminated)
        info["_final_info"] = terminated.copy()
        return (
            self.game.observe(),
            turn.reward,
            terminated,
            np.zeros_like(terminated),
            info,
        )

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads.

        Parameters
        ----------
        **kwargs
            Not used.
        """
        self.game.close()
