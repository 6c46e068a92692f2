"""The card of a shipped or exported spoofer: what it fits, what it knows, and how it was made."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal, Self

from pydantic import (
    Field,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    field_validator,
    model_validator,
)

from ..core.settings import unlike
from ..policies.card import PolicyCard, PolicyFile, Record, Space, spaces_of, unlike_spaces
from .base import SpooferContext

NAME = r"[A-Za-z0-9][A-Za-z0-9._-]*"  # what a spoofer with a card may be called


class Conditions(Record):
    """What an attack has to be like for the actions to mean what they meant; with control by rate
    the limit of the acceleration does not matter, and may be None."""

    interval_s: PositiveFloat
    steps: PositiveInt
    control: Literal["rate", "acceleration", "setpoint"]
    acceleration_limit_mps2: PositiveFloat | None
    rate_limit_mps: PositiveFloat
    setpoint_mps: PositiveFloat | None = None


class Knowledge(Record):
    """What a spoofer observes during an attack, and what it was optimised on before."""

    run_time: Literal[
        "blind", "tracking", "oracle", "blind+reported", "tracking+reported", "oracle+reported"
    ]
    design_time: str = Field(min_length=1)


class Score(Record):
    """What a spoofer reached against one detector, with the 95 % interval of the mean [m].

    - `counted`: runs that are silent before the onset and without attack, over which displacement
      and `alarm_rate` are taken; None on a card from before that was the rule, over all runs;
    - `clean_alarm_rate`: of all runs without attack;
    - `budget`: largest `alarm_rate`, by its upper limit on the runs of the choice; without
      `counted`, how far it may be above the clean one.
    """

    detector: str
    split: str
    entropy: NonNegativeInt
    runs: PositiveInt
    counted: PositiveInt | None = None
    undetected_displacement_m: float
    low: float
    high: float
    alarm_rate: float = Field(ge=0.0, le=1.0)
    clean_alarm_rate: float = Field(ge=0.0, le=1.0)
    budget: float = Field(ge=0.0, lt=1.0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.low <= self.undetected_displacement_m <= self.high:
            raise ValueError(
                "`undetected_displacement_m` must be within `low` and `high`, got "
                f"{self.undetected_displacement_m}, {self.low} and {self.high}"
            )
        return self


class Card(PolicyCard):
    """The card of a spoofer, on disk a JSON file with its policy.

    Attributes
    ----------
    format : int
        Of the card: 1.
    name : str
        Of the spoofer.
    kind : {"onnx-policy", "profile"}
        Registered name of its class.
    env_id : str
        Environment that it was made in.
    env_kwargs : dict
        What `gymnasium.make` takes besides the id.
    observation : Space or None
        What it observes; None for a profile, which looks at nothing.
    action : Space
        What it commands, within -1 and 1.
    conditions : Conditions
        Of the attack.
    knowledge : Knowledge
        At run time and at design time.
    training : dict
        How it was made: command, arguments, seed, steps, wall time, algorithm.
    versions : dict
        Of the packages that it was made with.
    scores : tuple of Score
        What it reached.
    rivals : tuple of dict
        Tuning tables of those that it was compared with.
    settings : dict
        Settings of a profile; empty for a policy.
    file : PolicyFile or None
        The policy; None for a profile.
    """

    other_kinds: ClassVar = {
        "detector-policy": "a detector policy, which is no spoofer: it is given as `detector`, or "
        "in the pool of a SpooferView"
    }

    format: Literal[1] = 1
    name: str = Field(pattern=rf"^{NAME}$")
    kind: Literal["onnx-policy", "profile"]
    env_id: str = Field(min_length=1)
    env_kwargs: dict[str, Any]
    observation: Space | None
    action: Space
    conditions: Conditions
    knowledge: Knowledge
    training: dict[str, Any]
    versions: dict[str, str]
    scores: tuple[Score, ...] = ()
    rivals: tuple[dict[str, Any], ...] = ()
    settings: dict[str, Any] = Field(default_factory=dict)
    file: PolicyFile | None

    @field_validator("action")
    @classmethod
    def _check_action(cls, action: Space) -> Space:
        if set(action.low) != {-1.0} or set(action.high) != {1.0}:
            raise ValueError("an action lies within -1 and 1")
        return action

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        policy = self.kind == "onnx-policy"
        if policy and (self.file is None or self.observation is None):
            raise ValueError("`file` and `observation` of an onnx-policy must not be null")
        if policy and self.settings:
            raise ValueError(f"`settings` of an onnx-policy must be empty, got {self.settings}")
        if not policy and self.file is not None:
            raise ValueError("`file` of a profile must be null")
        return self

    def differences(self, context: SpooferContext) -> list[str]:
        on_card, of_attack = self.conditions.model_dump(), _conditions_of(context)
        if self.conditions.control == of_attack["control"] == "rate":
            del on_card["acceleration_limit_mps2"], of_attack["acceleration_limit_mps2"]
        found, controls = [], {on_card["control"], of_attack["control"]}
        if self.kind == "profile" and controls == {"acceleration", "setpoint"}:
            # the same rates come of commands of acceleration and of set-points that it follows
            for name in ("control", "setpoint_mps"):
                del on_card[name], of_attack[name]
        else:
            found = unlike_spaces(self.observation, self.action, context)
        return found + unlike(on_card, of_attack, "conditions")


def fields_of(context: SpooferContext) -> dict[str, Any]:
    """Fields of a card that follow from the context of a spoofer. Returns ``observation`` (None
    without names or bounds), ``action`` and ``conditions``."""
    return {**spaces_of(context), "conditions": _conditions_of(context)}


def _conditions_of(context: SpooferContext) -> dict[str, Any]:
    found = {name: getattr(context, name) for name in Conditions.model_fields}
    limit = found["acceleration_limit_mps2"]
    return {**found, "acceleration_limit_mps2": limit if math.isfinite(limit) else None}
