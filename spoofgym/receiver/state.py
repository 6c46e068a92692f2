"""The arrays of a batch of receivers: estimates, samples, measurements, noise model.

All floating-point arrays of a batch lie one after the other in one buffer, `ReceiverBuffers`, and
`unpack` names them.  A kernel takes the buffer and unpacks it itself, which costs a tenth of
handing over twenty arrays; a copy of the buffers is a snapshot of the batch.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from .error_model import STATES

FloatArray = NDArray[np.float64]


class ReceiverState(NamedTuple):
    """What the receivers estimate.

    - `position_e`, `velocity_e` (B, 3) ECEF [m], [m/s];
    - `C_eb` (B, 3, 3) attitude, to ECEF from body axes;
    - `accel_bias_b`, `gyro_bias_b` (B, 3) estimated sensor biases [m/s^2], [rad/s];
    - `clock` (B, 2) receiver clock bias [m] and drift [m/s];
    - `covariance` (B, 17, 17) in the order of `error_model`.
    """

    position_e: FloatArray
    velocity_e: FloatArray
    C_eb: FloatArray
    accel_bias_b: FloatArray
    gyro_bias_b: FloatArray
    clock: FloatArray
    covariance: FloatArray


class Measurements(NamedTuple):
    """One epoch of the receivers: what is measured, and what is derived from it.

    - `time`, `interval` (B,) time of the epoch and time since the last one [s];
    - `pseudorange`, `range_rate` (B, n) [m], [m/s];
    - `satellite_position`, `satellite_velocity` (B, n, 3) ECEF [m], [m/s];
    - `visible` (B, n) bool;
    - `noise_variance` (B, 2n) R, pseudoranges first;
    - `innovation` (B, 2n), 0 where invisible;
    - `innovation_variance` (B, 2n) the diagonal of S, 1 where invisible;
    - `innovation_cov` (B, 2n, 2n) S, and `design` (B, 2n, 17) H: only where asked for;
    - `line_of_sight` (B, n, 3) unit vectors to the satellites, ECEF;
    - `transition` (B, 17, 17) Phi;
    - `imu_delta` (B, 6) bias-corrected delta-v [m/s] and delta-theta [rad] of the interval, body
      axes;
    - `coasting` (B,) bool, whether the update was left out for want of satellites.
    """

    time: FloatArray
    interval: FloatArray
    pseudorange: FloatArray
    range_rate: FloatArray
    satellite_position: FloatArray
    satellite_velocity: FloatArray
    visible: NDArray[np.bool_]
    noise_variance: FloatArray
    innovation: FloatArray
    innovation_variance: FloatArray
    innovation_cov: FloatArray
    design: FloatArray
    line_of_sight: FloatArray
    transition: FloatArray
    imu_delta: FloatArray
    coasting: NDArray[np.bool_]


@njit
def buffer_size(receivers: int, channels: int) -> int:
    """Number of floating-point values of a batch."""
    n = channels
    state = 3 + 3 + 9 + 3 + 3 + 2 + 289
    epoch = 2 + 2 * n + 6 * n + 2 * n + 4 * n + 4 * n * n + 34 * n + 3 * n + 289 + 6
    return receivers * (state + epoch + 17)


@njit
def unpack(
    floats: FloatArray, flags: NDArray[np.bool_], receivers: int, channels: int
) -> tuple[ReceiverState, Measurements, FloatArray]:
    """Name the arrays of a batch: views of its buffers.

    `floats` (`buffer_size`,) float64; `flags` (B (n + 1),) bool; returns `noise_psd` (B, 17) power
    spectral density of the noise that drives each state.
    """
    b, n, m = receivers, channels, 2 * channels
    o = 0
    position_e = floats[o : o + 3 * b].reshape((b, 3))
    o += 3 * b
    velocity_e = floats[o : o + 3 * b].reshape((b, 3))
    o += 3 * b
    C_eb = floats[o : o + 9 * b].reshape((b, 3, 3))
    o += 9 * b
    accel_bias_b = floats[o : o + 3 * b].reshape((b, 3))
    o += 3 * b
    gyro_bias_b = floats[o : o + 3 * b].reshape((b, 3))
    o += 3 * b
    clock = floats[o : o + 2 * b].reshape((b, 2))
    o += 2 * b
    covariance = floats[o : o + 289 * b].reshape((b, 17, 17))
    o += 289 * b
    time = floats[o : o + b]
    o += b
    interval = floats[o : o + b]
    o += b
    pseudorange = floats[o : o + n * b].reshape((b, n))
    o += n * b
    range_rate = floats[o : o + n * b].reshape((b, n))
    o += n * b
    satellite_position = floats[o : o + 3 * n * b].reshape((b, n, 3))
    o += 3 * n * b
    satellite_velocity = floats[o : o + 3 * n * b].reshape((b, n, 3))
    o += 3 * n * b
    noise_variance = floats[o : o + m * b].reshape((b, m))
    o += m * b
    innovation = floats[o : o + m * b].reshape((b, m))
    o += m * b
    innovation_variance = floats[o : o + m * b].reshape((b, m))
    o += m * b
    innovation_cov = floats[o : o + m * m * b].reshape((b, m, m))
    o += m * m * b
    design = floats[o : o + 17 * m * b].reshape((b, m, 17))
    o += 17 * m * b
    line_of_sight = floats[o : o + 3 * n * b].reshape((b, n, 3))
    o += 3 * n * b
    transition = floats[o : o + 289 * b].reshape((b, 17, 17))
    o += 289 * b
    imu_delta = floats[o : o + 6 * b].reshape((b, 6))
    o += 6 * b
    noise_psd = floats[o : o + 17 * b].reshape((b, 17))
    visible = flags[: n * b].reshape((b, n))
    coasting = flags[n * b : n * b + b]
    state = ReceiverState(
        position_e, velocity_e, C_eb, accel_bias_b, gyro_bias_b, clock, covariance
    )
    measured = Measurements(
        time,
        interval,
        pseudorange,
        range_rate,
        satellite_position,
        satellite_velocity,
        visible,
        noise_variance,
        innovation,
        innovation_variance,
        innovation_cov,
        design,
        line_of_sight,
        transition,
        imu_delta,
        coasting,
    )
    return state, measured, noise_psd


LANES = 8
"""Receivers whose inertial samples are mechanized side by side."""


class ReceiverBuffers:
    """The memory of a batch of receivers.

    - `samples`: most inertial samples between two epochs, S;
    - `block` (2, B) int64, first sample of the interval in the run, and number of samples;
    - `samples` (G, S, 6 * LANES) measured specific force and angular rate, body axes, component by
      component for the `LANES` receivers of each of the G groups.
    """

    def __init__(self, receivers: int, channels: int, samples: int) -> None:
        self.receivers, self.channels = receivers, channels
        self.floats = np.zeros(buffer_size(receivers, channels))
        self.flags = np.zeros(receivers * (channels + 1), dtype=np.bool_)
        self.block = np.zeros((2, receivers), dtype=np.int64)
        self.samples = np.zeros((-(-receivers // LANES), samples, 6 * LANES))
        self._name_arrays()
        self.measured.transition[:] = np.eye(STATES)
        self.measured.noise_variance[:] = 1.0

    def _name_arrays(self) -> None:
        self.state, self.measured, self.noise_psd = unpack(
            self.floats, self.flags, self.receivers, self.channels
        )

    def __getstate__(self) -> dict[str, Any]:
        """Buffers without their views, which a copy makes of its own buffers."""
        views = ("state", "measured", "noise_psd")
        return {name: value for name, value in self.__dict__.items() if name not in views}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the buffers, and name their arrays."""
        self.__dict__.update(state)
        self._name_arrays()

    def measured_samples(self, receiver: int) -> FloatArray:
        """Measured samples of one receiver's last interval.

        Returns (count, 6) specific force [m/s^2] and angular rate [rad/s], a copy.
        """
        group, lane = divmod(receiver, LANES)
        lanes = self.samples[group].reshape(-1, 6, LANES)
        return np.array(lanes[: self.block[1, receiver], :, lane])

    def put_samples(self, receiver: int, samples: FloatArray) -> None:
        """Write one receiver's samples of an interval.

        `samples` (count, 6) specific force [m/s^2] and angular rate [rad/s].
        """
        group, lane = divmod(receiver, LANES)
        lanes = self.samples[group].reshape(-1, 6, LANES)
        lanes[: len(samples), :, lane] = samples
