"""Train spoofers by plain PPO of stable-baselines3, several seeds, and score them by the benchmark.

    python -m train.ppo_spoofer --task T3 --out runs/t3

For every seed PPO learns on `SpoofVecEnv`, from nothing.  Now and then the amplitude of the policy
is fitted to the alarm budget on training runs (`ScoreCallback`), and the best one is kept as an
ONNX file with its card.  At the end all of them play evaluation runs, which decided nothing, beside
the tuned ramps and the blind optimum of the same runs, and beside the network as it was before it
learned, its amplitude fitted, too.

After a kill the same command goes on from the last checkpoint, to the same result: each stage of
learning starts new episodes with random numbers of its own.

The folder gets `results.json`, `curve.png`, the policy of the seed that was best on training runs,
`NAME.onnx` with `NAME.json`, and a folder for each seed with learning curve, checkpoint and policy.

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
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from rich.console import Console
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env import VecNormalize

from agents.checkpoint import load_checkpoint, save_checkpoint
from agents.curve import draw_curves
from agents.folder import command_of, error_lines, json_object, open_folder, used_versions
from agents.learning import LEAST, MOST, Bar, for_learning, learn, next_price, set_price
from agents.record import TrainingRecord, read_record
from agents.seeds import LOUDEST, comparable, copy_policy, table_of
from agents.spoofer_table import RIVALS
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.runs.players import FITTED, specify_policy
from spoofgym.bench.scores.spoofer import Score
from spoofgym.core.files import write_file
from spoofgym.core.progress import show_progress
from spoofgym.core.registry import check_choice, parse_spec
from spoofgym.sb3 import ScoreCallback, SpoofVecEnv
from spoofgym.spoofers import KNOWLEDGE
from spoofgym.tasks import ALARM_PRICE, task_of

CHECKPOINT, RECORD, RESULTS, PICTURE = "checkpoint.zip", "record.jsonl", "results.json", "curve.png"
STATE = ("stage", "spent_s", "untrained", "price")  # what a checkpoint keeps beside model, scores
FREE = ("out", "seeds", "rivals", "threads", "tensorboard", "json")  # may change when gone on with


@dataclass(frozen=True)
class Arguments:
    """Settings of a training; all but those of `FREE` are its identity, which a folder keeps."""

    out: Path  # Folder of the run; its last part is the name of the spoofer.
    task: str = "T3"
    """Task of spoofgym-bench-v1, T1 to T6, whose world and detector it learns against."""
    detector: str = ""
    """Another detector in that world: a name, with settings as name:key=value or JSON."""
    knowledge: str = "blind"
    """What it observes: blind, tracking or oracle, each also with +reported."""
    settings: str = "{}"  # Further settings of that world, as JSON, such as '{"attack": "quiet"}'.
    alarm_price: float = ALARM_PRICE  # What an alarm costs at first, in lengths.
    price_gain: float = 1.5
    """After a score the price is divided by this power of the amplitude; 0 for a fixed price."""
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4)
    """One training each; they seed the network, the exploration and the episodes."""
    steps: int = 150_000  # Decisions of all receivers together, for each seed.
    num_envs: int = 32  # Receivers side by side.
    batch_size: int = 240  # Decisions of a minibatch.
    n_epochs: int = 10  # How often each rollout is learned from.
    learning_rate: float = 1e-3  # At first; it falls linearly to a tenth.
    gae_lambda: float = 0.98
    """Of generalised advantage estimation; nearer to 1 than by default, as `gamma` is."""
    log_std_init: float = -1.5
    """Logarithm of the exploration's standard deviation at first, in parts of the full scale."""
    full_scale_mps: float | None = None
    """Rate that an action of 1 asks for; by default that of four lengths within the attack."""
    decision_interval_s: float | None = None
    """Time between decisions; 0 for one at every epoch, by default some ten seconds."""
    warm_pool: int | None = None
    """Receivers that are warmed up once, and the same for all seeds: each episode that is learned
    from starts as a copy of one.  None for warm-ups of their own; scores always have those."""
    length_m: float | None = None
    """Unit of rewards and prices; by default the alert limit, or 40 m."""
    average: float = 0.9
    """How much of the averaged weights stays at every update; 0 for the policy as it is."""
    stages: int = 12  # How often a policy is scored, and a checkpoint is written.
    fit_runs: int = 256
    """Training runs, on which amplitudes are fitted and the best policy is chosen."""
    runs: int = 400  # Evaluation runs, which decide nothing.
    entropy: int = 0  # Seed of training and evaluation runs.
    rivals: tuple[str, ...] = RIVALS
    """Spoofers to compare with on the same runs; `--rivals` alone for no comparison."""
    threads: int | None = None  # Of the engine; all useful cores by default.
    tensorboard: bool = False  # Log for TensorBoard.
    json: bool = False  # Print the results as JSON, and nothing else.

    def __post_init__(self) -> None:
        """Check what stable-baselines3 and the environment do not check, or only later."""
        check_choice("knowledge", self.knowledge, KNOWLEDGE)
        task_of(self.task)  # or a message that lists them
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
        own = {name: value for name, value in asdict(self).items() if name not in FREE}
        return dict(json.loads(json.dumps({"name": self.out.name, **own})))

    @property
    def world(self) -> dict[str, Any]:
        """World and detector, as `Evaluator` takes them: by the task, or by settings of their own.
        With a detector or settings of its own it is no longer the task."""
        given = json_object("settings", self.settings)
        if not self.detector and not given:
            return {"task": self.task}
        task = task_of(self.task)
        met = parse_spec(self.detector) if self.detector else task.detector
        return {**task.world_kwargs, "detector": met, **given}

    def make_envs(self) -> SpoofVecEnv:
        """Receivers of the training."""
        own: dict[str, Any] = {
            name: getattr(self, name) for name in ("knowledge", "threads", "warm_pool")
        }
        own |= self.world
        length_m = self.length_m or task_of(self.task).alert_limit_m
        if length_m is not None:
            own["length_m"] = length_m
        own = for_learning(own, self.full_scale_mps, self.decision_interval_s)
        return SpoofVecEnv(self.num_envs, **own)

    def command(self) -> str:
        """What trains the same again."""
        return command_of("train.ppo_spoofer", self, FREE, ["--seeds", *map(str, self.seeds)])


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
            path=self.policy,
            average=args.average,
            verbose=0,
        )
        self.envs = VecNormalize(args.make_envs(), gamma=1.0, clip_reward=math.inf)
        self.model = make_model(args, self.seed, self.envs, self._learning_rate)
        if args.tensorboard:
            self.model.set_logger(configure(str(self.folder / "tensorboard"), ["tensorboard"]))
        if (self.folder / CHECKPOINT).is_file():
            self.restore()

    @property
    def folder(self) -> Path:
        """Folder of this seed."""
        return self.args.out / f"seed-{self.seed}"

    @property
    def policy(self) -> Path:
        """File of the best policy."""
        return self.folder / f"{self.args.out.name}-{self.seed}.onnx"

    def _learning_rate(self, _: float) -> float:
        """It falls over all stages, where the library knows of one."""
        taken = self.model.num_timesteps if hasattr(self, "model") else 0
        return self.args.learning_rate * (1.0 - 0.9 * min(taken / self.args.steps, 1.0))

    def run(self, tick: BaseCallback) -> None:
        """Learn from where it is to the end, a checkpoint after every stage."""
        args = self.args
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
                callback=[self.watch, tick],
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

    def save(self) -> None:
        """Write the learning curve and a checkpoint, whole or not at all."""
        with TrainingRecord(self.folder / RECORD, last_step=-1) as record:
            for step, found in self.watch.history:
                record.append(
                    step,
                    round(self.spent_s * step / max(self.model.num_timesteps, 1), 1),
                    stealthy_m=found.score,
                    alarm_rate=found.chosen.alarm_rate,
                    amplitude=found.value,
                    within_budget=found.within_budget,
                )
        state = {name: getattr(self, name) for name in STATE} | {"watch": self.watch.state()}
        files = (self.policy, self.policy.with_suffix(".json"))
        save_checkpoint(self.folder / CHECKPOINT, self.model, self.envs, state, files)

    def restore(self) -> None:
        """Take over the checkpoint, and the best policy of its time."""
        state = load_checkpoint(self.folder / CHECKPOINT, self.model, self.envs, self.folder)
        self.watch.restore(state["watch"])
        for name in STATE:
            setattr(self, name, state[name])

    def scored(self, rivals: dict[str, Score]) -> dict[str, Any]:
        """What it has reached on evaluation runs, JSON-able."""
        watch = self.watch
        row: dict[str, Any] = {
            "seed": self.seed,
            "steps": self.model.num_timesteps,
            "wall_s": round(self.spent_s, 1),
            "diverged": watch.diverged,
            "chosen_at": watch.best_step if watch.best_step >= 0 else None,
            "untrained": self.untrained,
            "score": None,
        }
        if watch.best_step >= 0:
            score = self.judge.score(str(self.policy), amplitude=None)
            ratios = {
                name: score.ratio_to(rival, oracles=True).as_json()
                for name, rival in comparable(rivals, score.knowledge).items()
            }
            row |= {"score": score.as_dict(), "ratios": ratios}
        return row


def train(args: Arguments, console: Console) -> dict[str, Any]:
    """Train all seeds that are not finished, score and compare them; the results, JSON-able."""
    played = {name: getattr(args, name) for name in ("runs", "fit_runs", "entropy", "threads")}
    judge = Evaluator(**played, **args.world)
    args.make_envs().close()  # or what is wrong with them, before there is a folder
    for name in args.rivals:
        judge.check(name)
    open_folder(args.out, args.identity)
    trainings = []
    for seed in args.seeds:
        training, name = Training(args, seed, judge), f"seed {seed}"
        with show_progress(args.steps, start=name) as bar:
            training.run(Bar(bar, name))
        training.envs.close()
        trainings.append(training)
    with console.status("the rivals play"):
        rivals = {name: judge.score(name) for name in args.rivals}
    found = [t for t in trainings if t.watch.best_step >= 0]
    best = max(found, key=lambda t: t.watch.best_m, default=None)
    if best is not None:
        told = {"command": args.command(), "arguments": args.identity}
        copy_policy(best.policy, args.out / f"{args.out.name}.onnx", told)
    curves = {f"seed {t.seed}": read_record(t.folder / RECORD) for t in trainings}
    alike = comparable(rivals, args.knowledge)
    levels = {name: score.stealthy_displacement_m.value for name, score in alike.items()}
    draw_curves(curves, args.out / PICTURE, levels)
    return {
        "command": args.command(),
        "versions": used_versions(),
        "detector": judge.detector.label,
        "kept": None if best is None else best.seed,
        "seeds": [training.scored(rivals) for training in trainings],
        "rivals": {name: score.as_dict() for name, score in rivals.items()},
    }


def main() -> None:
    """Command line."""
    with error_lines():
        args = tyro.cli(Arguments, description=__doc__)
        console = Console(quiet=args.json)
        torch.set_num_threads(1)  # more of them fight with those of the engine
        results = train(args, console)
    text = json.dumps(results, indent=1, allow_nan=False)
    write_file(args.out / RESULTS, f"{text}\n".encode())
    if args.json:
        print(text)
    console.print(table_of(results), f"written: {args.out}")


if __name__ == "__main__":
    main()
