"""PTX of all kernels, as an environment launches them, for some architectures, without a GPU.

``python -m tests.cuda.ptx 75 80 90``: an environment is made on the processor, and whatever it
launches is lowered once, compiled by NVVM for each architecture in place of being run, and read.
"""

from __future__ import annotations

import json
import re
import sys
from functools import partial
from types import SimpleNamespace
from typing import Any

import numba
import numba.cuda.dispatcher as dispatcher
import torch
from numba import cuda
from numba.cuda.cudadrv import nvvm

from spoofgym.cuda import _kernels, memory, pool, supported, vector_env
from spoofgym.cuda._compile import compile_kernel, forbid_contraction

WORLD = {
    "timeline": {"warmup_s": 0.5, "live_s": 0.5, "attack_s": 1.0, "time_to_alert_s": 0.5},
    "detector": {"name": "windowed-chi2", "thresholds": "nominal", "window": 2},
    "imu_rate_hz": 10,
}
done: set[str] = set()
forbid_contraction()
compile_ir = nvvm.compile_ir


def compile_for_all(name: str, llvmir: Any, **options: Any) -> bytes:
    """Print name, architecture, length and fused multiply-adds in double precision."""
    ptx = b""  # all of `age` is part of the step, too
    for number in sys.argv[1:2] if name == "age" else sys.argv[1:]:
        ptx = compile_ir(llvmir, **options | {"arch": f"compute_{number}"})
        assert f".target sm_{number}".encode() in ptx
        fused = len(re.findall(rb"\bfma\.\w+\.f64", ptx))
        print(json.dumps([name, number, len(ptx), fused]), flush=True)
    return ptx


def compile_instead(name: str, receivers: int, device: Any, *arguments: Any) -> None:
    kinds = tuple(map(numba.typeof, arguments))
    if f"{name} {kinds}" in done:
        return
    done.add(f"{name} {kinds}")
    nvvm.compile_ir = partial(compile_for_all, name)
    how = {"device": False, "abi": "numba", "cc": (7, 5), "output": "ptx"}
    cuda.compile(compile_kernel(getattr(_kernels, name)).py_func, kinds, **how)


if __name__ == "__main__":
    dispatcher.get_current_device = lambda: SimpleNamespace(compute_capability=(7, 5))
    for module in (memory, pool, supported, vector_env):
        vars(module).update(SIMULATED=True, import_torch=lambda: torch, launch=compile_instead)
    env = vector_env.CudaVectorEnv(3, pasts=2, **WORLD)
    env.reset(seed=0)
    env.step(torch.zeros(3, 1))
