"""Plain PPO that corrects searched attacks against solution separation, trained on replay.

    python -m train.replay_ppo --list                 # what it trains, and its CPU hours
    python -m train.replay_ppo --out runs/replay      # all tasks, then confirmed on the engine
    python -m train.replay_ppo --tasks S2 S1:60 --seeds 0   # and S1 with attacks of 60 s
    python -m train.replay_ppo --ship                 # the results into docs/ and agents/, too

The detector of S1 to S3 has a filter of its own, which makes a decision on the engine some twelve
times as dear; its separations are linear in the attack, so that PPO learns on clean runs and their
responses (`train.replay_bank`), and only what is kept plays on the engine.  The base is the best of
the stored open-loop attack and a new search on the training runs, at exactly the alarm budget on
choice runs.  Of the checkpoints and the base the one is kept that gets farthest on these; scores
are of other runs, and ratios to the base paired.  After a kill the same command goes on.
"""

from __future__ import annotations

import copy
import hashlib
import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

import spoofgym.export
from agents.folder import Part, Records, error_lines, learning_versions, write_json
from agents.learning import learn, run_training
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.report.tasks import stored_cards
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.runs.world import World
from spoofgym.bench.scores.at_budget import AlarmCurve, ratio_at_budget, score_at_budget
from spoofgym.bench.scores.statistics import BUDGET
from spoofgym.bench.search.alarm_amplitude import trace_alarms
from spoofgym.bench.search.amplitude import EXACT, Tuning
from spoofgym.bench.search.open_loop import LONG, OpenLoopOptimizer
from spoofgym.core.progress import ProgressBar
from spoofgym.core.registry import check_choice
from spoofgym.core.settings import compute_digest, describe
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.tasks import get_task

from .replay_bank import (
    SEEN,
    Bank,
    BankBackend,
    BankRuns,
    BankVecEnv,
    Course,
    Policy,
    record_bank,
)
from .residual_ppo import KNOWLEDGE, OPEN_LOOP, get_metres, play_base, scale_rates
from .suite_ppo import EXPLORE, LEARN, LOG_STDS, find_price, make_env, score_policy
from .suite_ppo import TASK as README
from .suite_ppo import Settings as OfSuite

ROOT = Path(__file__).resolve().parents[1]
SHIPPED, SCORES = ROOT / "agents" / "replay", ROOT / "docs" / "learned_replay.json"
BLIND, STATISTICS = KNOWLEDGE
TASKS = {"S1": (1536, 512, 1.2), "S2": (768, 256, 1.2), "S3": (256, 128, 1.5)}
"""Runs to learn and to choose on, a third of them to choose; runs of scores; CPU hours of the runs
and of five seeds, roughly."""
FILTERS = {"own-filter": True, "same-filter": False}
"""Whether the task's solution separation has its filter, or works on that of the victim."""
RECORDING = 2
"""Of banks: another one where `record_bank` records something else."""
LEARNING, FINAL, CONFIRMED = 5, 7, 8
"""Entropy of the runs that are learned and chosen on, of those of scores, and of the engine's."""
BASE, POLICIES, RUNS = "base", "policies", OfSuite.runs
TRAINED, SCORED = "training", "evaluation"
HEAD = (
    *("task", "detector", "sees", "over its base on choice runs, each seed", "base [m]"),
    *("PPO, each seed beyond it [m]", "over its base, each of these"),
    *("shown the mean statistic", "on the engine", "alarms there [%]: base; PPO"),
)


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    out: Path = Path("runs/replay")  # Folder of the results.
    tasks: tuple[str, ...] = tuple(TASKS)  # In whose worlds; S1:60 with attacks of 60 s.
    detectors: tuple[str, ...] = ("own-filter",)  # Solution separation: own-filter, same-filter.
    knowledge: tuple[str, ...] = (STATISTICS, BLIND)  # What corrections are of.
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)  # One training each; blind the first alone.
    episodes: int = 40_960  # Of a training.
    checkpoints: int = 4  # Of a training, of which one or the base is taken.
    num_envs: int = 1024  # Receivers side by side.
    list: bool = False  # Only say what is trained, and how long it takes.
    ship: bool = False  # Take the results into docs/ and what got farther into agents/.

    def __post_init__(self) -> None:
        for word, given, valid in (
            ("task", [split_name(each)[0] for each in self.tasks], TASKS),
            ("detector", self.detectors, FILTERS),
            ("knowledge", self.knowledge, KNOWLEDGE),
        ):
            for each in given:
                check_choice(word, each, valid)

    def trainings(self, task: str) -> Iterator[tuple[str, str, int]]:
        for case, sees, seed in product(self.detectors, self.knowledge, self.seeds):
            if sees != BLIND or seed == self.seeds[0]:
                yield case, sees, seed


def split_name(name: str) -> tuple[str, float | None]:
    """A task, and how long attacks last if not as long as there: of S1:60, 60 s."""
    task, colon, seconds = name.partition(":")
    try:
        attack_s = float(seconds) if colon else None
    except ValueError:
        raise ValueError(f"after the colon of {name!r} seconds are wanted, as in S1:60") from None
    return task, attack_s


def get_sizes(name: str) -> tuple[int, int, float]:
    return TASKS[split_name(name)[0]]


def make_detector(task: str, case: str) -> dict[str, Any]:
    own = dict(get_task(split_name(task)[0]).detector)
    return own if FILTERS[case] else {k: x for k, x in own.items() if k != "filter"}


@cache
def make_world(task: str) -> World:
    key, attack_s = split_name(task)
    world = World.of(key)
    if attack_s is None:
        return world
    return world.copy_with(timeline={**world.settings["timeline"], "attack_s": attack_s})


@cache
def identify(task: str, case: str) -> str:
    """Digest of a world, its detector and the thresholds that this has there."""
    world, detector = make_world(task), specify_detector(make_detector(task, case))
    scales = [point.scale for point in world.points(detector)]
    known = {"world": world.config, "detector": detector.spec, "scales": scales}
    return compute_digest(describe({**known, "recording": RECORDING}))


@cache
def open_bank(out: Path, task: str, case: str, entropy: int, runs: int) -> Bank:
    """Recorded once, and stored."""
    words = task.replace(":", "-"), case, entropy, runs, identify(task, case)[:8]
    path = out / "banks" / f"{'-'.join(map(str, words))}.npz"
    if not path.is_file():
        world, split = make_world(task), TRAINED if entropy == LEARNING else SCORED
        found = record_bank(world, make_detector(task, case), split, entropy, runs)
        path.parent.mkdir(parents=True, exist_ok=True)
        trial = path.with_suffix(f".{os.getpid()}.partial")
        with trial.open("wb") as file:
            np.savez(file, **found._asdict())
        os.replace(trial, path)
    with np.load(path) as arrays:
        return Bank(**{name: arrays[name] for name in Bank._fields})


def split_bank(out: Path, task: str, case: str) -> tuple[Bank, Bank]:
    """Runs to learn on, and to choose on those of every third group of runs with one response: it
    is of a sky, start and age, and of sensors and view, by which groups of one start differ."""
    bank = open_bank(out, task, case, LEARNING, get_sizes(task)[0])
    chosen = bank.group % 3 == 0
    return bank.take(~chosen), bank.take(chosen)


def make_course(task: str, spec: Mapping[str, Any]) -> Course:
    return Course.of(make_world(task).setup, make_env(dict(spec), STATISTICS)["action"])


def correct_nothing(seen: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.zeros((len(seen), 1), dtype=np.float32)


def trace(bank: Bank, course: Course, policy: Policy = correct_nothing) -> AlarmCurve:
    runs = len(bank.sky)
    settings = Tuning(runs=runs, sift_runs=max(runs // 4, 1), rule=EXACT)
    return trace_alarms(BankRuns(bank, course, policy), settings)


def get_score(curve: AlarmCurve) -> dict[str, Any]:
    return score_at_budget(curve, BUDGET).as_json()


def find_base(out: Path, task: str, case: str) -> dict[str, Any]:
    """The best open-loop attack, at the budget on choice runs, and how far it and others get."""
    learned, chosen = split_bank(out, task, case)
    label = specify_detector(make_detector(task, case)).label
    stored = stored_cards().get(task, {}).get("optima_mps", {}).get(label)
    steps = make_world(task).setup.steps // make_world(task).setup.repeat
    ramp = make_course(task, {"name": OPEN_LOOP, "rates_mps": [0.0] * (steps - 1) + [0.01]})
    others = {} if stored is None else {"stored": np.asarray(stored)}
    found = OpenLoopOptimizer(BankBackend(learned, ramp), BUDGET, LONG).search(others)
    curves = {"found": found.rates_mps, **others}
    specs = {
        k: {"name": OPEN_LOOP, "rates_mps": np.round(x, 6).tolist()} for k, x in curves.items()
    }
    traces = {name: trace(chosen, make_course(task, spec)) for name, spec in specs.items()}
    reached = {name: get_metres(get_score(curve)) for name, curve in traces.items()}
    best = max(reached, key=lambda name: reached[name])
    spec = scale_rates(specs[best], get_score(traces[best])["amplitude"]["value"])
    price_m = round(find_price(traces[best]), 1)
    base = {"spec": spec, "tried_m": reached, "start": found.start, "price_m": price_m}
    base["choice_m"] = get_metres(get_score(trace(chosen, make_course(task, spec))))
    return {**base, **find_spread(learned, make_course(task, spec))}


def find_spread(bank: Bank, course: Course) -> dict[str, Any]:
    """First spread of corrections: the widest with which at most half of the budget more of the
    episodes alarm than by the base alone."""
    probe = bank.take(np.arange(0, len(bank.sky), max(len(bank.sky) // 256, 1)))
    shares = {"base": float(BankRuns(probe, course, correct_nothing).play(1.0)[0].mean())}
    for log_std in LOG_STDS:
        model = make_model(probe, course, False, 0.0, 0, len(probe.sky), log_std)
        share = shares[f"{log_std:g}"] = explore(probe, course, model)
        if share <= shares["base"] + 0.5 * BUDGET:
            break
    return {"log_std": log_std, "explored_alarms": shares}


def explore(bank: Bank, course: Course, model: PPO) -> float:
    """Share of runs that alarm while a model explores, with what is seen normalized."""
    norm = model.get_vec_normalize_env()
    assert norm is not None  # as of `make_model`

    def watch(seen: NDArray[np.float32]) -> NDArray[np.float32]:
        norm.obs_rms.update(seen)
        return correct_nothing(seen)

    def act(seen: NDArray[np.float32]) -> NDArray[np.float32]:
        return model.predict(norm.normalize_obs(seen))[0]

    BankRuns(bank, course, watch).play(1.0)
    model.policy.reset_noise(len(bank.sky))
    return float(BankRuns(bank, course, act).play(1.0)[0].mean())


def make_model(
    bank: Bank,
    course: Course,
    blind: bool,
    price_m: float,
    seed: int,
    num_envs: int,
    log_std: float,
) -> PPO:
    """PPO whose first corrections are 0 but for exploration."""
    envs = VecNormalize(BankVecEnv(bank, course, num_envs, price_m, seed, blind), gamma=1.0)
    steps = course.decisions
    part = max(k for k in range(1, 6) if steps % k == 0)  # of the decisions, without a rest
    how: dict[str, Any] = {"n_steps": steps, "batch_size": part * num_envs, "gamma": 1.0}
    how |= {**LEARN, **EXPLORE, "policy_kwargs": {"log_std_init": log_std}}
    model = PPO("MlpPolicy", envs, seed=seed, device="cpu", **how)
    with torch.no_grad():
        for each in model.policy.action_net.parameters():
            each.zero_()
    return model


class Narrowed(torch.nn.Module):
    """A policy of some elements of what the environment shows, with their normalization."""

    def __init__(self, model: PPO, names: tuple[str, ...] = SEEN) -> None:
        super().__init__()
        norm, policy = model.get_vec_normalize_env(), model.policy
        count = policy.observation_space.shape[0]
        self.columns = [names.index(name) for name in SEEN[:count]]
        self.body = copy.deepcopy(policy.mlp_extractor.policy_net)
        self.head, self.clip = copy.deepcopy(policy.action_net), float(norm.clip_obs)
        scale = np.sqrt(norm.obs_rms.var + norm.epsilon)
        for name, values in (("mean", norm.obs_rms.mean), ("scale", scale)):
            self.register_buffer(name, torch.as_tensor(values, dtype=torch.float32))

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        scaled = (seen[:, self.columns] - self.mean) / self.scale
        latent = self.body(torch.clamp(scaled, -self.clip, self.clip))
        return torch.clamp(self.head(latent), -1.0, 1.0)

    def act(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        with torch.no_grad():
            return self(torch.as_tensor(seen)).numpy()


def train(
    settings: Settings, task: str, case: str, sees: str, seed: int, base: dict[str, Any]
) -> dict[str, Any]:
    """One training, the choice of a checkpoint, its file, and its score on other runs."""
    began = time.process_time()
    learned, chosen = split_bank(settings.out, task, case)
    course = make_course(task, base["spec"])
    plan = base["price_m"], seed, settings.num_envs, base["log_std"]
    model = make_model(learned, course, sees == BLIND, *plan)
    policies, why, reached = [], None, [base["choice_m"]]
    for _ in range(settings.checkpoints):
        steps = settings.episodes * course.decisions // settings.checkpoints
        why = why or learn(model, steps, reset_num_timesteps=False)
        if why is None:
            policies.append(Narrowed(model))
            reached.append(get_metres(get_score(trace(chosen, course, policies[-1].act))))
    best = int(np.argmax(reached))
    row: dict[str, Any] = {"task": task, "case": case, "knowledge": sees, "seed": seed}
    row |= {"steps": model.num_timesteps, "choice_m": reached, "checkpoint": best}
    row |= {"diverged": why, "file": None}
    final = open_bank(settings.out, task, case, FINAL, get_sizes(task)[1])
    other = trace(final, course)
    own = trace(final, course, policies[best - 1].act) if best else other
    row |= {"score": get_score(own), "base": get_score(other)}
    row["ratio"] = ratio_at_budget(own, other, BUDGET).as_json()
    if best:
        act = policies[best - 1].act
        if sees == STATISTICS:
            still = trace(final, course, average_statistic(chosen, course, act))
            row["averaged"] = ratio_at_budget(still, other, BUDGET).as_json()
        file = write_policy(settings.out, task, case, base, policies[best - 1], row)
        row |= {"file": file.name, "sha256": compute_file_digest(file)}
    row["cpu_s"] = round(time.process_time() - began)
    return row


def average_statistic(bank: Bank, course: Course, act: Policy) -> Policy:
    """A control: the policy that is shown, at each decision, the mean statistic that it meets on
    runs of a bank, and not that of its own run."""
    means: list[float] = []

    def watch(seen: NDArray[np.float32]) -> NDArray[Any]:
        means.append(float(seen[:, -1].mean()))
        return act(seen)

    def average(seen: NDArray[np.float32]) -> NDArray[Any]:
        given = seen.copy()
        given[:, -1] = means[round(float(seen[0, 2]) * course.decisions)]
        return act(given)

    BankRuns(bank, course, watch).play(1.0)
    return average


def compute_file_digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_policy(
    out: Path, task: str, case: str, base: dict[str, Any], policy: Narrowed, row: dict[str, Any]
) -> Path:
    """File and card of what was kept."""
    env = {**make_env(base["spec"], row["knowledge"]), "detector": make_detector(task, case)}
    shown = SpoofVecEnv(1, **{**make_world(task).settings, **env})
    actor = copy.deepcopy(policy)
    names = shown.observation_names
    actor.columns = [names.index(name) for name in SEEN[: len(policy.columns)]]
    blind = f"-{BLIND}" if row["knowledge"] == BLIND else ""
    name = task.lower().replace(":", "-")
    path = out / POLICIES / f"{name}-{case}{blind}-{row['seed']}.onnx"
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = ("steps", "seed", "knowledge", "choice_m", "checkpoint")
    origin = {"algorithm": "PPO", "case": case, **{name: row[name] for name in kept}}
    origin |= {"price_m": base["price_m"], "decided_on": [[LEARNING, TRAINED]]}
    spoofgym.export.onnx(actor, shown, path, training=origin)
    shown.close()
    return path


def find_policy(out: Path, row: Mapping[str, Any]) -> Path:
    """File of a row, as it was written for it."""
    path = out / POLICIES / row["file"]
    if not path.is_file() or compute_file_digest(path) != row["sha256"]:
        raise ValueError(f"{path} is not the file that this training wrote: train it again")
    return path


def confirm(
    out: Path, task: str, case: str, rows: dict[str, Any], base: dict[str, Any]
) -> dict[str, Any]:
    """What was kept and its base on the engine, at the amplitudes of the replay, on fresh runs,
    each of an age of its own."""
    own = {**make_world(task).settings, "detector": make_detector(task, case)}
    judge = Evaluator(runs=get_sizes(task)[1], entropy=CONFIRMED, **own)
    still = play_base(OPEN_LOOP, make_env(base["spec"], BLIND))
    found = {}
    for name, row in {BASE: next(iter(rows.values())), **rows}.items():
        if name != BASE and row["file"] is None:
            continue
        replayed = row["base" if name == BASE else "score"]
        policy: Any = still if name == BASE else str(find_policy(out, row))
        score = judge.score(policy, amplitude=replayed["amplitude"]["value"])
        found[name] = {
            "alarm_rate": score.alarm_rate.as_json(),
            MEASURES[0]: score.stealthy_displacement_m.as_json(),
        }
    return found


def score_best_seed(out: Path, rows: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Score on the engine, on the runs of the README's table, of the seed with statistics that got
    farthest on choice runs; None where none got farther than its base."""
    kept = [row for row in rows if row["file"] and row["knowledge"] == STATISTICS]
    if not kept:
        return None
    best = max(kept, key=lambda row: max(row["choice_m"]))
    return score_policy(find_policy(out, best), RUNS)


def list_parts(settings: Settings) -> dict[str, Part]:
    """Bases, trainings and confirmations, in their order."""
    parts: dict[str, Part] = {}
    for task, case in product(settings.tasks, settings.detectors):
        parts |= list_case(settings, task, case)
    return parts


def list_case(settings: Settings, task: str, case: str) -> dict[str, Part]:
    """Those of one detector in one task."""
    out, base = settings.out, f"{task} {case} base"
    sizes = {name: getattr(settings, name) for name in ("episodes", "checkpoints", "num_envs")}
    own = {"runs": get_sizes(task), "of": identify(task, case)}
    trainings = {
        f"{task} {case} {sees} {seed}": (sees, seed)
        for of, sees, seed in settings.trainings(task)
        if of == case
    }
    names = tuple(trainings)

    def find(*_: Any) -> dict[str, Any]:
        return find_base(out, task, case)

    def train_one(sees: str, seed: int, done: dict[str, Any], _: Any) -> dict[str, Any]:
        return train(settings, task, case, sees, seed, done[base])

    def check(done: dict[str, Any], _: Any) -> dict[str, Any]:
        return confirm(out, task, case, {name: done[name] for name in names}, done[base])

    def score(done: dict[str, Any], _: Any) -> dict[str, Any] | None:
        return score_best_seed(out, [done[name] for name in names])

    parts = {base: Part(own, find, work=4.0)}
    for name, each in trainings.items():
        parts[name] = Part({**sizes, **own}, partial(train_one, *each), after=(base,))
    whole = {**sizes, **own, "trained": [*names]}
    parts[f"{task} {case} engine"] = Part(whole, check, after=(base, *names), work=4.0)
    if task == README:
        parts[f"{task} {case} readme"] = Part(whole, score, after=names, work=10.0)
    return parts


def play(settings: Settings, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Train what is missing; the results, JSON-able."""
    config = {"versions": learning_versions()}
    found = Records("replay-ppo", config, list_parts(settings)).play(settings.out, progress)
    if settings.ship:
        ship(settings, found)
    return found


def ship(settings: Settings, found: dict[str, Any]) -> None:
    """Results into docs/, beside those of other tasks and seeds, and policies into agents/."""
    kept = json.loads(SCORES.read_text()) if SCORES.is_file() else {}
    for name, each in found.items():
        before = kept.get(name)
        if name.endswith(" engine") and before:
            if before[BASE] != each[BASE]:
                raise ValueError(f"{name}: {SCORES.name} has a base of other runs or sizes")
            each = {**before, **each}
        kept[name] = each
        if each and each.get("sha256"):
            path = find_policy(settings.out, each)
            SHIPPED.mkdir(exist_ok=True)
            for part in (path, path.with_suffix(".json")):
                shutil.copy(part, SHIPPED / part.name)
    write_json(SCORES, kept)


def build_table(results: dict[str, Any]) -> str:
    """A line of Markdown for each task, detector and knowledge."""
    lines = []
    tasks = sorted({name.partition(" ")[0] for name in results})
    for task, case, sees in product(tasks, FILTERS, reversed(KNOWLEDGE)):
        names = [name for name in results if name.startswith(f"{task} {case} {sees} ")]
        if not names:
            continue
        rows, engine = [results[name] for name in names], results[f"{task} {case} engine"]
        gains = [max(row["choice_m"]) / row["choice_m"][0] for row in rows]
        beyond = [row for row in rows if row["file"]]
        played = [engine[name] for name, row in zip(names, rows, strict=True) if row["file"]]
        over = [get_metres(x) / get_metres(engine[BASE]) for x in played]
        alarms = [f"{100.0 * each['alarm_rate']['value']:.1f}" for each in (engine[BASE], *played)]
        lines.append((
            *(task, case, sees, ", ".join(f"{x:.2f}" for x in gains)),
            interval(rows[0]["base"][MEASURES[0]]),
            ", ".join(f"{get_metres(row['score']):.1f}" for row in beyond) or "-",
            "; ".join(interval(row["ratio"], 2) for row in beyond) or "-",
            "; ".join(interval(row["averaged"], 2) for row in beyond if "averaged" in row) or "-",
            ", ".join(f"{x:.2f}" for x in over) or "-",
            f"{alarms[0]}; {', '.join(alarms[1:]) or '-'}",
        ))  # fmt: skip
    return Table.of_texts(*HEAD).markdown(lines)


def list_plan(settings: Settings) -> Iterator[str]:
    """What is trained, and its CPU hours."""
    for task in settings.tasks:
        count = len([*settings.trainings(task)])
        hours = get_sizes(task)[2]
        yield f"{task}: {count} trainings, about {hours:.1f} CPU hours with the runs recorded"


@error_lines()
def main() -> None:
    run_training(Settings, __doc__, play, build_table, list_plan)


if __name__ == "__main__":
    main()
