"""Wrappers of the single environment; `vector` has their twins of the same names.

`DetectorWrapper`, `WatchWrapper`, `StealthBudget` and `EpochInfo` only set something in the engine
before the first episode: nothing outside could sit between the halves of an epoch.  So each is the
same as an argument of the environment.  A detector that only looks may be outside:
`PassiveDetector`, or any wrapper around an `EpochInfo`.

A file of recorded epochs holds those of the commands: neither the warm-up, nor the time to alert
after the last one.  It is written as a whole when its episode is over, so that a run that is broken
off leaves whole files; a later run into the same folder counts on.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from ..core.files import check_pyarrow, remove_stale_parts, write_columns
from ..detectors import Verdict
from ..detectors.build import DetectorSpec
from ..envs.core import EpochSpec, SpoofCore, WatchSpec
from ..envs.factory import composable, compose
from ..envs.terms.termination import AtStealthBudget, EpochState
from ..spoofers.build import SpooferSpec
from .outside import OutsideDetector, warn_uncalibrated

Observation = NDArray[np.float32]
Env = gym.Env[Observation, Observation]
_Base = gym.Wrapper[Observation, Observation, Observation, Observation]
Array = NDArray[Any]
FIRST = np.zeros(1, dtype=np.intp)
PATTERN = re.compile(r"receiver-(\d+)-episode-(\d+)\.parquet")


class EpochRecorder:
    """Recorder of the receivers of a core, into a folder that it makes; a `Listener`."""

    def __init__(self, folder: str | Path, receivers: int) -> None:
        check_pyarrow()
        self.folder = Path(folder)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"`folder` {str(folder)!r} can't be made: {error}") from error
        if not os.access(self.folder, os.W_OK | os.X_OK):
            raise ValueError(f"nothing can be written into the `folder` {str(folder)!r}")
        remove_stale_parts(self.folder)
        self._episode = np.zeros(receivers, dtype=np.int64)
        for path in self.folder.glob("*.parquet"):
            found = PATTERN.fullmatch(path.name)
            if found is not None and int(found[1]) < receivers:
                row = int(found[1])
                self._episode[row] = max(self._episode[row], int(found[2]) + 1)
        self._rows: list[dict[str, list[Array]]] = [{} for _ in range(receivers)]
        self._satellites: tuple[str, ...] = ()
        self._pool: dict[str, int] = {}

    def __call__(self, core: SpoofCore, state: EpochState, verdict: Verdict) -> None:
        simulator = state.snapshot.simulator
        epoch = simulator.epoch
        self._satellites = getattr(core.setup.world, "satellite_ids", ())
        pool = core.engine.warm_pool
        self._pool = {} if pool is None else {"warm_pool": pool}
        columns: dict[str, Array] = {
            "time_s": epoch.time,
            "step": state.snapshot.step,
            "displacement_m": state.displacement,
            "alarm": np.logical_or.reduce(verdict.alarm, axis=1),
            "statistic": verdict.statistic,
            "threshold": verdict.threshold,
            "innovation": epoch.innovation,
            "innovation_variance": epoch.innovation_variance,
            "visible": epoch.visible,
            **simulator.get_record_columns(),
        }
        for row in np.flatnonzero(~core.score.ended):
            stored = self._rows[row]
            for name, array in columns.items():
                stored.setdefault(name, []).append(np.array(array[row]))

    def finish(self, rows: NDArray[np.intp], *, complete: bool) -> list[Path]:
        """Write the episodes of some receivers, of those that have an epoch; start new ones."""
        written = []
        for row in rows.tolist():
            if not self._rows[row]:
                continue
            name = f"receiver-{row:03d}-episode-{self._episode[row]:06d}.parquet"
            head = {
                "receiver": row,
                "episode": int(self._episode[row]),
                "complete": complete,
                "satellite_ids": list(self._satellites),
                **self._pool,
            }
            columns = {key: np.stack(values) for key, values in self._rows[row].items()}
            columns = {key: x for key, x in columns.items() if x.size}  # no satellites, no columns
            write_columns(self.folder / name, columns, {"spoofgym": json.dumps(head)})
            written.append(self.folder / name)
            self._rows[row] = {}
            self._episode[row] += 1
        return written


class SingleWrapper(_Base, RecordConstructorArgs):
    """Base of the wrappers of a single environment, whose other arguments a spec names."""

    def __init__(self, env: Env, **given: Any) -> None:
        RecordConstructorArgs.__init__(self, **given)
        if not isinstance(env, gym.Env):
            twin = name_twin(env, type(self))
            raise TypeError(f"`env` must be a single environment, got {env!r}{twin}")
        gym.Wrapper.__init__(self, env)


def name_twin(env: Any, wrapper: type) -> str:
    """Where the wrapper of the same name for another form of environment is, for messages."""
    forms = {"wrappers": gym.Env, "wrappers.vector": gym.vector.VectorEnv}
    found = [form for form, kind in forms.items() if isinstance(env, kind)]
    if hasattr(env, "step_async") and not found:
        found = ["sb3"]
    return f"; its twin for that is `spoofgym.{found[0]}.{wrapper.__name__}`" if found else ""


class DetectorWrapper(SingleWrapper):
    """Sets the detector in the loop, as ``gym.make(..., detector=...)`` does.

    It takes the place of the detector that the environment's id brings.  `wrappers.vector` has the
    same for vector environments, `spoofgym.sb3` for that of stable-baselines3.  A detector object
    has its own thresholds unless a rate is given, and gives an `UncalibratedWarning` then.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not, not reset yet.
    detector : str, mapping, Detector or type
        Name, or name and settings; a detector, or its class; ``"module:Class"``; or the path of an
        ``.onnx`` file with its card.  As in `make_detector`.
    false_alarms_per_hour : float, optional
        Rate of the calibration that gives the thresholds; by default 0.2, and for an object none.

    Raises
    ------
    ValueError
        When the detector can't judge this victim; when there is no calibration for this rate in
        this world, with the command that makes one; or when a detector other than
        ``"never"`` was set before, by an argument or another wrapper.
    RuntimeError
        When an episode has started.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> from spoofgym.wrappers import DetectorWrapper
    >>> env = DetectorWrapper(gym.make("spoofgym/Zhong2025-v0"), "snapshot-chi2")
    >>> type(env.unwrapped.core.setup.detector).__name__
    'SnapshotChi2'
    >>> env.close()
    """

    def __init__(
        self, env: Env, detector: DetectorSpec, *, false_alarms_per_hour: float | None = None
    ) -> None:
        super().__init__(env, detector=detector, false_alarms_per_hour=false_alarms_per_hour)
        compose(env, detector=detector, false_alarms_per_hour=false_alarms_per_hour)
        setup = composable(env).core.setup
        warn_uncalibrated(detector, setup.detector, false_alarms_per_hour, setup)


class EpochInfo(SingleWrapper):
    """Adds ``info["epochs"]``, as ``gym.make(..., epoch=True)`` does.

    It is a tuple of all epochs since the last call in order, `Epoch` of one receiver each: after a
    reset those of the monitored start, in the last step also those of the time to alert.  So any
    wrapper around this one can be a passive detector.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not, not reset yet.
    epoch : bool or sequence of str
        True for all fields that the receiver has, or names of the optional ones.
    """

    def __init__(self, env: Env, epoch: EpochSpec = True) -> None:
        super().__init__(env, epoch=epoch)
        compose(env, epoch=epoch)


class PassiveDetector(SingleWrapper):
    """Lets a detector judge from outside of the loop, with the verdicts that it has within.

    The information has, of all epochs since the last call, ``alarm``, ``alarm_time_s`` of the first
    one (NaN without), and ``statistic`` and ``threshold`` where their ratio is largest.  A detector
    that the id brings is replaced by ``never``; one that an argument or a wrapper has set stays.
    Rewards are those of the environment: the price of an alarm is for that in the loop.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not, not reset yet.
    detector, false_alarms_per_hour
        As in `DetectorWrapper`; the detector must not de-weight measurements.
    end : bool
        Whether an alarm after the onset ends the episode.

    Raises
    ------
    ValueError
        When the detector de-weights measurements, draws, or can't judge this victim.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> from spoofgym.wrappers import PassiveDetector
    >>> env = PassiveDetector(gym.make("spoofgym/Zhong2025-v0"), "snapshot-chi2")
    >>> observation, info = env.reset(seed=1)
    >>> info["alarm"]
    False
    >>> env.close()
    """

    def __init__(
        self,
        env: Env,
        detector: DetectorSpec,
        *,
        false_alarms_per_hour: float | None = None,
        end: bool = True,
    ) -> None:
        rate = false_alarms_per_hour
        super().__init__(env, detector=detector, false_alarms_per_hour=rate, end=end)
        self.judge, self.end = OutsideDetector(env, detector, rate), end

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode, and judge its monitored start."""
        observation, info = super().reset(seed=seed, options=options)
        return observation, {**info, **self._judge(info, fresh=True)}

    def step(self, action: Observation) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        """Give one command, and judge its epochs."""
        observation, reward, terminated, truncated, info = super().step(action)
        info.update(self._judge(info, fresh=False))
        return observation, reward, terminated or (self.end and info["alarm"]), truncated, info

    def _judge(self, info: dict[str, Any], *, fresh: bool) -> dict[str, Any]:
        epochs: dict[str, Any] = {
            name: [info[name]] for name in ("epochs", "settling_epochs") if name in info
        }
        found = self.judge.judge(epochs, np.array([fresh]))
        return {name: array.item() for name, array in found.items()}


class ResidualAction(SingleWrapper):
    r"""Makes actions corrections of an attack that a spoofer plays, as the term `Residual` does.

    .. math:: a = \mathrm{clip}(a_{base} + s\, c, -1, 1)

    with the correction c of a policy: at 0 the environment plays the base to the bit.  So a learner
    starts from the best attack that is known.  Scores play both; the card of the policy
    names its base.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not, not reset yet.
    spoofer : str, mapping or Spoofer
        The base, as `make_spoofer` takes it; ``"amplitude"`` fixes how far it goes.
    scale : float, optional
        What a correction of 1 adds, s, in units of the action; by default 0.4 of the largest action
        of an open-loop base, and needed for any other.

    Raises
    ------
    ValueError
        When the base does not fit the environment, decides at another pace, or observes more.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import spoofgym
    >>> from spoofgym.wrappers import ResidualAction
    >>> env = gym.make("spoofgym/Zhong2025-v0", knowledge="oracle")
    >>> env = ResidualAction(env, {"name": "ramp", "rate_mps": 0.3})
    >>> env.unwrapped.action_names
    ('along_target_setpoint_correction',)
    >>> env.close()
    """

    def __init__(self, env: Env, spoofer: SpooferSpec, scale: float | None = None) -> None:
        super().__init__(env, spoofer=spoofer, scale=scale)
        compose(env, base=spoofer, scale=scale)


class WatchWrapper(SingleWrapper):
    """Adds passive detectors, as the argument ``watch=`` does.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not, and not reset yet.
    watch : sequence of str, mapping or Detector
        Each as `make_detector` takes it.  Their weights are not used.
    """

    def __init__(self, env: Env, watch: WatchSpec) -> None:
        super().__init__(env, watch=watch)
        compose(env, watch=watch)


class StealthBudget(SingleWrapper):
    """Ends an episode where the attack has spent its divergence; the end term `AtStealthBudget`.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not, and not reset yet.
    budget_nats : float
        Largest divergence, by the belief of the victim's filter.
    """

    def __init__(self, env: Env, budget_nats: float) -> None:
        super().__init__(env, budget_nats=budget_nats)
        compose(env, end=AtStealthBudget(budget_nats))


class RecordEpochs(SingleWrapper):
    """Writes every epoch of the commands into Parquet files, one an episode.

    Parameters
    ----------
    env : Env
        A `SpoofEnv`, wrapped or not.
    folder : str or Path
        Where the files go.
    """

    def __init__(self, env: Env, folder: str | Path) -> None:
        super().__init__(env, folder=str(folder))
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
