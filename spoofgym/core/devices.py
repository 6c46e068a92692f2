"""An NVIDIA GPU: its packages, driver and memory, looked for on demand.

Numba's simulator of one (``NUMBA_ENABLE_CUDASIM=1``) needs none of them.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

from numba import config

from .extras import name_extra
from .registry import check_choice

SIMULATED = bool(config.ENABLE_CUDASIM)
"""Whether the simulator stands for a device: Python for every thread, one after the other."""
LEAST_CUDA = (13, 0)


@cache
def import_torch() -> Any:
    """PyTorch, once numba's compiler for devices and a driver are there too; else an error."""
    try:
        import torch

        if not SIMULATED:
            import numba_cuda  # type: ignore[import-not-found]  # noqa: F401
    except ImportError as error:
        raise name_extra("device='cuda'", error, "cuda") from error
    if not SIMULATED:
        from numba import cuda

        check_driver(cuda)
    return torch


def check_device(device: str) -> None:
    """Raise unless it is the processor, or a device whose packages and driver are here."""
    check_choice("device", device.partition(":")[0], ("cpu", "cuda"))
    if device != "cpu":
        import_torch()


def check_driver(cuda: Any) -> None:
    if not cuda.is_available():
        raise RuntimeError("device='cuda' needs an NVIDIA driver and a GPU, and finds none")
    found = tuple(cuda.cudadrv.driver.driver.get_version())
    if found < LEAST_CUDA:
        raise RuntimeError(
            f"device='cuda' needs a driver of CUDA {LEAST_CUDA[0]} (580 or newer), and finds one "
            f"of CUDA {'.'.join(map(str, found))}"
        )


def check_free_memory(memory: Any, device: Any, receivers: int, each: float) -> None:
    """Raise a ValueError where receivers of `each` bytes need more than a device has free; `memory`
    is ``torch.cuda``, part of whose own may be free."""
    if device.type == "cpu":  # which is simulated
        return
    free = memory.mem_get_info(device)[0]
    free += memory.memory_reserved(device) - memory.memory_allocated(device)
    most = math.floor(0.95 * free / each)
    if receivers > most:
        raise ValueError(
            f"{receivers} receivers need {receivers * each / 2**30:.1f} GiB, and the device has "
            f"{free / 2**30:.1f} GiB free: at most {most}"
        )
