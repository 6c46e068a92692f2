"""What a spoofer is rewarded for: a list of small terms whose sum is the reward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .._registry import check_plain_settings

FloatArray = NDArray[np.float64]


class Outcome(NamedTuple):
    """What a step has brought.

    Attributes
    ----------
    gain : ndarray
        (B,) increase of the displacement that would count if no alarm followed [m], >= 0.
    retraction : ndarray
        (B,) what an alarm takes back of it [m], <= 0.
    detected : ndarray
        (B,) bool, whether this step brought the first alarm.
    """

    gain: FloatArray
    retraction: FloatArray
    detected: NDArray[np.bool_]


class RewardTerm(Protocol):
    """One part of the reward.

    Attributes
    ----------
    name : str
        The part is ``info["reward_<name>"]``.
    """

    name: ClassVar[str]

    def __call__(self, outcome: Outcome) -> FloatArray:
        """Reward of a step.

        Parameters
        ----------
        outcome : Outcome
            What it has brought.

        Returns
        -------
        ndarray
            (B,) a new array.
        """


@dataclass(frozen=True)
class DisplacementGain:
    """Increase of the undetected displacement along the target direction.

    Parameters
    ----------
    per_m : float
        Reward of one metre.
    """

    per_m: float = 1.0
    name: ClassVar[str] = "displacement"

    def __call__(self, outcome: Outcome) -> FloatArray:
        """Gain of the step."""
        return self.per_m * outcome.gain


@dataclass(frozen=True)
class Retraction:
    """What was gained within the time to alert of an alarm is taken back.

    Parameters
    ----------
    per_m : float
        Reward of one metre; that of `DisplacementGain`.
    """

    per_m: float = 1.0
    name: ClassVar[str] = "retraction"

    def __call__(self, outcome: Outcome) -> FloatArray:
        """What is taken back."""
        return self.per_m * outcome.retraction


@dataclass(frozen=True)
class AlarmPenalty:
    """Price of the first alarm.

    Parameters
    ----------
    penalty_m : float
        In metres of displacement, at least 0.
    """

    penalty_m: float = 10.0
    name: ClassVar[str] = "alarm"

    def __post_init__(self) -> None:
        """Check the price."""
        check_plain_settings(AlarmPenalty, {"penalty_m": self.penalty_m})
        if not (np.isfinite(self.penalty_m) and self.penalty_m >= 0.0):
            raise ValueError(f"`penalty_m` must be finite and >= 0, got {self.penalty_m}")

    def __call__(self, outcome: Outcome) -> FloatArray:
        """The price, where the first alarm came."""
        return np.where(outcome.detected, -self.penalty_m, 0.0)


def default_rewards(alarm_penalty_m: float = 10.0) -> tuple[RewardTerm, ...]:
    """Undiscounted, their sum is the undetected displacement minus the alarm penalty.

    Parameters
    ----------
    alarm_penalty_m : float
        Price of an alarm.

    Returns
    -------
    tuple
        Terms.
    """
    return DisplacementGain(), Retraction(), AlarmPenalty(alarm_penalty_m)


def named_terms(terms: Sequence[RewardTerm]) -> list[tuple[str, RewardTerm]]:
    """Terms by their keys in ``info``.

    Parameters
    ----------
    terms : sequence of RewardTerm
        Each with a name of its own.

    Returns
    -------
    list of tuple
        ``reward_<name>`` and the term.

    Raises
    ------
    ValueError
        When two have the same name.
    """
    names = [term.name for term in terms]
    if len(set(names)) < len(names):
        raise ValueError(f"two reward terms have the same name, got {', '.join(names)}")
    return [(f"reward_{term.name}", term) for term in terms]


def reward_of(
    terms: Sequence[tuple[str, RewardTerm]], outcome: Outcome, info: dict[str, NDArray[Any]]
) -> FloatArray:
    """Sum of the terms, whose parts are written into ``info``.

    Parameters
    ----------
    terms : sequence of tuple
        Of `named_terms`.
    outcome : Outcome
        What a step has brought.
    info : dict
        Gets a key per term.

    Returns
    -------
    ndarray
        (B,) reward.
    """
    reward = np.zeros(len(outcome.gain))
    for key, term in terms:
        info[key] = term(outcome)
        reward += info[key]
    return reward
