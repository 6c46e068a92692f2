"""Plain PPO on offsets of the pseudoranges, beside the best attacks without learning.

    python -m train.offsets_ppo --list                 # what it trains, and its CPU minutes
    python -m train.offsets_ppo --out runs/offsets     # five seeds of each case against `ewma`

It is stable-baselines3 with the arguments of `PLAIN` and a first spread of the actions, blind, in
the papers' world: that of `spoofgym/Offsets-v0` with `scenario="zhong2025"`, and receiver, timeline
and domain None.  With all satellites captured the rival is the exact coherent ramp; with 5 of 8 it
is the attack along the line that the others do not see, as `tools.offsets_worth` has searched for
it against that detector.  The case `"5 of 8, corrected"` learns corrections of that attack; all
others begin at nothing.  Scores are at exactly the alarm budget, and ratios paired, both amplitudes
fitted again in every draw; displacement and alarms of the policy as it was trained stand beside
them.  After a kill the same command goes on with the seed that was learning.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents.folder import Part, Records, error_lines, learning_versions
from agents.learning import learn, run_training
from agents.seeds import format_range
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.at_budget import AlarmCurve, ratio_at_budget
from spoofgym.bench.scores.statistics import BUDGET
from spoofgym.bench.search.amplitude import EXACT
from spoofgym.core.progress import ProgressBar
from spoofgym.core.registry import check_choice
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers.learned import ModelPolicy

WORLD: dict[str, Any] = {"scenario": "zhong2025"}
PACE: dict[str, Any] = {"decision_interval_s": 10.0, "between": "linear"}
PLAIN: dict[str, Any] = {"n_steps": 15, "batch_size": 960, "gamma": 1.0}
NUM_ENVS = 256
SPACE, FEW, CORRECTED = "position+clock", "5 of 8", "5 of 8, corrected"
SUBSET = {"basis": SPACE, "channels": FEW, "scales_mps": [1.0, 1.0, 0.05]}
CASES: dict[str, tuple[dict[str, Any], float]] = {
    "rotated": ({"basis": "rotated"}, -1.5),
    "satellites": ({"basis": "satellites"}, -1.5),
    FEW: (SUBSET, -3.5),
    CORRECTED: (SUBSET, -2.5),
}
"""Settings of the attack, and the logarithm of the first spread of the actions."""
RIVAL = "rival"
SEARCHED = Path(__file__).resolve().parents[1] / "docs" / "offsets.json"
RATE_MPS, FIX = 5.0, 4
"""What `tools.offsets_worth` has found, in units of this rate; the axes of a fix are the first."""
MINUTES = 3.0  # of a core that 300,000 decisions and their score take, roughly
HEAD = ("case", "detector", "rival [m]", "PPO, median and range [m]",
        "over the rival, median and range; the median seed's interval",
        "as trained [m], alarms [%]")  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    out: Path = Path("runs/offsets")  # Folder of the results.
    detectors: tuple[str, ...] = ("ewma",)  # At 0.2 false alarms an hour.
    cases: tuple[str, ...] = tuple(CASES)  # Which of them.
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)  # One training each.
    steps: int = 300_000  # Decisions of all receivers together.
    runs: int = 1024  # Evaluation runs.
    entropy: int = 0  # Of these runs.
    list: bool = False  # Only say what is trained, and how long it takes.

    def __post_init__(self) -> None:
        for case in self.cases:
            check_choice("case", case, CASES)

    def pairs(self) -> Iterator[tuple[str, Any, str]]:
        """Rows of the table: their name, detector and case."""
        for case, detector in product(self.cases, self.detectors):
            yield f"{case}, {specify_detector(detector).label}", detector, case


@cache
def load_line(detector: str) -> tuple[tuple[float, ...], ...]:
    """Rates of the axes of `SUBSET`, in its units, of what was searched for against a detector."""
    cases = json.loads(SEARCHED.read_text())["cases"]
    lines = {label: cases[label]["scores"][SPACE] for label in cases if label.endswith(f", {FEW}")}
    name = f"{detector}, {FEW}"
    check_choice("searched attack", name, lines)
    found = lines[name]
    curves = RATE_MPS * found["value"] * np.array(found["curves"])[:FIX]
    return tuple(map(tuple, (curves / max(1.0, np.abs(curves).max())).round(7).tolist()))


def make_env(detector: Any, case: str) -> dict[str, Any]:
    """Settings of the environment of a case, apart from its world and detector."""
    attack = {"attack": {"name": "offsets", **CASES[case][0]}}
    if case != CORRECTED:
        return {**attack, **PACE}
    line = {"name": "action-curves", "curves": load_line(specify_detector(detector).label)}
    return {**attack, **PACE, "action": {"name": "residual", "spoofer": line}}


def make_judge(settings: Settings, detector: Any, attack: dict[str, Any]) -> Evaluator:
    sizes: dict[str, Any] = {"runs": settings.runs, "fit_runs": settings.runs, "rule": EXACT}
    return Evaluator(detector=detector, entropy=settings.entropy, attack=attack, **WORLD, **sizes)


def fit_rival(settings: Settings, detector: Any, case: str) -> tuple[dict[str, Any], AlarmCurve]:
    """The best attack without learning: the best constant coherent ramp to the east, or the
    searched attack; at the pace of its corrections, where it is corrected."""
    own, rival = make_env(detector, case), "ramp"
    attack = own.pop("attack")
    if case == CORRECTED:
        rest = ModelPolicy(lambda seen: np.zeros((len(seen), FIX)), label="base", **own)
        fit = make_judge(settings, detector, attack).fit(rest)
    elif case == FEW:
        line = load_line(specify_detector(detector).label)
        fit = make_judge(settings, detector, attack).fit({"name": "action-curves", "curves": line})
    else:
        attack = {**attack, "basis": SPACE, "scales_mps": [1.0, 1.0, 1.0]}
        fit = make_judge(settings, detector, attack).fit(rival)
    assert fit.trace is not None
    assert fit.at_budget is not None
    return {**fit.at_budget, "value": fit.value}, fit.trace


def train(
    settings: Settings, detector: Any, case: str, seed: int, rival: AlarmCurve
) -> dict[str, Any]:
    """One training, and its scores."""
    own, log_std = make_env(detector, case), CASES[case][1]
    how: dict[str, Any] = {**WORLD, **own, "warm_pool": NUM_ENVS}
    vector = SpoofVecEnv(NUM_ENVS, detector=detector, knowledge="blind", seed=1000 * seed, **how)
    envs = VecNormalize(vector, gamma=1.0)
    spread: dict[str, Any] = {"policy_kwargs": {"log_std_init": log_std}}
    model = PPO("MlpPolicy", envs, seed=seed, device="cpu", **PLAIN, **spread)
    if case == CORRECTED:
        with torch.no_grad():
            for each in model.policy.action_net.parameters():
                each.zero_()
    began = time.perf_counter()
    why = learn(model, settings.steps)
    row: dict[str, Any] = {
        "seed": seed,
        "wall_s": round(time.perf_counter() - began, 1),
        "diverged": why,
    }
    if why is None:
        judge = make_judge(settings, detector, own["attack"])
        fit, trained = judge.fit(model), judge.score(model, amplitude=None)
        assert fit.trace is not None  # as of every exact fit
        ratio = ratio_at_budget(fit.trace, rival, BUDGET)
        row |= {"score": fit.at_budget, "amplitude": fit.value, "ratio": ratio.as_json()}
        row |= {"as_trained": trained.as_dict()}
    envs.close()
    return row


def play(settings: Settings, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Train what is missing; the results, JSON-able."""
    rows = {name: row for name, *row in settings.pairs()}
    rivals = cache(lambda name: fit_rival(settings, *rows[name]))
    parts = {}
    for name, (detector, case) in rows.items():
        own = {"detector": detector, "env": make_env(detector, case), "plain": PLAIN}
        own |= {"log_std": CASES[case][1]}
        parts[f"{name} {RIVAL}"] = Part(own, lambda *_, x=name: rivals(x)[0])
        for seed in settings.seeds:
            parts[f"{name} {seed}"] = Part(
                own,
                lambda *_, x=name, s=seed: train(settings, *rows[x], s, rivals(x)[1]),
                work=10.0,
            )
    told = {name: getattr(settings, name) for name in ("steps", "runs", "entropy")}
    config = {**told, "versions": learning_versions()}
    found = Records("offsets-ppo", config, parts).play(settings.out, progress)
    cases = {
        name: {
            RIVAL: found[f"{name} {RIVAL}"],
            "seeds": [found[f"{name} {seed}"] for seed in settings.seeds],
        }
        for name in rows
    }
    return {**told, "world": WORLD, "cases": cases}


def build_table(results: dict[str, Any]) -> str:
    """A line of Markdown for each case and detector; a training that has diverged counts as 0 m."""
    lines = []
    for name, found in results["cases"].items():
        case, _, detector = name.rpartition(", ")
        good = [row for row in found["seeds"] if row["diverged"] is None]
        lost = [0.0] * (len(found["seeds"]) - len(good))
        reached = [row["score"][MEASURES[0]]["value"] for row in good] + lost
        ordered = sorted(good, key=lambda row: row["ratio"]["value"])
        middle = ordered[(len(ordered) - 1) // 2]
        trained = middle["as_trained"]
        ratio = interval(middle["ratio"], 2)
        if len(reached) > 1:
            shares = [row["ratio"]["value"] for row in good] + lost
            ratio = f"{median(shares):.2f} [{min(shares):.2f}, {max(shares):.2f}]; {ratio}"
        lines.append((
            *(case, f"`{detector}`", interval(found[RIVAL][MEASURES[0]])),
            *(format_range(reached) if len(reached) > 1 else f"{reached[0]:.1f}", ratio),
            f"{trained['stealthy_displacement_m']['value']:.1f}, "
            f"{100.0 * trained['alarm_rate']['value']:.1f}",
        ))  # fmt: skip
    return Table.of_texts(*HEAD).markdown(lines)


def list_plan(settings: Settings) -> Iterator[str]:
    """What is trained, and its CPU minutes."""
    each = MINUTES * settings.steps / 300_000
    for name, *_ in settings.pairs():
        yield f"{name}: {len(settings.seeds)} seeds, about {each:.1f} CPU minutes each"


@error_lines()
def main() -> None:
    run_training(Settings, __doc__, play, build_table, list_plan)


if __name__ == "__main__":
    main()
