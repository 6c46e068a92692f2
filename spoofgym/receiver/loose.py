"""The loosely coupled receiver: 15 states, a strapdown corrected by positions of GNSS.

Inertial samples are mechanized in ECEF axes, exactly as `strapdown` does for the tightly coupled
receiver, and the errors are estimated in local-level axes, as `shadmehri2025` has them.  At every
position the filter estimates the errors and takes them out of the solution (closed loop); the
covariance is Joseph's form, which is right for the weights of a verdict, too.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from ..core.declared import setting, settings_record
from ..core.memory import Memory
from ..core.registry import build_record
from ..earth.wgs84 import DEGREE, MICRO_G
from ._loose_kernels import LooseState, first_estimate, predict, update_loose
from .adaptive import PROCESS, SelfTuning
from .epoch import OPTIONAL, Epoch, EpochMaker, FloatArray, without_channels
from .loose_states import POSITION, STATES


@settings_record(frozen=True, kw_only=True)
class LooselyCoupled:
    """Settings of the 15-state closed-loop loosely coupled receiver.

    Notes
    -----
    The defaults are those of `shadmehri2025`, section 4.2.  It writes a covariance of 15 states
    with three numbers in metres for the position; in radians of latitude they would be absurd.
    """

    horizontal_sd_m: float = setting(
        default=3.7,
        above=0.0,
        unit="m",
        help="Assumed white noise of a GNSS position to the east and to the north: R of the "
        "filter, or where self-tuning begins.",
    )
    vertical_sd_m: float = setting(
        default=6.0, above=0.0, unit="m", help="Assumed white noise of a GNSS position upwards."
    )
    gyro_noise_deg_per_rth: float = setting(
        default=0.005,
        least=0.0,
        unit="deg/sqrt(h)",
        help="Root power spectral density of the noise that drives the attitude.",
    )
    accel_noise_ug_per_rthz: float = setting(
        default=20.0,
        least=0.0,
        unit="ug/sqrt(Hz)",
        help="Root power spectral density of the noise that drives the velocity.",
    )
    position_noise_m_per_rth: float = setting(
        default=1.0,
        least=0.0,
        unit="m/sqrt(h)",
        help="Root power spectral density of the noise that drives the position.",
    )
    tilt_arcsec: float = setting(
        default=20.0, least=0.0, unit="arcsec", help="Initial standard deviation of the tilt."
    )
    heading_arcsec: float = setting(
        default=180.0, least=0.0, unit="arcsec", help="Initial standard deviation of the heading."
    )
    velocity_mps: float = setting(
        default=0.1,
        least=0.0,
        unit="m/s",
        help="Initial standard deviation of the velocity; that of the position is R's.",
    )
    gyro_bias_deg_per_h: float = setting(
        default=0.01,
        least=0.0,
        unit="deg/h",
        help="Initial standard deviation of the gyros' biases.",
    )
    accel_bias_ug: float = setting(
        default=100.0,
        least=0.0,
        unit="ug",
        help="Initial standard deviation of the accelerometers' biases.",
    )
    initial_factor: float = setting(
        default=3.0, least=0.0, help="Factor of all initial standard deviations."
    )
    self_tuning: SelfTuning | Mapping[str, Any] | None = setting(
        default=None, help="How the noise adapts; None for the conventional filter."
    )

    def __post_init__(self) -> None:
        if self.self_tuning is not None:
            tuning = build_record("self_tuning", SelfTuning, self.self_tuning)
            object.__setattr__(self, "self_tuning", tuning)

    @property
    def tuning(self) -> SelfTuning | None:
        return self.self_tuning if isinstance(self.self_tuning, SelfTuning) else None

    def noise_variance(self) -> FloatArray:
        """(3,) assumed variance of a position, east, north, up [m^2]."""
        return np.array([self.horizontal_sd_m, self.horizontal_sd_m, self.vertical_sd_m]) ** 2

    def initial_sd(self) -> FloatArray:
        """(15,) standard deviations of the state at time zero, SI units and radians."""
        tilt, heading = self.tilt_arcsec * DEGREE / 3600.0, self.heading_arcsec * DEGREE / 3600.0
        return self.initial_factor * np.concatenate(
            [
                [tilt, tilt, heading],
                np.full(3, self.velocity_mps),
                np.sqrt(self.noise_variance()),
                np.full(3, self.gyro_bias_deg_per_h * DEGREE / 3600.0),
                np.full(3, self.accel_bias_ug * MICRO_G),
            ]
        )

    def noise_psd(self) -> FloatArray:
        """(15,) power spectral density of the noise that drives each state."""
        attitude = (self.gyro_noise_deg_per_rth * DEGREE / 60.0) ** 2
        velocity = (self.accel_noise_ug_per_rthz * MICRO_G) ** 2
        position = self.position_noise_m_per_rth**2 / 3600.0
        return np.repeat([attitude, velocity, position, 0.0, 0.0], 3)


class LooseReceivers:
    """A batch of loosely coupled receivers.

    - `memory`: of B receivers; what changes from one epoch to the next is declared in it;
    - `samples`: inertial samples of an epoch;
    - `samples` (B, S, 6) measured specific force and angular rate, to be written before `predict`;
    - `fix_e` (B, 3) GNSS position, ECEF [m], to be written before `predict`;
    - `fields`: optional ones that its epochs have.
    """

    def __init__(
        self,
        settings: LooselyCoupled,
        memory: Memory,
        samples: int,
        imu_interval_s: float,
        fields: Collection[str] = OPTIONAL,
    ) -> None:
        self.settings, self.memory = settings, memory
        self._lengths, self._tau = np.full(samples, imu_interval_s), samples * imu_interval_s
        b, tuning = memory.receivers, settings.tuning
        window = tuning.window if tuning else 0
        self._rule = PROCESS[tuning.process] if tuning else PROCESS["fixed"]
        self._floor = tuning.floor_m**2 if tuning else 0.0
        memory.declare_all(
            position_e=np.zeros((b, 3)),
            velocity_e=np.zeros((b, 3)),
            C_eb=np.tile(np.eye(3), (b, 1, 1)),
            bias=np.zeros((b, 6)),
            covariance=np.tile(np.diag(settings.initial_sd() ** 2), (b, 1, 1)),
            innovation=np.zeros((b, 3)),
            innovation_cov=np.tile(np.eye(3), (b, 1, 1)),
            measurement_cov=np.tile(np.diag(settings.noise_variance()), (b, 1, 1)),
            process_scale=np.ones(b),
            residuals=np.zeros((b, window, 3)),
            innovations=np.zeros((b, window if self._rule else 0, 3)),
            seen=np.zeros(b, dtype=np.int64),
        )
        self.samples, self.fix_e = np.zeros((b, samples, 6)), np.zeros((b, 3))
        self._psd = settings.noise_psd()
        self._transition = np.tile(np.eye(STATES), (b, 1, 1))
        self._imu_delta = np.zeros((b, 6))
        self._design = np.zeros((b, 3, STATES))
        self._design[:, np.arange(3), POSITION + np.arange(3)] = -1.0
        self._ones = np.ones((b, 3))
        constant = {"interval": np.full(b, self._tau), "design": self._design}
        self._epoch = EpochMaker(fields, {**constant, **without_channels(b)})

    @property
    def state(self) -> LooseState:
        return LooseState(*[self.memory[name] for name in LooseState._fields])

    def start_episodes(
        self, position_e: FloatArray, velocity_e: FloatArray, C_eb: FloatArray, error: FloatArray
    ) -> None:
        """Begin at a true state, apart from the errors (B, 15) of the alignment."""
        first_estimate(self.state, position_e, velocity_e, C_eb, error)

    def predict(self) -> None:
        self.predict_over(self.samples, self._lengths, self._tau)

    def predict_over(self, samples: FloatArray, lengths: FloatArray, tau: float) -> None:
        """The same for samples (B, S, 6) of any `lengths` (S,), `tau` together [s]."""
        measured = samples, lengths, tau, self.fix_e
        predict(self.state, *measured, self._psd, self._transition, self._imu_delta)

    def update(self, weights: FloatArray | None) -> None:
        update_loose(
            self.state, self._ones if weights is None else weights, self._rule, self._floor
        )

    def epoch(self, time: FloatArray) -> Epoch:
        """What a detector may see, between `predict` and `update`. `time` (B,) of the epoch [s];
        returns read-only copies; n = 0, and m = 3 coordinates, east, north, up."""
        state = self.state
        return self._epoch(
            time=time,
            innovation=state.innovation,
            innovation_variance=state.innovation_cov.diagonal(0, 1, 2),
            innovation_cov=state.innovation_cov,
            predicted_cov=state.covariance,
            predicted_position=state.position_e,
            predicted_velocity=state.velocity_e,
            transition=self._transition,
            imu_delta=self._imu_delta,
            gnss_position=self.fix_e,
        )
