"""Train spoofers by plain PPO of stable-baselines3, several seeds, and score them by the benchmark.

    python -m train.ppo_spoofer --task T3 --out runs/t3

For every seed PPO learns on `SpoofVecEnv`, from nothing.  Now and then the amplitude of the policy
is fitted to the alarm budget on training runs (`ScoreCallback`), and the best one is kept as an
ONNX file with its card.  At the end all of them play evaluation runs, which decided nothing, beside
rivals and beside the network as it was before it learned, all fitted.

The folder gets `results.json`, `curve.png`, the policy of the seed that was best on training runs,
`NAME.onnx` with `NAME.json`, and a folder for each seed.  After a kill the same command goes on
from the last checkpoint, to the same result: each stage of learning starts new episodes with random
numbers of its own.

What is not a default of PPO or of the environment, and why:

1. A decision every ten seconds, between which the rate changes linearly: 15 of them in place of 300
   are what an alarm is blamed on, and exploration has no jumps, which tests of range rates see.
2. `gamma` = 1: what is scored is not discounted; `n_steps` is an episode; few receivers side by
   side, with `gae_lambda` near to it, since the policy moves only so far at every update.
3. `log_std_init` = -1.5: at the library's 0 every episode alarms; `learning_rate` falls from 1e-3.
4. `VecNormalize`: observations and rewards in units of their own standard deviations, so that one
   set of settings suits detectors that allow for metres and for hundreds of metres.  Rewards are
   not clipped: an alarm costs more than the ten deviations at which the library cuts them.
5. The environment's action is a wanted rate, and an action of 1 all through the attack goes four
   lengths (alert limits, or `length_m`) far: exploration is no louder than what it looks for.
6. `average`: the average of the weights over some ten updates is scored, since one of them jitters.
7. The price of an alarm follows the budget, as a Lagrange multiplier: a policy that has to be
   scaled down pays more from then on, one that could be scaled up pays less.
"""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecNormalize

from agents.checkpoint import load_checkpoint, save_checkpoint
from agents.curve import draw_curves
from agents.folder import (
    Part,
    Records,
    error_lines,
    format_command,
    json_object,
    learning_versions,
    write_json,
)
from agents.learning import LEAST, MOST, Steps, for_learning, learn, next_price, set_price
from agents.record import read_record, write_record
from agents.seeds import LOUDEST, build_table, comparable, copy_policy, get_displacement
from agents.spoofer_table import RIVALS
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.experiments.identity import code_identity
from spoofgym.bench.report.table import Table
from spoofgym.bench.runs.players import FITTED, specify_policy
from spoofgym.bench.scores.spoofer import SpooferScore
from spoofgym.core.progress import ProgressBar, show_progress
from spoofgym.core.registry import check_choice, parse_spec
from spoofgym.core.settings import outside_sources
from spoofgym.sb3 import ScoreCallback, SpoofVecEnv
from spoofgym.spoofers import KNOWLEDGE
from spoofgym.tasks import ALARM_PRICE, get_task

CHECKPOINT, RECORD, RESULTS, PICTURE = "checkpoint.zip", "record.jsonl", "results.json", "curve.png"
STATE = ("stage", "spent_s", "untrained", "price")  # what a checkpoint keeps beside model, scores
RESUME_OPTIONS = (
    "out",
    "seeds",
    "rivals",
    "threads",
    "tensorboard",
    "json",
)  # may change when gone on with


@dataclass(frozen=True)
class Arguments:
    """Settings of a training; all but those of `RESUME_OPTIONS` are its identity, which a folder
    keeps."""

    out: Path  # Folder of the run; its last part is the name of the spoofer.
    task: str = "T3"  # Task, T1 to T6, whose world and detector it learns against.
    detector: str = ""  # Another detector in that world: name:key=value or JSON.
    knowledge: str = "blind"  # What it observes: blind, tracking or oracle, also with +reported.
    settings: str = "{}"  # Further settings of that world, as JSON, such as '{"attack": "quiet"}'.
    alarm_price: float = ALARM_PRICE  # What an alarm costs at first, in lengths.
    price_gain: float = 1.5  # The price is divided by this power of the amplitude; 0: it is fixed.
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)  # One training each: network, exploration, episodes.
    steps: int = 150_000  # Decisions of all receivers together, for each seed.
    num_envs: int = 32  # Receivers side by side.
    batch_size: int = 240  # Decisions of a minibatch.
    n_epochs: int = 10  # How often each rollout is learned from.
    learning_rate: float = 1e-3  # At first; it falls linearly to a tenth.
    gae_lambda: float = 0.98  # Of generalised advantage estimation; near to 1, as `gamma` is.
    log_std_init: float = -1.5  # Logarithm of the exploration at first, in parts of the full scale.
    full_scale_mps: float | None = None  # Rate of an action of 1; default: four lengths an attack.
    decision_interval_s: float | None = None  # 0: every epoch; by default some ten seconds.
    warm_pool: int | None = None
    """Receivers that are warmed up once: each episode that is learned from starts as a copy of one.
    None for warm-ups of their own, which scores always have."""
    length_m: float | None = None  # Unit of rewards and prices; by default the alert limit.
    average: float = 0.9  # How much of the averaged weights stays at every update; 0: none.
    stages: int = 12  # How often a policy is scored, and a checkpoint is written.
    fit_runs: int = 256  # Training runs, which fit amplitudes and choose the best policy.
    runs: int = 400  # Evaluation runs, which decide nothing.
    entropy: int = 0  # Seed of training and evaluation runs.
    rivals: tuple[str, ...] = RIVALS  # Spoofers to compare with; `--rivals` alone for none.
    threads: int | None = None  # Of the engine; all useful cores by default.
    tensorboard: bool = False  # Log for TensorBoard.
    json: bool = False  # Print the results as JSON, and nothing else.

    def __post_init__(self) -> None:
        """Check what stable-baselines3 and the environment do not check, or only later."""
        check_choice("knowledge", self.knowledge, KNOWLEDGE)
        get_task(self.task)  # or a message that lists them
        for name, low, high in (
            *((name, 1, math.inf) for name in ("steps", "num_envs", "batch_size", "n_epochs")),
            *((name, 1, math.inf) for name in ("stages", "fit_runs", "runs")),
            ("gae_lambda", 0.0, 1.0),
            ("alarm_price", *((LEAST, MOST) if self.price_gain else (0.0, math.inf))),
            ("price_gain", 0.0, 10.0),
            ("average", 0.0, 0.999),
            ("learning_rate", 0.0, 1.0),
            ("log_std_init", -20.0, 2.0),
            ("full_scale_mps", 1e-3, 1e3),
            *(("length_m", 0.1, 1e5), ("decision_interval_s", 0.0, 1e5)),
            ("warm_pool", 1, 1e6),
        ):
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                raise ValueError(f"`{name}` must be in [{low:g}, {high:g}], got {value}")
        if not self.seeds or len(set(self.seeds)) < len(self.seeds) or min(self.seeds) < 0:
            raise ValueError(f"`seeds` must be different numbers, 0 or more, got {self.seeds}")
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", self.out.name):
            raise ValueError(
                "the last part of `out` names the spoofer: letters, digits, dots, hyphens and "
                f"underscores, the first one a letter or digit; got {str(self.out)!r}"
            )
        _ = self.world  # or a message about `settings`
        for name in self.rivals:
            specify_policy(name, FITTED)

    @property
    def identity(self) -> dict[str, Any]:
        """What a run that is gone on with must share with the one before; JSON-able."""
        own = {name: value for name, value in asdict(self).items() if name not in RESUME_OPTIONS}
        return dict(json.loads(json.dumps({"name": self.out.name, **own})))

    @property
    def config(self) -> dict[str, Any]:
        """What a folder is of, besides the library."""
        return {"arguments": self.identity, "versions": learning_versions()}

    def folder(self, seed: int) -> Path:
        return self.out / f"seed-{seed}"

    def policy(self, seed: int) -> Path:
        """File of a seed's best policy."""
        return self.folder(seed) / f"{self.out.name}-{seed}.onnx"

    @property
    def world(self) -> dict[str, Any]:
        """World and detector, as `Evaluator` takes them: by the task, or by settings of their own.
        With a detector or settings of its own it is no longer the task."""
        given = json_object("settings", self.settings)
        if not self.detector and not given:
            return {"task": self.task}
        task = get_task(self.task)
        met = parse_spec(self.detector) if self.detector else task.detector
        return {**task.world_kwargs, "detector": met, **given}

    def make_envs(self) -> SpoofVecEnv:
        own: dict[str, Any] = {
            name: getattr(self, name) for name in ("knowledge", "threads", "warm_pool")
        }
        own |= self.world
        length_m = self.length_m or get_task(self.task).alert_limit_m
        if length_m is not None:
            own["length_m"] = length_m
        own = for_learning(own, self.full_scale_mps, self.decision_interval_s)
        return SpoofVecEnv(self.num_envs, **own)

    def command(self) -> str:
        return format_command(
            "train.ppo_spoofer", self, RESUME_OPTIONS, ["--seeds", *map(str, self.seeds)]
        )


def make_model(
    args: Arguments, seed: int, envs: VecNormalize, learning_rate: Callable[[float], float] | float
) -> PPO:
    """PPO with fresh weights; a rollout is an episode of every receiver."""
    n_steps = envs.venv.core.episode_steps
    return PPO(
        "MlpPolicy",
        envs,
        learning_rate=learning_rate,
        n_steps=n_steps,
        batch_size=min(args.batch_size, n_steps * args.num_envs),
        n_epochs=args.n_epochs,
        gamma=1.0,
        gae_lambda=args.gae_lambda,
        policy_kwargs={"log_std_init": args.log_std_init},
        seed=seed,
        device="cpu",
    )


@dataclass
class Training:
    """One seed: its environment, its model, and what has been found so far."""

    args: Arguments
    seed: int
    judge: Evaluator
    spent_s: float = 0.0
    stage: int = 0
    untrained: dict[str, Any] | None = None
    price: float = field(init=False)
    envs: VecNormalize = field(init=False)
    model: PPO = field(init=False)
    watch: ScoreCallback = field(init=False)

    def __post_init__(self) -> None:
        """Make a fresh model, and take over what its folder holds."""
        args = self.args
        self.price = args.alarm_price
        self.watch = ScoreCallback(
            judge=self.judge,
            every=args.steps,
            path=self.args.policy(self.seed),
            average=args.average,
            verbose=0,
        )
        self.envs = VecNormalize(args.make_envs(), gamma=1.0, clip_reward=math.inf)
        self.model = make_model(args, self.seed, self.envs, self._learning_rate)
        if args.tensorboard:
            self.model.set_logger(configure(str(self.folder / "tensorboard"), ["tensorboard"]))
        if (self.folder / CHECKPOINT).is_file():
            state = load_checkpoint(
                self.folder / CHECKPOINT, self.model, self.envs, self.policy_files
            )
            self.watch.restore(state["watch"])
            for name in STATE:
                setattr(self, name, state[name])

    @property
    def folder(self) -> Path:
        return self.args.folder(self.seed)

    @property
    def policy_files(self) -> tuple[Path, Path]:
        policy = self.args.policy(self.seed)
        return policy, policy.with_suffix(".json")

    def _learning_rate(self, _: float) -> float:
        """It falls over all stages, where the library knows of one."""
        taken = self.model.num_timesteps if hasattr(self, "model") else 0
        return self.args.learning_rate * (1.0 - 0.9 * min(taken / self.args.steps, 1.0))

    def run(self, tick: Callable[[float], None]) -> dict[str, Any]:
        """Learn from where it is to the end, a checkpoint after every stage; what came of it."""
        args, told = self.args, Steps(tick)
        if self.untrained is None:
            score = self.judge.score(self.model, label="untrained", largest_amplitude=LOUDEST)
            self.untrained = score.as_dict()
        while self.stage < args.stages and self.watch.diverged is None:
            began, scores = time.perf_counter(), len(self.watch.history)
            chance = np.random.SeedSequence([self.seed, self.stage])
            self.model.set_random_seed(int(chance.generate_state(1)[0]))
            self.model.set_env(self.envs)  # which makes the stage start with new episodes
            set_price(self.envs.venv, self.price)
            until = args.steps * (self.stage + 1) // args.stages
            why = learn(
                self.model,
                until - self.model.num_timesteps,
                callback=[self.watch, told],
                reset_num_timesteps=False,
            )
            if why is not None:
                self.watch.give_up(why)
            self.stage += 1
            if len(self.watch.history) > scores:
                amplitude = self.watch.history[-1][1].value
                self.price = next_price(self.price, amplitude, args.price_gain)
            self.spent_s += time.perf_counter() - began
            self.save()
        self.envs.close()
        found = self.watch.best_step >= 0
        return {
            "seed": self.seed,
            "steps": self.model.num_timesteps,
            "wall_s": round(self.spent_s, 1),
            "diverged": self.watch.diverged,
            "chosen_at": self.watch.best_step if found else None,
            "training_m": self.watch.best_m if found else None,
            "untrained": self.untrained,
        }

    def save(self) -> None:
        """Write the learning curve and a checkpoint, whole or not at all."""
        points = [
            {
                "step": step,
                "wall_s": round(self.spent_s * step / max(self.model.num_timesteps, 1), 1),
                "stealthy_m": found.score,
                "alarm_rate": found.chosen.alarm_rate,
                "amplitude": found.value,
                "within_budget": found.within_budget,
            }
            for step, found in self.watch.history
        ]
        write_record(self.folder / RECORD, points)
        state = {name: getattr(self, name) for name in STATE} | {"watch": self.watch.state()}
        save_checkpoint(self.folder / CHECKPOINT, self.model, self.envs, state, self.policy_files)


def score_seed(
    args: Arguments, judge: Evaluator, found: Mapping[str, Any], rivals: Mapping[str, SpooferScore]
) -> dict[str, Any]:
    """What a seed has reached on evaluation runs, JSON-able."""
    if found["chosen_at"] is None:
        return {"score": None}
    score = judge.score(str(args.policy(found["seed"])), amplitude=None)
    known = {name: rival.knowledge for name, rival in rivals.items()}
    ratios = {
        name: score.ratio_to(rivals[name], oracles=True).as_json()
        for name in comparable(known, score.knowledge)
    }
    return {"score": score.as_dict(), "ratios": ratios}


def train(args: Arguments, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Train all seeds that are not finished, score and compare them; the results, JSON-able."""
    played = {name: getattr(args, name) for name in ("runs", "fit_runs", "entropy", "threads")}
    judge = Evaluator(**played, **args.world)
    args.make_envs().close()  # or what is wrong with them, before there is a folder
    for name in args.rivals:
        judge.check(name)
    whom = {"rivals": args.rivals, "outside": outside_sources(*args.rivals)}
    parts: dict[str, Part] = {}
    seeds, scores = ([f"{what}-{seed}" for seed in args.seeds] for what in ("seed", "score"))
    for seed, key in zip(args.seeds, seeds, strict=True):
        make = lambda _, context, k=seed: Training(args, k, judge).run(context.tick)  # noqa: E731
        parts[key] = Part({}, make, work=args.steps)
    met = cache(lambda: {name: judge.score(name) for name in args.rivals})
    parts["rivals"] = Part(whom, lambda *_: {name: x.as_dict() for name, x in met().items()})
    for key, seed in zip(scores, seeds, strict=True):
        make = lambda before, _, k=seed: score_seed(args, judge, before[k], met())  # noqa: E731
        parts[key] = Part(whom, make, (seed,))
    found = Records("ppo-spoofer", args.config, parts).play(args.out, progress)
    kept = [found[key] for key in seeds if found[key]["chosen_at"] is not None]
    best = max(kept, key=lambda row: row["training_m"], default={"seed": None})["seed"]
    if best is not None:
        told = {"command": args.command(), "arguments": args.identity}
        copy_policy(args.policy(best), args.out / f"{args.out.name}.onnx", told)
    curves = {f"seed {seed}": read_record(args.folder(seed) / RECORD) for seed in args.seeds}
    known = {name: each["knowledge"] for name, each in found["rivals"].items()}
    levels = {
        name: get_displacement(found["rivals"][name]) for name in comparable(known, args.knowledge)
    }
    draw_curves(curves, args.out / PICTURE, levels)
    rows = [{**found[key], **found[score]} for key, score in zip(seeds, scores, strict=True)]
    rows = [{name: x for name, x in row.items() if name != "training_m"} for row in rows]
    return {
        "command": args.command(),
        "versions": {**code_identity(), **learning_versions()},
        "detector": judge.detector.label,
        "kept": best,
        "seeds": rows,
        "rivals": found["rivals"],
    }


@error_lines()
def main() -> None:
    args = tyro.cli(Arguments, description=__doc__)
    torch.set_num_threads(1)  # more of them fight with those of the engine
    results = train(args, show_progress)
    write_json(args.out / RESULTS, results)
    if args.json:
        print(json.dumps(results, indent=1, allow_nan=False))
    else:
        title, head, rows = build_table(results)
        Table.of_texts(*head).print(title, rows)
        print(f"written: {args.out}")


if __name__ == "__main__":
    main()
