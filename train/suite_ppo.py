"""Plain PPO that corrects the searched attacks of the standard suite: its column `learned`.

    python -m train.suite_ppo --list              # what it trains, and its CPU hours
    python -m train.suite_ppo --out runs/suite    # trains; what is kept of it goes to agents/s1
    python -m train.suite_ppo --score             # the column again, from the shipped cards alone

A detector's base is the open-loop attack of docs/headlines.json, at the amplitude that is at the
budget on choice runs.  PPO sees the detector's statistics, begins with corrections of 0, explores
no wider than the base stays quiet with, pays for an alarm what breaks even at the budget, and goes
on for `steps` decisions; of its checkpoints and the base the one is taken that gets farthest on the
choice runs.  Scores are of the runs of the README's table, at exactly the budget, which decide
nothing here; ratios to the base are paired.  After a kill the same command goes on with the seed
that was learning.
"""

from __future__ import annotations

import copy
import hashlib
import json
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import spoofgym.export
from agents.folder import Part, Records, error_lines, learning_versions, write_json
from agents.learning import learn, run_training
from agents.seeds import format_range
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.experiments.suite import list_standard_detectors
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.scores.at_budget import AlarmCurve, ratio_at_budget
from spoofgym.bench.scores.statistics import BUDGET
from spoofgym.bench.search.amplitude import EXACT
from spoofgym.core.progress import ProgressBar
from spoofgym.core.registry import check_choice
from spoofgym.detectors.calibrated import STANDARD_RATE
from spoofgym.policies import SpooferCard
from spoofgym.tasks import get_task

from .residual_ppo import (
    KNOWLEDGE,
    OPEN_LOOP,
    freeze,
    get_metres,
    make_model,
    play_base,
    scale_rates,
)

TASK, (BLIND, STATISTICS), POSITION = "S1", KNOWLEDGE, "position"
SEES = {**KNOWLEDGE, POSITION: f"{KNOWLEDGE[BLIND]}+reported"}
"""What corrections are of; *position* is what the victim reports, beside what is seen blind."""
WORLD = get_task(TASK).world_kwargs
ROOT = Path(__file__).resolve().parents[1]
SHIPPED, SCORES = ROOT / "agents" / "s1", ROOT / "docs" / "learned.json"
CAMPAIGN = ROOT / "docs" / "headlines.json"
CHOICE, FINAL = 1, 0
"""Entropy of the runs of choices, and of those of the README."""
CASES = {
    "cumulative-bank": ("cumulative-bank(signals=range_rate)", 3.0),
    "snapshot-chi2": ("snapshot-chi2", 3.0),
    "aime": ("aime(signals=range_rate)", 3.0),
    "sequential-chi2": ("sequential-chi2(signals=range_rate)", 3.0),
    "same-filter": ("solution-separation(spacing=geometric)", 7.0),
    "own-filter": ("solution-separation(filter=augmented,spacing=geometric)", 30.0),
}
"""Labels of detectors, and CPU minutes of a training of 600,000 decisions with its scores, roughly.
Against the others of the suite the searched attack goes as far as its limits permit."""
LEARN: dict[str, Any] = {"learning_rate": 1e-4, "n_epochs": 4}
"""Many episodes an update and small steps, since few of them alarm."""
EXPLORE, PROBES = {"use_sde": True}, 256
LOG_STDS = (-2.0, -3.0, -4.0, -4.5, -5.0, -5.5, -6.0)
"""Corrections are explored by one draw an episode (gSDE), since what changes between decisions
is seen.  Logarithms of the first spread: taken is the widest with which at most `BUDGET` more of
the episodes alarm than by the base alone.  Where all of them alarm a learner learns to be quiet,
and nothing of what pays."""


HEAD = (
    *("detector", "sees", "over its base on choice runs, each seed", "base [m]"),
    *("PPO, median and range of the seeds beyond it [m]", "over its base, each of these"),
)


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    out: Path = Path("runs/suite")  # Folder of the results.
    detectors: tuple[str, ...] = tuple(CASES)  # Of the README's table.
    knowledge: str = STATISTICS  # What corrections are of: statistics, position or blind.
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)  # One training each.
    steps: int = 600_000  # Decisions of all receivers together.
    checkpoints: int = 4  # Of a training, of which one or the base is taken.
    num_envs: int = 1024  # Receivers side by side.
    choice_runs: int = 256  # On which all is chosen.
    runs: int = 256  # Of the README's table.
    list: bool = False  # Only say what is trained, and how long it takes.
    score: bool = False  # Score the shipped cards again, into docs/learned.json.

    def __post_init__(self) -> None:
        for name in self.detectors:
            check_choice("detector", name, CASES)
        check_choice("knowledge", self.knowledge, SEES)


@cache
def list_specs() -> dict[str, dict[str, Any]]:
    """Detectors of the standard suite by their labels, with their rate of false alarms."""
    rate = {"false_alarms_per_hour": STANDARD_RATE}
    specs = [{**rate, **each} for each in list_standard_detectors(get_task(TASK))]
    return {specify_detector(spec).label: spec for spec in specs}


@cache
def make_judge(label: str, runs: int, entropy: int) -> Evaluator:
    sizes: dict[str, Any] = {"runs": runs, "fit_runs": runs, "rule": EXACT, "entropy": entropy}
    return Evaluator(detector=list_specs()[label], **WORLD, **sizes)


def find_base(label: str, choice_runs: int) -> dict[str, Any]:
    """Open-loop attack of the standard suite at the budget on choice runs, and how far it gets."""
    cells = json.loads(CAMPAIGN.read_text())["worlds"][TASK]["cells"]
    (found,) = (
        cell["spoofer_settings"]["rates_mps"]
        for cell in cells
        if cell["detector"] == label and cell["spoofer"] == OPEN_LOOP
    )
    spec = {"name": OPEN_LOOP, "rates_mps": found}
    fit = make_judge(label, choice_runs, CHOICE).fit(play_base(OPEN_LOOP, make_env(spec, BLIND)))
    found = scale_rates(spec, fit.value)
    price_m = find_price(fit.trace)
    reached = {"choice_m": get_metres(fit.at_budget), "price_m": round(price_m, 1)}
    return {"spec": found, **reached, **find_spread(label, found)}


def find_price(curve: AlarmCurve) -> float:
    """Price of an alarm [m] at which the base breaks even at the budget: what a larger amplitude
    gains by the alarms that it adds, around the budget, or up to it where nothing is gained
    beyond."""
    reached = curve.displacement[MEASURES[0]].mean(axis=1)
    alarms = curve.alarmed.mean(axis=1)
    for part in (slice(None), curve.amplitudes <= curve.chosen):
        price_m = float(np.polyfit(alarms[part], reached[part], 1)[0])
        if price_m > 0.0:
            return price_m
    raise ValueError(f"no amplitude below the budget's gets less far: {reached} m at {alarms}")


def make_env(spec: dict[str, Any], knowledge: str) -> dict[str, Any]:
    """Corrections of the command that the searched attack gives, its acceleration: a base that is
    played by wanted rates turns at every decision, and gets less far."""
    action = {"name": "residual", "spoofer": spec, "action": [{"name": "along-target"}]}
    return {"knowledge": SEES[knowledge], "action": action}


def set_env(label: str, spec: dict[str, Any], knowledge: str = STATISTICS) -> dict[str, Any]:
    return {**WORLD, "detector": list_specs()[label], **make_env(spec, knowledge)}


def find_spread(label: str, spec: dict[str, Any]) -> dict[str, Any]:
    """First spread of corrections, and the share of episodes that alarm by the base alone and by
    each that was tried."""
    own = set_env(label, spec)
    shares = {"base": explore(own, None)}
    for log_std in LOG_STDS:
        share = shares[f"{log_std:g}"] = explore(own, log_std)
        if share <= shares["base"] + BUDGET:
            break
    return {"log_std": log_std, "explored_alarms": shares}


def explore(own: dict[str, Any], log_std: float | None) -> float:
    """Share of episodes that alarm when a base is explored; without a spread by the base alone."""
    model = make_model(own, 0.0, 0, PROBES, log_std=log_std or 0.0, **EXPLORE)
    envs = model.get_env()
    with closing(envs):
        seen, alarmed, over = envs.reset(), np.zeros(PROBES, bool), np.zeros(PROBES, bool)
        model.policy.reset_noise(PROBES)
        while not over.all():
            seen, _, ends, _ = envs.step(model.predict(seen, deterministic=log_std is None)[0])
            alarmed |= (envs.unwrapped.result.info["cost"] > 0.0) & ~over
            over |= ends
    return float(alarmed.mean())


def train(settings: Settings, case: str, base: dict[str, Any], seed: int) -> dict[str, Any]:
    """One training; the checkpoint that gets farthest on the choice runs goes to a file."""
    label, _ = CASES[case]
    own = set_env(label, base["spec"], settings.knowledge)
    how = {"log_std": base["log_std"], **LEARN, **EXPLORE}
    model = make_model(own, base["price_m"], seed, settings.num_envs, **how)
    judge, reached = make_judge(label, settings.choice_runs, CHOICE), [base["choice_m"]]
    states, why, began = [], None, time.process_time()
    for _ in range(settings.checkpoints):
        why = why or learn(model, settings.steps // settings.checkpoints, reset_num_timesteps=False)
        if why is None:
            reached.append(get_metres(judge.fit(freeze(model)).at_budget))
            norm = model.get_vec_normalize_env()
            states.append(copy.deepcopy((model.policy.state_dict(), norm.obs_rms)))
    best = int(np.argmax(reached))
    row: dict[str, Any] = {
        "case": case,
        "knowledge": settings.knowledge,
        "seed": seed,
        "price_m": base["price_m"],
        "log_std": base["log_std"],
        "steps": model.num_timesteps,
    }
    row |= {"choice_m": reached, "checkpoint": best, "diverged": why, "file": None}
    row["cpu_s"] = round(time.process_time() - began)
    if best:
        weights, model.get_vec_normalize_env().obs_rms = states[best - 1]
        model.policy.load_state_dict(weights)
        row["file"] = f"{TASK.lower()}-{name_training(settings, case, seed, '-')}.onnx"
        SHIPPED.mkdir(exist_ok=True)
        origin = {**row, "decided_on": [[CHOICE, "evaluation"]]}
        spoofgym.export.onnx(model, model.get_env(), SHIPPED / row["file"], training=origin)
    model.get_env().close()
    return row


def name_training(settings: Settings, case: str, seed: int, between: str) -> str:
    sees = () if settings.knowledge == STATISTICS else (settings.knowledge,)
    return between.join((case, *sees, str(seed)))


def score_policy(path: Path, runs: int) -> dict[str, Any]:
    """Score of a policy on the runs of the README, and paired with that of the base on its card."""
    card = SpooferCard.load(path.with_suffix(".json"))
    label = specify_detector(card.env_kwargs["detector"]).label
    (term,) = (each for each in card.env_kwargs["action"] if each["name"] == "residual")
    judge = make_judge(label, runs, FINAL)
    kept, base = (
        judge.fit(str(path)),
        judge.fit(play_base(OPEN_LOOP, make_env(term["spoofer"], BLIND))),
    )
    ratio = ratio_at_budget(kept.trace, base.trace, BUDGET).as_json()
    kept_of_card = ("knowledge", "seed", "price_m", "steps", "choice_m")
    origin = {name: card.training[name] for name in kept_of_card if name in card.training}
    scores = {"score": kept.at_budget, "base": base.at_budget, "ratio": ratio}
    return {"detector": label, "file": path.name, **origin, **scores, "amplitude": kept.value}


def list_parts(settings: Settings) -> dict[str, Part]:
    """Bases and trainings, in their order."""
    parts: dict[str, Part] = {}
    names = "steps", "checkpoints", "num_envs", "choice_runs"
    sizes = {each: getattr(settings, each) for each in names}
    for case in settings.detectors:
        label, base = CASES[case][0], f"base {case}"
        find = lambda *_, x=label: find_base(x, settings.choice_runs)  # noqa: E731
        parts[base] = Part({"choice_runs": settings.choice_runs}, find)
        for seed in settings.seeds:
            make = lambda done, _, x=case, b=base, k=seed: train(settings, x, done[b], k)  # noqa: E731
            name = name_training(settings, case, seed, " ")
            parts[name] = Part(sizes, make, after=(base,))
    return parts


def play(settings: Settings, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Train what is missing, or score the shipped cards; the results, JSON-able."""
    config = {"task": TASK, "versions": learning_versions()}
    kept = json.loads(SCORES.read_text())
    if not settings.score:
        found = Records("suite-ppo", config, list_parts(settings)).play(settings.out, progress)
        done = {name: each for name, each in found.items() if "checkpoint" in each}
        write_json(SCORES, {**kept, "trained": {**kept["trained"], **done}})
        return found
    parts = {
        path.stem: Part(
            {"runs": settings.runs, "file": hashlib.sha256(path.read_bytes()).hexdigest()},
            lambda *_, x=path: score_policy(x, settings.runs),
        )
        for path in sorted(SHIPPED.glob("*.onnx"))
    }
    found = Records("suite-ppo-cards", config, parts).play(settings.out / "scores", progress)
    write_json(SCORES, {**kept, "runs": settings.runs, "policies": found})
    return found


def build_table(results: dict[str, Any]) -> str:
    """A line of Markdown for each training, or for each shipped policy that was scored."""
    lines = []
    for name, each in results.items():
        if "ratio" in each:
            scores = [interval(each[x][MEASURES[0]]) for x in ("score", "base")]
            lines.append((name, *scores, interval(each["ratio"], 2)))
        elif "checkpoint" in each:
            base, *reached = (f"{x:.1f}" for x in each["choice_m"])
            lines.append((name, ", ".join(reached), base, f"checkpoint {each['checkpoint']}"))
    return Table.of_texts("policy", "score [m]", "base [m]", "over its base, or taken").markdown(
        lines
    )


def tabulate(kept: dict[str, Any]) -> str:
    """A line of Markdown for each detector, of what is kept in docs/learned.json."""
    lines = []
    for (case, (label, _)), sees in product(CASES.items(), (STATISTICS, POSITION, BLIND)):
        rows = [each for each in kept["trained"].values() if each["knowledge"] == sees]
        trained = [each for each in rows if each["case"] == case]
        if trained:
            chosen = [max(each["choice_m"]) / each["choice_m"][0] for each in trained]
            rows = [each for each in kept["policies"].values() if each["knowledge"] == sees]
            scored = [each for each in rows if each["detector"] == label]
            scored.sort(key=lambda each: each["seed"])
            reached = [get_metres(each["score"]) for each in scored]
            lines.append((
                *(f"`{label}`", sees, ", ".join(f"{each:.2f}" for each in chosen)),
                interval(scored[0]["base"][MEASURES[0]]) if scored else "-",
                format_range(reached) if reached else "-",
                "; ".join(interval(each["ratio"], 2) for each in scored) or "-",
            ))  # fmt: skip
    return Table.of_texts(*HEAD).markdown(lines)


def list_plan(settings: Settings) -> Iterator[str]:
    """What is trained, and its CPU hours."""
    for name in settings.detectors:
        hours = CASES[name][1] * settings.steps / 600_000 * len(settings.seeds) / 60.0
        yield f"{name}: {len(settings.seeds)} trainings, about {hours:.2f} CPU hours"


@error_lines()
def main() -> None:
    run_training(Settings, __doc__, play, build_table, list_plan)


if __name__ == "__main__":
    main()
