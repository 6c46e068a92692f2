"""World of a duel where none is given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..tasks import task_of

GAME = "T3"
"""Task in whose world a duel is played by default.

The best detector that is known there still concedes part of the alert limit (docs/game.md).
"""


def with_world(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with the world of `GAME` below them, unless they have a scenario of their own."""
    if settings.get("scenario") is not None:
        return dict(settings)
    given = {name: value for name, value in settings.items() if name != "scenario"}
    return {**task_of(GAME).world_kwargs, **given}
