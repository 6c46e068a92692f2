"""What an environment on a device refuses, by the simulator; in a process of its own."""

import re
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

import spoofgym
from spoofgym.cuda import CudaVectorEnv
from spoofgym.simulation.simulator import FilterDiverged

LINE = {"warmup_s": 1.0, "live_s": 1.0, "attack_s": 2.0, "time_to_alert_s": 1.0}
SETTINGS = {"timeline": LINE, "imu_rate_hz": 10, "detector": "never", "knowledge": "blind"}


PAGE = Path(__file__).resolve().parents[2] / "docs" / "cuda.md"


def play_the_page() -> None:
    """Its code, with two receivers and a short flight."""
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.DOTALL)
    assert "num_envs=4096" in code
    small = {"num_envs": 2, "pasts": 2, "timeline": LINE, "imu_rate_hz": 10}
    given = ", ".join(f"{name}={value!r}" for name, value in small.items())
    exec(code.replace("num_envs=4096", given), {})


def main() -> None:
    warnings.simplefilter("ignore")
    assert spoofgym.__version__
    made = gym.make_vec("spoofgym/Zhong2025-v0", num_envs=2, device="cuda", pasts=2, **SETTINGS)
    env = made.unwrapped
    assert isinstance(env, CudaVectorEnv)
    assert env.num_envs == 2
    assert env.observation_space.shape == (2, 4)
    other = CudaVectorEnv(3, pasts=2, infos=("alarm",), **SETTINGS)
    with pytest.raises(RuntimeError, match="call reset"):
        env.step(torch.zeros(2, 1))
    first, info = env.reset(seed=1)
    assert isinstance(first, torch.Tensor)
    assert first.dtype == torch.float32
    assert info == {}
    with pytest.raises(TypeError, match="tensor"):
        env.step(np.zeros((2, 1)))
    with pytest.raises(ValueError, match="shape"):
        env.step(torch.zeros(3, 1))
    for wrong in (float("nan"), 1.5, float("-inf")):
        with pytest.raises(ValueError, match="NaN"):
            env.step(torch.full((2, 1), wrong))
    with pytest.raises(ValueError, match="options"):
        env.reset(options={"reset_mask": np.ones(2, dtype=np.bool_)})
    with pytest.raises(ValueError, match="same_step"):
        CudaVectorEnv(2, pasts=2, autoreset_mode="next_step", **SETTINGS)
    with pytest.raises(ValueError, match="info"):
        CudaVectorEnv(2, pasts=2, infos=("nothing",), **SETTINGS)
    # two environments on one device leave each other alone, and a seed gives the same again
    seen, reward, terminated, truncated, info = env.step(torch.ones(2, 1))
    other.reset(seed=9)
    assert {*other.step(torch.zeros(3, 1))[4]} == {"alarm"}
    assert torch.equal(env.reset(seed=1)[0], first)
    again = env.step(torch.ones(2, 1))
    assert torch.equal(again[0], seen)
    assert torch.equal(again[1], reward)
    assert reward.dtype == torch.float64
    assert terminated.dtype == truncated.dtype == torch.bool
    assert info == {}
    env._arrays["x"][1] = float("nan")
    env.step(torch.zeros(2, 1))
    with pytest.raises(FilterDiverged, match="receiver 1 of 2"):
        env.step(torch.zeros(2, 1))
    made.close()
    other.close()
    play_the_page()
    print("refused")


if __name__ == "__main__":
    main()
