"""Epochs of the receivers of a vector environment, as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from ..envs.recorder import EpochRecorder
from .vec_env import SpoofVecEnv

Array = NDArray[Any]


class RecordEpochs(VecEnvWrapper):
    """Writes every epoch of the commands into Parquet files, one an episode of a receiver.

    The twin of `spoofgym.envs.wrappers.RecordEpochs`, for stable-baselines3.

    Parameters
    ----------
    venv : VecEnv
        A `SpoofVecEnv`, in other wrappers or not.
    folder : str or Path
        Where the files go.

    Raises
    ------
    TypeError
        When there is no `SpoofVecEnv` inside.
    """

    def __init__(self, venv: VecEnv, folder: str | Path) -> None:
        super().__init__(venv)
        inner: Any = venv
        while isinstance(inner, VecEnvWrapper):
            inner = inner.venv
        if not isinstance(inner, SpoofVecEnv):
            raise TypeError(f"this wrapper needs a SpoofVecEnv, wrapped or not, got {inner!r}")
        if inner.side == "detector":
            raise TypeError(
                "the epochs of a duel are not recorded: this SpoofVecEnv has the side 'detector'"
            )
        self.recorder = EpochRecorder(folder, self.num_envs)
        inner.core.listeners.append(self.recorder)

    def reset(self) -> Any:
        """Start episodes; those that are not over are written as they are.

        Returns
        -------
        ndarray
            (B, o) of the environment.
        """
        self.recorder.finish(np.arange(self.num_envs), complete=False)
        return self.venv.reset()

    def step_wait(self) -> tuple[Any, Array, Array, list[dict[str, Any]]]:
        """Run one step, and write the episodes that it has ended.

        Returns
        -------
        observations, rewards, dones, infos
            Of the environment.
        """
        result: tuple[Any, Array, Array, list[dict[str, Any]]] = self.venv.step_wait()
        if result[2].any():
            self.recorder.finish(np.flatnonzero(result[2]), complete=True)
        return result

    def close(self) -> None:
        """Write episodes that are not over, and close the environment."""
        self.recorder.finish(np.arange(self.num_envs), complete=False)
        super().close()
