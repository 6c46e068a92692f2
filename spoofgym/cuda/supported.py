"""What is there on a device: drivers, and which settings of an environment."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ..attacks.commands import FalsePosition, PerChannel
from ..attacks.offsets import Offsets
from ..core.extras import name_extra
from ..detectors.calibrated import Calibrated
from ..detectors.charts import Ewma, Shewhart
from ..envs.core import SpoofCore
from ..envs.terms import observation as seen
from ..simulation.setup import Setup
from ..simulation.tight import TightlyCoupledSetup, split_scale
from .memory import DETECTORS

LEAST_CUDA = (13, 0)
TERMS: dict[type[Any], str] = {
    seen.OwnOffsets: "offsets",
    seen.Time: "time",
    seen.TargetMotion: "motion",
    seen.TargetDirection: "direction",
    seen.SatelliteGeometry: "geometry",
    seen.GainWeight: "weights",
    seen.StatisticRatio: "ratio",
}
"""Observation terms that depend on what has happened, by what is observed."""


def import_torch() -> Any:
    """PyTorch, once numba's compiler for devices and a driver are there too; else an error."""
    try:
        import torch

        from ._compile import SIMULATED

        if not SIMULATED:
            import numba_cuda  # type: ignore[import-not-found]  # noqa: F401
    except ImportError as error:
        raise name_extra("device='cuda'", error, "cuda") from error
    if not SIMULATED:
        from numba import cuda

        check_driver(cuda)
    return torch


def check_driver(cuda: Any) -> None:
    if not cuda.is_available():
        raise RuntimeError("device='cuda' needs an NVIDIA driver and a GPU, and finds none")
    found = tuple(cuda.cudadrv.driver.driver.get_version())
    if found < LEAST_CUDA:
        raise RuntimeError(
            f"device='cuda' needs a driver of CUDA {LEAST_CUDA[0]} (580 or newer), and finds one "
            f"of CUDA {'.'.join(map(str, found))}"
        )


def check_receivers(setup: Setup) -> None:
    """Raise a ValueError where receivers have what a device lacks, with its name."""
    if not isinstance(setup, TightlyCoupledSetup):
        raise ValueError(f"device='cuda' has no {setup.whose}: only a tightly coupled receiver")
    detector: Any = split_scale(setup.detector)[0]
    weighs = isinstance(detector, Ewma) and detector.weight_scale is not None
    rescaled = isinstance(setup.detector, Calibrated) and setup.detector.rescaled
    known = type(detector) in DETECTORS or rescaled
    found = {
        "receiver 'augmented'": setup.receiver.tuning == "augmented",
        "a detector with rescaled innovations": rescaled,
        f"detector {type(detector).__name__}": not known,
        "`max_exclusion_s` of the detector": weighs and detector.max_exclusion_s is not None,
        "`min_satellites` of the detector": weighs and detector.min_satellites,
        "`bias_window_s` of the detector": getattr(detector, "bias_window_s", 0.0) > 0.0,
        "`two_sided` of the detector": getattr(detector, "two_sided", False),
        "a filter of the detector's own": getattr(detector, "filter", "victim") != "victim",
        "`weight_scale` of Shewhart": isinstance(detector, Shewhart) and detector.weight_scale,
    }
    _refuse(found)


def check_supported(core: SpoofCore) -> None:
    """Raise a ValueError where an environment has what a device lacks, with its name."""
    check_receivers(core.setup)
    attack, settings = core.setup.attack, core.settings
    equipment = attack.capture is not None or attack.replaces_errors or not attack.idle_is_clean
    found = {
        f"attack {attack.kind!r}": type(attack) not in (FalsePosition, PerChannel, Offsets),
        "an attack with a capture, tracking, a clock or errors of its own": equipment,
        "`watch`": settings["watch"],
        "`epoch`": settings["epoch"] is not False,
        "an `end` but at an alarm": core._has_ends,
        "`twin`": settings["twin"],
        "an action that corrects a spoofer's": core.commands.base is not None,
        "a reward term in Python": not core._compiled,
    }
    seen = {type(term) for term, _ in core.observer._parts}
    _refuse(found | {f"observation term {x.__name__}": x not in TERMS for x in seen})


def _refuse(found: Mapping[str, Any]) -> None:
    if lacking := [what for what, there in found.items() if there]:
        raise ValueError(f"device='cuda' does not have {', '.join(lacking)}")


def check_free_memory(receivers: int, each: int, free: int) -> None:
    """Raise a ValueError where receivers of `each` bytes need more than is `free` on a device."""
    most = math.floor(0.95 * free / each)
    if receivers > most:
        raise ValueError(
            f"{receivers} receivers need {receivers * each / 2**30:.1f} GiB, and the device has "
            f"{free / 2**30:.1f} GiB free: at most {most}"
        )
