"""The one step path of all environments: episodes of B receivers, scored, rewarded and observed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number, check_word
from ..core.memory import Memory
from ..core.registry import check_choice, check_truth
from ..detectors import Detector, Verdict, detector_in_world
from ..simulation.domain import FloatArray
from ..simulation.engine import Engine
from ..simulation.monitors import EpochLog, PassiveDetectors, needed_monitors
from ..simulation.setup import Setup
from ..simulation.simulator import FixedChoices, Rngs, Rows, run_serially
from ..spoofers.base import KNOWLEDGE
from ._kernels import ALARM, COST, DISPLACEMENT, FIRST, GAIN, RETRACTION, REWARD, TRUNCATED
from .context import bind_base
from .observer import Observer
from .scoring import (
    MARK_NAMES,
    VALUE_NAMES,
    DisplacementScore,
    FusedStep,
    Info,
    Mask,
    PlainResult,
    ScoredStep,
    StepResult,
    report_verdict,
)
from .terms import ActionSpec, EndSpec, ObservationSpec, RewardSpec, make_terms
from .terms.action import CommandMap, Decisions, default_action
from .terms.observation import Snapshot, default_terms
from .terms.reward import Outcome, compute_shares, default_rewards, named_terms, sum_terms
from .terms.termination import AtAlarm, Ends, EpochState

Listener = Callable[["SpoofCore", EpochState, Verdict], None]
"""Called after every epoch of a command, before the time to alert, if it was the last."""
WatchSpec = str | Mapping[str, Any] | Detector | Sequence[str | Mapping[str, Any] | Detector]
"""Passive detectors: they judge the same epochs as the one in the loop, and change nothing."""
EpochSpec = bool | Sequence[str]
"""Whether the information has the epochs: optional fields of `Epoch` by name, True for all that the
receiver has; `SETTLING` among them adds the filter-only warm-up, as ``info["settling_epochs"]``."""
SETTLING = "settling"
SingleStep = tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]
"""Observation, reward, terminated, truncated, and information, of a batch of one."""
ALARM_PRICE = 1.5
"""Price of an alarm, in lengths; that of `tasks`, which is no source of what is compiled."""
NOTHING_SEEN = np.empty(0, dtype=np.float32)


class Core(Protocol):
    """Episodes of B receivers, as an environment of either side needs them. `bounds` are the least
    and the largest observation, (o,) each; `reset_names` the keys of the information of a reset;
    `episode_steps` the steps of an episode that nothing ends early."""

    receivers: int
    observation_names: tuple[str, ...]
    action_names: tuple[str, ...]
    reset_names: tuple[str, ...]
    bounds: tuple[NDArray[np.float32], NDArray[np.float32]]
    episode_steps: int

    @property
    def info_names(self) -> tuple[str, ...]:
        """Keys of the information of a step."""

    def reset(
        self, rngs: Rngs, rows: Rows | None = None, given: FixedChoices | None = None
    ) -> None:
        """Start new episodes of some receivers, all by default; one generator a row."""

    def step(self, action: FloatArray) -> tuple[StepResult | PlainResult, NDArray[np.float32]]:
        """Run a step with (B, a) actions; result and (B, o) observation."""

    def single(self, action: FloatArray) -> SingleStep:
        """`step` of a batch of one, as a Gymnasium environment returns it."""

    def observe(self) -> NDArray[np.float32]:
        """Observe all receivers, (B, o), a new array."""

    def reset_info(self) -> Info:
        """Information of a reset."""

    def close(self) -> None:
        """End the threads."""


class SpoofCore:
    """Episodes of B receivers in which the learner is the spoofer.

    The displacement of a step is the position error of the victim along the target direction, less
    what it was at the onset, or, with twins, the distance from the clean twin along it.  What of it
    counts is in `scoring`.  After the last command the offsets hold their rate for the time to
    alert, in which an alarm still counts.  A decision may last several epochs; its reward is the
    sum of theirs, and a receiver whose episode ends at one of them is observed as it is then.

    Parameters
    ----------
    receivers : int
        B.
    setup : Setup
        Of any victim.
    threads, prefetch, warm_pool : optional
        As in `Engine`; all others as in `SpoofEnv`.

    Attributes
    ----------
    observation_names, action_names, reset_names, bounds, episode_steps
        As in `Core`.
    engine, commands, score : Engine, CommandMap, DisplacementScore
        The receivers, what actions command, and what counts of the running episodes.
    settings : dict
        Arguments as they were given, for `copy_with`.
    listeners : list of Listener
        Called at every epoch.
    """

    def __init__(
        self,
        receivers: int,
        setup: Setup,
        *,
        knowledge: str = "tracking",
        observation: ObservationSpec | None = None,
        action: ActionSpec | None = None,
        reward: RewardSpec | None = None,
        end: EndSpec | None = None,
        watch: WatchSpec = (),
        epoch: EpochSpec = False,
        length_m: float | None = None,
        alarm_price: float = ALARM_PRICE,
        end_at_alarm: bool = True,
        twin: bool = False,
        warm_pool: int | None = None,
        threads: int | None = None,
        prefetch: bool = False,
    ) -> None:
        check_word("knowledge", knowledge, KNOWLEDGE)
        check_truth("end_at_alarm", end_at_alarm)
        check_truth("twin", twin)
        check_truth("prefetch", prefetch)
        ends = None if end is None else make_terms("end", end)
        _check_overruled(length_m, alarm_price, reward, end_at_alarm, ends)
        length = setup.scales["length_m"] if length_m is None else length_m
        check_number("length_m", length, above=0.0)
        self.length_m = float(length)
        check_number("alarm_price", alarm_price, least=0.0)
        actions = default_action(setup) if action is None else make_terms("action", action)
        self.commands = CommandMap(actions, setup)
        seen = default_terms(setup, knowledge, along_target=self.commands.along_target)
        if observation is not None:
            seen = make_terms("observation", observation)
        rewards = default_rewards(alarm_price * self.length_m)
        if reward is not None:
            rewards = make_terms("reward", reward)
        self.settings: dict[str, Any] = {
            "knowledge": knowledge,
            "observation": observation,
            "action": None if action is None else actions,
            "reward": reward,
            "end": ends,
            "watch": make_watch(watch),
            "epoch": epoch,
            "length_m": length_m,
            "alarm_price": alarm_price,
            "end_at_alarm": end_at_alarm,
            "twin": twin,
            "warm_pool": warm_pool,
            "threads": threads,
            "prefetch": prefetch,
        }
        self._ends = Ends(((AtAlarm(),) if end_at_alarm else ()) if ends is None else ends)
        self.end_at_alarm, self._has_ends = self._ends.at_alarm, bool(self._ends)
        monitors = needed_monitors([*seen, *self._ends.terms])
        passive = self.settings["watch"]
        self._passive = PassiveInfo(PassiveDetectors(passive), receivers) if passive else None
        self.reset_names: tuple[str, ...] = (
            *("time_s", "warmup_alarm", "coasting", "statistic", "threshold"),
            *setup.attack.reports,
        )
        if self._passive is not None:
            monitors.append(self._passive.monitor)
            self.reset_names += self._passive.reset_names
        log = make_log(epoch, setup)
        self._log_names: tuple[str, ...] = ()
        if log is not None:
            monitors.append(log)
            self._log_names = ("epochs", "settling_epochs") if log.from_start else ("epochs",)
            self.reset_names += self._log_names
        own = set(map(type, monitors))
        monitors += [monitor for monitor in setup.monitors if type(monitor) not in own]
        self.setup = setup.copy_with(monitors=monitors)
        self.engine = Engine(
            receivers,
            self.setup,
            threads=threads,
            prefetch=prefetch,
            twin=twin,
            warm_pool=warm_pool or None,
        )
        self.receivers, self.episode_steps = receivers, setup.steps // setup.repeat
        self.observer = Observer(seen, self.setup)
        self.observation_names = self.observer.names
        self.bounds = self.observer.low, self.observer.high
        self._origin = np.zeros((receivers, 2))
        self._decisions = Decisions(setup, receivers, len(self.commands.names))
        self._all_rows = np.arange(receivers)
        self.action_names = self.commands.names
        self.commands.aim(self.heading_rad)
        self._seen = NOTHING_SEEN.reshape(receivers, 0)
        self._base = bind_base(self.setup, receivers, self.observer, self.commands)
        self.score = DisplacementScore(receivers, setup.steps, setup.hold)
        self.listeners: list[Listener] = []
        self._done: _DoneRows | None = None
        self.set_rewards(rewards)

    @property
    def heading_rad(self) -> FloatArray:
        """(B,) direction in which displacement counts, clockwise from north [rad]."""
        return self.engine.simulator.heading

    @property
    def info_names(self) -> tuple[str, ...]:
        rewards = [key for key, _ in self._reward_parts]
        passive = self._passive.step_names if self._passive else ()
        captured = () if self.setup.attack.capture is None else ("captured_channels",)
        captured += self.setup.attack.reports
        twin = () if self.engine.twin is None else ("twin_alarm",)
        return (
            *VALUE_NAMES,
            *MARK_NAMES,
            *captured,
            *twin,
            *rewards,
            *self._ends.info_names,
            *passive,
            *self._log_names,
        )

    def set_rewards(self, terms: Sequence[Any]) -> None:
        self._reward_parts = named_terms(terms)
        shares = compute_shares(terms)
        self._compiled = shares is not None
        self._fused = FusedStep(
            self.score,
            self.setup.epoch_time,
            at_alarm=self.end_at_alarm,
            worst=self.setup.target_heading_deg == "worst",
            parts=tuple(key for key, _ in self._reward_parts) if self._compiled else (),
            shares=shares,
            table=self.observer.table,
            command=self.observer.command,
            per_rate=self.observer.per_rate,
        )
        self._sequel = ScoredStep(self._fused, self._origin, self.engine.hold)
        self._scratch = StepResult(self._fused.layout)
        captures = bool(self.setup.attack.capture is not None or self.setup.attack.reports)
        twins = self.engine.twin is not None
        watched = self._passive is not None or bool(self._log_names)
        self._reports_more = captures or twins or watched
        self._needs_arrays = (
            self._reports_more or self._has_ends or not self._compiled or self.setup.repeat > 1
        ) or self._base is not None

    def copy_with(self, setup: Setup | None = None, **changes: Any) -> SpoofCore:
        """A new core, not started yet, with another setup or other arguments, without listeners."""
        chosen = self.setup if setup is None else setup
        return SpoofCore(self.receivers, chosen, **{**self.settings, **changes})

    def close(self) -> None:
        self.engine.close()

    def snapshot(self) -> Snapshot:
        """The episodes now, as views that are valid until the next step."""
        engine = self.engine
        return Snapshot(self.setup, engine.simulator, self.score.step_count, engine.twin)

    def observe(self) -> NDArray[np.float32]:
        return self._remember(self.observer.observe(self.snapshot()))

    def _remember(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Keep what a base observes, apart from the array that is handed out."""
        if self._base is not None:
            self._seen = observation.copy()
        return observation

    def reset(
        self, rngs: Rngs, rows: Rows | None = None, given: FixedChoices | None = None
    ) -> None:
        where = self._all_rows if rows is None else rows
        self.engine.reset(rngs, rows, given)
        self.score.reset(where)
        if self._done is not None:  # an interrupted decision may have left some
            self._done.drop(where)
        self._decisions.forget(where)
        self.commands.aim(self.heading_rad)
        if self._base is not None:
            self._base.spoofer.reset(np.isin(self._all_rows, where))
        if self.engine.twin is None:
            self.set_origin(where)
        if self._passive is not None:
            self._passive.reset(where, self._passive_memory)

    def set_origin(self, rows: Rows) -> None:
        """Count the displacement of some receivers from here on."""
        self._origin[rows] = self.engine.simulator.origin_ne()[rows]

    @property
    def _passive_memory(self) -> Memory:
        return self.engine.simulator.monitor(PassiveDetectors).memory

    def command(self, action: FloatArray) -> FloatArray:
        """Command (B, a) of the coming epoch, of an action (B, k); valid until the next one."""
        return self.commands.command(action, self.engine.simulator.commanded_rate)

    def displacement(self) -> FloatArray:
        """(B,) displacement that counts, at this epoch [m]."""
        displacement = np.empty(self.receivers)
        self.engine.simulator.displacement(self._origin, self.engine.twin, displacement)
        return displacement

    def step(self, action: FloatArray) -> tuple[StepResult, NDArray[np.float32]]:
        """One decision of all receivers, (B, k) in [-1, 1]; its result and (B, o) observed."""
        if self._passive is not None:
            self._passive_memory["alarmed"][:] = False
        if self._base is not None:
            action = self._base.add(self._seen, action)
        if self.setup.repeat > 1:
            result = self._decide(action)
            observation = self.observe()
        else:
            result = StepResult(self._fused.layout)
            observation = self._remember(self._epoch(action, result))
        if self._reports_more:
            if self.setup.attack.capture is not None:
                result.extra["captured_channels"] = self.engine.simulator.captured_channels()
            if self.setup.attack.reports:
                result.extra.update(self.engine.simulator.report_attack())
            if self._passive is not None:
                result.extra.update(self._passive.step_info(self._passive_memory))
            result.extra.update(self._take_epochs())
        return result, observation

    def _take_epochs(self) -> Info:
        """Epochs since the last call, where they are logged, by `_log_names`."""
        if not self._log_names:
            return {}
        log = self.engine.simulator.monitor(EpochLog)
        taken = log.take(), log.take_settling()
        return dict(zip(self._log_names, taken, strict=False))

    def single(self, action: FloatArray) -> SingleStep:
        if self._needs_arrays or self.listeners:
            result, observation = self.step(action)
            return observation[0], *result.single()
        # its arrays are not stored: their values are returned as numbers
        return self._epoch(action, self._scratch)[0], *self._scratch.single()

    def _epoch(
        self, action: FloatArray, result: StepResult, now: FloatArray | None = None
    ) -> NDArray[np.float32]:
        """One epoch; (B, o) observed, or nothing where `now` is the action within a decision."""
        engine, observed = self.engine, now is None
        now = action if now is None else now
        command = now if self.commands.is_plain else self.command(now)
        receivers, width = self.receivers, len(self.observer.names)
        seen = np.empty(receivers * width, dtype=np.float32) if observed else NOTHING_SEEN
        if self._has_ends or self.listeners or engine.twin is not None:
            self._score_apart(command, result, seen)
        else:
            self._sequel.result, self._sequel.seen = result, seen
            engine.step(command, self._sequel)
        result.report(engine.simulator.verdict)
        if not self._compiled:
            self._reward(result, action)
        if not observed:
            return NOTHING_SEEN
        observation = seen.reshape(receivers, width)
        if self.observer.dynamic:
            self.observer.complete(self.snapshot(), observation)
        return observation

    def _score_apart(
        self, command: FloatArray, result: StepResult, seen: NDArray[np.float32]
    ) -> None:
        engine, early = self.engine, self.score.no_rows
        verdict = engine.step(command)
        engine.simulator.displacement(self._origin, engine.twin, result.displacement)
        if self._has_ends or self.listeners:
            early = self._judge_ends(result, verdict)
        given = engine.simulator, verdict.alarm, early, engine.warmup_alarm
        if engine.twin is not None and engine.twin.verdict is not None:
            self.score.twin_alarmed |= engine.twin.verdict.alarm.any(axis=1)
        self._fused(*given, result, seen, engine.hold)
        if engine.twin is not None:
            result.extra["twin_alarm"] = self.score.twin_alarmed.copy()

    def _decide(self, action: FloatArray) -> StepResult:
        """All epochs of one decision; a receiver whose episode ends at one stays as it is then."""
        setup, score = self.setup, self.score
        if self._done is None:
            self._done = _DoneRows(self.engine)
        before = score.ended.copy()
        self._done.keep(np.flatnonzero(before))
        result = StepResult(self._fused.layout)
        self._decisions.take(action)
        self._epoch(action, result, self._decisions.action(0))
        for epoch in range(1, setup.repeat):
            over, counts = score.ended.copy(), score.step_count.copy()
            if np.logical_and.reduce(over):
                break
            self._done.keep(np.flatnonzero(over & ~before))
            self._done.turn_back()
            before = over
            later = StepResult(self._fused.layout)
            self._epoch(action, later, self._decisions.action(epoch))
            later.add(result, over)
            score.step_count[over] = counts[over]
            result = later
        self._done.restore()
        return result

    def _reward(self, result: StepResult, action: FloatArray) -> None:
        values, marks = result.values, result.marks
        moved = values[GAIN], values[RETRACTION]
        alarms = marks[FIRST], values[COST] > 0.0, marks[ALARM]
        over = result.terminated | result.truncated
        outcome = Outcome(*moved, *alarms, action, self.score.undetected, over)
        values[REWARD] = sum_terms(self._reward_parts, outcome, result.extra)

    def _judge_ends(self, result: StepResult, verdict: Verdict) -> Mask:
        """(B,) whether the last command came before the end of the window; calls the listeners."""
        snapshot = self.snapshot()._replace(step=self.score.step_count + 1)
        state = EpochState(snapshot, result.values[DISPLACEMENT])
        for listener in self.listeners:
            listener(self, state, verdict)
        if not self._has_ends:
            return self.score.no_rows
        early, truncated = self._ends.judge(state, result.extra)
        result.marks[TRUNCATED] = truncated
        return early

    def reset_info(self) -> Info:
        engine = self.engine
        return {
            "time_s": engine.simulator.time_s(),
            "warmup_alarm": engine.warmup_alarm.copy(),
            "coasting": engine.simulator.coasting.copy(),
            **report_verdict(engine.simulator),
            **(engine.simulator.report_attack() if self.setup.attack.reports else {}),
            **(self._passive.reset_info() if self._passive else {}),
            **self._take_epochs(),
        }


class _DoneRows:
    """Receivers whose episodes end within a decision, stored as they are then. The engine runs all
    of its receivers in step; these are put back when the others reach the next decision."""

    def __init__(self, engine: Engine) -> None:
        whole = [engine.simulator] if engine.twin is None else [engine.simulator, engine.twin]
        self._pairs = [(each.setup.simulator(each.receivers, run_serially), each) for each in whole]
        self._stored: Mask = np.zeros(engine.receivers, dtype=np.bool_)

    def keep(self, rows: Rows) -> None:
        if len(rows):
            for copy, simulator in self._pairs:
                copy.copy_rows(rows, simulator, rows)
            self._stored[rows] = True

    def turn_back(self) -> None:
        """Put back those that have come to the end of their flight: there is no epoch after it."""
        simulator = self._pairs[0][1]
        end = simulator.memory["first"] + simulator.setup.length
        self._put_back(np.flatnonzero(self._stored & (simulator.epochs >= end)))

    def restore(self) -> None:
        self._put_back(np.flatnonzero(self._stored))
        self._stored[:] = False

    def _put_back(self, rows: Rows) -> None:
        if len(rows):
            for copy, simulator in self._pairs:
                simulator.copy_rows(rows, copy, rows)

    def drop(self, rows: Rows) -> None:
        self._stored[rows] = False


class PassiveInfo:
    """What is reported of passive detectors: their alarms, and largest statistic ratios."""

    def __init__(self, monitor: PassiveDetectors, receivers: int) -> None:
        self.monitor, names = monitor, monitor.names
        self.reset_names = tuple(f"watch_{name}_warmup_alarm" for name in names)
        self._alarm_names = tuple(f"watch_{name}_alarm" for name in names)
        self._ratio_names = tuple(f"watch_{name}_ratio" for name in names)
        self.step_names = (*self.reset_names, *self._alarm_names, *self._ratio_names)
        self._warmup_alarm = np.zeros((receivers, len(names)), dtype=np.bool_)

    def reset(self, rows: Rows, memory: Memory) -> None:
        self._warmup_alarm[rows] = memory["alarmed"][rows]

    def reset_info(self) -> Info:
        return {name: self._warmup_alarm[:, k].copy() for k, name in enumerate(self.reset_names)}

    def step_info(self, memory: Memory) -> Info:
        alarms = {name: memory["alarmed"][:, k].copy() for k, name in enumerate(self._alarm_names)}
        ratios = {name: memory["ratio"][:, k].copy() for k, name in enumerate(self._ratio_names)}
        return {**self.reset_info(), **alarms, **ratios}


def make_watch(spec: WatchSpec) -> tuple[Detector, ...]:
    if isinstance(spec, str | Mapping | Detector):
        spec = (spec,)
    if not isinstance(spec, Sequence):
        raise TypeError(f"`watch` must be a detector or a list of detectors, got {spec!r}")
    return tuple(detector_in_world(each) for each in spec)


def make_log(spec: EpochSpec, setup: Setup) -> EpochLog | None:
    """Log of the epochs as `epoch` requests them; None without one."""
    if spec is False:
        return None
    if spec is True:
        return EpochLog(setup.has)
    if isinstance(spec, str) or not isinstance(spec, Sequence):
        raise TypeError(f"`epoch` must be True, False or names of fields, got {spec!r}")
    for name in spec:
        check_choice("field of an epoch", name, (*sorted(setup.has), SETTLING))
    return EpochLog(set(spec) - {SETTLING}, from_start=SETTLING in spec)


def merge_epoch_specs(one: EpochSpec, other: EpochSpec, setup: Setup) -> EpochSpec:
    """Request for all that either of two requests has."""
    wanted = [spec for spec in (one, other) if spec is not False]
    listed = [sorted(setup.has) if spec is True else spec for spec in wanted]
    return tuple(dict.fromkeys(name for each in listed for name in each)) if wanted else False


def _check_overruled(
    length_m: float | None,
    alarm_price: float,
    reward: RewardSpec | None,
    end_at_alarm: bool,
    end: Sequence[Any] | None,
) -> None:
    if reward is not None and not (length_m is None and alarm_price == ALARM_PRICE):
        raise ValueError(
            "`alarm_price` and `length_m` make the default reward, and `reward` is given: list "
            "{'name': 'alarm-penalty', 'penalty_m': ...} there"
        )
    if end is not None and not end_at_alarm and any(isinstance(term, AtAlarm) for term in end):
        raise ValueError("`end` lists 'at-alarm', but `end_at_alarm` is False: leave out one")
