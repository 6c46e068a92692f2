r"""The paper's methods M3 and M4: the innovation-rate test that is given the attack.

The true offset of the true channel is added a second time to its innovation, from the true onset
on, before the rate filter sees it,

.. math:: \omega^{ST} = \frac{r + B}{\sqrt{S_{jj}}}, \qquad
    \omega^{SG} = \frac{r + a (t - t_{Lock})}{\sqrt{S_{jj}}},

so that a step of B is found as fast as one of 2 B would be.  No receiver knows B, a, the channel or
the onset; given these without an attack, it alarms all the same, and given those of another
channel, too.  They are here to reproduce the paper's figures and are part of no comparison; `glr`
holds the detectors that find channel, size and onset for themselves.

Symbols: r innovation of pseudorange j [m], S innovation covariance, B step [m], a slope [m/s],
:math:`t_{Lock}` onset [s].

Source: `ke2022`, eqs. 31 and 43.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ...receiver.epoch import Epoch
from ..base import DetectorContext
from .detector import InnovationRate

FloatArray = NDArray[np.float64]


@dataclass
class _Oracle(InnovationRate):
    """What the two have in common: which channels, and since when."""

    weight_scale: float | None = 1.0
    channels: tuple[str, ...] | None = None
    onset_s: float = 350.0

    oracle: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.onset_s < math.inf:
            raise ValueError(f"`onset_s` must be finite and >= 0, got {self.onset_s}")
        if self.channels is not None:
            self.channels = tuple(self.channels)

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        ids = context.satellite_ids
        unknown = [name for name in self.channels or () if name not in ids]
        if unknown:
            raise ValueError(
                f"`channels` names {', '.join(unknown)}; the receiver has "
                f"{', '.join(filter(None, ids))}"
            )
        self._mask = np.array([self.channels is None or name in self.channels for name in ids])

    def added(self, epoch: Epoch) -> FloatArray:
        """What is added to the innovations: (B, n) [m]."""
        since = epoch.time - self.onset_s
        offset = np.where(since >= 0.0, self.offset_m(np.maximum(since, 0.0)), 0.0)
        masked: FloatArray = offset[:, None] * self._mask
        return masked

    @abstractmethod
    def offset_m(self, since_s: FloatArray) -> FloatArray:
        """Offset of the attack.  `since_s` (B,) time since the onset [s]; returns (B,) [m]."""


@dataclass
class OracleStep(_Oracle):
    """Oracle, no detector: the innovation-rate test with a step's true size added a second time.

    Parameters
    ----------
    false_alarm, threshold, weight_scale, correlation_per_s, noise, memory_s
        As in `InnovationRate`; M3 weighs as M2 does.
    start_s, settled_s, max_exclusion_s, min_satellites, alarm_scale
        As in `InnovationRate`.
    channels : tuple of str or None
        Satellites that are attacked; None for all.
    onset_s : float
        Time of the run at which the attack starts [s].
    size_m : float
        B [m].
    """

    described_as = "OracleStep"
    size_m: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not math.isfinite(self.size_m):
            raise ValueError(f"`size_m` must be finite, got {self.size_m}")

    def offset_m(self, since_s: FloatArray) -> FloatArray:
        """Offset of the attack.  `since_s` (B,) time since the onset [s]; returns (B,) [m]."""
        return np.full_like(since_s, self.size_m)


@dataclass
class OracleRamp(_Oracle):
    """Oracle, no detector: the innovation-rate test with a ramp's true offset added once more.

    Parameters
    ----------
    false_alarm, threshold, weight_scale, correlation_per_s, noise, memory_s
        As in `InnovationRate`; M4 weighs as M2 does.
    start_s, settled_s, max_exclusion_s, min_satellites, alarm_scale
        As in `InnovationRate`.
    channels : tuple of str or None
        Satellites that are attacked; None for all.
    onset_s : float
        Time of the run at which the attack starts [s].
    rate_mps : float
        a [m/s].
    """

    described_as = "OracleRamp"
    rate_mps: float = 0.1

    def __post_init__(self) -> None:
        super().__post_init__()
        if not math.isfinite(self.rate_mps):
            raise ValueError(f"`rate_mps` must be finite, got {self.rate_mps}")

    def offset_m(self, since_s: FloatArray) -> FloatArray:
        """Offset of the attack.  `since_s` (B,) time since the onset [s]; returns (B,) [m]."""
        return self.rate_mps * since_s
