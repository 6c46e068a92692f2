"""Settings as JSON, and a digest of them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Mapping
from datetime import date
from pathlib import PurePath
from typing import Any

import numpy as np


def describe(value: Any) -> Any:
    """Settings as JSON: records by their fields, arrays by a digest."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"a setting must be finite, got {value}")
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        content = np.ascontiguousarray(value)
        digest = hashlib.sha256(f"{content.dtype.str}{content.shape}".encode() + content.tobytes())
        return f"sha256:{digest.hexdigest()[:16]}"
    if isinstance(value, date):
        return value.isoformat()
    if isinstance(value, PurePath):
        return value.name
    return _describe_parts(value)


def _describe_parts(value: Any) -> Any:
    """A record, mapping or sequence as JSON."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        named = {f.name: describe(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"kind": type(value).__qualname__, **named}
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {str(key): describe(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [describe(item) for item in value]
    raise TypeError(
        f"a setting of type {type(value).__qualname__} can't be written down: {value!r}"
    )


def digest_of(config: Any) -> str:
    """Digest of a configuration, whatever the order of its keys."""
    text = json.dumps(config, sort_keys=True, allow_nan=False, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def unlike(card: Any, here: Any, where: str = "") -> list[str]:
    """Where settings differ from those on a card."""
    if isinstance(card, Mapping) and isinstance(here, Mapping):
        names = [*card, *(name for name in here if name not in card)]
        lines = []
        for name in names:
            inside = f"{where}.{name}" if where else str(name)
            lines += unlike(card.get(name), here.get(name), inside)
        return lines
    if isinstance(card, list | tuple) and isinstance(here, list | tuple):
        card, here = list(card), list(here)
    return [] if card == here else [f"{where}: {card!r} on the card, {here!r} here"]
