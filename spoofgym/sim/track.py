"""A track: cleaned fixes of a recorded flight, before they become a motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

MINIMUM_FIXES = 6
"""Fewest fixes of a track; a quintic polynomial has as many coefficients."""
STEEPEST_LATITUDE = math.radians(89.0)
"""Largest latitude north or south [rad]; closer to a pole, courses change too fast."""


@dataclass(frozen=True, eq=False)
class Track:
    """Distinct, airborne fixes without a gap.

    - `start_utc`: time of the first fix, with its time zone;
    - `time` (K,) time since `start_utc` [s], rising;
    - `latitude`, `longitude` (K,) geodetic [rad];
    - `height` (K,) height above the ellipsoid [m];
    - `groundspeed` (K,) speed over ground [m/s], NaN where there is none to be trusted;
    - `track_angle` (K,) course over ground, clockwise from north [rad], NaN likewise.
    """

    described_as = "Track"
    name: str
    start_utc: datetime
    time: NDArray[np.float64]
    latitude: NDArray[np.float64]
    longitude: NDArray[np.float64]
    height: NDArray[np.float64]
    groundspeed: NDArray[np.float64]
    track_angle: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.start_utc.tzinfo is None:
            raise ValueError(f"`start_utc` must have a time zone, got {self.start_utc}")
        count = np.size(self.time)
        if count < MINIMUM_FIXES:
            raise ValueError(f"a track must have at least {MINIMUM_FIXES} fixes, got {count}")
        for field in ("time", "latitude", "longitude", "height"):
            if not np.isfinite(self._settle(field, count)).all():
                raise ValueError(f"`{field}` must be finite, got NaN or infinity")
        for field in ("groundspeed", "track_angle"):
            if np.isinf(self._settle(field, count)).any():
                raise ValueError(f"`{field}` must be finite or NaN, got infinity")
        if self.time[0] != 0.0 or not (np.diff(self.time) > 0.0).all():
            raise ValueError("`time` must start at 0 s and rise from fix to fix")
        if (worst := float(np.abs(self.latitude).max())) > STEEPEST_LATITUDE:
            raise ValueError(
                f"`latitude` must lie within {math.degrees(STEEPEST_LATITUDE):g} deg of the "
                f"equator, got {math.degrees(worst):g} deg"
            )

    def _settle(self, field: str, count: int) -> NDArray[np.float64]:
        """Replace a field by a checked float64 copy."""
        value = np.array(getattr(self, field), dtype=np.float64)
        if value.shape != (count,):
            raise ValueError(f"`{field}` must have shape ({count},), got {value.shape}")
        object.__setattr__(self, field, value)
        return value

    @property
    def duration(self) -> float:
        """Time of the last fix [s]."""
        return float(self.time[-1])
