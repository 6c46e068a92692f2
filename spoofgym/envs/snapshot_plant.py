"""The snapshot receiver as a plant: twelve satellites, some of them spoofed, a fix an epoch.

A vehicle goes straight on, and its receiver makes a fix of every epoch's pseudoranges by
themselves.  The spoofer has some of the satellites, and lets them tell of a position and a clock
that drift away from the true ones; a detector that excludes a group leaves it out of the fix.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from .._registry import build_record, check_choice
from ..detectors import Detector, DetectorContext, Verdict, make_detector
from ..detectors.verdicts import judged
from ..receiver.epoch import Epoch, frozen
from ..receiver.least_squares import fix_receivers
from ..receiver.snapshot_positioning import EXPECTED_CLOCK_SD_M, EXPECTED_POSITION_SD_M, expect
from ..sim.constellation import CircularConstellation
from ..sim.sky import make_sky, measure, scratch
from .observations import KNOWLEDGE
from .plant import Plant, bound
from .setup import Timeline
from .sight import Sight, Sky

FloatArray = NDArray[np.float64]

AXES = ("north", "east", "down", "clock")
DEFAULT_TIMELINE = {"warmup_s": 10.0, "live_s": 10.0, "attack_s": 60.0, "time_to_alert_s": 10.0}
CLOCK_SD = (1e4, 10.0)
"""Standard deviation of the receiver's clock offset [m] and drift [m/s]."""
DISPLACEMENT_SCALE_M = 100.0
MOTION_SCALE_M = 10_000.0
ERROR_SCALE_M = 100.0
BOUND = 10.0


class SnapshotPlant(Plant):
    """B snapshot receivers.

    - `timeline`: phases of an episode, settings over `DEFAULT_TIMELINE`; there is nothing to warm
      up but the detector;
    - `satellites`: n, in view and used, the highest ones;
    - `spoofed`: how many satellites are spoofed, others in every episode; or which slots, always
      the same;
    - `noise_m`: white noise of a pseudorange [m];
    - `rate_limit_mps`: largest rate of the counterfeit displacement [m/s], one for all or north,
      east, down, clock;
    - `time_offset_s`: of the constellation: another geometry.

    Notes
    -----
    The target of `wu2024`, tables 5 to 8: 12 satellites and 4 m.  The detector gets raw
    pseudoranges; its prediction is the last fix, which innovation tests are told not to trust.
    """

    kind: ClassVar[str] = "snapshot"

    def __init__(
        self,
        receivers: int,
        *,
        detector: str | Mapping[str, Any] | Detector = "srv-raim",
        timeline: Timeline | Mapping[str, float] | None = None,
        satellites: int = 12,
        spoofed: int | Sequence[int] = 6,
        noise_m: float = 4.0,
        rate_limit_mps: float | Sequence[float] = 5.0,
        speed_mps: float = 50.0,
        heading_deg: float = 0.0,
        interval_s: float = 1.0,
        time_offset_s: float = 0.0,
    ) -> None:
        self.receivers, self.interval_s = receivers, _positive("interval_s", interval_s)
        self.noise_m = _positive("noise_m", noise_m)
        if not receivers >= 1:
            raise ValueError(f"`receivers` must be at least 1, got {receivers}")
        if not isinstance(satellites, int | np.integer) or satellites < 4:
            raise ValueError(f"`satellites` must be a whole number >= 4, got {satellites!r}")
        for name, value in (("speed_mps", speed_mps), ("heading_deg", heading_deg)):
            if not math.isfinite(value):
                raise ValueError(f"`{name}` must be finite, got {value}")
        self.spoofed = _which(spoofed, satellites)
        self.rate_limit_mps = _rates(rate_limit_mps)
        self.timeline = build_record("timeline", Timeline, timeline, DEFAULT_TIMELINE)
        quiet, live, self.steps, self.hold = self.timeline.epochs(interval_s)
        self._quiet, self._live, self.onset = quiet, live, quiet + live
        self.action_names = tuple(f"{axis}_rate" for axis in AXES)
        self.sky = make_sky(
            2 + self.onset + self.steps + self.hold,  # the first fix, and one to spare
            interval_s,
            satellites,
            CircularConstellation(satellites=36, time_offset_s=time_offset_s),
            speed_mps=speed_mps,
            heading_deg=heading_deg,
        )
        self.unbound = make_detector(detector)
        self._settle()

    def _settle(self) -> None:
        """Detector, memory and buffers of this batch."""
        b, n = self.receivers, len(self.sky.satellite_ids)
        variance = np.repeat([self.noise_m**2, 1.0], n)
        self.detector = bound(
            self.unbound,
            DetectorContext(b, n, self.interval_s, variance, self.sky.satellite_ids),
            self._live + self.steps + self.hold,
            "a snapshot receiver",
            frozenset(),
        )
        c = n if self.detector.scope == "channel" else 1
        self.memory = Memory(b)
        start = np.tile(self.sky.position_e[0], (b, 1))
        for name, initial in {
            "epoch": np.zeros(b, dtype=np.int64),
            "keys": np.zeros((b, 2), dtype=np.uint64),
            "true_clock": np.zeros((b, 2)),
            "spoofed": np.zeros((b, n), dtype=np.bool_),
            "displacement": np.zeros((b, 4)),
            "rate": np.zeros((b, 4)),
            "position_e": start,
            "clock": np.zeros((b, 1)),
            "statistic": np.zeros((b, c)),
            "threshold": np.ones((b, c)),
            "weights": np.ones((b, 2 * n)),
        }.items():
            self.memory.declare(name, initial)
        self._deviates = scratch(n)
        self._pseudorange, self._satellites = np.empty((b, n)), np.empty((b, n, 3))
        self._innovation, self._cov = np.empty((b, 2 * n)), np.empty((b, 2 * n, 2 * n))
        self._design, self._status = np.empty((b, 2 * n, 4)), np.zeros(b, dtype=np.int64)
        belief = np.diag(np.square([*[EXPECTED_POSITION_SD_M] * 3, EXPECTED_CLOCK_SD_M]))
        constant: dict[str, NDArray[Any]] = {
            "interval": np.full(b, self.interval_s),
            "predicted_cov": np.tile(belief, (b, 1, 1)),
            "transition": np.tile(np.eye(4), (b, 1, 1)),
            "imu_delta": np.zeros((b, 6)),
            "range_rate": np.zeros((b, n)),
            "visible": np.ones((b, n), dtype=np.bool_),
            "predicted_velocity": np.zeros((b, 3)),
        }
        self._constant = {name: frozen(array) for name, array in constant.items()}

    def spawn(self, receivers: int) -> SnapshotPlant:
        """Another batch of the same settings, not begun yet."""
        other = copy.copy(self)
        other.receivers = receivers
        other._settle()
        return other

    def begin(self, rngs: Sequence[np.random.Generator]) -> NDArray[np.bool_]:
        """Begin new episodes in all receivers, and run up to the onset.

        `rngs`: one per receiver; its seed sequence spawns one child an episode; returns (B,) bool,
        whether the detector alarmed before the onset.
        """
        self.memory.reset()
        self.detector.reset()
        memory = self.memory
        for b, rng in enumerate(rngs):
            episode = rng.bit_generator.seed_seq.spawn(1)[0]  # type: ignore[attr-defined]
            memory["keys"][b] = episode.generate_state(2, np.uint64)
            draw = np.random.default_rng(episode.spawn(1)[0])
            memory["true_clock"][b] = draw.standard_normal(2) * CLOCK_SD
            slots = self.spoofed
            if isinstance(slots, int):
                slots = draw.permutation(len(self.sky.satellite_ids))[:slots].tolist()
            memory["spoofed"][b, slots] = True
        self._measure()
        self._fix()
        alarm = np.zeros(self.receivers, dtype=np.bool_)
        for k in range(self.onset):
            alarm |= self._epoch(live=k >= self._quiet)
        return alarm

    def advance(self, action: FloatArray | None) -> NDArray[np.bool_]:
        """Run one epoch.

        `action` (B, 4) rates of the counterfeit displacement over their limits; None holds them;
        returns (B,) bool, whether the detector alarms.
        """
        memory = self.memory
        if memory["epoch"].max() >= len(self.sky.time) - 1:
            raise RuntimeError("the episode is over; begin a new one")
        if action is not None:
            memory["rate"] = np.clip(action, -1.0, 1.0) * self.rate_limit_mps
        memory["displacement"] = memory["displacement"] + memory["rate"] * self.interval_s
        return self._epoch(live=True)

    def action_limits(self) -> FloatArray:
        """Largest rate of every axis: (4,) [m/s]."""
        return self.rate_limit_mps

    def _epoch(self, live: bool) -> NDArray[np.bool_]:
        """Measure, judge and fix."""
        memory = self.memory
        memory["epoch"] = memory["epoch"] + 1
        self._measure()
        alarm = np.zeros(self.receivers, dtype=np.bool_)
        if live:
            verdict = self._verdict()
            np.any(verdict.alarm, axis=1, out=alarm)
            memory["statistic"], memory["threshold"] = verdict.statistic, verdict.threshold
            if verdict.weights is not None:
                memory["weights"] = verdict.weights
        self._fix()
        return alarm

    def _measure(self) -> None:
        sky, memory = self.sky, self.memory
        measure(
            memory["epoch"],
            memory["keys"],
            memory["true_clock"],
            memory["displacement"],
            memory["spoofed"],
            sky.time,
            sky.position_e,
            sky.C_en,
            sky.satellite_position_e,
            self.noise_m,
            self._deviates,
            self._pseudorange,
            self._satellites,
        )

    def _verdict(self) -> Verdict:
        memory = self.memory
        expect(
            self._pseudorange,
            self._satellites,
            memory["position_e"],
            memory["clock"],
            self.noise_m**2,
            self._innovation,
            self._cov,
            self._design,
        )
        arrays = {
            "time": self.sky.time[memory["epoch"]],
            "innovation": self._innovation,
            "innovation_cov": self._cov,
            "design": self._design,
            "pseudorange": self._pseudorange,
            "satellite_position": self._satellites,
            "satellite_velocity": self.sky.satellite_velocity_e[memory["epoch"]],
            "predicted_position": memory["position_e"],
        }
        seen = {name: frozen(array) for name, array in arrays.items()}
        return judged(self.detector, Epoch(**seen, **self._constant))

    def _fix(self) -> None:
        """New fix with the detector's weights; where there is none, the last one stays."""
        memory = self.memory
        fix_receivers(
            self._pseudorange,
            self._satellites,
            memory["weights"],
            memory["position_e"],
            memory["clock"],
            self._status,
        )

    def _true_position(self) -> FloatArray:
        return np.asarray(self.sky.position_e[self.memory["epoch"]])

    def error_ne(self) -> FloatArray:
        """Error of the fix, estimate minus truth: (B, 2) north, east [m]."""
        error = self.memory["position_e"] - self._true_position()
        return np.asarray(np.einsum("bi,ij->bj", error, self.sky.C_en)[:, :2])

    def route_ne(self) -> FloatArray:
        """True way of an episode.

        Returns (K, 2) from the onset to the end of the time to alert, north, east [m].
        """
        way = self.sky.position_e[self.onset : self.onset + self.steps + self.hold + 1]
        return np.asarray(((way - way[0]) @ self.sky.C_en)[:, :2])

    def sight(self) -> Sight:
        """The first receiver as it is."""
        memory, sky = self.memory, self.sky
        epoch, n = int(memory["epoch"][0]), len(sky.satellite_ids)
        toward = self._line_of_sight_n()[0]
        moved = sky.position_e[epoch] - sky.position_e[self.onset]
        return Sight(
            position_ne=(moved @ sky.C_en)[:2],
            error_ne=self.error_ne()[0],
            displacement_ne=memory["displacement"][0, :2].copy(),
            ratio=float((memory["statistic"][0] / memory["threshold"][0]).max()),
            sky=Sky(
                names=sky.satellite_ids,
                azimuth=np.arctan2(toward[:, 1], toward[:, 0]),
                elevation=np.arcsin(-toward[:, 2]),
                visible=np.ones(n, dtype=np.bool_),
                spoofed=memory["spoofed"][0] & memory["displacement"][0].any(),
                weight=memory["weights"][0, :n].copy(),
            ),
        )

    def time_s(self) -> FloatArray:
        """Time of the present epoch: (B,) [s]."""
        return np.asarray(self.sky.time[self.memory["epoch"]])

    def _line_of_sight_n(self) -> FloatArray:
        """Unit vectors to the satellites, (B, n, 3), north-east-down."""
        epoch = self.memory["epoch"]
        apart = self.sky.satellite_position_e[epoch] - self._true_position()[:, None]
        apart /= np.sqrt(np.einsum("bni,bni->bn", apart, apart))[:, :, None]
        return np.asarray(np.einsum("bni,ij->bnj", apart, self.sky.C_en))

    def observation(self, knowledge: str) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
        """What a level of knowledge observes.

        Returns `names` (o,) one per element; `low`, `high` (o,) finite bounds.
        """
        check_choice("knowledge", knowledge, KNOWLEDGE)
        slots = range(len(self.sky.satellite_ids))
        own = [f"own_{what}_{axis}" for what in ("displacement", "rate") for axis in AXES]
        names = [*own, "time_since_onset", "time_left"]
        low, high = [-BOUND] * 4 + [-1.0] * 4 + [0.0] * 2, [BOUND] * 4 + [1.0] * 6
        if knowledge != "blind":
            names += [f"target_motion_{axis}" for axis in AXES[:3]]
            names += [f"satellite_{j}_{axis}" for j in slots for axis in AXES[:3]]
            names += [f"satellite_{j}_spoofed" for j in slots]
            low += [-BOUND] * 3 + [-1.0] * 3 * len(slots) + [0.0] * len(slots)
            high += [BOUND] * 3 + [1.0] * 4 * len(slots)
        if knowledge == "oracle":
            c = self.memory["statistic"].shape[1]
            names += [f"statistic_over_threshold_{j}" for j in range(c)]
            names += [f"weight_{j}" for j in slots]
            names += ["error_north", "error_east"]
            low += [-BOUND] * c + [0.0] * len(slots) + [-BOUND] * 2
            high += [BOUND] * c + [1.0] * len(slots) + [BOUND] * 2
        return tuple(names), np.array(low), np.array(high)

    def observe(self, knowledge: str, out: NDArray[np.float32]) -> None:
        """Write the observation; clipping follows.  `out` (B, o), written."""
        memory, n = self.memory, len(self.sky.satellite_ids)
        since = (memory["epoch"] - self.onset) / self.steps
        parts = [
            memory["displacement"] / DISPLACEMENT_SCALE_M,
            memory["rate"] / self.rate_limit_mps,
            since[:, None],
            1.0 - since[:, None],
        ]
        if knowledge != "blind":
            motion = self._true_position() - self.sky.position_e[self.onset]
            parts += [
                np.einsum("bi,ij->bj", motion, self.sky.C_en) / MOTION_SCALE_M,
                self._line_of_sight_n().reshape(self.receivers, -1),
                memory["spoofed"],
            ]
        if knowledge == "oracle":
            parts += [
                memory["statistic"] / memory["threshold"],
                memory["weights"][:, :n],
                self.error_ne() / ERROR_SCALE_M,
            ]
        np.concatenate(parts, axis=1, out=out, casting="unsafe")


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"`{name}` must be finite and > 0, got {value}")
    return float(value)


def _which(spoofed: int | Sequence[int], satellites: int) -> int | list[int]:
    """Count of spoofed satellites, or their slots."""
    if isinstance(spoofed, int | np.integer):
        if not 0 <= spoofed <= satellites:
            raise ValueError(
                f"`spoofed` must be within 0..{satellites}, the number of satellites, got {spoofed}"
            )
        return int(spoofed)
    if isinstance(spoofed, float | str):
        raise ValueError(
            f"`spoofed` must be a whole number of satellites, or a list of slots, got {spoofed!r}"
        )
    slots = [int(j) for j in spoofed]
    if len(set(slots)) < len(slots) or not all(0 <= j < satellites for j in slots):
        raise ValueError(
            f"`spoofed` must name slots within 0..{satellites - 1}, each once, got {slots}"
        )
    return slots


def _rates(rate_limit_mps: float | Sequence[float]) -> FloatArray:
    limits = np.asarray(rate_limit_mps, dtype=np.float64)
    if limits.shape not in ((), (4,)) or not (np.isfinite(limits) & (limits > 0.0)).all():
        raise ValueError(
            "`rate_limit_mps` must be finite and > 0, one number or one for each of "
            f"{', '.join(AXES)}, got {rate_limit_mps}"
        )
    return np.broadcast_to(limits, (4,)).copy()
