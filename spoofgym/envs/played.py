"""What an environment needs of a game."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .tally import Tally

FloatArray = NDArray[np.float64]


def check_end_at_alarm(end_at_alarm: bool) -> None:
    """Raise unless the end of an episode is reported."""
    if not isinstance(end_at_alarm, bool | np.bool_):
        raise ValueError(f"`end_at_alarm` must be True or False, got {end_at_alarm!r}")


def check_heading(target_heading_deg: float) -> None:
    """Raise unless there is such a direction."""
    if not isinstance(target_heading_deg, Real) or not np.isfinite(float(target_heading_deg)):
        raise ValueError(
            f"`target_heading_deg` must be a finite number, got {target_heading_deg!r}"
        )


class Turn(NamedTuple):
    """What a step returns.

    Attributes
    ----------
    reward : ndarray
        (B,) float64.
    terminated, truncated : ndarray
        (B,) bool, never both.
    info : dict
        Arrays with a leading axis of receivers.
    """

    reward: FloatArray
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    info: dict[str, NDArray[Any]]

    def alone(self) -> tuple[float, bool, bool, dict[str, Any]]:
        """The same of a batch of one, as plain numbers."""
        info = {name: array.item() for name, array in self.info.items()}
        return self.reward.item(), self.terminated.item(), self.truncated.item(), info


Told = tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]
"""Observation, reward, terminated, truncated, and information, of a batch of one."""


class Played(Protocol):
    """Episodes of B receivers."""

    @property
    def receivers(self) -> int:
        """B."""

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Name of every element of an observation."""

    @property
    def action_names(self) -> tuple[str, ...]:
        """Name of every element of an action."""

    @property
    def episode_steps(self) -> int:
        """Most steps of an episode."""

    @property
    def begin_names(self) -> tuple[str, ...]:
        """Keys of `begin_info`."""

    @property
    def info_names(self) -> tuple[str, ...]:
        """Keys of the information of a step."""

    @property
    def bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Least and largest observation, (o,) each."""

    def reset(
        self,
        rngs: Sequence[np.random.Generator],
        rows: NDArray[np.intp] | None = None,
        given: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin new episodes of some receivers; of all by default."""

    def step(self, action: FloatArray) -> Turn | Tally:
        """Run one epoch with (B, a) commands."""

    def observe(self) -> NDArray[np.float32]:
        """Observe all receivers, (B, o)."""

    def turn(self, action: FloatArray) -> tuple[Turn | Tally, NDArray[np.float32]]:
        """`step`, then `observe`."""

    def alone(self, action: FloatArray) -> Told:
        """`turn` of the only receiver, as an environment returns it."""

    def begin_info(self) -> dict[str, NDArray[Any]]:
        """Information at the begin of an episode."""

    def close(self) -> None:
        """End what runs beside."""


class Stepwise(ABC):
    """A game that is stepped, then observed; `Game` has a faster twin of both."""

    @abstractmethod
    def step(self, action: FloatArray) -> Turn | Tally:
        """Run one epoch with (B, a) commands."""

    @abstractmethod
    def observe(self) -> NDArray[np.float32]:
        """Observe all receivers, (B, o)."""

    def turn(self, action: FloatArray) -> tuple[Turn | Tally, NDArray[np.float32]]:
        """Step, then observe.

        `action` (B, a) float64, C-contiguous, in [-1, 1]; returns `observation` (B, o) float32,
        new.
        """
        turn = self.step(action)
        return turn, self.observe()

    def alone(self, action: FloatArray) -> Told:
        """`turn` of the only receiver.

        `action` (1, a) as in `turn`; returns `observation` (o,) float32.
        """
        turn, observation = self.turn(action)
        return observation[0], *turn.alone()
