"""The arrays of a batch of receivers' sensors: errors, clocks, keys of the noise.

As with the receivers, all floating-point arrays lie in one buffer that `unpack_sensors` names.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._jit import njit
from .gnss import GnssErrors
from .imu import ImuGrade
from .noise import normals, padded

FloatArray = NDArray[np.float64]
SOURCES = ("imu", "clock", "gnss", "bias", "trajectory", "domain", "spoofer", "correlated")
"""Sources of chance; each has a key of its own in every episode.  New ones come last, which leaves
the keys of the others as they are."""


class SensorState(NamedTuple):
    """Errors of every receiver's sensors.

    - `accel_bias`, `gyro_bias` (B, 3) body axes [m/s^2], [rad/s];
    - `accel_matrix`, `gyro_matrix`, `g_dependence` (B, 3, 3) I + M_a, I + M_g and G_g;
    - `imu_noise` (B, 4) root PSD of accelerometers and gyros, quantization levels;
    - `residual` (B, 6) what quantization carries to the next sample;
    - `clock`, `clock_psd` (B, 2) true clock bias [m] and drift [m/s], and their noise;
    - `gnss_noise` (B, 2) white noise of pseudoranges [m] and range rates [m/s];
    - `satellite_bias` (B, n) constant for an episode [m];
    - `range_offset`, `rate_offset` (B, n) what the attack adds [m], [m/s];
    - `correlated_noise` (B, 2) standard deviation [m] and correlation time [s] of the correlated
      code errors;
    - `correlated` (B, n) correlated code errors of the present epoch [m];
    - `authentic` (B, 2n) factor on the authentic errors, pseudoranges first: 1, or 0 where a
      counterfeit signal brings errors of its own.
    """

    accel_bias: FloatArray
    gyro_bias: FloatArray
    accel_matrix: FloatArray
    gyro_matrix: FloatArray
    g_dependence: FloatArray
    imu_noise: FloatArray
    residual: FloatArray
    clock: FloatArray
    clock_psd: FloatArray
    gnss_noise: FloatArray
    satellite_bias: FloatArray
    range_offset: FloatArray
    rate_offset: FloatArray
    correlated_noise: FloatArray
    correlated: FloatArray
    authentic: FloatArray


@njit
def sensor_size(receivers: int, channels: int) -> int:
    """Number of floating-point values of a batch of sensors."""
    return receivers * (6 + 27 + 4 + 6 + 6 + 2 + 6 * channels)


@njit
def unpack_sensors(floats: FloatArray, receivers: int, channels: int) -> SensorState:
    """Name the arrays of a batch of sensors: views of its buffer.

    `floats` (`sensor_size`,) float64.
    """
    b, n = receivers, channels
    o = 0
    accel_bias = floats[o : o + 3 * b].reshape((b, 3))
    o += 3 * b
    gyro_bias = floats[o : o + 3 * b].reshape((b, 3))
    o += 3 * b
    accel_matrix = floats[o : o + 9 * b].reshape((b, 3, 3))
    o += 9 * b
    gyro_matrix = floats[o : o + 9 * b].reshape((b, 3, 3))
    o += 9 * b
    g_dependence = floats[o : o + 9 * b].reshape((b, 3, 3))
    o += 9 * b
    imu_noise = floats[o : o + 4 * b].reshape((b, 4))
    o += 4 * b
    residual = floats[o : o + 6 * b].reshape((b, 6))
    o += 6 * b
    clock = floats[o : o + 2 * b].reshape((b, 2))
    o += 2 * b
    clock_psd = floats[o : o + 2 * b].reshape((b, 2))
    o += 2 * b
    gnss_noise = floats[o : o + 2 * b].reshape((b, 2))
    o += 2 * b
    satellite_bias = floats[o : o + n * b].reshape((b, n))
    o += n * b
    range_offset = floats[o : o + n * b].reshape((b, n))
    o += n * b
    rate_offset = floats[o : o + n * b].reshape((b, n))
    o += n * b
    correlated_noise = floats[o : o + 2 * b].reshape((b, 2))
    o += 2 * b
    correlated = floats[o : o + n * b].reshape((b, n))
    o += n * b
    authentic = floats[o : o + 2 * n * b].reshape((b, 2 * n))
    return SensorState(
        accel_bias,
        gyro_bias,
        accel_matrix,
        gyro_matrix,
        g_dependence,
        imu_noise,
        residual,
        clock,
        clock_psd,
        gnss_noise,
        satellite_bias,
        range_offset,
        rate_offset,
        correlated_noise,
        correlated,
        authentic,
    )


class SensorBuffers:
    """The memory of a batch of sensors.

    `keys` (S, B, 2) uint64, key of the noise of each of `SOURCES`; `epoch` (B,) int64, the epoch
    that each receiver is at.
    """

    def __init__(self, receivers: int, channels: int) -> None:
        self.receivers, self.channels = receivers, channels
        self.floats = np.zeros(sensor_size(receivers, channels))
        self.state = unpack_sensors(self.floats, receivers, channels)
        self.keys = np.zeros((len(SOURCES), receivers, 2), dtype=np.uint64)
        self.epoch = np.zeros(receivers, dtype=np.int64)

    def __getstate__(self) -> dict[str, Any]:
        """Buffers without their views, which a copy makes of its own buffer."""
        return {name: value for name, value in self.__dict__.items() if name != "state"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the buffers, and name their arrays."""
        self.__dict__.update(state)
        self.state = unpack_sensors(self.floats, self.receivers, self.channels)

    def draw_keys(self, rows: NDArray[np.intp], rngs: Sequence[np.random.Generator]) -> None:
        """Take the keys of a new episode.

        `rngs`: one per row.  Its seed sequence spawns one child an episode, and that gives every
        source a key, so that no source depends on how much another draws, or on when the last
        episode ended.
        """
        for row, rng in zip(rows, rngs, strict=True):
            episode = rng.bit_generator.seed_seq.spawn(1)[0]  # type: ignore[attr-defined]
            self.keys[:, row] = episode.generate_state(2 * len(SOURCES), np.uint64).reshape(-1, 2)

    def begin(
        self,
        rows: NDArray[np.intp],
        grade: ImuGrade,
        errors: GnssErrors,
        bias_sd: FloatArray,
    ) -> None:
        """Draw the errors of a new episode, by its keys.

        `bias_sd` (n,) standard deviation of the satellite biases [m].
        """
        state = self.state
        state.accel_bias[rows] = grade.accel_bias
        state.gyro_bias[rows] = grade.gyro_bias
        state.accel_matrix[rows] = grade.accel_matrix
        state.gyro_matrix[rows] = grade.gyro_matrix
        state.g_dependence[rows] = grade.g_dependence
        state.imu_noise[rows] = grade.noise
        state.residual[rows] = 0.0
        clock = errors.clock
        state.clock[rows] = clock.offset_m, clock.drift_mps
        state.clock_psd[rows] = clock.phase_psd, clock.frequency_psd
        state.gnss_noise[rows] = errors.code_sd_m, errors.range_rate_sd_mps
        state.range_offset[rows] = 0.0
        state.rate_offset[rows] = 0.0
        state.correlated_noise[rows] = errors.correlated_sd_m, errors.correlation_s
        state.correlated[rows] = 0.0
        state.authentic[rows] = 1.0
        deviates = np.empty(padded(len(bias_sd)))
        for row in rows:
            k0, k1 = self.keys[SOURCES.index("bias"), row]
            normals(k0, k1, 0, deviates)
            state.satellite_bias[row] = bias_sd * deviates[: len(bias_sd)]
