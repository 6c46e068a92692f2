"""An entry of a leaderboard: a folder with a player, its files, and what it is said to reach."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import Field, ValidationError

from ...core.reading import read_json
from ...core.registry import parse_spec
from ...policies.card import NAME, Record, format_error
from ...policies.onnx_file import SUFFIX
from ...tasks import EVENTS, get_detector_task
from ..scores.detector import CLEAN, WINDOW
from ..scores.scores import SHARES

FILE = "entry.json"
ROUNDING = 0.01
"""Part of a figure that a claim may be rounded by."""
LARGEST_ENTRY = 2**20
"""Bytes of its file."""
FileName = Annotated[str, Field(pattern=rf"^{NAME}$")]
Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Figures = dict[str, float | dict[str, float | dict[str, float | dict[str, float]]]]

INTERVAL = dict.fromkeys(("value", "low", "high"))
EXCEEDED = {"exceeded_m": {f"{share:g}": INTERVAL for share in SHARES}}


def list_detector_figures(families: Iterable[str]) -> dict[str, Any]:
    """Figures that an audit of a detector has, without their values."""
    scored = {"p_hmi": INTERVAL, **EXCEEDED}
    return {
        **scored,
        "families": dict.fromkeys(families, scored),
        "false_alarms": dict.fromkeys((WINDOW, CLEAN, *EVENTS), INTERVAL),
        "false_alarms_per_hour": INTERVAL,
        "ages": {"missed": INTERVAL},
    }


def list_spoofer_figures(detectors: Iterable[str], others: Iterable[str]) -> dict[str, Any]:
    """The same of a spoofer, against each detector, beside other attacks."""
    rates = dict.fromkeys(("false_alarms_per_hour", "alarm_rate"), INTERVAL)
    row = {**rates, **EXCEEDED, "others": dict.fromkeys(others, EXCEEDED["exceeded_m"])}
    return {"detectors": dict.fromkeys(detectors, row)}


def list_player_files(player: str) -> set[str]:
    """Files that a player is made of, as far as its name says."""
    name = str(parse_spec(player)["name"])
    if name.endswith(SUFFIX):
        return {name, str(PurePath(name).with_suffix(".json"))}
    return {f"{name.partition(':')[0]}.py"} if ":" in name else set()


class Entry(Record):
    """What an entry says of itself: who has made a `player`, as `spoofgym audit` takes it in the
    folder, the SHA-256 of its `files`, and the `figures` of ``--json`` that it claims, by value
    alone."""

    format: Literal[1]
    suite: str
    task: str
    side: Literal["detector", "spoofer"]
    name: FileName
    who: str = Field(min_length=1, max_length=200)
    player: str = Field(min_length=1)
    files: dict[FileName, Digest]
    figures: Figures = Field(min_length=1)

    @classmethod
    def load(cls, folder: Path) -> Entry:
        """Read the entry in a folder; a ValueError says what is wrong with it or its files."""
        path = folder / FILE
        try:
            entry = cls.model_validate(read_json(path, most=LARGEST_ENTRY), strict=True)
        except ValidationError as error:
            raise ValueError(f"{path}: {format_error(error)}") from error
        suite = get_detector_task(entry.task).suite
        if entry.suite != suite:
            raise ValueError(
                f"{path}: {entry.task} is of the suite {suite!r}, not {entry.suite!r}: audit again"
            )
        for name in sorted(list_player_files(entry.player) - {*entry.files}):
            raise ValueError(f"`files` of {path} must have the digest of {name}, which it plays")
        for name, digest in entry.files.items():
            if not (folder / name).is_file():
                raise ValueError(f"{path} names the file {name}, which is not in {folder}")
            if (found := hashlib.sha256((folder / name).read_bytes()).hexdigest()) != digest:
                raise ValueError(f"{folder / name} is another file than {FILE} says: {found}")
        return entry


class Figure(NamedTuple):
    """A figure that an entry claims, beside the one that was played with its 95 % interval."""

    name: str
    claimed: float
    value: float | None
    low: float | None
    high: float | None

    @property
    def holds(self) -> bool:
        if self.low is None:
            return False
        high = math.inf if self.high is None else self.high
        return (1.0 - ROUNDING) * self.low <= self.claimed <= (1.0 + ROUNDING) * high


def compare_figures(claimed: Any, found: Any, name: str = "") -> Iterator[Figure]:
    """Compare figures that are claimed with an audit, as ``--json`` prints it, or with those that
    one will have: a ValueError for an unknown one."""
    if isinstance(found, list):  # rows, each of a detector or a family
        found = {str(row.get("family") or row.get("detector")): row for row in found}
    if not isinstance(found, Mapping):
        raise ValueError(f"an audit has no figure {name!r} with an interval")
    if isinstance(claimed, Mapping):
        for key, each in claimed.items():
            if key not in found:
                raise ValueError(f"an audit has no figure {key!r}; valid: {', '.join(found)}")
            yield from compare_figures(each, found[key], f"{name} {key}".strip())
    elif not {"value", "low", "high"} <= {*found}:
        raise ValueError(f"an audit has no figure {name!r} with an interval")
    else:
        yield Figure(name, float(claimed), *(found[key] for key in ("value", "low", "high")))
