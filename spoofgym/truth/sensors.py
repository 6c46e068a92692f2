"""Inertial sensors of three grades, and the errors, clocks and keys of a batch's sensors.

    f_m = b_a + (I + M_a) f + noise,      w_m = b_g + (I + M_g) w + G_g f + noise,

white noise of a given root power spectral density, then rounded to the quantization level, what
the rounding left over being carried to the next sample.  What kernels need at every epoch lies in
lane arrays, group by group.

Where biases wander, a first-order Gauss-Markov process comes to each of the constant ones, the same
over an interval between two epochs, stationary from the start.  Its standard deviation is what a
data sheet calls in-run bias stability, which is the lowest point of the Allan deviation; that of
the process itself has its highest one at 0.62 of it.  Sources by grade:

- aviation: a tenth of the constant biases of that class, 30 to 100 ug and 0.01 deg/h (`groves2013`,
  section 4.4.1);
- tactical: `stim300`;
- consumer: `adis16405`.

The correlation time is a choice: programs that simulate such sensors take 100 s to an hour.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.lanes import LaneFields
from ..earth.wgs84 import DEGREE, MICRO_G, STANDARD_GRAVITY
from .gnss_errors import GnssErrors
from .noise import BLOCK, normals, pad_count
from .signal_errors import FloatArray, SignalErrors, signal_shapes, start_signals

_DEG_PER_HOUR = DEGREE / 3600.0

Rows = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


class ImuGrade(NamedTuple):
    """Errors of one grade of inertial sensors, in the units of data sheets.

    - `attitude_error_deg`: initial error of the attitude about north, east, down [deg];
    - `accel_bias_ug`, `gyro_bias_deg_per_h`: constant biases, body x, y, z;
    - `accel_matrix_ppm`, `gyro_matrix_ppm`: scale-factor and cross-coupling errors, row by row;
    - `gyro_g_dependence`: g-dependent gyro bias, row by row [deg/h/g];
    - `accel_quantization`, `gyro_quantization`: quantization levels [m/s^2], [rad/s];
    - `accel_in_run_ug`, `gyro_in_run_deg_per_h`, `in_run_s`: standard deviations of what biases
      wander by during a run, and its correlation time [s].
    """

    attitude_error_deg: tuple[float, float, float]
    accel_bias_ug: tuple[float, float, float]
    gyro_bias_deg_per_h: tuple[float, float, float]
    accel_matrix_ppm: Rows
    gyro_matrix_ppm: Rows
    gyro_g_dependence: Rows
    accel_noise_ug_per_rthz: float
    gyro_noise_deg_per_rth: float
    accel_quantization: float
    gyro_quantization: float
    accel_in_run_ug: float
    gyro_in_run_deg_per_h: float
    in_run_s: float = 1000.0

    @property
    def accel_bias(self) -> NDArray[np.float64]:
        return np.array(self.accel_bias_ug) * MICRO_G

    @property
    def gyro_bias(self) -> NDArray[np.float64]:
        return np.array(self.gyro_bias_deg_per_h) * _DEG_PER_HOUR

    @property
    def accel_matrix(self) -> NDArray[np.float64]:
        return np.eye(3) + np.array(self.accel_matrix_ppm) * 1e-6

    @property
    def gyro_matrix(self) -> NDArray[np.float64]:
        return np.eye(3) + np.array(self.gyro_matrix_ppm) * 1e-6

    @property
    def g_dependence(self) -> NDArray[np.float64]:
        return np.array(self.gyro_g_dependence) * _DEG_PER_HOUR / STANDARD_GRAVITY

    @property
    def noise(self) -> NDArray[np.float64]:
        """(4,) root PSD of accelerometers and gyros [m/s^1.5], [rad/s^0.5], quantization levels."""
        return np.array(
            [
                self.accel_noise_ug_per_rthz * MICRO_G,
                self.gyro_noise_deg_per_rth * (DEGREE / 60.0),
                self.accel_quantization,
                self.gyro_quantization,
            ]
        )

    @property
    def in_run(self) -> NDArray[np.float64]:
        """(2,) standard deviations of wandering biases of accelerometers and gyros, SI units."""
        return np.array(
            [self.accel_in_run_ug * MICRO_G, self.gyro_in_run_deg_per_h * _DEG_PER_HOUR]
        )


IMU_GRADES: dict[str, ImuGrade] = {  # sensor errors by grade (`groves2013`, the book's software)
    "aviation": ImuGrade(
        attitude_error_deg=(-0.01, 0.008, 0.01),
        accel_bias_ug=(30.0, -45.0, 26.0),
        gyro_bias_deg_per_h=(-0.0009, 0.0013, -0.0008),
        accel_matrix_ppm=((100.0, -120.0, 80.0), (-60.0, -120.0, 100.0), (-100.0, 40.0, 90.0)),
        gyro_matrix_ppm=((8.0, -120.0, 100.0), (0.0, -6.0, -60.0), (0.0, 0.0, -7.0)),
        gyro_g_dependence=((0.0, 0.0, 0.0),) * 3,
        accel_noise_ug_per_rthz=20.0,
        gyro_noise_deg_per_rth=0.002,
        accel_quantization=5e-5,
        gyro_quantization=1e-6,
        accel_in_run_ug=5.0,
        gyro_in_run_deg_per_h=0.001,
    ),
    "tactical": ImuGrade(
        attitude_error_deg=(-0.05, 0.04, 1.0),
        accel_bias_ug=(900.0, -1300.0, 800.0),
        gyro_bias_deg_per_h=(-9.0, 13.0, -8.0),
        accel_matrix_ppm=(
            (500.0, -300.0, 200.0),
            (-150.0, -600.0, 250.0),
            (-250.0, 100.0, 450.0),
        ),
        gyro_matrix_ppm=((400.0, -300.0, 250.0), (0.0, -300.0, -150.0), (0.0, 0.0, -350.0)),
        gyro_g_dependence=((0.9, -1.1, -0.6), (-0.5, 1.9, -1.6), (0.3, 1.1, -1.3)),
        accel_noise_ug_per_rthz=100.0,
        gyro_noise_deg_per_rth=0.01,
        accel_quantization=1e-2,
        gyro_quantization=2e-4,
        accel_in_run_ug=50.0,
        gyro_in_run_deg_per_h=0.5,
    ),
    "consumer": ImuGrade(
        attitude_error_deg=(-0.5, 0.4, 2.0),
        accel_bias_ug=(9000.0, -13000.0, 8000.0),
        gyro_bias_deg_per_h=(-180.0, 260.0, -160.0),
        accel_matrix_ppm=(
            (50000.0, -15000.0, 10000.0),
            (-7500.0, -60000.0, 12500.0),
            (-12500.0, 5000.0, 20000.0),
        ),
        gyro_matrix_ppm=(
            (40000.0, -14000.0, 12500.0),
            (0.0, -30000.0, -7500.0),
            (0.0, 0.0, -17500.0),
        ),
        gyro_g_dependence=((90.0, -110.0, -60.0), (-50.0, 190.0, -160.0), (30.0, 110.0, -130.0)),
        accel_noise_ug_per_rthz=1000.0,
        gyro_noise_deg_per_rth=1.0,
        accel_quantization=1e-1,
        gyro_quantization=2e-3,
        accel_in_run_ug=200.0,
        gyro_in_run_deg_per_h=25.0,
    ),
}


# Counters, under a satellite bias's key, of the deviates of inertial sensors: of their constants,
# and of the first of the biases that wander.
TURN_ON, IN_RUN = 1, 2
# Sources of chance; each has a key of its own in every episode. New ones come last, which leaves
# the keys of the others as they are.
SOURCES = ("imu", "clock", "gnss", "bias", "trajectory", "domain", "spoofer", "correlated")


def sensor_shapes(channels: int) -> dict[str, tuple[int, ...]]:
    """What is stored of every receiver's sensors, in the order of the lane array.

    - `residual` (6,) what quantization carries to the next sample;
    - `clock` (2,) true clock bias [m] and drift [m/s];
    - `satellite_bias` (n,) constant for an episode [m];
    - `correlated` (n,) correlated code errors of the present epoch [m].
    """
    n = channels
    return {"residual": (6,), "clock": (2,), "satellite_bias": (n,), "correlated": (n,)}


CONSTANTS: dict[str, tuple[int, ...]] = {
    "accel_bias": (3,),
    "gyro_bias": (3,),
    "accel_matrix": (3, 3),
    "gyro_matrix": (3, 3),
    "g_dependence": (3, 3),
    "imu_noise": (4,),
    "clock_psd": (2,),
    "gnss_noise": (2,),
    "correlated_noise": (2,),
}
"""What stays the same of every receiver's sensors for an episode, in the order of the lane array.

- `accel_bias`, `gyro_bias` body axes [m/s^2], [rad/s];
- `accel_matrix`, `gyro_matrix`, `g_dependence` I + M_a, I + M_g and G_g;
- `imu_noise` root PSD of accelerometers and gyros, quantization levels;
- `clock_psd` noise of clock bias and drift;
- `gnss_noise` white noise of pseudoranges [m] and range rates [m/s];
- `correlated_noise` standard deviation [m] and correlation time [s] of the correlated code errors.
"""


WANDERING: dict[str, tuple[int, ...]] = {"bias": (6,), "step": (3,)}
"""What is stored of biases that wander, in the order of the lane array.

- `bias` (6,) accelerometers, gyros, over the interval to the next epoch [m/s^2], [rad/s];
- `step` (3,) factor over one interval, and driving noise of accelerometers and gyros.
"""


def draw_source_keys(episodes: Sequence[np.random.SeedSequence]) -> dict[str, NDArray[np.uint64]]:
    """(b, 2) keys of the noise of each of `SOURCES`, from the seeds of episodes."""
    drawn = np.array([seed.generate_state(2 * len(SOURCES), np.uint64) for seed in episodes])
    return {source: drawn[:, 2 * k : 2 * k + 2] for k, source in enumerate(SOURCES)}


class SensorBuffers:
    """The memory of a batch of sensors, and what an attack adds to their measurements.

    - `fields`: those of `sensor_shapes`;
    - `constants`: those of `CONSTANTS`, stored once where all receivers are `alike`;
    - `words`: key of the noise of each of `SOURCES`, (2,) uint64;
    - `epoch` (B,) int64, the epoch of each receiver;
    - `range_offset`, `rate_offset` (B, n) what the attack adds [m], [m/s];
    - `authentic` (B, 2n) share of the authentic errors that stays, pseudoranges first: 1 without
      a counterfeit signal, 1 down to 0 with one, -1 where the receiver's own noise is replaced,
      too; no rows where no attack replaces errors;
    - `signals`: those of `signal_shapes`; no rows where no receiver has such errors;
    - `in_run`: those of `WANDERING`; no rows where biases are constant.
    """

    def __init__(
        self,
        receivers: int,
        channels: int,
        *,
        with_signals: bool = False,
        with_authentic: bool = False,
        with_in_run: bool = False,
        alike: bool = False,
    ) -> None:
        self.receivers, self.channels = receivers, channels
        self.in_run = LaneFields(receivers, WANDERING if with_in_run else {})
        self.signals = LaneFields(receivers, signal_shapes(channels) if with_signals else {})
        self.fields = LaneFields(receivers, sensor_shapes(channels))
        self.constants = LaneFields(receivers, CONSTANTS, shared=alike)
        self.words = LaneFields(receivers, dict.fromkeys(SOURCES, (2,)), np.uint64)
        self.epoch = np.zeros(receivers, dtype=np.int64)
        self.range_offset = np.zeros((receivers, channels))
        self.rate_offset = np.zeros((receivers, channels))
        self.authentic = np.ones((receivers if with_authentic else 0, 2 * channels))

    @property
    def keys(self) -> NDArray[np.uint64]:
        return np.array([self.words[source] for source in SOURCES])

    def copy_rows(self, to: NDArray[np.intp], other: SensorBuffers, rows: NDArray[np.intp]) -> None:
        for name in ("fields", "constants", "words", "signals", "in_run"):
            getattr(self, name).copy_rows(to, getattr(other, name), rows)
        for name in ("epoch", "range_offset", "rate_offset"):
            getattr(self, name)[to] = getattr(other, name)[rows]
        if len(self.authentic):
            self.authentic[to] = other.authentic[rows] if len(other.authentic) else 1.0

    def draw_keys(self, rows: NDArray[np.intp], rngs: Sequence[np.random.Generator]) -> None:
        """Take the keys of a new episode. `rngs`: one per row. Its seed sequence spawns one child
        an episode, and that gives every source a key, so that no source depends on how much another
        draws, or on when the last episode ended."""
        spawned = [rng.bit_generator.seed_seq.spawn(1) for rng in rngs]  # type: ignore[attr-defined]
        self.put_keys(rows, [episode for (episode,) in spawned])

    def put_keys(
        self,
        rows: NDArray[np.intp],
        episodes: Sequence[np.random.SeedSequence],
        sources: Sequence[str] = SOURCES,
    ) -> None:
        drawn = draw_source_keys(episodes)
        for source in sources:
            self.words.put(source, rows, drawn[source])

    def start_episodes(
        self,
        rows: NDArray[np.intp],
        grade: ImuGrade,
        errors: GnssErrors,
        bias_sd: FloatArray,
        *,
        interval_s: float = 0.0,
        drawn: bool = False,
    ) -> None:
        """Draw the errors of a new episode, by its keys. `bias_sd` (n,) standard deviation of the
        satellite biases [m]; `interval_s` between epochs, for what wanders; `drawn`: whether the
        inertial sensors' constants are others in every episode, as large as those of the grade."""
        clock, n = errors.clock, len(bias_sd)
        constants: dict[str, Any] = {
            "accel_bias": grade.accel_bias,
            "gyro_bias": grade.gyro_bias,
            "accel_matrix": grade.accel_matrix,
            "gyro_matrix": grade.gyro_matrix,
            "g_dependence": grade.g_dependence,
            "imu_noise": grade.noise,
            "clock_psd": (clock.phase_psd, clock.frequency_psd),
            "gnss_noise": (errors.code_sd_m, errors.range_rate_sd_mps),
            "correlated_noise": (errors.correlated_sd_m, errors.correlation_s),
        }
        for name, value in constants.items():
            self.constants.put(name, rows, value)
        first = {"residual": 0.0, "clock": (clock.offset_m, clock.drift_mps), "correlated": 0.0}
        for name, value in first.items():
            self.fields.put(name, rows, value)
        self.range_offset[rows] = self.rate_offset[rows] = 0.0
        if len(self.authentic):
            self.authentic[rows] = 1.0
        deviates, biases = np.empty(pad_count(n)), np.empty((len(rows), n))
        for bias, (k0, k1) in zip(biases, self.words.get("bias", rows), strict=True):
            normals(k0, k1, 0, deviates)
            bias[:] = bias_sd * deviates[:n]
        self.fields.put("satellite_bias", rows, biases)
        if self.signals.rows:
            signals = SignalErrors() if errors.signals is None else errors.signals
            keys = self.words.get("correlated", rows)
            start_signals(self.signals, rows, signals, interval_s, keys)
        if self.in_run.rows:
            self._start_in_run(rows, grade, interval_s)
        if drawn:
            self._draw_constants(rows, grade)

    def _start_in_run(self, rows: NDArray[np.intp], grade: ImuGrade, interval_s: float) -> None:
        sds, factor = grade.in_run, math.exp(-interval_s / grade.in_run_s)
        deviates = self._draw_deviates(rows, IN_RUN)[:, :6]
        self.in_run.put("bias", rows, np.repeat(sds, 3) * deviates)
        self.in_run.put("step", rows, (factor, *(math.sqrt(1.0 - factor * factor) * sds)))

    def _draw_deviates(self, rows: NDArray[np.intp], counter: int) -> FloatArray:
        """(b, BLOCK) under the key of the satellites' biases."""
        deviates = np.empty((len(rows), BLOCK))
        for row, (k0, k1) in zip(deviates, self.words.get("bias", rows), strict=True):
            normals(k0, k1, counter, row)
        return deviates

    def _draw_constants(self, rows: NDArray[np.intp], grade: ImuGrade) -> None:
        """Draw biases and matrices of the inertial sensors, by the RMS of those of the grade."""
        one = np.eye(3)
        means = {
            "accel_bias": (np.zeros(3), grade.accel_bias),
            "gyro_bias": (np.zeros(3), grade.gyro_bias),
            "accel_matrix": (one, grade.accel_matrix - one),
            "gyro_matrix": (one, grade.gyro_matrix - one),
            "g_dependence": (0.0 * one, grade.g_dependence),
        }
        deviates, first = self._draw_deviates(rows, TURN_ON), 0
        for name, (mean, spread) in means.items():
            own = deviates[:, first : first + spread.size].reshape(len(rows), *spread.shape)
            self.constants.put(name, rows, mean + np.sqrt(np.mean(spread**2)) * own)
            first += spread.size
