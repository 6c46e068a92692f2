"""Starts of a process: import, the first step with an empty cache of compiled code, a later one."""

import os
import subprocess
import sys

import pytest

from spoofgym.core.compile import CACHE_VARIABLE

IMPORT = "import spoofgym"
STEP = f"""{IMPORT}
import gymnasium as gym
env = gym.make("spoofgym/Zhong2025-v0")
env.reset(seed=0)
env.step(env.action_space.sample())
"""


def run(code, cache):
    subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, CACHE_VARIABLE: str(cache)},
        check=True,
        stderr=subprocess.DEVNULL,
    )


@pytest.mark.parametrize("code", ["pass", IMPORT], ids=["python", "import"])
def test_import(benchmark, tmp_path, code):
    benchmark.pedantic(run, (code, tmp_path), rounds=5, warmup_rounds=1)


def test_cold_start(benchmark, tmp_path):
    benchmark.pedantic(run, (STEP, tmp_path), rounds=1)


def test_start_with_compiled_code(benchmark, tmp_path):
    benchmark.pedantic(run, (STEP, tmp_path), rounds=5, warmup_rounds=1)
