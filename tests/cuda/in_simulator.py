"""Played by numba's simulator of a device: on the processor, too, with the same bits, or refused.

Run in a process of its own, since numba reads ``NUMBA_ENABLE_CUDASIM`` when it is imported.
"""

from __future__ import annotations

import json
import re
import sys
import warnings
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import gymnasium as gym
import numpy as np
import pytest
import torch

from spoofgym.cuda import CudaVectorEnv
from spoofgym.envs.factory import make_core, select_victim
from spoofgym.simulation.engine import seed_pasts
from spoofgym.simulation.simulator import FilterDiverged
from spoofgym.simulation.tight import AFTER_ONSET
from spoofgym.truth.noise import threefry
from spoofgym.truth.sensors import SOURCES

RECEIVERS, PASTS, STEPS = 2, 3, 8
EVERY = np.arange(RECEIVERS)
VICTIM = select_victim("tightly-coupled")
LINE = {"warmup_s": 1.0, "live_s": 1.0, "attack_s": 2.0, "time_to_alert_s": 1.0}
SETTINGS = {"timeline": LINE, "imu_rate_hz": 10, "detector": "never", "knowledge": "blind"}
PAGE = Path(__file__).resolve().parents[2] / "docs" / "cuda.md"


class Processor:
    """The same episodes in a core of the library."""

    def __init__(self, settings: dict[str, Any], seed: np.ndarray) -> None:
        self.core = make_core(VICTIM, RECEIVERS, {**settings, "warm_pool": 0}, threads=1)
        self.pool = self.core.setup.simulator(PASTS, lambda work, b: work(0, b))
        self.pool.warm_up(seed_pasts(np.arange(PASTS)))
        self.core.engine.simulator.warm_up(seed_pasts(EVERY))
        self.seed, self.number = seed, np.zeros(RECEIVERS, dtype=np.int64)

    def start(self, rows: np.ndarray) -> None:
        self.number[rows] += 1
        simulator = self.core.engine.simulator
        for b in rows.tolist():
            drawn = threefry(np.uint64(self.number[b]), np.uint64(b), *self.seed)
            row, past = np.array([b]), np.array([drawn[0] % PASTS])
            simulator.copy_rows(row, self.pool, past)
            for name in AFTER_ONSET:
                key = threefry(np.uint64(SOURCES.index(name)), np.uint64(0), *map(np.uint64, drawn))
                simulator.sensors.words.put(name, row, np.array([key], dtype=np.uint64))
        self.core.score.reset(rows)
        self.core._decisions.forget(rows)
        self.core.commands.aim(self.core.heading_rad)
        self.core.set_origin(rows)


def compare(settings: dict[str, Any]) -> dict[str, int]:
    """Play both, and count what has been compared; an AssertionError where a bit differs."""
    device = CudaVectorEnv(RECEIVERS, pasts=PASTS, infos="all", **settings)
    first, _ = device.reset(seed=5)
    cpu = Processor(settings, device._rows["seed"].numpy().view(np.uint64))
    count = compare_lasting(device._fleet.tensors, cpu.pool)
    same("alarms", device._fleet.tensors["warmup_alarm"], cpu.pool.memory["warmup_alarm"])
    cpu.start(EVERY)
    same("first observation", first, cpu.core.observe())
    rng, ends = np.random.default_rng(3), 0
    for _ in range(STEPS):
        action = rng.uniform(-1.0, 1.0, (RECEIVERS, len(device.action_names)))
        result, last = cpu.core.step(action)
        seen, reward, terminated, _, info = device.step(torch.from_numpy(action))
        found = {"reward": reward, "terminated": terminated, **info}
        wanted = {"reward": result.reward, "terminated": result.terminated, "final_obs": last}
        wanted |= result.info
        assert set(found) == set(wanted), set(found) ^ set(wanted)
        for name, array in wanted.items():
            same(name, found[name], array)
            count += array.size
        ends += int(result.terminated.any())
        cpu.start(np.flatnonzero(result.terminated))
        same("observation", seen, cpu.core.observe())
    count += compare_lasting(device._arrays, cpu.core.engine.simulator)
    device.close()
    return {"numbers": count, "resets": ends}


def same(name: str, found: torch.Tensor, wanted: np.ndarray) -> None:
    bits = (np.asarray(x).view(f"u{x.dtype.itemsize}") for x in (found, wanted))
    np.testing.assert_array_equal(*bits, err_msg=name)


def compare_lasting(tensors: Any, simulator: Any) -> int:
    """State, covariance, sensors and commands of all receivers."""
    found = {**simulator.lasting_arrays(), "weights": simulator.weights}
    for name, array in found.items():
        same(name, tensors[name], array)
    return sum(array.size for array in found.values())


def play_the_page() -> None:
    """Its code, with two receivers and a short flight."""
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    assert "num_envs=4096" in code
    small = f"num_envs=2, pasts=2, timeline={LINE!r}, imu_rate_hz=10"
    exec(code.replace("num_envs=4096", small), {})


def raises(error: type[Exception], message: str, work: Any, *given: Any, **how: Any) -> None:
    with pytest.raises(error, match=message):
        work(*given, **how)


def take_turns(*envs: CudaVectorEnv) -> list[torch.Tensor]:
    """All that each environment brings, from one seed, while they step in turn."""
    found = [[env.reset(seed=1)[0]] for env in envs]
    for env, own in [*zip(envs, found, strict=True)] * 5:
        own += env.step(torch.ones(env.num_envs, 1))[:3]
    return [torch.cat([each.ravel() for each in own]) for own in found]


def refuse() -> dict[str, int]:
    """What an environment on a device refuses, and that two of them leave each other alone."""
    made = gym.make_vec("spoofgym/Zhong2025-v0", num_envs=2, device="cuda", pasts=2, **SETTINGS)
    env = made.unwrapped
    assert isinstance(env, CudaVectorEnv)
    other = CudaVectorEnv(3, pasts=2, infos=["alarm"], **SETTINGS | {"knowledge": "blind+reported"})
    raises(RuntimeError, "call reset", env.step, torch.zeros(2, 1))
    first, info = env.reset(seed=1)
    assert (first.shape, first.dtype, info) == (env.observation_space.shape, torch.float32, {})
    raises(TypeError, "tensor on cpu, got ndarray", env.step, np.zeros((2, 1)))
    raises(TypeError, "got one on meta", env.step, torch.zeros(2, 1, device="meta"))
    raises(ValueError, "shape", env.step, torch.zeros(3, 1))
    for number in (float("nan"), 1.5, float("-inf")):
        raises(ValueError, "NaN", env.step, torch.full((2, 1), number))
    raises(ValueError, "options", env.reset, options={"reset_mask": np.ones(2, dtype=np.bool_)})
    raises(ValueError, "same_step", CudaVectorEnv, 2, autoreset_mode="next_step", **SETTINGS)
    raises(ValueError, "info", CudaVectorEnv, 2, pasts=2, infos=("nothing",), **SETTINGS)
    alone = [*take_turns(env), *take_turns(other)]
    assert all(map(torch.equal, alone, take_turns(env, other)))
    _, reward, terminated, truncated, info = other.step(torch.ones(3, 1))
    assert {*info} == {"alarm"}
    assert (reward.dtype, terminated.dtype, truncated.dtype) == (torch.float64, *[torch.bool] * 2)
    env._arrays["x"][1] = float("nan")
    env.step(torch.zeros(2, 1))
    raises(FilterDiverged, "receiver 1 of 2", env.step, torch.zeros(2, 1))
    env.reset()
    env.step_unchecked(torch.full((2, 1), float("nan")))
    raises(FilterDiverged, "receiver 0 of 2", env.check)
    raises(ValueError, "an epoch beyond the world", env._fleet.run, 100_000)
    # an interrupt leaves a step halfway, up to a reset
    env.reset()
    env._restart = Mock(side_effect=KeyboardInterrupt)
    raises(KeyboardInterrupt, "", env.step, torch.zeros(2, 1))
    raises(RuntimeError, "halfway", env.step, torch.zeros(2, 1))
    del env._restart
    env.reset()
    env.step(torch.zeros(2, 1))
    play_the_page()
    return {"refused": 1}


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    for case in json.loads(sys.argv[1]):
        print(json.dumps(compare(case) if case else refuse()), flush=True)
