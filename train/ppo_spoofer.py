"""Train a spoofer by PPO, straight on the engine, under an alarm budget.

    python -m train.ppo_spoofer --detector ewma --knowledge blind --out runs/ewma-blind

What happens:

1. The ramps are tuned under the budget, as the benchmark does it.  They are the rivals that the
   card tells, and set the scale of the reward.
2. PPO of stable-baselines3 learns.  The price of an alarm rises while more runs alarm than the
   budget allows, and falls while fewer do (a Lagrange multiplier by dual ascent).
3. Every now and then the policy is written as ONNX, and onnxruntime plays it deterministically on
   runs of the calibration split, with the largest amplitude that keeps the budget.  The best one is
   kept, with its card.
4. At the end the best one plays runs of the evaluation split, once, and the card tells it.

The folder holds `config.json`, `record.jsonl` (learning curve), `tensorboard/`, `checkpoint.zip`,
the best policy `NAME.onnx` and its card `NAME.json`.  After a kill the same command with `--resume`
goes on from the last checkpoint.

Deviations from plain PPO of stable-baselines3, and why:

1. gamma is 1: the return is what is scored, and an episode has an end.
2. Large minibatches, since the environment is fast; rollouts as long as an episode.
3. The alarm penalty adapts between rollouts.
4. What is evaluated are weights averaged over the last rollouts: alarms are rare and dear, so that
   single updates jitter.
5. The amplitude of what it plans is fitted to the budget afterwards, as the benchmark fits the rate
   of a ramp, and `baselines.profile` the scale of a profile.
6. Rewards are in units of what the best ramp reaches, so that one set of settings suits detectors
   that allow for metres and for hundreds of metres.
"""

from __future__ import annotations

import json
import math
import shlex
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import torch
import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.policies import ActorCriticPolicy

from agents.export import PolicyExporter
from agents.networks import MlpShape
from agents.record import TrainingRecord
from spoofgym._describe import unlike
from spoofgym._files import write_file
from spoofgym.bench.budget import BUDGET, MARGIN, Excess, excess_of, reach
from spoofgym.bench.campaign import Silent, training_start
from spoofgym.bench.metrics import bootstrap_mean, resamples
from spoofgym.bench.run import WarmStart, displacement_of, play
from spoofgym.bench.specs import parse_spec
from spoofgym.bench.suite import Suite, Tuning, versions
from spoofgym.bench.tune import Trial, TuningResult, tune
from spoofgym.envs.attach import spoofer_context
from spoofgym.envs.rewards import AlarmPenalty, DisplacementGain, Retraction, RewardTerm
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers.card import Card, fields_of
from spoofgym.spoofers.onnx_policy import OnnxPolicy


@dataclass(frozen=True)
class Arguments:
    """Settings of a training run; all but `resume` and `threads` belong to its identity."""

    out: Path
    """Folder of the run; its last part is the name of the spoofer."""
    detector: str = "ewma"
    """Detector that it learns against: a name, with settings as name:key=value or JSON."""
    knowledge: str = "blind"
    """What it observes: blind, tracking or oracle."""
    scenario: str = "zhong2025"
    """Scenario, like the detector."""
    attack: str = "false-position"
    """Attack, likewise."""
    attack_s: float = 150.0
    """Command phase of an episode, in seconds."""
    warmup_s: float = 200.0
    """Clean run before the attack, in seconds; its last 60 s, or all of it, with the detector."""
    steps: int = 5_000_000
    """Steps of all receivers together."""
    num_envs: int = 128
    """Receivers side by side."""
    n_steps: int = 0
    """Steps of a rollout in every receiver; 0 for an episode."""
    batch_size: int = 4800
    """Steps of a minibatch."""
    n_epochs: int = 4
    """How often each rollout is learned from."""
    learning_rate: float = 1e-3
    """At first; it falls linearly to a tenth."""
    gamma: float = 1.0
    """Discount; anything but 1 is not what is scored."""
    gae_lambda: float = 0.98
    """Of generalised advantage estimation."""
    clip_range: float = 0.2
    """Of PPO's ratio."""
    log_std_init: float = -1.5
    """Logarithm of the exploration's size at first."""
    averaging: float = 0.9
    """Weight of the past in the average of the weights, for each rollout; 0 for the last one."""
    width: int = 64
    """Units of each of the two hidden layers."""
    budget: float = BUDGET
    """How much more often than without attack an alarm may come, as a part of the runs."""
    margin: float = MARGIN
    """Distance that the choice keeps from the budget, in standard errors."""
    penalty: float = 3.0
    """Price of an alarm at first, in displacements of the best ramp."""
    penalty_limit: float = 30.0
    """Its largest value, likewise."""
    penalty_gain: float = 0.3
    """How quickly the price adapts; 0 to keep it."""
    evaluations: int = 8
    """How often the policy is evaluated, and a checkpoint is written."""
    evaluation_runs: int = 512
    """Runs of an evaluation, of the tuning of the ramps, and of the clean alarm rate."""
    final_runs: int = 500
    """Runs of the evaluation split that the best policy plays at the end."""
    seed: int = 0
    """All chance follows from this number."""
    tensorboard: bool = True
    """Whether to log for TensorBoard."""
    torch_threads: int = 1
    """Threads of torch; more of them fight with those of the engine."""
    threads: int | None = None
    """Threads of the engine; as many as pay by default."""
    resume: bool = False
    """Go on from the last checkpoint in the folder."""

    def __post_init__(self) -> None:
        """Check what stable-baselines3 and the environment do not check, or only later."""
        counts = ("steps", "num_envs", "batch_size", "n_epochs", "evaluations", "width")
        for name, least in (*((n, 1) for n in counts), ("evaluation_runs", 2), ("final_runs", 2)):
            if getattr(self, name) < least:
                raise ValueError(f"`{name}` must be at least {least}, got {getattr(self, name)}")
        for name, low, high in (
            ("budget", 0.0, 1.0),
            ("gamma", 0.0, 1.0),
            ("learning_rate", 0.0, math.inf),
            ("margin", 0.0, math.inf),
            ("penalty", 0.0, math.inf),
            ("penalty_limit", 0.0, math.inf),
            ("penalty_gain", 0.0, math.inf),
            ("averaging", 0.0, 1.0),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"`{name}` must be in [{low:g}, {high:g}], got {value}")
        if self.gamma != 1.0:
            warnings.warn(
                f"`gamma` = {self.gamma:g}: what is scored is not discounted, and with less than 1 "
                "the spoofer learns to be quick rather than to get far",
                stacklevel=2,
            )

    @property
    def identity(self) -> dict[str, Any]:
        """What a resumed run must share with the interrupted one; JSON-able."""
        free = ("resume", "threads", "torch_threads", "out", "tensorboard")
        return {name: value for name, value in asdict(self).items() if name not in free}

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """What `gymnasium.make` takes."""
        return {
            "scenario": parse_spec(self.scenario),
            "detector": parse_spec(self.detector),
            "attack": parse_spec(self.attack),
            "timeline": {
                "warmup_s": self.warmup_s,
                "live_s": min(self.warmup_s, 60.0),
                "attack_s": self.attack_s,
            },
            "knowledge": self.knowledge,
        }

    @property
    def suite(self) -> Suite:
        """Campaign of the same preset, for its runs and for tuning the ramps."""
        env = self.env_kwargs
        return Suite(
            scenario=env["scenario"],
            attack=env["attack"],
            timeline=env["timeline"],
            detectors=[env["detector"]],
            spoofers=[
                {"name": "ramp", "rate_mps": "tuned"},
                {"name": "accelerating-ramp", "acceleration_mps2": "tuned"},
            ],
            entropy=self.seed,
            tuning=Tuning(
                runs=self.evaluation_runs,
                sift_runs=max(self.evaluation_runs // 16, 1),
                budget=self.budget,
                margin=self.margin,
            ),
        )


class Diverged(RuntimeError):
    """The policy is no longer a number."""


@dataclass(frozen=True)
class Evaluation:
    """What a policy did on some runs."""

    displacement_m: np.ndarray
    """(R,) undetected displacement."""
    alarm: np.ndarray
    """(R,) bool."""
    clean_alarm: np.ndarray
    """(R,) bool, of the same runs without attack."""

    @property
    def mean_m(self) -> float:
        """Mean undetected displacement over all runs."""
        return float(self.displacement_m.mean())

    @property
    def excess(self) -> Excess:
        """How much more often than without attack it alarmed."""
        return excess_of(self.alarm, self.clean_alarm)


class Judge:
    """Runs of one split at the onset, on which policies are played."""

    def __init__(self, args: Arguments, split: str, runs: int, entropy: int) -> None:
        suite = replace(args.suite, entropy=entropy)
        self.setup = suite.setup(suite.detector_entries[0])
        rngs = suite.generators(split, runs)
        self.start = WarmStart(self.setup, rngs, threads=args.threads)
        self.clean = play(self.start, "none")
        self.split, self.entropy = split, entropy
        self.label = suite.detector_entries[0].label

    @property
    def clean_alarm(self) -> np.ndarray:
        """(R,) bool, alarms without attack."""
        return self.clean.alarm.any(axis=0)

    def evaluate(self, policy: Path) -> Evaluation:
        """Let an ONNX file play all runs."""
        attacked = play(self.start, OnnxPolicy(str(policy)), drop_alarmed=True)
        return Evaluation(
            displacement_of(self.setup, attacked, self.clean),
            attacked.alarm.any(axis=0),
            self.clean_alarm,
        )

    def score(self, found: Evaluation, budget: float) -> dict[str, Any]:
        """Entry of the card."""
        samples = resamples(len(found.alarm), np.random.default_rng(0))
        mean = bootstrap_mean(found.displacement_m, samples)
        return {
            "detector": self.label,
            "split": self.split,
            "entropy": self.entropy,
            "runs": len(found.alarm),
            "undetected_displacement_m": round(mean.value, 4),
            "low": round(mean.low, 4),
            "high": round(mean.high, 4),
            "alarm_rate": round(float(found.alarm.mean()), 6),
            "clean_alarm_rate": round(float(found.clean_alarm.mean()), 6),
            "budget": budget,
        }


def fitted(keeps: Callable[[float], bool], first: float) -> None:
    """Try amplitudes: walk from the first one to where the budget is spent, then halve the step."""
    faster = keeps(first)
    low = high = first
    for _ in range(WALKS):
        last, there = (high, high * STEP) if faster else (low, low / STEP)
        if keeps(there) != faster:
            low, high = sorted((last, there))
            break
        low = high = there
    for _ in range(HALVINGS if low < high else 0):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if keeps(middle) else (low, middle)


def tuned_ramps(args: Arguments, console: Console) -> list[dict[str, Any]]:
    """Tuning tables of the ramps, on the runs of the training split."""
    suite = args.suite
    start, clean = training_start(suite, suite.detector_entries[0], args.threads, Silent())
    tables = []
    for entry in suite.spoofer_entries:
        if entry.tuned:
            with console.status(f"tuning the {entry.spec['name']} under the alarm budget"):
                found = tune(start, clean, entry, suite.detector_entries[0].label, suite.tuning)
            tables.append(found.as_dict())
    return tables


def best_ramp(tables: list[dict[str, Any]]) -> Trial:
    """What the ramp that gets farthest did on its tuning runs."""
    chosen = [TuningResult.from_dict(table).chosen for table in tables]
    return max(chosen, key=lambda trial: trial.undetected_displacement_m)


def rewards(scale_m: float, penalty_m: float) -> tuple[RewardTerm, ...]:
    """Displacement less the price of an alarm, in units of a scale."""
    per_m = 1.0 / scale_m
    return DisplacementGain(per_m), Retraction(per_m), AlarmPenalty(penalty_m * per_m)


def make_model(args: Arguments, env: SpoofVecEnv) -> PPO:
    """PPO with fresh weights."""
    n_steps = args.n_steps or env.game.setup.steps
    size = n_steps * args.num_envs
    if size % args.batch_size and args.batch_size < size:
        # stable-baselines3 warns of a last minibatch that is smaller; it is harmless
        warnings.filterwarnings("ignore", message="You have specified a mini-batch size")
    shape = MlpShape(width=args.width, log_std_init=args.log_std_init)
    return PPO(
        "MlpPolicy",
        env,
        learning_rate=lambda left: args.learning_rate * (0.1 + 0.9 * left),
        n_steps=n_steps,
        batch_size=min(args.batch_size, size),
        n_epochs=args.n_epochs,
        gamma=args.gamma,
        gae_lambda=args.gae_lambda,
        clip_range=args.clip_range,
        policy_kwargs=shape.policy_kwargs(),
        seed=args.seed,
        device="cpu",
    )


def twin_of(model: PPO) -> ActorCriticPolicy:
    """Policy of its own with the same weights."""
    twin = model.policy_class(
        model.observation_space,
        model.action_space,
        model.lr_schedule,
        **model.policy_kwargs,
    )
    twin.load_state_dict(model.policy.state_dict())
    return twin


class Run(BaseCallback):
    """One training run: adapts the price of an alarm, evaluates, keeps the best, checkpoints."""

    def __init__(self, args: Arguments, env: SpoofVecEnv, rivals: list[dict[str, Any]]) -> None:
        super().__init__()
        self.args, self.env, self.rivals = args, env, rivals
        self.name = args.out.name
        self.judge = Judge(args, "calibration", args.evaluation_runs, args.seed)
        ramp = best_ramp(rivals)
        self.scale_m = max(ramp.undetected_displacement_m, 1e-3)
        self.penalty_m = args.penalty * self.scale_m
        clean = [float(rivals[0]["clean_alarm_rate"]), float(self.judge.clean_alarm.mean())]
        self.clean_rate = sum(clean) / 2.0
        self.aim = self.alarm_rate = self.clean_rate + reach(
            args.budget, args.margin, ramp.excess_error
        )
        self.best_m, self.best_step = -math.inf, -1
        self.spent_s, self.rollout, self.next_step, self.evaluated = 0.0, 0, 0, -1
        self.latest: dict[str, float] = {}
        self._ended: list[tuple[float, bool]] = []
        self._began = time.perf_counter()
        self.average: ActorCriticPolicy | None = None
        self.amplitude = 1.0

    @property
    def wall_s(self) -> float:
        """Wall time of the training so far, interruptions not counted."""
        return self.spent_s + time.perf_counter() - self._began

    @property
    def best_path(self) -> Path:
        """File of the best policy."""
        return self.args.out / f"{self.name}.onnx"

    def prepare(self, model: PPO, record: TrainingRecord, bar: Progress) -> None:
        """Take what is trained, and what the training writes to."""
        self.record, self.bar = record, bar
        self.average = twin_of(model) if self.average is None else self.average
        self.exporter = PolicyExporter(self.average)
        self.task = bar.add_task(self.name, total=self.args.steps)
        self.env.set_rewards(rewards(self.scale_m, self.penalty_m))

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if info:
                self._ended.append((info["undetected_displacement_m"], info["detected"]))
        return True

    def _on_rollout_start(self) -> None:
        """After every update."""
        check_finite(self.model)
        if self.num_timesteps:
            self._average()
        self.bar.update(self.task, completed=self.num_timesteps)
        if self.num_timesteps >= self.next_step:
            self.evaluate()

    def evaluate_last(self) -> None:
        """After the last update."""
        if self.num_timesteps > self.evaluated:
            self.next_step = self.num_timesteps
            self._on_rollout_start()

    @torch.no_grad()
    def _average(self) -> None:
        """Move the average towards the latest weights."""
        # at first over what there is, so that the initial weights do not linger
        kept = min(self.args.averaging, 1.0 - 1.0 / (self.rollout + 1))
        for mean, now in zip(
            self.average.parameters(), self.model.policy.parameters(), strict=True
        ):
            mean.lerp_(now, 1.0 - kept)

    def _on_rollout_end(self) -> None:
        """Adapt the price of an alarm to what the rollout has seen."""
        self.rollout += 1
        if not self._ended:
            return
        displacement, alarmed = np.array(self._ended, dtype=np.float64).mean(axis=0)
        self._ended.clear()
        self.alarm_rate += 0.3 * (float(alarmed) - self.alarm_rate)
        change = math.exp(self.args.penalty_gain * (self.alarm_rate - self.aim))
        bounds = 0.1 * self.scale_m, self.args.penalty_limit * self.scale_m
        self.penalty_m = min(max(self.penalty_m * change, bounds[0]), bounds[1])
        self.env.set_rewards(rewards(self.scale_m, self.penalty_m))
        self.latest = {
            "train_undetected_m": float(displacement),
            "train_alarm_rate": float(alarmed),
            "alarm_penalty_m": self.penalty_m,
        }
        for key, value in self.latest.items():
            self.logger.record(f"spoofer/{key}", value)

    def evaluate(self) -> None:
        """Play the policy as it is, keep it if it is the best, write a checkpoint."""
        self.next_step = self.num_timesteps + self.args.steps // self.args.evaluations
        self.evaluated = self.num_timesteps
        found = self._played()
        within = [item for item in found if self._keeps(item[1])]
        amplitude, best = max(within or found[:1], key=lambda item: (item[1].mean_m, -item[0]))
        if within:
            self.amplitude = amplitude
        if within and best.mean_m > self.best_m:
            self.best_m, self.best_step = best.mean_m, self.num_timesteps
            score = self.judge.score(best, self.args.budget)
            self.exporter.write(self.best_path, self.card_fields([score], amplitude), amplitude)
        self._tell(amplitude, best, bool(within))
        self.save()

    def _keeps(self, found: Evaluation) -> bool:
        return found.excess.keeps(self.args.budget, self.args.margin)

    def _played(self) -> list[tuple[float, Evaluation]]:
        """The policy with some amplitudes around what the budget allows, the first one first."""
        found: list[tuple[float, Evaluation]] = []
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{self.name}.onnx"

            def keeps(amplitude: float) -> bool:
                self.exporter.write(path, self.card_fields([], amplitude), amplitude)
                found.append((amplitude, self.judge.evaluate(path)))
                return self._keeps(found[-1][1])

            if self.num_timesteps:
                fitted(keeps, self.amplitude)
            else:
                keeps(1.0)
        return found

    def _tell(self, amplitude: float, found: Evaluation, within: bool) -> None:
        """Write a point of the learning curve, and a line."""
        values = {
            **self.latest,
            "amplitude": amplitude,
            "eval_undetected_m": found.mean_m,
            "eval_alarm_rate": float(found.alarm.mean()),
            "eval_excess": found.excess.value,
            "within_budget": within,
        }
        self.record.append(self.num_timesteps, round(self.wall_s, 2), **values)
        for key in ("eval_undetected_m", "eval_excess", "amplitude"):
            self.logger.record(f"spoofer/{key}", values[key])
        self.bar.console.print(
            f"{self.num_timesteps:>9,d} steps {self.wall_s:5.0f} s   "
            f"undetected {found.mean_m:7.2f} m   alarms {100 * found.excess.value:+5.1f} %   "
            f"amplitude {amplitude:4.2f}{'' if within else '  over budget'}"
            f"{'  best' if self.best_step == self.num_timesteps else ''}",
            soft_wrap=True,
        )

    def card_fields(self, scores: list[dict[str, Any]], amplitude: float) -> dict[str, Any]:
        """Card of the policy as it is."""
        game, args = self.env.game, self.args
        context = spoofer_context(game.setup, 1, game.observer)
        return {
            "env_id": "spoofgym/TightlyCoupled-v0",
            "env_kwargs": args.env_kwargs,
            **fields_of(context),
            "knowledge": {
                "run_time": args.knowledge,
                "design_time": f"{self.judge.label}, receiver, attack and scenario, by training",
            },
            "training": {
                "algorithm": "PPO (stable-baselines3)",
                "command": shlex.join(["python", "-m", "train.ppo_spoofer", *command_of(args)]),
                "arguments": args.identity,
                "seed": args.seed,
                "steps": self.num_timesteps,
                "wall_s": round(self.wall_s, 1),
                "amplitude": amplitude,
                "alarm_penalty_m": round(self.penalty_m, 3),
                "ramp_m": round(self.scale_m, 3),
            },
            "versions": used_versions(),
            "scores": scores,
            "rivals": self.rivals,
        }

    def save(self) -> None:
        """Write a checkpoint, whole or not at all."""
        state = {name: getattr(self, name) for name in STATE}
        state |= {"num_timesteps": self.num_timesteps, "spent_s": self.wall_s}
        content = BytesIO()
        with zipfile.ZipFile(content, "w") as archive:
            weights = BytesIO()
            torch.save({**self.model.get_parameters(), AVERAGE: self.average.state_dict()}, weights)
            archive.writestr("parameters.pt", weights.getvalue())
            archive.writestr("state.json", json.dumps(state))
        write_file(self.args.out / CHECKPOINT, content.getvalue())

    def restore(self, model: PPO) -> None:
        """Take over the checkpoint of the folder."""
        with zipfile.ZipFile(self.args.out / CHECKPOINT) as archive:
            state = json.loads(archive.read("state.json"))
            weights = BytesIO(archive.read("parameters.pt"))
        parameters = torch.load(weights, weights_only=True)
        self.average = twin_of(model)
        self.average.load_state_dict(parameters.pop(AVERAGE))
        model.set_parameters(parameters, device="cpu")
        model.num_timesteps = self.num_timesteps = state.pop("num_timesteps")
        for name, value in state.items():
            setattr(self, name, value)


STATE = (
    "penalty_m",
    "alarm_rate",
    "amplitude",
    "best_m",
    "best_step",
    "rollout",
    "next_step",
    "evaluated",
)
AVERAGE = "average"
"""Name of the averaged weights in a checkpoint."""
STEP, WALKS, HALVINGS = 1.15, 4, 2
"""Step between amplitudes, most steps of one search, and how often the last one is halved."""
CHECKPOINT, CONFIG, RECORD = "checkpoint.zip", "config.json", "record.jsonl"
"""Files of a run's folder."""


def check_finite(model: PPO) -> None:
    """Raise where an update has made the policy useless."""
    after = f"after {model.num_timesteps:,} steps"
    for name, weight in model.policy.named_parameters():
        if not bool(torch.isfinite(weight).all()):
            raise Diverged(f"{name} is not finite {after}")
    deviation = model.policy.log_std.exp()
    if not bool(((deviation > 0.0) & torch.isfinite(deviation)).all()):
        raise Diverged(f"the size of the exploration is {deviation.tolist()} {after}")


def command_of(args: Arguments) -> list[str]:
    """Arguments that differ from the defaults, as the command line takes them."""
    words = ["--out", Path(args.out).name]
    for item in fields(args):
        value = getattr(args, item.name)
        if item.name in ("out", "resume", "threads") or value == item.default:
            continue
        name = item.name.replace("_", "-")
        words += (
            [f"--{name}" if value else f"--no-{name}"]
            if isinstance(value, bool)
            else [
                f"--{name}",
                str(value),
            ]
        )
    return words


def used_versions() -> dict[str, str]:
    """What the training depended on."""
    return versions() | {name: version(name) for name in ("torch", "stable-baselines3", "onnx")}


def open_folder(args: Arguments) -> dict[str, Any]:
    """Begin a run, or go on with it; the configuration that was written.

    A folder with a run in it is gone on with under `--resume` only, and by the same settings only.
    """
    path = args.out / CONFIG
    if not path.is_file():
        if args.resume and (args.out / CHECKPOINT).is_file():
            raise SystemExit(f"{args.out} has a checkpoint but no {CONFIG}; choose another --out")
        return {}
    old = json.loads(path.read_text(encoding="utf-8"))
    if not args.resume:
        raise SystemExit(
            f"{args.out} holds a training run; go on with it by --resume, or choose another --out"
        )
    here = {"arguments": json.loads(json.dumps(args.identity)), "versions": used_versions()}
    found = unlike({k: old[k] for k in here}, here)
    if found:
        raise SystemExit(
            f"{args.out} holds a run with other settings, which can't be gone on with:\n  "
            + "\n  ".join(found)
        )
    return old


def train(args: Arguments, console: Console) -> Path:
    """Train, and return the file of the best policy."""
    torch.set_num_threads(args.torch_threads)
    config = open_folder(args)
    rivals = config.get("rivals") or tuned_ramps(args, console)
    if not config:
        config = {"arguments": args.identity, "versions": used_versions(), "rivals": rivals}
        write_file(args.out / CONFIG, (json.dumps(config, indent=1) + "\n").encode())
    env = SpoofVecEnv(
        args.num_envs,
        threads=args.threads,
        torch_threads=args.torch_threads,
        **args.env_kwargs,
    )
    model = make_model(args, env)
    run = Run(args, env, rivals)
    resumed = args.resume and (args.out / CHECKPOINT).is_file()
    if resumed:
        run.restore(model)
        console.print(f"resumed after {model.num_timesteps:,} steps")
    begun = model.num_timesteps
    # receivers and exploration go on with other chance than they began with
    chance = np.random.SeedSequence([args.seed, begun])
    model.set_random_seed(int(chance.generate_state(1)[0]))
    log = ["tensorboard"] if args.tensorboard else []
    model.set_logger(configure(str(args.out / "tensorboard"), log))
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} steps"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )
    last = begun if resumed else None
    with TrainingRecord(args.out / RECORD, last_step=last if resumed else -1) as record, bar:
        run.prepare(model, record, bar)
        try:
            model.learn(max(args.steps - begun, 0), callback=run, reset_num_timesteps=False)
            run.evaluate_last()
        except (Diverged, ValueError) as error:
            raise_if_diverged(model, run, error)
    env.close()
    return run.best_path


def raise_if_diverged(model: PPO, run: Run, error: Exception) -> NoReturn:
    """Tell what is left of a run whose losses are no numbers; other errors go on."""
    try:
        check_finite(model)
    except Diverged as found:
        best = (
            f"the best policy up to then, of step {run.best_step:,} with {run.best_m:.2f} m, is "
            f"kept: {run.best_path}"
            if run.best_step >= 0
            else "no policy up to then was within the alarm budget"
        )
        raise SystemExit(
            f"training has diverged: {found}; {best}. Try a smaller --learning-rate."
        ) from error
    raise error


def finish(args: Arguments, best: Path, console: Console) -> None:
    """Play the best policy on runs that decided nothing, and tell the card."""
    if not best.is_file():
        raise SystemExit(
            f"no policy within the alarm budget of {100 * args.budget:g} % was found; train "
            "longer, or with a larger --penalty"
        )
    with console.status("playing runs that decided nothing"):
        judge = Judge(args, "evaluation", args.final_runs, 0)
        score = judge.score(judge.evaluate(best), args.budget)
    card = Card.load(best.with_suffix(".json"))
    scores = [s.model_dump() for s in card.scores if s.split != "evaluation"]
    card = Card.model_validate({**card.model_dump(), "scores": [*scores, score]})
    card.save(best.with_suffix(".json"))
    table = Table(title=f"{card.name}, against {judge.label}")
    for head in ("runs", "undetected displacement [m]", "alarms [%]", "without attack [%]"):
        table.add_column(head, justify="right")
    for row in card.scores:
        table.add_row(
            f"{row.runs} ({row.split})",
            f"{row.undetected_displacement_m:.2f} ({row.low:.2f} to {row.high:.2f})",
            f"{100 * row.alarm_rate:.1f}",
            f"{100 * row.clean_alarm_rate:.1f}",
        )
    console.print(table)
    console.print(f"best ramp on its tuning runs: {card.training['ramp_m']:.2f} m")
    console.print(f"written: {best} and its card")


def main() -> None:
    """Command line."""
    console = Console()
    try:
        args = tyro.cli(Arguments, description=__doc__)
        finish(args, train(args, console), console)
    except ValueError as error:
        raise SystemExit(f"error: {error}") from error
    except KeyboardInterrupt:
        raise SystemExit("interrupted; the same command with --resume goes on") from None


if __name__ == "__main__":
    main()
