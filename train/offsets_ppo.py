"""Plain PPO from nothing on offsets of the pseudoranges, beside the exact coherent ramp.

    python -m train.offsets_ppo --list                 # what it trains, and its CPU minutes
    python -m train.offsets_ppo --out runs/offsets     # five seeds of each case

It is stable-baselines3 with the arguments of `PLAIN` and a first spread of the actions, blind, in
the papers' world: that of `spoofgym/Offsets-v0` with `scenario="zhong2025"`, and receiver, timeline
and domain None.  Scores are at exactly the alarm budget, and ratios paired, both amplitudes fitted
again in every draw; score and alarms of the policy as it was trained stand beside them.  After a
kill the same command goes on with the seed that was learning.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents.folder import Part, Records, error_lines, learning_versions
from agents.learning import learn, run_training
from agents.seeds import format_range
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.at_budget import AlarmCurve, ratio_at_budget
from spoofgym.bench.scores.statistics import BUDGET
from spoofgym.bench.search.amplitude import EXACT
from spoofgym.core.progress import ProgressBar
from spoofgym.core.registry import check_choice
from spoofgym.sb3 import SpoofVecEnv

WORLD: dict[str, Any] = {"scenario": "zhong2025"}
PACE: dict[str, Any] = {"decision_interval_s": 10.0, "between": "linear"}
PLAIN: dict[str, Any] = {"n_steps": 15, "batch_size": 960, "gamma": 1.0}
NUM_ENVS = 256
SUBSET = {"basis": "position+clock", "channels": "5 of 8", "scales_mps": [0.3, 0.3, 0.05]}
CASES: dict[str, tuple[dict[str, Any], float]] = {
    "rotated": ({"basis": "rotated"}, -1.5),
    "satellites": ({"basis": "satellites"}, -1.5),
    "5 of 8": (SUBSET, -2.5),
}
"""Settings of the attack, and the logarithm of the first spread of the actions."""
RIVAL = "ramp"
MINUTES = 2.0  # of a core that 300,000 decisions and their score take, roughly
HEAD = ("case", "exact ramp [m]", "PPO, median and range [m]", "over the ramp, median seed",
        "as trained: [m]", "alarms [%]")  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    out: Path = Path("runs/offsets")  # Folder of the results.
    detector: str = "ewma"  # Detector, at 0.2 false alarms an hour.
    cases: tuple[str, ...] = tuple(CASES)  # Which of them.
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)  # One training each.
    steps: int = 300_000  # Decisions of all receivers together.
    runs: int = 1024  # Evaluation runs.
    list: bool = False  # Only say what is trained, and how long it takes.

    def __post_init__(self) -> None:
        for case in self.cases:
            check_choice("case", case, CASES)


def make_judge(settings: Settings, attack: dict[str, Any]) -> Evaluator:
    sizes: dict[str, Any] = {"runs": settings.runs, "fit_runs": settings.runs, "rule": EXACT}
    world: dict[str, Any] = {**WORLD, "attack": {"name": "offsets", **attack}}
    return Evaluator(detector=settings.detector, **world, **sizes)


def fit_ramp(settings: Settings, case: str) -> tuple[dict[str, Any], AlarmCurve]:
    """The best constant coherent ramp to the east, by the same satellites."""
    attack = {**CASES[case][0], "basis": "position+clock", "scales_mps": [1.0, 1.0, 1.0]}
    fit = make_judge(settings, attack).fit(RIVAL)
    assert fit.trace is not None
    assert fit.at_budget is not None
    return {**fit.at_budget, "value": fit.value}, fit.trace


def train(settings: Settings, case: str, seed: int, ramp: AlarmCurve) -> dict[str, Any]:
    """One training, and its scores."""
    attack, log_std = CASES[case]
    own = {**WORLD, "attack": {"name": "offsets", **attack}, "warm_pool": NUM_ENVS}
    vector = SpoofVecEnv(
        NUM_ENVS, detector=settings.detector, knowledge="blind", seed=1000 * seed, **own, **PACE
    )
    envs = VecNormalize(vector, gamma=1.0)
    spread: dict[str, Any] = {"policy_kwargs": {"log_std_init": log_std}}
    model = PPO("MlpPolicy", envs, seed=seed, device="cpu", **PLAIN, **spread)
    began = time.perf_counter()
    why = learn(model, settings.steps)
    row: dict[str, Any] = {
        "seed": seed,
        "wall_s": round(time.perf_counter() - began, 1),
        "diverged": why,
    }
    if why is None:
        judge = make_judge(settings, attack)
        fit, trained = judge.fit(model), judge.score(model, amplitude=None)
        assert fit.trace is not None  # as of every exact fit
        ratio = ratio_at_budget(fit.trace, ramp, BUDGET)
        row |= {"score": fit.at_budget, "amplitude": fit.value, "ratio": ratio.as_json()}
        row |= {"as_trained": trained.as_dict()}
    envs.close()
    return row


def play(settings: Settings, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Train what is missing; the results, JSON-able."""
    ramps = cache(lambda case: fit_ramp(settings, case))
    parts = {}
    for case in settings.cases:
        own = {"attack": CASES[case], "plain": PLAIN}
        parts[f"{case} {RIVAL}"] = Part(own, lambda *_, x=case: ramps(x)[0])
        for seed in settings.seeds:
            parts[f"{case} {seed}"] = Part(
                own, lambda *_, x=case, s=seed: train(settings, x, s, ramps(x)[1]), work=10.0
            )
    told = {name: getattr(settings, name) for name in ("detector", "steps", "runs")}
    config = {**told, "versions": learning_versions()}
    found = Records("offsets-ppo", config, parts).play(settings.out, progress)
    cases = {
        case: {
            RIVAL: found[f"{case} {RIVAL}"],
            "seeds": [found[f"{case} {seed}"] for seed in settings.seeds],
        }
        for case in settings.cases
    }
    return {**told, "world": WORLD, "cases": cases}


def build_table(results: dict[str, Any]) -> str:
    """A line of Markdown for each case; a training that has diverged counts as 0 m."""
    lines = []
    for case, found in results["cases"].items():
        good = [row for row in found["seeds"] if row["diverged"] is None]
        reached = [row["score"][MEASURES[0]]["value"] for row in good]
        reached += [0.0] * (len(found["seeds"]) - len(good))
        ordered = sorted(good, key=lambda row: row["ratio"]["value"])
        middle = ordered[(len(ordered) - 1) // 2]
        trained = middle["as_trained"]
        lines.append((
            *(case, interval(found[RIVAL][MEASURES[0]]), format_range(reached)),
            *(interval(middle["ratio"], 2), interval(trained["stealthy_displacement_m"])),
            f"{100.0 * trained['alarm_rate']['value']:.1f}",
        ))  # fmt: skip
    return Table.of_texts(*HEAD).markdown(lines)


def list_plan(settings: Settings) -> Iterator[str]:
    """What is trained, and its CPU minutes."""
    each = MINUTES * settings.steps / 300_000
    for case in settings.cases:
        yield f"{case}: {len(settings.seeds)} seeds, about {each:.1f} CPU minutes each"


@error_lines()
def main() -> None:
    run_training(Settings, __doc__, play, build_table, list_plan)


if __name__ == "__main__":
    main()
