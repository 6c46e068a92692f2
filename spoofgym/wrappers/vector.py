"""Twins of the wrappers for vector environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..envs.factory import composable
from ..envs.options import Array, read_fresh
from ..envs.wrappers import vector as twins
from .alarms import AlarmLog

DetectorWrapper = twins.DetectorWrapper
EpochInfo = twins.EpochInfo
PassiveDetector = twins.PassiveDetector
RecordEpochs = twins.RecordEpochs
ResidualAction = twins.ResidualAction
StealthBudget = twins.StealthBudget
WatchWrapper = twins.WatchWrapper


class AlarmRecorder(twins.Wrapper):
    """As `wrappers.AlarmRecorder`, of all receivers; not with ``same_step`` autoreset."""

    def __init__(self, env: twins.Envs) -> None:
        super().__init__(env)
        twins.require_separate_resets(composable(env, unset=False), AlarmRecorder)
        self.alarms = AlarmLog(env)
        self._over = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        fresh = read_fresh(options, self.num_envs)
        observation, info = super().reset(seed=seed, options=options)  # type: ignore[arg-type]
        for row in np.flatnonzero(fresh).tolist():
            self.alarms.start(row, select_row(info, row))
        self._over &= ~fresh
        return observation, info

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        result = super().step(actions)
        over = result[2] | result[3]
        for row in range(self.num_envs):
            now = select_row(result[4], row)
            if self._over[row]:
                self.alarms.start(row, now)
            else:
                self.alarms.add(row, actions[row], now, bool(over[row]))
        self._over = over
        return result


def select_row(info: dict[str, Any], row: int) -> dict[str, Any]:
    """Information of one receiver, of that of all."""
    return {
        name: array[row]
        for name, array in info.items()
        if not name.startswith("_") and info.get(f"_{name}", [False] * (row + 1))[row]
    }
