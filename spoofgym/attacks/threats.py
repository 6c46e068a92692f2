"""Threats by name: attacks with their settings, from an ideal spoofer to one that only replays."""

from __future__ import annotations

from typing import Any

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
