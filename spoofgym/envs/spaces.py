"""Spaces of a core, and the check of an action."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ._kernels import within
from .core import Core

TOLERANCE = 1e-6


def observation_space(core: Core) -> spaces.Space[Any]:
    """Space of one receiver's observation: (o,) float32."""
    low, high = core.bounds
    return spaces.Box(low.copy(), high.copy(), dtype=np.float32)


def action_space(core: Core) -> spaces.Space[Any]:
    """Space of one receiver's action: (a,) float32 in [-1, 1]."""
    return spaces.Box(-1.0, 1.0, (len(core.action_names),), dtype=np.float32)


def checked_action(action: Any, shape: tuple[int, ...], names: tuple[str, ...]) -> NDArray[Any]:
    """Action as the engine takes it.

    `shape`: that it must have: (B, a), or (a,) of a single environment; returns that shape,
    float64, C-contiguous, a copy.
    """
    array = np.array(action, dtype=np.float64, order="C")
    if array.shape != shape:
        raise ValueError(
            f"an action must have shape {shape} ({', '.join(names)}), got {array.shape}"
        )
    if not within(array, 1.0 + TOLERANCE):
        where = tuple(np.argwhere(~(np.abs(array) <= 1.0 + TOLERANCE))[0])
        whose = f" of receiver {where[0]}" if array.ndim == 2 else ""
        raise ValueError(
            f"an action must be finite and in [-1, 1]; {names[where[-1]]!r}{whose} is "
            f"{array[where]}"
        )
    return array
