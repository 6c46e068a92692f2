"""The wheeled robot: dead reckoning and GNSS on a closed course, as a small environment.

The spoofer moves the position that the robot's GNSS receiver reports, by rates of an offset in
north and east.  The victim is the credible Kalman filter, and the detector decides which fixes it
believes.  With a high limit of the rate an offset jumps within one fix.

Source: `song2021`; the physics is in `sim.robot_track`, `sim.odometry` and `receiver.credible`.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from .._registry import build_record
from ..detectors import Detector, DetectorContext, Verdict, make_detector
from ..receiver.credible import AXES, CredibleBatch, CredibleFilter
from ..receiver.epoch import Epoch
from ..sim.noise import BLOCK
from ..sim.odometry import (
    MOST_SAMPLES,
    SOURCES,
    FixErrors,
    Odometer,
    draw_keys,
    measure_fix,
    measure_odometry,
)
from ..sim.robot_track import RobotLoop
from . import robot_observation
from .plant import Plant, bound
from .setup import Timeline
from .sight import Sight

FloatArray = NDArray[np.float64]

DEFAULT_DETECTOR: dict[str, Any] = {"name": "acna", "variant": "production"}
DEFAULT_TIMELINE = {"warmup_s": 60.0, "live_s": 60.0, "attack_s": 150.0, "time_to_alert_s": 10.0}
SPARE_EPOCHS = 2
"""Epochs that a finished receiver may run until it is reset."""


class RobotPlant(Plant):
    """B wheeled robots, each on its own run of the course.

    - `detector`: as `make_detector` takes it; ``acna`` in production by default;
    - `timeline`: settings of `Timeline`; 60 s of warm-up with the detector live, 150 s of attack
      and 10 s of time to alert by default;
    - `interval_s`: time between fixes, a multiple of the encoders' sample interval;
    - `rate_limit_mps`: rate of the offset in north and in east that an action of 1 commands;
    - `displacement_scale_m`: displacement, and error of the estimate, that is observed as 1;
    - `position_scale_m`, `velocity_scale_mps`: motion of the target since the onset, and its
      velocity, that are observed as 1;
    - `loop`, `odometer`, `fix_errors`, `receiver`: settings of `RobotLoop`, `Odometer`, `FixErrors`
      and `CredibleFilter`;
    - `interruptions_s`: start and end of the times without a fix, counted from the start of the
      episode.
    """

    kind: ClassVar[str] = "robot"

    def __init__(
        self,
        receivers: int,
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
    ) -> None:
        for name, value in (
            ("interval_s", interval_s),
            ("rate_limit_mps", rate_limit_mps),
            ("displacement_scale_m", displacement_scale_m),
            ("position_scale_m", position_scale_m),
            ("velocity_scale_mps", velocity_scale_mps),
        ):
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"`{name}` must be finite and > 0, got {value}")
        self.interval_s, self.rate_limit_mps = interval_s, rate_limit_mps
        self.displacement_scale_m, self.position_scale_m = displacement_scale_m, position_scale_m
        self.velocity_scale_mps = velocity_scale_mps
        self.loop = build_record("loop", RobotLoop, loop)
        self.odometer = build_record("odometer", Odometer, odometer)
        self.fix_errors = build_record("fix_errors", FixErrors, fix_errors)
        self.filter = build_record("receiver", CredibleFilter, receiver)
        self.timeline = build_record("timeline", Timeline, timeline, DEFAULT_TIMELINE)
        self.quiet, self.live, self.steps, self.hold = self.timeline.epochs(interval_s)
        self.onset = self.quiet + self.live
        self.action_names = ("north_rate", "east_rate")
        self.unbound = make_detector(DEFAULT_DETECTOR if detector is None else detector)
        self._drive()
        self._interrupt(interruptions_s)
        self._populate(receivers)

    def _drive(self) -> None:
        """Truth of the run, at the encoders' samples and at the epochs."""
        ratio = self.interval_s / self.odometer.sample_interval_s
        self.samples = round(ratio)
        if not 1 <= self.samples <= MOST_SAMPLES or abs(ratio - self.samples) > 1e-6:
            raise ValueError(
                f"`interval_s` must be 1 to {MOST_SAMPLES} times the sample interval of the "
                f"odometer, {self.odometer.sample_interval_s}, got {self.interval_s}"
            )
        self.epochs = self.onset + self.steps + self.hold + 1 + SPARE_EPOCHS
        samples = (self.epochs - 1) * self.samples
        self.track = self.loop.track(samples, self.odometer.sample_interval_s)
        self._left, self._right = self.track.wheels(self.odometer.wheel_base_m)
        self.true_position_ne = np.ascontiguousarray(self.track.position_ne[:: self.samples])
        self.true_velocity_ne = np.ascontiguousarray(self.track.velocity_ne[:: self.samples])

    def _interrupt(self, interruptions_s: Sequence[Sequence[float]]) -> None:
        """Epochs that have a fix; the first one has, since the filter begins there."""
        time = np.arange(self.epochs) * self.interval_s
        self.available = np.ones(self.epochs, dtype=np.bool_)
        pairs = np.array(interruptions_s, dtype=np.float64)
        if pairs.size == 0:
            pairs = np.empty((0, 2))
        right = pairs.ndim == 2 and pairs.shape[1] == 2
        if not (right and (pairs[:, 0] > 0.0).all() and (pairs[:, 0] < pairs[:, 1]).all()):
            raise ValueError(
                "`interruptions_s` must be pairs (begin, end) with 0 < begin < end, got "
                f"{interruptions_s}"
            )
        for pair in pairs:
            self.available &= (time < pair[0]) | (time >= pair[1])

    def _populate(self, receivers: int) -> None:
        """Memory, filters and detector of B receivers."""
        if receivers < 1:
            raise ValueError(f"`receivers` must be at least 1, got {receivers}")
        b = self.receivers = receivers
        self.memory = Memory(b)
        self.memory.declare("epoch", np.zeros(b, dtype=np.int64))
        self.memory.declare("keys", np.zeros((b, len(SOURCES), 2), dtype=np.uint64))
        self.memory.declare("phase", np.zeros((b, 2)))
        self.memory.declare("yaw", np.zeros(b))
        self.memory.declare("correlated", np.zeros((b, AXES)))
        self.memory.declare("fix", np.zeros((b, AXES)))
        self.memory.declare("offset", np.zeros((b, AXES)))
        self.memory.declare("rate", np.zeros((b, AXES)))
        self.memory.declare("ratio", np.zeros(b))
        self.memory.declare("weight", np.ones(b))
        self.batch = CredibleBatch(self.filter, self.memory, self.interval_s)
        self.increment = np.zeros((b, AXES))
        self._noise = np.empty(BLOCK)
        variance = np.full(AXES, self.filter.noise_variance)
        self.detector = bound(
            self.unbound,
            DetectorContext(b, 0, self.interval_s, variance, ()),
            self.live + self.steps + self.hold,
            "a wheeled robot",
            frozenset({"gnss_position", "auxiliary_position"}),
        )

    def spawn(self, receivers: int) -> RobotPlant:
        """Another batch of the same settings."""
        twin = copy.copy(self)
        twin._populate(receivers)
        return twin

    def begin(self, rngs: Sequence[np.random.Generator]) -> NDArray[np.bool_]:
        """Begin new episodes, and run their clean warm-up.

        Returns (B,) bool, whether the detector alarmed before the onset.
        """
        self.memory.reset()
        self.detector.reset()
        self.memory["keys"], self.memory["phase"] = draw_keys(rngs)
        self._measure()
        self.batch.begin(self.memory["fix"])
        for _ in range(self.quiet):
            self._predict()
            self.batch.update(None)
        alarmed = np.zeros(self.receivers, dtype=np.bool_)
        for _ in range(self.live):
            np.logical_or(alarmed, self._judge(self._predict()), out=alarmed)
        return alarmed

    def advance(self, action: FloatArray | None) -> NDArray[np.bool_]:
        """Run one epoch under attack.

        `action` (B, 2) in [-1, 1]; None holds the rate; returns (B,) bool, whether the detector
        alarms.
        """
        memory = self.memory
        if action is not None:
            memory["rate"] = np.multiply(action, self.rate_limit_mps, dtype=np.float64)
        memory["offset"] = memory["offset"] + memory["rate"] * self.interval_s
        return self._judge(self._predict())

    def _measure(self) -> None:
        memory, odometer, errors = self.memory, self.odometer, self.fix_errors
        measure_odometry(
            memory["keys"],
            memory["epoch"],
            self._left,
            self._right,
            self.track.yaw,
            self.samples,
            odometer.count_m,
            math.radians(odometer.hard_iron_deg),
            math.radians(odometer.yaw_noise_deg),
            memory["phase"],
            self._noise,
            memory["yaw"],
            self.increment,
        )
        measure_fix(
            memory["keys"],
            memory["epoch"],
            self.true_position_ne,
            self.available,
            errors.correlated_sd_m,
            errors.decay(self.interval_s),
            errors.white_sd_m,
            memory["offset"],
            self._noise,
            memory["correlated"],
            memory["fix"],
        )

    def _predict(self) -> Epoch:
        epoch = self.memory["epoch"] + 1
        if epoch.max() >= self.epochs:
            raise RuntimeError(
                f"an episode has {self.onset + self.steps + self.hold} epochs, and receivers "
                f"{np.flatnonzero(epoch >= self.epochs).tolist()} are past its end; begin anew"
            )
        self.memory["epoch"] = epoch
        self._measure()
        return self.batch.predict(self.time_s(), self.increment, self.memory["fix"])

    def _judge(self, epoch: Epoch) -> NDArray[np.bool_]:
        verdict: Verdict = self.detector.judge(epoch)
        self.batch.update(verdict.weights)
        self.memory["ratio"] = (verdict.statistic / verdict.threshold).max(axis=1)
        if verdict.weights is not None:
            self.memory["weight"] = verdict.weights.mean(axis=1)
        return np.asarray(verdict.alarm.any(axis=1))

    def error_ne(self) -> FloatArray:
        """Error of the estimate: (B, 2) north, east [m]."""
        estimate = self.memory["position"][:, :AXES]
        error: FloatArray = estimate - self.true_position_ne[self.memory["epoch"]]
        return error

    def route_ne(self) -> FloatArray:
        """True way of an episode.

        Returns (K, 2) from the onset to the end of the time to alert, north, east [m].
        """
        way = self.true_position_ne[self.onset : self.onset + self.steps + self.hold + 1]
        return np.asarray(way - way[0])

    def sight(self) -> Sight:
        """The first receiver as it is."""
        memory, truth = self.memory, self.true_position_ne
        return Sight(
            position_ne=truth[memory["epoch"][0]] - truth[self.onset],
            error_ne=self.error_ne()[0],
            displacement_ne=memory["offset"][0].copy(),
            ratio=float(memory["ratio"][0]),
            sky=None,
        )

    def time_s(self) -> FloatArray:
        """Time since the start of the episode: (B,) [s]."""
        time: FloatArray = self.memory["epoch"] * self.interval_s
        return time

    def observation(self, knowledge: str) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
        """What a level of knowledge observes.

        Returns `names` (o,) one per element; `low`, `high` (o,) finite bounds.
        """
        return robot_observation.elements(knowledge)

    def observe(self, knowledge: str, out: NDArray[np.float32]) -> None:
        """Write the observation; clipping follows.  `out` (B, o), written."""
        memory = self.memory
        epoch = memory["epoch"]
        since = (epoch - self.onset) / self.steps
        truth = self.true_position_ne
        values = robot_observation.Values(
            displacement=memory["offset"] / self.displacement_scale_m,
            rate=memory["rate"] / self.rate_limit_mps,
            time=np.stack([since, 1.0 - since], axis=1),
            position=(truth[epoch] - truth[self.onset]) / self.position_scale_m,
            velocity=self.true_velocity_ne[epoch] / self.velocity_scale_mps,
            verdict=np.stack([memory["ratio"], memory["weight"]], axis=1),
            error=self.error_ne() / self.displacement_scale_m,
        )
        robot_observation.write(values, out)
