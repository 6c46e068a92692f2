"""What a small environment simulates: world, victim, attack and detector of B receivers, in step.

The tightly coupled receiver has an engine of its own (`engine`).  The others, whose epochs are
cheap, are plants: one class each, played by `plant_game` and seen by Gymnasium through
`plant_env`.  All memory of a plant lies in one `Memory` and in its detector's, so that receivers
can be reset, taken out and put back by rows.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from ..detectors import Detector, DetectorContext
from .setup import check_settles
from .watched import members_of

FloatArray = NDArray[np.float64]


class Plant(ABC):
    """B receivers of one kind, each in its own episode.

    A subclass sets all attributes when it is made, binds its own copy of the detector, and keeps
    what changes from one epoch to the next in `memory` alone.  A receiver has the same bits in any
    batch: kernels go receiver by receiver, and its noise is keyed by its own generator.

    - `kind`: name in results, such as ``"snapshot"``;
    - `steps`, `hold`: commands of an episode, and epochs of the time to alert after the last one;
    - `action_names`: what each element of the action commands, with its unit;
    - `unbound`: as it was given; `spawn` binds a copy of it;
    - `memory`: everything else that an episode changes.
    """

    kind: ClassVar[str]
    receivers: int
    steps: int
    hold: int
    interval_s: float
    action_names: tuple[str, ...]
    unbound: Detector
    detector: Detector
    memory: Memory

    @abstractmethod
    def spawn(self, receivers: int) -> Plant:
        """Another batch of the same settings, not begun yet."""

    def altered(self, detector: Detector) -> Plant:
        """A batch of the same settings with another detector, not begun yet."""
        other = copy.copy(self)
        other.unbound = detector
        return other.spawn(self.receivers)

    def action_limits(self) -> FloatArray:
        """What an action of 1 commands, where it is not the same for all elements.

        Returns (a,) in the unit of each; all 1 where they are alike.
        """
        return np.ones(len(self.action_names))

    @abstractmethod
    def begin(self, rngs: Sequence[np.random.Generator]) -> NDArray[np.bool_]:
        """Begin new episodes in all receivers, and run their clean warm-up up to the onset.

        `rngs`: one per receiver; children are spawned of each, nothing else is drawn from it;
        returns (B,) bool, whether the detector alarmed before the onset.
        """

    @abstractmethod
    def advance(self, action: FloatArray | None) -> NDArray[np.bool_]:
        """Run one epoch: attack, measure, judge, update.

        A receiver whose episode is over, the time to alert included, may be advanced once more
        beside others before it begins anew; a plant keeps that epoch to spare.

        `action` (B, a) in [-1, 1], C-contiguous; None holds what is commanded; returns (B,) bool,
        whether the detector alarms.
        """

    @abstractmethod
    def error_ne(self) -> FloatArray:
        """Error of the victim's position, estimate minus truth: (B, 2) north, east [m]."""

    @abstractmethod
    def time_s(self) -> FloatArray:
        """Time of the present epoch: (B,) [s]."""

    @abstractmethod
    def observation(self, knowledge: str) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
        """What a level of knowledge observes.

        Returns `names` (o,) one per element; `low`, `high` (o,) finite bounds.
        """

    @abstractmethod
    def observe(self, knowledge: str, out: NDArray[np.float32]) -> None:
        """Write the observation; clipping follows.  `out` (B, o), written."""

    def copy_rows(self, to: NDArray[np.intp], other: Plant, rows: NDArray[np.intp]) -> None:
        """Take over receivers of another batch, with all that they remember.

        `to`: rows of this batch that are overwritten.
        """
        self.memory.copy_rows(to, other.memory, rows)
        self.detector.memory.copy_rows(to, other.detector.memory, rows)


def bound(
    unbound: Detector, context: DetectorContext, epochs: int, whose: str, has: frozenset[str]
) -> Detector:
    """Copy of a detector, ready for the receivers of a plant."""
    detector = copy.deepcopy(unbound)
    for member in members_of(detector):
        missing = member.needs - has
        if missing:
            raise ValueError(
                f"{type(member).__name__} needs {', '.join(sorted(missing))}, which {whose} does "
                "not have"
            )
    detector.bind(context)
    for member in members_of(detector):
        check_settles(member, epochs)
    return detector
