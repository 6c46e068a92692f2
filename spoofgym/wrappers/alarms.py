"""Alarms over episodes: false alarms, missed attacks, delay and undetected displacement.

An episode whose actions are all zero is clean, and any alarm in it is false, as is one in the
monitored start of any episode.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..bench.scores.statistics import (
    Estimate,
    bootstrap_mean,
    clopper_pearson,
    draw_resamples,
    interval,
    wilson,
)
from ..detectors.calibration_file import hourly_rate
from ..envs.factory import composable
from .single import SingleWrapper

Observation = NDArray[np.float32]


class AlarmSummary(NamedTuple):
    """What an `AlarmRecorder` has found; all but the counts with 95 % intervals (of false alarms
    exact ones, of `missed` Wilson's).

    Attributes
    ----------
    clean, attacked : int
        Episodes that are over.
    false_alarm : Estimate
        Share of all episodes that have an alarm before the first command, or an alarm and no
        command.
    false_alarms_per_hour : Estimate
        The rate of such alarms in the time without attack, monitored starts included [1/h].
    missed : Estimate
        Of the attacked episodes that have no false alarm, the share without an alarm.
    delay_s : Estimate
        Mean time from the first command that is not zero to the alarm, where there is one [s].
    undetected_displacement_m : Estimate
        Mean over the attacked episodes that have no false alarm [m].
    """

    clean: int
    attacked: int
    false_alarm: Estimate
    false_alarms_per_hour: Estimate
    missed: Estimate
    delay_s: Estimate
    undetected_displacement_m: Estimate

    def __str__(self) -> str:
        hourly, missed, delay, moved = (interval(each.as_json()) for each in self[3:])
        return (
            f"{self.clean} clean and {self.attacked} attacked episodes: {hourly} false alarms an "
            f"hour, {missed} of the attacks missed, delay {delay} s, undetected displacement "
            f"{moved} m"
        )


class AlarmLog:
    """Alarms of the running and the past episodes of B receivers of an environment."""

    def __init__(self, env: Any) -> None:
        core = composable(env, unset=False).core
        engine = getattr(core, "engine", None)
        if engine is not None and engine.warm_pool is not None:
            raise ValueError(
                f"episodes that share {engine.warm_pool} pasts are not independent, which the "
                "intervals assume: make the environment with warm_pool=0"
            )
        setup, self._past = core.setup, list[tuple[float, ...]]()
        self._repeat, self._hold = setup.repeat, setup.hold
        self._interval_s, self._start_s = setup.interval_s, setup.live * setup.interval_s
        self._begun = [(0.0, False)] * core.receivers
        self._moved: list[list[float]] = [[] for _ in self._begun]
        self._onset = [math.nan] * core.receivers
        self._alarm = [math.nan] * core.receivers

    def start(self, row: int, info: dict[str, Any]) -> None:
        """Begin an episode, by the information of a reset."""
        early = ("alarm" in info and _read_alarm(info)) or bool(info["warmup_alarm"])
        self._begun[row] = float(info["time_s"]), early
        self._moved[row], self._onset[row], self._alarm[row] = [], math.nan, math.nan

    def add(self, row: int, action: ArrayLike, info: dict[str, Any], over: bool) -> None:
        """Add a step; `info` has ``time_s``, ``displacement_m`` and ``alarm``."""
        moved = self._moved[row]
        if math.isnan(self._onset[row]) and np.any(np.asarray(action) != 0.0):
            self._onset[row] = self._begun[row][0] + len(moved) * self._repeat * self._interval_s
        moved.append(float(info["displacement_m"]))
        if _read_alarm(info) and math.isnan(self._alarm[row]):
            time_s = float(info.get("alarm_time_s", math.nan))
            self._alarm[row] = float(info["time_s"]) if math.isnan(time_s) else time_s
        if over:
            self._finish(row, info)

    def _finish(self, row: int, info: dict[str, Any]) -> None:
        time_s, early = self._begun[row]
        onset, alarm = self._onset[row], self._alarm[row]
        attacked, alarmed = not math.isnan(onset), not math.isnan(alarm)
        if info.get("detected", False):  # the environment knows the epoch of its own detector
            undetected = float(info["undetected_displacement_m"])
        else:
            counted = self._moved[row]
            if alarmed:
                epochs = round((alarm - time_s) / self._interval_s) - self._hold
                counted = counted[: max(math.ceil(epochs / self._repeat) - 1, 0)]
            undetected = max(counted, default=0.0)
        clean_s = self._start_s + (0.0 if attacked else float(info["time_s"]) - time_s)
        false = early or (alarmed and not attacked)
        self._past.append((attacked, false, alarm - onset, max(undetected, 0.0), clean_s))

    def summarize(self) -> AlarmSummary:
        """Rates and means over all episodes that are over."""
        past = np.array(self._past, dtype=np.float64).reshape(-1, 5)
        attacked, false = past[:, 0] > 0.0, past[:, 1] > 0.0
        valid = past[attacked & ~false]
        delays = valid[~np.isnan(valid[:, 2]), 2]
        rate = clopper_pearson(int(false.sum()), len(past))
        mean_s = past[:, 4].mean() if len(past) else 0.0
        hourly = [hourly_rate(p, mean_s) if mean_s else math.nan for p in rate]
        return AlarmSummary(
            clean=int((~attacked).sum()),
            attacked=int(attacked.sum()),
            false_alarm=rate,
            false_alarms_per_hour=Estimate(*hourly),
            missed=wilson(len(valid) - len(delays), len(valid)),
            delay_s=bootstrap_mean(delays, draw_resamples(np.arange(len(delays)))),
            undetected_displacement_m=bootstrap_mean(
                valid[:, 3], draw_resamples(np.arange(len(valid)))
            ),
        )


def _read_alarm(info: dict[str, Any]) -> bool:
    alarm = info.get("alarm")
    if not isinstance(alarm, bool | np.bool_):
        found = repr(alarm) if "alarm" in info else "none"
        raise ValueError(f"info['alarm'] must be boolean, True at an alarm; got {found}")
    return bool(alarm)


class AlarmRecorder(SingleWrapper):
    """Records the alarms of whatever detector there is below, over episodes.

    It reads ``alarm``, ``time_s`` and ``displacement_m`` in the information, and the actions.
    Where a decision lasts several epochs the displacement counts as of its last one.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not.

    Attributes
    ----------
    alarms : AlarmLog
        The episodes; ``summarize()`` gives an `AlarmSummary`.
    """

    def __init__(self, env: gym.Env[Observation, Observation]) -> None:
        super().__init__(env)
        self.alarms = AlarmLog(env)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; one that is not over is left out."""
        observation, info = super().reset(seed=seed, options=options)
        self.alarms.start(0, info)
        return observation, info

    def step(self, action: Observation) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        """Give one command, and record what comes of it."""
        result = super().step(action)
        self.alarms.add(0, action, result[4], result[2] or result[3])
        return result
