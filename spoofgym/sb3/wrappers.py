"""Twins of `spoofgym.wrappers` for stable-baselines3."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from ..detectors.build import DetectorSpec
from ..wrappers.alarms import AlarmLog
from ..wrappers.outside import OutsideDetector
from .vec_env import SpoofVecEnv, select_receiver_info

RECORDED = frozenset({"time_s", "displacement_m", "alarm"})


class PassiveDetector(VecEnvWrapper):
    """A detector outside of the loop, as `spoofgym.wrappers.PassiveDetector` is.

    Parameters
    ----------
    venv : SpoofVecEnv
        Of the spoofer's side without a pool, not reset yet; wrappers go around this one.
    detector, false_alarms_per_hour, end
        As there.
    """

    def __init__(
        self,
        venv: SpoofVecEnv,
        detector: DetectorSpec,
        *,
        false_alarms_per_hour: float | None = None,
        end: bool = True,
    ) -> None:
        if not isinstance(venv, SpoofVecEnv):
            raise TypeError(f"`venv` must be a SpoofVecEnv, not wrapped yet, got {venv!r}")
        self.judge, self.end = OutsideDetector(venv, detector, false_alarms_per_hour), end
        self.inner = venv
        super().__init__(venv)

    def reset(self) -> Any:
        """Start a new episode in every receiver, and judge its monitored start."""
        observations = self.inner.reset()
        self._start(np.ones(self.num_envs, dtype=np.bool_))
        return observations

    def step_wait(self) -> Any:
        """Run one step, and judge its epochs; an alarm ends the episode."""
        observations, reward, over, infos = self.inner.step_wait()
        found = self.judge.judge(self.inner.result.info, np.zeros_like(over))
        alarm = found["alarm"] & ~over & self.end
        if alarm.any():
            observations = self.inner.end_episodes(alarm, observations, infos)
            over = over | alarm
        for row, info in enumerate(infos):
            info |= select_receiver_info(found, row)
        if over.any():
            self._start(over)
        return observations, reward, over, infos

    def _start(self, fresh: Any) -> None:
        found = self.judge.judge(self.inner.starts, fresh)
        for row in np.flatnonzero(fresh).tolist():
            self.reset_infos[row] = {
                **self.inner.reset_infos[row],
                **select_receiver_info(found, row),
            }


class AlarmRecorder(VecEnvWrapper):
    """Records alarms over episodes, as `spoofgym.wrappers.AlarmRecorder` does.

    Parameters
    ----------
    venv : VecEnv
        A `SpoofVecEnv` with ``infos="all"``, wrapped or not.
    """

    def __init__(self, venv: VecEnv) -> None:
        self.alarms = AlarmLog(venv)
        keys = getattr(venv.unwrapped, "_keys", None)
        if keys is not None and not keys >= RECORDED:
            raise ValueError(f"`infos` of the SpoofVecEnv must have {', '.join(sorted(RECORDED))}")
        super().__init__(venv)

    def reset(self) -> Any:
        """Start a new episode in every receiver; those that are not over are left out."""
        observations = self.venv.reset()
        self._start(range(self.num_envs))
        return observations

    def step_async(self, actions: Any) -> None:
        """Take the commands of the next step."""
        self._actions = np.array(actions)
        self.venv.step_async(actions)

    def step_wait(self) -> Any:
        """Run one step, and record what comes of it."""
        result = self.venv.step_wait()
        for row, (over, info) in enumerate(zip(*result[2:], strict=True)):
            self.alarms.add(row, self._actions[row], info, bool(over))
        self._start(np.flatnonzero(result[2]).tolist())
        return result

    def _start(self, rows: Any) -> None:
        below: Any = self.venv
        while not any(below.reset_infos):  # not every wrapper hands them on
            below = below.venv
        for row in rows:
            self.alarms.start(row, below.reset_infos[row])
