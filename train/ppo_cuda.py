"""PPO on a GPU, without a copy to the host: `CudaVectorEnv`, PyTorch, one file.

    python -m train.ppo_cuda --out runs/cuda    # one seed against ewma in the world of S1
    python -m train.ppo_cuda --out runs/cpu --device cpu --num-envs 64 --steps 150_000

With ``--device cpu`` the same learner takes `SpoofVectorEnv`, for a trial where there is no GPU.
The policy goes to an ONNX file with its card, and is scored on the processor, on warm-ups and
seeds that nothing was learned on.  After a kill the same command goes on from its last checkpoint.

Reference: CleanRL's ``ppo_continuous_action.py``.  Deviations:

1. A rollout is an episode of every receiver that nothing ends early; rewards are not discounted.
2. Rewards are in lengths of the task; neither they nor observations are normalized, which the
   environment scales.
3. The value is not clipped, and the entropy has no part in the loss.
4. On a GPU the step of a rollout and that of a minibatch are CUDA graphs; what they count stays
   there until an update is over.
5. Every stage, between two checkpoints, begins with new episodes, seeded by it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

import spoofgym.export
from agents.checkpoint import open_checkpoint, write_checkpoint
from agents.folder import Part, Records, error_lines, json_object, learning_versions
from agents.learning import for_learning, run_training
from spoofgym.bench.experiments.evaluate import Evaluator
from spoofgym.bench.report.table import Table, interval
from spoofgym.bench.runs.world import WORLD, World
from spoofgym.core.progress import ProgressBar
from spoofgym.core.registry import check_choice, parse_spec, whole_number
from spoofgym.envs import SpoofVectorEnv
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers import KNOWLEDGE
from spoofgym.tasks import get_task

COUNTED = "undetected_displacement_m", "detected"
CHECKPOINT = "checkpoint.zip"
WARM_UPS = 3  # calls before a graph is made


@dataclass(frozen=True)
class Settings:
    """What is trained."""

    out: Path  # Folder of the results.
    task: str = "S1"  # Task, S1 to S3 or T1 to T6, whose world it learns in.
    detector: str = "ewma"  # Detector, one that a device has: name:key=value or JSON.
    settings: str = "{}"  # Further settings of that world, as JSON.
    knowledge: str = "blind"  # What it observes: blind, tracking or oracle; with +reported.
    device: str = "cuda"  # Where receivers and network are: cuda, cuda:1 or cpu.
    seeds: tuple[int, ...] = (0,)  # One training each: network, exploration, episodes.
    steps: int = 50_000_000  # Decisions of all receivers together, for each seed.
    num_envs: int = 16_384  # Receivers side by side.
    pasts: int = 16_384  # Warmed-up receivers that episodes start from, on a device.
    stages: int = 4  # Checkpoints.
    minibatches: int = 8  # Of a rollout.
    n_epochs: int = 4  # How often each rollout is learned from.
    learning_rate: float = 1e-3  # At first; it falls linearly to 0.
    gae_lambda: float = 0.98  # Of generalised advantage estimation.
    clip: float = 0.2  # Largest change of a probability that pays.
    log_std: float = -1.5  # Logarithm of the exploration at first, in parts of the full scale.
    alarm_price: float = 1.5  # What an alarm costs, in lengths.
    graphs: bool = True  # Whether CUDA graphs are made.
    fit_runs: int = 256  # Training runs, on which amplitudes are fitted.
    runs: int = 400  # Evaluation runs.

    def __post_init__(self) -> None:
        check_choice("knowledge", self.knowledge, KNOWLEDGE)
        check_choice("device", self.device.partition(":")[0], ("cuda", "cpu"))
        for name in ("steps", "num_envs", "pasts", "stages", "minibatches", "n_epochs"):
            whole_number(f"`{name}`", getattr(self, name), 1)
        named = {name: x for name, x in self.judged.items() if name != "detector"}
        World.of(**named)  # or a message about `settings`

    @property
    def world(self) -> dict[str, Any]:
        own = json_object("settings", self.settings)
        return {**get_task(self.task).world_kwargs, "detector": parse_spec(self.detector), **own}

    @property
    def judged(self) -> dict[str, Any]:
        """The same, as `Evaluator` takes it."""
        further = self.world
        named = {name: further.pop(name) for name in ("detector", *WORLD) if name in further}
        return {**named, "settings": further}

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """World, action and reward that are learned with."""
        length = {"length_m": get_task(self.task).alert_limit_m or 40.0}
        shown = {"knowledge": self.knowledge, "alarm_price": self.alarm_price}
        return for_learning({**self.world, **length, **shown})

    @property
    def identity(self) -> dict[str, Any]:
        """What a seed's training depends on, JSON-able."""
        free = ("out", "seeds", "graphs", "fit_runs", "runs")
        return {name: value for name, value in vars(self).items() if name not in free}


class OnProcessor:
    """`SpoofVectorEnv` as a learner takes a `CudaVectorEnv`."""

    def __init__(self, num_envs: int, **kwargs: Any) -> None:
        self.envs = SpoofVectorEnv(num_envs, autoreset_mode="same_step", infos=COUNTED, **kwargs)
        self.core, self.num_envs, self.device = self.envs.core, num_envs, torch.device("cpu")

    def reset(self, *, seed: int) -> tuple[torch.Tensor, dict[str, Any]]:
        return torch.from_numpy(self.envs.reset(seed=seed)[0].copy()), {}

    def step_unchecked(self, actions: torch.Tensor) -> tuple[Any, ...]:
        seen, *rest, info = self.envs.step(actions.numpy())
        last = info.get("final_info", {})
        none = np.zeros(self.num_envs)
        counted = {name: torch.from_numpy(np.array(last.get(name, none))) for name in COUNTED}
        return (*(torch.from_numpy(np.array(each)) for each in (seen, *rest)), counted)

    def check(self) -> None:
        """There is nothing to be found later."""

    def close(self) -> None:
        self.envs.close()


class Policy(nn.Module):
    """The mean action (B, a) of observations (B, o); its spread and the value beside it."""

    def __init__(self, observed: int, actions: int, log_std: float, hidden: int = 64) -> None:
        super().__init__()
        self.actor, self.critic = (
            nn.Sequential(
                *(_layer(observed, hidden), nn.Tanh(), _layer(hidden, hidden), nn.Tanh()),
                _layer(hidden, size, gain),
            )
            for size, gain in ((actions, 0.01), (1, 1.0))
        )
        self.log_std = nn.Parameter(torch.full((actions,), log_std))

    def forward(self, observation: torch.Tensor) -> Any:
        return self.actor(observation)

    def value(self, observation: torch.Tensor) -> Any:
        return self.critic(observation)[:, 0]

    def log_probability(self, mean: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        """Of actions (B, a), but for a constant."""
        apart = (action - mean) / self.log_std.exp()
        return -(0.5 * apart.square() + self.log_std).sum(dim=-1)


def _layer(size: int, out: int, gain: float = math.sqrt(2.0)) -> nn.Linear:
    layer = nn.Linear(size, out)
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def make_graph(function: Callable[[], None], device: torch.device) -> Callable[[], None]:
    """What replays a function as a CUDA graph, after some calls of it."""
    aside = torch.cuda.Stream(device)
    aside.wait_stream(torch.cuda.current_stream(device))
    with torch.cuda.stream(aside):
        for _ in range(WARM_UPS):
            function()
    torch.cuda.current_stream(device).wait_stream(aside)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        function()
    return graph.replay


class Learner:
    """PPO on a vector environment of tensors; `tensors` is all that it has learned.

    A rollout has T steps of B receivers: observations, actions, their log-probabilities, values,
    rewards and ends are (T, B, ...).  `totals` (3,) counts episodes, alarms and the sum of their
    undetected displacements [m].
    """

    def __init__(self, envs: Any, settings: Settings, seed: int) -> None:
        torch.manual_seed(seed)
        self.envs, self.settings, self.device = envs, settings, envs.device
        core, (t, b) = envs.core, (envs.core.episode_steps, envs.num_envs)
        observed, actions = len(core.observation_names), len(core.action_names)
        self.scale, self.size = 1.0 / core.length_m, t * b
        on_device: dict[str, Any] = {"device": self.device}
        self.policy = Policy(observed, actions, settings.log_std).to(self.device)
        fast = self.device.type == "cuda"
        rate = torch.tensor(settings.learning_rate, **on_device)
        self.optimizer = torch.optim.Adam(
            self.policy.parameters(), lr=rate, eps=1e-5, capturable=fast, foreach=fast
        )
        self.now = torch.zeros(b, observed, **on_device)
        self.step = torch.zeros(1, dtype=torch.long, **on_device)
        self.totals = torch.zeros(3, dtype=torch.float64, **on_device)
        sizes = {"seen": (observed,), "action": (actions,), "log_p": (), "value": ()}
        sizes |= {"reward": (), "over": (), "advantage": (), "target": ()}
        self.rollout = {name: torch.zeros(t, b, *size, **on_device) for name, size in sizes.items()}
        learned = ("seen", "action", "log_p", "advantage", "target")
        rows = max(self.size // settings.minibatches, 1)
        self.batch = {name: torch.zeros(rows, *sizes[name], **on_device) for name in learned}
        self._take_step, self._take_update = self._prepare()

    def _prepare(self) -> tuple[Callable[[], None], Callable[[], None]]:
        """The steps of a rollout and of a minibatch, as graphs where that is wanted. All has run
        once then, which gives the optimizer its tensors, and nothing has been learned."""
        fresh = {name: tensor.clone() for name, tensor in self.policy.state_dict().items()}
        works: tuple[Callable[[], None], ...] = self._collect, self._update
        self.begin(0)
        if self.device.type == "cuda" and self.settings.graphs:
            works = tuple(make_graph(work, self.device) for work in works)
        self._update()
        self.policy.load_state_dict(fresh)
        for state in self.optimizer.state.values():
            for tensor in state.values():
                tensor.zero_()
        return works[0], works[1]

    @property
    def tensors(self) -> dict[str, torch.Tensor]:
        moments = enumerate(self.optimizer.state.values())
        found = {f"adam.{k}.{name}": x for k, each in moments for name, x in each.items()}
        return {**self.policy.state_dict(), **found}

    def load(self, given: Mapping[str, torch.Tensor]) -> None:
        """Take over what has been learned, in place, since graphs have its addresses."""
        for name, tensor in self.tensors.items():
            tensor.copy_(given[name])

    def begin(self, seed: int) -> None:
        """Start new episodes, and the exploration of a stage."""
        torch.manual_seed(seed)
        self.now.copy_(self.envs.reset(seed=seed)[0])
        self.step.zero_()
        self.totals.zero_()

    @torch.no_grad()
    def _collect(self) -> None:
        """One step of all receivers into the rollout."""
        policy, seen = self.policy, self.now
        mean = policy(seen)
        action = mean + policy.log_std.exp() * torch.randn_like(mean)
        after, reward, ends, cuts, info = self.envs.step_unchecked(action.clamp(-1.0, 1.0))
        over = (ends | cuts).to(mean.dtype)
        for name, value in {
            "seen": seen,
            "action": action,
            "log_p": policy.log_probability(mean, action),
            "value": policy.value(seen),
            "reward": (self.scale * reward).to(mean.dtype),
            "over": over,
        }.items():
            self.rollout[name].index_copy_(0, self.step, value[None])
        counted = [over, *(over * info[name] for name in reversed(COUNTED))]
        self.totals += torch.stack([each.sum(dtype=torch.float64) for each in counted])
        self.now.copy_(after)
        self.step.add_(1).remainder_(len(self.rollout["over"]))

    def _update(self) -> None:
        """One step of the optimizer, on a minibatch."""
        batch, policy, clip = self.batch, self.policy, self.settings.clip
        log_p = policy.log_probability(policy(batch["seen"]), batch["action"])
        ratio = (log_p - batch["log_p"]).exp()
        gain = batch["advantage"]
        gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)
        lost = torch.max(-gain * ratio, -gain * ratio.clamp(1.0 - clip, 1.0 + clip)).mean()
        missed = (policy.value(batch["seen"]) - batch["target"]).square().mean()
        self.optimizer.zero_grad(set_to_none=False)
        (lost + 0.5 * missed).backward()
        nn.utils.clip_grad_norm_(policy.parameters(), 0.5)
        self.optimizer.step()

    @torch.no_grad()
    def _estimate_advantages(self) -> None:
        rollout, last = self.rollout, self.policy.value(self.now)
        ahead, run = last, torch.zeros_like(last)
        for t in reversed(range(len(rollout["over"]))):
            live, value = 1.0 - rollout["over"][t], rollout["value"][t]
            run = rollout["reward"][t] + live * (ahead + self.settings.gae_lambda * run) - value
            rollout["advantage"][t], ahead = run, value
        rollout["target"].copy_(rollout["advantage"] + rollout["value"])

    def learn(self, done: float) -> None:
        """A rollout, and what follows from it; `done`: part of all updates that is over."""
        for _ in range(len(self.rollout["over"])):
            self._take_step()
        self.envs.check()
        self._estimate_advantages()
        for group in self.optimizer.param_groups:
            group["lr"].fill_(self.settings.learning_rate * (1.0 - done))
        flat = {name: self.rollout[name].flatten(0, 1) for name in self.batch}
        rows = len(self.batch["log_p"])
        for _ in range(self.settings.n_epochs):
            order = torch.randperm(self.size, device=self.device)
            for first in range(0, self.size - rows + 1, rows):
                chosen = order[first : first + rows]
                for name, tensor in self.batch.items():
                    tensor.copy_(flat[name][chosen])
                self._take_update()

    def pop_totals(self) -> dict[str, float]:
        """What the episodes since the last call have come to."""
        episodes, alarms, metres = self.totals.tolist()
        self.totals.zero_()
        each = max(episodes, 1.0)
        return {"episodes": episodes, "alarm_rate": alarms / each, "undetected_m": metres / each}


def make_envs(settings: Settings) -> Any:
    own = settings.env_kwargs
    if settings.device == "cpu":
        return OnProcessor(settings.num_envs, **own)
    on_device: dict[str, Any] = {
        "device": settings.device,
        "pasts": settings.pasts,
        "infos": COUNTED,
    }
    return SpoofVectorEnv(settings.num_envs, **on_device, **own)


def train(settings: Settings, seed: int, tick: Callable[[float], None]) -> dict[str, Any]:
    """One training from its last checkpoint on; its policy goes to a file."""
    folder = settings.out / f"seed-{seed}"
    began = time.perf_counter()
    with closing(make_envs(settings)) as envs:
        learner = Learner(envs, settings, seed)
        updates = max(math.ceil(settings.steps / learner.size), 1)
        state: dict[str, Any] = {"stage": 0, "wall_s": 0.0, "curve": []}
        if (folder / CHECKPOINT).is_file():
            with open_checkpoint(folder / CHECKPOINT) as (tensors, state):
                learner.load(tensors)
        for stage in range(state["stage"], settings.stages):
            learner.begin(int(np.random.SeedSequence([seed, stage]).generate_state(1)[0]))
            first, last = (updates * k // settings.stages for k in (stage, stage + 1))
            for k in range(first, last):
                learner.learn(k / updates)
                tick(settings.steps / updates)
            if not all(bool(x.isfinite().all()) for x in learner.policy.parameters()):
                return {"seed": seed, "diverged": stage, "curve": state["curve"], "file": None}
            state["curve"].append({"steps": last * learner.size, **learner.pop_totals()})
            now = time.perf_counter()
            state |= {"stage": stage + 1, "wall_s": state["wall_s"] + now - began}
            began = now
            write_checkpoint(folder / CHECKPOINT, learner.tensors, state)
        policy = learner.policy.cpu()
    path = folder / f"{settings.out.name}-{seed}.onnx"
    counted = {"algorithm": "train.ppo_cuda", "seed": seed, **settings.identity}
    with closing(SpoofVecEnv(1, **settings.env_kwargs)) as probe:
        spoofgym.export.onnx(policy, probe, path, training=counted)
    steps, wall_s = updates * learner.size, round(state["wall_s"], 1)
    row = {"seed": seed, "steps": steps, "wall_s": wall_s, "curve": state["curve"]}
    return {**row, "diverged": None, "file": path.name}


def play(settings: Settings, progress: ProgressBar | None = None) -> dict[str, Any]:
    """Train and score what is missing; the results, JSON-able."""
    sizes: dict[str, Any] = {"runs": settings.runs, "fit_runs": settings.fit_runs}
    judge = cache(lambda: Evaluator(**sizes, **settings.judged))

    def score(row: dict[str, Any]) -> Any:
        if row["file"] is None:
            return None
        file = str(settings.out / f"seed-{row['seed']}" / row["file"])
        return judge().score(file).as_dict()

    parts: dict[str, Part] = {}
    for seed in settings.seeds:
        name = f"seed-{seed}"
        make = lambda _, context, k=seed: train(settings, k, context.tick)  # noqa: E731
        parts[name] = Part({}, make, work=settings.steps)
        rate = lambda before, _, x=name: score(before[x])  # noqa: E731
        parts[f"score-{seed}"] = Part(sizes, rate, (name,))
    config = {**settings.identity, "versions": learning_versions()}
    return Records("ppo-cuda", config, parts).play(settings.out, progress)


def build_table(results: dict[str, Any]) -> str:
    """A line of Markdown for each seed."""
    lines = []
    for name, row in results.items():
        if not name.startswith("seed-"):
            continue
        score, last = results[f"score-{row['seed']}"], (row["curve"] or [{}])[-1]
        reached = "diverged" if score is None else interval(score["stealthy_displacement_m"])
        learned = f"{last.get('undetected_m', 0.0):.1f}", f"{last.get('alarm_rate', 0.0):.3f}"
        lines.append((name, *learned, reached))
    head = "training", "undetected while it learned [m]", "alarm rate", "score [m]"
    return Table.of_texts(*head).markdown(lines)


@error_lines()
def main() -> None:
    run_training(Settings, __doc__, play, build_table)


if __name__ == "__main__":
    main()
