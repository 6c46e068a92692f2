"""The measure of PPO's speed, with settings that take seconds."""

import json
import sys

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
for name in ("stable_baselines3", "onnxscript", "tyro"):
    pytest.importorskip(name)

from benchmarks import ppo_speed
from benchmarks.ppo_speed import Nothing, main
from spoofgym.sb3 import SpoofVecEnv


def test_ratio_and_speeds_are_medians_each_of_its_environment(monkeypatch, capsys):
    def call(*given):
        monkeypatch.setattr(sys, "argv", ["benchmarks.ppo_speed", *given])
        main()
        return json.loads(capsys.readouterr().out)

    found = call("--rounds", "1", "--rollouts", "1", "--num-envs", "2", "--json")
    assert [found[key] for key in ("num_envs", "detector")] == [2, "ewma:thresholds=nominal"]
    assert min(found["engine_steps_per_s"], found["without_physics_steps_per_s"]) > 0.0
    with pytest.raises(SystemExit) as told:
        call("--rounds", "0")
    assert "`rounds`" in f"{told.value.code} {capsys.readouterr().err}"  # Python prints a word
    speeds = {SpoofVecEnv: iter((30.0, 20.0, 40.0)), Nothing: iter((60.0, 80.0, 50.0))}
    monkeypatch.setattr(ppo_speed, "steps_per_s", lambda kind, *_: next(speeds[kind]))
    found = call("--rounds", "3", "--json")
    assert (found["engine_steps_per_s"], found["without_physics_steps_per_s"]) == (30.0, 60.0)
    assert (found["ratio"], found["ratios"]) == (0.5, [0.5, 0.25, 0.8])


def test_the_environment_without_physics_looks_like_the_engine():
    timeline = {"warmup_s": 6.0, "live_s": 3.0, "attack_s": 10.0}
    kwargs = {"scenario": "zhong2025", "timeline": timeline, "prefetch": False}
    looks = []
    for kind in (SpoofVecEnv, Nothing):
        envs = kind(2, seed=0, threads=1, **kwargs)
        seen = [envs.reset()]
        for _ in range(envs.core.setup.steps):
            actions = np.zeros((2, *envs.action_space.shape), dtype=np.float32)
            observation, reward, over, infos = envs.step(actions)
            seen.append(observation)
        arrays = [(array.shape, array.dtype) for array in (*seen, reward, over)]
        looks.append((envs.observation_space, envs.action_space, arrays))
        assert all({"terminal_observation", "TimeLimit.truncated"} <= set(info) for info in infos)
        envs.close()
    assert looks[0] == looks[1]
    assert over.all()
