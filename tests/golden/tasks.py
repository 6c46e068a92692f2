"""What the tasks are, and what a stated spoofer gets in them: kept, so that they stay as they are.

python -m tests.golden.tasks     # writes tests/golden/tasks.json
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from spoofgym.attacks import ATTACKS
from spoofgym.bench.runs.players import specify_detector
from spoofgym.bench.runs.world import World
from spoofgym.core.files import write_file
from spoofgym.core.registry import build_spec
from spoofgym.core.settings import compute_digest, describe
from spoofgym.tasks import TASKS, Task

KEPT = Path(__file__).with_name("tasks.json")
SEEDS = (0, 1, 2)
LAST = 0.5
"""Command of the last decision, as a part of the limit of rate; it rises from 0 evenly."""


def resolved(task: Task) -> dict[str, Any]:
    """All settings of a task with their defaults, and the factors on its detectors' thresholds."""
    env: Any = gym.make(task.env_id).unwrapped
    setup = env.core.setup
    points = World.of(task.key).points(specify_detector(task.detector))
    found = {
        "world": setup.conditions.settings,
        "attack": build_spec("attack", ATTACKS, setup.attack),
        "target_heading_deg": setup.target_heading_deg,
        "decision_interval_s": setup.decision_interval_s,
        "between": setup.between,
        "detectors": list(task.detectors),
        "scales": [point.scale for point in points],
        "alert_limit_m": task.alert_limit_m,
        "length_m": env.core.length_m,
        "observation": list(env.observation_names),
        "action": list(env.action_names),
        "spec": task.env_kwargs,
    }
    env.close()
    kept: dict[str, Any] = json.loads(json.dumps(describe(found)))
    return kept


def returns(task: Task, seeds: tuple[int, ...] = SEEDS) -> dict[str, list[float]]:
    """Return and undetected displacement of episodes with commands that rise evenly."""
    env = gym.make(task.env_id, warm_pool=0)
    setup: Any = env.unwrapped.core.setup
    decisions = setup.steps // setup.repeat
    found: dict[str, list[float]] = {"return": [], "undetected_displacement_m": [], "steps": []}
    for seed in seeds:
        env.reset(seed=seed)
        total, over, k = 0.0, False, 0
        while not over:
            action = np.full(env.action_space.shape, LAST * min(k / decisions, 1.0))
            _, reward, terminated, truncated, info = env.step(action.astype(np.float32))
            total, over, k = total + float(reward), terminated or truncated, k + 1
        found["return"].append(total)
        found["undetected_displacement_m"].append(float(info["undetected_displacement_m"]))
        found["steps"].append(float(k))
    env.close()
    return found


def differences(kept: Any, now: Any, at: str = "") -> list[str]:
    """Keys at which settings differ, with both values."""
    if isinstance(kept, dict) and isinstance(now, dict):
        keys = [*kept, *(key for key in now if key not in kept)]
        pairs = [(f".{key}", kept.get(key), now.get(key)) for key in keys]
    elif isinstance(kept, list) and isinstance(now, list) and len(kept) == len(now):
        pairs = [(f"[{k}]", *pair) for k, pair in enumerate(zip(kept, now, strict=True))]
    else:
        return [] if kept == now else [f"{at}: {kept!r} is {now!r} now"]
    return [line for part, one, other in pairs for line in differences(one, other, at + part)]


def main() -> None:
    """Write what is kept."""
    found = {}
    for key, task in TASKS.items():
        settings = resolved(task)
        found[key] = {"sha256": compute_digest(settings), "settings": settings, **returns(task)}
        print(key, found[key]["sha256"], found[key]["undetected_displacement_m"], flush=True)
    write_file(KEPT, (json.dumps(found, indent=1) + "\n").encode())


if __name__ == "__main__":
    main()
