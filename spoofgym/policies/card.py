"""The card of a learned policy or of a shipped profile: a JSON file that states what it fits.

One format for both sides, with the field ``side``; format 1, of which the field ``kind`` alone says
the side, is read, too.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    TypeAdapter,
    ValidationError,
    field_validator,
    model_validator,
)

from ..core.files import write_file
from ..core.reading import FileError, read_json
from ..core.settings import format_card_diff

SPOOFER, DETECTOR = "spoofer", "detector"
"""Sides of a card."""
NAME = r"[A-Za-z0-9][A-Za-z0-9._-]*"  # what a spoofer with a card may be called
FORMAT = 2
BETWEEN = ("hold", "linear")
"""What is commanded between two decisions."""
LARGEST_CARD = 2**22  # [bytes]
SIDES = {"onnx-policy": SPOOFER, "profile": SPOOFER, "detector-policy": DETECTOR}
"""Of the kinds of cards, which is all that format 1 has of a side."""


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


def parse_seeds(training: Mapping[str, Any], name: str) -> frozenset[tuple[int, str]]:
    found = training.get(DECIDED_ON, [])
    try:
        return frozenset(PAIRS.validate_python(found))
    except ValidationError:
        raise ValueError(
            f"card of {name!r}: `training.{DECIDED_ON}` must be pairs of an entropy and a "
            f'split, such as [[0, "training"]], got {found!r}'
        ) from None


class Card(Record):
    """What the cards of both sides have in common; `load` reads either."""

    format: int
    side: str
    name: str
    kind: str
    observation: Space | None
    action: Space
    file: PolicyFile | None

    own_side: ClassVar[str | None] = None
    where: ClassVar[str]
    """What a card of this side is, and where it belongs, in the error where the other is needed."""

    @property
    def decided_on(self) -> frozenset[tuple[int, str]]:
        """Entropy and split of the runs that it was trained, fitted or chosen on."""
        return parse_seeds(getattr(self, "training", {}), self.name)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a card, of either side by `Card`; a ValueError says what is wrong with it."""
        path = Path(path)
        try:
            fields = read_json(path, object, LARGEST_CARD)
        except OSError as error:
            raise ValueError(f"there is no card {path} ({error.strerror})") from error
        except FileError as error:
            raise FileError(f"card {error}") from error
        fields = _upgrade_fields(fields)
        side = fields.get("side") if isinstance(fields, dict) else None
        found = CARDS.get(side) if isinstance(side, str) else None
        if found is None and cls is Card:
            raise ValueError(f"card {path}: `side` must be one of {', '.join(CARDS)}, got {side!r}")
        if found is not None and not issubclass(found, cls):
            raise ValueError(f"card {path} is that of {found.where}")
        try:
            return (found or cls).model_validate_json(json.dumps(fields), strict=True)
        except ValidationError as error:
            raise ValueError(f"card {path}: {format_error(error)}") from error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the card; nothing is written where it can't be read back."""
        _ = self.decided_on  # or what is wrong with it, where it can still be mended
        try:
            text = json.dumps(self.model_dump(), indent=1, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ValueError(f"card of {self.name!r} can't be written: {error}") from error
        write_file(Path(path), (text + "\n").encode())


class AttackConditions(Record):
    """What an attack has to be like for the actions to mean what they meant; with control by rate
    the limit of the acceleration does not matter, and may be None."""

    interval_s: PositiveFloat
    steps: PositiveInt
    control: Literal["rate", "acceleration", "setpoint", "offset"]
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


class SpooferCard(Card):
    """The card of a spoofer, on disk a JSON file with its policy.

    Attributes
    ----------
    format : int
        Of the card: 2; cards of format 1 are read, too.
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

    own_side: ClassVar = SPOOFER
    where: ClassVar = (
        "a spoofer, which is no detector policy: it belongs into the pool of a DetectorView"
    )

    format: Literal[2] = 2
    side: Literal["spoofer"] = "spoofer"
    name: str = Field(pattern=rf"^{NAME}$")
    kind: Literal["onnx-policy", "profile"]
    env_id: str = Field(min_length=1)
    env_kwargs: dict[str, Any]
    observation: Space | None
    action: Space
    conditions: AttackConditions
    knowledge: Knowledge
    training: dict[str, Any]
    versions: dict[str, str]
    scores: tuple[Score, ...] = ()
    rivals: tuple[dict[str, Any], ...] = ()
    settings: dict[str, Any] = Field(default_factory=dict)
    file: PolicyFile | None

    @field_validator("env_kwargs")
    @classmethod
    def _check_env_kwargs(cls, given: dict[str, Any]) -> dict[str, Any]:
        """What a policy reads without its environment, which checks the rest."""
        for name in given:
            if not name.isidentifier():
                raise ValueError(f"must be settings of an environment, got {name!r}")
        interval = given.get("decision_interval_s")
        number = isinstance(interval, int | float) and not isinstance(interval, bool)
        if interval is not None and not (number and 0.0 < interval < math.inf):
            raise ValueError(f"`decision_interval_s` must be above 0 and finite, got {interval!r}")
        if given.get("between", "hold") not in BETWEEN:
            valid = " or ".join(map(repr, BETWEEN))
            raise ValueError(f"`between` must be {valid}, got {given['between']!r}")
        return given

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

    def diff_context(self, context: Any) -> list[str]:
        on_card, of_attack = self.conditions.model_dump(), _describe_conditions(context)
        if self.conditions.control == of_attack["control"] == "rate":
            del on_card["acceleration_limit_mps2"], of_attack["acceleration_limit_mps2"]
        found, controls = [], {on_card["control"], of_attack["control"]}
        if self.kind == "profile" and controls == {"acceleration", "setpoint"}:
            # the same rates come of commands of acceleration and of set-points that it follows
            for name in ("control", "setpoint_mps"):
                del on_card[name], of_attack[name]
        else:
            found = diff_spaces(self.observation, self.action, context)
        return found + format_card_diff(on_card, of_attack, "conditions")


class DetectorCard(Card):
    """The card of a learned detector, on disk a JSON file with its ONNX file.

    Attributes
    ----------
    format : int
        Of the card: 2; cards of format 1 are read, too.
    name : str
        Of the detector.
    kind : str
        ``"detector-policy"``.
    observation, action : Space
        What it observes and decides.
    statistic : {"receiver", "channel"}
        One statistic, or one for every slot.
    weighs : bool
        Whether it weighs satellites.
    exclusion_s : float or None
        Allowance of exclusion in an episode.
    decision_delay : {0, 1}
        Whether it judges an epoch by a decision on itself, or by one on the epoch before.
    terms : tuple of dict or None
        What it observes, as `make_detector_terms` takes it; None for those of the duel.
    state : tuple of State
        What a recurrent network hands on from one epoch to the next; empty for a plain one.
    quiet_epochs : int or None
        Epochs after it is switched on in which it does not decide, as in the monitored warm-up of
        the duel that it was made in.  None on older cards: the warm-up of a duel in its pools, 0
        elsewhere.
    channels : int or None
        Slots of the receiver that it was made for; None on older cards.
    interval_s : float or None
        Time between epochs that it was made for [s]; None on older cards, for any.
    threshold : float or None
        Calibrated; None where that has not been done.
    calibration : dict
        How: interval, runs, false-alarm rate; empty without one.
    training : dict
        How it was made.
    file : PolicyFile
        The policy.
    """

    own_side: ClassVar = DETECTOR
    where: ClassVar = (
        "a detector policy, which is no spoofer: it is given as `detector`, or in the pool of a "
        "SpooferView"
    )

    format: Literal[2] = 2
    side: Literal["detector"] = "detector"
    name: str = Field(min_length=1)
    kind: Literal["detector-policy"] = "detector-policy"
    observation: Space
    action: Space
    statistic: Literal["receiver", "channel"]
    weighs: bool
    exclusion_s: float | None = Field(default=None, ge=0.0)
    decision_delay: Literal[0, 1]
    terms: tuple[dict[str, Any], ...] | None = Field(default=None, min_length=1)
    state: tuple[State, ...] = ()
    quiet_epochs: int | None = Field(default=None, ge=0)
    channels: int | None = Field(default=None, ge=1)
    interval_s: float | None = Field(default=None, gt=0.0)
    threshold: float | None = Field(default=None, gt=0.0, le=1.0)
    calibration: dict[str, Any] = Field(default_factory=dict)
    training: dict[str, Any] = Field(default_factory=dict)
    file: PolicyFile

    @model_validator(mode="after")
    def _check(self) -> Self:
        names = [each.name for each in self.state]
        if len(set(names)) < len(names):
            raise ValueError(f"names of `state` must differ, got {', '.join(names)}")
        return self


CARDS: dict[str, type[Card]] = {SPOOFER: SpooferCard, DETECTOR: DetectorCard}
"""By side."""


def describe_spaces(given: Any) -> dict[str, Any]:
    """Fields ``observation`` (None without names or bounds) and ``action`` of a card, for the
    names and bounds that a policy is given."""
    size, observation = len(given.action_names), None
    names, low, high = given.observation_names, given.observation_low, given.observation_high
    if names and low and high:
        observation = {"names": names, "low": low, "high": high}
    action = {"names": given.action_names, "low": (-1.0,) * size, "high": (1.0,) * size}
    return {"observation": observation, "action": action}


def diff_spaces(observation: Space | None, action: Space, given: Any) -> list[str]:
    seen = describe_spaces(given)["observation"]
    found = _order("action", action, given.action_names)
    if observation is not None:
        found += _order("observation", observation, given.observation_names)
        if not found and seen is not None:
            found += format_card_diff(observation.model_dump(), seen, "observation")
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


def describe_context(context: Any) -> dict[str, Any]:
    """Fields of a card that follow from the context of a spoofer. Returns ``observation`` (None
    without names or bounds), ``action`` and ``conditions``."""
    return {**describe_spaces(context), "conditions": _describe_conditions(context)}


def _describe_conditions(context: Any) -> dict[str, Any]:
    found = {name: getattr(context, name) for name in AttackConditions.model_fields}
    limit = found["acceleration_limit_mps2"]
    return {**found, "acceleration_limit_mps2": limit if math.isfinite(limit) else None}


def _upgrade_fields(fields: Any) -> Any:
    """Fields of a card of format 1 as this format has them."""
    if not isinstance(fields, dict) or "side" in fields or fields.get("format", 1) != 1:
        return fields
    side = SIDES.get(str(fields.get("kind")))
    return {**fields, "format": FORMAT, **({"side": side} if side else {})}


def format_error(error: ValidationError) -> str:
    parts = []
    for item in error.errors():
        where = ".".join(map(str, item["loc"]))
        message = item["msg"].removeprefix("Value error, ")
        got = item["input"]
        small = got is None or isinstance(got, str | int | float)
        value = f", got {got!r}" if small and item["type"] != "missing" else ""
        parts.append(f"`{where}`: {message}{value}" if where else message)
    return "; ".join(parts)
