"""The card of a policy: a JSON file with the ONNX file, that states what the policy fits."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, NoReturn, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PositiveInt,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from ..core.files import write_file
from ..core.settings import unlike


class Record(BaseModel):
    """A frozen record that knows its fields."""

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


class State(Record):
    """What a recurrent network hands on to its next decision, 0 at the start of an episode: `size`
    elements of a receiver; its input in the ONNX file is `name`, the output ``next_NAME``."""

    name: str = Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")
    size: int = Field(ge=1, le=4096)


class PolicyFile(Record):
    """The ONNX file of a policy; `name` has no folder, `opset` is the version of the operators."""

    name: str = Field(pattern=r"^[^/\\]+\.onnx$")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    bytes: PositiveInt
    opset: PositiveInt


DECIDED_ON = "decided_on"
"""Key of `training`: entropy and split of runs that a policy was trained, fitted or chosen on."""
PAIRS = TypeAdapter(list[tuple[Annotated[int, Field(strict=True, ge=0)], str]])


def seeds_in(training: Mapping[str, Any], name: str) -> frozenset[tuple[int, str]]:
    found = training.get(DECIDED_ON, [])
    try:
        return frozenset(PAIRS.validate_python(found))
    except ValidationError:
        raise ValueError(
            f"card of {name!r}: `training.{DECIDED_ON}` must be pairs of an entropy and a "
            f'split, such as [[0, "training"]], got {found!r}'
        ) from None


class PolicyCard(Record):
    """Base of the cards of both sides; a subclass has the fields."""

    other_kinds: ClassVar[Mapping[str, str]] = {}
    """Other kinds of cards, by their field ``kind``, and where they belong."""

    name: str

    @property
    def decided_on(self) -> frozenset[tuple[int, str]]:
        return seeds_in(getattr(self, "training", {}), self.name)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
            json.loads(text, parse_constant=_refuse)
            return cls.model_validate_json(text, strict=True)
        except OSError as error:
            raise ValueError(f"there is no card {path} ({error.strerror})") from error
        except ValidationError as error:
            other = cls.other_kinds.get(_kind_of(text))
            if other is not None:
                raise ValueError(f"card {path} is that of {other}") from error
            raise ValueError(f"card {path}: {text_of(error)}") from error
        except (ValueError, RecursionError) as error:
            raise ValueError(f"card {path} is not JSON: {error}") from error

    def save(self, path: str | os.PathLike[str]) -> None:
        _ = self.decided_on  # or what is wrong with it, where it can still be mended
        try:
            text = json.dumps(self.model_dump(), indent=1, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"card of {self.name!r} can't be written: {error}") from error
        write_file(Path(path), (text + "\n").encode())


def spaces_of(given: Any) -> dict[str, Any]:
    """Fields ``observation`` (None without names or bounds) and ``action`` of a card, for the
    names and bounds that a policy is given."""
    size, observation = len(given.action_names), None
    names, low, high = given.observation_names, given.observation_low, given.observation_high
    if names and low and high:
        observation = {"names": names, "low": low, "high": high}
    action = {"names": given.action_names, "low": (-1.0,) * size, "high": (1.0,) * size}
    return {"observation": observation, "action": action}


def unlike_spaces(observation: Space | None, action: Space, given: Any) -> list[str]:
    seen = spaces_of(given)["observation"]
    found = _order("action", action, given.action_names)
    if observation is not None:
        found += _order("observation", observation, given.observation_names)
        if not found and seen is not None:
            found += unlike(observation.model_dump(), seen, "observation")
    return found


def _order(word: str, card: Space, names: tuple[str, ...]) -> list[str]:
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


def kind_at(path: str | os.PathLike[str]) -> str:
    """Kind of a card in its file, such as ``"detector-policy"``; empty where it has none."""
    try:
        return _kind_of(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        return ""


def _kind_of(text: str) -> str:
    try:
        card = json.loads(text)
    except (ValueError, RecursionError):
        return ""
    kind = card.get("kind") if isinstance(card, dict) else None
    return kind if isinstance(kind, str) else ""


def text_of(error: ValidationError) -> str:
    parts = []
    for item in error.errors():
        where = ".".join(map(str, item["loc"]))
        message = item["msg"].removeprefix("Value error, ")
        got = item["input"]
        small = got is None or isinstance(got, str | int | float)
        value = f", got {got!r}" if small and item["type"] != "missing" else ""
        parts.append(f"`{where}`: {message}{value}" if where else message)
    return "; ".join(parts)
