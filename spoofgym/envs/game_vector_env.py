"""The vector environment of any game: B receivers in step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Generic

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from .._registry import check_choice
from .game_env import G, told_domain
from .spaces import action_space, checked_action, observation_space

AUTORESET_MODES = {
    "next_step": AutoresetMode.NEXT_STEP,
    "same_step": AutoresetMode.SAME_STEP,
}
Array = NDArray[Any]


def autoreset_mode_of(given: str | AutoresetMode) -> AutoresetMode:
    """Mode by name.

    Parameters
    ----------
    given : {"next_step", "same_step"} or AutoresetMode
        Of the user.

    Returns
    -------
    AutoresetMode
        One that the environments have.

    Raises
    ------
    ValueError
        When it is another; the valid ones are listed.
    """
    if isinstance(given, str):
        word = given.lower().removeprefix("autoresetmode.")
        check_choice("autoreset mode", word, AUTORESET_MODES)
        return AUTORESET_MODES[word]
    if given not in AUTORESET_MODES.values():
        raise ValueError(
            f"`autoreset_mode` must be one of {', '.join(AUTORESET_MODES)}, got {given}"
        )
    return given


def check_vector_settings(num_envs: int, render_mode: object) -> None:
    """Raise unless there are receivers, and nothing is to be rendered.

    Parameters
    ----------
    num_envs : int
        Receivers.
    render_mode : object
        Of the user.

    Raises
    ------
    ValueError
        Says which is wrong.
    """
    if num_envs < 1:
        raise ValueError(f"`num_envs` must be at least 1, got {num_envs}")
    if render_mode is not None:
        raise ValueError(
            "`render_mode` must be None, there is nothing to render in a vector environment: the "
            f"single one seeded with seed + i shows receiver i; got {render_mode!r}"
        )


class GameVectorEnv(VectorEnv[Array, Array, Array], Generic[G]):
    """Environment of B receivers; receiver i is the single one seeded with ``seed + i``.

    Parameters
    ----------
    game : Played
        Of B receivers, not begun yet.
    autoreset_mode : AutoresetMode
        When a finished receiver begins its next episode.

    Attributes
    ----------
    game : Played
        The same.
    observation_names, action_names : tuple of str
        Name of every element.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  (declared so by Gymnasium)
        "render_modes": [],
        "render_fps": 2,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(self, game: G, autoreset_mode: AutoresetMode) -> None:
        self.game = game
        self.autoreset_mode = autoreset_mode
        self.metadata = {**type(self).metadata, "autoreset_mode": autoreset_mode}
        self.num_envs, self.render_mode = game.receivers, None
        self.observation_names, self.action_names = game.observation_names, game.action_names
        self.single_observation_space = observation_space(game)
        self.single_action_space = action_space(game)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._rngs: list[np.random.Generator] = []
        self._over = np.ones(self.num_envs, dtype=np.bool_)
        self._all = np.ones(self.num_envs, dtype=np.bool_)

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
            ``"domain"``: circumstances not to be drawn, each one value, or (B,) of them; see
            `spoofgym.envs.domain.CHOICES`.

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
        self.game.reset(self._rngs, given=told_domain(options))
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
        for name in self.game.begin_names:
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
