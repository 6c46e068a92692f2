"""Settings of a victim, phases, seed splits."""

from __future__ import annotations

import copy
import json
import math
import shlex
import zlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.declared import Setting, check_number, check_word, setting, settings_record
from ..core.registry import build_record, require
from ..detectors import Detector, detector_in_world
from ..detectors.calibration_file import Conditions, describe_as_json
from ..policies.card import BETWEEN
from ..receiver.epoch import OPTIONAL
from ._kernels import local_motion
from .domain import Choice, Domain, DomainBounds, FloatArray
from .monitors import Monitor

MOST_EPOCHS = 100_000  # longest episode


@settings_record(frozen=True, kw_only=True)
class Timeline:
    """Phases of an episode."""

    warmup_s: float = setting(
        default=200.0, least=0.0, unit="s", help="Clean run before the attack."
    )
    live_s: float = setting(
        default=180.0,
        least=0.0,
        unit="s",
        help="Last part of it in which the detectors judge; an alarm there is a false alarm.  By "
        "default it lets the slowest memory settle, so that a detector is not better or worse for "
        "having just been switched on.",
    )
    attack_s: float = setting(default=150.0, above=0.0, unit="s", help="Command phase.")
    time_to_alert_s: float = setting(
        default=10.0,
        least=0.0,
        unit="s",
        help="Time to alert: how long the offsets hold their rate after the command phase, with "
        "alarms live; what was induced within this time of an alarm does not count.",
    )

    def __post_init__(self) -> None:
        require(
            self.live_s <= self.warmup_s,
            f"`live_s` must be at most `warmup_s` = {self.warmup_s}, got {self.live_s}",
        )

    def aged(self, age_s: float) -> Timeline:
        """The same phases with another warm-up, whose first part stays."""
        before = self.warmup_s - self.live_s
        require(
            age_s >= before,
            f"`age_s` must be at least the {before:g} s from switch-on to when detectors are live "
            f"(`warmup_s` - `live_s`), got {age_s:g}",
        )
        return replace(self, warmup_s=age_s, live_s=age_s - before)

    def epochs(self, interval_s: float) -> tuple[int, int, int, int]:
        """Epochs of the filter-only and the monitored warm-up, the command phase, and the hold."""
        length = self.warmup_s + self.attack_s + self.time_to_alert_s
        require(
            length <= MOST_EPOCHS * interval_s,
            f"an episode must have at most {MOST_EPOCHS} epochs; {length:g} s at intervals of "
            f"{interval_s:g} s are {length / interval_s:.0f}",
        )
        warmup = round(self.warmup_s / interval_s)
        live = min(round(self.live_s / interval_s), warmup)
        attack = max(round(self.attack_s / interval_s), 1)
        return warmup - live, live, attack, round(self.time_to_alert_s / interval_s)


TARGETS = ("random", "worst")  # target directions that are no number
Run = Callable[[Callable[[int, int], None], int], None]  # calls ``f(lo, hi)`` over slices of B


@dataclass(frozen=True)
class RateCommands:
    """Displacement commanded by rates, one an axis, as an `Attack` of a smaller victim. `limits`
    (a,) are what an action of 1 means [m/s]."""

    kind: str
    names: tuple[str, ...]
    limits: tuple[float, ...]
    control: ClassVar[str] = "rate"
    capture: ClassVar[None] = None
    reports: ClassVar[tuple[str, ...]] = ()
    acceleration_limit_mps2: ClassVar[float] = math.inf

    @property
    def label(self) -> str:
        return self.kind

    @property
    def rate_limit_mps(self) -> float | tuple[float, ...]:
        return self.limits[0] if len(set(self.limits)) == 1 else self.limits

    def action_names(self, world: object) -> tuple[str, ...]:
        return self.names


class Setup(ABC):
    """World, victim, commands, detector, phases and decisions, computed once and shared.

    A subclass is one victim.  It calls `_phase` and `_aim`, and sets the attributes named here.

    - `kind` of the victim, such as ``"snapshot"``; `name` of the scenario, for results;
    - `attack`: what a spoofer commands; `detector` in the loop, copied for every simulator;
    - `monitors`: what looks at every epoch and changes nothing; copied for every simulator;
    - `interval_s` between epochs; `epoch_time` (K,) of every epoch that an episode can come to [s];
    - `true_position`, `C_en` (K, d) where the target is at every epoch [m], and (K, d, d) to those
      axes from local north, east (and down);
    - `filter_only`, `live`, `steps`, `hold`: epochs of the filter-only warm-up, the monitored
      warm-up, the command phase, and the time to alert; `onset` is the sum of the first two,
      `repeat` epochs make a decision; where ages are drawn, `live` and `onset` are the largest,
      and `youngest` is the smallest onset;
    - `bounds`: what an episode chooses from;
    - `motion_names`, `error_names`, `weight_names`, `geometry_names`: elements of what a simulator
      of this victim writes as motion of the target, error of the estimate, weights and geometry;
    - `scales`: what the default observation takes for 1: ``"length_m"`` of displacements and
      errors, by what goes unnoticed of this victim; ``"position_m"`` and ``"velocity_mps"``.
    """

    kind: ClassVar[str]
    whose: ClassVar[str]  # the victim with its article, for messages
    env_id: ClassVar[str] = ""  # environment of this victim at its defaults; "" for none
    of_attack: ClassVar[frozenset[str]] = frozenset(  # settings that a clean run does not depend on
        {
            *("detector", "attack", "target_heading_deg", "rate_limit_mps"),
            *("decision_interval_s", "between", "control", "basis", "channels"),
        }
    )
    raw_settings: Mapping[str, Any] | None = None  # settings as they were given
    has: ClassVar[frozenset[str]] = frozenset(OPTIONAL) - {
        "gnss_position",
        "auxiliary_position",
        "cn0_dbhz",
        "weights",
    }  # optional fields of `Epoch` that the victim has
    fields: frozenset[str] = frozenset()  # wanted besides the `needs` of detectors and monitors
    domain_names: ClassVar[frozenset[str]] = frozenset()  # settings of `Domain` that the victim has
    usual_detector: ClassVar[Mapping[str, Any]] = {}  # in the loop where none is given
    usual_timeline: ClassVar[Mapping[str, float] | None] = None
    threaded: ClassVar[bool] = False  # whether its kernels work on slices of the receivers
    follows_setpoint: ClassVar[bool] = False  # whether spoofers command wanted rates by default
    ratio_is_largest: ClassVar[bool] = True  # else the default observation has one a channel
    motion_names: tuple[str, ...] = ()
    error_names: tuple[str, ...] = ("north", "east")
    weight_names: tuple[str, ...] = ()
    geometry_names: tuple[str, ...] = ()
    scales: Mapping[str, float] = {"length_m": 40.0, "position_m": 10_000.0, "velocity_mps": 100.0}

    name: str
    attack: Any
    detector: Detector
    timeline: Timeline
    domain: Domain
    interval_s: float
    epoch_time: FloatArray
    true_position: FloatArray
    C_en: FloatArray
    bounds: DomainBounds
    epochs_each: int
    target_heading_deg: float | str
    world: Any = None

    def _phase(
        self,
        detector: str | Mapping[str, Any] | Detector | None,
        timeline: Mapping[str, float] | Timeline | None,
        interval_s: float,
        decision_interval_s: float | None,
        between: str,
    ) -> None:
        self.detector = detector_in_world(self.usual_detector if detector is None else detector)
        timeline = build_record("timeline", Timeline, timeline, self.usual_timeline)
        self.timeline, self.interval_s = timeline, interval_s
        self.monitors: tuple[Monitor, ...] = ()
        age_s = self.domain.age_s
        oldest = timeline if age_s is None else timeline.aged(age_s[1])
        self.filter_only, self.live, self.steps, self.hold = oldest.epochs(interval_s)
        self.onset = self.youngest = self.filter_only + self.live
        if age_s is not None:
            self.youngest = sum(timeline.aged(age_s[0]).epochs(interval_s)[:2])
        self._decide_every(decision_interval_s, between)
        # one epoch more, which a finished receiver may run until it is reset
        self.length = self.onset + self.steps + self.hold + 1

    def _decide_every(self, decision_interval_s: float | None, between: str) -> None:
        check_word("between", between, BETWEEN)
        require(
            between == "hold" or decision_interval_s is not None,
            f"`between` {between!r} needs a `decision_interval_s`: without one there is no "
            "epoch between two decisions",
        )
        self.decision_interval_s, self.between = decision_interval_s, between
        self.repeat, interval_s = 1, self.interval_s
        if decision_interval_s is None:
            return
        check_number("decision_interval_s", decision_interval_s, above=0.0)
        self.repeat = repeat = round(decision_interval_s / interval_s)
        require(
            repeat >= 1 and abs(repeat * interval_s - decision_interval_s) <= 1e-6 * interval_s,
            f"`decision_interval_s` must be a multiple of the interval between epochs, "
            f"{interval_s:g} s, got {decision_interval_s}",
        )
        require(
            self.steps % repeat == 0,
            f"the attack window of {self.steps * interval_s:g} s must hold a whole number of "
            f"decisions, got `decision_interval_s` {decision_interval_s}",
        )

    @abstractmethod
    def world_settings(self) -> Mapping[str, Any]:
        """Settings of this victim that a clean run depends on, but for the timeline."""

    @property
    def window_s(self) -> float:
        return (self.steps + self.hold) * self.interval_s

    @cached_property
    def conditions(self) -> Conditions:
        """World and timeline, which a calibration of a detector belongs to. How often a spoofer
        decides is no part of them."""
        settings = {
            "kind": self.kind,
            **describe_as_json(self.world_settings()),
            "timeline": describe_as_json(self.timeline),
            "interval_s": describe_as_json(self.interval_s),
        }
        return Conditions(settings, self.window_s, self.name, self._options())

    def _options(self) -> str:
        """Options of a command line that name this world; "" where none can."""
        if self.raw_settings is None or not self.env_id:
            return ""
        words = [f"--env {self.env_id}"]
        try:
            for name, value in self.raw_settings.items():
                if name not in self.of_attack:
                    words.append(f"--set {shlex.quote(f'{name}={json.dumps(value)}')}")
        except TypeError:
            return ""
        return " ".join(words)

    def _aim(
        self, target_heading_deg: float | str, domain: Mapping[str, Any] | Domain | None
    ) -> None:
        heading = Setting(one_of=TARGETS)
        heading.check("target_heading_deg", target_heading_deg, "float | str")
        self.target_heading_deg = target_heading_deg
        self.domain = build_record("domain", Domain, domain)
        nothing = Domain()
        for name in vars(nothing):
            require(
                getattr(self.domain, name) == getattr(nothing, name) or name in self.domain_names,
                f"`domain` has no {name!r} for {self.whose}; valid: "
                f"{', '.join(sorted(self.domain_names)) or 'none'}",
            )

    def _bounds(self, worlds: int, grades: int, errors: int, first: int, last: int) -> DomainBounds:
        heading, fixed = self.target_heading_deg, None
        if heading != "random":  # where "worst" counts, no direction does
            fixed = 0.0 if isinstance(heading, str) else float(np.radians(heading))
        ages = self.youngest, self.onset
        return DomainBounds(worlds, grades, errors, first, last, fixed, *ages)

    @property
    def least_live(self) -> int:
        """Epochs of the monitored warm-up of the youngest receivers."""
        return self.youngest - self.filter_only

    def find_onsets(self, choice: Choice) -> NDArray[np.int64]:
        """(b,) epochs of `epoch_time` after which the attacks of some episodes start."""
        return choice.world * self.epochs_each + choice.start + choice.age

    def require_one_age(self, what: str) -> None:
        require(
            self.youngest == self.onset,
            f"ages are drawn: {what} needs one age at the onset, not `age_s` {self.domain.age_s}",
        )

    def _starts(self, epochs: int, name: str) -> tuple[int, int]:
        interval, length = self.interval_s, self.length
        early, late = self.domain.start_s
        room = epochs - 1 - length
        first = math.ceil(early / interval - 1e-6)
        last = room if late is None else math.floor(late / interval + 1e-6)
        if first > last and late is not None:
            raise ValueError(
                f"`start_s` must hold an epoch, of which there is one every {interval:g} s, got "
                f"{self.domain.start_s}"
            )
        if max(first, last) > room:
            line = self.timeline
            start = f" from a start at {max(first, last) * interval:g} s" if first or last else ""
            before = self.onset * interval
            valid = f"a start is at most at {room * interval:g} s"
            if room < 0:
                valid = f"the three take at most {(epochs - 2) * interval:g} s"
                if self.youngest != self.onset:
                    valid += "; `domain` and `timeline` None are those of the papers' short flights"
            raise ValueError(
                f"an episode takes {length * interval:g} s{start} (warm-up {before:g} s, "
                f"attack {line.attack_s:g} s, time to alert {line.time_to_alert_s:g} s, and one "
                f"epoch of {interval:g} s in reserve), but {name!r} lasts "
                f"{(epochs - 1) * interval:g} s: {valid}"
            )
        return first, last

    @property
    def title(self) -> str:
        return f"{self.kind} receiver"

    @property
    def rate_scale_mps(self) -> float:
        """Commanded rate that the default observation takes for 1: that length in the window."""
        return self.scales["length_m"] / (self.steps * self.interval_s)

    @property
    def action_names(self) -> tuple[str, ...]:
        return tuple(self.attack.action_names(self.world))

    @property
    def combination_names(self) -> Mapping[str, Sequence[str]]:
        return {"imu": ("own",), "errors": ("own",)}

    @property
    def onsets(self) -> NDArray[np.int64] | None:
        """(K,) onset of the episodes that each epoch is part of; None where there is no table."""
        return None

    def motion_table(self, per_position: float, per_velocity: float) -> NDArray[np.float32] | None:
        """(K, len(motion_names)) motion at every epoch, scaled; None where there is no table."""
        return None

    def local_motion(self, *epochs_to_out: Any) -> None:
        local_motion(self.true_position, self.world.velocity_e, self.C_en, *epochs_to_out)

    def geometry_table(self) -> FloatArray | None:
        """(K, len(geometry_names)) geometry at every epoch; None where there is no table."""
        return None

    def probe_geometry(self) -> FloatArray | None:
        """(P, len(geometry_names)) some rows of the table, of several worlds, that are in attack
        windows of some episodes; None where no more is known than the table."""
        return None

    @abstractmethod
    def simulator(self, receivers: int, run: Run) -> Any:
        """`Simulator` of B receivers of this victim, not started yet."""

    def check_fit(self, detector: Detector) -> None:
        fitted = self.copy_with(detector=detector, monitors=())
        fitted.simulator(1, lambda work, receivers: work(0, receivers))

    def command(
        self, before: FloatArray, action: FloatArray, epoch: int | NDArray[np.int64]
    ) -> FloatArray:
        """Action (B, k) of an epoch of a decision, from 0 on, after the one `before`, (B, k)."""
        if self.between == "hold":
            return action
        count = np.asarray(epoch) + 1
        # the line reaches its end exactly, not but for rounding
        on_the_way = before + (count / self.repeat) * (action - before)
        return np.where(count == self.repeat, action, on_the_way)

    def copy_with(
        self,
        *,
        detector: Detector | None = None,
        monitors: Sequence[Monitor] | None = None,
        pace: tuple[float | None, str] | None = None,
    ) -> Setup:
        """The same world and attack, with another detector, other monitors, or another pace.

        The spoofer's pace, ``decision_interval_s`` and ``between``, changes neither when an episode
        may start nor how long it takes.
        """
        other = copy.copy(self)
        if pace is not None:
            other._decide_every(*pace)
        if detector is not None:
            other.detector = detector
        if monitors is not None:
            other.monitors = tuple(monitors)
        return other


SPLITS = {  # first element of the spawn keys; 3 was once another split's
    "training": 0,
    "calibration": 1,
    "evaluation": 2,
    "holdout": 4,
    "selection": 5,
    "search": 6,
    "game": 7,
    "dataset-train": 8,
    "dataset-validation": 9,
    "dataset-test": 10,
}


def seeds_of_runs(
    entropy: int, split: str, scenario: str, runs: Iterable[int]
) -> list[np.random.SeedSequence]:
    """Seeds of runs of a split by their numbers; `entropy`: of the campaign, at least 0."""
    key = zlib.crc32(scenario.encode())
    return [np.random.SeedSequence(entropy, spawn_key=(SPLITS[split], key, run)) for run in runs]


def make_generators(seeds: Iterable[np.random.SeedSequence]) -> list[np.random.Generator]:
    return [np.random.Generator(np.random.PCG64(seed)) for seed in seeds]
