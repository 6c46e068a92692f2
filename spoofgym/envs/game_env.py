"""The single environment of any game: a batch of one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Generic, TypeVar

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from .played import Played
from .rendering import RENDER_MODES, Recorder, Screen
from .resets import checked_seed, warn_unknown
from .spaces import action_space, checked_action, observation_space

Observation = NDArray[np.float32]


G = TypeVar("G", bound=Played)


def refuse_rendering(render_mode: object) -> None:
    """Raise unless nothing is to be rendered."""
    if render_mode is not None:
        raise ValueError(
            f"`render_mode` must be None, there is nothing to render; got {render_mode!r}"
        )


def with_length(spec: EnvSpec | None, game: Played) -> EnvSpec | None:
    """The spec with a limit of one step more than an episode has."""
    # with the length itself `gymnasium.make` would wrap what it makes from the spec in a
    # `TimeLimit` that truncates at the last step, where the episode ends by itself
    return None if spec is None else replace(spec, max_episode_steps=game.episode_steps + 1)


class GameEnv(gym.Env[Observation, Observation], Generic[G]):
    """Environment of one receiver.

    Parameters
    ----------
    game : Played
        Of one receiver, not begun yet.
    render_mode : {"human", "rgb_array"}, optional
        Whether a window shows the episode, or `render` returns pictures of it.

    Raises
    ------
    ValueError
        When there is no such render mode.

    Attributes
    ----------
    game : Played
        The same.
    observation_names, action_names : tuple of str
        Name of every element.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  (Gymnasium's)
        "render_modes": list(RENDER_MODES),
        "render_fps": 2,
    }
    _spec: EnvSpec | None = None

    def __init__(self, game: G, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self._screen: Screen | None = None
        self.adopt(game)

    def adopt(self, game: G) -> None:
        """Take a game that has not begun."""
        if self._screen is not None:
            self._screen.close()
        self.game = game
        self._draw_with(self._recorder())
        self.observation_names, self.action_names = game.observation_names, game.action_names
        self._action_shape = (len(self.action_names),)
        self.observation_space = observation_space(game)
        self.action_space = action_space(game)
        self._begun = self._running = False

    @property
    def spec(self) -> EnvSpec | None:
        """What `gymnasium.make` made it from; ``max_episode_steps`` is an episode's and one."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        """Fill in the limit."""
        self._spec = with_length(given, self.game)

    @property
    def begun(self) -> bool:
        """Whether it has been reset."""
        return self._begun

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode: warm-up, then the onset.  Returns `observation` (o,) float32."""
        warn_unknown(options, ("domain",))
        super().reset(seed=checked_seed(seed))
        self.game.reset([self.np_random], given=told_domain(options))
        self._begun = self._running = True
        info = _of_one(self.game.begin_info())
        if self._screen is not None:
            self._screen.begin(info)
        return self.game.observe()[0], info

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Give one command, and run one epoch.

        `action` (a,) in [-1, 1]; returns `observation` (o,) float32; `reward`: sum of
        ``info["reward_*"]``; `terminated`, `truncated`: the second is False, unless an end term
        truncates.
        """
        if not self._running:
            why = "the episode is over" if self._begun else "no episode has begun"
            raise RuntimeError(f"{why}: call reset() before step()")
        given = checked_action(action, self._action_shape, self.action_names)
        told = self.game.alone(given[None])
        _, _, terminated, truncated, info = told
        self._running = not (terminated or truncated)
        if self._screen is not None:
            self._screen.add(info)
        return told

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the episode from its onset until now.

        Returns (H, W, 3) uint8 in mode ``rgb_array``; None in mode ``human``, which also draws at
        every reset and step.
        """
        if self._screen is None:
            gym.logger.warn(
                "render() needs a render mode: make the environment with "
                "render_mode='rgb_array' or 'human'"
            )
            return None
        return self._screen.render()

    def close(self) -> None:
        """End what runs beside, and close the window."""
        self.game.close()
        if self._screen is not None:
            self._screen.close()

    def _recorder(self) -> Recorder | None:
        """What looks at the game for pictures; None where there is nothing to render."""
        return None

    def _draw_with(self, recorder: Recorder | None) -> None:
        """Say what can be rendered, and prepare it where it is asked for."""
        kept = type(self).metadata
        if recorder is None:
            refuse_rendering(self.render_mode)
            self.metadata = {**kept, "render_modes": []}
            return
        self.metadata = {**kept, "render_fps": 1.0 / recorder.interval_s}
        if self.render_mode is not None:
            self._screen = Screen(self.render_mode, recorder)


def told_domain(options: dict[str, Any] | None) -> Mapping[str, Any] | None:
    """Circumstances that a reset is given."""
    given = (options or {}).get("domain")
    if given is not None and not isinstance(given, Mapping):
        raise TypeError(f"the option `domain` of a reset must be a dict, got {given!r}")
    return given


def _of_one(info: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Information of a batch of one, as plain numbers."""
    return {name: array.item() for name, array in info.items()}
