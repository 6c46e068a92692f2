"""When an episode ends: a list of small terms, and the last command, which always ends it.

An end that belongs to the game is `terminated`: the offsets then hold their rate for the time to
alert, in which an alarm still counts, as after the last command.  A limit from outside the game is
`truncated`; nothing is held, since the episode would go on.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ...core.declared import setting, settings_record
from ...simulation.divergence import Divergence
from .observation import Snapshot

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]


class EpochState(NamedTuple):
    """The episodes after the epoch of a command; `displacement` (B,) along the target [m]."""

    snapshot: Snapshot
    displacement: FloatArray


class EndTerm(Protocol):
    """One reason to end an episode, ``info["end_<name>"]``; `truncates`: from outside the game."""

    name: ClassVar[str]
    truncates: ClassVar[bool]

    def __call__(self, state: EpochState) -> Mask:
        """(B,) bool, which episodes it ends, a new array."""


@settings_record(frozen=True)
class AtAlarm:
    """The first alarm of the detector in the loop."""

    name: ClassVar[str] = "alarm"
    truncates: ClassVar[bool] = False

    def __call__(self, state: EpochState) -> Mask:
        simulator = state.snapshot.simulator
        if simulator.verdict is None:
            return np.zeros(simulator.receivers, dtype=np.bool_)
        return np.asarray(simulator.verdict.alarm.any(axis=1))


@settings_record(frozen=True)
class AtWindowEnd:
    """The last command of the attack window; ends every episode, listed or not."""

    name: ClassVar[str] = "window"
    truncates: ClassVar[bool] = False

    def __call__(self, state: EpochState) -> Mask:
        return state.snapshot.step >= state.snapshot.setup.steps


@settings_record(frozen=True)
class AtDisplacement:
    """Displacement along the target direction, as far as the spoofer wants it."""

    limit_m: float = setting(above=0.0, unit="m", help="Displacement at which the episode ends.")
    name: ClassVar[str] = "displacement"
    truncates: ClassVar[bool] = False

    def __call__(self, state: EpochState) -> Mask:
        return state.displacement >= self.limit_m


@settings_record(frozen=True)
class AtStealthBudget:
    """Divergence that the attack may cause: half the sum of rho' S^-1 rho, as the filter has it."""

    budget_nats: float = setting(
        above=0.0,
        unit="nats",
        help="Largest divergence of an episode that goes on; see `Divergence`.",
    )
    name: ClassVar[str] = "stealth_budget"
    truncates: ClassVar[bool] = False
    needs: ClassVar[tuple[type[Divergence], ...]] = (Divergence,)

    def __call__(self, state: EpochState) -> Mask:
        spent = state.snapshot.simulator.monitor(Divergence).memory["divergence"]
        return spent > self.budget_nats


@settings_record(frozen=True)
class AtSteps:
    """Number of commands after which a caller stops the episode; truncates."""

    steps: int = setting(least=1, help="Decisions; each may last several epochs.")
    name: ClassVar[str] = "steps"
    truncates: ClassVar[bool] = True

    def __call__(self, state: EpochState) -> Mask:
        snapshot = state.snapshot
        return snapshot.step >= self.steps * snapshot.setup.repeat


END_TERMS: dict[str, type[EndTerm]] = {
    "at-alarm": AtAlarm,
    "at-window-end": AtWindowEnd,
    "at-displacement": AtDisplacement,
    "at-stealth-budget": AtStealthBudget,
    "at-steps": AtSteps,
}


class Ends:
    """Ends of a list of terms; the core itself knows of the alarm and of the last command."""

    def __init__(self, terms: Sequence[EndTerm]) -> None:
        names = [term.name for term in terms]
        if len(set(names)) < len(names):
            raise ValueError(f"two end terms have the same name, got {', '.join(names)}")
        self.at_alarm = any(isinstance(term, AtAlarm) for term in terms)
        self.terms = tuple(terms)
        self._terms = [term for term in terms if not isinstance(term, AtAlarm | AtWindowEnd)]
        self.info_names = tuple(f"end_{term.name}" for term in self._terms)

    def __bool__(self) -> bool:
        return bool(self._terms)

    def judge(self, state: EpochState, info: dict[str, NDArray[Any]]) -> tuple[Mask, Mask]:
        """Judge the episodes.  Returns `terminated`, `truncated` (B,) bool, new arrays."""
        result = np.zeros((2, len(state.displacement)), dtype=np.bool_)
        for key, term in zip(self.info_names, self._terms, strict=True):
            info[key] = term(state)
            result[int(term.truncates)] |= info[key]
        return result[0], result[1]
