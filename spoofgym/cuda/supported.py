"""What is there on a device: drivers, and which settings of an environment."""

from __future__ import annotations

import math
from typing import Any

from ..attacks.commands import FalsePosition, PerChannel
from ..core.extras import name_extra
from ..detectors import Detector
from ..detectors.calibrated import Calibrated
from ..detectors.charts import Ewma, Shewhart
from ..detectors.chi_square import SnapshotChi2
from ..detectors.controls import Never
from ..detectors.cusum import Cusum
from ..envs.core import SpoofCore
from ..envs.terms import observation as seen
from ..simulation.tight import TightlyCoupledSetup

LEAST_CUDA = (13, 0)
DETECTORS: tuple[type[Detector], ...] = (Never, Ewma, Shewhart, Cusum, SnapshotChi2)
TERMS: dict[type[Any], str] = {
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

        from ._lanes import SIMULATED

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


def split_scale(detector: Detector) -> tuple[Detector, float]:
    """Detector without a calibration, and the factor on its thresholds."""
    if isinstance(detector, Calibrated):
        return detector.detector, float(detector.scale or 1.0)
    return detector, 1.0


def check_supported(core: SpoofCore) -> None:
    """Raise a ValueError where an environment has what a device lacks, with its name."""
    setup, settings = core.setup, core.settings
    lacking: list[str] = []

    def refuse(found: Any, what: str) -> None:
        if found:
            lacking.append(what)

    if not isinstance(setup, TightlyCoupledSetup):
        raise ValueError(f"device='cuda' has no {setup.whose}: only a tightly coupled receiver")
    attack, (detector, _) = setup.attack, split_scale(setup.detector)
    refuse(setup.receiver.tuning == "augmented", "receiver 'augmented'")
    refuse(type(attack) not in (FalsePosition, PerChannel), f"attack {attack.kind!r}")
    equipment = attack.capture is not None or attack.replaces_errors or not attack.idle_is_clean
    refuse(equipment, "an attack with a capture, tracking, a clock or errors of its own")
    refuse(type(detector) not in DETECTORS, f"detector {type(detector).__name__}")
    calibrated = isinstance(setup.detector, Calibrated) and setup.detector.rescaled
    refuse(calibrated, "a detector with rescaled innovations")
    if isinstance(detector, Ewma) and detector.weight_scale is not None:
        refuse(detector.max_exclusion_s is not None, "`max_exclusion_s` of the detector")
        refuse(detector.min_satellites, "`min_satellites` of the detector")
    refuse(getattr(detector, "bias_window_s", 0.0) > 0.0, "`bias_window_s` of the detector")
    refuse(getattr(detector, "two_sided", False), "`two_sided` of the detector")
    refuse(getattr(detector, "filter", "victim") != "victim", "a filter of the detector's own")
    refuse(isinstance(detector, Shewhart) and detector.weight_scale, "`weight_scale` of Shewhart")
    refuse(settings["watch"], "`watch`")
    refuse(settings["epoch"] is not False, "`epoch`")
    refuse(core._has_ends, "an `end` but at an alarm")
    refuse(settings["twin"], "`twin`")
    refuse(core.commands.base is not None, "an action that corrects a spoofer's")
    refuse(setup.repeat > 1, "`decision_interval_s`")
    refuse(not core._compiled, "a reward term in Python")
    for term, _ in core.observer._parts:
        refuse(type(term) not in TERMS, f"observation term {type(term).__name__}")
    if lacking:
        raise ValueError(f"device='cuda' does not have {', '.join(lacking)}")


def check_free_memory(receivers: int, each: int, free: int) -> None:
    """Raise a ValueError where receivers of `each` bytes need more than is `free` on a device."""
    most = math.floor(0.95 * free / each)
    if receivers > most:
        raise ValueError(
            f"{receivers} receivers need {receivers * each / 2**30:.1f} GiB, and the device has "
            f"{free / 2**30:.1f} GiB free: at most {most}"
        )
