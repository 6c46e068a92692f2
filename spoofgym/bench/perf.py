"""How fast this machine steps the environments, measured as Gymnasium measures it.

The vector environment has 64 receivers with epochs of 1 s (100 inertial samples), the ``ewma``
detector and the default observations; episodes do not end at an alarm.  The loop lasts at least
as long as asked for, and until every receiver has started a second episode, so that its share of
resets with their warm-up is counted.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from typing import Any

import numpy as np

ENV = "spoofgym/TightlyCoupled-v0"
SETTINGS: dict[str, Any] = {
    "scenario": {"name": "zhong2025", "epoch_interval_s": 1.0},
    "detector": "ewma",
    "end_at_alarm": False,
}
LONGEST_S = 3600.0


def _check_duration(duration_s: float) -> None:
    if not 0.0 <= duration_s <= LONGEST_S:
        raise ValueError(f"the duration must be 0 to {LONGEST_S:g} s, got {duration_s:g} s")


def vector_speed(
    num_envs: int = 64, threads: int | None = None, duration_s: float = 10.0, **settings: Any
) -> dict[str, Any]:
    """Steps a second of the vector environment, all receivers together.

    `threads`: of the engine; as many as it finds worth while by default.
    """
    import gymnasium as gym

    _check_duration(duration_s)
    envs = gym.make_vec(ENV, num_envs=num_envs, threads=threads, **{**SETTINGS, **settings})
    used = envs.unwrapped.core.engine.threads  # type: ignore[attr-defined]
    envs.action_space.seed(0)
    envs.reset(seed=0)
    actions = envs.action_space.sample()
    envs.step(actions)
    steps, ended = 0, np.zeros(num_envs, dtype=np.int64)
    began = time.perf_counter()
    while True:
        _, _, terminated, truncated, _ = envs.step(actions)
        steps += num_envs
        ended += terminated | truncated
        passed = time.perf_counter() - began
        # the step after the end is the one that starts the next episode
        if passed >= duration_s and ended.min() >= 1 and not (terminated | truncated).any():
            break
    envs.close()
    return {
        "num_envs": num_envs,
        "threads": used,
        "steps_per_s": round(steps / passed, 1),
        "steps": steps,
        "episodes": int(ended.sum()),
        "duration_s": round(passed, 3),
    }


def single_speed(duration_s: float = 5.0, **settings: Any) -> dict[str, Any]:
    """Steps a second of the single environment, resets included."""
    import gymnasium as gym

    _check_duration(duration_s)
    env = gym.make(ENV, **{**SETTINGS, **settings})
    env.action_space.seed(0)
    env.reset(seed=0)
    action = env.action_space.sample()
    env.step(action)
    env.reset()
    steps = episodes = 0
    began = time.perf_counter()
    while True:
        _, _, terminated, truncated, _ = env.step(action)
        steps += 1
        if terminated or truncated:
            episodes += 1
            env.reset()
            passed = time.perf_counter() - began
            if passed >= duration_s:
                break
    env.close()
    return {
        "steps_per_s": round(steps / passed, 1),
        "steps": steps,
        "episodes": episodes,
        "duration_s": round(passed, 3),
    }


def overhead(num_envs: int = 64, rounds: int = 5, **settings: Any) -> dict[str, Any]:
    """What an environment costs on top of its engine, in steps without resets.

    Engine and environment run the same commands from the same seed by turns, on one thread and in
    processor time, so that a busy machine counts little.
    """
    import gymnasium as gym

    given = {**SETTINGS, **settings}
    env: Any
    if num_envs == 1:
        env = gym.make(ENV, **given).unwrapped
    else:
        env = gym.make_vec(ENV, num_envs=num_envs, threads=1, prefetch=False, **given).unwrapped
    engine, steps = env.core.engine, env.core.setup.steps - 1
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    command = np.zeros((num_envs, len(env.action_names)))

    def seconds(step: Callable[[Any], Any], what: Any) -> float:
        """Processor time of the steps of an episode."""
        env.reset(seed=0)
        began = time.thread_time()
        for _ in range(steps):
            step(what)
        return time.thread_time() - began

    pairs = [(seconds(engine.step, command), seconds(env.step, action)) for _ in range(rounds)]
    env.close()
    alone, whole = (min(pair[k] for pair in pairs) * 1e6 / steps for k in range(2))
    return {
        "num_envs": num_envs,
        "engine_us": round(alone, 1),
        "env_us": round(whole, 1),
        "overhead_us": round(whole - alone, 1),
        "overhead_percent": round(100.0 * (whole - alone) / alone, 1),
    }


def machine() -> dict[str, Any]:
    """What it was measured on."""
    try:
        usable = len(os.sched_getaffinity(0))
    except AttributeError:
        usable = os.cpu_count() or 1
    return {
        "processors": usable,
        "processor": platform.processor() or platform.machine(),
        "python": platform.python_version(),
    }
