"""What a policy of either side is: an observation in, an action out."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.memory import Memory
from ..core.settings import compute_digest, describe, get_kind, outside_sources

FloatArray = NDArray[np.float64]


ContextT = TypeVar("ContextT", bound=Any)  # with `receivers`, B


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


def clip_action(
    action: Any, receivers: int, size: int, policy: str, names: Sequence[str] = ()
) -> FloatArray:
    """Action of a policy, (B, a) float64, cut to [-1, 1]; `policy` names it, and `names` its
    elements, in errors."""
    array = np.array(action, dtype=np.float64, order="C")
    if array.shape != (receivers, size):
        raise ValueError(
            f"{policy} returned actions of shape {array.shape}, not {(receivers, size)}"
            + (f" ({', '.join(names)})" if names else "")
        )
    finite = np.isfinite(array)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        word = "NaN" if np.isnan(array[row, column]) else f"{array[row, column]}"
        raise NotFinite(f"{policy} returned {word} for receiver {row}")
    return np.clip(array, -1.0, 1.0)


class PolicyContext(NamedTuple):
    """What a policy is given once: names and bounds (o,) of an observation, and names (a,) of an
    action."""

    receivers: int
    interval_s: float
    observation_names: tuple[str, ...]
    observation_low: tuple[float, ...]
    observation_high: tuple[float, ...]
    action_names: tuple[str, ...]


class DetectorPolicy(Policy[PolicyContext]):
    """Decides for the detector agents of B receivers.

    A subclass declares its arrays in `bind` (``self.memory.declare(name, initial)``, with a leading
    axis of receivers) and keeps nothing else from one decision to the next.

    Attributes
    ----------
    memory : Memory
        What it remembers of every receiver.
    """

    @abstractmethod
    def decide(self, observation: NDArray[np.float32]) -> FloatArray:
        """Decide on one epoch.

        Parameters
        ----------
        observation : ndarray
            (B, o) of all receivers.

        Returns
        -------
        ndarray
            (B, a) in [-1, 1].
        """

    def digest(self) -> str | None:
        """What distinguishes this frozen policy from any other.

        Returns
        -------
        str or None
            16 hexadecimal digits, of the settings of a dataclass and of the source of its class;
            None where there is no telling, and a calibration can't be stored.
        """
        try:
            settings = describe(self)
        except TypeError:
            return None
        sources = outside_sources(self)
        if None in sources.values():
            return None
        return compute_digest(
            {"class": get_kind(type(self)), "settings": settings, "sources": sources}
        )


class FunctionPolicy(DetectorPolicy):
    """A function of the observation alone.

    Parameters
    ----------
    function : callable
        (B, o) to (B, a), in [-1, 1].
    name : str, optional
        What distinguishes it from other functions, for the store of calibrations.
    """

    def __init__(self, function: Callable[[Any], Any], name: str | None = None) -> None:
        self.function, self.name = function, name

    def decide(self, observation: NDArray[np.float32]) -> FloatArray:
        receivers, size = self.context.receivers, len(self.context.action_names)
        return clip_action(self.function(observation), receivers, size, repr(self.function))

    def digest(self) -> str | None:
        if self.name is None:
            return None
        return hashlib.sha256(self.name.encode()).hexdigest()[:16]


def as_policy(policy: Any) -> DetectorPolicy:
    if isinstance(policy, DetectorPolicy):
        return policy
    if callable(policy):
        return FunctionPolicy(policy)
    raise TypeError(
        "a detector policy is an instance of spoofgym.duel_v0.DetectorPolicy or a function of "
        f"(B, o) observations, got {policy!r}"
    )
