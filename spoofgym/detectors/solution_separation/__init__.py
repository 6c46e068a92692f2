"""Solution separation from a bank of coasting solutions."""

from __future__ import annotations

from .detector import SolutionSeparation

__all__ = ["SolutionSeparation"]
