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
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from ..core.compile import njit
from ..core.declared import setting, settings_record
from ..core.memory import Memory
from ..core.registry import require
from .epoch import OPTIONAL, Epoch, EpochMaker, FloatArray, without_channels

AXES = 2


class CredibleState(NamedTuple):
    """What the filters remember: `position` (B, 3) estimate [m], `covariance` (B, 2, 2) P [m^2],
    `odometry` (B, 3) dead reckoning alone [m], `outage` (B,) t, and `interrupted` (B,) time since
    the last fix [s]."""

    position: FloatArray
    covariance: FloatArray
    odometry: FloatArray
    outage: FloatArray
    interrupted: FloatArray


class Innovations(NamedTuple):
    """Those of an epoch, `innovation` (B, 2), `innovation_cov`, `design` (B, 2, 2), and
    `gnss_position` (B, 3)."""

    innovation: FloatArray
    innovation_cov: FloatArray
    design: FloatArray
    gnss_position: FloatArray


Rules = tuple[float, float, float, float]  # tau [s], q [m^2/s], d [m/s], R [m^2]


@njit
def predict_positions(
    rules: Rules, increment: FloatArray, fix: FloatArray, state: CredibleState, seen: Innovations
) -> None:
    """First half of an epoch: dead reckoning, interruption check, innovation. `increment`, `fix`
    (B, 2) u and g [m]; a fix that is not finite is missing; `state`, `seen` are overwritten."""
    interval, noise, drift_rate, noise_variance = rules
    position, covariance, odometry, outage, interrupted = state
    innovation, innovation_cov, design, gnss_position = seen
    for b in range(increment.shape[0]):
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
    rules: Rules, weights: FloatArray, state: CredibleState, seen: Innovations
) -> None:
    """Second half of an epoch: the weighted update, in Joseph's form. `weights` (B, 2) w; `state`:
    overwritten; its `outage` is 0 once a fix has been believed at all."""
    interval, _, _, noise_variance = rules
    position, covariance, _, outage, _ = state
    innovation, innovation_cov, design, _ = seen
    for b in range(weights.shape[0]):
        believed = False
        for i in range(2):
            gain = weights[b, i] * design[b, i, i] * covariance[b, i, i] / innovation_cov[b, i, i]
            position[b, i] += gain * innovation[b, i]
            left = 1.0 - gain
            covariance[b, i, i] = left * left * covariance[b, i, i] + gain * gain * noise_variance
            believed = believed or gain > 0.0
        outage[b] = 0.0 if believed else outage[b] + interval


@settings_record(frozen=True, kw_only=True)
class CredibleFilter:
    """Settings of the filter."""

    gain: float = setting(
        default=0.16,
        above=0.0,
        below=1.0,
        help="K on which the filter settles. 0.16 a second lets a ramp of 0.7 m/s lead by the "
        "3.9 m by which the paper's EKF lags.",
    )
    noise_sd_m: float = setting(
        default=1.02, above=0.0, unit="m", help="Root of R, the variance of a fix."
    )
    drift_rate_mps: float = setting(
        default=0.04,
        least=0.0,
        unit="m/s",
        help="Deviation d of the rate at which dead reckoning drifts; less than what the gain "
        "leaves room for.",
    )

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
        require(
            self.drift_rate_mps <= most,
            f"`drift_rate_mps` must be at most {most:g} for a gain of {self.gain:g} every "
            f"{interval_s:g} s, got {self.drift_rate_mps}",
        )
        return total / interval_s - self.drift_rate_mps**2 * interval_s


class CredibleBatch:
    """B filters in step; all that they remember lies in a memory that is handed in. `memory`: of B
    receivers; `CredibleState` is declared in it; `fields`: optional ones that its epochs have."""

    def __init__(
        self,
        settings: CredibleFilter,
        memory: Memory,
        interval_s: float,
        fields: Collection[str] = OPTIONAL,
    ) -> None:
        b = memory.receivers
        self.settings, self.memory, self.interval_s = settings, memory, interval_s
        noise = float(settings.process_noise(interval_s)), float(settings.drift_rate_mps)
        self._rules: Rules = interval_s, *noise, settings.noise_variance
        covariance = np.tile(settings.noise_variance * np.eye(AXES), (b, 1, 1))
        places = np.zeros((b, 3)), covariance, np.zeros((b, 3)), np.zeros(b), np.zeros(b)
        memory.declare_all(**CredibleState(*places)._asdict())
        square = (b, AXES, AXES)
        self.seen = Innovations(
            np.zeros((b, AXES)), np.zeros(square), np.zeros(square), np.zeros((b, 3))
        )
        self.ones = np.ones((b, AXES))
        constant = {
            "interval": np.full(b, interval_s),
            "transition": np.tile(np.eye(AXES), (b, 1, 1)),
            "imu_delta": np.zeros((b, 6)),
            "predicted_velocity": np.zeros((b, 3)),
        }
        self._epoch = EpochMaker(fields, {**constant, **without_channels(b)})

    @property
    def state(self) -> CredibleState:
        return CredibleState(*(self.memory[name] for name in CredibleState._fields))

    def start_episodes(self, fix: FloatArray) -> None:
        self.memory["position"][:, :AXES] = fix
        self.memory["odometry"][:, :AXES] = fix

    def predict(self, time: FloatArray, increment: FloatArray, fix: FloatArray) -> Epoch:
        """First half of an epoch. `time` (B,) of the epoch [s]; `increment`, `fix` (B, 2) dead
        reckoning since the last epoch, GNSS position [m]."""
        state, seen = self.state, self.seen
        predict_positions(self._rules, increment, fix, state, seen)
        return self._epoch(
            time=time,
            innovation_variance=seen.innovation_cov.diagonal(0, 1, 2),
            predicted_cov=state.covariance,
            predicted_position=state.position,
            auxiliary_position=state.odometry,
            **seen._asdict(),
        )

    def update(self, weights: FloatArray | None) -> None:
        used = self.ones if weights is None else weights
        update_positions(self._rules, used, self.state, self.seen)
