"""What a spoofer can physically do to the measurements of a receiver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..core.registry import build, check_choice
from .base import Attack, AttackContext
from .commands import FalsePosition, Meaconer, PerChannel
from .equipment import Capture, CounterfeitErrors, SpooferClock, TrackingError
from .offsets import Offsets, as_offsets
from .threats import THREATS

__all__ = [
    "ATTACKS",
    "THREATS",
    "Attack",
    "AttackContext",
    "Capture",
    "CounterfeitErrors",
    "FalsePosition",
    "Meaconer",
    "Offsets",
    "PerChannel",
    "SpooferClock",
    "TrackingError",
    "as_offsets",
    "make_attack",
]

ATTACKS: dict[str, type[Attack]] = {
    "false-position": FalsePosition,
    "per-channel": PerChannel,
    "meaconer": Meaconer,
    "offsets": Offsets,
}
"""Attacks by name."""


def make_attack(spec: str | Mapping[str, Any] | Attack) -> Attack:
    """Attack by name, by name and settings, or a copy of an object.

    Parameters
    ----------
    spec : str, mapping or Attack
        A name in `ATTACKS` or in `THREATS`; ``{"name": ..., "setting": value, ...}``, which changes
        settings of a threat, and says so in its label; or an attack, which is copied.

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

    Examples
    --------
    >>> from spoofgym.attacks import make_attack
    >>> make_attack("tracking-1m").label
    'tracking-1m'
    >>> make_attack({"name": "tracking-1m", "rate_limit_mps": 1.0}).label
    'tracking-1m rate_limit_mps=1.0'
    """
    if isinstance(spec, str):
        spec = {"name": spec}
    if isinstance(spec, Mapping) and isinstance(spec.get("name"), str):
        name = spec["name"]
        check_choice("attack", name, {*ATTACKS, *THREATS})
        if name in THREATS:
            settings = {key: value for key, value in spec.items() if key != "name"}
            changed = "".join(f" {key}={settings[key]}" for key in sorted(settings))
            spec = {**THREATS[name], "threat": f"{name}{changed}", **settings}
    return build("attack", ATTACKS, Attack, spec, more=THREATS)
