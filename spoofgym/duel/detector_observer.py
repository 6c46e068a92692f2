"""What a detector agent observes: a list of small terms of an epoch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .._memory import Memory
from ..receiver.epoch import Epoch
from .detector_terms import (
    AverageInnovation,
    ChiSquare,
    DetectorTerm,
    Elapsed,
    Innovation,
    InnovationSd,
    InView,
    PredictedMotion,
)

ALL_TERMS: tuple[DetectorTerm, ...] = (
    Innovation(),
    AverageInnovation(),
    InnovationSd(),
    ChiSquare(),
    InView(),
    PredictedMotion(),
    Elapsed(),
)
"""All terms with their default scales."""


class DetectorObserver:
    """Observations of a list of terms.

    Parameters
    ----------
    terms : sequence of DetectorTerm
        In the order of the observation.
    channels : int
        Slots.

    Attributes
    ----------
    names : tuple of str
        (o,) name of every element.
    low, high : ndarray
        (o,) float32 bounds.
    """

    def __init__(self, terms: Sequence[DetectorTerm], channels: int) -> None:
        self._parts: list[tuple[DetectorTerm, slice]] = []
        names: list[str] = []
        low: list[float] = []
        high: list[float] = []
        for term in terms:
            own, (least, most) = term.names(channels), term.bounds()
            self._parts.append((term, slice(len(names), len(names) + len(own))))
            names.extend(own)
            low.extend([least] * len(own))
            high.extend([most] * len(own))
        self.names = tuple(names)
        self.low, self.high = np.array(low, np.float32), np.array(high, np.float32)
        self._channels = channels

    def declare(self, memory: Memory) -> None:
        """Declare what the terms remember, and the observation itself, 0 before the first epoch."""
        memory.declare("observation", np.zeros((memory.receivers, len(self.names)), np.float32))
        for term, _ in self._parts:
            term.declare(memory, self._channels)

    def look(self, epoch: Epoch, memory: Memory) -> None:
        """Take in one epoch; the observation is ``memory["observation"]`` from then on."""
        out = np.empty((memory.receivers, len(self.names)), dtype=np.float32)
        for term, part in self._parts:
            term(epoch, memory, out[:, part])
        np.maximum(out, self.low, out=out)
        np.minimum(out, self.high, out=out)
        memory["observation"] = out
