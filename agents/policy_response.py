"""A spoofer that PPO of stable-baselines3 learns against a mix of detectors."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from stable_baselines3 import PPO

from spoofgym.bench.runs.players import Mixture
from spoofgym.export import onnx
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers.learned import finite
from spoofgym.tasks import ALARM_PRICE, task_of

from .learning import for_learning, learn

NUM_ENVS, LOG_STD = 32, -1.5
"""Of PPO, which decides as seldom as in `train.ppo_spoofer`; the rest are the defaults of
stable-baselines3, with gamma 1."""


def learn_against(
    mix: Mixture, task: str, limit_m: float, steps: int, file: Path, seed: int, threads: int
) -> bool:
    """Let PPO learn against a mix, and write what it has learned, as an ONNX file with its card.
    `mix`: of detectors; every episode meets one of them; `limit_m`: alert limit in place of the
    task's [m]; 0 for that.  Returns whether there is such a policy: none is written whose weights
    are not finite."""
    pool, world = mix.pool(), task_of(task)
    length = limit_m or world.alert_limit_m
    settings: dict[str, Any] = {
        **world.world_kwargs,
        **({} if length is None else {"length_m": length}),
        "pool": pool["members"],
        "weights": pool["weights"],
        "threads": threads,
        "alarm_price": ALARM_PRICE,
    }
    env = SpoofVecEnv(NUM_ENVS, seed=seed, **for_learning(settings))
    n_steps = env.core.episode_steps
    model = PPO(
        "MlpPolicy",
        env,
        n_steps=n_steps,
        batch_size=n_steps * NUM_ENVS // 2,
        gamma=1.0,
        policy_kwargs={"log_std_init": LOG_STD},
        seed=seed,
        device="cpu",
    )
    learn(model, steps)
    sound = finite(model.policy)
    if sound:
        onnx(model, env, file)
    env.close()
    return sound
