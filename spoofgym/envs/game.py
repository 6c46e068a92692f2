"""The game: episodes of B receivers, with observations, rewards and ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._kernels import score
from .engine import Engine
from .observations import ObservationTerm, Observer
from .rewards import Outcome, RewardTerm
from .setup import Setup
from .snapshot import Snapshot

FloatArray = NDArray[np.float64]


class Turn(NamedTuple):
    """What a step returns.

    Attributes
    ----------
    reward : ndarray
        (B,) float64.
    terminated : ndarray
        (B,) bool.
    info : dict
        Arrays with a leading axis of receivers.
    """

    reward: FloatArray
    terminated: NDArray[np.bool_]
    info: dict[str, NDArray[Any]]


class Game:
    r"""Episodes of B receivers under attack.

    The displacement of a step is the position error of the victim along the target direction, less
    what it was at the onset; with :math:`M_j` its largest value in steps 0 to j, the undetected
    displacement of an episode without an alarm is :math:`M_N`, and that of an episode with its
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
    target_heading_deg : float
        Direction in which displacement counts, clockwise from north.
    threads : int, optional
        As in `Engine`.
    prefetch : bool
        As in `Engine`.

    Attributes
    ----------
    engine : Engine
        The receivers.
    step_count : ndarray
        (B,) commands given in the running episodes.
    detected : ndarray
        (B,) bool, whether the attack has raised an alarm.
    target_heading_deg : float
        As it was given.
    """

    def __init__(
        self,
        receivers: int,
        setup: Setup,
        *,
        observation: Sequence[ObservationTerm],
        reward: Sequence[RewardTerm],
        end_at_alarm: bool = True,
        target_heading_deg: float = 90.0,
        threads: int | None = None,
        prefetch: bool = False,
    ) -> None:
        if not np.isfinite(target_heading_deg):
            raise ValueError(f"`target_heading_deg` must be finite, got {target_heading_deg}")
        self.set_rewards(reward)
        self.setup, self.end_at_alarm = setup, end_at_alarm
        self.engine = Engine(receivers, setup, threads=threads, prefetch=prefetch)
        self.observer = Observer(observation, setup)
        self.target_heading_deg = target_heading_deg
        heading = np.radians(target_heading_deg)
        self._target_e = setup.onset_C_en @ np.array([np.cos(heading), np.sin(heading), 0.0])
        self._rows = np.arange(receivers)
        self.step_count = np.zeros(receivers, dtype=np.int64)
        self.detected = np.zeros(receivers, dtype=np.bool_)
        self._origin = np.zeros(receivers)
        self._largest = np.zeros((receivers, setup.steps + 1))
        self.credited = np.zeros(receivers)

    @property
    def receivers(self) -> int:
        """B."""
        return self.engine.receivers

    def set_rewards(self, terms: Sequence[RewardTerm]) -> None:
        """Reward by these terms from the next step on.

        Parameters
        ----------
        terms : sequence of RewardTerm
            Terms of the reward, each with a name of its own.
        """
        names = [term.name for term in terms]
        if len(set(names)) < len(names):
            raise ValueError(f"two reward terms have the same name, got {', '.join(names)}")
        self._reward_parts = [(f"reward_{term.name}", term) for term in terms]

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
        return Snapshot(self.setup, self.engine.batch, self.step_count)

    def observe(self) -> NDArray[np.float32]:
        """Observe all receivers.

        Returns
        -------
        ndarray
            (B, o) a new array.
        """
        return self.observer.observe(self.snapshot())

    def reset(
        self, rngs: Sequence[np.random.Generator], rows: NDArray[np.intp] | None = None
    ) -> None:
        """Begin new episodes, and run their warm-up up to the onset.

        Parameters
        ----------
        rngs : sequence of Generator
            One per row.
        rows : ndarray, optional
            Which receivers; all by default.
        """
        where = self._rows if rows is None else rows
        self.engine.reset(rngs, rows)
        self.step_count[where] = 0
        self.detected[where] = False
        self._largest[where] = 0.0
        self.credited[where] = 0.0
        self._origin[where] = self._projection()[where]

    def _projection(self) -> FloatArray:
        batch = self.engine.batch
        error_e = batch.buffers.state.position_e - self.setup.world.position_e[batch.epochs]
        result: FloatArray = (error_e * self._target_e).sum(axis=1)
        return result

    def _hold(
        self,
        rows: NDArray[np.intp],
        retraction: FloatArray,
        first: NDArray[np.bool_],
        alarm: NDArray[np.bool_],
    ) -> None:
        """Run the time to alert after the last command, and write what its alarms do."""
        if not len(rows):
            return
        late = self.engine.hold(rows)
        alarmed = late.any(axis=0)
        # index of the last epoch that counts, with the first alarm at steps + 1 + argmax
        kept = np.maximum(self.setup.steps + late.argmax(axis=0) - self.setup.hold, 0)
        before = self._largest[rows, self.setup.steps]
        retraction[rows] = np.where(alarmed, self._largest[rows, kept] - before, 0.0)
        first[rows] = alarmed
        alarm[rows] |= alarmed

    def step(self, action: FloatArray) -> Turn:
        """One command of all receivers, and one epoch.

        Parameters
        ----------
        action : ndarray
            (B, a) float64, C-contiguous, in [-1, 1].

        Returns
        -------
        Turn
            Rewards, ends and information.
        """
        verdict = self.engine.step(action)
        engine, setup, batch = self.engine, self.setup, self.engine.batch
        displacement, gain, retraction = np.empty((3, self.receivers))
        alarm, first, finished = np.empty((3, self.receivers), dtype=np.bool_)
        score(
            batch.buffers.state.position_e,
            setup.world.position_e,
            batch.epochs,
            self._target_e,
            np.ascontiguousarray(verdict.alarm),
            setup.steps,
            setup.hold,
            self.step_count,
            self.detected,
            self._origin,
            self._largest,
            displacement,
            gain,
            retraction,
            alarm,
            first,
            finished,
        )
        if finished.any() and setup.hold:
            self._hold(
                np.flatnonzero(finished & ~(self.detected | first)), retraction, first, alarm
            )
        np.logical_or(self.detected, first, out=self.detected)
        self.credited += gain
        self.credited += retraction

        outcome = Outcome(gain, retraction, first)
        info: dict[str, NDArray[Any]] = {
            "time_s": setup.world.epoch_time[batch.epochs],
            "alarm": alarm,
            "detected": self.detected.copy(),
            "warmup_alarm": engine.warmup_alarm.copy(),
            "coasting": batch.buffers.measured.coasting.copy(),
            "displacement_m": displacement,
            "undetected_displacement_m": self.credited.copy(),
        }
        reward = np.zeros(self.receivers)
        for key, term in self._reward_parts:
            info[key] = term(outcome)
            reward += info[key]
        terminated = finished | self.detected if self.end_at_alarm else finished
        return Turn(reward, terminated, info)

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
