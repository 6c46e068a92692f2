"""The contract of a policy for the detector agent: an observation in, an action out."""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.settings import describe, digest_of, kind_of, outside_sources
from .contract import FloatArray, Policy, checked_action


class PolicyContext(NamedTuple):
    """What a policy is given once, before the first decision.

    - `observation_names` (o,) name of every element of an observation;
    - `observation_low`, `observation_high` (o,) bounds;
    - `action_names` (a,) name of every element of an action.
    """

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
        named = {"class": kind_of(type(self)), "settings": settings, "sources": sources}
        return digest_of(named)


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
        """Call the function, and check what it returns.  `observation` (B, o); returns (B, a)."""
        receivers, size = self.context.receivers, len(self.context.action_names)
        return checked_action(self.function(observation), receivers, size, repr(self.function))

    def digest(self) -> str | None:
        if self.name is None:
            return None
        return hashlib.sha256(self.name.encode()).hexdigest()[:16]


def as_policy(policy: Any) -> DetectorPolicy:
    """Policy as an object.  `policy`: a function takes (B, o) and returns (B, a)."""
    if isinstance(policy, DetectorPolicy):
        return policy
    if callable(policy):
        return FunctionPolicy(policy)
    raise TypeError(
        "a detector policy is an instance of spoofgym.duel_v0.DetectorPolicy or a function of "
        f"(B, o) observations, got {policy!r}"
    )
