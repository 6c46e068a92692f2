"""What a detector promises, and what it costs where nobody attacks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...detectors.calibration_file import hourly_rate
from ..runs.record import Cell
from .paired import FREE
from .statistics import Estimate, clopper_pearson, clustered_proportion

NOMINAL = "nominal"  # footing of detectors that were asked for no rate


def operating_point(config: dict[str, Any], detector: str) -> dict[str, Any]:
    """What a detector was asked for: ``claimed``, and the ``footing`` on which it is compared. The
    footing is the rate; ``"nominal"`` where none was asked for, and ``"any"`` of a detector that
    never alarms."""
    found = config["calibrations"].get(detector, [])
    rates = {point["false_alarms_per_hour"] for point in found}
    claimed = None
    if found:
        first = found[0]
        names = ("per_run", "false_alarms_per_hour", "runs", "extrapolated", "warmup_alarms")
        claimed = {name: first[name] for name in names}
    if len(rates) == 1:
        footing = f"{rates.pop():g}"
    else:
        footing = FREE if detector in config["never_alarm"] else NOMINAL
    return {"claimed": claimed, "footing": footing}


def score_detector(clean: Cell) -> dict[str, Any]:
    """False alarms of a detector and their price, from its runs without attack. Per run, per hour,
    and per epoch of the window, which is the availability that is lost; in the warm-up; satellites
    that are blamed though nobody attacks, in satellite seconds an hour, None where channels are not
    judged; RMS distance from the truth, and the largest while coasting."""
    records, window_s = clean.records, clean.window * clean.interval_s
    warm = int(records["warmup_alarm"].sum())
    per_run = clopper_pearson(int(clean.alarmed.sum()), clean.runs)
    hours = clean.runs * window_s / 3600.0
    blamed = float(records["blamed"].sum()) * clean.interval_s / hours
    coasting = records["coasting_epochs"] > 0
    return {
        "detector": clean.detector,
        "window_s": window_s,
        "false_alarm_per_run": per_run.as_json(),
        "false_alarms_per_hour": _per_hour(per_run, window_s),
        "false_alarm_per_epoch": clustered_proportion(
            records["alarm_epochs"], clean.window
        ).as_json(),
        "warmup_alarm_per_run": clopper_pearson(warm, clean.runs).as_json(),
        "blamed_s_per_hour": round(blamed, 4) if clean.head["judges_channels"] else None,
        "navigation_rms_m": float(np.sqrt(np.mean(records["navigation_rms_m"] ** 2)).round(4)),
        "coasting_error_m": mean_of(records["coasting_error_m"][coasting]),
    }


def _per_hour(per_run: Estimate, window_s: float) -> dict[str, float | None]:
    rates = (hourly_rate(each, window_s) for each in per_run)
    return {
        name: round(rate, 6) if np.isfinite(rate) else None
        for name, rate in zip(Estimate._fields, rates, strict=True)
    }


def number(value: Any) -> float:
    return round(float(value), 4)


def mean_of(x: NDArray[Any]) -> float | None:
    return number(x.mean()) if len(x) else None
