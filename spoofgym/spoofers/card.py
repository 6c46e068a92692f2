"""The card of a shipped or exported spoofer: what it fits, what it knows, and how it was made."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, Literal, NoReturn, Self

from pydantic import Field, ValidationError, field_validator, model_validator

from .._describe import unlike
from .._files import write_file
from .base import SpooferContext
from .card_parts import Conditions, Knowledge, PolicyFile, Record, Score, Space, kind_of, told

NAME = r"[A-Za-z0-9][A-Za-z0-9._-]*"
"""What a spoofer with a card may be called."""


class Card(Record):
    """The card of a spoofer, on disk a JSON file beside its policy.

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
        What `gymnasium.make` takes beside the id.
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

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a card."""
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
            json.loads(text, parse_constant=_refuse)
            return cls.model_validate_json(text, strict=True)
        except OSError as error:
            raise ValueError(f"there is no card {path} ({error.strerror})") from error
        except ValidationError as error:
            if kind_of(text) == "detector-policy":
                raise ValueError(
                    f"card {path} is that of a detector policy, which is no spoofer: it belongs "
                    "into the pool of a SpooferView"
                ) from error
            raise ValueError(f"card {path}: {told(error)}") from error
        except ValueError as error:
            raise ValueError(f"card {path} is not JSON: {error}") from error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the card, whole or not at all."""
        try:
            text = json.dumps(self.model_dump(), indent=1, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"card of {self.name!r} can't be written: {error}") from error
        write_file(Path(path), (text + "\n").encode())

    def differences(self, context: SpooferContext) -> list[str]:
        """What an attack is like here, and not on the card."""
        here = fields_of(context)
        seen, card = here["observation"], self.model_dump()
        found = _order("action", self.action, context.action_names)
        if self.observation is not None:
            found += _order("observation", self.observation, context.observation_names)
            if not found and seen is not None:
                found += unlike(card["observation"], seen, "observation")
        on_card, of_attack = card["conditions"], here["conditions"]
        if self.conditions.control == of_attack["control"] == "rate":
            del on_card["acceleration_limit_mps2"], of_attack["acceleration_limit_mps2"]
        return found + unlike(on_card, of_attack, "conditions")


def fields_of(context: SpooferContext) -> dict[str, Any]:
    """Fields of a card that follow from what a spoofer is told.

    Returns ``observation`` (None without names or bounds), ``action`` and ``conditions``.
    """
    names, size = context.observation_names, len(context.action_names)
    observation = None
    if names and context.observation_low and context.observation_high:
        low, high = context.observation_low, context.observation_high
        observation = {"names": names, "low": low, "high": high}
    return {
        "observation": observation,
        "action": {"names": context.action_names, "low": (-1.0,) * size, "high": (1.0,) * size},
        "conditions": {name: getattr(context, name) for name in Conditions.model_fields},
    }


def _order(word: str, card: Space, names: tuple[str, ...]) -> list[str]:
    """What is missing, added or moved among names."""
    missing = [name for name in card.names if name not in names]
    added = [name for name in names if name not in card.names]
    lines = [
        f"{word}: {', '.join(some[:4])}{', ...' if len(some) > 4 else ''} {where}"
        for some, where in ((missing, "only on the card"), (added, "only here"))
        if some
    ]
    if not lines and names != card.names:
        lines = [f"{word}: the same names in another order"]
    return lines


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number")
