"""The game: episodes of B receivers, with observations, rewards and ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from ..detectors import Detector, Verdict
from ._kernels import (
    ALARM,
    DISPLACEMENT,
    FIRST,
    GAIN,
    RETRACTION,
    REWARD,
    TRUNCATED,
    displace,
    tell,
)
from .actions import ActionTerm, Actor, FullCommand
from .at_once import AtOnce, rules_of
from .books import Books
from .checks import check_truth
from .ends import AtAlarm, Ends, EndTerm, Standing
from .engine import Engine
from .kept import Kept
from .observations import ObservationTerm
from .observer import Observer
from .played import Stepwise, Told, check_end_at_alarm
from .rewards import SHARED, Outcome, RewardTerm, named_terms, reward_of, shares_of
from .setup import Setup
from .snapshot import Snapshot, position_error_n
from .tally import MARK_NAMES, VALUE_NAMES, Heads, Tally
from .watching import WatchBooks, needed
from .witness import Watch

FloatArray = NDArray[np.float64]
Listener = Callable[["Game", Standing, Verdict], None]
"""Called after every epoch of a command, before the time to alert, if it was the last."""
Apart = tuple[Any, Any, Any, Any, Any, Any, bool, FloatArray]
"""The first arguments of `displace`."""
BEGIN_NAMES = ("time_s", "warmup_alarm", "coasting")
"""Keys of the information at the begin of an episode."""


class Game(Stepwise):
    r"""Episodes of B receivers under attack.

    The displacement of a step is the position error of the victim along the target direction, less
    what it was at the onset, or, with twins, the distance from the clean twin along it; with
    :math:`M_j` its largest value in steps 0 to j, the undetected displacement of an episode
    without an alarm is :math:`M_N`, and that of an episode with its
    first alarm at epoch a is :math:`M_{a-h-1}`, h being the epochs of the time to alert.  After the
    last command the offsets hold their rate for h epochs, in which an alarm still counts.

    A decision may last several epochs.  Its reward is the sum of theirs.  A receiver whose episode
    ends at one of them is observed and told as it stands there.

    Parameters
    ----------
    receivers : int
        B.
    setup : Setup
        World, victim, attack, detector, timeline.
    observation : sequence of ObservationTerm
        Terms of the observation.
    reward : sequence of RewardTerm
        Terms of the reward.
    action : sequence of ActionTerm, optional
        Terms of the action; every element that the attack takes by default.
    end : sequence of EndTerm, optional
        Terms of the end; by `end_at_alarm` if there are none given.
    watch : sequence of Detector
        Detectors that judge every epoch beside the one in the loop, and tell in ``info``.
    end_at_alarm : bool
        Whether an alarm ends the episode.  If not, it goes on without further reward.
    threads : int, optional
        As in `Engine`.
    prefetch, twin : bool
        As in `Engine`.

    Attributes
    ----------
    engine : Engine
        The receivers.
    books : Books
        What counts of the running episodes.
    end_at_alarm : bool
        Whether an alarm ends the episode.
    settings : dict
        Arguments as they were given, for `altered`.
    listeners : list of callable
        Each a `Listener`.
    begin_names, info_names : tuple of str
        Keys of `begin_info`, and of the information of a step.
    """

    def __init__(
        self,
        receivers: int,
        setup: Setup,
        *,
        observation: Sequence[ObservationTerm],
        reward: Sequence[RewardTerm],
        action: Sequence[ActionTerm] | None = None,
        end: Sequence[EndTerm] | None = None,
        watch: Sequence[Detector] = (),
        end_at_alarm: bool = True,
        threads: int | None = None,
        prefetch: bool = False,
        twin: bool = False,
    ) -> None:
        check_end_at_alarm(end_at_alarm)
        check_truth("twin", twin)
        check_truth("prefetch", prefetch)
        self.settings: dict[str, Any] = {
            "observation": observation,
            "reward": reward,
            "action": action,
            "end": end,
            "watch": watch,
            "end_at_alarm": end_at_alarm,
            "threads": threads,
            "prefetch": prefetch,
            "twin": twin,
        }
        ends = ((AtAlarm(),) if end_at_alarm else ()) if end is None else tuple(end)
        self._ends = Ends(ends)
        self.end_at_alarm = self._ends.at_alarm
        self.watch = Watch(watch) if watch else None
        witnesses = needed([*observation, *ends])
        if self.watch is not None:
            witnesses.append(self.watch)
        if witnesses or setup.witnesses:
            setup = setup.altered(witnesses=witnesses)
        self.setup = setup
        self.engine = Engine(receivers, setup, threads=threads, prefetch=prefetch, twin=twin)
        self._kept = Kept(self.engine)
        self.observer = Observer(observation, setup)
        self._origin = np.zeros((receivers, 2))
        self._given = np.zeros((receivers, len(setup.attack.action_names(setup.world))))
        self._rows = np.arange(receivers)
        self.actor = Actor((FullCommand(),) if action is None else action, setup)
        self.actor.aim(self.heading_rad)
        self.books = Books(receivers, setup.steps, setup.hold)
        self.listeners: list[Listener] = []
        self._watch = WatchBooks(self.watch.names, receivers) if self.watch is not None else None
        self._observed = receivers * len(self.observation_names)
        # whether something comes between the verdict of an epoch and what is told of it
        self._in_pieces = bool(self._ends) or setup.repeat > 1
        self.set_rewards(reward)

    @property
    def receivers(self) -> int:
        """B."""
        return self.engine.receivers

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Name of every element of an observation."""
        return self.observer.names

    @property
    def bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Least and largest observation, (o,) each."""
        return self.observer.low, self.observer.high

    @property
    def heading_rad(self) -> FloatArray:
        """(B,) direction in which displacement counts, clockwise from north [rad]."""
        return self.engine.batch.heading

    @property
    def target_heading_deg(self) -> float | str:
        """Direction in which displacement counts, as it was given."""
        return self.setup.target_heading_deg

    @property
    def action_names(self) -> tuple[str, ...]:
        """Name of every element of an action."""
        return self.actor.names

    @property
    def episode_steps(self) -> int:
        """Decisions of the attack window."""
        return self.setup.steps // self.setup.repeat

    @property
    def begin_names(self) -> tuple[str, ...]:
        """Keys of `begin_info`."""
        return BEGIN_NAMES if self._watch is None else (*BEGIN_NAMES, *self._watch.begin_names)

    @property
    def info_names(self) -> tuple[str, ...]:
        """Keys of the information of a step."""
        rewards = [key for key, _ in self._reward_parts]
        watched = () if self._watch is None else self._watch.step_names
        captured = () if self.setup.attack.capture is None else ("captured_channels",)
        told = (*VALUE_NAMES, *MARK_NAMES)
        return (*told, *captured, *rewards, *self._ends.info_names, *watched)

    @property
    def step_count(self) -> NDArray[np.int64]:
        """(B,) commands given in the running episodes."""
        return self.books.step_count

    def set_rewards(self, terms: Sequence[RewardTerm]) -> None:
        """Reward by these terms from the next step on."""
        self._reward_parts = named_terms(terms)
        shares = shares_of(terms)
        self._compiled = shares is not None
        self._shares = np.zeros((0, len(SHARED))) if shares is None else shares
        parts = [key for key, _ in self._reward_parts] if self._compiled else []
        self._heads = Heads(self.receivers, parts)
        self._scratch = Tally(self._heads)
        rules = rules_of(self.engine, self.books, self.observer, self.end_at_alarm, self._shares)
        self._at_once = AtOnce(self.engine, self.books, self.observer, rules)
        self._at_once.begin(self.engine, self._origin)
        captures = self.setup.attack.capture is not None
        self._tells_more = captures or self._watch is not None or not self._compiled

    def altered(self, setup: Setup | None = None, **changes: Any) -> Game:
        """A new game, not begun yet, with some settings changed.

        It has as many receivers, and no listeners.
        """
        return Game(
            self.receivers,
            self.setup if setup is None else setup,
            **{**self.settings, **changes},
        )

    def close(self) -> None:
        """End the threads; they are started again when they are needed."""
        self.engine.close()

    def snapshot(self) -> Snapshot:
        """The game as it is."""
        return Snapshot(self.setup, self.engine.batch, self.step_count, self.engine.twin)

    def observe(self) -> NDArray[np.float32]:
        """Observe all receivers: (B, o) a new array."""
        return self.observer.observe(self.snapshot())

    def reset(
        self,
        rngs: Sequence[np.random.Generator],
        rows: NDArray[np.intp] | None = None,
        given: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin new episodes, and run their warm-up up to the onset."""
        where = self._rows if rows is None else rows
        self.engine.reset(rngs, rows, given)
        self.books.reset(where)
        self._given[where] = 0.0
        self.actor.aim(self.heading_rad)
        if self.engine.twin is None:
            error_n = position_error_n(self.setup, self.engine.batch)
            self._origin[where] = error_n[where, :2]
        self._at_once.begin(self.engine, self._origin)
        if self._watch is not None:
            self._watch.reset(where, self._watched)

    @property
    def _watched(self) -> Memory:
        """What the detectors beside the one in the loop have seen."""
        return self.engine.batch.witness(Watch).memory

    def displacement(self) -> FloatArray:
        """Displacement that counts, of this epoch, (B,) [m]."""
        displacement = np.empty(self.receivers)
        displace(*self._apart(), displacement)
        return displacement

    def _apart(self) -> Apart:
        """What a displacement is computed from, as `displace` takes it."""
        batch, twin, world = self.engine.batch, self.engine.twin, self.setup.world
        return (
            batch.buffers.state.position_e,
            world.position_e if twin is None else twin.buffers.state.position_e,
            batch.epochs if twin is None else self._rows,
            world.C_en,
            batch.onset,
            batch.heading,
            self.setup.target_heading_deg == "worst",
            self._origin,
        )

    def _advance(self, command: FloatArray) -> Verdict:
        """One epoch of the receivers, and of their twins."""
        verdict = self.engine.step(command)
        if self.engine.twin is not None:
            self.engine.step_twin()
        return verdict

    def _play(self, command: FloatArray) -> Tally:
        """One epoch, which is not told yet."""
        verdict = self._advance(command)
        tally = Tally(self._heads)
        displace(*self._apart(), tally.values[DISPLACEMENT])
        early = self._judge_ends(tally, verdict)
        self.books.count(tally, verdict.alarm, early, self.end_at_alarm, self.engine.hold)
        return tally

    def _decide(self, command: FloatArray, action: FloatArray) -> Tally:
        """All epochs of one decision; a receiver whose episode ends at one stands still then."""
        books = self.books
        before = books.ended.copy()
        tally = self._play_and_tell(command, action, 0)
        for epoch in range(1, self.setup.repeat):
            over, counts = books.ended.copy(), books.step_count.copy()
            if np.logical_and.reduce(over):
                break
            self._kept.put_aside(np.flatnonzero(over & ~before))
            before = over
            later = self._play_and_tell(command, action, epoch)
            later.add(tally, over)
            books.step_count[over] = counts[over]
            tally = later
        self._kept.put_back()
        self._given[:] = command
        return tally

    def _play_and_tell(self, command: FloatArray, action: FloatArray, epoch: int) -> Tally:
        """One epoch of a decision, as if it were the only one."""
        tally = self._play(self.setup.command(self._given, command, epoch))
        self._tell(tally)
        if not self._compiled:
            self._reward(tally, action)
        return tally

    def _decide_at_once(self, command: FloatArray, tally: Tally) -> NDArray[np.float32]:
        """`_decide` and `observe` in one kernel, where nobody looks between; (B o,) observed."""
        verdict = self._advance(command)
        seen = np.empty(self._observed, dtype=np.float32)
        if self._at_once(verdict, tally, seen):
            self.books.score_hold(tally, self.engine.hold)
            self._tell(tally)
            return self.observe().ravel()
        if self.observer.dynamic:
            self.observer.complete(self.snapshot(), seen.reshape(self.receivers, -1))
        return seen

    def _tell(self, tally: Tally) -> None:
        """Write what is told of a step."""
        books, engine = self.books, self.engine
        tell(
            books.detected,
            books.ended,
            books.credited,
            engine.warmup_alarm,
            engine.batch.buffers.measured.coasting,
            self.setup.world.epoch_time,
            engine.batch.epochs,
            self._shares,
            tally.values,
            tally.marks,
        )

    def step(self, action: FloatArray) -> Tally:
        """One decision of all receivers, and the epochs until the next.

        `action` (B, k) float64, C-contiguous, in [-1, 1].
        """
        return self.turn(action)[0]

    def turn(self, action: FloatArray) -> tuple[Tally, NDArray[np.float32]]:
        """`step`, then `observe`.  Returns `observation` (B, o) float32, new."""
        if self._watch is not None:
            self._watch.forget(self._watched)
        command = self.actor.command(action)
        if self._in_pieces or self.listeners:
            tally = self._decide(command, action)
            observation = self.observe()
        else:
            tally = Tally(self._heads)
            observation = self._decide_at_once(command, tally).reshape(self.receivers, -1)
            if not self._compiled:
                self._reward(tally, action)
        if self._tells_more:
            self._tell_more(tally)
        return tally, observation

    def _tell_more(self, tally: Tally) -> None:
        """Tell of a step what compiled code does not."""
        if self.setup.attack.capture is not None:
            captured = self.engine.batch.attack.memory["captured"]
            tally.more["captured_channels"] = captured.sum(axis=1)
        if self._watch is not None:
            tally.more.update(self._watch.step_info(self._watched))

    def alone(self, action: FloatArray) -> Told:
        """`turn` of the only receiver, as an environment returns it.

        `action` (1, k) as in `step`.
        """
        if self._in_pieces or self.listeners or self._tells_more:
            return super().alone(action)
        # nobody keeps its arrays: their values are handed out as numbers
        tally = self._scratch
        observation = self._decide_at_once(self.actor.command(action), tally)
        return observation, *tally.alone()

    def _reward(self, tally: Tally, action: FloatArray) -> None:
        """Reward by the terms themselves."""
        values, marks = tally.values, tally.marks
        outcome = Outcome(
            values[GAIN],
            values[RETRACTION],
            marks[FIRST],
            marks[ALARM],
            action,
            self.books.credited,
            tally.terminated | tally.truncated,
        )
        values[REWARD] = reward_of(self._reward_parts, outcome, tally.more)

    def _judge_ends(self, tally: Tally, verdict: Verdict) -> NDArray[np.bool_]:
        """Who has given the last command before the end of the window; tell the listeners, too."""
        if not (self._ends or self.listeners):
            return self.books.nobody
        snapshot = self.snapshot()._replace(step=self.step_count + 1)
        standing = Standing(snapshot, tally.values[DISPLACEMENT])
        for listener in self.listeners:
            listener(self, standing, verdict)
        if not self._ends:
            return self.books.nobody
        early, truncated = self._ends.judge(standing, tally.more)
        tally.marks[TRUNCATED] = truncated
        return early

    def begin_info(self) -> dict[str, NDArray[Any]]:
        """Information at the start of an episode."""
        engine = self.engine
        watched = {} if self._watch is None else self._watch.begin_info()
        return {
            "time_s": self.setup.world.epoch_time[engine.batch.epochs],
            "warmup_alarm": engine.warmup_alarm.copy(),
            "coasting": engine.batch.buffers.measured.coasting.copy(),
            **watched,
        }
