"""Wrappers of the single environment; `vector` has their twins of the same names.

All but `RecordEpochs` only set something in the engine before the first episode: nothing outside
could sit between the halves of an epoch.  So each is the same as an argument of the environment.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from ...detectors import Detector
from ..core import WatchSpec
from ..factory import composable, compose
from ..recorder import EpochRecorder
from ..terms.termination import AtStealthBudget

Observation = NDArray[np.float32]
Env = gym.Env[Observation, Observation]
_Base = gym.Wrapper[Observation, Observation, Observation, Observation]
FIRST = np.zeros(1, dtype=np.intp)
__all__ = ["DetectorWrapper", "RecordEpochs", "StealthBudget", "WatchWrapper"]


class DetectorWrapper(_Base, RecordConstructorArgs):
    """Sets the detector in the loop, as the argument ``detector=`` does.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not, without a detector of its own, and not reset yet.
    detector : str, mapping or Detector
        As `make_detector` takes it.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> from spoofgym.envs.wrappers import DetectorWrapper
    >>> env = DetectorWrapper(gym.make("spoofgym/TightlyCoupled-v0"), "snapshot-chi2")
    >>> type(env.unwrapped.core.setup.detector).__name__
    'SnapshotChi2'
    >>> env.close()
    """

    def __init__(self, env: Env, detector: str | Mapping[str, Any] | Detector) -> None:
        RecordConstructorArgs.__init__(self, detector=detector)
        gym.Wrapper.__init__(self, env)
        compose(env, detector=detector)


class WatchWrapper(_Base, RecordConstructorArgs):
    """Adds passive detectors, as the argument ``watch=`` does.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not, and not reset yet.
    watch : sequence of str, mapping or Detector
        Each as `make_detector` takes it.  Their weights are not used.
    """

    def __init__(self, env: Env, watch: WatchSpec) -> None:
        RecordConstructorArgs.__init__(self, watch=watch)
        gym.Wrapper.__init__(self, env)
        compose(env, watch=watch)


class StealthBudget(_Base, RecordConstructorArgs):
    """Ends an episode where the attack has spent its divergence; the end term `AtStealthBudget`.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not, and not reset yet.
    budget_nats : float
        Largest divergence, by the belief of the victim's filter.
    """

    def __init__(self, env: Env, budget_nats: float) -> None:
        RecordConstructorArgs.__init__(self, budget_nats=budget_nats)
        gym.Wrapper.__init__(self, env)
        compose(env, end=AtStealthBudget(budget_nats))


class RecordEpochs(_Base, RecordConstructorArgs):
    """Writes every epoch of the commands into Parquet files, one an episode.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not.
    folder : str or Path
        Where the files go.
    """

    def __init__(self, env: Env, folder: str | Path) -> None:
        RecordConstructorArgs.__init__(self, folder=str(folder))
        gym.Wrapper.__init__(self, env)
        self.recorder = EpochRecorder(folder, 1)
        composable(env).core.listeners.append(self.recorder)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; one that is not over is written as it is."""
        self.recorder.finish(FIRST, complete=False)
        return super().reset(seed=seed, options=options)

    def step(self, action: Observation) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        """Give one command; write the episode when it is over."""
        result = super().step(action)
        if result[2] or result[3]:
            self.recorder.finish(FIRST, complete=True)
        return result

    def close(self) -> None:
        """Write an episode that is not over, and close the environment."""
        self.recorder.finish(FIRST, complete=False)
        super().close()
