r"""The credible Kalman filter: dead reckoning, corrected by the positions that are believed.

The state is the position, driven by the increments of dead reckoning u; a GNSS position g is its
measurement,

.. math:: x_k^- = x_{k-1} + u_k, \quad
    P_k^- = P_{k-1} + q \tau + d^2 (2 t + \tau) \tau, \quad
    x_k = x_k^- + w K (g_k - x_k^-), \quad K = P_k^- / (P_k^- + R)

with a detector's weight w on the gain: 1 is the paper's credible update, 0 its auxiliary update.
t is the time since the last fix that was believed: a heading that is off lets dead reckoning drift
at a constant rate, of deviation d, so that the variance grows with the square of t, and a fix that
is believed again after an outage resets the position.  q is chosen such that the gain settles at a
stated value.  With no detector in the loop this is the paper's plain EKF.

Interruption check: a fix that is missing or not finite gives a zero row of `design`, innovation 0
and the identity in `innovation_cov`; no update takes place, and `interrupted` counts on.

Positions are (B, 3) north, east, down of a local frame, down always 0; m = s = 2.

Deviations from `song2021`, section 2.4:

1. The state is the position alone: the paper has a velocity, but no measurement of it in its
   design, and a heading among the measurements that is not in the state.
2. Dead reckoning is the control input.  As a measurement of equal weight that runs free from the
   begin it would contradict the paper's own EKF, which follows the attack to 98 %.
3. No vertical channel: the court is level, and the paper gives no vertical error.

Source: `song2021`; the filter is from `groves2013`, chapter 3.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.compile import njit
from ..core.memory import Memory
from .epoch import ALWAYS, OPTIONAL, Epoch, frozen_fields

FloatArray = NDArray[np.float64]
AXES = 2


@njit
def predict_positions(
    interval: float,
    increment: FloatArray,
    fix: FloatArray,
    noise: float,
    drift_rate: float,
    noise_variance: float,
    position: FloatArray,
    covariance: FloatArray,
    odometry: FloatArray,
    outage: FloatArray,
    interrupted: FloatArray,
    innovation: FloatArray,
    innovation_cov: FloatArray,
    design: FloatArray,
    gnss_position: FloatArray,
) -> None:
    """First half of an epoch: dead reckoning, interruption check, innovation.

    `increment`, `fix` (B, 2) u and g [m]; a fix that is not finite is none; `position`,
    `covariance`, `odometry` (B, 3) estimate [m], (B, 2, 2) P [m^2], (B, 3) dead reckoning alone
    [m], overwritten; `outage`, `interrupted` (B,) t, and time since the last fix [s]; the second
    overwritten; `innovation`, `innovation_cov`, `design`, `gnss_position` (B, 2), (B, 2, 2),
    (B, 2, 2), (B, 3), written.
    """
    for b in range(increment.shape[0]):
        # comparisons, since the relaxed rules may fold `isfinite` away (see `fits`)
        valid = abs(fix[b, 0]) < np.inf and abs(fix[b, 1]) < np.inf
        interrupted[b] = 0.0 if valid else interrupted[b] + interval
        grown = noise + drift_rate * drift_rate * (2.0 * outage[b] + interval)
        gnss_position[b, 2] = 0.0
        for i in range(2):
            position[b, i] += increment[b, i]
            odometry[b, i] += increment[b, i]
            covariance[b, i, i] += grown * interval
            innovation_cov[b, i, 1 - i] = 0.0
            design[b, i, 1 - i] = 0.0
            if valid:
                gnss_position[b, i] = fix[b, i]
                innovation[b, i] = fix[b, i] - position[b, i]
                innovation_cov[b, i, i] = covariance[b, i, i] + noise_variance
                design[b, i, i] = 1.0
            else:
                gnss_position[b, i] = position[b, i]
                innovation[b, i] = 0.0
                innovation_cov[b, i, i] = 1.0
                design[b, i, i] = 0.0


@njit
def update_positions(
    interval: float,
    weights: FloatArray,
    noise_variance: float,
    innovation: FloatArray,
    innovation_cov: FloatArray,
    design: FloatArray,
    position: FloatArray,
    covariance: FloatArray,
    outage: FloatArray,
) -> None:
    """Second half of an epoch: the weighted update, in Joseph's form. `interval`: tau [s];
    `weights` (B, 2) w; `noise_variance`: R [m^2]; `position`, `covariance` (B, 3), (B, 2, 2),
    overwritten; `outage` (B,) t [s], overwritten: 0 once a fix has been believed at all."""
    for b in range(weights.shape[0]):
        believed = False
        for i in range(2):
            gain = weights[b, i] * design[b, i, i] * covariance[b, i, i] / innovation_cov[b, i, i]
            position[b, i] += gain * innovation[b, i]
            left = 1.0 - gain
            covariance[b, i, i] = left * left * covariance[b, i, i] + gain * gain * noise_variance
            believed = believed or gain > 0.0
        outage[b] = 0.0 if believed else outage[b] + interval


@dataclass(frozen=True, kw_only=True)
class CredibleFilter:
    """Settings of the filter.

    - `gain`: K on which the filter settles, in (0, 1). 0.16 a second lets a ramp of 0.7 m/s lead by
      the 3.9 m by which the paper's EKF lags;
    - `noise_sd_m`: root of R, above 0;
    - `drift_rate_mps`: d, at least 0, below what the gain leaves room for.
    """

    described_as = "CredibleFilter"
    gain: float = 0.16
    noise_sd_m: float = 1.02
    drift_rate_mps: float = 0.04

    def __post_init__(self) -> None:
        if not 0.0 < self.gain < 1.0:
            raise ValueError(f"`gain` must lie between 0 and 1, both excluded, got {self.gain}")
        if not (math.isfinite(self.noise_sd_m) and self.noise_sd_m > 0.0):
            raise ValueError(f"`noise_sd_m` must be finite and > 0, got {self.noise_sd_m}")
        if not (math.isfinite(self.drift_rate_mps) and self.drift_rate_mps >= 0.0):
            raise ValueError(f"`drift_rate_mps` must be finite and >= 0, got {self.drift_rate_mps}")

    @property
    def noise_variance(self) -> float:
        return self.noise_sd_m**2

    def process_noise(self, interval_s: float) -> float:
        r"""Process noise with which the gain settles at K.

        .. math:: q \tau = \frac{K^2 R}{1 - K} - d^2 \tau^2

        Returns q [m^2/s].
        """
        total = self.gain**2 * self.noise_variance / (1.0 - self.gain)
        most = math.sqrt(total) / interval_s
        if self.drift_rate_mps > most:
            raise ValueError(
                f"`drift_rate_mps` must be at most {most:g} for a gain of {self.gain:g} every "
                f"{interval_s:g} s, got {self.drift_rate_mps}"
            )
        return total / interval_s - self.drift_rate_mps**2 * interval_s


class CredibleBatch:
    """B filters in step; all that they remember lies in a memory that is handed in. `memory`: of B
    receivers; ``position``, ``covariance``, ``odometry``, ``outage``, ``interrupted`` are declared
    in it; `fields`: optional ones that its epochs have."""

    def __init__(
        self,
        settings: CredibleFilter,
        memory: Memory,
        interval_s: float,
        fields: Collection[str] = OPTIONAL,
    ) -> None:
        b = memory.receivers
        self.settings, self.memory, self.interval_s = settings, memory, interval_s
        self._noise = settings.process_noise(interval_s)
        memory.declare("position", np.zeros((b, 3)))
        memory.declare("covariance", np.tile(settings.noise_variance * np.eye(AXES), (b, 1, 1)))
        memory.declare("odometry", np.zeros((b, 3)))
        memory.declare("outage", np.zeros(b))
        memory.declare("interrupted", np.zeros(b))
        self.innovation = np.zeros((b, AXES))
        self.innovation_cov = np.zeros((b, AXES, AXES))
        self.design = np.zeros((b, AXES, AXES))
        self.gnss_position = np.zeros((b, 3))
        self.ones = np.ones((b, AXES))
        self._names = ALWAYS.union(fields)
        self._fixed = frozen_fields(_empty_fields(b, interval_s), self._names)

    def begin(self, fix: FloatArray) -> None:
        """Begin at a position.  `fix` (B, 2) the first fix [m], finite."""
        self.memory["position"][:, :AXES] = fix
        self.memory["odometry"][:, :AXES] = fix

    def predict(self, time: FloatArray, increment: FloatArray, fix: FloatArray) -> Epoch:
        """First half of an epoch. `time` (B,) of the epoch [s]; `increment`, `fix` (B, 2) dead
        reckoning since the last epoch, GNSS position [m]."""
        memory, settings = self.memory, self.settings
        predict_positions(
            self.interval_s,
            increment,
            fix,
            self._noise,
            settings.drift_rate_mps,
            settings.noise_variance,
            memory["position"],
            memory["covariance"],
            memory["odometry"],
            memory["outage"],
            memory["interrupted"],
            self.innovation,
            self.innovation_cov,
            self.design,
            self.gnss_position,
        )
        arrays: dict[str, NDArray[Any]] = {
            "time": time,
            "innovation": self.innovation,
            "innovation_variance": self.innovation_cov.diagonal(0, 1, 2),
            "innovation_cov": self.innovation_cov,
            "predicted_cov": memory["covariance"],
            "design": self.design,
            "predicted_position": memory["position"],
            "gnss_position": self.gnss_position,
            "auxiliary_position": memory["odometry"],
        }
        return Epoch(**self._fixed, **frozen_fields(arrays, self._names))

    def update(self, weights: FloatArray | None) -> None:
        """Second half of an epoch.  `weights` (B, 2) of a verdict; None for ones."""
        memory = self.memory
        update_positions(
            self.interval_s,
            self.ones if weights is None else weights,
            self.settings.noise_variance,
            self.innovation,
            self.innovation_cov,
            self.design,
            memory["position"],
            memory["covariance"],
            memory["outage"],
        )


def _empty_fields(b: int, interval_s: float) -> Mapping[str, NDArray[Any]]:
    return {
        "interval": np.full(b, interval_s),
        "transition": np.tile(np.eye(AXES), (b, 1, 1)),
        "imu_delta": np.zeros((b, 6)),
        "pseudorange": np.zeros((b, 0)),
        "range_rate": np.zeros((b, 0)),
        "satellite_position": np.zeros((b, 0, 3)),
        "satellite_velocity": np.zeros((b, 0, 3)),
        "visible": np.zeros((b, 0), dtype=np.bool_),
        "predicted_velocity": np.zeros((b, 3)),
    }
