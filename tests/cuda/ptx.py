"""PTX of all kernels, as an environment launches them, for some architectures, without a GPU.

``python -m tests.cuda.ptx 8,0 9,0``: an environment is made on the processor, and whatever it
launches is compiled by NVVM in place of being run, and read.
"""

from __future__ import annotations

import json
import re
import sys
from types import SimpleNamespace
from typing import Any

import numba
import numba.cuda.dispatcher as dispatcher
import torch
from numba import cuda

from spoofgym.cuda import _kernels, memory, pool, supported, vector_env
from spoofgym.cuda._compile import compile_kernel

WORLD = {
    "timeline": {"warmup_s": 0.5, "live_s": 0.5, "attack_s": 1.0, "time_to_alert_s": 0.5},
    "detector": {"name": "windowed-chi2", "thresholds": "nominal", "window": 2},
    "imu_rate_hz": 10,
}
done: set[str] = set()


def compile_instead(name: str, receivers: int, device: Any, *arguments: Any) -> None:
    """Print name, architecture, length and fused multiply-adds in double precision; of the step for
    all architectures, of other kernels for the first."""
    kinds = tuple(map(numba.typeof, arguments))
    if f"{name} {kinds}" in done:
        return
    done.add(f"{name} {kinds}")
    for architecture in sys.argv[1:] if name == "play_step" else sys.argv[1:2]:
        major, minor = map(int, architecture.split(","))
        current = SimpleNamespace(compute_capability=(major, minor))
        dispatcher.get_current_device = lambda current=current: current
        how = {"device": False, "abi": "numba", "cc": (major, minor), "output": "ptx"}
        ptx, _ = cuda.compile(compile_kernel(getattr(_kernels, name)).py_func, kinds, **how)
        assert f".target sm_{major}{minor}" in ptx
        fused = len(re.findall(r"\bfma\.\w+\.f64", ptx))
        print(json.dumps([name, architecture, len(ptx), fused]), flush=True)


if __name__ == "__main__":
    for module in (memory, pool, supported, vector_env):
        vars(module).update(SIMULATED=True, import_torch=lambda: torch, launch=compile_instead)
    env = vector_env.CudaVectorEnv(3, pasts=2, **WORLD)
    env.reset(seed=0)
    env.step(torch.zeros(3, 1))
