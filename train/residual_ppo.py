"""Plain PPO that corrects the optimized open-loop attack, beside that attack.

    python -m train.residual_ppo --list                 # what it trains, and its CPU minutes
    python -m train.residual_ppo --out runs/residual

The base is searched against the detector and fitted to exactly the alarm budget.  PPO with the
arguments of `PLAIN` begins with corrections of 0 and small noise.  Its checkpoints, the base among
them, are scored on runs for the choice, and the best is kept; then it and the base are scored on
other runs, at exactly the budget, and ratios are paired.  The papers' world; after a kill the same
command goes on with the seed that was learning.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from rich.console import Console
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from agents.folder import Part, Records, error_lines, learning_versions, write_json
from agents.learning import learn, set_price
from agents.seeds import format_range
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.at_budget import ratio_at_budget
from spoofgym.bench.scores.statistics import BUDGET
from spoofgym.bench.search.amplitude import EXACT
from spoofgym.core.progress import ProgressBar, show_progress
from spoofgym.core.registry import check_choice
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers.learned import ModelPolicy, describe_env, get_normalization

from .offsets_ppo import NUM_ENVS, PACE, PLAIN, WORLD

KNOWLEDGE = {"blind": "blind", "statistics": "oracle"}
"""What the correction is of, by the words of the table."""
LEAST_SCALE_MPS, ROOM = 2.0, 1.5
"""Least rate that an action of 1 requests, and how many times the base's largest it is."""
LOG_STD, CHECKPOINTS = -2.0, 5
CHOICE, FINAL = 1, 2
"""Entropy of the runs on which a checkpoint is chosen, and of those that it is scored on."""
MINUTES = 5.0  # of a core that 200,000 decisions and their scores take, roughly
HEAD = ("detector", "correction by", "open-loop attack [m]", "kept policy, median and range [m]",
        "over the base, each seed", "last policy, each seed", "alarms as trained [%]")  # fmt: skip


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    out: Path = Path("runs/residual")  # Folder of the results.
    detectors: tuple[str, ...] = ("ewma", "joint-chart")  # At 0.2 false alarms an hour.
    knowledge: tuple[str, ...] = tuple(KNOWLEDGE)  # What corrections are of.
    seeds: tuple[int, ...] = (0, 1, 2)  # One training each.
    steps: int = 200_000  # Decisions of all receivers together.
    price_m: float = 300.0  # Price of an alarm [m], about what the base gains by one more.
    runs: int = 1024  # Runs of the last scores; half as many for the choice.
    list: bool = False  # Only say what is trained, and how long it takes.

    def __post_init__(self) -> None:
        for each in self.knowledge:
            check_choice("knowledge", each, KNOWLEDGE)


def make_judge(settings: Settings, detector: str, entropy: int) -> Evaluator:
    runs = settings.runs // 2 if entropy == CHOICE else settings.runs
    sizes: dict[str, Any] = {"runs": runs, "fit_runs": runs, "rule": EXACT}
    return Evaluator(detector=detector, entropy=entropy, **WORLD, **sizes)


def find_base(settings: Settings, detector: str) -> dict[str, Any]:
    """The optimized open-loop attack at the amplitude that keeps the budget."""
    found = make_judge(settings, detector, CHOICE).fit("open-loop")
    assert found.found is not None  # as of every search
    rates = np.asarray(found.found["played"]["rates_mps"]) * found.value
    return {"name": "open-loop", "rates_mps": np.round(rates, 6).tolist()}


def make_model(settings: Settings, case: tuple[str, str, int], base: dict[str, Any]) -> PPO:
    """PPO whose first corrections are 0 but for exploration."""
    detector, knowledge, seed = case
    full_scale_mps = max(LEAST_SCALE_MPS, ROOM * max(base["rates_mps"]))
    below = [{"name": "rate-setpoint", "full_scale_mps": full_scale_mps}]
    own = {**WORLD, "detector": detector, "knowledge": KNOWLEDGE[knowledge]}
    own |= {"action": {"name": "residual", "spoofer": base, "action": below}}
    vector = SpoofVecEnv(NUM_ENVS, seed=1000 * seed, warm_pool=NUM_ENVS, **own, **PACE)
    set_price(vector, settings.price_m / vector.core.length_m)
    spread: dict[str, Any] = {"policy_kwargs": {"log_std_init": LOG_STD}}
    envs = VecNormalize(vector, gamma=1.0)
    model = PPO("MlpPolicy", envs, seed=seed, device="cpu", **PLAIN, **spread)
    with torch.no_grad():
        for each in model.policy.action_net.parameters():
            each.zero_()
    return model


def freeze(model: PPO) -> ModelPolicy:
    """The policy as it is now, apart from the one that goes on learning."""
    spaces, seen = (model.observation_space, model.action_space), get_normalization(model)
    policy = model.policy_class(*spaces, lambda _: 0.0, **model.policy_kwargs)
    policy.load_state_dict(model.policy.state_dict())
    policy.set_training_mode(False)

    def act(observation: Any) -> Any:
        given = observation if seen is None else seen(observation)
        return policy.predict(given, deterministic=True)[0]

    return ModelPolicy(act, label="residual", **describe_env(model.get_env()))


def train(settings: Settings, case: tuple[str, str, int], base: dict[str, Any]) -> dict[str, Any]:
    """One training, the choice of a checkpoint, and scores on other runs."""
    model, began = make_model(settings, case, base), time.perf_counter()
    policies, why = [freeze(model)], None
    for _ in range(CHECKPOINTS):
        why = why or learn(model, settings.steps // CHECKPOINTS, reset_num_timesteps=False)
        if why is None:
            policies.append(freeze(model))
    wall_s = round(time.perf_counter() - began, 1)
    choice = make_judge(settings, case[0], CHOICE)
    reached = [choice.fit(each).at_budget[MEASURES[0]]["value"] for each in policies]
    best = int(np.argmax(reached))
    final = make_judge(settings, case[0], FINAL)
    rival = final.fit(policies[0])
    row: dict[str, Any] = {"seed": case[2], "wall_s": wall_s, "diverged": why, "checkpoint": best}
    row |= {"choice_m": reached, "base": rival.at_budget}
    for name, number in (("kept", best), ("last", len(policies) - 1)):
        fit = final.fit(policies[number])
        ratio = ratio_at_budget(fit.trace, rival.trace, BUDGET)
        row[name] = {"score": fit.at_budget, "amplitude": fit.value, "ratio": ratio.as_json()}
    row["as_trained"] = final.score(policies[-1], amplitude=None).as_dict()
    model.get_env().close()
    return row


def play(settings: Settings, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Train what is missing; the results, JSON-able."""
    parts: dict[str, Part] = {}
    for detector in settings.detectors:
        own = {"detector": detector}
        search = f"{detector} base"
        parts[search] = Part(own, lambda *_, x=detector: find_base(settings, x), work=2.0)
        for knowledge in settings.knowledge:
            for seed in settings.seeds:
                case = detector, knowledge, seed
                parts[" ".join(map(str, case))] = Part(
                    {**own, "knowledge": KNOWLEDGE[knowledge], "plain": PLAIN},
                    lambda done, _, x=case, b=search: train(settings, x, done[b]),
                    after=(search,),
                    work=10.0,
                )
    sizes = {name: getattr(settings, name) for name in ("steps", "price_m", "runs")}
    config = {**sizes, "versions": learning_versions()}
    return {
        **sizes,
        "world": WORLD,
        "cells": Records("residual-ppo", config, parts).play(settings.out, progress),
    }


def build_table(settings: Settings, cells: dict[str, Any]) -> str:
    """A line of Markdown for each detector and knowledge."""
    lines = []
    for detector in settings.detectors:
        for knowledge in settings.knowledge:
            found = [cells[f"{detector} {knowledge} {seed}"] for seed in settings.seeds]
            kept = [each["kept"]["score"][MEASURES[0]]["value"] for each in found]
            ratios = {
                name: "; ".join(interval(each[name]["ratio"], 2) for each in found)
                for name in ("kept", "last")
            }
            alarms = [f"{100.0 * each['as_trained']['alarm_rate']['value']:.1f}" for each in found]
            base = interval(found[0]["base"][MEASURES[0]])
            lines.append((
                *(f"`{detector}`", knowledge, base, format_range(kept)),
                *(ratios["kept"], ratios["last"], ", ".join(alarms)),
            ))  # fmt: skip
    return Table.of_texts(*HEAD).markdown(lines)


@error_lines()
def main() -> None:
    settings = tyro.cli(Settings, description=__doc__)
    if settings.list:
        each = MINUTES * settings.steps / 200_000
        for detector in settings.detectors:
            for knowledge in settings.knowledge:
                count = len(settings.seeds)
                print(f"{detector}, {knowledge}: {count} seeds, about {each:.1f} CPU minutes each")
        return
    torch.set_num_threads(1)
    results = play(settings, show_progress)
    write_json(settings.out / "results.json", results)
    text = build_table(settings, results["cells"])
    Console().print(text, soft_wrap=True, markup=False)


if __name__ == "__main__":
    main()
