"""Wrappers of the vector environment, around what `gymnasium.make_vec` returns.

It takes no ``wrappers=`` where an environment has a vector form of its own.  Arguments are those of
those of the same names in `wrappers`; `RecordEpochs` writes a file an episode of a receiver.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import VectorEnv, VectorWrapper

from ...detectors.build import DetectorSpec
from ..core import WatchSpec
from ..factory import composable, compose
from ..options import Array, read_mask
from ..terms.termination import AtStealthBudget
from . import EpochRecorder

Envs = VectorEnv[Array, Array, Array]
if TYPE_CHECKING:
    Wrapper = VectorWrapper[Array, Array, Array]
else:
    Wrapper = VectorWrapper  # not generic before Gymnasium 1.4


class DetectorWrapper(Wrapper):
    """As `wrappers.DetectorWrapper`, of all receivers."""

    def __init__(
        self, env: Envs, detector: DetectorSpec, *, false_alarms_per_hour: float | None = None
    ) -> None:
        super().__init__(env)
        compose(env, detector=detector, false_alarms_per_hour=false_alarms_per_hour)


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

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        mask = read_mask(options, self.num_envs)
        rows = np.arange(self.num_envs) if mask is None else np.flatnonzero(mask)
        self.recorder.finish(rows, complete=False)
        return super().reset(seed=seed, options=options)  # type: ignore[arg-type]

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, dict[str, Any]]:
        result = super().step(actions)
        over = result[2] | result[3]
        if over.any():
            self.recorder.finish(np.flatnonzero(over), complete=True)
        return result

    def close(self, **kwargs: Any) -> None:
        self.recorder.finish(np.arange(self.num_envs), complete=False)
        super().close(**kwargs)
