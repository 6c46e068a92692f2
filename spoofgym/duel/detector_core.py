"""The detector's side of the duel, for one learner against a pool of frozen spoofers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..envs.core import SingleStep
from ..envs.scoring import Info, PlainResult
from ..simulation.monitors import FloatArray, PastPositions
from .duel import make_duel
from .opponents import SpooferPool, SpooferSpec


class DetectorCore:
    """Episodes of B receivers, in which the learner is the detector. With ``decision_delay=0`` an
    observation is of the epoch that the next action judges; with 1 it is of the epoch before. A
    step is an epoch, however seldom the spoofers decide. `settings` are those of `make_duel`.
    `reset_names`, `info_names`: keys of `reset_info`, and of the information of a step."""

    reset_names: tuple[str, ...] = ("time_s", "decision_delay")
    info_names: tuple[str, ...] = (
        "time_s",
        "alarm",
        "statistic",
        "threshold",
        "decision_delay",
        "attacked",
        "undetected_displacement_m",
    )

    def __init__(
        self,
        receivers: int,
        pool: Sequence[SpooferSpec] | SpooferSpec,
        weights: Sequence[float] | None = None,
        *,
        threads: int | None = None,
        **settings: Any,
    ) -> None:
        given: dict[str, Any] = {"action": "full-command", **settings}
        # for spoofers of the pool that know what the victim reports
        duel = make_duel(receivers, threads=threads, monitors=[PastPositions()], **given)
        self.duel = duel
        self.change(pool, weights)
        observer, self.action_names = duel.agent.observer, duel.agent.action_names
        self.observation_names, self.bounds = observer.names, (observer.low, observer.high)
        self.receivers, self.episode_steps = duel.receivers, duel.epochs
        self._everyone = np.arange(duel.receivers)

    def change(
        self, pool: Sequence[SpooferSpec] | SpooferSpec, weights: Sequence[float] | None = None
    ) -> Self:
        """Take other opponents; the running episodes are over."""
        self.pool = SpooferPool(pool, weights, self.duel.setup, self.duel.receivers)
        return self

    def opponents(self) -> list[str]:
        return [self.pool.labels[k] for k in self.pool.opponent]

    def reset(
        self,
        rngs: Sequence[np.random.Generator],
        rows: NDArray[np.intp] | None = None,
        given: Mapping[str, Any] | None = None,
    ) -> None:
        """Start new episodes, up to the first epoch that is to be judged."""
        where = self._everyone if rows is None else rows
        self.duel.reset(rngs, rows, given)
        self.pool.begin(where, self.duel.core.engine.simulator.memory["key"][where])
        if self.duel.decision_delay == 0:
            self._arrive(where)

    def _arrive(self, rows: NDArray[np.intp]) -> None:
        due = rows[self.duel.deciding[rows]]
        action = self.pool.act(self.duel.snapshot(), due) if len(due) else None
        self.duel.arrive(action, rows)

    def step(self, action: FloatArray) -> tuple[PlainResult, NDArray[np.float32]]:
        """Judge one epoch of all receivers.  `action` (B, a) float64, in [-1, 1]."""
        if self.duel.decision_delay == 0:
            # the world may end one epoch after an episode
            playing = np.flatnonzero(~self.duel.over)
            done = self.duel.decide(action)
            if len(playing):
                self._arrive(playing)
        else:
            self._arrive(self._everyone)
            done = self.duel.decide(action)
        over, all_ = done.terminated, done.info
        info: Info = {
            "time_s": all_["time_s"],
            "alarm": all_["alarm"],
            "statistic": all_["statistic"],
            "threshold": all_["threshold"],
            "decision_delay": np.full(self.receivers, self.duel.decision_delay),
            "attacked": all_["attacked"] & over,
            "undetected_displacement_m": np.where(over, all_["undetected_displacement_m"], 0.0),
        }
        result = PlainResult(done.detector_reward, over, np.zeros_like(over), info)
        return result, self.observe()

    def single(self, action: FloatArray) -> SingleStep:
        result, observation = self.step(action)
        return observation[0], *result.single()

    def observe(self) -> NDArray[np.float32]:
        return self.duel.observe_detector()

    def reset_info(self) -> Info:
        delay = np.full(self.receivers, self.duel.decision_delay)
        return {"time_s": self.duel.time_s(), "decision_delay": delay}

    def close(self) -> None:
        self.duel.close()
