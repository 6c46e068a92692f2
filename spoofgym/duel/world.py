"""World of a duel where none is given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..tasks import task_of

GAME = "T3"
"""Task in whose world a duel is played by default.

The best detector that is known there still concedes part of the alert limit (docs/game.md).
"""

OPPONENT, ELSEWHERE = "solution-separation", "ewma"
"""Detector that a spoofer meets by default there, the best of `GAME`, and in any other scenario."""


def default_opponent(settings: Mapping[str, Any]) -> str:
    """Detector that a spoofer meets in a world where no pool is given."""
    return ELSEWHERE if "scenario" in given(settings) else OPPONENT


def given(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings without a scenario of None, which is as if it were not there."""
    found = dict(settings)
    if found.get("scenario") is None:
        found.pop("scenario", None)
    return found


def with_world(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with the world of `GAME` below them, unless they have a scenario of their own."""
    own = given(settings)
    return own if "scenario" in own else {**task_of(GAME).world_kwargs, **own}
