"""Parts of the card of a spoofer."""

from __future__ import annotations

import json
from typing import Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    ValidationError,
    model_validator,
)


class Record(BaseModel):
    """What knows its fields, and can't be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Space(Record):
    """Elements of an observation or of an action."""

    names: tuple[str, ...] = Field(min_length=1)
    low: tuple[float, ...]
    high: tuple[float, ...]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(set(self.names)) < len(self.names):
            raise ValueError("`names` must differ from each other")
        if not len(self.names) == len(self.low) == len(self.high):
            raise ValueError(
                f"`names`, `low` and `high` must be of the same length, got {len(self.names)}, "
                f"{len(self.low)} and {len(self.high)}"
            )
        for name, low, high in zip(self.names, self.low, self.high, strict=True):
            if not low < high:
                raise ValueError(f"`low` of {name} must be below `high`, got {low} and {high}")
        return self


class Conditions(Record):
    """What an attack has to be like for the actions to mean what they meant.

    `acceleration_limit_mps2`, `rate_limit_mps`: of the attack; with control by rate the first one
    does not matter.
    """

    interval_s: PositiveFloat
    steps: PositiveInt
    control: Literal["rate", "acceleration"]
    acceleration_limit_mps2: PositiveFloat
    rate_limit_mps: PositiveFloat


class Knowledge(Record):
    """What a spoofer knows.

    `run_time`: what it observes during an attack; `design_time`: what it was optimised on before:
    detector, receiver, scenario.
    """

    run_time: Literal["blind", "tracking", "oracle"]
    design_time: str = Field(min_length=1)


class PolicyFile(Record):
    """The ONNX file of a policy.

    - `name`: file name, without a folder;
    - `sha256`: digest of its content, 64 hexadecimal digits;
    - `opset`: version of the ONNX operators.
    """

    name: str = Field(pattern=r"^[^/\\]+\.onnx$")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    bytes: PositiveInt
    opset: PositiveInt


class Score(Record):
    """What a spoofer reached against one detector.

    - `split`: which seeds: those of training, calibration or evaluation;
    - `low`, `high`: 95 % interval of the mean [m];
    - `alarm_rate`, `clean_alarm_rate`: parts of the runs with an alarm, under attack and without;
    - `budget`: how much more often than without attack an alarm may come.
    """

    detector: str
    split: str
    entropy: NonNegativeInt
    runs: PositiveInt
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


def kind_of(text: str) -> str | None:
    """Kind that a card says."""
    try:
        card = json.loads(text)
    except ValueError:
        return None
    kind = card.get("kind") if isinstance(card, dict) else None
    return kind if isinstance(kind, str) else None


def told(error: ValidationError) -> str:
    """What is wrong with which fields, in one line."""
    parts = []
    for item in error.errors():
        where = ".".join(map(str, item["loc"]))
        message = item["msg"].removeprefix("Value error, ")
        got = item["input"]
        small = got is None or isinstance(got, str | int | float)
        told = f", got {got!r}" if small and item["type"] != "missing" else ""
        parts.append(f"`{where}`: {message}{told}" if where else message)
    return "; ".join(parts)
