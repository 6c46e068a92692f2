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
    """Elements of an observation or of an action.

    Attributes
    ----------
    names : tuple of str
        Name of every element.
    low, high : tuple of float
        Bounds of every element.
    """

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

    Attributes
    ----------
    interval_s : float
        Time between commands.
    steps : int
        Commands of an episode.
    control : {"rate", "acceleration"}
        What is commanded.
    acceleration_limit_mps2, rate_limit_mps : float
        Of the attack; with control by rate the first one does not matter.
    """

    interval_s: PositiveFloat
    steps: PositiveInt
    control: Literal["rate", "acceleration"]
    acceleration_limit_mps2: PositiveFloat
    rate_limit_mps: PositiveFloat


class Knowledge(Record):
    """What a spoofer knows.

    Attributes
    ----------
    run_time : {"blind", "tracking", "oracle"}
        What it observes during an attack.
    design_time : str
        What it was optimised on before: detector, receiver, scenario.
    """

    run_time: Literal["blind", "tracking", "oracle"]
    design_time: str = Field(min_length=1)


class PolicyFile(Record):
    """The ONNX file of a policy.

    Attributes
    ----------
    name : str
        File name, without a folder.
    sha256 : str
        Digest of its content, 64 hexadecimal digits.
    bytes : int
        Its size.
    opset : int
        Version of the ONNX operators.
    """

    name: str = Field(pattern=r"^[^/\\]+\.onnx$")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    bytes: PositiveInt
    opset: PositiveInt


class Score(Record):
    """What a spoofer reached against one detector.

    Attributes
    ----------
    detector : str
        Its label.
    split : str
        Which seeds: those of training, calibration or evaluation.
    entropy : int
        Of the seeds.
    runs : int
        How many.
    undetected_displacement_m : float
        Mean over all runs.
    low, high : float
        95 % interval of the mean [m].
    alarm_rate, clean_alarm_rate : float
        Parts of the runs with an alarm, under attack and without.
    budget : float
        How much more often than without attack an alarm may come.
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
    """Kind that a card says.

    Parameters
    ----------
    text : str
        Of the card.

    Returns
    -------
    str or None
        None where it says none.
    """
    try:
        card = json.loads(text)
    except ValueError:
        return None
    kind = card.get("kind") if isinstance(card, dict) else None
    return kind if isinstance(kind, str) else None


def told(error: ValidationError) -> str:
    """What is wrong with which fields, in one line.

    Parameters
    ----------
    error : ValidationError
        Of a card.

    Returns
    -------
    str
        For a message.
    """
    parts = []
    for item in error.errors():
        where = ".".join(map(str, item["loc"]))
        message = item["msg"].removeprefix("Value error, ")
        got = item["input"]
        small = got is None or isinstance(got, str | int | float)
        told = f", got {got!r}" if small and item["type"] != "missing" else ""
        parts.append(f"`{where}`: {message}{told}" if where else message)
    return "; ".join(parts)
