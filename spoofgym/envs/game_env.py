"""The single environment of any game: a batch of one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Generic, TypeVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from .played import Played
from .resets import warn_unknown
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

    Attributes
    ----------
    game : Played
        The same.
    observation_names, action_names : tuple of str
        Name of every element.
    """

    metadata: dict[str, Any] = {"render_modes": [], "render_fps": 2}  # noqa: RUF012  (Gymnasium's)

    def __init__(self, game: G) -> None:
        self.render_mode = None
        self.adopt(game)

    def adopt(self, game: G) -> None:
        """Take a game that has not begun.

        Parameters
        ----------
        game : Played
            Instead of the present one, if there is one.
        """
        self.game = game
        self.observation_names, self.action_names = game.observation_names, game.action_names
        self.observation_space = observation_space(game)
        self.action_space = action_space(game)
        self._begun = self._running = False

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
        super().reset(seed=seed)
        self.game.reset([self.np_random], given=told_domain(options))
        self._begun = self._running = True
        return self.game.observe()[0], _of_one(self.game.begin_info())

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
        if not self._running:
            raise RuntimeError("the episode is over: call reset() before step()")
        given = checked_action(action, (len(self.action_names),), self.action_names)
        turn = self.game.step(given[None])
        terminated, truncated = bool(turn.terminated[0]), bool(turn.truncated[0])
        self._running = not (terminated or truncated)
        observation = self.game.observe()[0]
        return observation, float(turn.reward[0]), terminated, truncated, _of_one(turn.info)


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
