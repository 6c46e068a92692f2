"""Environments of any core: the single one, a batch of one, and the vector of B receivers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ..core.registry import whole_number
from .core import Core, SpoofCore
from .options import (
    HALFWAY,
    RESET_MASK,
    Array,
    InfoSpec,
    action_space,
    add_masks,
    checked_action,
    checked_seed,
    domain_option,
    info_keys,
    list_seeds,
    observation_space,
    of_rows,
    parse_autoreset_mode,
    read_mask,
    reseed,
    select_info,
    warn_unknown,
    whole_reset,
)
from .rendering import RENDER_MODES, CoreRecorder, Screen
from .scoring import PlainResult, StepResult, first_row

Observation = NDArray[np.float32]
C = TypeVar("C", bound=Core)
NOT_RESET, OVER = "no episode has started", "the episode is over"
LIMIT = "`max_episode_steps`"


class HasSpec:
    """What the environments share: a spec with the length of an episode."""

    core: Core
    _spec: EnvSpec | None = None

    def name_spaces(self, core: Core, receivers: int) -> None:
        """Name the spaces of a vector of so many receivers, and what is in them."""
        self.observation_names, self.action_names = core.observation_names, core.action_names
        self.single_observation_space = observation_space(core)
        self.single_action_space = action_space(core)
        self.observation_space = batch_space(self.single_observation_space, receivers)
        self.action_space = batch_space(self.single_action_space, receivers)

    @property
    def spec(self) -> EnvSpec | None:
        """What `gymnasium` made it from; ``max_episode_steps`` is the episode's plus one."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        """Set `max_episode_steps` to one more than an episode has.

        With the exact number, `gymnasium.make` would add a `TimeLimit` that truncates at the last
        step, where the episode ends by itself.  `kwargs` does not repeat the limit, since the spec
        has a field for it.
        """
        if given is not None:
            kwargs = {key: given.kwargs[key] for key in given.kwargs if key != "max_episode_steps"}
            limit = self.core.episode_steps + 1
            given = replace(given, kwargs=kwargs, max_episode_steps=limit)
        self._spec = given


class CoreEnv(HasSpec, gym.Env[Observation, Observation], Generic[C]):
    """Environment of one receiver, from a core of one, not started yet."""

    core: C
    metadata: dict[str, Any] = {  # noqa: RUF012  (Gymnasium's)
        "render_modes": list(RENDER_MODES),
        "render_fps": 2,
    }

    def __init__(self, core: C, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self._screen: Screen | None = None
        self.adopt(core)

    def adopt(self, core: C) -> None:
        """Take a core that has not started, instead of the present one."""
        if self._screen is not None:
            self._screen.close()
        self.core = core
        self._prepare_screen()
        self.observation_names, self.action_names = core.observation_names, core.action_names
        self._action_shape = (len(self.action_names),)
        self.observation_space = observation_space(core)
        self.action_space = action_space(core)
        self._stopped: str | None = NOT_RESET
        self._halfway = False

    @property
    def is_started(self) -> bool:
        return self._stopped is not NOT_RESET

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode: warm-up, then the onset; without a `seed` the next of the same stream.

        ``options["domain"]``: circumstances that are not to be drawn, as ``{"start_s": 10.0}``; see
        `spoofgym.simulation.domain.CHOICES`.
        """
        warn_unknown(options, ("domain",))
        super().reset(seed=checked_seed(seed))
        with whole_reset(self):
            self.core.reset([self.np_random], given=domain_option(options))
        self._stopped = None
        info = {name: first_row(array) for name, array in self.core.reset_info().items()}
        if self._screen is not None:
            self._screen.start_episode(info)
        return self.core.observe()[0], info

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Give one command (a,) in [-1, 1], and run until the next is due.

        The reward is the sum of ``info["reward_*"]``; `truncated` is False, unless an end term
        truncates; the information has also the alarm, the displacement and the time.
        """
        if self._stopped is not None:
            raise RuntimeError(f"{self._stopped}: call reset() before step()")
        given = checked_action(action, self._action_shape, self.action_names)
        if self._halfway:
            raise RuntimeError(HALFWAY)
        self._halfway = True
        result = self.core.single(given[None])
        self._halfway = False
        self._stopped = OVER if result[2] or result[3] else None
        if self._screen is not None:
            self._screen.add(result[4])
        return result

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the episode from its onset until now: (H, W, 3) uint8 in mode ``rgb_array``; None in
        mode ``human``, which also draws at every reset and step."""
        if self._screen is None:
            gym.logger.warn(
                "render() needs a render mode: make the environment with "
                "render_mode='rgb_array' or 'human'"
            )
            return None
        return self._screen.render()

    def close(self) -> None:
        self.core.close()
        if self._screen is not None:
            self._screen.close()

    def _prepare_screen(self) -> None:
        """Declare what can be rendered, only an episode of the spoofer's side, and prepare it."""
        if not isinstance(self.core, SpoofCore):
            if self.render_mode is not None:
                raise ValueError(
                    "`render_mode` must be None, there is nothing to render; got "
                    f"{self.render_mode!r}"
                )
            self.metadata = {**type(self).metadata, "render_modes": []}
            return
        recorder = CoreRecorder(self.core)
        self.metadata = {**type(self).metadata, "render_fps": 1.0 / recorder.interval_s}
        if self.render_mode is not None:
            self._screen = Screen(self.render_mode, recorder)


class CoreVectorEnv(HasSpec, VectorEnv[Array, Array, Array], Generic[C]):
    """Environment of B receivers; receiver i is the single one seeded with ``seed + i``. `core` is
    of B receivers, not started yet; the others are as in `SpoofVectorEnv`."""

    core: C
    metadata: dict[str, Any] = {  # noqa: RUF012  (declared so by Gymnasium)
        "render_modes": [],
        "render_fps": 2,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    closed = True  # until there is a core: older Gymnasium closes what has failed to be made

    def __init__(
        self,
        core: C,
        autoreset_mode: str | AutoresetMode,
        infos: InfoSpec = "all",
        max_episode_steps: int | None = None,
    ) -> None:
        limit = max_episode_steps
        if limit is not None and whole_number(LIMIT, limit) <= core.episode_steps:
            raise ValueError(
                f"{LIMIT} must be more than the {core.episode_steps} steps that an "
                f"episode has, got {limit}; the end term 'at-steps' cuts it short"
            )
        self.autoreset_mode = parse_autoreset_mode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = None
        self.infos = infos
        self.adopt(core)
        self.closed = False

    def adopt(self, core: C) -> None:
        self.core, self.num_envs = core, core.receivers
        self.name_spaces(core, self.num_envs)
        self._action_shape = (self.num_envs, len(self.action_names))
        self._keys = info_keys(self.infos, core.info_names)
        self._rngs: list[np.random.Generator] = []
        self._halfway = False
        self._over = np.ones(self.num_envs, dtype=np.bool_)
        self._all = np.ones(self.num_envs, dtype=np.bool_)

    @property
    def is_started(self) -> bool:
        return bool(self._rngs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        """Start an episode in every receiver, or in some. `options`: ``reset_mask``, (B,) bool,
        which receivers to reset, at least one (all by default and at the first reset); ``domain``,
        circumstances not to be drawn, each one value or (B,) of them, see
        `spoofgym.simulation.domain.CHOICES`. Returns `observation` (B, o) float32."""
        warn_unknown(options, ("domain", RESET_MASK))
        mask = read_mask(options, self.num_envs)
        if not self._rngs and not mask.all():
            raise ValueError("the first reset must be that of all receivers")
        if self._halfway and not mask.all():
            raise ValueError("the reset after an interrupted step must be that of all receivers")
        seeds = list_seeds(seed, self.num_envs)
        super().reset(seed=seeds[0] if isinstance(seed, int | np.integer) else None)
        self._rngs = reseed(self._rngs, seeds, mask)
        given = domain_option(options)
        with whole_reset(self):
            if mask.all():
                self.core.reset(self._rngs, given=given)
                self._over[:] = False
            else:
                self._restart(mask, given)
        return self.core.observe(), self._add_masks(self.core.reset_info(), mask)

    def _restart(self, mask: NDArray[np.bool_], given: Mapping[str, Any] | None = None) -> None:
        rows = np.flatnonzero(mask)
        chosen_given = given and of_rows(given, rows, self.num_envs)
        self.core.reset([self._rngs[row] for row in rows], rows, chosen_given)
        self._over[rows] = False

    def _add_masks(self, info: dict[str, Array], mask: NDArray[np.bool_]) -> dict[str, Any]:
        return add_masks(select_info(info, self._keys), mask)

    def _report_step(
        self, result: StepResult | PlainResult
    ) -> tuple[Array, Array, Array, dict[str, Any]]:
        if self._keys is None and isinstance(result, StepResult) and not result.extra:
            return result.unpack_with_masks()
        info = self._add_masks(result.info, self._all)
        return result.reward, result.terminated, result.truncated, info

    def _mark_all(self, info: dict[str, Any]) -> None:
        for name in self.core.reset_names:
            if name in info:
                info[f"_{name}"] = self._all.copy()

    def step(self, actions: Any) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        """Give one command to every receiver, and run one epoch. `actions` (B, a) in [-1, 1];
        returns `observation` (B, o) float32; `reward` (B,) float64."""
        if not self._rngs:
            raise RuntimeError("call reset() before step()")
        if self._halfway:
            raise RuntimeError(HALFWAY)
        given = checked_action(actions, self._action_shape, self.action_names)
        if self.autoreset_mode is AutoresetMode.DISABLED and np.count_nonzero(self._over):
            raise RuntimeError(
                f"the episodes of receivers {', '.join(map(str, np.flatnonzero(self._over)))} are "
                f"over: call reset(options={{'{RESET_MASK}': ...}}) before step()"
            )
        self._halfway = True
        # where nothing is reset by itself, no receiver is over here
        same_step = self.autoreset_mode is AutoresetMode.SAME_STEP
        result = self._same_step(given) if same_step else self._next_step(given)
        self._halfway = False
        return result

    def _next_step(self, given: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        over = np.count_nonzero(self._over)
        if over == self.num_envs:
            self._restart(self._all)
            info = self._add_masks(self.core.reset_info(), self._all)
            never = np.zeros_like(self._over)
            return self.core.observe(), np.zeros(self.num_envs), never, never.copy(), info
        result, observation = self.core.step(given)
        if over:
            reward, terminated, truncated = result.reward, result.terminated, result.truncated
            reward[self._over] = 0.0
            terminated[self._over] = truncated[self._over] = False
            info = self._restart_instead(self._over, result.info)
            observation = self.core.observe()
        else:
            reward, terminated, truncated, info = self._report_step(result)
        self._over = terminated | truncated
        return observation, reward, terminated, truncated, info

    def _restart_instead(self, fresh: NDArray[np.bool_], info: dict[str, Array]) -> dict[str, Any]:
        fresh = fresh.copy()
        self._restart(fresh)
        start = self.core.reset_info()
        for name, array in info.items():
            array[fresh] = start[name][fresh] if name in start else 0
        result = self._add_masks(info, ~fresh)
        self._mark_all(result)
        return result

    def _same_step(self, given: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        result, observation = self.core.step(given)
        over = result.terminated | result.truncated
        if not np.count_nonzero(over):
            return observation, *self._report_step(result)
        final = np.full(self.num_envs, None, dtype=object)
        for row in np.flatnonzero(over):
            final[row] = observation[row].copy()
        wanted = select_info(result.info, self._keys)
        last = {name: _where(over, array) for name, array in wanted.items()}
        self._restart(over)
        start = self.core.reset_info()
        values = {name: _where(~over, array, start.get(name)) for name, array in wanted.items()}
        info = add_masks(values, ~over)
        self._mark_all(info)
        info["final_obs"], info["_final_obs"] = final, over.copy()
        info["final_info"] = add_masks(last, over)
        info["_final_info"] = over.copy()
        return self.core.observe(), result.reward, result.terminated, result.truncated, info

    @property
    def over(self) -> NDArray[np.bool_]:
        """Receivers whose episodes are over, (B,)."""
        return self._over

    def end_episodes(self, mask: NDArray[np.bool_]) -> None:
        """Take the episodes of some receivers, (B,), as over: a wrapper around this ends them."""
        self._over |= mask

    def close_extras(self, **kwargs: Any) -> None:
        self.core.close()


def _where(mask: NDArray[np.bool_], array: Array, other: Array | None = None) -> Array:
    """Elements of an array, and those of another, or zeros, elsewhere; of the same type."""
    nothing = np.zeros((), array.dtype)  # a plain 0 would make numbers of truth values
    rows = mask.reshape(-1, *[1] * (array.ndim - 1))
    return np.where(rows, array, nothing if other is None else other)
