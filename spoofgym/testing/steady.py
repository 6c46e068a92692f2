"""Epochs of a filter in steady state, on which nothing depends on the time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from ..detectors import Detector, DetectorContext
from ..receiver.epoch import Epoch, EpochMaker, without_channels

FloatArray = NDArray[np.float64]
VISIBLE = 8
INTERVAL_S = 0.5
GRAVITY_MPS2 = 9.8
STATE_SD = np.repeat([1e-6, 2e-3, 1e-2, 1e-5, 1e-8, 0.05], 3)[:17]
"""Noise of an interval on attitude, velocity, position, sensor biases, clock [rad, m, s]."""
MEMORY = np.repeat([0.999, 1.0, 1.0, 0.999, 0.999, 1.0], 3)[:17]
"""What is left of each state after an interval: those that are hardly observed forget."""
_START = np.array([6_378_137.0, 0.0, 0.0])
_VELOCITY = np.array([0.0, 100.0, 0.0])
_RANGE_M = 2.2e7


class SteadyEpochs:
    """Clean epochs without end, of B receivers that have run for ever; the same at every iteration.

    Innovations are white, with the covariance S = H P H' + R of the filter, whose P solves the
    Riccati equation of a strapdown receiver that flies straight on.  Satellites stand still above
    it; a receiver that measures a position has 15 states, and its three coordinates.
    """

    def __init__(
        self, receivers: int, channels: int = VISIBLE, interval_s: float = INTERVAL_S
    ) -> None:
        self.receivers, self.channels, self.interval_s = receivers, channels, interval_s
        self.visible = np.arange(channels) < VISIBLE
        self.sight = _lines_of_sight(channels)
        self.design = self._measure()
        s = self.design.shape[1]
        self.noise = np.repeat([6.25, 0.01], channels) if channels else np.array([1.0, 1.5, 4.0])
        seen = np.abs(self.design).sum(axis=1) > 0.0
        self.transition = _propagate(s, interval_s)
        self.predicted = solve_discrete_are(
            self.transition.T,
            self.design[seen].T,
            np.diag(STATE_SD[:s] ** 2),
            np.diag(self.noise[seen]),
        )
        self.belief = self.design @ self.predicted @ self.design.T
        self.belief += np.diag(np.where(seen, self.noise, 1.0))
        self._root = np.linalg.cholesky(self.belief) * seen[:, None]
        ids = (f"G{j + 1:02d}" if j < VISIBLE else "" for j in range(channels))
        self.context = DetectorContext(
            receivers, channels, interval_s, self.noise, tuple(ids), states=s
        )

    @classmethod
    def of(cls, detector: Detector, receivers: int) -> SteadyEpochs:
        """Epochs of what a detector measures; with the slots and the interval of its card."""
        if detector.measures == "position":
            return cls(receivers, channels=0)
        card = detector.card
        if card is None:
            return cls(receivers)
        return cls(receivers, card.channels or VISIBLE, card.interval_s or INTERVAL_S)

    def __iter__(self) -> Iterator[Epoch]:
        rng, k = np.random.default_rng(3), 0
        make = EpochMaker(Epoch._field_defaults, self._constant())
        while True:
            k += 1
            yield make(**self._draw(k * self.interval_s, rng))

    def _measure(self) -> FloatArray:
        n = self.channels
        if not n:
            design = np.zeros((3, 15))
            design[:, 6:9] = np.eye(3)
            return design
        design = np.zeros((2 * n, 17))
        design[:n, 6:9], design[:n, 15] = self.sight, 1.0
        design[n:, 3:6], design[n:, 16] = self.sight, 1.0
        return design * np.hstack([self.visible, self.visible])[:, None]

    def _constant(self) -> dict[str, NDArray[Any]]:
        b, n = self.receivers, self.channels
        per_receiver = {
            "innovation_variance": np.diag(self.belief),
            "innovation_cov": self.belief,
            "predicted_cov": self.predicted,
            "design": self.design,
            "transition": self.transition,
            "predicted_velocity": _VELOCITY,
        }
        tiled = {name: np.tile(a, (b, *(1,) * np.ndim(a))) for name, a in per_receiver.items()}
        tiled["interval"] = np.full(b, self.interval_s)
        if not n:
            return {**without_channels(b), "cn0_dbhz": np.zeros((b, 0)), **tiled}
        return {
            **tiled,
            "visible": np.tile(self.visible, (b, 1)),
            "satellite_velocity": np.tile(_VELOCITY, (b, n, 1)),
        }

    def _draw(self, time_s: float, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
        b, n = self.receivers, self.channels
        innovation = rng.standard_normal((b, len(self._root))) @ self._root.T
        position = np.tile(_START + _VELOCITY * time_s, (b, 1))
        fix = 2.0 * rng.standard_normal((b, 3)) if n else innovation
        drawn = {
            "time": np.full(b, time_s),
            "innovation": innovation,
            "imu_delta": rng.standard_normal((b, 6)) * np.repeat([0.1, 1e-3], 3),
            "predicted_position": position,
            "gnss_position": position + fix,
            "auxiliary_position": position + 5.0 * rng.standard_normal((b, 3)),
        }
        if not n:
            return drawn
        return {
            **drawn,
            "pseudorange": np.where(self.visible, _RANGE_M + 1e4 + innovation[:, :n], 0.0),
            "range_rate": np.where(self.visible, 100.0 + innovation[:, n:], 0.0),
            "satellite_position": position[:, None, :] + _RANGE_M * self.sight,
            "cn0_dbhz": 45.0 + rng.standard_normal((b, n)),
        }


def _lines_of_sight(n: int) -> FloatArray:
    """(n, 3) with the vertical first, around the horizon and up to the zenith."""
    azimuth = 2.4 * np.arange(n)
    elevation = 0.2 + 1.2 * (np.arange(n) * 0.618 % 1.0)
    east, north = np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth)
    return np.column_stack([np.sin(elevation), east, north])


def _propagate(s: int, interval_s: float) -> FloatArray:
    """(s, s) attitude tilts gravity, biases accelerate and turn, velocity moves, the clock runs."""
    phi = np.diag(MEMORY[:s])
    phi[0:3, 12:15] = phi[3:6, 9:12] = phi[6:9, 3:6] = interval_s * np.eye(3)
    phi[4, 2], phi[5, 1] = GRAVITY_MPS2 * interval_s, -GRAVITY_MPS2 * interval_s
    if s > 15:
        phi[15, 16] = interval_s
    return phi
