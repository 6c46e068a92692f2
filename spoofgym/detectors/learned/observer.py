"""Observations of a learned detector: all terms of an epoch, and the terms by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..._describe import describe
from ..._memory import Memory
from ..._registry import build
from ...receiver.epoch import Epoch
from ..base import DetectorContext
from .classic import Classic
from .terms import (
    AverageInnovation,
    ChiSquare,
    DetectorTerm,
    Elapsed,
    ExclusionLeft,
    Innovation,
    InnovationSd,
    InView,
    LineOfSight,
    PredictedMotion,
)

DETECTOR_TERMS: dict[str, type[DetectorTerm]] = {
    "average-innovation": AverageInnovation,
    "chi-square": ChiSquare,
    "classic": Classic,
    "elapsed": Elapsed,
    "exclusion-left": ExclusionLeft,
    "in-view": InView,
    "innovation": Innovation,
    "innovation-sd": InnovationSd,
    "line-of-sight": LineOfSight,
    "predicted-motion": PredictedMotion,
}
"""Terms of a learned detector's observation by name."""
ALL_TERMS: tuple[DetectorTerm, ...] = (
    Innovation(),
    AverageInnovation(),
    InnovationSd(),
    ChiSquare(),
    InView(),
    PredictedMotion(),
    Elapsed(),
)
"""Those that are observed by default, with their scales; what is left of the allowance follows."""
TermSpec = str | Mapping[str, Any] | DetectorTerm


def make_detector_terms(specs: Iterable[TermSpec] | TermSpec) -> tuple[DetectorTerm, ...]:
    """Terms from names, names and settings, or objects.

    Parameters
    ----------
    specs : str, mapping, DetectorTerm, or a sequence of them
        A name in `DETECTOR_TERMS`; ``{"name": ..., "setting": value, ...}``; or an object.

    Returns
    -------
    tuple of DetectorTerm
        In the order given.

    Raises
    ------
    ValueError
        When a name or a setting is unknown; the valid ones are listed.
    TypeError
        When something is no term.

    Examples
    --------
    >>> make_detector_terms(["in-view", {"name": "elapsed", "scale_s": 60.0}])
    (InView(), Elapsed(scale_s=60.0))
    """
    several = [specs] if isinstance(specs, str | Mapping | DetectorTerm) else list(specs)
    if not several:
        raise ValueError(f"`terms` must name at least one of {', '.join(sorted(DETECTOR_TERMS))}")
    return tuple(build("detector term", DETECTOR_TERMS, DetectorTerm, each) for each in several)


def written_terms(terms: Sequence[DetectorTerm]) -> tuple[dict[str, Any], ...]:
    """Terms as `make_detector_terms` takes them, JSON-able."""
    names = {kind: name for name, kind in DETECTOR_TERMS.items()}
    found = []
    for term in terms:
        each: Any = term
        if type(term) not in names:
            raise TypeError(
                f"{type(term).__qualname__} has no name in `DETECTOR_TERMS`, by which a card could "
                "list it"
            )
        settings = {f.name: describe(getattr(each, f.name)) for f in dataclasses.fields(each)}
        found.append({"name": names[type(term)], **settings})
    return tuple(found)


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
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"`terms` observe the same twice: {', '.join(twice[:4])}")
        self.names = tuple(names)
        self.low, self.high = np.array(low, np.float32), np.array(high, np.float32)
        self._channels = channels

    def bind(self, context: DetectorContext) -> list[Memory]:
        """Bind the terms to a batch.  Returns what some of them remember by themselves."""
        self._parts = [(term.bound(context), part) for term, part in self._parts]
        own = [getattr(term, "memory", None) for term, _ in self._parts]
        return [memory for memory in own if memory is not None]

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
