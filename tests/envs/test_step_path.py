"""One step is a short way through the package."""

import sys
from pathlib import Path

import numpy as np

import spoofgym

from .support import victim

ROOT = Path(spoofgym.__file__).parent
ELSEWHERE = ("attacks", "detectors", "envs/terms")
"""What has a contract of its own, and calls what it likes; kernels are no Python."""
MOST_CALLS = 18


def calls_of(work):
    """Python functions of the package that are called, in order; not what terms and kernels do."""
    found = []
    outside = []

    def profile(frame, event, _):
        path = Path(frame.f_code.co_filename)
        if not path.is_relative_to(ROOT):
            return
        name = path.relative_to(ROOT).as_posix()
        if event == "call" and name.startswith(ELSEWHERE):
            outside.append(id(frame))
        elif event == "call" and not outside and not path.stem.endswith("_kernels"):
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
    for watch, most in ((None, MOST_CALLS), ("ewma", np.inf)):
        env = victim("Zhong2025", detector="never", watch=watch).unwrapped
        env.reset(seed=1)
        action = np.zeros(env.action_space.shape, dtype=np.float32)
        for _ in range(3):  # compiles, and makes what is made once
            env.step(action)
        calls = calls_of(lambda env=env, action=action: env.step(action))
        assert calls[0] == "envs/env.py:CoreEnv.step"
        assert any(call.endswith("TightlyCoupledSimulator.step") for call in calls)
        assert len(calls) <= most, "\n".join(calls)
        assert not any(call.startswith(ELSEWHERE) for call in calls)
        assert any("PassiveInfo" in call for call in calls) == bool(watch)  # so they are counted
