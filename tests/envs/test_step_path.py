"""One step is a short way through the package."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import spoofgym

from .support import victim

ROOT = Path(spoofgym.__file__).parent
ELSEWHERE = ("attacks", "detectors", "envs/terms")
"""What has a contract of its own, and calls what it likes; kernels are no Python."""
MOST_CALLS = 15


def calls_of(work) -> list[str]:
    """Python functions of the package that are called, in order; not what terms and kernels do."""
    found: list[str] = []
    outside: list[int] = []

    def profile(frame, event, _):
        path = Path(frame.f_code.co_filename)
        if not path.is_relative_to(ROOT):
            return
        name = path.relative_to(ROOT).as_posix()
        if event == "call":
            if name.startswith(ELSEWHERE):
                outside.append(id(frame))
            elif not outside and not path.stem.endswith("_kernels"):
                found.append(f"{name}:{frame.f_code.co_qualname}")
        elif event == "return" and outside and outside[-1] == id(frame):
            outside.pop()

    sys.setprofile(profile)
    try:
        work()
    finally:
        sys.setprofile(None)
    return found


def test_a_step_takes_few_calls():
    """Of the single environment, in its steady state, without a defence."""
    env = victim("TightlyCoupled", detector="never").unwrapped
    env.reset(seed=1)
    action = np.zeros(env.action_space.shape, dtype=np.float32)
    for _ in range(3):  # compiles, and makes what is made once
        env.step(action)
    calls = calls_of(lambda: env.step(action))
    assert calls[0] == "envs/env.py:CoreEnv.step"
    assert any(call.endswith("TightlyCoupledSimulator.step") for call in calls)
    assert len(calls) <= MOST_CALLS, "\n".join(calls)
    passive = victim("TightlyCoupled", detector="never", watch="ewma").unwrapped
    passive.reset(seed=1)
    passive.step(action)
    found = calls_of(lambda: passive.step(action))
    assert any("PassiveInfo" in call for call in found)  # so that calls are counted
    assert not any(call.startswith(ELSEWHERE) for call in found)
