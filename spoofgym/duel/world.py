"""World of a duel where none is given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..tasks import task_of

GAME = "T3"
"""Task in whose world a duel is played by default: docs/game.md shows that it is a game.

In the world of the papers, the default of the environments of one side, it is none: a detector that
has learned for half a minute finds every attack there.
"""


def with_world(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with the world of `GAME` below them, unless they have a scenario of their own."""
    below = task_of(GAME).world_kwargs if settings.get("scenario") is None else {}
    return {**below, **settings}
