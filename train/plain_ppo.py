"""What anyone's PPO learns: stable-baselines3 on `SpoofVecEnv`, five arguments or none at all.

    python -m train.plain_ppo --task T3 --out runs/plain-T3

`plain` has the five arguments of `PLAIN`, `defaults` those of the library alone.  Both are scored
while they learn, and at the end on evaluation runs, beside the tuned ramps of the same runs and
the same network before it learned.  After a kill the same command goes on; what is lost is the seed
that was learning, up to a quarter of an hour.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents.folder import Part, Records, error_lines, learning_versions
from agents.learning import learn, run_training
from agents.seeds import KIND_HEAD, LOUDEST, kind_cells
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.table import Table
from spoofgym.bench.scores.spoofer import SpooferScore
from spoofgym.core.progress import ProgressBar
from spoofgym.core.registry import check_choice, whole_number
from spoofgym.sb3 import ScoreCallback, SpoofVecEnv

NUM_ENVS = {"plain": 64, "defaults": 8}
PLAIN: dict[str, Any] = {
    "n_steps": 300,
    "batch_size": 2400,
    "gamma": 1.0,
    "policy_kwargs": {"log_std_init": -1.5},
}
"""With `VecNormalize` around the environment these are the five."""


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    out: Path  # Folder of the results.
    task: str = "T3"  # Task, T1 to T6.
    kinds: tuple[str, ...] = ("plain", "defaults")  # Five arguments, or none.
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)  # One training each.
    steps: int = 1_000_000  # Steps of all receivers together.
    scores: int = 4  # How often it is scored while it learns.
    fit_runs: int = 128  # Training runs, on which amplitudes are fitted.
    runs: int = 400  # Evaluation runs.
    entropy: int = 0  # Seed of training and evaluation runs; trials of recipes have 0.
    num_envs: int | None = None  # Receivers side by side; 64, and 8 for the defaults, unless given.

    def __post_init__(self) -> None:
        for kind in self.kinds:
            check_choice("kind", kind, NUM_ENVS)
        for name in ("steps", "scores", "fit_runs", "runs", "entropy"):
            whole_number(f"`{name}`", getattr(self, name), 0 if name == "entropy" else 1)
        if self.scores > self.steps:
            raise ValueError(f"`scores` must be in [1, {self.steps}], the steps, got {self.scores}")

    @property
    def identity(self) -> dict[str, Any]:
        """What all seeds of a folder share, JSON-able."""
        own = ("task", "steps", "scores", "fit_runs", "runs", "num_envs")
        told = {name: getattr(self, name) for name in own}
        return told | ({"entropy": self.entropy} if self.entropy else {})  # older folders have 0


def train(
    settings: Settings, kind: str, seed: int, judge: Evaluator, ramps: dict[str, SpooferScore]
) -> dict[str, Any]:
    """One training: its score on evaluation runs, and what it was on training runs meanwhile. A
    training that has diverged has no score."""
    num_envs = settings.num_envs or NUM_ENVS[kind]
    envs: Any = SpoofVecEnv(num_envs, task=settings.task, knowledge="blind", seed=1000 * seed)
    if kind == "plain":
        envs = VecNormalize(envs, gamma=1.0)
    given = PLAIN if kind == "plain" else {}
    model = PPO("MlpPolicy", envs, seed=seed, device="cpu", **given)
    untrained = judge.score(model, label="untrained", largest_amplitude=LOUDEST)
    watch = ScoreCallback(judge=judge, every=settings.steps // settings.scores, verbose=0)
    began = time.perf_counter()
    why = learn(model, settings.steps, callback=watch)
    if why is not None:
        watch.give_up(why)
    wall_s = time.perf_counter() - began
    row: dict[str, Any] = {"seed": seed, "score": None, "ratios": {}}
    if watch.diverged is None:
        score = judge.score(model, label=kind)
        row["score"] = score.as_dict()
        row["ratios"] = {k: score.ratio_to(ramp).as_json() for k, ramp in ramps.items()}
    envs.close()
    curve = [[step, round(found.score, 3)] for step, found in watch.history]
    told = {"curve": curve, "wall_s": round(wall_s, 1), "diverged": watch.diverged}
    return {**row, "untrained": untrained.as_dict(), **told}


def play(settings: Settings, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Train what is missing; the results, JSON-able."""
    played = {name: getattr(settings, name) for name in ("runs", "fit_runs", "entropy")}
    judge = Evaluator(settings.task, **played)
    ramps = cache(lambda: {name: judge.score(name) for name in ("ramp", "accelerating-ramp")})
    parts = {"ramps": Part({}, lambda *_: {name: x.as_dict() for name, x in ramps().items()})}
    for kind in settings.kinds:
        for seed in settings.seeds:
            make = lambda *_, x=(kind, seed): train(settings, *x, judge, ramps())  # noqa: E731
            parts[f"{kind}-{seed}"] = Part({}, make, work=settings.steps)
    config = {**settings.identity, "versions": learning_versions()}
    found = Records("plain-ppo", config, parts).play(settings.out, progress)
    told = {name: getattr(settings, name) for name in ("task", "steps", "entropy")}
    rows = {kind: [found[f"{kind}-{seed}"] for seed in settings.seeds] for kind in settings.kinds}
    return {**told, "ramps": found["ramps"], "kinds": rows}


def build_table(results: dict[str, Any]) -> str:
    """A line of Markdown for each kind: the median over its seeds, and the range."""
    ramp = results["ramps"]["ramp"]
    rows = [kind_cells(results["task"], kind, of, ramp) for kind, of in results["kinds"].items()]
    return Table.of_texts(*KIND_HEAD).markdown(rows)


@error_lines()
def main() -> None:
    run_training(Settings, __doc__, play, build_table)


if __name__ == "__main__":
    main()
