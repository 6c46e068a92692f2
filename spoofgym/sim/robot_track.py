"""True motion of a wheeled robot on a closed course.

The course is a rectangle with rounded corners, driven clockwise at constant speed.  Position and
heading are closed forms of the distance travelled, so that a lap ends where it began.

Source: `song2021`, section 4.1: the sidelines of a badminton court, 0.5 m/s, first heading 248 deg.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
MOST_SPEED = 100.0


@dataclass(frozen=True, kw_only=True)
class RobotTrack:
    """Truth at every sample of the encoders; sample 0 is at time zero.

    - `time` (N+1,) [s];
    - `position_ne`, `velocity_ne` (N+1, 2) north and east of the start [m], [m/s];
    - `yaw` (N+1,) heading, clockwise from north, not wrapped [rad];
    - `distance` (N+1,) travelled by the middle of the axle [m].
    """

    described_as = "RobotTrack"
    time: FloatArray
    position_ne: FloatArray
    velocity_ne: FloatArray
    yaw: FloatArray
    distance: FloatArray

    def wheels(self, wheel_base: float) -> tuple[FloatArray, FloatArray]:
        """Distance that the left and the right wheel have rolled. `wheel_base`: distance between
        the wheels [m]; returns `left`, `right` (N+1,) [m]; the left wheel is the outer one of a
        turn to the right."""
        turned = 0.5 * wheel_base * (self.yaw - self.yaw[0])
        return self.distance + turned, self.distance - turned


@dataclass(frozen=True, kw_only=True)
class RobotLoop:
    """A rectangular course.

    - `length_m`, `width_m`: sides; the first one that is driven is a long one;
    - `corner_radius_m`: radius of the corners, above 0 and at most half the shorter side; the paper
      does not say how its robot turns;
    - `heading_deg`: of the first side, clockwise from north;
    - `speed_mps`: 0 for a robot at rest.
    """

    described_as = "RobotLoop"
    length_m: float = 13.4
    width_m: float = 6.1
    corner_radius_m: float = 0.3
    heading_deg: float = 248.0
    speed_mps: float = 0.5

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not math.isfinite(value):
                raise ValueError(f"`{item.name}` must be finite, got {value}")
        for name in ("length_m", "width_m"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"`{name}` must be > 0, got {getattr(self, name)}")
        most = 0.5 * min(self.length_m, self.width_m)
        if not 0.0 < self.corner_radius_m <= most:
            raise ValueError(
                f"`corner_radius_m` must be in (0, {most:g}], got {self.corner_radius_m}"
            )
        if not 0.0 <= self.speed_mps <= MOST_SPEED:
            raise ValueError(f"`speed_mps` must be in [0, {MOST_SPEED:g}], got {self.speed_mps}")

    @property
    def lap_s(self) -> float:
        """Time of a lap; 0 for a robot at rest."""
        return float(self._pieces()[0].sum()) / self.speed_mps if self.speed_mps else 0.0

    def _pieces(self) -> tuple[FloatArray, FloatArray]:
        """(8,) length and turn of the sides and corners of a lap."""
        r = self.corner_radius_m
        corner = 0.5 * math.pi * r
        long, short = self.length_m - 2.0 * r, self.width_m - 2.0 * r
        return (
            np.array([long, corner, short, corner] * 2),
            np.array([0.0, 0.5 * math.pi] * 4),
        )

    def track(self, samples: int, interval_s: float) -> RobotTrack:
        r"""Truth along the course.

        With heading :math:`\psi` at the start of a side or corner and distance s within it,

        .. math:: \Delta p = s (\cos\psi, \sin\psi), \qquad
            \Delta p = r (\sin\psi' - \sin\psi, \cos\psi - \cos\psi'), \quad \psi' = \psi + s / r
        """
        lengths, turns = self._pieces()
        time: FloatArray = np.arange(samples + 1, dtype=np.float64) * interval_s
        distance: FloatArray = self.speed_mps * time
        ends = np.cumsum(lengths)
        lap, within = np.divmod(distance, ends[-1])
        piece = np.minimum(np.searchsorted(ends, within, side="right"), 7)
        s = within - (ends - lengths)[piece]
        heading = math.radians(self.heading_deg) + np.concatenate([[0.0], np.cumsum(turns)[:-1]])
        starts = np.zeros((8, 2))
        for i in range(7):
            starts[i + 1] = starts[i] + self._moved(heading[i], lengths[i], i % 2 == 1)
        first = heading[piece]
        straight = self._moved(first, s, False)
        curved = self._moved(first, s, True)
        corner = (piece % 2 == 1)[:, None]
        yaw = first + np.where(piece % 2 == 1, s / self.corner_radius_m, 0.0)
        direction = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        return RobotTrack(
            time=time,
            position_ne=starts[piece] + np.where(corner, curved, straight),
            velocity_ne=self.speed_mps * direction,
            yaw=yaw + 2.0 * math.pi * lap,
            distance=distance,
        )

    def _moved(self, heading: FloatArray, s: FloatArray, corner: bool) -> FloatArray:
        """(..., 2) north and east moved over a distance along a side or a corner."""
        if not corner:
            return np.stack([s * np.cos(heading), s * np.sin(heading)], axis=-1)
        r = self.corner_radius_m
        end = heading + s / r
        return r * np.stack([np.sin(end) - np.sin(heading), np.cos(heading) - np.cos(end)], axis=-1)
