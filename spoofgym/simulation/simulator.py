"""B receivers of one victim in step: start, predict, judge, update; no Gymnasium here.

An epoch has two halves.  `predict` takes the spoofer's command and gives the `Epoch` that detectors
may see; `update` corrects the filter with the weights of their verdict.  Every array has a leading
axis of receivers, and a receiver has the same bits in a batch of any size.
"""

from __future__ import annotations

import copy
import math
import sys
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number
from ..core.memory import Memory
from ..core.registry import require
from ..detectors import Detector, DetectorContext, Never, PooledDetector, Verdict
from ..detectors.base import HAVE_IT, YoungMemoryWarning, check_needs, checked_weights, judge_epoch
from ..detectors.calibrated import resolve_thresholds
from ..receiver.epoch import Epoch
from ._kernels import find_diverged
from .domain import Choice, FloatArray, apply_choices, draw
from .monitors import Monitor, name_detector
from .setup import Run, Setup, make_generators, seeds_of_runs

Rows = NDArray[np.intp]
Rngs = Sequence[np.random.Generator]
FixedChoices = Mapping[str, Any]  # circumstances that are not to be drawn, by `domain.CHOICES`
Written = NDArray[np.floating[Any]]
StepArrays = tuple[NDArray[np.int64], NDArray[np.bool_], FloatArray, FloatArray, FloatArray]
M = TypeVar("M", bound=Monitor)
DROPPED = 0.125  # part of the receivers of a warm-up that are at their onset when these are left
DOMAIN_STREAM = 0xD0  # key of the stream of an episode's seed from which a domain is drawn


class SkyData(NamedTuple):
    """The satellites over one receiver, by slot (n,). Angles in radians; `spoofed` where the
    spoofer changes the signal; `weight` of the pseudorange in the receiver, 0 where the detector
    excludes it; `names` is ``""`` for an empty slot."""

    names: tuple[str, ...]
    azimuth: FloatArray
    elevation: FloatArray
    visible: NDArray[np.bool_]
    spoofed: NDArray[np.bool_]
    weight: FloatArray


class FrameData(NamedTuple):
    """One receiver at one instant. `position_ne` (2,) true position from that at the onset,
    `error_ne` (2,) estimate minus truth, `displacement_ne` (2,) commanded, None where the spoofer
    commands no position [m]; `ratio` the largest statistic over its threshold, NaN before the first
    verdict; `sky` None where the receiver takes positions."""

    position_ne: FloatArray
    error_ne: FloatArray
    displacement_ne: FloatArray | None
    ratio: float
    sky: SkyData | None


class EpisodeLayout(NamedTuple):
    """What stays the same in a picture for a whole episode. `track_ne` (K, 2) is the true ground
    track from the onset to the end of the time to alert [m]; `onset_s` the time of the onset."""

    title: str
    track_ne: FloatArray
    interval_s: float
    steps: int
    attack_s: float
    hold_s: float
    onset_s: float
    commands_position: bool
    has_sky: bool


class Sequel(Protocol):
    """What follows an epoch, such as its score, for `Simulator.step`. A simulator calls it after
    the epoch, or gives its `arrays` to `Setup.kernel` before those of its own; then `hold` is
    called where that found receivers that have come to the time to alert."""

    def arrays(self, simulator: Any) -> tuple[NDArray[Any], ...]:
        """First arguments of `Setup.kernel`."""

    def hold(self, simulator: Any, verdict: Verdict) -> None:
        """Run the time to alert of the receivers that need it, and do what is left."""

    def __call__(self, simulator: Any, verdict: Verdict) -> None:
        """Do all of it."""


FARTHEST = 1e9
"""Coordinate from which on an estimated position counts as diverged [m]."""


class FilterDiverged(ArithmeticError):
    """The filter of a victim has no position any more, so that no score of it means anything."""


class Simulator(ABC):
    """B receivers that go through their episodes in step with one another.

    All that an episode changes is in memories, so that receivers can be reset and moved by rows.

    - `setup`: what all simulators of this victim share;
    - `receivers`: B;
    - `fields`: optional fields of the epochs: what the detector in the loop and the monitors need,
      and `Setup.fields`; the others are None;
    - `memory`: ``first`` and ``onset`` (B,) epochs at which the episode starts, and after which the
      attack does; ``heading`` (B,) and ``direction`` (B, 2) of the target; ``key`` (B, 2) of the
      episode's domain; ``warmup_alarm`` (B,), whether the warm-up alarmed; and the victim's;
    - `detector`: in the loop, bound; `monitors`: what looks at every epoch that is judged;
    - `verdict`: of the last epoch that was judged in these episodes, or None;
    - `weights` (B, m) of the last update;
    - `clean` (B,) bool, receivers whose measurements the attack leaves alone, whatever it is
      commanded; None for none.
    """

    verdict: Verdict | None
    epoch: Epoch

    def __init__(self, setup: Setup, receivers: int, run: Run) -> None:
        check_number("receivers", receivers, least=1, whole=True)
        self.setup, self.receivers, self._run = setup, receivers, run
        self.memory, b = Memory(receivers), receivers
        self.memory.declare_all(
            first=np.zeros(b, dtype=np.int64),
            onset=np.zeros(b, dtype=np.int64),
            heading=np.zeros(b),
            key=np.zeros((b, 2), dtype=np.uint64),
            direction=np.zeros((b, 2)),
            warmup_alarm=np.zeros(b, dtype=np.bool_),
        )
        resolve_thresholds(setup.detector, setup)
        self.fields = setup.fields.union(*map(check_needs, (setup.detector, *setup.monitors)))
        self._allocate()
        self.ones = np.ones((receivers, len(self._context().noise_variance)))
        self.weights, self.verdict = self.ones, None
        self.clean: NDArray[np.bool_] | None = None
        self.detector = copy.deepcopy(setup.detector)
        self.bind_detector(self.detector)
        self.monitors = [copy.deepcopy(monitor) for monitor in setup.monitors]
        for monitor in self.monitors:
            monitor.bind(self)
            self._check_has(monitor)

    # --- what a victim defines -----------------------------------------------------------------

    @abstractmethod
    def _allocate(self) -> None:
        """Declare memories and make the buffers of B receivers."""

    @abstractmethod
    def _context(self) -> DetectorContext:
        """Sizes, interval, noise and satellites, for detectors."""

    @abstractmethod
    def _draw(self, rngs: Rngs) -> NDArray[np.uint64]:
        """Take a new episode from every generator; (B, 2) keys of its domain."""

    @abstractmethod
    def _start(self, choice: Choice) -> None:
        """Draw the errors of the chosen episodes, and initialize the filters."""

    @abstractmethod
    def _renew(self, rows: Rows, episodes: Sequence[np.random.SeedSequence]) -> None:
        """Take the noise of other episodes from here on; what has been drawn before stays."""

    @abstractmethod
    def _measure(self, command: FloatArray | None) -> None:
        """Go on by one epoch: move the counterfeit, measure, predict."""

    def _form_epoch(self) -> Epoch:
        """What a detector may see of the epoch: of the optional fields those in `fields`."""
        return self.epoch

    @abstractmethod
    def _correct(self, weights: FloatArray | None) -> None:
        """Update the filters with these weights; None for ones."""

    @property
    @abstractmethod
    def epochs(self) -> NDArray[np.int64]:
        """(B,) index of each receiver's epoch in `Setup.epoch_time`."""

    @property
    @abstractmethod
    def position(self) -> FloatArray:
        """(B, d) estimated, in the axes of `Setup.true_position` [m]."""

    @abstractmethod
    def error_n(self) -> FloatArray:
        """(B, e) error of the estimate along `Setup.error_names`, estimate minus truth [m]."""

    @property
    def coasting(self) -> NDArray[np.bool_]:
        """(B,) bool, whether the last epoch had no update for want of measurements."""
        return np.zeros(self.receivers, dtype=np.bool_)

    @property
    def commands(self) -> Memory:
        """Where ``displacement`` and ``rate`` (B, a) of the spoofer's commands are."""
        return self.memory

    @property
    def commanded_displacement(self) -> FloatArray:
        return self.commands["displacement"]

    @property
    def commanded_rate(self) -> FloatArray:
        return self.commands["rate"]

    def step_arrays(self) -> StepArrays:
        """Epochs, coasting, commanded displacement and rate, target direction, for kernels."""
        commanded = self.commanded_displacement, self.commanded_rate
        return self.epochs, self.coasting, *commanded, self.memory["direction"]

    def motion(self, per_position: float, per_velocity: float, out: Written) -> None:
        """Write the target's true motion since the onset, along `Setup.motion_names`, scaled."""
        self.setup.local_motion(self.epochs, self.onset, per_position, per_velocity, out)

    def geometry(self, out: NDArray[np.float32]) -> None:
        raise TypeError(f"{self.setup.whose} has no satellites")

    def report_attack(self) -> dict[str, NDArray[Any]]:
        """What the attack reports of itself, (B, ...) by key."""
        return {}

    def captured_channels(self) -> NDArray[np.int64]:
        raise TypeError(f"the channels of {self.setup.whose} are not captured one by one")

    def observed_weights(self) -> FloatArray:
        """(B, w) weights of the last update along `Setup.weight_names`."""
        return self.weights[:, : len(self.setup.weight_names)]

    def _ground_ne(self, epochs: slice) -> FloatArray:
        """(K, 2) true position at epochs, north and east of the first receiver's onset [m]."""
        setup, onset = self.setup, int(self.onset[0])
        ground_e = setup.true_position[epochs] - setup.true_position[onset]
        return np.asarray(ground_e @ setup.C_en[onset])[:, :2]

    def _sky(self) -> SkyData | None:
        return None

    def get_record_columns(self) -> dict[str, NDArray[Any]]:
        return {"commanded_displacement_m": self.commanded_displacement}

    # --- the same for all victims --------------------------------------------------------------

    @property
    def onset(self) -> NDArray[np.int64]:
        return self.memory["onset"]

    @property
    def ages(self) -> NDArray[np.int64]:
        """(B,) epochs from the start of the episode to its onset."""
        return np.asarray(self.onset - self.memory["first"])

    @property
    def heading(self) -> FloatArray:
        """(B,) direction in which displacement counts, clockwise from north [rad]."""
        return self.memory["heading"]

    def time_s(self) -> FloatArray:
        return self.setup.epoch_time[self.epochs]

    def bind_detector(self, detector: Detector) -> None:
        """Bind a detector to these receivers; a ValueError where it can't judge or alarm."""
        setup, context = self.setup, self._context()
        require(
            not detector.needs_model or context.model is not None,
            f"{type(detector).__name__} needs a model of the victim's errors, which "
            f"{setup.whose} does not have here; {HAVE_IT}",
        )
        self._check_has(detector)
        late = detector.needs - self.fields
        require(
            not late,
            f"{type(detector).__name__} needs {', '.join(sorted(late))}, but the fields of the "
            "epochs are fixed when a simulator is made: a monitor that binds detectors must "
            "have what they need in its own `needs`",
        )
        resolve_thresholds(detector, setup)
        detector.bind(context)
        seen = setup.onset if detector.from_start else setup.live
        if setup.domain.age_s is None and seen < detector.memory_epochs:
            ages = (seen * setup.interval_s, detector.memory_epochs * setup.interval_s)
            warnings.warn(
                f"{type(detector).__name__} is live for {ages[0]:g} s before the attack and its "
                f"memory is {ages[1]:g} s long, so that what it finds depends on when it went "
                "live: give the timeline a longer `live_s`",
                YoungMemoryWarning,
                stacklevel=2,
            )
        youngest = setup.youngest if detector.from_start else setup.least_live
        epochs = youngest + setup.steps + setup.hold
        require(
            detector.silent_epochs < epochs,
            f"{type(detector).__name__} can't alarm in its first {detector.silent_epochs} "
            f"epochs, and an episode has {epochs} in which it judges; shorten its windows",
        )

    def _check_has(self, reader: Detector | Monitor) -> None:
        missing = reader.needs - self.setup.has
        require(
            not missing,
            f"{type(reader).__name__} needs {', '.join(sorted(missing))}, which "
            f"{self.setup.whose} does not have",
        )

    def monitor(self, kind: type[M]) -> M:
        for monitor in self.monitors:
            if isinstance(monitor, kind):
                return monitor
        raise LookupError(f"this simulator has no monitor {kind.__name__}")

    def start_episodes(self, rngs: Rngs, given: FixedChoices | None = None) -> None:
        """Start a new episode in every receiver; `given` are circumstances not to be drawn."""
        keys = self._draw(rngs)
        self.memory["key"][:] = keys
        choice = self._choose(keys, given)
        self.detector.reset()
        if isinstance(self.detector, PooledDetector):
            self.detector.draw(keys)
        for monitor in self.monitors:
            monitor.start_episodes()
        self._start(choice)
        self.verdict, self.weights = None, self.ones
        self.memory["warmup_alarm"][:] = False

    def _choose(self, keys: NDArray[np.uint64], given: FixedChoices | None) -> Choice:
        setup = self.setup
        choice = draw(setup.bounds, keys)
        if given:
            names = setup.combination_names
            choice = apply_choices(given, choice, setup.bounds, names, setup.interval_s)
        self.memory["onset"][:] = setup.find_onsets(choice)
        self.memory["first"][:] = self.memory["onset"] - choice.age
        self.memory["heading"][:] = choice.heading
        for b, heading in enumerate(choice.heading.tolist()):
            self.memory["direction"][b] = math.cos(heading), math.sin(heading)
        return choice

    def predict(self, command: FloatArray | None) -> Epoch:
        """First half of an epoch under attack; `command` (B, a), None holds the present rate."""
        self._measure(command)
        self.epoch = self._form_epoch()
        return self.epoch

    def advance(self) -> Epoch:
        return self.predict(None)

    def judge(self) -> Verdict:
        try:
            self.verdict = judge_epoch(self.detector, self.epoch)
        except ValueError:  # a verdict that is not finite may be the filter's fault
            self.check_converged()
            raise
        for monitor in self.monitors:
            monitor.update(self)
        return self.verdict

    def update(self, weights: FloatArray | None) -> None:
        """Second half of an epoch; `weights` (B, m) in [0, 1], C-contiguous, None for ones."""
        if weights is not None and (self.verdict is None or weights is not self.verdict.weights):
            checked_weights(weights, self.epoch)
        self.weights = self.ones if weights is None else weights
        self._correct(weights)
        self.check_converged()
        for monitor in self.monitors:
            monitor.observe_update(self)

    def check_converged(self) -> None:
        """Raise `FilterDiverged` where an estimated position is invalid, whatever the detector."""
        position = self.position
        b = find_diverged(position, FARTHEST)
        if b >= 0:
            raise FilterDiverged(
                f"the filter of receiver {b} of {len(position)} has diverged at "
                f"{self.time_s()[b]:g} s: its position is {position[b].tolist()}; "
                "a weaker attack, more satellites or another `tuning` may keep it"
            )

    def step(
        self,
        command: FloatArray | None = None,
        *,
        attacked: bool = True,
        sequel: Sequel | None = None,
    ) -> Verdict:
        """Both halves of an epoch, with the detector's weights; `attacked` as in `predict`."""
        self.predict(command) if attacked else self.advance()
        verdict = self.judge()
        self.update(verdict.weights)
        if sequel is not None:
            sequel(self, verdict)
        return verdict

    def run_filter_only(self, count: int) -> None:
        """Run epochs that are not judged. What sees them `from_start` is shown them: the detector
        in the loop, the monitors, and the detectors of these."""
        self.weights = self.ones
        beside = (each for monitor in self.monitors for each in monitor.detectors)
        readers: list[Detector | Monitor] = [self.detector, *beside, *self.monitors]
        watching = [each for each in readers if each.from_start]
        if not watching:
            self._run_unseen(count)
            return
        for _ in range(count):
            epoch = self.advance()
            for each in watching:
                each.watch(epoch)
            self._correct(None)

    def _run_unseen(self, count: int) -> None:
        for _ in range(count):
            self._measure(None)
            self._correct(None)

    @property
    def judges_compiled(self) -> bool:
        """Whether `live_epochs` takes one kernel call, and not a loop in Python."""
        return False

    def live_epochs(self, count: int, *, holding: bool = False) -> NDArray[np.bool_]:
        """Run epochs with the detector and without commands; (count, B) bool alarms. `holding` says
        that the attack holds its rate; if not, it has not started."""
        alarms = np.zeros((count, self.receivers), dtype=np.bool_)
        for k in range(count):
            alarms[k] = self.step(attacked=holding).alarm.any(axis=1)
        return alarms

    def switch_on(self, rngs: Rngs, given: FixedChoices | None = None) -> None:
        """`warm_up` that ends where the detectors go live."""
        self.start_episodes(rngs, given)
        self.run_filter_only(self.setup.filter_only)

    def warm_up(self, rngs: Rngs, given: FixedChoices | None = None) -> NDArray[np.bool_]:
        for _ in self.warming(rngs, given):
            pass
        return self.memory["warmup_alarm"]

    def warming(
        self, rngs: Rngs, given: FixedChoices | None = None, piece: int = sys.maxsize
    ) -> Iterator[None]:
        """`warm_up` that stops after pieces of some epochs of single receivers."""
        self.start_episodes(rngs, given)
        each = max(1, piece // self.receivers)
        for start in range(0, self.setup.filter_only, each):
            yield
            self.run_filter_only(min(each, self.setup.filter_only - start))
        for part, _, count in self.ageing(self.setup.filter_only):
            each = max(1, piece // part.receivers) if part.judges_compiled else 1
            for start in range(0, count, each):
                yield
                alarms = part.live_epochs(min(each, count - start))
                part.memory["warmup_alarm"] |= alarms.any(axis=0)

    def ageing(self, past: int = 0) -> Iterator[tuple[Self, Rows, int]]:
        """Receivers that are to go on together, their rows here, and by how many epochs, until each
        is at its onset, `past` epochs after the start. Those that are there stay as they are."""
        left, rows = self.ages - past, np.arange(self.receivers)
        if (left == left[0]).all():
            yield self, rows, int(left[0])
            return
        part, gone = self._copy(rows), 0
        for end in np.unique(left).tolist():
            yield part, rows, end - gone
            gone, there = end, np.flatnonzero(left[rows] == end)
            self.copy_rows(rows[there], part, there)
            young = keep_company(np.flatnonzero(left[rows] > end), there)
            if 0 < len(young) <= (1.0 - DROPPED) * len(rows):
                part, rows = part._copy(young), rows[young]

    def _copy(self, rows: Rows) -> Self:
        part: Self = self.setup.simulator(len(rows), self._run)
        part.copy_rows(np.arange(len(rows)), self, rows)
        return part

    def start_from(
        self, pool: Self, rows: Rows, episodes: Sequence[np.random.SeedSequence], picked: Rows
    ) -> None:
        """Let some receivers start new episodes as copies of the `picked` of a pool that have come
        to the onset. The seed of an episode gives all noise after the onset."""
        self.copy_rows(rows, pool, picked)
        self._renew(rows, episodes)

    def layout(self) -> EpisodeLayout:
        setup, onset = self.setup, int(self.onset[0])
        return EpisodeLayout(
            title=f"{setup.title} against {name_detector(setup.detector)}",
            track_ne=self._ground_ne(slice(onset, onset + setup.steps + setup.hold + 1)),
            interval_s=setup.interval_s,
            steps=setup.steps,
            attack_s=setup.steps * setup.interval_s,
            hold_s=setup.hold * setup.interval_s,
            onset_s=float(setup.epoch_time[onset]),
            commands_position=self._displacement_ne() is not None,
            has_sky=self._sky() is not None,
        )

    def frame(self) -> FrameData:
        epoch = int(self.epochs[0])
        return FrameData(
            position_ne=self._ground_ne(slice(epoch, epoch + 1))[0],
            error_ne=self.error_n()[0, :2],
            displacement_ne=self._displacement_ne(),
            ratio=float(self.ratio()[0]),
            sky=self._sky(),
        )

    def _displacement_ne(self) -> FloatArray | None:
        axes = [name.rsplit("_", 1)[0] for name in self.setup.action_names]
        if not {"north", "east"} & set(axes):
            return None
        moved = dict(zip(axes, self.commanded_displacement[0], strict=True))
        return np.array([moved.get("north", 0.0), moved.get("east", 0.0)])

    def origin_ne(self) -> FloatArray:
        """(B, 2) error north and east now, for the `origin` of a displacement [m]."""
        return self.error_n()[:, :2]

    def displacement(self, origin: FloatArray, twin: Self | None, out: FloatArray) -> None:
        """Write the displacement that counts, (B,) [m]. It is the horizontal error less `origin`
        (B, 2), or the distance from the clean twin, along the target direction; its size where that
        is ``"worst"``."""
        apart = self.error_n()[:, :2]
        if twin is not None:
            apart = apart - twin.error_n()[:, :2]
        if self.setup.target_heading_deg == "worst":
            north, east = (apart - origin).T
            np.sqrt(north * north + east * east, out=out)
            return
        north, east = self.memory["direction"].T
        np.subtract(
            apart[:, 0] * north + apart[:, 1] * east,
            origin[:, 0] * north + origin[:, 1] * east,
            out=out,
        )

    def command_with(self, command: FloatArray | None) -> FloatArray | None:
        if command is None:
            return None
        within = np.clip(command, -1.0, 1.0)
        return within if self.clean is None else np.where(self.clean[:, None], 0.0, within)

    def copy_rows(self, to: Rows, other: Self, rows: Rows) -> None:
        self.memory.copy_rows(to, other.memory, rows)
        self.detector.memory.copy_rows(to, other.detector.memory, rows)
        if self.monitors:  # a clean twin has no monitors
            for mine, theirs in zip(self.monitors, other.monitors, strict=True):
                mine.copy_rows(to, theirs, rows)
        weights = self.weights.copy()
        weights[to] = other.weights[rows]
        self.weights = weights
        if other.verdict is not None:
            self.verdict = _merge(self.verdict, other.verdict, to, rows, self.receivers)
        elif self.verdict is not None:
            # nothing has been judged in the new episode; the verdict of the old one is over
            statistic, alarm = self.verdict.statistic.copy(), self.verdict.alarm.copy()
            statistic[to], alarm[to] = 0.0, False
            self.verdict = self.verdict._replace(statistic=statistic, alarm=alarm)

    def ratio(self) -> FloatArray:
        """(B,) largest statistic over its threshold of the last verdict; NaN before the first."""
        if self.verdict is None:
            return np.full(self.receivers, np.nan)
        return np.asarray((self.verdict.statistic / self.verdict.threshold).max(axis=1))


def _merge(mine: Verdict | None, theirs: Verdict, to: Rows, rows: Rows, receivers: int) -> Verdict:
    merged: list[Any] = []
    for k, source in enumerate(theirs):
        if source is None:
            merged.append(None)
            continue
        target = np.zeros((receivers, *source.shape[1:]), dtype=source.dtype)
        if mine is not None and mine[k] is not None:
            target[:] = mine[k]
        target[to] = source[rows]
        merged.append(target)
    return Verdict(*merged)


def episode_seeds(rngs: Rngs) -> list[np.random.SeedSequence]:
    return [rng.bit_generator.seed_seq.spawn(1)[0] for rng in rngs]  # type: ignore[attr-defined]


def domain_keys(episodes: Sequence[np.random.SeedSequence]) -> NDArray[np.uint64]:
    """(B, 2) keys from which the domains of episodes are drawn, apart from all their noise."""
    streams = [
        np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, DOMAIN_STREAM))
        for seed in episodes
    ]
    return np.array([stream.generate_state(2, np.uint64) for stream in streams])


def draw_ages(setup: Setup, rngs: Rngs) -> NDArray[np.int64]:
    """(B,) age at the onset of the episodes that generators, which go on, come to next [epochs]."""
    bare_setup = setup.copy_with(detector=Never(), monitors=())
    simulator: Simulator = bare_setup.simulator(len(rngs), run_serially)
    simulator._choose(simulator._draw(rngs), None)
    return simulator.ages


def run_serially(work: Callable[[int, int], None], receivers: int) -> None:
    work(0, receivers)


def keep_company(rows: Rows, others: Rows) -> Rows:
    """Receivers that go on, in order; with a single one also the first of the others. The kernels
    of a single receiver are others, which would be compiled for it alone."""
    return rows if len(rows) != 1 else np.sort(np.append(rows, others[:1]))


def weighs(setup: Setup, detector: Detector) -> bool:
    """Whether a detector de-weights measurements in this world: its first verdict says so. Two
    receivers step: see `keep_company`."""
    chosen = setup.copy_with(detector=detector, monitors=())
    simulator: Simulator = chosen.simulator(2, run_serially)
    simulator.switch_on(make_generators(seeds_of_runs(0, "calibration", setup.name, [0, 1])))
    return simulator.step(attacked=False).weights is not None
