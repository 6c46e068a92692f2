"""What a classic detector says of an epoch, as an observation of a learned one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from ..._memory import Memory
from ...receiver.epoch import Epoch
from ..base import Detector, DetectorContext
from ..calibrated import Calibrated
from ..pool import PooledDetector
from ..verdicts import judged
from .terms import DetectorTerm, Written, slots

LARGEST = 5.0
"""Largest logarithm of a ratio; e^5 is 148."""


@dataclass(frozen=True)
class Classic(DetectorTerm):
    r"""Logarithm of a passive detector's statistic over its nominal threshold.

    .. math:: \ln (\text{statistic} / \text{threshold}), \text{ within } -5 \text{ and } 5

    One value where it judges the receiver as a whole, else one for every slot; -5 where the
    statistic is 0, as where a slot is invisible.

    Parameters
    ----------
    detector : str or mapping
        As `make_detector` takes it, without a word on thresholds, such as
        ``{"name": "solution-separation"}``.  It must not take weight off measurements: for `ewma`
        that is ``{"name": "ewma", "weight_scale": None}``.
    label : str, optional
        What it is called in the names of the observation; by default as its detector.
    """

    described_as = "Classic"
    detector: str | Mapping[str, Any] = "snapshot-chi2"
    label: str | None = None

    _judge: ClassVar[Detector]

    def __post_init__(self) -> None:
        from .. import DETECTORS, make_detector

        made = make_detector(self.detector)
        kinds = {kind: name for name, kind in DETECTORS.items()}
        if isinstance(made, Calibrated | PooledDetector) or type(made) not in kinds:
            raise ValueError(
                "`detector` of a classic term must be one of the package with its nominal "
                f"thresholds, and neither a pool nor a learned one, got {self.detector!r}"
            )
        if made.oracle:
            raise ValueError(
                f"`detector` of a classic term must be no oracle, got {self.detector!r}"
            )
        if isinstance(self.detector, str):
            object.__setattr__(self, "detector", {"name": self.detector})
        object.__setattr__(self, "_judge", made)
        object.__setattr__(self, "needs", made.needs)
        if self.label is None:
            object.__setattr__(self, "label", kinds[type(made)].replace("-", "_"))

    def names(self, channels: int) -> tuple[str, ...]:
        """``classic_`` and the name of the detector."""
        word = f"classic_{self.label}"
        return slots(word, channels) if self._judge.scope == "channel" else (word,)

    def bounds(self) -> tuple[float, float]:
        """-5 and 5."""
        return -LARGEST, LARGEST

    def bound(self, context: DetectorContext) -> Self:
        own = replace(self)
        own._judge.bind(context)
        return own

    @property
    def memory(self) -> Memory:
        """What its detector remembers."""
        return self._judge.memory

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        verdict = judged(self._judge, epoch)
        if verdict.weights is not None:
            raise ValueError(
                f"`detector` of a classic term must be passive, and {self.detector!r} takes weight "
                "off measurements; where it has a `weight_scale`, give it None"
            )
        least = np.exp(-LARGEST) * verdict.threshold
        np.log(np.maximum(verdict.statistic, least) / verdict.threshold, out=out, casting="unsafe")
