"""What policies of both sides have in common: an observation in, an action out."""

from __future__ import annotations

from abc import ABC
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.memory import Memory

FloatArray = NDArray[np.float64]


class Context(Protocol):
    """What a policy is given once, before its first action."""

    @property
    def receivers(self) -> int:
        """B."""


ContextT = TypeVar("ContextT", bound=Context)


class Policy(ABC, Generic[ContextT]):
    """A policy with memory of B receivers."""

    context: ContextT
    memory: Memory

    def bind(self, context: ContextT) -> None:
        """Prepare for a batch of receivers; call ``super().bind(context)`` first.

        Parameters
        ----------
        context : SpooferContext or PolicyContext
            Sizes, names and bounds.
        """
        self.context = context
        self.memory = Memory(context.receivers)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Start a new episode in some receivers.

        Parameters
        ----------
        mask : ndarray, optional
            (B,) bool, which ones; all by default.
        """
        self.memory.reset(mask)


class NotFinite(ValueError):
    """A policy returned NaN or an infinite action."""


def checked_action(action: Any, receivers: int, size: int, policy: str) -> FloatArray:
    """Action of a policy, (B, a) float64, cut to [-1, 1]; `policy` names it in errors."""
    array = np.array(action, dtype=np.float64, order="C")
    if array.shape != (receivers, size):
        raise ValueError(
            f"{policy} returned actions of shape {array.shape}, not {(receivers, size)}"
        )
    finite = np.isfinite(array)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        word = "NaN" if np.isnan(array[row, column]) else f"{array[row, column]}"
        raise NotFinite(f"{policy} returned {word} for receiver {row}")
    return np.clip(array, -1.0, 1.0)
