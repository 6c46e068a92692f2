"""What part of PPO's speed the simulation leaves: ``python -m benchmarks.ppo_speed``.

PPO runs on the engine, and on an environment of the same spaces that computes nothing, in turn
within one process: with a decision at every epoch, large minibatches and the other settings of
`train.ppo_spoofer`.  The ratio is what counts; the steps a second are those of the machine.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from stable_baselines3.common.vec_env import VecNormalize

from agents.folder import error_lines
from spoofgym.bench.report.table import Table
from spoofgym.core.registry import whole_number
from spoofgym.sb3 import SpoofVecEnv
from train.ppo_spoofer import Arguments, make_model


@dataclass(frozen=True)
class Settings:
    """What is measured."""

    rounds: int = 3  # How often both are measured, in turn.
    rollouts: int = 6  # Of each measurement, after one that does not count.
    num_envs: int = 128  # Receivers side by side.
    detector: str = "ewma:thresholds=nominal"  # Detector, as in train.ppo_spoofer.
    knowledge: str = "blind"  # What the spoofer observes: blind, tracking or oracle.
    json: bool = False  # Print JSON, and nothing else.

    def __post_init__(self) -> None:
        for name in ("rounds", "rollouts", "num_envs"):
            whole_number(f"`{name}`", getattr(self, name), 1)


class Nothing(SpoofVecEnv):
    """The same spaces, episodes of full length, and no simulation."""

    def reset(self) -> np.ndarray:
        """Start over."""
        self._step = 0
        self._seen = np.zeros((self.num_envs, *self.observation_space.shape), dtype=np.float32)
        return self._seen.copy()

    def step_async(self, actions: np.ndarray) -> None:
        """Look at nothing."""

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Count."""
        self._step += 1
        over = self._step % self.core.setup.steps == 0
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if over:
            for info in infos:
                info.update({"terminal_observation": self._seen[0], "TimeLimit.truncated": False})
        rewards = np.zeros(self.num_envs, dtype=np.float32)
        return self._seen.copy(), rewards, np.full(self.num_envs, over), infos


def steps_per_s(kind: type[SpoofVecEnv], args: Arguments, rollouts: int) -> float:
    """Steps a second of PPO, learning included, after a first rollout."""
    engine = kind(args.num_envs, seed=0, knowledge=args.knowledge, **args.world)
    envs = VecNormalize(engine, gamma=1.0)
    model = make_model(args, 0, envs, args.learning_rate)
    size = model.n_steps * args.num_envs
    model.learn(size)
    began = time.perf_counter()
    model.learn(rollouts * size, reset_num_timesteps=False)
    passed = time.perf_counter() - began
    envs.close()
    return rollouts * size / passed


def measure(settings: Settings) -> dict[str, Any]:
    args = Arguments(
        out=Path("unused"),
        task="T1",
        num_envs=settings.num_envs,
        batch_size=2400,
        n_epochs=5,
        detector=settings.detector,
        knowledge=settings.knowledge,
    )
    pairs = [
        [steps_per_s(kind, args, settings.rollouts) for kind in (SpoofVecEnv, Nothing)]
        for _ in range(settings.rounds)
    ]
    engine, nothing = np.median(pairs, axis=0)
    return {
        "num_envs": args.num_envs,
        "detector": args.detector,
        "knowledge": args.knowledge,
        "engine_steps_per_s": round(float(engine), 1),
        "without_physics_steps_per_s": round(float(nothing), 1),
        "ratio": round(float(np.median([a / b for a, b in pairs])), 3),
        "ratios": [round(a / b, 3) for a, b in pairs],
    }


@error_lines()
def main() -> None:
    settings = tyro.cli(Settings, description=__doc__)
    found = measure(settings)
    if settings.json:
        print(json.dumps(found))
        return
    names = {"engine": "engine", "without_physics": "without physics"}
    rows = [(name, f"{found[f'{key}_steps_per_s']:,.0f}") for key, name in names.items()]
    Table.of_texts("environment", "steps/s").print("PPO, learning included", rows)
    each = ", ".join(f"{ratio:.2f}" for ratio in found["ratios"])
    print(f"ratio {found['ratio']:.2f} (median of {each})")


if __name__ == "__main__":
    main()
