"""Train a spoofer by PPO, straight on the engine, under an alarm budget.

    python -m train.ppo_spoofer --detector ewma --knowledge blind --out runs/ewma-blind

What happens:

1. The ramps are tuned under the budget, as the benchmark does it.  They are the rivals that the
   card tells, and set the scale of the reward.
2. PPO of stable-baselines3 learns.  The price of an alarm rises while more runs alarm than the
   budget allows, and falls while fewer do (a Lagrange multiplier by dual ascent).
3. Every now and then the policy is written as ONNX, and onnxruntime plays it deterministically on
   runs of the training split, those that ramps are tuned and profiles chosen on, with the largest
   amplitude that keeps the budget.  The best one is kept, with its card.  Learning itself is on
   runs of its own.
4. At the end the best one plays runs of the calibration split, once, and the card tells it.  The
   evaluation split is left to the benchmark.

The folder holds `config.json`, `record.jsonl` (learning curve), `tensorboard/`, `checkpoint.zip`,
the best policy `NAME.onnx` and its card `NAME.json`.  After a kill the same command with `--resume`
goes on from the last checkpoint.

Deviations from plain PPO of stable-baselines3, and why:

1. gamma is 1: the return is what is scored, and an episode has an end.
2. The policy has one action, the acceleration along the heading in which displacement is rewarded,
   not the environments' wanted rate; ramps and profiles push along it, too.  With one for each
   axis it drifted across, where nothing pulls it back but alarms.
3. It begins as the tuned ramp of its kind: the bias of its last layer is that ramp's command.  From
   nothing it may as well begin to push the other way, where nothing is rewarded.  With `--imitate`
   it begins as an optimised profile: alarms by chance drown what PPO would have to learn of a shape
   against detectors that alarm without an attack in every fifth run, as `ewma` does.
4. The critic, which is thrown away after training, sees the detector's statistics in any case
   (asymmetric actor-critic, `pinto2018`): the policy sees what `--knowledge` allows.
5. Large minibatches, since the environment is fast; rollouts as long as an episode.
6. The alarm penalty adapts between rollouts.
7. What is evaluated are weights averaged over the last rollouts: alarms are rare and dear, so that
   single updates jitter.
8. The amplitude of what it plans is fitted to the budget afterwards, as the benchmark fits the rate
   of a ramp, and `baselines.profile` the scale of a profile.
9. The network sees its own rate and displacement in units of the ramps'; in those of the attack's
   limits a policy against a sharp detector would need weights that are never learned.
10. Rewards are in units of what the best ramp reaches, so that one set of settings suits detectors
   that allow for metres and for hundreds of metres.
"""

from __future__ import annotations

import json
import math
import re
import shlex
import tempfile
import time
import warnings
import zipfile
from dataclasses import asdict, dataclass, fields, replace
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from typing import Any, NoReturn, Self

import numpy as np
import torch
import tyro
from gymnasium.spaces import Box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import VecEnvWrapper

from agents.export import PolicyExporter
from agents.imitation import check_imitable, demonstrations, imitate
from agents.networks import InformedCritic, MlpShape
from agents.record import TrainingRecord
from spoofgym._describe import unlike
from spoofgym._files import remove_stale_parts, write_file
from spoofgym._registry import check_choice
from spoofgym.bench.budget import BUDGET, aim, largest_within
from spoofgym.bench.campaign import Silent, training_start
from spoofgym.bench.entries import detector_entry
from spoofgym.bench.metrics import bootstrap_mean, resamples_of
from spoofgym.bench.run import WarmStart, displacement_of, play
from spoofgym.bench.scores import Stealth, counted, stealth_of
from spoofgym.bench.specs import parse_spec
from spoofgym.bench.suite import Suite, Tuning, versions
from spoofgym.bench.tune import Trial, TuningResult, tune
from spoofgym.cli.suites import calibrate_with_progress
from spoofgym.detectors import DETECTORS
from spoofgym.envs import Observer, Setup, default_terms
from spoofgym.envs.spoofer_binding import spoofer_context
from spoofgym.envs.terms.reward import (
    AlarmPenalty,
    DisplacementGain,
    Retraction,
    RewardTerm,
)
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.simulators import Timeline
from spoofgym.spoofers import KNOWLEDGE, Profile, card_of, shipped
from spoofgym.spoofers.aim import direction
from spoofgym.spoofers.card import Card, fields_of
from spoofgym.spoofers.learned import OnnxPolicy
from spoofgym.tasks import task_of


@dataclass(frozen=True)
class Arguments:
    """Settings of a training run; all but `resume` and `threads` belong to its identity."""

    out: Path
    """Folder of the run; its last part is the name of the spoofer."""
    task: str = ""
    """Task of spoofgym-bench-v1, T1 to T6, which decides detector, scenario, attack and times."""
    detector: str = "ewma"
    """Detector that it learns against: a name, with settings as name:key=value or JSON."""
    knowledge: str = "blind"
    """What it observes: blind, tracking or oracle."""
    scenario: str = "zhong2025"
    """Scenario, like the detector."""
    attack: str = "false-position"
    """Attack, likewise."""
    imitate: str = ""
    """Shipped name or card of a profile that the policy imitates before it learns on."""
    heading_deg: float = 90.0
    """Direction in which it pushes and is rewarded, clockwise from north."""
    attack_s: float = 150.0
    """Command phase of an episode, in seconds."""
    warmup_s: float = 200.0
    """Clean run before the attack, in seconds; its last 60 s, or all of it, with the detector."""
    warm_pool: int | None = None
    """Warm-ups that all episodes of the training start from; by default each has its own."""
    steps: int = 2_500_000
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
    gae_lambda: float = 0.95
    """Of generalised advantage estimation."""
    clip_range: float = 0.2
    """Of PPO's ratio."""
    log_std_init: float = -2.0
    """Logarithm of the exploration's size at first."""
    averaging: float = 0.9
    """Weight of the past in the average of the weights, for each rollout; 0 for the last one."""
    width: int = 64
    """Units of each of the two hidden layers."""
    budget: float = BUDGET
    """Largest P(alarm | silent without attack), which its upper 95 % limit keeps."""
    penalty: float = 10.0
    """Price of an alarm at first, in displacements of the best ramp."""
    penalty_limit: float = 3.0
    """Largest factor on that price."""
    penalty_gain: float = 0.3
    """How quickly the factor adapts; 0 to keep it."""
    choose: str = "budget"
    """What is kept: 'budget', the farthest within the alarm budget, with an amplitude fitted to it;
    or 'price', the farthest less `penalty` for every alarm, as it was learned."""
    evaluations: int = 8
    """How often the policy is evaluated, and a checkpoint is written."""
    tuning_runs: int = 512
    """Runs that the ramps are tuned on."""
    evaluation_runs: int = 1024
    """Runs of an evaluation, which choose the policy and its amplitude."""
    final_runs: int = 500
    """Runs that decided nothing, which the best policy plays at the end."""
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
        check_choice("knowledge", self.knowledge, KNOWLEDGE)
        check_choice("choice", self.choose, ("budget", "price"))
        if self.choose == "price" and self.penalty_gain != 0.0:
            raise ValueError(
                f"`penalty_gain` must be 0 with `choose` = 'price', since a price that follows the "
                f"budget is none to choose by, got {self.penalty_gain:g}"
            )
        counts = ("steps", "num_envs", "batch_size", "n_epochs", "evaluations", "width")
        ones = ((name, 1) for name in (*counts, "torch_threads"))
        pairs = ((name, 2) for name in ("tuning_runs", "evaluation_runs", "final_runs"))
        for name, least in (*ones, ("n_steps", 0), *pairs):
            if getattr(self, name) < least:
                raise ValueError(f"`{name}` must be at least {least}, got {getattr(self, name)}")
        for name, low, high in (
            ("attack_s", 0.0, math.inf),
            ("averaging", 0.0, 1.0),
            ("budget", 0.0, 1.0),
            ("clip_range", 0.0, math.inf),
            ("gae_lambda", 0.0, 1.0),
            ("gamma", 0.0, 1.0),
            ("learning_rate", 0.0, math.inf),
            ("log_std_init", -20.0, 2.0),
            ("penalty", 0.0, math.inf),
            ("penalty_gain", 0.0, math.inf),
            ("penalty_limit", 0.0, math.inf),
            ("warmup_s", 0.0, math.inf),
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise ValueError(f"`{name}` must be in [{low:g}, {high:g}], got {value}")
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*", self.out.name):
            raise ValueError(
                "the last part of `out` names the spoofer: letters, digits, dots, hyphens and "
                f"underscores, the first one a letter or digit; got {str(self.out)!r}"
            )
        if ":" in str(parse_spec(self.detector)["name"]):
            raise ValueError(
                f"`detector` must be one of {', '.join(sorted(DETECTORS))}: a card can't name a "
                f"class of another module; got {self.detector!r}"
            )
        if self.task:
            self._check_task()
        if self.gamma != 1.0:
            warnings.warn(
                f"`gamma` = {self.gamma:g}: what is scored is not discounted, and with less than 1 "
                "the spoofer learns to be quick rather than to get far",
                stacklevel=2,
            )

    def _check_task(self) -> None:
        task_of(self.task)  # or a message that lists them
        decided = ("detector", "scenario", "attack", "attack_s", "warmup_s")
        for item in fields(self):
            if item.name in decided and getattr(self, item.name) != item.default:
                raise ValueError(f"`{item.name}` can't be given with `task`, which decides it")

    @property
    def identity(self) -> dict[str, Any]:
        """What a resumed run must share with the interrupted one; JSON-able."""
        free = ("resume", "threads", "torch_threads", "out", "tensorboard")
        settings = {name: value for name, value in asdict(self).items() if name not in free}
        return {"name": self.out.name, **settings}

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """What `gymnasium.make` takes."""
        pool = {} if self.warm_pool is None else {"warm_pool": self.warm_pool}
        if self.task:
            task = task_of(self.task)
            whom = {"detector": task.detector, "knowledge": self.knowledge, **pool}
            given = {"target_heading_deg": self.heading_deg, "action": "full-command"}
            return {**given, **task.world_kwargs, **whom}
        return {
            **pool,
            "action": "full-command",
            "scenario": parse_spec(self.scenario),
            "detector": detector_entry(parse_spec(self.detector)).spec,
            "attack": parse_spec(self.attack),
            "timeline": {
                "warmup_s": self.warmup_s,
                "live_s": min(self.warmup_s, Timeline().live_s),
                "attack_s": self.attack_s,
            },
            "knowledge": self.knowledge,
            "target_heading_deg": self.heading_deg,
        }

    @property
    def suite(self) -> Suite:
        """Campaign of the same preset, for its runs and for tuning the ramps."""
        own = ("detector", "knowledge", "warm_pool", "action")
        world = {k: v for k, v in self.env_kwargs.items() if k not in own}
        return Suite(
            **world,
            detectors=[self.env_kwargs["detector"]],
            spoofers=[
                {"name": "ramp", "rate_mps": "tuned", "heading_deg": self.heading_deg},
                {
                    "name": "accelerating-ramp",
                    "acceleration_mps2": "tuned",
                    "heading_deg": self.heading_deg,
                },
            ],
            entropy=self.seed,
            tuning=Tuning(
                runs=self.tuning_runs,
                sift_runs=max(self.tuning_runs // 16, 1),
                budget=self.budget,
            ),
        )


class AlongHeading(VecEnvWrapper):
    """Environment with one action, the push along a heading."""

    def __init__(self, venv: SpoofVecEnv, heading_deg: float) -> None:
        self.directions = direction(venv.action_names, heading_deg)[None, :]
        super().__init__(venv, action_space=Box(-1.0, 1.0, (1,), np.float32))

    def reset(self) -> np.ndarray:
        """Begin new episodes."""
        return self.venv.reset()

    def step_async(self, actions: np.ndarray) -> None:
        """Push."""
        self.venv.step_async(actions @ self.directions)

    def step_wait(self) -> Any:
        """What the environment returns."""
        return self.venv.step_wait()


class Diverged(RuntimeError):
    """The policy is no longer a number."""


@dataclass(frozen=True)
class Evaluation:
    """What a policy did on some runs."""

    displacement_m: np.ndarray
    """(R,) undetected displacement."""
    alarm: np.ndarray
    """(R,) bool."""
    counts: np.ndarray
    """(R,) bool, which runs count: silent before the onset and without attack."""

    @property
    def stealth(self) -> Stealth:
        """Score over the runs that count."""
        return stealth_of(self.displacement_m, self.alarm, self.counts)

    @property
    def mean_m(self) -> float:
        """Stealthy displacement; 0 where no run counts."""
        return self.stealth.displacement_m if self.counts.any() else 0.0

    @property
    def alarm_rate(self) -> float:
        """P(alarm | silent twin); 1 where no run counts."""
        return self.stealth.alarm_rate if self.counts.any() else 1.0


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
        return self.clean.first_alarm > 0

    @property
    def counts(self) -> np.ndarray:
        """(R,) bool, which runs count."""
        return counted(self.start.warmup_alarm, self.clean_alarm)

    def evaluate(self, policy: Path) -> Evaluation:
        """Let an ONNX file play all runs."""
        attacked = play(self.start, OnnxPolicy(str(policy)), drop_alarmed=True)
        return Evaluation(
            displacement_of(self.setup, attacked, self.clean),
            attacked.first_alarm > 0,
            self.counts,
        )

    def score(self, found: Evaluation, budget: float) -> dict[str, Any]:
        """Entry of the card."""
        counts = int(found.counts.sum())
        if not counts:
            raise ValueError(
                f"none of the {len(found.counts)} runs is silent without attack: there is no score"
            )
        mean = bootstrap_mean(found.displacement_m[found.counts], resamples_of(np.arange(counts)))
        return {
            "detector": self.label,
            "split": self.split,
            "entropy": self.entropy,
            "runs": len(found.alarm),
            "counted": counts,
            "undetected_displacement_m": round(mean.value, 4),
            "low": round(mean.low, 4),
            "high": round(mean.high, 4),
            "alarm_rate": round(found.alarm_rate, 6),
            "clean_alarm_rate": round(float(self.clean_alarm.mean()), 6),
            "budget": budget,
        }


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
    return max(chosen, key=lambda trial: trial.stealthy_displacement_m)


def rewards(args: Arguments, scale_m: float, factor: float) -> tuple[RewardTerm, ...]:
    """Displacement less the price of an alarm, in units of a scale."""
    return (
        DisplacementGain(1.0 / scale_m),
        Retraction(1.0 / scale_m),
        AlarmPenalty(args.penalty * factor),
    )


@dataclass(frozen=True)
class Scales:
    """What the tuned ramps tell of the size of things."""

    action: float = 0.0
    """Command of the ramp of the attack's control, as a part of the limit: the first action."""
    rate_mps: float = 1.0
    """Largest rate of both."""
    displacement_m: float = 100.0
    """Displacement of the better one."""

    @classmethod
    def of(cls, setup: Setup, tables: list[dict[str, Any]]) -> Self:
        """Read them from tuning tables."""
        attack, values = setup.attack, {table["setting"]: table["value"] for table in tables}
        own = "acceleration_mps2" if attack.control == "acceleration" else "rate_mps"
        window_s = setup.steps * setup.interval_s
        fastest = max(values["rate_mps"], values["acceleration_mps2"] * window_s)
        return cls(
            values[own] / attack.unit_scale,
            min(fastest, attack.rate_limit_mps),
            best_ramp(tables).stealthy_displacement_m,
        )

    def factors(self, observer: Observer, setup: Setup) -> list[float]:
        """Factors on observations, by which the own command is of the order of 1."""
        of_kind = {
            "own_rate": setup.rate_scale_mps / self.rate_mps,
            "own_displacement": setup.scales["length_m"] / self.displacement_m,
        }
        kinds = [name.rsplit("_", 1)[0] for name in observer.names]
        return [of_kind.get(kind, 1.0) for kind in kinds]


def make_model(args: Arguments, env: AlongHeading, scales: Scales = Scales()) -> PPO:
    """PPO with fresh weights, whose first actions lie around that of a ramp."""
    setup = env.get_attr("core")[0].setup
    n_steps = args.n_steps or setup.steps // setup.repeat
    size = n_steps * args.num_envs
    if size % args.batch_size and args.batch_size < size:
        # stable-baselines3 warns of a last minibatch that is smaller; it is harmless
        warnings.filterwarnings("ignore", message="You have specified a mini-batch size")
    shape = MlpShape(width=args.width, log_std_init=args.log_std_init)
    core = env.venv.core
    observer = Observer(default_terms(core.setup, args.knowledge), core.setup)
    model = PPO(
        InformedCritic,
        env,
        learning_rate=lambda left: args.learning_rate * (0.1 + 0.9 * left),
        n_steps=n_steps,
        batch_size=min(args.batch_size, size),
        n_epochs=args.n_epochs,
        gamma=args.gamma,
        gae_lambda=args.gae_lambda,
        clip_range=args.clip_range,
        policy_kwargs=shape.policy_kwargs()
        | {"seen": len(observer.names), "scale": scales.factors(core.observer, core.setup)},
        seed=args.seed,
        device="cpu",
    )
    torch.nn.init.constant_(model.policy.action_net.bias, scales.action)
    return model


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

    def __init__(
        self,
        args: Arguments,
        env: AlongHeading,
        rivals: list[dict[str, Any]],
        spent_s: float = 0.0,
    ) -> None:
        super().__init__()
        self._began, self.spent_s = time.perf_counter(), spent_s
        self.args, self.env, self.rivals = args, env, rivals
        self.name = args.out.name
        self.judge = Judge(args, "training", args.evaluation_runs, args.seed)
        ramp = best_ramp(rivals)
        self.scale_m = max(ramp.stealthy_displacement_m, 1e-3)
        self.factor = 1.0
        # training sees alarms by chance, too, which a run without attack would have
        chance = float(self.judge.clean_alarm.mean())
        own = aim(int(self.judge.counts.sum()), args.budget)
        self.aim = self.alarm_rate = chance + (1.0 - chance) * own
        self.best_m, self.best_step = -math.inf, -1
        self.rollout, self.next_step, self.evaluated = 0, 0, -1
        self.latest: dict[str, float] = {}
        self._ended: list[tuple[float, bool]] = []
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
        self.exporter = PolicyExporter(self.average, self.env.directions)
        self.task = bar.add_task(self.name, total=self.args.steps)
        self.env.venv.set_rewards(rewards(self.args, self.scale_m, self.factor))

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
        self.factor = min(max(self.factor * change, 0.1), self.args.penalty_limit)
        self.env.venv.set_rewards(rewards(self.args, self.scale_m, self.factor))
        self.latest = {
            "train_undetected_m": float(displacement),
            "train_alarm_rate": float(alarmed),
            "alarm_penalty_m": self.args.penalty * self.factor * self.scale_m,
        }
        for key, value in self.latest.items():
            self.logger.record(f"spoofer/{key}", value)

    def evaluate(self) -> None:
        """Play the policy as it is, keep it if it is the best, write a checkpoint."""
        self.next_step = self.num_timesteps + self.args.steps // self.args.evaluations
        self.evaluated = self.num_timesteps
        found = self._played()
        within = [item for item in found if self._keeps(item[1])]
        amplitude, best = max(
            within or found[:1], key=lambda item: (self._worth_m(item[1]), -item[0])
        )
        if within:
            self.amplitude = amplitude
        if within and self._worth_m(best) > self.best_m:
            self.best_m, self.best_step = self._worth_m(best), self.num_timesteps
            score = self.judge.score(best, self.args.budget)
            self.exporter.write(self.best_path, self.card_fields([score], amplitude), amplitude)
        self._tell(amplitude, best, bool(within))
        self.save()

    def _keeps(self, found: Evaluation) -> bool:
        priced = self.args.choose == "price"
        return priced or found.stealth.keeps(self.args.budget)

    def _worth_m(self, found: Evaluation) -> float:
        """What a policy is chosen by: how far it gets, or that less the price of its alarms."""
        if self.args.choose == "budget":
            return found.mean_m
        return found.mean_m - self.args.penalty * self.scale_m * found.alarm_rate

    def _played(self) -> list[tuple[float, Evaluation]]:
        """The policy with some amplitudes around what the budget allows, the first one first."""
        found: list[tuple[float, Evaluation]] = []
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{self.name}.onnx"

            def keeps(amplitude: float) -> bool:
                self.exporter.write(path, self.card_fields([], amplitude), amplitude)
                found.append((amplitude, self.judge.evaluate(path)))
                return self._keeps(found[-1][1])

            if self.num_timesteps and self.args.choose == "budget":
                largest_within(keeps, self.amplitude)
            else:
                keeps(1.0)
        return found

    def _tell(self, amplitude: float, found: Evaluation, within: bool) -> None:
        """Write a point of the learning curve, and a line."""
        values = {
            **self.latest,
            "amplitude": amplitude,
            "eval_undetected_m": found.mean_m,
            "eval_alarm_rate": found.alarm_rate,
            "within_budget": within,
        }
        self.record.append(self.num_timesteps, round(self.wall_s, 2), **values)
        for key in ("eval_undetected_m", "eval_alarm_rate", "amplitude"):
            self.logger.record(f"spoofer/{key}", values[key])
        self.bar.console.print(
            f"{self.num_timesteps:>9,d} steps {self.wall_s:5.0f} s   "
            f"undetected {found.mean_m:7.2f} m   alarms {100 * found.alarm_rate:5.1f} %   "
            f"amplitude {amplitude:4.2f}{'' if within else '  over budget'}"
            f"{'  best' if self.best_step == self.num_timesteps else ''}",
            soft_wrap=True,
        )

    def card_fields(self, scores: list[dict[str, Any]], amplitude: float) -> dict[str, Any]:
        """Card of the policy as it is."""
        setup, args = self.env.venv.core.setup, self.args
        observer = Observer(default_terms(setup, args.knowledge), setup)
        context = spoofer_context(setup, 1, observer)
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
                "price_factor": round(self.factor, 4),
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
            for path in self._best_files():
                if self.best_step >= 0:
                    archive.writestr(path.name, path.read_bytes())
        write_file(self.args.out / CHECKPOINT, content.getvalue())

    def _best_files(self) -> tuple[Path, Path]:
        return self.best_path, self.best_path.with_suffix(".json")

    def restore(self, model: PPO) -> None:
        """Take over the checkpoint of the folder, and the best policy of its time."""
        path = self.args.out / CHECKPOINT
        try:
            with zipfile.ZipFile(path) as archive:
                state = json.loads(archive.read("state.json"))
                parameters = torch.load(BytesIO(archive.read("parameters.pt")), weights_only=True)
                best = (
                    {file: archive.read(file.name) for file in self._best_files()}
                    if (state["best_step"] >= 0)
                    else {}
                )
        except (zipfile.BadZipFile, KeyError, ValueError) as error:
            raise SystemExit(f"{path} is damaged ({error}); choose another --out") from error
        for file, content in best.items():
            write_file(file, content)
        self.average = twin_of(model)
        self.average.load_state_dict(parameters.pop(AVERAGE))
        model.set_parameters(parameters, device="cpu")
        model.num_timesteps = self.num_timesteps = state["num_timesteps"]
        for name in (*STATE, "spent_s"):
            setattr(self, name, state[name])


STATE = (
    "factor",
    "alarm_rate",
    "amplitude",
    "best_m",
    "best_step",
    "rollout",
    "next_step",
    "evaluated",
)
"""What a checkpoint keeps of a run, beside the weights."""
LEAST_M = 0.1
"""Displacement of the best ramp, below which there is no scale for a reward."""
AVERAGE = "average"
"""Name of the averaged weights in a checkpoint."""
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


def open_folder(args: Arguments, console: Console) -> dict[str, Any]:
    """Look at the folder of a run; the configuration that an interrupted one left, or nothing.

    A folder with a run in it is gone on with under `--resume` only, and by the same settings only.
    """
    path = args.out / CONFIG
    remove_stale_parts(args.out)
    if not path.is_file():
        if args.resume:
            console.print(f"there is no run in {args.out} yet: it begins anew")
        return {}
    if not args.resume:
        raise SystemExit(
            f"{args.out} holds a training run; go on with it by --resume, or choose another --out"
        )
    try:
        old = json.loads(path.read_text(encoding="utf-8"))
        there = {"arguments": old["arguments"], "versions": old["versions"]}
        old["rivals"], old["spent_s"]
    except (ValueError, KeyError, TypeError) as error:
        raise SystemExit(f"{path} is damaged ({error!r}); choose another --out") from error
    here = {"arguments": json.loads(json.dumps(args.identity)), "versions": used_versions()}
    found = [line.replace(" on the card", " there") for line in unlike(there, here)]
    if found:
        raise SystemExit(
            f"{args.out} holds a run with other settings, which can't be gone on with:\n  "
            + "\n  ".join(found)
        )
    return dict(old)


def train(
    args: Arguments, console: Console, rivals: list[dict[str, Any]] | None = None
) -> tuple[Path, float]:
    """Train; the file of the best policy, and the time that it took, interruptions not counted.

    `rivals` are the tables of ramps that have been tuned before, by the same settings.
    """
    began = time.perf_counter()
    torch.set_num_threads(args.torch_threads)
    calibrate_with_progress(args.suite, args.threads)
    config = open_folder(args, console)
    engine = SpoofVecEnv(
        args.num_envs,
        threads=args.threads,
        torch_threads=args.torch_threads,
        **(args.env_kwargs | {"knowledge": "oracle"}),
    )
    env = AlongHeading(engine, args.heading_deg)
    try:
        if args.imitate:
            check_imitable(engine, profile_of(args), env.directions[0])
        make_model(args, env)  # which refuses what does not fit, before anything is written
        if not config:
            config = begin(args, began, console, rivals)
        return learn(args, env, config, console)
    finally:
        env.close()


def begin(
    args: Arguments, began: float, console: Console, rivals: list[dict[str, Any]] | None
) -> dict[str, Any]:
    """Tune the ramps, unless they are, and write the configuration of a new run."""
    rivals = tuned_ramps(args, console) if rivals is None else rivals
    reached = best_ramp(rivals).stealthy_displacement_m
    if reached < LEAST_M:
        raise SystemExit(
            f"the ramps displace the victim by no more than {reached:.2g} m: no scale for a reward "
            "follows from that. Choose an attack that moves it along --heading-deg"
        )
    config = {
        "arguments": args.identity,
        "versions": used_versions(),
        "rivals": rivals,
        "spent_s": time.perf_counter() - began,
    }
    write_file(args.out / CONFIG, (json.dumps(config, indent=1) + "\n").encode())
    return config


def profile_of(args: Arguments) -> Profile:
    """The profile that is imitated."""
    card = card_of(args.imitate) if args.imitate in shipped() else Card.load(args.imitate)
    if card.kind != "profile":
        raise ValueError(f"`imitate` must be a profile, {args.imitate!r} is an {card.kind}")
    return Profile(**card.settings)


def learn(
    args: Arguments, env: AlongHeading, config: dict[str, Any], console: Console
) -> tuple[Path, float]:
    """Learn from where the folder is at."""
    rivals = config["rivals"]
    model = make_model(args, env, Scales.of(env.venv.core.setup, rivals))
    run = Run(args, env, rivals, config["spent_s"])
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
    if args.imitate and not resumed:
        profile = profile_of(args)
        data = demonstrations(env.venv, profile, env.directions[0], args.seed)
        apart = imitate(model.policy, *data, args.seed)
        console.print(f"imitates {args.imitate} to {apart:.3f} of the largest command")
    with TrainingRecord(args.out / RECORD, last_step=begun if resumed else -1) as record, bar:
        run.prepare(model, record, bar)
        try:
            if begun < args.steps:
                model.learn(args.steps - begun, callback=run, reset_num_timesteps=False)
                run.evaluate_last()
        except (Diverged, ValueError) as error:
            raise_if_diverged(model, run, error)
    return run.best_path, run.wall_s


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
            f"training has diverged: {found}; {best}. Try a smaller --learning-rate, in another "
            "--out."
        ) from error
    raise error


def finish(args: Arguments, best: Path, spent_s: float, console: Console) -> None:
    """Play the best policy on runs that decided nothing, and tell the card."""
    began = time.perf_counter()
    if not best.is_file():
        raise SystemExit(
            f"no policy within the alarm budget of {100 * args.budget:g} % was found; train "
            "longer, or with a larger --penalty, in another --out"
        )
    with console.status("playing runs that decided nothing"):
        judge = Judge(args, "calibration", args.final_runs, args.seed)
        score = judge.score(judge.evaluate(best), args.budget)
    card = Card.load(best.with_suffix(".json"))
    training = {**card.training, "total_s": round(spent_s + time.perf_counter() - began, 1)}
    told = card.model_dump() | {"training": training, "scores": [card.scores[0], score]}
    card = Card.model_validate(told)
    card.save(best.with_suffix(".json"))
    table = Table(title=f"{card.name}, against {judge.label}")
    for head in ("runs", "undetected displacement [m]", "alarms [%]", "without attack [%]"):
        table.add_column(head, justify="right")
    for row in card.scores:
        table.add_row(
            f"{row.runs} ({'choice' if row is card.scores[0] else 'fresh'})",
            f"{row.undetected_displacement_m:.2f} ({row.low:.2f} to {row.high:.2f})",
            f"{100 * row.alarm_rate:.1f}",
            f"{100 * row.clean_alarm_rate:.1f}",
        )
    console.print(table)
    console.print(
        f"best ramp on its tuning runs: {card.training['ramp_m']:.2f} m; all of it took "
        f"{training['total_s']:.0f} s"
    )
    if card.scores[0].undetected_displacement_m <= card.training["ramp_m"]:
        console.print("that is no more than the ramp: train longer, in another --out")
    console.print(f"written: {best} and its card")


def main() -> None:
    """Command line."""
    console = Console()
    try:
        args = tyro.cli(Arguments, description=__doc__)
        finish(args, *train(args, console), console)
    except ValueError as error:
        raise SystemExit(f"error: {error}") from error
    except KeyboardInterrupt:
        console.print("interrupted; the same command with --resume goes on")
        raise SystemExit(130) from None


if __name__ == "__main__":
    main()
