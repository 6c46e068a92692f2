"""The detector in the loop of a plant, with others that watch beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..detectors import Detector, DetectorContext, Verdict
from ..detectors.pool import JointMemory
from ..detectors.verdicts import judged
from ..receiver.epoch import Epoch
from .witness import Watch


class WatchedDetector(Detector):
    """A detector, and others that judge the same epochs; it is the first one's verdict that counts.

    An engine has witnesses for that.  A plant has a detector alone, which is reset, moved and asked
    in the warm-up and in the time to alert: what watches goes along with it.

    `watch`: what the others have seen.
    """

    measures: ClassVar[str] = "any"

    def __init__(self, loop: Detector, watch: Sequence[Detector]) -> None:
        self.loop, self.watch = loop, Watch(watch)
        # these are the object's, not the class's
        self.paper = loop.paper  # type: ignore[misc]
        self.scope = loop.scope  # type: ignore[misc]
        self.oracle = loop.oracle  # type: ignore[misc]

    @property
    def members(self) -> tuple[Detector, ...]:
        """The detector in the loop, then those beside it."""
        return (self.loop, *self.watch.detectors)

    def bind(self, context: DetectorContext) -> None:
        """Prepare all detectors."""
        super().bind(context)
        for member in self.members:
            member.bind(context)
        self.watch.declare(context.receivers)
        parts = [*(member.memory for member in self.members), self.watch.memory]
        self.memory = JointMemory(context.receivers, parts)

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        """Forget everything about some receivers."""
        for member in self.members:
            member.reset(mask)
        self.watch.memory.reset(mask)

    def judge(self, epoch: Epoch) -> Verdict:
        """Let all of them judge."""
        verdict = judged(self.loop, epoch)
        self.watch.look(epoch)
        return verdict


def members_of(detector: Detector) -> tuple[Detector, ...]:
    """Detectors that a detector is made of.  The detector alone, unless others watch with it."""
    return detector.members if isinstance(detector, WatchedDetector) else (detector,)
