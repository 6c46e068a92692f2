"""Wrappers of the vector environment, around what `gymnasium.make_vec` returns.

It takes no ``wrappers=`` where an environment has a vector form of its own.  Arguments are those of
the same names in `wrappers`; `RecordEpochs` writes a file an episode of a receiver.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

from ..detectors.build import DetectorSpec
from ..envs.core import EpochSpec, WatchSpec
from ..envs.factory import composable, compose
from ..envs.options import Array, read_mask
from ..envs.terms.termination import AtStealthBudget
from ..spoofers.build import SpooferSpec
from .alarms import AlarmLog
from .outside import OutsideDetector, warn_uncalibrated
from .single import EpochRecorder, name_twin

Envs = VectorEnv[Array, Array, Array]
if TYPE_CHECKING:
    _Base = VectorWrapper[Array, Array, Array]
else:
    _Base = VectorWrapper  # not generic before Gymnasium 1.4


class Wrapper(_Base):
    """A wrapper of a vector environment, which names its twin for any other."""

    def __init__(self, env: Envs) -> None:
        if not isinstance(env, VectorEnv):
            twin = name_twin(env, type(self))
            raise TypeError(f"`env` must be a vector environment of Gymnasium, got {env!r}{twin}")
        super().__init__(env)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        fresh = read_mask(options, self.num_envs)
        observation, info = super().reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._start(fresh, info)
        return observation, info

    def _start(self, fresh: Array, info: dict[str, Any]) -> None:
        """Take the information of receivers that have begun an episode, (B,) bool."""


def add_to_info(info: dict[str, Any], arrays: dict[str, Array]) -> None:
    """Add (B,) arrays to the information, of all receivers."""
    for name, array in arrays.items():
        info[name], info[f"_{name}"] = array, np.ones(len(array), dtype=np.bool_)


def require_separate_resets(inner: Any, wrapper: type) -> None:
    """Refuse an environment in which the last step of an episode and the next start are one."""
    if inner.autoreset_mode is AutoresetMode.SAME_STEP or inner.infos != "all":
        raise ValueError(
            f"{wrapper.__name__} needs infos='all' and an `autoreset_mode` 'next_step' or "
            f"'disabled', got {inner.infos!r} and {inner.autoreset_mode.name.lower()!r}"
        )


class DetectorWrapper(Wrapper):
    """As `wrappers.DetectorWrapper`, of all receivers."""

    def __init__(
        self, env: Envs, detector: DetectorSpec, *, false_alarms_per_hour: float | None = None
    ) -> None:
        super().__init__(env)
        compose(env, detector=detector, false_alarms_per_hour=false_alarms_per_hour)
        setup = composable(env).core.setup
        warn_uncalibrated(detector, setup.detector, false_alarms_per_hour, setup)


class EpochInfo(Wrapper):
    """As `wrappers.EpochInfo`, of all receivers: ``info["epochs"]`` (B,) has a tuple of each."""

    def __init__(self, env: Envs, epoch: EpochSpec = True) -> None:
        super().__init__(env)
        compose(env, epoch=epoch)


class PassiveDetector(Wrapper):
    """As `wrappers.PassiveDetector`, of all receivers. With ``same_step`` autoreset an alarm could
    not end an episode, which is refused."""

    def __init__(
        self,
        env: Envs,
        detector: DetectorSpec,
        *,
        false_alarms_per_hour: float | None = None,
        end: bool = True,
    ) -> None:
        super().__init__(env)
        self.judge, self.end = OutsideDetector(env, detector, false_alarms_per_hour), end
        require_separate_resets(composable(env), PassiveDetector)
        self._over = np.zeros(env.num_envs, dtype=np.bool_)

    def _start(self, fresh: Array, info: dict[str, Any]) -> None:
        self._over &= ~fresh
        add_to_info(info, self.judge.judge(info, fresh))

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        observation, reward, terminated, truncated, info = super().step(actions)
        fresh = self._over
        add_to_info(info, self.judge.judge(info, fresh))
        if self.end:
            alarm = info["alarm"] & ~fresh
            self.unwrapped.end_episodes(alarm)  # type: ignore[attr-defined]
            terminated = terminated | alarm
        self._over = terminated | truncated
        return observation, reward, terminated, truncated, info


class ResidualAction(Wrapper):
    """As `wrappers.ResidualAction`, of all receivers."""

    def __init__(self, env: Envs, spoofer: SpooferSpec, scale: float | None = None) -> None:
        super().__init__(env)
        compose(env, base=spoofer, scale=scale)


class WatchWrapper(Wrapper):
    """As `wrappers.WatchWrapper`, of all receivers."""

    def __init__(self, env: Envs, watch: WatchSpec) -> None:
        super().__init__(env)
        compose(env, watch=watch)


class StealthBudget(Wrapper):
    """As `wrappers.StealthBudget`, of all receivers."""

    def __init__(self, env: Envs, budget_nats: float) -> None:
        super().__init__(env)
        compose(env, end=AtStealthBudget(budget_nats))


class RecordEpochs(Wrapper):
    """As `wrappers.RecordEpochs`, of all receivers."""

    def __init__(self, env: Envs, folder: str | Path) -> None:
        super().__init__(env)
        self.recorder = EpochRecorder(folder, env.num_envs)
        composable(env).core.listeners.append(self.recorder)

    def _start(self, fresh: Array, info: dict[str, Any]) -> None:
        self.recorder.finish(np.flatnonzero(fresh), complete=False)

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        result = super().step(actions)
        over = result[2] | result[3]
        if over.any():
            self.recorder.finish(np.flatnonzero(over), complete=True)
        return result

    def close(self, **kwargs: Any) -> None:
        self.recorder.finish(np.arange(self.num_envs), complete=False)
        super().close(**kwargs)


class AlarmRecorder(Wrapper):
    """As `wrappers.AlarmRecorder`, of all receivers; not with ``same_step`` autoreset."""

    def __init__(self, env: Envs) -> None:
        super().__init__(env)
        require_separate_resets(composable(env, unset=False), AlarmRecorder)
        self.alarms = AlarmLog(env)
        self._over = np.zeros(env.num_envs, dtype=np.bool_)

    def _start(self, fresh: Array, info: dict[str, Any]) -> None:
        for row in np.flatnonzero(fresh).tolist():
            self.alarms.start(row, select_row(info, row))
        self._over &= ~fresh

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        result = super().step(actions)
        over = result[2] | result[3]
        if (on := np.flatnonzero(over & ~self.unwrapped.over)).size:  # type: ignore[attr-defined]
            raise ValueError(
                f"a wrapper ends the episodes of receivers {', '.join(map(str, on))}, which fly "
                "on: it has to call env.unwrapped.end_episodes(mask), (B,) bool, too"
            )
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
