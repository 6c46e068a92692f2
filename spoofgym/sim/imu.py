"""Inertial sensors: three grades of errors.

    f_m = b_a + (I + M_a) f + noise,      w_m = b_g + (I + M_g) w + G_g f + noise,

white noise of a given root power spectral density, then rounded to the quantization level, what
the rounding left over being carried to the next sample.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..earth.wgs84 import STANDARD_GRAVITY

_UG = STANDARD_GRAVITY * 1e-6
_DEG = math.pi / 180.0
_DEG_PER_HOUR = _DEG / 3600.0
_DEG_PER_ROOT_HOUR = _DEG / 60.0

Rows = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


class ImuGrade(NamedTuple):
    """Errors of one grade of inertial sensors, in the units of data sheets.

    - `attitude_error_deg`: initial error of the attitude about north, east, down [deg];
    - `accel_bias_ug`, `gyro_bias_deg_per_h`: constant biases, body x, y, z;
    - `accel_matrix_ppm`, `gyro_matrix_ppm`: scale-factor and cross-coupling errors, row by row;
    - `gyro_g_dependence`: g-dependent gyro bias, row by row [deg/h/g];
    - `accel_quantization`, `gyro_quantization`: quantization levels [m/s^2], [rad/s].
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

    @property
    def accel_bias(self) -> NDArray[np.float64]:
        """(3,) accelerometer bias, body axes [m/s^2]."""
        return np.array(self.accel_bias_ug) * _UG

    @property
    def gyro_bias(self) -> NDArray[np.float64]:
        """(3,) gyro bias, body axes [rad/s]."""
        return np.array(self.gyro_bias_deg_per_h) * _DEG_PER_HOUR

    @property
    def accel_matrix(self) -> NDArray[np.float64]:
        """(3, 3) I + M_a."""
        return np.eye(3) + np.array(self.accel_matrix_ppm) * 1e-6

    @property
    def gyro_matrix(self) -> NDArray[np.float64]:
        """(3, 3) I + M_g."""
        return np.eye(3) + np.array(self.gyro_matrix_ppm) * 1e-6

    @property
    def g_dependence(self) -> NDArray[np.float64]:
        """(3, 3) G_g [rad s/m]."""
        return np.array(self.gyro_g_dependence) * _DEG_PER_HOUR / STANDARD_GRAVITY

    @property
    def noise(self) -> NDArray[np.float64]:
        """(4,) root PSD of accelerometers and gyros [m/s^1.5], [rad/s^0.5], quantization levels."""
        return np.array(
            [
                self.accel_noise_ug_per_rthz * _UG,
                self.gyro_noise_deg_per_rth * _DEG_PER_ROOT_HOUR,
                self.accel_quantization,
                self.gyro_quantization,
            ]
        )


_ZERO: Rows = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

IMU_GRADES: dict[str, ImuGrade] = {
    "aviation": ImuGrade(
        attitude_error_deg=(-0.01, 0.008, 0.01),
        accel_bias_ug=(30.0, -45.0, 26.0),
        gyro_bias_deg_per_h=(-0.0009, 0.0013, -0.0008),
        accel_matrix_ppm=((100.0, -120.0, 80.0), (-60.0, -120.0, 100.0), (-100.0, 40.0, 90.0)),
        gyro_matrix_ppm=((8.0, -120.0, 100.0), (0.0, -6.0, -60.0), (0.0, 0.0, -7.0)),
        gyro_g_dependence=_ZERO,
        accel_noise_ug_per_rthz=20.0,
        gyro_noise_deg_per_rth=0.002,
        accel_quantization=5e-5,
        gyro_quantization=1e-6,
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
    ),
}
"""Sensor errors by grade (`groves2013`, the book's software)."""
