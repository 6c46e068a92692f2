"""The single environment of any core: a batch of one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Generic, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from .core import Core, SpoofCore
from .options import (
    HALFWAY,
    action_space,
    checked_action,
    checked_seed,
    domain_option,
    observation_space,
    warn_unknown,
    whole_reset,
)
from .rendering import RENDER_MODES, CoreRecorder, Screen

Observation = NDArray[np.float32]
C = TypeVar("C", bound=Core)
NOT_RESET, OVER = "no episode has started", "the episode is over"


class HasSpec:
    """What the environments share: a spec with the length of an episode."""

    core: Core
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """What `gymnasium` made it from; ``max_episode_steps`` is an episode's and one."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        """Fill in the limit.

        With the length itself `gymnasium.make` would wrap what it makes from the spec in a
        `TimeLimit` that truncates at the last step, where the episode ends by itself.  In the
        arguments of `make_vec` the limit has a field of its own.
        """
        if given is not None:
            kwargs = {key: given.kwargs[key] for key in given.kwargs if key != "max_episode_steps"}
            limit = self.core.episode_steps + 1
            given = replace(given, kwargs=kwargs, max_episode_steps=limit)
        self._spec = given


class CoreEnv(HasSpec, gym.Env[Observation, Observation], Generic[C]):
    """Environment of one receiver, from a core of one, not begun yet."""

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
        """Take a core that has not begun, instead of the present one."""
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
    def begun(self) -> bool:
        return self._stopped is not NOT_RESET

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode: warm-up, then the onset.

        Parameters
        ----------
        seed : int, optional
            Seeds the receiver; without it the next episode of the same stream starts.
        options : dict, optional
            ``"domain"``: circumstances that are not to be drawn, such as ``{"start_s": 10.0}``; see
            `spoofgym.simulation.domain.CHOICES`.  Others are warned of.

        Returns
        -------
        observation : ndarray
            (o,) float32.
        info : dict
            Whether the warm-up alarmed, and the time.
        """
        warn_unknown(options, ("domain",))
        super().reset(seed=checked_seed(seed))
        with whole_reset(self):
            self.core.reset([self.np_random], given=domain_option(options))
        self._stopped = None
        info = {name: array.item() for name, array in self.core.reset_info().items()}
        if self._screen is not None:
            self._screen.begin(info)
        return self.core.observe()[0], info

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Give one command, and run until the next is due.

        Parameters
        ----------
        action : array_like
            (a,) in [-1, 1].

        Returns
        -------
        observation : ndarray
            (o,) float32.
        reward : float
            Sum of ``info["reward_*"]``.
        terminated, truncated : bool
            The second is False, unless an end term truncates.
        info : dict
            Parts of the reward, alarm, displacement, time.
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
        """Draw the episode from its onset until now.

        Returns
        -------
        ndarray or None
            (H, W, 3) uint8 in mode ``rgb_array``; None in mode ``human``, which also draws at
            every reset and step.

        Raises
        ------
        RuntimeError
            Before the first reset, and in mode ``human`` without a display.
        """
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
