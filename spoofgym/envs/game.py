"""The game: episodes of B receivers, with observations, rewards and ends."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..detectors import Detector, Verdict
from ._kernels import displace
from .actions import ActionTerm, Actor, FullCommand
from .books import Books, Score, joined
from .ends import AtAlarm, Ends, EndTerm, Standing
from .engine import Engine
from .observations import ObservationTerm
from .observer import Observer
from .played import Turn, check_end_at_alarm
from .rewards import Outcome, RewardTerm, named_terms, reward_of
from .setup import Setup
from .snapshot import Snapshot, position_error_n
from .watching import WatchBooks, needed
from .witness import Watch

FloatArray = NDArray[np.float64]
Listener = Callable[["Game", Standing, Verdict], None]
"""Called after every epoch of a command, before the time to alert, if it was the last."""
BEGIN_NAMES = ("time_s", "warmup_alarm", "coasting")
"""Keys of the information at the begin of an episode."""
STEP_NAMES = (
    "time_s",
    "alarm",
    "detected",
    "warmup_alarm",
    "coasting",
    "displacement_m",
    "undetected_displacement_m",
    "cost",
)
"""Keys of the information of a step, without the parts that terms and watching detectors add."""


class Played(NamedTuple):
    """What the epochs of a decision have brought.

    Attributes
    ----------
    displacement : ndarray
        (B,) after the last of them [m].
    score : Score
        Of all of them.
    terminated, truncated : ndarray
        (B,) bool, whose episodes are over.
    ends : dict
        Which end terms hold, or held at an epoch.
    """

    displacement: FloatArray
    score: Score
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    ends: dict[str, NDArray[Any]]

    def then(self, later: Played) -> Played:
        """Join a later epoch to what has been played.

        Parameters
        ----------
        later : Played
            Of the same receivers.

        Returns
        -------
        Played
            An episode that has been truncated is not terminated later.
        """
        return Played(
            later.displacement,
            joined(self.score, later.score),
            self.terminated | (later.terminated & ~self.truncated),
            self.truncated | later.truncated,
            {name: ended | later.ends[name] for name, ended in self.ends.items()},
        )


class Game:
    r"""Episodes of B receivers under attack.

    The displacement of a step is the position error of the victim along the target direction, less
    what it was at the onset, or, with twins, the distance from the clean twin along it; with
    :math:`M_j` its largest value in steps 0 to j, the undetected displacement of an episode
    without an alarm is :math:`M_N`, and that of an episode with its
    first alarm at epoch a is :math:`M_{a-h-1}`, h being the epochs of the time to alert.  After the
    last command the offsets hold their rate for h epochs, in which an alarm still counts.

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
        self.observer = Observer(observation, setup)
        self._origin = np.zeros((receivers, 2))
        self._given = np.zeros((receivers, len(setup.attack.action_names(setup.world))))
        self._rows = np.arange(receivers)
        self.actor = Actor((FullCommand(),) if action is None else action, setup)
        self.actor.aim(self.heading_rad)
        self.books = Books(receivers, setup.steps, setup.hold)
        self.listeners: list[Listener] = []
        self._watch = WatchBooks(self.watch.names, receivers) if self.watch is not None else None
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
    def begin_names(self) -> tuple[str, ...]:
        """Keys of `begin_info`."""
        return BEGIN_NAMES if self._watch is None else (*BEGIN_NAMES, *self._watch.begin_names)

    @property
    def info_names(self) -> tuple[str, ...]:
        """Keys of the information of a step."""
        rewards = [key for key, _ in self._reward_parts]
        watched = () if self._watch is None else self._watch.step_names
        return (*STEP_NAMES, *rewards, *self._ends.info_names, *watched)

    @property
    def step_count(self) -> NDArray[np.int64]:
        """(B,) commands given in the running episodes."""
        return self.books.step_count

    def set_rewards(self, terms: Sequence[RewardTerm]) -> None:
        """Reward by these terms from the next step on.

        Parameters
        ----------
        terms : sequence of RewardTerm
            Terms of the reward, each with a name of its own.
        """
        self._reward_parts = named_terms(terms)

    def altered(self, setup: Setup | None = None, **changes: Any) -> Game:
        """A new game, not begun yet, with some settings changed.

        Parameters
        ----------
        setup : Setup, optional
            Another one.
        **changes
            Arguments of this class by name.

        Returns
        -------
        Game
            Of as many receivers, without listeners.
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
        """The game as it stands.

        Returns
        -------
        Snapshot
            Views, valid until the next step.
        """
        return Snapshot(self.setup, self.engine.batch, self.step_count, self.engine.twin)

    def observe(self) -> NDArray[np.float32]:
        """Observe all receivers.

        Returns
        -------
        ndarray
            (B, o) a new array.
        """
        return self.observer.observe(self.snapshot())

    def reset(
        self,
        rngs: Sequence[np.random.Generator],
        rows: NDArray[np.intp] | None = None,
        given: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin new episodes, and run their warm-up up to the onset.

        Parameters
        ----------
        rngs : sequence of Generator
            One per row.
        rows : ndarray, optional
            Which receivers; all by default.
        given : mapping, optional
            As in `Engine.reset`.
        """
        where = self._rows if rows is None else rows
        self.engine.reset(rngs, rows, given)
        self.books.reset(where)
        self._given[where] = 0.0
        self.actor.aim(self.heading_rad)
        if self.engine.twin is None:
            error_n = position_error_n(self.setup, self.engine.batch)
            self._origin[where] = error_n[where, :2]
        if self._watch is not None:
            self._watch.reset(where, self.engine)

    def displacement(self) -> FloatArray:
        """Displacement that counts, of this epoch, (B,) [m]."""
        batch, twin, world = self.engine.batch, self.engine.twin, self.setup.world
        displacement = np.empty(self.receivers)
        displace(
            batch.buffers.state.position_e,
            world.position_e if twin is None else twin.buffers.state.position_e,
            batch.epochs if twin is None else self._rows,
            world.C_en,
            batch.onset,
            batch.heading,
            self.setup.target_heading_deg == "worst",
            self._origin,
            displacement,
        )
        return displacement

    def _play(self, command: FloatArray) -> Played:
        """One epoch."""
        verdict = self.engine.step(command)
        if self.engine.twin is not None:
            self.engine.step_twin()
        displacement = self.displacement()
        early, truncated, ends = self._judge_ends(displacement, verdict)
        truncated &= ~self.books.ended
        score = self.books.score(displacement, verdict.alarm, self.engine.hold, early)
        terminated = self.books.over(score.finished, self.end_at_alarm)
        truncated &= ~terminated
        self.books.ended |= terminated | truncated
        return Played(displacement, score, terminated, truncated, ends)

    def _decide(self, command: FloatArray) -> Played:
        """All epochs of one decision."""
        played = self._play(self.setup.command(self._given, command, 0))
        for epoch in range(1, self.setup.repeat):
            played = played.then(self._play(self.setup.command(self._given, command, epoch)))
        self._given[:] = command
        return played

    def step(self, action: FloatArray) -> Turn:
        """One decision of all receivers, and the epochs until the next.

        Parameters
        ----------
        action : ndarray
            (B, k) float64, C-contiguous, in [-1, 1].

        Returns
        -------
        Turn
            Rewards, ends and information.
        """
        if self._watch is not None:
            self._watch.forget(self.engine)
        played = self._decide(self.actor.command(action))
        score = played.score
        engine, world, batch = self.engine, self.setup.world, self.engine.batch
        info: dict[str, NDArray[Any]] = {
            "time_s": world.epoch_time[batch.epochs],
            "alarm": score.alarm,
            "detected": self.books.detected.copy(),
            "warmup_alarm": engine.warmup_alarm.copy(),
            "coasting": batch.buffers.measured.coasting.copy(),
            "displacement_m": played.displacement,
            "undetected_displacement_m": self.books.credited.copy(),
            "cost": score.first.astype(np.float64),
        }
        outcome = Outcome(
            score.gain,
            score.retraction,
            score.first,
            score.alarm,
            action,
            self.books.credited,
            played.terminated | played.truncated,
        )
        reward = reward_of(self._reward_parts, outcome, info)
        info.update(played.ends)
        if self._watch is not None:
            info.update(self._watch.step_info(engine))
        return Turn(reward, played.terminated, played.truncated, info)

    def _judge_ends(
        self, displacement: FloatArray, verdict: Verdict
    ) -> tuple[NDArray[np.bool_] | None, NDArray[np.bool_], dict[str, NDArray[Any]]]:
        """Ends before that of the window, and what is told of them; tell the listeners, too."""
        nobody = np.zeros(self.receivers, dtype=np.bool_)
        if not (self._ends or self.listeners):
            return None, nobody, {}
        standing = Standing(self.snapshot()._replace(step=self.step_count + 1), displacement)
        for listener in self.listeners:
            listener(self, standing, verdict)
        if not self._ends:
            return None, nobody, {}
        ends: dict[str, NDArray[Any]] = {}
        early, truncated = self._ends.judge(standing, ends)
        return early, truncated, ends

    def begin_info(self) -> dict[str, NDArray[Any]]:
        """Information at the begin of an episode.

        Returns
        -------
        dict
            Arrays with a leading axis of receivers.
        """
        engine = self.engine
        watched = {} if self._watch is None else self._watch.begin_info()
        return {
            "time_s": self.setup.world.epoch_time[engine.batch.epochs],
            "warmup_alarm": engine.warmup_alarm.copy(),
            "coasting": engine.batch.buffers.measured.coasting.copy(),
            **watched,
        }
