"""Speed of receivers on a device: ``python -m benchmarks.device``.

Environment steps by the number of receivers, clean epochs of a calibration, and training steps of
`train.ppo_cuda`, all against EWMA in the papers' world.  ``--device cpu`` measures the same on the
processor.  Graphs count from their second call on, and what is compiled not at all.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro

from agents.folder import error_lines
from spoofgym.bench.experiments.calibration import TOGETHER_ON_DEVICE, play_on_device
from spoofgym.bench.report.table import Table
from spoofgym.calibration.clean_runs import Player
from spoofgym.core.registry import check_choice, whole_number
from spoofgym.detectors import make_detector
from train.ppo_cuda import Learner, Settings, make_envs, make_graph

WORLD: dict[str, Any] = {"scenario": "zhong2025", "receiver": None, "domain": None}
PACE = {"timeline": None, "decision_interval_s": None, "between": "hold"}
MET = {"name": "ewma", "thresholds": "nominal"}


@dataclass(frozen=True)
class Measured:
    """What is measured."""

    device: str = "cuda"  # Where: cuda, cuda:1 or cpu.
    receivers: tuple[int, ...] = (1024, 4096, 16_384, 65_536)  # Side by side.
    steps: int = 64  # Of each environment.
    runs: int = 16_384  # Clean runs.
    updates: int = 4  # Of PPO, with each number of receivers.
    world: str = "{}"  # Further settings of the world, as JSON.
    json: bool = False  # Print JSON, and nothing else.

    def __post_init__(self) -> None:
        check_choice("device", self.device.partition(":")[0], ("cuda", "cpu"))
        for name in ("steps", "runs", "updates"):
            whole_number(f"`{name}`", getattr(self, name), 1)

    def settings(self, receivers: int) -> Settings:
        own = json.dumps({**WORLD, **PACE, **json.loads(self.world)})
        sizes = {"num_envs": receivers, "pasts": min(receivers, 16_384), "minibatches": 8}
        met = {"task": "T1", "detector": json.dumps(MET), "settings": own, "log_std": -3.0}
        return Settings(out=Path("unused"), device=self.device, **met, **sizes)


def name_device(device: str) -> str:
    return "processor" if device == "cpu" else torch.cuda.get_device_name(device)


def take_time(work: Callable[[], Any], device: str) -> float:
    """Seconds of a call, when all that it has begun on a device is over."""

    def wait() -> None:
        if device != "cpu":
            torch.cuda.synchronize(device)

    wait()
    began = time.perf_counter()
    work()
    wait()
    return time.perf_counter() - began


def measure_steps(measured: Measured, receivers: int) -> dict[str, float]:
    """Environment steps and training steps a second."""
    settings = measured.settings(receivers)
    with closing(make_envs(settings)) as envs:
        envs.reset(seed=0)
        actions = torch.zeros(receivers, len(envs.core.action_names), device=envs.device)
        step = partial(envs.step_unchecked, actions)
        step()
        if settings.device != "cpu" and settings.graphs:
            step = make_graph(step, envs.device)
        run = lambda: [step() for _ in range(measured.steps)]  # noqa: E731
        stepped = measured.steps * receivers / take_time(run, measured.device)
        envs.check()
        learner = Learner(envs, settings, 0)
        learner.begin(0)
        learner.learn(0.0)
        learn = lambda: [learner.learn(0.5) for _ in range(measured.updates)]  # noqa: E731
        learned = measured.updates * learner.size / take_time(learn, measured.device)
    return {"env_steps_per_s": stepped, "ppo_steps_per_s": learned}


def measure_clean(measured: Measured) -> dict[str, float]:
    """Epochs of clean runs a second, with their beginnings on the processor."""
    settings = measured.settings(1)
    with closing(make_envs(settings)) as envs:
        setup = envs.core.setup
    how: dict[str, Any] = {}
    if measured.device != "cpu":
        how = {"batch": partial(play_on_device, device=measured.device)}
        how["chunk"] = TOGETHER_ON_DEVICE
    player, detector = Player(setup, **how), make_detector(MET)
    play = lambda runs: player.play([detector], np.arange(runs), in_loop=True)  # noqa: E731
    play(2)
    passed = take_time(lambda: play(measured.runs), measured.device)
    return {"clean_epochs_per_s": measured.runs * (setup.length - 1) / passed}


def measure(measured: Measured) -> dict[str, Any]:
    by_receivers = {str(n): measure_steps(measured, n) for n in measured.receivers}
    return {
        "device": name_device(measured.device),
        "torch": torch.__version__,
        "receivers": by_receivers,
        **measure_clean(measured),
    }


@error_lines()
def main() -> None:
    measured = tyro.cli(Measured, description=__doc__)
    found = measure(measured)
    if measured.json:
        print(json.dumps(found))
        return
    rows = [
        (receivers, *(f"{each[name]:,.0f}" for name in ("env_steps_per_s", "ppo_steps_per_s")))
        for receivers, each in found["receivers"].items()
    ]
    Table.of_texts("receivers", "steps/s", "of PPO").print(found["device"], rows)
    print(f"clean epochs/s: {found['clean_epochs_per_s']:,.0f}")


if __name__ == "__main__":
    main()
