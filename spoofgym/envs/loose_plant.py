"""An airliner with a loosely coupled receiver, whose positions by GNSS a spoofer shifts.

The spoofer commands at which rate the position that GNSS hands out runs away to the north and to
the east; all the rest of the attack is inherited, the errors of the authentic position included.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from .._registry import build_record, check_choice
from ..detectors import Detector, DetectorContext, make_detector
from ..receiver.loose import LooselyCoupled, LooseReceivers
from ..sim.loose_world import SOURCES, InertialErrors, first_errors, flown_world, measure
from ..sim.noise import padded
from ..sim.position_error import PositionErrors
from .observations import KNOWLEDGE
from .plant import Plant, bound
from .setup import Timeline
from .sight import Sight

FloatArray = NDArray[np.float64]

INTERVAL_S = 0.1
DEFAULT_WINDOW = 100
DEFAULT_DETECTOR: dict[str, Any] = {
    "name": "windowed-chi2",
    "window": 1,
    "covariance": "estimated",
    "covariance_window": DEFAULT_WINDOW,
}
DEFAULT_RECEIVER: dict[str, Any] = {"self_tuning": {"window": DEFAULT_WINDOW}}
DEFAULT_TIMELINE = {"warmup_s": 20.0, "live_s": 20.0, "attack_s": 5.0, "time_to_alert_s": 5.0}
DISPLACEMENT_SCALE_M = 25.0
POSITION_SCALE_M = 10_000.0
VELOCITY_SCALE_MPS = 100.0
BOUND = 10.0
_NORTH_EAST = (1, 0)


class LoosePlant(Plant):
    """B loosely coupled receivers, each in its own episode, at 10 epochs a second.

    The world, the filter and the phases of an episode are those of `shadmehri2025`: 20 s without
    an attack, in which all windows fill, 5 s of attack, 5 s in which an alarm still counts.  What
    the paper leaves open is chosen so that the monitor works: the errors of a position by GNSS
    are correlated (`PositionErrors`), only R adapts, over 100 epochs, and the threshold is the one
    for an estimated covariance.

    - `detector`: as `make_detector` takes it; `DEFAULT_DETECTOR` by default;
    - `timeline`: settings of `Timeline`, over `DEFAULT_TIMELINE`;
    - `flight`: a ready-made flight whose inertial sensors run at a multiple of 10 Hz;
    - `receiver`: settings of `LooselyCoupled`; `DEFAULT_RECEIVER` by default;
    - `rate_limit_mps`: largest rate of the offset along each axis [m/s].
    """

    kind: ClassVar[str] = "loose"

    def __init__(
        self,
        receivers: int,
        *,
        detector: str | Mapping[str, Any] | Detector | None = None,
        timeline: Mapping[str, float] | Timeline | None = None,
        flight: str = "shadmehri2025",
        errors: Mapping[str, Any] | PositionErrors | None = None,
        inertial: Mapping[str, Any] | InertialErrors | None = None,
        receiver: Mapping[str, Any] | LooselyCoupled | None = None,
        rate_limit_mps: float = 5.0,
    ) -> None:
        if receivers < 1:
            raise ValueError(f"`receivers` must be at least 1, got {receivers}")
        if not (np.isfinite(rate_limit_mps) and rate_limit_mps > 0.0):
            raise ValueError(f"`rate_limit_mps` must be finite and > 0, got {rate_limit_mps}")
        self.receivers, self.rate_limit_mps = receivers, float(rate_limit_mps)
        self.interval_s = INTERVAL_S
        self.action_names = ("north_rate", "east_rate")
        self.world = flown_world(flight, INTERVAL_S)
        self.errors = build_record("errors", PositionErrors, errors)
        self.inertial = build_record("inertial", InertialErrors, inertial)
        self.settings = build_record(
            "receiver", LooselyCoupled, DEFAULT_RECEIVER if receiver is None else receiver
        )
        self.timeline = build_record("timeline", Timeline, timeline, DEFAULT_TIMELINE)
        self._quiet, self._live, self.steps, self.hold = self.timeline.epochs(INTERVAL_S)
        self.onset = self._quiet + self._live
        # one epoch more, which a finished receiver may run until it is reset
        last = self.onset + self.steps + self.hold + 1
        if last >= self.world.epochs:
            raise ValueError(
                f"an episode takes {last * INTERVAL_S:g} s, but {flight!r} lasts "
                f"{(self.world.epochs - 1) * INTERVAL_S:g} s; shorten the `timeline`"
            )
        self.unbound = make_detector(DEFAULT_DETECTOR if detector is None else detector)
        self.detector = self._bound()
        self.memory = self._declared()

    def _bound(self) -> Detector:
        return bound(
            self.unbound,
            DetectorContext(self.receivers, 0, INTERVAL_S, self.settings.noise_variance(), ()),
            self._live + self.steps + self.hold,
            "a loosely coupled receiver",
            frozenset({"gnss_position"}),
        )

    def _declared(self) -> Memory:
        b = self.receivers
        memory = Memory(b)
        self._victims = LooseReceivers(
            self.settings, memory, self.world.samples, self.world.imu_interval_s
        )
        memory.declare("keys", np.zeros((b, SOURCES, 2), dtype=np.uint64))
        memory.declare("epoch", np.zeros(b, dtype=np.int64))
        memory.declare("first_error", np.zeros((b, 15)))
        memory.declare("sensor_bias", np.zeros((b, 6)))
        memory.declare("position_error", np.zeros((b, 3)))
        memory.declare("displacement", np.zeros((b, 3)))  # east, north, up
        memory.declare("rate", np.zeros((b, 3)))
        memory.declare("ratio", np.zeros(b))
        memory.declare("statistic", np.zeros(b))
        memory.declare("weights", np.ones((b, 3)))
        self._deviates = np.empty(padded(6 * self.world.samples))
        return memory

    def spawn(self, receivers: int) -> LoosePlant:
        """Another batch of the same settings, not begun yet."""
        if receivers < 1:
            raise ValueError(f"`receivers` must be at least 1, got {receivers}")
        other = copy.copy(self)
        other.receivers = receivers
        other.detector = other._bound()
        other.memory = other._declared()
        return other

    def begin(self, rngs: Sequence[np.random.Generator]) -> NDArray[np.bool_]:
        """Begin new episodes in all receivers, and run their clean warm-up up to the onset.

        `rngs`: one per receiver; its seed sequence spawns one child an episode; returns (B,) bool,
        whether the detector alarmed before the onset.
        """
        memory, world = self.memory, self.world
        memory.reset()
        self.detector.reset()
        for row, rng in zip(range(self.receivers), rngs, strict=True):
            episode = rng.bit_generator.seed_seq.spawn(1)[0]  # type: ignore[attr-defined]
            memory["keys"][row] = episode.generate_state(2 * SOURCES, np.uint64).reshape(-1, 2)
        first_errors(
            memory["keys"],
            self.inertial.initial_sd,
            self.errors.sd,
            self._deviates,
            memory["first_error"],
            memory["position_error"],
        )
        memory["sensor_bias"][:] = memory["first_error"][:, 9:]
        self._victims.begin(
            world.position_e[0], world.velocity_e[0], world.C_eb[0], memory["first_error"]
        )
        for _ in range(self._quiet):
            self._measure()
            self._victims.update(None)
        alarmed = np.zeros(self.receivers, dtype=np.bool_)
        for _ in range(self._live):
            self._measure()
            alarmed |= self._judge()
        return alarmed

    def advance(self, action: FloatArray | None) -> NDArray[np.bool_]:
        """Run one epoch: attack, measure, judge, update.

        `action` (B, 2) in [-1, 1], north and east; None holds the rates; returns (B,) bool, whether
        the detector alarms.
        """
        memory = self.memory
        if action is not None:
            for column, axis in enumerate(_NORTH_EAST):
                memory["rate"][:, axis] = self.rate_limit_mps * action[:, column]
        memory["displacement"] += INTERVAL_S * memory["rate"]
        self._measure()
        return self._judge()

    def _measure(self) -> None:
        memory, world, victims = self.memory, self.world, self._victims
        measure(
            memory["keys"],
            memory["epoch"],
            world.run,
            world.position_e,
            world.C_el,
            world.imu_interval_s,
            self.inertial.noise,
            memory["sensor_bias"],
            self.errors.decay,
            self.errors.sd,
            memory["displacement"],
            self._deviates,
            memory["position_error"],
            victims.samples,
            victims.fix_e,
        )
        victims.predict()

    def _judge(self) -> NDArray[np.bool_]:
        memory = self.memory
        verdict = self.detector.judge(self._victims.epoch(self.time_s()))
        memory["statistic"][:] = verdict.statistic.max(axis=1)
        memory["ratio"][:] = (verdict.statistic / verdict.threshold).max(axis=1)
        if verdict.weights is not None:
            memory["weights"][:] = verdict.weights
        self._victims.update(verdict.weights)
        return np.asarray(verdict.alarm.any(axis=1))

    def error_ne(self) -> FloatArray:
        """Error of the victim's position, estimate minus truth: (B, 2) north, east [m]."""
        epoch = self.memory["epoch"]
        apart = self.memory["position_e"] - self.world.position_e[epoch]
        C_el = self.world.C_el[epoch]
        out = np.empty((self.receivers, 2))
        for column, axis in enumerate(_NORTH_EAST):
            out[:, column] = (
                apart[:, 0] * C_el[:, 0, axis]
                + apart[:, 1] * C_el[:, 1, axis]
                + apart[:, 2] * C_el[:, 2, axis]
            )
        return out

    def route_ne(self) -> FloatArray:
        """True way of an episode.

        Returns (K, 2) from the onset to the end of the time to alert, north, east [m].
        """
        way = self.world.position_e[self.onset : self.onset + self.steps + self.hold + 1]
        return np.asarray((way - way[0]) @ self.world.C_el[self.onset][:, _NORTH_EAST])

    def sight(self) -> Sight:
        """The first receiver as it is."""
        memory, world = self.memory, self.world
        moved = world.position_e[memory["epoch"][0]] - world.position_e[self.onset]
        return Sight(
            position_ne=moved @ world.C_el[self.onset][:, _NORTH_EAST],
            error_ne=self.error_ne()[0],
            displacement_ne=memory["displacement"][0, _NORTH_EAST],
            ratio=float(memory["ratio"][0]),
            sky=None,
        )

    def time_s(self) -> FloatArray:
        """Time of the present epoch: (B,) [s]."""
        return np.asarray(self.memory["epoch"] * INTERVAL_S)

    def observation(self, knowledge: str) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
        """What a level of knowledge observes.

        Returns `names` (o,) one per element; `low`, `high` (o,) finite bounds.
        """
        check_choice("knowledge", knowledge, KNOWLEDGE)
        axes = ("north", "east", "down")
        names = [f"own_{what}_{a}" for what in ("displacement", "rate") for a in axes[:2]]
        names += ["time_since_onset", "time_left"]
        low = [-BOUND] * 4 + [0.0] * 2
        high = [BOUND] * 4 + [1.0] * 2
        if knowledge != "blind":
            names += [f"target_{what}_{a}" for what in ("position", "velocity") for a in axes]
            low, high = low + [-BOUND] * 6, high + [BOUND] * 6
        if knowledge == "oracle":
            names += ["statistic_ratio", "weight_east", "weight_north", "weight_up"]
            names += ["victim_error_north", "victim_error_east"]
            low, high = low + [0.0] * 4 + [-BOUND] * 2, high + [BOUND] + [1.0] * 3 + [BOUND] * 2
        return tuple(names), np.array(low), np.array(high)

    def observe(self, knowledge: str, out: NDArray[np.float32]) -> None:
        """Write the observation; clipping follows.  `out` (B, o), written."""
        memory, world, epoch = self.memory, self.world, self.memory["epoch"]
        for column, axis in enumerate(_NORTH_EAST):
            out[:, column] = memory["displacement"][:, axis] / DISPLACEMENT_SCALE_M
            out[:, 2 + column] = memory["rate"][:, axis] / self.rate_limit_mps
        since = (epoch - self.onset) / self.steps
        out[:, 4], out[:, 5] = since, 1.0 - since
        if knowledge == "blind":
            return
        C_el = world.C_el[self.onset]
        moved = world.position_e[epoch] - world.position_e[self.onset]
        velocity = world.velocity_e[epoch]
        for column, (axis, sign) in enumerate(((1, 1.0), (0, 1.0), (2, -1.0))):
            x, y, z = sign * C_el[:, axis]
            along = moved[:, 0] * x + moved[:, 1] * y + moved[:, 2] * z
            out[:, 6 + column] = along / POSITION_SCALE_M
            along = velocity[:, 0] * x + velocity[:, 1] * y + velocity[:, 2] * z
            out[:, 9 + column] = along / VELOCITY_SCALE_MPS
        if knowledge == "oracle":
            out[:, 12], out[:, 13:16] = memory["ratio"], memory["weights"]
            out[:, 16:18] = self.error_ne() / DISPLACEMENT_SCALE_M
