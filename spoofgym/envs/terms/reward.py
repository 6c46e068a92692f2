"""What a spoofer is rewarded for: a list of small terms whose sum is the reward."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from ...core.declared import setting, settings_record
from .observation import holds_for_call

FloatArray = NDArray[np.float64]


class Outcome(NamedTuple):
    """What an epoch has brought; the reward of a decision over several is the sum of theirs.

    - `gain` (B,) increase of the displacement that would count if no alarm followed [m], >= 0;
    - `retraction` (B,) what an alarm takes back of it [m], <= 0;
    - `detected` (B,) bool, whether it brought the first alarm; `excess`, the same, unless a clean
      twin has alarmed by then; `alarm`, whether there is one now;
    - `action` (B, k) as the spoofer gave it, in [-1, 1];
    - `undetected` (B,) undetected displacement of the episode so far [m];
    - `over` (B,) bool, whether the episode has come to its end.
    """

    gain: FloatArray
    retraction: FloatArray
    detected: NDArray[np.bool_]
    excess: NDArray[np.bool_]
    alarm: NDArray[np.bool_]
    action: FloatArray
    undetected: FloatArray
    over: NDArray[np.bool_]


SHARED = ("gain", "retraction", "excess", "alarm")
"""Fields of `Outcome` of which a term can be a share."""


class RewardTerm(Protocol):
    """One part of the reward, ``info["reward_<name>"]``."""

    name: ClassVar[str]

    def __call__(self, outcome: Outcome) -> FloatArray:
        """(B,) reward of an epoch, a new array."""


class _Shared:
    """A term that is a factor, its first setting, times one field of the outcome.  Where all terms
    are, kernels compute the reward, to the same bits."""

    field: ClassVar[str]
    sign: ClassVar[float] = 1.0

    @property
    def share(self) -> tuple[str, float]:
        return self.field, self.sign * float(next(iter(vars(self).values())))

    def __call__(self, outcome: Outcome) -> FloatArray:
        field, factor = self.share
        values = getattr(outcome, field)
        return np.where(values, factor, 0.0) if values.dtype == np.bool_ else factor * values


@settings_record(frozen=True)
class DisplacementGain(_Shared):
    """Increase of the undetected displacement along the target direction."""

    per_m: float = setting(default=1.0, unit="1/m", help="Reward of one metre.")
    name: ClassVar[str] = "displacement"
    field: ClassVar[str] = "gain"


@settings_record(frozen=True)
class Retraction(_Shared):
    """What was gained within the time to alert of an alarm is taken back."""

    per_m: float = setting(
        default=1.0, unit="1/m", help="Reward of one metre; that of `DisplacementGain`."
    )
    name: ClassVar[str] = "retraction"
    field: ClassVar[str] = "retraction"


@settings_record(frozen=True)
class AlarmPenalty(_Shared):
    """Price of the first alarm; with a clean twin, where that has not alarmed so far."""

    penalty_m: float = setting(
        default=60.0, least=0.0, unit="m", help="Price of it, as a displacement."
    )
    name: ClassVar[str] = "alarm"
    field: ClassVar[str] = "excess"
    sign: ClassVar[float] = -1.0


@settings_record(frozen=True)
class AlarmedEpochs(_Shared):
    """Price of every epoch with an alarm, for episodes that go on after the first."""

    per_epoch_m: float = setting(
        default=1.0, least=0.0, unit="m", help="Price of each, as a displacement."
    )
    name: ClassVar[str] = "alarmed_epochs"
    field: ClassVar[str] = "alarm"
    sign: ClassVar[float] = -1.0


@settings_record(frozen=True)
class EffortPenalty:
    """Price of the command: the mean square of its elements.

    Of an action that corrects a base, the sum of both counts, as it is played.
    """

    at_full_m: float = setting(
        default=0.1,
        least=0.0,
        unit="m",
        help="Price of an epoch in which all elements of the action are at their limits.",
    )
    name: ClassVar[str] = "effort"

    def __call__(self, outcome: Outcome) -> FloatArray:
        action = outcome.action
        return np.asarray(-self.at_full_m * (action * action).mean(axis=1))


@settings_record(frozen=True)
class TerminalDisplacement:
    """Undetected displacement of the episode, all of it at its end."""

    per_m: float = setting(default=1.0, unit="1/m", help="Reward of one metre.")
    name: ClassVar[str] = "terminal_displacement"

    def __call__(self, outcome: Outcome) -> FloatArray:
        return np.where(outcome.over, self.per_m * outcome.undetected, 0.0)


REWARD_TERMS: dict[str, type[RewardTerm]] = {
    "displacement-gain": DisplacementGain,
    "retraction": Retraction,
    "alarm-penalty": AlarmPenalty,
    "alarmed-epochs": AlarmedEpochs,
    "effort-penalty": EffortPenalty,
    "terminal-displacement": TerminalDisplacement,
}


def default_rewards(alarm_penalty_m: float) -> tuple[RewardTerm, ...]:
    """Undiscounted, their sum is the undetected displacement minus the price of an alarm [m]."""
    return DisplacementGain(), Retraction(), AlarmPenalty(alarm_penalty_m)


def named_terms(terms: Sequence[RewardTerm]) -> list[tuple[str, RewardTerm]]:
    names = [term.name for term in terms]
    if len(set(names)) < len(names):
        raise ValueError(f"two reward terms have the same name, got {', '.join(names)}")
    return [(f"reward_{term.name}", term) for term in terms]


def compute_shares(terms: Sequence[RewardTerm]) -> FloatArray | None:
    """(r, 4) factor of every term on the fields of `SHARED`, for compiled code; None where a term
    has no share, or one that its own `__call__` may belie."""
    shares = np.zeros((len(terms), len(SHARED)))
    for row, term in zip(shares, terms, strict=True):
        if not holds_for_call(term, "share"):
            return None
        field, factor = cast("_Shared", term).share
        row[SHARED.index(field)] = factor
    return shares


def sum_terms(
    terms: Sequence[tuple[str, RewardTerm]], outcome: Outcome, info: dict[str, NDArray[Any]]
) -> FloatArray:
    """Sum of the terms, whose parts are written into ``info``: (B,) reward."""
    reward = np.zeros(len(outcome.gain))
    for key, term in terms:
        part = info[key] = np.asarray(term(outcome), dtype=np.float64)
        if not np.isfinite(part).all():
            raise ValueError(f"info[{key!r}] must be finite, got {part}")
        reward += part
    return reward
