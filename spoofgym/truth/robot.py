r"""A wheeled robot on a closed course: its true motion, encoders, heading and GNSS positions.

The course is a rectangle with rounded corners, driven clockwise at constant speed: the sidelines of
a badminton court, 0.5 m/s, first heading 248 deg (`song2021`, section 4.1).  Position and heading
are closed forms of the distance travelled, so that a lap ends where it began.

Dead reckoning adds up, from sample to sample, the mean way of the two wheels in the direction of
the heading in the middle of the sample,

.. math:: \Delta p = \tfrac12 (s^l + s^r) (\cos\bar\psi, \sin\bar\psi), \qquad
    s = o \frac{2 \pi W_r}{L}

with o counts of an encoder of L counts a turn and wheels of radius W_r.  The heading comes from an
inertial system whose magnetometer is deflected by iron on the robot,

.. math:: \psi^I = \psi - A \sin\psi + \text{noise}

and drives dead reckoning off by the same vector every lap.  A GNSS position is the true one, a
Gauss-Markov error, white noise, and what a spoofer adds.

Deviations from `song2021`, sections 2.3 and 4.1:

1. The paper multiplies counts by counts per turn in its eq. 2; they are divided here.
2. It takes the heading at the end of a step; the mean of both ends has no error in a turn.
3. It names no error that would let dead reckoning drift.  A = 4 deg gives the drift of its tables.
4. Its receiver's errors are not described.  A deviation of 1.0 m an axis that is correlated over
   60 s, and 0.2 m of white noise, give the spread of its clean data; white noise alone would raise
   its alarm all the time.
5. Radius and distance of the wheels are not printed; neither matters, since wheels do not slip.
6. The noise of the heading is the magnetometer's last digit, 0.6 uT in a horizontal field of 28 uT.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..core.registry import require
from .noise import BLOCK

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

    time: FloatArray
    position_ne: FloatArray
    velocity_ne: FloatArray
    yaw: FloatArray
    distance: FloatArray

    def wheels(self, wheel_base: float) -> tuple[FloatArray, FloatArray]:
        """(N+1,) distance that the left and the right wheel have rolled [m]; `wheel_base` between
        them [m]; the left wheel is the outer one of a turn to the right."""
        turned = 0.5 * wheel_base * (self.yaw - self.yaw[0])
        return self.distance + turned, self.distance - turned


@settings_record(frozen=True, kw_only=True)
class RobotLoop:
    """A rectangular course."""

    length_m: float = setting(
        default=13.4, above=0.0, unit="m", help="Length of the side that is driven first."
    )
    width_m: float = setting(default=6.1, above=0.0, unit="m", help="Length of the other side.")
    corner_radius_m: float = setting(
        default=0.3,
        above=0.0,
        unit="m",
        help="Radius of the corners, at most half the shorter side; the paper does not say how its "
        "robot turns.",
    )
    heading_deg: float = setting(
        default=248.0, unit="deg", help="Heading of the first side, clockwise from north."
    )
    speed_mps: float = setting(
        default=0.5, least=0.0, most=MOST_SPEED, unit="m/s", help="Speed; 0 for a robot at rest."
    )

    def __post_init__(self) -> None:
        most = 0.5 * min(self.length_m, self.width_m)
        require(
            self.corner_radius_m <= most,
            f"`corner_radius_m` must be at most {most:g}, half the shorter side, got "
            f"{self.corner_radius_m}",
        )

    @property
    def lap_s(self) -> float:
        return float(self._pieces()[0].sum()) / self.speed_mps if self.speed_mps else 0.0

    def _pieces(self) -> tuple[FloatArray, FloatArray]:
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
            starts[i + 1] = starts[i] + self._displace(heading[i], lengths[i], i % 2 == 1)
        first = heading[piece]
        straight = self._displace(first, s, False)
        curved = self._displace(first, s, True)
        corner = (piece % 2 == 1)[:, None]
        yaw = first + np.where(piece % 2 == 1, s / self.corner_radius_m, 0.0)
        return RobotTrack(
            time=time,
            position_ne=starts[piece] + np.where(corner, curved, straight),
            velocity_ne=self.speed_mps * np.stack([np.cos(yaw), np.sin(yaw)], axis=-1),
            yaw=yaw + 2.0 * math.pi * lap,
            distance=distance,
        )

    def _displace(self, heading: FloatArray, s: FloatArray, corner: bool) -> FloatArray:
        """(..., 2) north and east moved over a distance along a side or a corner."""
        if not corner:
            return np.stack([s * np.cos(heading), s * np.sin(heading)], axis=-1)
        r = self.corner_radius_m
        end = heading + s / r
        return r * np.stack([np.sin(end) - np.sin(heading), np.cos(heading) - np.cos(end)], axis=-1)


SOURCES = ("yaw", "fix")  # sources of chance; each has a key of its own in every episode
MOST_SAMPLES = BLOCK  # most encoder samples between two fixes: one block of noise


@settings_record(frozen=True, kw_only=True)
class Odometer:
    """Encoders and heading."""

    counts_per_turn: int = setting(default=495, least=1, help="Counts of an encoder in a turn.")
    wheel_radius_m: float = setting(
        default=0.0325, above=0.0, unit="m", help="Radius of the wheels."
    )
    wheel_base_m: float = setting(
        default=0.2, above=0.0, unit="m", help="Distance between the wheels."
    )
    sample_interval_s: float = setting(
        default=0.1, above=0.0, unit="s", help="Time between samples."
    )
    hard_iron_deg: float = setting(
        default=4.0, least=-45.0, most=45.0, unit="deg", help="A: error of the heading by iron."
    )
    yaw_noise_deg: float = setting(
        default=0.35,
        least=0.0,
        most=45.0,
        unit="deg",
        help="White noise of the heading at every sample.",
    )

    @property
    def count_m(self) -> float:
        return 2.0 * math.pi * self.wheel_radius_m / self.counts_per_turn


@settings_record(frozen=True, kw_only=True)
class FixErrors:
    """GNSS position errors, alike in north and east."""

    correlated_sd_m: float = setting(
        default=1.0, least=0.0, unit="m", help="Standard deviation of the Gauss-Markov error."
    )
    correlation_time_s: float = setting(
        default=60.0, above=0.0, unit="s", help="Its time constant."
    )
    white_sd_m: float = setting(default=0.2, least=0.0, unit="m", help="White noise at every fix.")

    def decay(self, interval_s: float) -> float:
        return math.exp(-interval_s / self.correlation_time_s)


def episode_keys(episode: np.random.SeedSequence) -> tuple[NDArray[np.uint64], FloatArray]:
    """Keys (2, 2) of each of `SOURCES` for a new episode, and parts of a count (2,) at which the
    left and the right encoder start, in [0, 1)."""
    words = 2 * len(SOURCES)
    state = np.asarray(episode.generate_state(words + 2, np.uint64), dtype=np.uint64)
    phase = np.asarray((state[words:] >> np.uint64(11)) * 2.0**-53, dtype=np.float64)
    return state[:words].reshape(-1, 2), phase
