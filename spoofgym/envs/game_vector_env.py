"""The vector environment of any game: B receivers in step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Generic

import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from .._registry import check_choice, whole_number
from .game_env import G, told_domain, with_length
from .infos import InfoSpec, chosen, info_keys, masked
from .played import Turn
from .resets import RESET_MASK, mask_of, of_rows, seeds_of, warn_unknown
from .spaces import action_space, checked_action, observation_space
from .tally import Tally

NEXT_STEP, SAME_STEP = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP
AUTORESET_MODES = {
    "next_step": NEXT_STEP,
    "same_step": SAME_STEP,
    "disabled": AutoresetMode.DISABLED,
}
LIMIT = "`max_episode_steps`"
Array = NDArray[Any]


def autoreset_mode_of(given: str | AutoresetMode) -> AutoresetMode:
    """Mode by name."""
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
    """Raise unless there are receivers, and nothing is to be rendered."""
    if not isinstance(num_envs, int | np.integer) or isinstance(num_envs, bool):
        raise ValueError(f"`num_envs` must be a whole number, got {num_envs!r}")
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
        When a finished receiver begins its next episode: at the next step, at the same, or when
        ``reset`` is called with a mask.
    infos : {"all", "none"} or sequence of str
        Which information is handed out, by its keys; ``final_obs`` and ``final_info`` always are.
    max_episode_steps : int, optional
        As `gymnasium.make_vec` hands it on from a spec: more than an episode has.

    Raises
    ------
    ValueError
        When `max_episode_steps` would cut an episode short.

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
    _spec: EnvSpec | None = None
    closed = True  # until there is a game: older Gymnasium closes what has failed to be made

    def __init__(
        self,
        game: G,
        autoreset_mode: AutoresetMode,
        infos: InfoSpec = "all",
        max_episode_steps: int | None = None,
    ) -> None:
        limit = max_episode_steps
        if limit is not None and whole_number(LIMIT, limit) <= game.episode_steps:
            raise ValueError(
                f"{LIMIT} must be more than the {game.episode_steps} steps that an "
                f"episode has, got {limit}; the end term 'at-steps' cuts it short"
            )
        self.autoreset_mode = autoreset_mode
        self.metadata = {**type(self).metadata, "autoreset_mode": autoreset_mode}
        self.render_mode = None
        self._infos = infos
        self.adopt(game)
        self.closed = False

    def adopt(self, game: G) -> None:
        """Take a game that has not begun."""
        self.game, self.num_envs = game, game.receivers
        self.observation_names, self.action_names = game.observation_names, game.action_names
        self._action_shape = (self.num_envs, len(self.action_names))
        self.single_observation_space = observation_space(game)
        self.single_action_space = action_space(game)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._keys = info_keys(self._infos, game.info_names)
        self._rngs: list[np.random.Generator] = []
        self._over = np.ones(self.num_envs, dtype=np.bool_)
        self._all = np.ones(self.num_envs, dtype=np.bool_)

    @property
    def spec(self) -> EnvSpec | None:
        """What `gymnasium.make_vec` made it from; ``max_episode_steps`` is an episode's and one."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        """Fill in the limit."""
        if given is not None:  # the limit has a field of its own, from which `make_vec` takes it
            kwargs = {key: given.kwargs[key] for key in given.kwargs if key != "max_episode_steps"}
            given = replace(given, kwargs=kwargs)
        self._spec = with_length(given, self.game)

    @property
    def begun(self) -> bool:
        """Whether it has been reset."""
        return bool(self._rngs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        """Begin an episode in every receiver, or in some.

        `options`: ``reset_mask``, (B,) bool, which receivers to reset, at least one (all by default
        and at the first reset); ``domain``, circumstances not to be drawn, each one value or (B,)
        of them, see `spoofgym.envs.domain.CHOICES`.  Returns `observation` (B, o) float32.
        """
        warn_unknown(options, ("domain", RESET_MASK))
        mask = mask_of(options, self.num_envs)
        if mask is None:
            mask = self._all.copy()
        elif not self._rngs and not mask.all():
            raise ValueError("the first reset must be that of all receivers")
        seeds = seeds_of(seed, self.num_envs)
        super().reset(seed=seeds[0] if isinstance(seed, int | np.integer) else None)
        if not self._rngs:
            self._rngs = [np.random.default_rng(s) for s in seeds]
        else:
            self._rngs = [
                rng if s is None or not begins else np.random.default_rng(s)
                for rng, s, begins in zip(self._rngs, seeds, mask, strict=True)
            ]
        given = told_domain(options)
        if mask.all():
            self.game.reset(self._rngs, given=given)
            self._over[:] = False
        else:
            self._restart(mask, given)
        return self.game.observe(), self._masked(self.game.begin_info(), mask)

    def _restart(self, mask: NDArray[np.bool_], given: Mapping[str, Any] | None = None) -> None:
        rows = np.flatnonzero(mask)
        told = given and of_rows(given, rows, self.num_envs)
        self.game.reset([self._rngs[row] for row in rows], rows, told)
        self._over[rows] = False

    def _masked(self, info: dict[str, Array], mask: NDArray[np.bool_]) -> dict[str, Any]:
        """Arrays that are asked for, with the masks that tell which receivers have them."""
        return masked(chosen(info, self._keys), mask)

    def _told(self, turn: Turn | Tally) -> tuple[Array, Array, Array, dict[str, Any]]:
        """Rewards, ends and information of a step that every receiver has made."""
        if self._keys is None and isinstance(turn, Tally) and not turn.more:
            return turn.masked()
        info = self._masked(turn.info, self._all)
        return turn.reward, turn.terminated, turn.truncated, info

    def _mark_begun(self, info: dict[str, Any]) -> None:
        """Say of what every receiver has, also one that begins, that it does."""
        for name in self.game.begin_names:
            if name in info:
                info[f"_{name}"] = self._all.copy()

    def step(self, actions: Any) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Give one command to every receiver, and run one epoch.

        `actions` (B, a) in [-1, 1]; returns `observation` (B, o) float32; `reward` (B,) float64.
        """
        if not self._rngs:
            raise RuntimeError("call reset() before step()")
        given = checked_action(actions, self._action_shape, self.action_names)
        mode = self.autoreset_mode
        if mode is NEXT_STEP:
            return self._next_step(given)
        return self._same_step(given) if mode is SAME_STEP else self._plain_step(given)

    def _plain_step(self, given: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        if np.count_nonzero(self._over):
            raise RuntimeError(
                f"the episodes of receivers {', '.join(map(str, np.flatnonzero(self._over)))} are "
                f"over: call reset(options={{'{RESET_MASK}': ...}}) before step()"
            )
        turn, observation = self.game.turn(given)
        reward, terminated, truncated, info = self._told(turn)
        self._over = terminated | truncated
        return observation, reward, terminated, truncated, info

    def _next_step(self, given: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        begins = np.count_nonzero(self._over)
        if begins == self.num_envs:
            self._restart(self._all)
            info = self._masked(self.game.begin_info(), self._all)
            never = np.zeros_like(self._over)
            return self.game.observe(), np.zeros(self.num_envs), never, never.copy(), info
        turn, observation = self.game.turn(given)
        if begins:
            reward, terminated, truncated = turn.reward, turn.terminated, turn.truncated
            reward[self._over] = 0.0
            terminated[self._over] = truncated[self._over] = False
            info = self._begin_instead(self._over, turn.info)
            observation = self.game.observe()
        else:
            reward, terminated, truncated, info = self._told(turn)
        self._over = terminated | truncated
        return observation, reward, terminated, truncated, info

    def _begin_instead(self, begins: NDArray[np.bool_], info: dict[str, Array]) -> dict[str, Any]:
        """Begin the next episode of receivers that ran one epoch more than theirs."""
        begins = begins.copy()
        self._restart(begins)
        begin = self.game.begin_info()
        for name, array in info.items():
            array[begins] = begin[name][begins] if name in begin else 0
        told = self._masked(info, ~begins)
        self._mark_begun(told)
        return told

    def _same_step(self, given: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        turn, observation = self.game.turn(given)
        over = turn.terminated | turn.truncated
        if not np.count_nonzero(over):
            return observation, *self._told(turn)
        final = np.full(self.num_envs, None, dtype=object)
        for row in np.flatnonzero(over):
            final[row] = observation[row].copy()
        told = chosen(turn.info, self._keys)
        last = {name: _where(over, array) for name, array in told.items()}
        self._restart(over)
        begin = self.game.begin_info()
        values = {name: _where(~over, array, begin.get(name)) for name, array in told.items()}
        info = masked(values, ~over)
        self._mark_begun(info)
        info["final_obs"], info["_final_obs"] = final, over.copy()
        info["final_info"] = masked(last, over)
        info["_final_info"] = over.copy()
        return self.game.observe(), turn.reward, turn.terminated, turn.truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads."""
        self.game.close()


def _where(mask: NDArray[np.bool_], array: Array, other: Array | None = None) -> Array:
    """Elements of an array, and those of another, or zeros, elsewhere; of the same type."""
    nothing = np.zeros((), array.dtype)  # a plain 0 would make numbers of truth values
    return np.where(mask, array, nothing if other is None else other)
