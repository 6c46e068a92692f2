"""Score (with its average) and recording callbacks."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from ..bench.experiments.evaluate import FIT_RUNS, Evaluator
from ..bench.search.amplitude import TuningResult
from ..core.declared import check_number
from ..core.progress import ProgressCallback
from ..core.registry import refuse_overrides, whole_number
from ..policies.card import DECIDED_ON
from ..policies.contract import NotFinite
from ..policies.onnx_file import checked_path
from ..spoofers.learned import finite
from ..wrappers.single import EpochRecorder
from .vec_env import SpoofVecEnv

Array = NDArray[Any]


class RecordEpochs(VecEnvWrapper):
    """Writes every epoch of the commands into Parquet files, one an episode of a receiver.

    The twin of `spoofgym.wrappers.RecordEpochs`, for stable-baselines3.

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
        inner: Any = venv.unwrapped
        if not isinstance(inner, SpoofVecEnv):
            raise TypeError(f"this wrapper needs a SpoofVecEnv, wrapped or not, got {inner!r}")
        if inner.side == "detector":
            raise TypeError(
                "the epochs of a duel are not recorded: this SpoofVecEnv has the side 'detector'"
            )
        self.recorder = EpochRecorder(folder, self.num_envs)
        inner.core.listeners.append(self.recorder)

    def reset(self) -> Any:
        """Start episodes; those that are not over are written as they are."""
        self.recorder.finish(np.arange(self.num_envs), complete=False)
        return self.venv.reset()

    def step_wait(self) -> tuple[Any, Array, Array, list[dict[str, Any]]]:
        """Run one step, the environment's own, and write the episodes that it has ended."""
        result: tuple[Any, Array, Array, list[dict[str, Any]]] = self.venv.step_wait()
        if result[2].any():
            self.recorder.finish(np.flatnonzero(result[2]), complete=True)
        return result

    def close(self) -> None:
        """Write episodes that are not over, and close the environment."""
        self.recorder.finish(np.arange(self.num_envs), complete=False)
        super().close()


class WeightAverage:
    """Exponential average of the weights of a model's policy, w <- a w + (1 - a) w_now (Polyak and
    Juditsky, SIAM J. Control and Optimization 30, 1992), which jitters less; `keeps`: a, in [0,
    1)."""

    def __init__(self, keeps: float) -> None:
        self.keeps = keeps
        self.weights: dict[str, NDArray[np.float64]] = {}

    def update(self, model: Any) -> None:
        """Take the weights of a model into the average; the first ones are the average."""
        for name, weight in model.policy.named_parameters():
            now = weight.detach().cpu().numpy().astype(np.float64)
            self.weights[name] = self.keeps * self.weights.get(name, now) + (1.0 - self.keeps) * now

    @contextmanager
    def apply(self, model: Any) -> Iterator[None]:
        """Let the model have the average as its weights, and its own ones again afterwards."""
        parameters = dict(model.policy.named_parameters())
        own = {name: weight.detach().clone() for name, weight in parameters.items()}
        for name, average in self.weights.items():
            parameters[name].data.copy_(own[name].new_tensor(average))
        try:
            yield
        finally:
            for name, weight in own.items():
                parameters[name].data.copy_(weight)

    def state(self) -> dict[str, Any]:
        """The average, JSON-able and exact."""
        return {name: weight.tolist() for name, weight in self.weights.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` returned."""
        self.weights = {name: np.array(values) for name, values in state.items()}


STATE = ("best_m", "best_step", "best_amplitude", "diverged", "_next", "_averaged_at")
"""What a `ScoreCallback` keeps, beside its history."""


class ScoreCallback(BaseCallback):
    """Scores a policy while it learns, and keeps the best one.

    The amplitude of the policy is fitted to the alarm budget on training runs, and the score is the
    stealthy displacement there.  It is logged as ``spoofer/stealthy_m``, with
    ``spoofer/amplitude``, ``spoofer/alarm_rate`` and ``spoofer/best_m``.  A figure to report is
    that of `spoofgym.evaluate` afterwards, on runs that decided nothing.

    With ``average``, what is scored and stored is an exponential average of the policy's weights
    over its updates, which jitters less than the policy that learns.  The policy itself goes on
    with its own weights; `apply_average` lends it the average, such as for a last score.

    A policy whose weights or actions are NaN or infinite ends the training; the best one stays,
    and the model has the weights of the last rollout before.  Where they become so within an
    update, before its last minibatch, torch raises a ValueError out of ``learn``: no callback is
    called there.  The file of the best policy is whole then, too.

    Parameters
    ----------
    task : str, optional
        As in `spoofgym.evaluate`.
    every : int
        Steps of all receivers together from one score to the next; the first one is that of the
        policy as it begins.
    path : str or Path, optional
        Where the best policy is written, ``.../NAME.onnx``, with its card; needs the extra
        ``train``.
    fit_runs : int
        Training runs, on which it is scored.
    average : float
        How much of the average stays at every rollout, in [0, 1); 0 for the policy as it is.
    entropy, threads, progress : optional
        As in `spoofgym.evaluate`.
    judge : Evaluator, optional
        Made before, in place of all that decides one: task, runs and world.
    verbose : int
        1 for a line at every score.
    **world
        As in `spoofgym.evaluate`.

    Attributes
    ----------
    history : list of (int, TuningResult)
        Steps, and what was found then.
    best_m, best_step, best_amplitude : float, int and float
        Largest score within the budget [m], when it was, and its amplitude; 0, -1 and 1 before.
    diverged : str or None
        Why the training was ended.
    """

    def __init__(
        self,
        task: str | None = None,
        *,
        every: int = 50_000,
        path: str | Path | None = None,
        fit_runs: int = FIT_RUNS,
        average: float = 0.0,
        entropy: int = 0,
        threads: int | None = None,
        progress: ProgressCallback | None = None,
        judge: Evaluator | None = None,
        verbose: int = 1,
        **world: Any,
    ) -> None:
        super().__init__(verbose)
        if judge is not None:
            given = world if task is None else {"task": task, **world}
            refuse_overrides("`judge`", (f"`{name}`" for name in given))
        self.every = whole_number("`every`", every, 1)
        self.path = None if path is None else checked_path(path)
        check_number("average", average, least=0.0, below=1.0)
        self._average = WeightAverage(average)
        self.judge = judge or Evaluator(
            task, fit_runs=fit_runs, entropy=entropy, threads=threads, progress=progress, **world
        )
        self.history: list[tuple[int, TuningResult]] = []
        self.best_m, self.best_step, self.best_amplitude = 0.0, -1, 1.0
        self.diverged: str | None = None
        self._next, self._averaged_at = 0, -1
        self._sound: dict[str, Any] = {}

    def _on_rollout_start(self) -> None:
        """Score the policy, when that is due; it is not updated before the rollout is full."""
        if not self._is_sound():
            return
        self._update_average()
        if self.num_timesteps >= self._next:
            self._next = self.num_timesteps + self.every
            self._score()

    def _on_step(self) -> bool:
        return self.diverged is None

    def _on_training_end(self) -> None:
        if self._is_sound():
            self._update_average()
            self._score()

    def _is_sound(self) -> bool:
        """Whether the weights are finite; if not, the model gets the last ones that were."""
        if self.diverged is not None:
            return False
        if finite(self.model.policy):
            state = self.model.policy.state_dict()
            self._sound = {name: weight.clone() for name, weight in state.items()}
            return True
        if self._sound:
            self.model.policy.load_state_dict(self._sound)
        self.give_up(f"{type(self.model).__name__} has weights that are not finite")
        return False

    def _update_average(self) -> None:
        if self._average.keeps and self.num_timesteps != self._averaged_at:
            self._average.update(self.model)
            self._averaged_at = self.num_timesteps

    @contextmanager
    def apply_average(self) -> Iterator[None]:
        """Let the model act by the average of its weights for a while, where there is one."""
        if not self._average.weights:  # nothing is averaged, or nothing has been learned
            yield
            return
        with self._average.apply(self.model):
            yield

    def state(self) -> dict[str, Any]:
        """What it has found so far, JSON-able, for `restore` from a checkpoint."""
        own = {name: getattr(self, name) for name in STATE}
        history = [[step, found.as_dict()] for step, found in self.history]
        return {**own, "history": history, "average": self._average.state()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a `state`; the file of the best policy is left to its writer."""
        for name in STATE:
            setattr(self, name, state[name])
        self._average.restore(state["average"])
        self.history = [(step, TuningResult.from_dict(found)) for step, found in state["history"]]

    def give_up(self, why: str) -> None:
        """End the training as diverged, with a warning that says why; the best policy stays."""
        outcome = "none before it was within the budget"
        if self.best_step >= 0:
            best = f"the best one was that of step {self.best_step:,} with {self.best_m:.2f} m"
            outcome = best if self.path is None else f"{best}, and is saved"
        when = f"training has diverged after {self.num_timesteps:,} steps"
        self.diverged = f"{when}: {why}; {outcome}"
        warnings.warn(self.diverged, UserWarning, stacklevel=3)

    def _score(self) -> None:
        """Score the policy as it is, unless that has been done, or it has diverged."""
        done = bool(self.history) and self.history[-1][0] == self.num_timesteps
        if done or self.diverged is not None:
            return
        try:
            with self.apply_average():
                found = self.judge.fit(self.model)
        except NotFinite as error:
            self.give_up(str(error))
            return
        self.history.append((self.num_timesteps, found))
        better = found.within_budget and (self.best_step < 0 or found.score > self.best_m)
        if better:
            self.best_m, self.best_step = found.score, self.num_timesteps
            self.best_amplitude = found.value
            if self.path is not None:
                self._keep(found)
        chosen = found.chosen
        for key, value in (
            ("stealthy_m", found.score),
            ("amplitude", found.value),
            ("alarm_rate", chosen.alarm_rate),
            ("best_m", self.best_m),
        ):
            self.logger.record(f"spoofer/{key}", value)
        if self.verbose:
            over = "" if found.within_budget else ", over the budget"
            print(
                f"{self.num_timesteps:>10,d} steps   stealthy {found.score:8.2f} m   alarms "
                f"{100 * chosen.alarm_rate:5.1f} %   amplitude {found.value:.3g}{over}"
                f"{'   best' if better else ''}",
                flush=True,
            )

    def _keep(self, found: TuningResult) -> None:
        from ..export import onnx  # torch, which the engine does not need

        assert self.path is not None  # else nothing is stored
        with self.apply_average():
            seeds = {DECIDED_ON: [[self.judge.entropy, "training"]]}
            onnx(self.model, path=self.path, amplitude=found.value, training=seeds)
