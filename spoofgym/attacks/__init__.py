"""What a spoofer can physically do to the measurements of a receiver."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

from .base import Attack, AttackContext
from .false_position import FalsePosition
from .per_channel import PerChannel

__all__ = ["ATTACKS", "Attack", "AttackContext", "FalsePosition", "PerChannel", "make_attack"]

ATTACKS: dict[str, type[Attack]] = {"false-position": FalsePosition, "per-channel": PerChannel}
"""Attacks by name."""


def make_attack(spec: str | dict[str, Any] | Attack) -> Attack:
    """Attack by name, by name and settings, or a copy of an object.

    Parameters
    ----------
    spec : str, dict or Attack
        A name in `ATTACKS`; ``{"name": ..., "setting": value, ...}``; or an attack, which is
        copied.

    Returns
    -------
    Attack
        Not bound yet.

    Raises
    ------
    ValueError
        When the name or a setting is unknown; the valid ones are listed.
    TypeError
        When `spec` is something else.
    """
    if isinstance(spec, Attack):
        return copy.deepcopy(spec)
    if isinstance(spec, str):
        spec = {"name": spec}
    if not isinstance(spec, dict) or not isinstance(spec.get("name"), str):
        raise TypeError(f"an attack is a name, a dict with a `name`, or an Attack, got {spec!r}")
    settings = dict(spec)
    name = settings.pop("name")
    if name not in ATTACKS:
        raise ValueError(f"unknown attack {name!r}; valid: {', '.join(sorted(ATTACKS))}")
    valid = [field.name for field in dataclasses.fields(ATTACKS[name])]
    for setting in settings:
        if setting not in valid:
            raise ValueError(
                f"attack {name!r} has no setting {setting!r}; valid: {', '.join(valid)}"
            )
    return ATTACKS[name](**settings)
