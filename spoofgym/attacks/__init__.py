"""What a spoofer can physically do to the measurements of a receiver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .._registry import build
from .base import Attack, AttackContext
from .false_position import FalsePosition
from .per_channel import PerChannel

__all__ = ["ATTACKS", "Attack", "AttackContext", "FalsePosition", "PerChannel", "make_attack"]

ATTACKS: dict[str, type[Attack]] = {"false-position": FalsePosition, "per-channel": PerChannel}
"""Attacks by name."""


def make_attack(spec: str | Mapping[str, Any] | Attack) -> Attack:
    """Attack by name, by name and settings, or a copy of an object.

    Parameters
    ----------
    spec : str, mapping or Attack
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
    return build("attack", ATTACKS, Attack, spec)
