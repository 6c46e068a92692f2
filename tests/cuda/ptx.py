"""PTX of all kernels, as an environment launches them, for some architectures, without a GPU.

``python -m tests.cuda.ptx types`` in the simulator prints the arguments of every kernel; with the
file of that and architectures such as ``8,0`` each is compiled by NVVM, and read.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

OF_EPOCHS = ("play_step", "age")  # long kernels; the others are compiled for the first architecture


def describe(value: Any) -> Any:
    if isinstance(value, tuple):
        return {name: describe(each) for name, each in value._asdict().items()}
    if not isinstance(value, np.ndarray):
        return "int64"
    layout = "C" if value.flags.c_contiguous else "F" if value.flags.f_contiguous else "A"
    return [value.dtype.name, value.ndim, layout]


def list_arguments() -> dict[str, list[Any]]:
    """Arguments by kernel, in an environment whose detector reads all that there is."""
    from spoofgym.cuda import pool, vector_env

    found: dict[str, list[Any]] = {}
    launch = pool.launch

    def note(name: str, receivers: int, device: Any, *arguments: Any) -> None:
        kinds = [describe(each) for each in arguments]
        if name != "take" or len(kinds[0]) == 3:
            found[f"{name} {json.dumps(kinds)}"] = kinds
        launch(name, receivers, device, *arguments)

    pool.launch = vector_env.launch = note
    timeline = {"warmup_s": 0.5, "live_s": 0.5, "attack_s": 1.0, "time_to_alert_s": 0.5}
    detector = {"name": "snapshot-chi2", "thresholds": "nominal"}
    settings = {"timeline": timeline, "detector": detector, "imu_rate_hz": 10}
    env = vector_env.CudaVectorEnv(3, pasts=2, **settings)
    env.reset(seed=0)
    env.step(env._torch.zeros(3, 1))
    return found


def compile_kernels(arguments: dict[str, list[Any]], architectures: list[str]) -> None:
    """Print name, architecture, length and fused multiply-adds in double precision of each."""
    import numba.cuda.dispatcher as dispatcher
    from numba import cuda, types

    from spoofgym.cuda import _kernels
    from spoofgym.cuda._compile import copy_kernel, forbid_contraction

    tuples = {t._fields: t for t in (_kernels.Receivers, _kernels.Shared, _kernels.Episodes)}

    def kind(value: Any) -> Any:
        if value == "int64":
            return types.int64
        if isinstance(value, dict):
            return types.NamedTuple([kind(x) for x in value.values()], tuples[tuple(value)])
        name, axes, layout = value
        return types.Array(getattr(types, name.replace("bool", "boolean")), axes, layout)

    forbid_contraction()
    for place, architecture in enumerate(architectures):
        major, minor = map(int, architecture.split(","))
        device = SimpleNamespace(compute_capability=(major, minor))
        dispatcher.get_current_device = lambda device=device: device
        for key, given in arguments.items():
            name = key.partition(" ")[0]
            if place and name not in OF_EPOCHS[:1]:
                continue
            kernel, signature = copy_kernel(getattr(_kernels, name)), tuple(map(kind, given))
            how = {"device": False, "abi": "numba", "cc": (major, minor), "output": "ptx"}
            ptx, _ = cuda.compile(kernel, signature, **how)
            fused, target = len(re.findall(r"\bfma\.\w+\.f64", ptx)), f".target sm_{major}{minor}"
            assert target in ptx
            print(json.dumps([name, architecture, len(ptx), fused]), flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "types":
        print(json.dumps(list_arguments()))
    else:
        compile_kernels(json.loads(Path(sys.argv[1]).read_text()), sys.argv[2:])
