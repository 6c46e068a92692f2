"""Which settings of an environment there are on a device."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ..attacks.commands import FalsePosition, PerChannel
from ..attacks.offsets import Offsets
from ..core.devices import import_torch
from ..detectors.calibrated import Calibrated
from ..detectors.charts import Ewma, Shewhart
from ..envs.core import SpoofCore
from ..envs.terms import observation as seen
from ..simulation.setup import Setup
from ..simulation.tight import TightlyCoupledSetup, split_scale
from .memory import DETECTORS


def _see_offsets(arrays: Any, rows: Any, term: Any) -> Any:
    moved = arrays["displacement"] / rows["unit_offsets"], arrays["rate"] / rows["unit_rates"]
    return import_torch().cat([*moved, arrays["action_mask"], arrays["taken"]], dim=1)


def _see_ratio(arrays: Any, rows: Any, term: Any) -> Any:
    ratio = arrays["statistic"] / arrays["threshold"]
    return ratio.amax(dim=1, keepdim=True) if term.largest else ratio


TERMS: dict[type[Any], Callable[[Any, Any, Any], Any]] = {
    seen.OwnOffsets: _see_offsets,
    seen.Time: lambda arrays, rows, term: arrays["time"],
    seen.TargetMotion: lambda arrays, rows, term: arrays["motion"],
    seen.TargetDirection: lambda arrays, rows, term: arrays["direction"],
    seen.SatelliteGeometry: lambda arrays, rows, term: rows["geometry"][arrays["epochs"]],
    seen.GainWeight: lambda arrays, rows, term: arrays["weights"],
    seen.StatisticRatio: _see_ratio,
    seen.EstimateError: lambda arrays, rows, term: arrays["error"] * (1.0 / term.scale_m),
    seen.ReportedPosition: lambda arrays, rows, term: arrays["reported"],
    seen.ReportedDeviation: lambda arrays, rows, term: arrays["reported"],
}
"""What is observed by a term, in the first columns, of tensors of receivers, and of all."""


def check_receivers(setup: Setup, *, attacked: bool = True) -> None:
    """Raise a ValueError where receivers, or their attack, have what a device lacks, by name."""
    if not isinstance(setup, TightlyCoupledSetup):
        raise ValueError(f"device='cuda' has no {setup.whose}: only a tightly coupled receiver")
    detector: Any = split_scale(setup.detector)[0]
    usual = {"bias_window_s": 0.0, "two_sided": False, "filter": "victim"}
    if isinstance(detector, Ewma) and detector.weight_scale is not None:
        usual |= {"max_exclusion_s": None, "min_satellites": 0}
    elif isinstance(detector, Shewhart):
        usual["weight_scale"] = None
    rescaled = isinstance(setup.detector, Calibrated) and setup.detector.rescaled
    found = {
        "receiver 'augmented'": setup.receiver.tuning == "augmented",
        "a detector with rescaled innovations": rescaled,
        f"detector {type(detector).__name__}": type(detector) not in DETECTORS and not rescaled,
        **{f"`{x}` of the detector": getattr(detector, x, y) != y for x, y in usual.items()},
    }
    if attacked:
        attack: Any = setup.attack
        equipment = attack.capture is not None or attack.replaces_errors or not attack.idle_is_clean
        found[f"attack {attack.kind!r}"] = type(attack) not in (FalsePosition, PerChannel, Offsets)
        found["an attack with a capture, tracking, a clock or errors of its own"] = equipment
    _refuse(found)


def check_supported(core: SpoofCore) -> None:
    """Raise a ValueError where an environment has what a device lacks, with its name."""
    check_receivers(core.setup)
    found = {
        "`watch`": core.settings["watch"],
        "`epoch`": core.settings["epoch"] is not False,
        "an `end` but at an alarm": core._has_ends,
        "`twin`": core.settings["twin"],
        "an action that corrects a spoofer's": core.commands.base is not None,
        "a reward term in Python": not core._compiled,
    }
    seen = {type(term) for term, _ in core.observer._parts}
    _refuse(found | {f"observation term {x.__name__}": x not in TERMS for x in seen})


def _refuse(found: Mapping[str, Any]) -> None:
    if lacking := [what for what, there in found.items() if there]:
        raise ValueError(f"device='cuda' does not have {', '.join(lacking)}")
