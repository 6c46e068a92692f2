"""What PPO learns on the detector's side: stable-baselines3 on `SpoofVecEnv`, beside classics.

    python -m train.ppo_detector --out runs/ppo-detector

`plain` is the duel as it is by default, `priced` has a fixed threshold, a price of false alarms,
little exploration and normalized observations (`KINDS`).  What has learned plays fresh runs, clean
and attacked, in which nothing alarms; the largest statistics of the clean ones give each detector
its threshold.  Beside it are the same network before it learned, classics, and the file of any
detector (`--detectors`).  After a kill the same command goes on with the seeds that are missing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents.detector_score import area
from agents.folder import Part, Records, error_lines, learning_versions
from agents.learning import learn, run_training
from spoofgym.bench.report.table import Table
from spoofgym.bench.runs.record import undetected_displacement
from spoofgym.bench.scores.statistics import percent, wilson
from spoofgym.core.progress import ProgressBar
from spoofgym.core.registry import check_choice, parse_spec, whole_number
from spoofgym.detectors import make_detector
from spoofgym.detectors.calibration_file import compute_rank
from spoofgym.detectors.learned import LearnedDetector
from spoofgym.duel.duel import make_duel
from spoofgym.duel.opponents import SpooferPool
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.simulation.monitors import PassiveDetectors, PastPositions
from spoofgym.spoofers.learned import make_function

WORLD: dict[str, Any] = {"scenario": "zhong2025"}
POOL: list[dict[str, Any]] = [
    *({"name": "ramp", "rate_mps": rate} for rate in (0.05, 0.1, 0.2, 0.4)),
    {"name": "accelerating-ramp"},
]
KINDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "plain": ({}, {}),
    "priced": (
        {"weighs": False, "payoff": {"name": "weighted", "false_alarm": 30.0}, "threshold": 0.7},
        {"n_steps": 160, "learning_rate": 1e-3, "policy_kwargs": {"log_std_init": -2.0}},
    ),
}
"""Settings of the environment and of PPO; `priced` has `VecNormalize` around it, too."""
RECEIVERS, BATCH = 32, 1024
FRESH = 1_000_000
"""First seed of the runs that are scored; those that are learned from are below it."""
Array = NDArray[Any]


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    out: Path  # Folder of the results.
    kinds: tuple[str, ...] = ("plain", "priced")  # Ways to learn, see `KINDS`.
    seeds: tuple[int, ...] = (1, 2, 3)  # One training each.
    steps: int = 150_000  # Epochs of all receivers together.
    runs: int = 400  # Clean runs to score on, and as many attacked ones.
    detectors: tuple[str, ...] = (
        "snapshot-chi2",
        "aime:signals=range_rate",
        "cumulative-bank:signals=range_rate",
    )
    """Classics, or `.onnx` files of detectors, on the same runs."""

    def __post_init__(self) -> None:
        for kind in self.kinds:
            check_choice("kind", kind, KINDS)
        whole_number("`steps`", self.steps, 1)
        whole_number("`runs`", self.runs, 19)  # for a threshold that 5 % exceed

    @property
    def identity(self) -> dict[str, Any]:
        """What all parts of a folder share, JSON-able."""
        return {"steps": self.steps, "runs": self.runs, "world": WORLD, "pool": POOL}


def play_runs(
    decide: Callable[[Array], Array],
    runs: int,
    attacked: bool,
    watched: Sequence[str],
    **world: Any,
) -> tuple[Array, Array, int]:
    """Statistics (1 + w, L, B) of the agent and of passive detectors in runs that no alarm ends,
    the displacement (L, B) [m], and the epochs of the time to alert."""
    beside = PassiveDetectors([_make_passive(each) for each in watched])
    duel = make_duel(
        runs,
        threads=1,
        monitors=[PastPositions(), beside],
        action="full-command",
        threshold=1.0,
        attack_probability=float(attacked),
        **WORLD,
        **world,
    )
    pool, rows = SpooferPool(POOL, None, duel.setup, runs), np.arange(runs)
    first = FRESH + runs * attacked
    duel.reset([np.random.default_rng(first + row) for row in rows])
    simulator = duel.core.engine.simulator
    pool.start_episodes(rows, simulator.memory["key"])
    passive = simulator.monitor(PassiveDetectors)
    statistics, moved = [], []
    for _ in range(duel.episode_steps):
        due = rows[duel.deciding]
        duel.arrive(pool.act(duel.snapshot(), due) if len(due) else None)
        passive.update(simulator)
        done = duel.decide(np.asarray(decide(duel.observe_detector()), dtype=np.float64))
        statistics.append(np.column_stack([done.info["statistic"], passive.memory["ratio"]]))
        moved.append(done.info["displacement_m"])
    duel.close()
    return np.moveaxis(np.array(statistics), 2, 0), np.array(moved), duel.setup.hold


def _make_passive(text: str) -> Any:
    if text.endswith(".onnx"):
        return LearnedDetector(text)
    spec = parse_spec(text)
    plain = {"name": spec} if isinstance(spec, str) else dict(spec)
    return make_detector({**plain, "thresholds": "nominal"})  # only the order of runs counts


def score(
    decide: Callable[[Array], Array], runs: int, watched: Sequence[str] = (), **world: Any
) -> list[dict[str, Any]]:
    """Scores of an agent and of passive detectors, each at the threshold that 5 % of the clean runs
    exceed: `area` under the curve of largest statistics, attacks `found`, mean undetected
    displacement."""
    clean = play_runs(decide, runs, False, watched, **world)[0].max(axis=1)
    statistics, moved, hold = play_runs(decide, runs, True, watched, **world)
    found, attacked = [], np.arange(2 * runs) >= runs
    for own, quiet in zip(statistics, clean, strict=True):
        alarm = own > np.sort(quiet)[-compute_rank(0.05, runs)]
        first = np.where(alarm.any(axis=0), alarm.argmax(axis=0) + 1, 0)
        largest = np.concatenate([quiet, own.max(axis=0)])
        undetected = undetected_displacement(moved[: len(moved) - hold], first, hold)
        hits = wilson(int((first > 0).sum()), runs).as_json()
        found.append(
            {"area": area(largest, attacked), "found": hits, "mean_m": float(undetected.mean())}
        )
    return found


def train(settings: Settings, kind: str, seed: int) -> dict[str, Any]:
    """One training: scores before and after, episodes and processor time."""
    world, given = KINDS[kind]
    envs: Any = SpoofVecEnv(
        RECEIVERS, side="detector", pool=POOL, seed=1000 * seed, **WORLD, **world
    )
    if kind == "priced":
        envs = VecNormalize(envs, gamma=1.0)
    model = PPO("MlpPolicy", envs, gamma=1.0, batch_size=BATCH, seed=seed, device="cpu", **given)
    weighs = world.get("weighs", True)
    (before,) = score(make_function(model), settings.runs, weighs=weighs)
    began = time.process_time()
    diverged = learn(model, settings.steps)
    cpu_s = time.process_time() - began
    (after,) = score(make_function(model), settings.runs, weighs=weighs)
    envs.close()
    return {"before": before, "after": after, "cpu_s": cpu_s, "diverged": diverged}


def score_others(settings: Settings) -> dict[str, Any]:
    """Scores of what has not learned here, by name; `never` says 0."""
    silent = lambda seen: np.full((len(seen), 1), -1.0)  # noqa: E731
    rows = score(silent, settings.runs, settings.detectors, weighs=False)
    return dict(zip(("never", *settings.detectors), rows, strict=True))


def play(settings: Settings, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Train and score what is missing; the results, JSON-able."""
    files = {"detectors": list(settings.detectors)}
    parts = {"others": Part(files, lambda *_: score_others(settings))}
    for kind in settings.kinds:
        for seed in settings.seeds:
            make = lambda *_, x=(kind, seed): train(settings, *x)  # noqa: E731
            named = {"kind": kind, "settings": KINDS[kind]}
            parts[f"{kind}-{seed}"] = Part(named, make, work=settings.steps)
    config = {**settings.identity, "versions": learning_versions()}
    return Records("ppo-detector", config, parts).play(settings.out, progress)


def build_table(results: dict[str, Any]) -> str:
    """Lines of Markdown: every training before and after, and the others."""
    head = (
        "detector",
        "area under the curve",
        "attacks found [%]",
        "undetected [m]",
        "processor [s]",
    )
    rows = []
    for name, found in results.items():
        lines = found if name == "others" else {}
        if not lines:
            lines = {f"{name}, untrained": found["before"], name: found["after"]}
        for label, each in lines.items():
            spent = f"{found['cpu_s']:.0f}" if label == name else ""
            cells = f"{each['area']:.3f}", percent(each["found"]), f"{each['mean_m']:.1f}"
            rows.append([label, *cells, spent])
    return Table.of_texts(*head).markdown(rows)


@error_lines()
def main() -> None:
    run_training(Settings, __doc__, play, build_table)


if __name__ == "__main__":
    main()
