"""The single environment of any game: a batch of one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Generic, TypeVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from .played import Played
from .rendering import RENDER_MODES, Recorder, Screen
from .resets import HALFWAY, check_seed, warn_unknown, whole_reset
from .spaces import action_space, checked_action, observation_space

Observation = NDArray[np.float32]


G = TypeVar("G", bound=Played)


def refuse_rendering(render_mode: object) -> None:
    """Raise unless nothing is to be rendered.

    Parameters
    ----------
    render_mode : object
        Of the user.

    Raises
    ------
    ValueError
        When it is not None.
    """
    if render_mode is not None:
        raise ValueError(
            f"`render_mode` must be None, there is nothing to render; got {render_mode!r}"
        )


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

    def __init__(self, game: G, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self._screen: Screen | None = None
        self.adopt(game)

    def adopt(self, game: G) -> None:
        """Take a game that has not begun.

        Parameters
        ----------
        game : Played
            Instead of the present one, if there is one.
        """
        if self._screen is not None:
            self._screen.close()
        self.game = game
        self._draw_with(self._recorder())
        self.observation_names, self.action_names = game.observation_names, game.action_names
        self._action_shape = (len(self.action_names),)
        self.observation_space = observation_space(game)
        self.action_space = action_space(game)
        self._begun = self._running = self._halfway = False

    @property
    def begun(self) -> bool:
        """Whether it has been reset."""
        return self._begun

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode: warm-up, then the onset.

        Parameters
        ----------
        seed : int, optional
            Seeds the receiver; without it the next episode of the same stream begins.
        options : dict, optional
            ``"domain"``: circumstances that are not to be drawn, such as ``{"start_s": 10.0}``; see
            `spoofgym.envs.domain.CHOICES`.  Others are warned of.

        Returns
        -------
        observation : ndarray
            (o,) float32.
        info : dict
            Whether the warm-up alarmed, and the time.
        """
        warn_unknown(options, ("domain",))
        check_seed(seed)
        super().reset(seed=seed)
        with whole_reset(self):
            self.game.reset([self.np_random], given=told_domain(options))
        self._begun = self._running = True
        info = _of_one(self.game.begin_info())
        if self._screen is not None:
            self._screen.begin(info)
        return self.game.observe()[0], info

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Give one command, and run one epoch.

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
        if self._halfway:
            raise RuntimeError(HALFWAY)
        if not self._running:
            why = "the episode is over" if self._begun else "no episode has begun"
            raise RuntimeError(f"{why}: call reset() before step()")
        given = checked_action(action, self._action_shape, self.action_names)
        self._halfway = True
        told = self.game.alone(given[None])
        self._halfway = False
        _, _, terminated, truncated, info = told
        self._running = not (terminated or truncated)
        if self._screen is not None:
            self._screen.add(info)
        return told

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
    """Circumstances that a reset is told.

    Parameters
    ----------
    options : dict or None
        Of the user.

    Returns
    -------
    mapping or None
        Of ``"domain"``.

    Raises
    ------
    TypeError
        When it is no mapping.
    """
    given = (options or {}).get("domain")
    if given is not None and not isinstance(given, Mapping):
        raise TypeError(f"the option `domain` of a reset must be a dict, got {given!r}")
    return given


def _of_one(info: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Information of a batch of one, as plain numbers."""
    return {name: array.item() for name, array in info.items()}
