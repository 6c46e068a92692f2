"""The tightly coupled receiver: which filter, tuned for which inertial sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.declared import check_number, setting, settings_record
from ..core.registry import require
from ..earth.wgs84 import DEGREE, MICRO_G
from .kalman import COVARIANCE_UPDATES
from .states import SIZES

CONVENTIONS = ("groves", "orthonormal")
TUNINGS = ("paper", "matched", "augmented")


class FilterGrade(NamedTuple):
    """How the filter is tuned for one grade of inertial sensors.

    - `attitude_sd`, `velocity_sd`, `position_sd`: initial standard deviations [rad], [m/s], [m];
      the last two also of clock drift and offset;
    - `accel_bias_sd`, `gyro_bias_sd`: initial standard deviations [m/s^2], [rad/s];
    - `gyro_noise_psd`, `accel_noise_psd` [rad^2/s], [m^2/s^3];
    - `accel_bias_psd`, `gyro_bias_psd` [m^2/s^5], [rad^2/s^3].
    """

    attitude_sd: float
    velocity_sd: float
    position_sd: float
    accel_bias_sd: float
    gyro_bias_sd: float
    gyro_noise_psd: float
    accel_noise_psd: float
    accel_bias_psd: float
    gyro_bias_psd: float


FILTER_GRADES: dict[str, FilterGrade] = {
    "aviation": FilterGrade(
        0.01 * DEGREE,
        0.1,
        10.0,
        30.0 * MICRO_G,
        0.001 * DEGREE / 3600.0,
        (0.004 * DEGREE / 60.0) ** 2,
        (40.0 * MICRO_G) ** 2,
        3e-9,
        2e-16,
    ),
    "tactical": FilterGrade(
        1.0 * DEGREE,
        0.1,
        10.0,
        1000.0 * MICRO_G,
        10.0 * DEGREE / 3600.0,
        (0.02 * DEGREE / 60.0) ** 2,
        (200.0 * MICRO_G) ** 2,
        1e-7,
        2e-12,
    ),
    "consumer": FilterGrade(
        2.0 * DEGREE,
        0.1,
        10.0,
        10000.0 * MICRO_G,
        200.0 * DEGREE / 3600.0,
        0.01**2,
        0.2**2,
        1e-5,
        4e-11,
    ),
}  # filter tuning by grade of the inertial sensors (`groves2013`, the book's software)


class NoiseModel(NamedTuple):
    """What the filter assumes of GNSS errors, of its clock and of its inertial sensors.

    Attributes
    ----------
    pseudorange_sd, range_rate_sd : float
        Standard deviations [m], [m/s].
    clock_phase_psd, clock_frequency_psd : float
        [m^2/s], [m^2/s^3].
    inertial : FilterGrade or None
        Inertial sensors and initial errors, if other than those of `FILTER_GRADES`.
    """

    pseudorange_sd: float = 2.5
    range_rate_sd: float = 0.1
    clock_phase_psd: float = 1.0
    clock_frequency_psd: float = 1.0
    inertial: FilterGrade | None = None


@settings_record(frozen=True, kw_only=True)
class TightlyCoupled:
    """Settings of the 17-state closed-loop tightly coupled receiver."""

    grade: str = setting(
        default="aviation",
        one_of=FILTER_GRADES,
        help="Inertial sensors that the filter is tuned for.",
    )
    tuning: str = setting(
        default="paper",
        one_of=TUNINGS,
        help='Noise that the filter assumes.  ``"paper"``: what the papers print, 2.5 m, 0.1 m/s '
        "and a clock PSD of 1, which overstates the world's, and the inertial sensors of the "
        'book\'s software.  ``"matched"``: GNSS noise and clock as the world has them, satellite '
        "biases that last for the run as a pseudorange noise that leaves the position their "
        "spread, and the data sheet of the inertial sensors with what its errors of scale make of "
        "the run's manoeuvres (`matching` derives both).  Its covariance is that of its "
        "errors where there are no such biases; with them it is too large early in the run, and "
        'the innovation covariance of pseudoranges all the time.  ``"augmented"``: states for all '
        "of these instead (`spoofgym.receiver.augmented`), so that innovations are white; the "
        'covariance update is ``"unweighted"``.  A replay of measurements, which knows no world, '
        "takes `noise` instead.",
    )
    covariance_update: str = setting(
        default="unweighted",
        one_of=COVARIANCE_UPDATES,
        help="What a detector's weights W on the gain do to the covariance: nothing, "
        "``(I - K H) P``; the symmetric part of ``(I - K W H) P``; or the form right for any gain. "
        "The three are the same where all weights are 1.",
    )
    conventions: str = setting(
        default="groves",
        one_of=CONVENTIONS,
        help='Upkeep of the attitude.  ``"groves"`` keeps every convention of the reference '
        'software; ``"orthonormal"`` re-orthonormalizes the attitude matrix after each update.',
    )
    min_satellites: int = setting(
        default=4,
        least=0,
        most=32,
        help="With fewer visible satellites the receiver coasts on its inertial sensors.",
    )
    noise: NoiseModel | None = setting(
        default=None,
        help="Replaces the GNSS noise and the clock that the receiver assumes, and the inertial "
        "sensors, too, where `inertial` is given.",
    )

    def __post_init__(self) -> None:
        if self.tuning == "augmented":
            self._check_augmented()
        if self.noise is not None:
            values = self.noise._asdict()
            inertial = values.pop("inertial")
            if inertial is not None:
                values |= {f"inertial.{name}": x for name, x in inertial._asdict().items()}
            for name, value in values.items():
                if name in ("pseudorange_sd", "range_rate_sd"):
                    check_number(f"noise.{name}", value, above=0.0)
                else:
                    check_number(f"noise.{name}", value, least=0.0)

    def _check_augmented(self) -> None:
        require(
            self.noise is None, '`noise` can\'t be set with `tuning` "augmented", which derives it'
        )
        require(
            self.covariance_update == "unweighted",
            '`covariance_update` must be "unweighted" with `tuning` "augmented", got '
            f"{self.covariance_update!r}",
        )

    @property
    def matches(self) -> bool:
        return self.tuning != "paper" and self.noise is None

    @property
    def noise_model(self) -> NoiseModel:
        """Assumed GNSS noise and clock where no world has others."""
        return self.noise if self.noise is not None else NoiseModel()

    def sensors(self, noise: NoiseModel | None = None) -> FilterGrade:
        model = self.noise_model if noise is None else noise
        return FILTER_GRADES[self.grade] if model.inertial is None else model.inertial

    @property
    def covariance_code(self) -> int:
        return COVARIANCE_UPDATES[self.covariance_update]

    @property
    def orthonormalize(self) -> bool:
        return self.conventions == "orthonormal"

    def initial_covariance(self, noise: NoiseModel | None = None) -> NDArray[np.float64]:
        """Covariance of the state at time zero: (17, 17) diagonal."""
        g = self.sensors(noise)
        biases = g.accel_bias_sd, g.gyro_bias_sd
        sds = g.attitude_sd, g.velocity_sd, g.position_sd, *biases, g.position_sd, g.velocity_sd
        return np.diag(np.repeat(np.array(sds, dtype=np.float64), SIZES) ** 2)

    def noise_psd(self, noise: NoiseModel | None = None) -> NDArray[np.float64]:
        """Power spectral density of the noise that drives each state: (17,)."""
        g = self.sensors(noise)
        clock = self.noise_model if noise is None else noise
        inertial = g.gyro_noise_psd, g.accel_noise_psd, 0.0, g.accel_bias_psd, g.gyro_bias_psd
        psd = *inertial, clock.clock_phase_psd, clock.clock_frequency_psd
        return np.repeat(np.array(psd, dtype=np.float64), SIZES)


@dataclass(frozen=True, kw_only=True)
class NavState:
    """Navigation solution at time zero.

    Parameters
    ----------
    position_e, velocity_e : array_like
        (3,) ECEF [m], [m/s].
    C_eb : array_like
        (3, 3) attitude, to ECEF from body axes.
    clock_bias_m, clock_drift_mps : float
        Receiver clock [m], [m/s], which a loosely coupled receiver has not.
    attitude_sd : float
        Least standard deviation of the attitude, whatever the receiver assumes [rad].
    """

    position_e: ArrayLike
    velocity_e: ArrayLike
    C_eb: ArrayLike
    clock_bias_m: float = 0.0
    clock_drift_mps: float = 0.0
    attitude_sd: float = 0.0

    def __post_init__(self) -> None:
        for name, shape in (("position_e", (3,)), ("velocity_e", (3,)), ("C_eb", (3, 3))):
            array = np.array(getattr(self, name), dtype=np.float64)
            require(
                array.shape == shape and np.isfinite(array).all(),
                f"`{name}` must be finite and of shape {shape}, got {array!r}",
            )
            object.__setattr__(self, name, array)
        for name in ("clock_bias_m", "clock_drift_mps", "attitude_sd"):
            value = float(getattr(self, name))
            require(math.isfinite(value), f"`{name}` must be finite, got {value}")
            object.__setattr__(self, name, value)


def raise_attitude(P: NDArray[np.float64], initial: NavState) -> None:
    """Raise variances of the first three states of (s, s) to those of the initial attitude."""
    rows = np.arange(3)
    P[rows, rows] = np.maximum(P[rows, rows], initial.attitude_sd**2)
