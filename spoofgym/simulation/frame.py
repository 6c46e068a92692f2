"""What a picture shows of one receiver; all truth, and nothing that an agent gets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


class SkyData(NamedTuple):
    """The satellites over one receiver, by slot (n,). Angles in radians; `spoofed` where the
    spoofer changes the signal; `weight` of the pseudorange in the receiver, 0 where the detector
    excludes it; `names` is ``""`` for an empty slot."""

    names: tuple[str, ...]
    azimuth: FloatArray
    elevation: FloatArray
    visible: NDArray[np.bool_]
    spoofed: NDArray[np.bool_]
    weight: FloatArray


class FrameData(NamedTuple):
    """One receiver at one instant. `position_ne` (2,) true position from that at the onset,
    `error_ne` (2,) estimate minus truth, `displacement_ne` (2,) commanded, None where the spoofer
    commands no position [m]; `ratio` the largest statistic over its threshold, NaN before the first
    verdict; `sky` None where the receiver takes positions."""

    position_ne: FloatArray
    error_ne: FloatArray
    displacement_ne: FloatArray | None
    ratio: float
    sky: SkyData | None


class EpisodeLayout(NamedTuple):
    """What stays the same in a picture for a whole episode. `track_ne` (K, 2) is the true ground
    track from the onset to the end of the time to alert [m]; `onset_s` the time of the onset."""

    title: str
    track_ne: FloatArray
    interval_s: float
    steps: int
    attack_s: float
    hold_s: float
    onset_s: float
    commands_position: bool
    has_sky: bool
