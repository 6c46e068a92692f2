"""The game: episodes of B receivers, with observations, rewards and ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ._kernels import displace
from .books import Books, Score, joined
from .engine import Engine
from .observations import ObservationTerm, Observer
from .played import Turn, check_end_at_alarm
from .rewards import RewardTerm, named_terms, reward_of
from .setup import Setup
from .snapshot import Snapshot, position_error_n

FloatArray = NDArray[np.float64]


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
    begin_names : tuple of str
        Keys of `begin_info`.
    """

    begin_names: ClassVar[tuple[str, ...]] = ("time_s", "warmup_alarm", "coasting")

    def __init__(
        self,
        receivers: int,
        setup: Setup,
        *,
        observation: Sequence[ObservationTerm],
        reward: Sequence[RewardTerm],
        end_at_alarm: bool = True,
        threads: int | None = None,
        prefetch: bool = False,
        twin: bool = False,
    ) -> None:
        check_end_at_alarm(end_at_alarm)
        self.set_rewards(reward)
        self.setup, self.end_at_alarm = setup, end_at_alarm
        self.engine = Engine(receivers, setup, threads=threads, prefetch=prefetch, twin=twin)
        self.observer = Observer(observation, setup)
        self._origin = np.zeros((receivers, 2))
        self._given = np.zeros((receivers, len(self.action_names)))
        self._rows = np.arange(receivers)
        self.books = Books(receivers, setup.steps, setup.hold)

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
    def target_heading_deg(self) -> float | str:
        """Direction in which displacement counts, as it was given."""
        return self.setup.target_heading_deg

    @property
    def action_names(self) -> tuple[str, ...]:
        """Name of every element of an action."""
        return self.setup.attack.action_names(self.setup.world)

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
        if self.engine.twin is None:
            error_n = position_error_n(self.setup, self.engine.batch)
            self._origin[where] = error_n[where, :2]

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

    def _play(self, command: FloatArray) -> tuple[FloatArray, Score]:
        """One epoch: displacement, and what it counts."""
        verdict = self.engine.step(command)
        if self.engine.twin is not None:
            self.engine.step_twin()
        displacement = self.displacement()
        return displacement, self.books.score(displacement, verdict.alarm, self.engine.hold)

    def _decide(self, action: FloatArray) -> tuple[FloatArray, Score]:
        """One decision: the last displacement, and what all its epochs count."""
        displacement, score = self._play(self.setup.command(self._given, action, 0))
        for epoch in range(1, self.setup.repeat):
            displacement, later = self._play(self.setup.command(self._given, action, epoch))
            score = joined(score, later)
        self._given[:] = action
        return displacement, score

    def step(self, action: FloatArray) -> Turn:
        """One decision of all receivers, and the epochs until the next.

        Parameters
        ----------
        action : ndarray
            (B, a) float64, C-contiguous, in [-1, 1].

        Returns
        -------
        Turn
            Rewards, ends and information.
        """
        displacement, score = self._decide(action)
        engine, world, batch = self.engine, self.setup.world, self.engine.batch
        info: dict[str, NDArray[Any]] = {
            "time_s": world.epoch_time[batch.epochs],
            "alarm": score.alarm,
            "detected": self.books.detected.copy(),
            "warmup_alarm": engine.warmup_alarm.copy(),
            "coasting": batch.buffers.measured.coasting.copy(),
            "displacement_m": displacement,
            "undetected_displacement_m": self.books.credited.copy(),
            "cost": score.outcome.detected.astype(np.float64),
        }
        reward = reward_of(self._reward_parts, score.outcome, info)
        return Turn(reward, self.books.over(score.finished, self.end_at_alarm), info)

    def begin_info(self) -> dict[str, NDArray[Any]]:
        """Information at the begin of an episode.

        Returns
        -------
        dict
            Arrays with a leading axis of receivers.
        """
        engine = self.engine
        return {
            "time_s": self.setup.world.epoch_time[engine.batch.epochs],
            "warmup_alarm": engine.warmup_alarm.copy(),
            "coasting": engine.batch.buffers.measured.coasting.copy(),
        }
