"""What a spoofer can physically do to the measurements of a receiver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..core.registry import build, check_choice
from .base import Attack, AttackContext
from .commands import FalsePosition, Meaconer, PerChannel
from .equipment import Capture, CounterfeitErrors, SpooferClock, TrackingError
from .offsets import Offsets, as_offsets

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
THREATS: dict[str, dict[str, Any]] = {
    "paper-ideal": {"name": "per-channel"},
    "pseudorange-only": {"name": "per-channel", "coherent": False},
    "false-position-ideal": {"name": "false-position"},
    "tracking-1m": {
        "name": "false-position",
        "tracking": {"sd_m": 1.0, "correlation_s": 30.0},
    },
    "quiet": {"name": "false-position", "errors": "quiet"},
    "partial-constellation": {"name": "false-position", "channels": "E*"},
    "meaconer": {
        "name": "meaconer",
        "antenna_m": [0.0, 20.0, 0.0],
        "follows": True,
    },
}
"""What `make_attack` makes of each name: the attack and its settings, which fit into JSON.

``paper-ideal``
    The five papers' spoofer: an offset on every pseudorange, authentic errors inherited.
``pseudorange-only``
    The same with the code alone, which drifts away from the carrier.
``false-position-ideal``
    One false position, with perfect knowledge of the true one.
``tracking-1m``
    A false position by a spoofer that tracks its target to 1 m along each axis.
``quiet``
    A false position whose signals have thermal noise alone, blended in over 30 s.
``partial-constellation``
    A false position by one of two constellations, the one whose ids begin with E; it needs a world
    that has it, such as ``trolley-two-constellations``.
``meaconer``
    Record and replay by an antenna at the target's side, 20 m east of it.
"""


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
