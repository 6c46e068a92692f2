"""Wheeled robots on a closed course: dead reckoning, and GNSS positions that a spoofer displaces.

The victim is the credible Kalman filter, and the detector decides which fixes it believes.  With a
high limit of the rate a displacement jumps within one fix.

Source: `song2021`; the physics is in `truth.robot` and `receiver.credible`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number
from ..core.registry import build_record, require
from ..core.settings import describe
from ..detectors import Detector, DetectorContext
from ..receiver.credible import AXES, CredibleBatch, CredibleFilter
from ..truth._kernels import measure_fix, measure_odometry
from ..truth.noise import BLOCK
from ..truth.robot import MOST_SAMPLES, SOURCES, FixErrors, Odometer, RobotLoop, episode_keys
from .domain import Choice, Domain, FloatArray
from .loose import RateSimulator
from .setup import MOST_EPOCHS, RateCommands, Run, Setup, Timeline
from .simulator import Written

DEFAULT_DETECTOR: dict[str, Any] = {"name": "acna", "variant": "production"}


class WheeledRobotSetup(Setup):
    """Course, victim and detector of wheeled robots.

    Parameters
    ----------
    detector, timeline, domain, target_heading_deg, decision_interval_s, between : optional
        As in `SpoofEnv`; by default ``acna`` in production, and 60 s with the detector live, 150 s
        and 10 s.  A domain has `start_s`, the time on the course at which the robot is switched on;
        None as the latest is one lap after the earliest.
    interval_s : float
        Time between fixes, a multiple of the encoders' sample interval.
    rate_limit_mps : float
        Rate of the displacement to the north and to the east that a command of 1 means.
    displacement_scale_m : float
        Displacement, and error of the estimate, that is observed as 1.
    position_scale_m, velocity_scale_mps : float
        Motion of the target since the onset, and its velocity, that are observed as 1.
    loop : mapping or RobotLoop, optional
        The course.
    odometer : mapping or Odometer, optional
        Encoders and heading.
    fix_errors : mapping or FixErrors, optional
        GNSS position errors.
    receiver : mapping or CredibleFilter, optional
        Settings of the victim.
    interruptions_s : sequence of pairs of float
        Start and end of the times without a fix, counted from the start of the episode.

    Attributes
    ----------
    track : RobotTrack
        Truth at every sample of the encoders.
    true_velocity_ne : ndarray
        (K, 2) truth at every epoch, north and east [m/s].
    available : ndarray
        (K,) bool, whether there is a fix, from the start of an episode on.
    """

    kind: ClassVar[str] = "robot"
    env_id: ClassVar[str] = "spoofgym/WheeledRobot-v0"
    of_attack: ClassVar[frozenset[str]] = Setup.of_attack | {
        "displacement_scale_m",
        "position_scale_m",
        "velocity_scale_mps",
    }
    whose: ClassVar[str] = "a wheeled robot"
    has: ClassVar[frozenset[str]] = Setup.has | {"gnss_position", "auxiliary_position"}
    domain_names: ClassVar[frozenset[str]] = frozenset({"start_s"})
    usual_detector = DEFAULT_DETECTOR
    usual_timeline: ClassVar[Mapping[str, float] | None] = {
        "warmup_s": 60.0,
        "live_s": 60.0,
        "attack_s": 150.0,
        "time_to_alert_s": 10.0,
    }
    motion_names = ("position_north", "position_east", "velocity_north", "velocity_east")
    weight_names = ("fix",)

    def __init__(
        self,
        *,
        detector: str | Mapping[str, Any] | Detector | None = None,
        timeline: Mapping[str, float] | Timeline | None = None,
        interval_s: float = 1.0,
        rate_limit_mps: float = 1.0,
        displacement_scale_m: float = 10.0,
        position_scale_m: float = 10.0,
        velocity_scale_mps: float = 1.0,
        loop: Mapping[str, float] | RobotLoop | None = None,
        odometer: Mapping[str, float] | Odometer | None = None,
        fix_errors: Mapping[str, float] | FixErrors | None = None,
        receiver: Mapping[str, float] | CredibleFilter | None = None,
        interruptions_s: Sequence[Sequence[float]] = (),
        domain: Mapping[str, Any] | Domain | None = None,
        target_heading_deg: float | str = 90.0,
        decision_interval_s: float | None = None,
        between: str = "hold",
    ) -> None:
        positive = {
            "interval_s": interval_s,
            "rate_limit_mps": rate_limit_mps,
            "displacement_scale_m": displacement_scale_m,
            "position_scale_m": position_scale_m,
            "velocity_scale_mps": velocity_scale_mps,
        }
        for name, value in positive.items():
            check_number(name, value, above=0.0)
        self.name = self.kind
        self.attack = RateCommands(
            self.kind, ("north_rate", "east_rate"), (float(rate_limit_mps),) * 2
        )
        self.scales = {
            "length_m": displacement_scale_m,
            "position_m": position_scale_m,
            "velocity_mps": velocity_scale_mps,
        }
        self.loop = build_record("loop", RobotLoop, loop)
        self.odometer = build_record("odometer", Odometer, odometer)
        self.fix_errors = build_record("fix_errors", FixErrors, fix_errors)
        self.receiver = build_record("receiver", CredibleFilter, receiver)
        self._aim(target_heading_deg, domain)
        self._phase(detector, timeline, float(interval_s), decision_interval_s, between)
        self._drive()
        self._interruptions_s = interruptions_s
        self._interrupt(interruptions_s)

    def world_settings(self) -> dict[str, Any]:
        names = ("loop", "odometer", "fix_errors", "receiver", "domain")
        parts = {name: describe(getattr(self, name)) for name in names}
        return {**parts, "interruptions_s": [list(pair) for pair in self._interruptions_s]}

    def _drive(self) -> None:
        ratio = self.interval_s / self.odometer.sample_interval_s
        self.samples = round(ratio)
        require(
            1 <= self.samples <= MOST_SAMPLES and abs(ratio - self.samples) <= 1e-6,
            f"`interval_s` must be 1 to {MOST_SAMPLES} times the sample interval of the "
            f"odometer, {self.odometer.sample_interval_s}, got {self.interval_s}",
        )
        early, late = self.domain.start_s
        late = early + self.loop.lap_s if late is None else late
        require(
            late <= MOST_EPOCHS * self.interval_s,
            f"`start_s` must be within 0 and {MOST_EPOCHS * self.interval_s:g} s, got "
            f"{self.domain.start_s}",
        )
        self.epochs_each = self.length + math.floor(late / self.interval_s + 1e-6) + 1
        self.bounds = self._bounds(1, 1, 1, *self._starts(self.epochs_each, "the course"))
        self.epoch_time = np.arange(self.epochs_each, dtype=np.float64) * self.interval_s
        samples = (self.epochs_each - 1) * self.samples
        self.track = self.loop.track(samples, self.odometer.sample_interval_s)
        self.wheels = self.track.wheels(self.odometer.wheel_base_m)
        self.true_position = np.ascontiguousarray(self.track.position_ne[:: self.samples])
        self.C_en = np.broadcast_to(np.eye(AXES), (self.epochs_each, AXES, AXES))
        self.true_velocity_ne = np.ascontiguousarray(self.track.velocity_ne[:: self.samples])

    def _interrupt(self, interruptions_s: Sequence[Sequence[float]]) -> None:
        """Epochs that have a fix; the first one has, since the filter starts there."""
        pairs = np.array(interruptions_s, dtype=np.float64)
        if pairs.size == 0:
            pairs = np.empty((0, 2))
        right = pairs.ndim == 2 and pairs.shape[1] == 2
        require(
            right and (pairs[:, 0] > 0.0).all() and (pairs[:, 0] < pairs[:, 1]).all(),
            "`interruptions_s` must be pairs (start, end) with 0 < start < end, got "
            f"{interruptions_s}",
        )
        time = np.arange(self.length + 1)[:, None] * self.interval_s
        self.available: NDArray[np.bool_] = np.all(
            (time < pairs[:, 0]) | (time >= pairs[:, 1]), axis=1
        )

    def simulator(self, receivers: int, run: Run) -> WheeledRobotSimulator:
        return WheeledRobotSimulator(self, receivers, run)


class WheeledRobotSimulator(RateSimulator):
    """B wheeled robots; `filters` are theirs, `increment` (B, 2) is their dead reckoning [m]."""

    setup: WheeledRobotSetup

    def _allocate(self) -> None:
        super()._allocate()
        b, memory, setup = self.receivers, self.memory, self.setup
        memory.declare_all(
            keys=np.zeros((b, len(SOURCES), 2), dtype=np.uint64),
            phase=np.zeros((b, 2)),
            yaw=np.zeros(b),
            correlated=np.zeros((b, AXES)),
            fix=np.zeros((b, AXES)),
        )
        self.filters = CredibleBatch(setup.receiver, memory, setup.interval_s, self.fields)
        self.increment = np.zeros((b, AXES))
        self._noise = np.empty(BLOCK)

    def _context(self) -> DetectorContext:
        variance = np.full(AXES, self.setup.receiver.noise_variance)
        return DetectorContext(self.receivers, 0, self.setup.interval_s, variance, ())

    def _keys(self, episode: np.random.SeedSequence) -> NDArray[np.uint64]:
        return episode_keys(episode)[0]

    def _seed(self, row: int, episode: np.random.SeedSequence) -> None:
        self.memory["keys"][row], self.memory["phase"][row] = episode_keys(episode)

    def _start(self, choice: Choice) -> None:
        super()._start(choice)
        self.filters.start_episodes(self.memory["fix"])

    def _observe(self) -> None:
        memory, setup = self.memory, self.setup
        odometer, errors = setup.odometer, setup.fix_errors
        drawn = memory["keys"], memory["epoch"], memory["first"]
        step, used = (setup.samples, odometer.count_m), (memory["phase"], self._noise)
        yaw = math.radians(odometer.hard_iron_deg), math.radians(odometer.yaw_noise_deg)
        written = memory["yaw"], self.increment
        measure_odometry(*drawn, *setup.wheels, setup.track.yaw, *step, *yaw, *used, *written)
        truth = setup.true_position, setup.available
        sizes = errors.correlated_sd_m, errors.decay(setup.interval_s), errors.white_sd_m
        written = memory["correlated"], memory["fix"]
        measure_fix(*drawn, *truth, *sizes, memory["displacement"], self._noise, *written)

    def _measure(self, command: FloatArray | None) -> None:
        super()._measure(command)
        self.epoch = self.filters.predict(self.time_s(), self.increment, self.memory["fix"])

    def _correct(self, weights: FloatArray | None) -> None:
        self.filters.update(weights)

    @property
    def coasting(self) -> NDArray[np.bool_]:
        return np.asarray(~self.setup.available[self.epochs - self.memory["first"]])

    @property
    def position(self) -> FloatArray:
        return self.memory["position"][:, :AXES]

    def error_n(self) -> FloatArray:
        return self.position - self.setup.true_position[self.epochs]

    def observed_weights(self) -> FloatArray:
        return np.asarray(self.weights.mean(axis=1, keepdims=True))

    def motion(self, per_position: float, per_velocity: float, out: Written) -> None:
        setup, truth = self.setup, self.setup.true_position
        out[:, :AXES] = per_position * (truth[self.epochs] - truth[self.onset])
        out[:, AXES:] = per_velocity * setup.true_velocity_ne[self.epochs]
