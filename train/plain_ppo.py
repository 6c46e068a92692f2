"""What anyone's PPO learns: stable-baselines3 on `SpoofVecEnv`, five arguments or none at all.

    python -m train.plain_ppo --task T3 --out runs/plain-T3

`plain` has the five arguments of `PLAIN`, `defaults` those of the library alone.  Both are scored
while they learn, and at the end on evaluation runs, beside the tuned ramps of the same runs and
beside the same network before it learned; every amplitude is fitted to the alarm budget on training
runs.  Each seed is kept as soon as it is finished, so that the same command goes on after a kill;
what is lost is the seed that was learning, up to a quarter of an hour.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import tyro
from rich.console import Console
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents.folder import error_lines, open_folder
from agents.learning import learn
from agents.seeds import KIND_HEAD, LOUDEST, kind_cells
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.table import Table
from spoofgym.bench.scores.spoofer import Score
from spoofgym.core.files import write_file
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
    entropy: int = 0
    """Seed of training and evaluation runs; trials of recipes have played those of 0."""
    num_envs: int | None = None  # Receivers side by side; 64, and 8 for the defaults, unless given.

    def __post_init__(self) -> None:
        """Check names and numbers."""
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


def train(settings: Settings, kind: str, seed: int, judge: Evaluator) -> tuple[Score | None, Any]:
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
    score = judge.score(model, label=kind) if watch.diverged is None else None
    envs.close()
    curve = [[step, round(found.score, 3)] for step, found in watch.history]
    told = {"curve": curve, "wall_s": round(wall_s, 1), "diverged": watch.diverged}
    return score, {"untrained": untrained.as_dict(), **told}


def play(settings: Settings, console: Console) -> dict[str, Any]:
    """Train what is missing; the results, JSON-able."""
    played = {name: getattr(settings, name) for name in ("runs", "fit_runs", "entropy")}
    judge = Evaluator(settings.task, **played)
    open_folder(settings.out, settings.identity)
    ramps = {name: judge.score(name) for name in ("ramp", "accelerating-ramp")}
    rows: dict[str, list[Any]] = {}
    for kind in settings.kinds:
        for seed in settings.seeds:
            path = settings.out / f"{kind}-{seed}.json"
            if not path.is_file():
                with console.status(f"{kind}, seed {seed}"):
                    score, more = train(settings, kind, seed, judge)
                row: dict[str, Any] = {"seed": seed, "score": None, "ratios": {}}
                if score is not None:
                    row["score"] = score.as_dict()
                    row["ratios"] = {k: score.ratio_to(ramp).as_json() for k, ramp in ramps.items()}
                write_file(path, (json.dumps({**row, **more}, indent=1) + "\n").encode())
                console.print(f"{kind}, seed {seed}: {score or more['diverged']}", soft_wrap=True)
            rows.setdefault(kind, []).append(json.loads(path.read_text(encoding="utf-8")))
    rivals = {name: ramp.as_dict() for name, ramp in ramps.items()}
    told = {name: getattr(settings, name) for name in ("task", "steps", "entropy")}
    return {**told, "ramps": rivals, "kinds": rows}


def table_of(results: dict[str, Any]) -> str:
    """A line of Markdown for each kind: the median over its seeds, and the range."""
    ramp = results["ramps"]["ramp"]
    rows = [kind_cells(results["task"], kind, of, ramp) for kind, of in results["kinds"].items()]
    return Table.of_texts(*KIND_HEAD).markdown(rows)


def main() -> None:
    """Command line."""
    console = Console()
    with error_lines():
        settings = tyro.cli(Settings, description=__doc__)
        torch.set_num_threads(1)
        results = play(settings, console)
    text = json.dumps(results, indent=1) + "\n"
    write_file(settings.out / "results.json", text.encode())
    console.print(table_of(results), soft_wrap=True, markup=False)


if __name__ == "__main__":
    main()
