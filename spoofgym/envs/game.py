"""The game: episodes of B receivers, with observations, rewards and ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .engine import Engine, Setup
from .observations import ObservationTerm, Observer
from .rewards import Outcome, RewardTerm
from .snapshot import Snapshot, position_error_n

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

    Attributes
    ----------
    engine : Engine
        The receivers.
    step_count : ndarray
        (B,) commands given in the running episodes.
    detected : ndarray
        (B,) bool, whether the attack has raised an alarm.
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
    ) -> None:
        if not np.isfinite(target_heading_deg):
            raise ValueError(f"`target_heading_deg` must be finite, got {target_heading_deg}")
        names = [term.name for term in reward]
        if len(set(names)) < len(names):
            raise ValueError(f"two reward terms have the same name, got {', '.join(names)}")
        self.setup, self.end_at_alarm = setup, end_at_alarm
        self.engine = Engine(receivers, setup, threads=threads)
        self.observer = Observer(observation, setup)
        self.reward_terms = tuple(reward)
        heading = np.radians(target_heading_deg)
        self._target = np.array([np.cos(heading), np.sin(heading), 0.0])
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
        error = position_error_n(self.setup, self.engine.batch)
        result: FloatArray = (error * self._target).sum(axis=1)
        return result

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
        alarm = verdict.alarm.any(axis=1)
        rows, engine, setup = self._rows, self.engine, self.setup
        # a receiver whose episode is over may be stepped once more before it is reset
        self.step_count += 1
        j = np.minimum(self.step_count, setup.steps)
        displacement = self._projection() - self._origin
        before = self._largest[rows, j - 1]
        largest = np.maximum(before, displacement)
        self._largest[rows, j] = largest

        first = alarm & ~self.detected
        gain = np.where(self.detected | first, 0.0, largest - before)
        kept = self._largest[rows, np.maximum(j - setup.hold - 1, 0)]
        retraction = np.where(first, kept - before, 0.0)

        finished = self.step_count == setup.steps
        holding = np.flatnonzero(finished & ~(self.detected | first))
        if len(holding) and setup.hold:
            late = self.engine.hold(holding)
            alarmed = late.any(axis=0)
            epoch = setup.steps + 1 + late.argmax(axis=0)
            kept_late = self._largest[holding, np.maximum(epoch - setup.hold - 1, 0)]
            retraction[holding] = np.where(alarmed, kept_late - largest[holding], 0.0)
            first[holding] = alarmed
            alarm[holding] |= alarmed
        self.detected |= first
        self.credited += gain + retraction

        outcome = Outcome(gain, retraction, first)
        info: dict[str, NDArray[Any]] = {
            "time_s": setup.world.epoch_time[engine.batch.epochs],
            "alarm": alarm,
            "detected": self.detected.copy(),
            "warmup_alarm": engine.warmup_alarm.copy(),
            "coasting": engine.batch.buffers.measured.coasting.copy(),
            "displacement_m": displacement,
            "undetected_displacement_m": self.credited.copy(),
        }
        reward = np.zeros(self.receivers)
        for term in self.reward_terms:
            part = term(outcome)
            info[f"reward_{term.name}"] = part
            reward = reward + part
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
