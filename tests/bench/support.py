"""A campaign that takes seconds."""

from __future__ import annotations

from typing import Any

from spoofgym.bench.suite import Suite, Tuning
from spoofgym.envs.setup import Timeline

SHORT = Timeline(warmup_s=20.0, live_s=10.0, attack_s=20.0, time_to_alert_s=5.0)
QUICK = Tuning(runs=6, sift_runs=3, values=4, refined=2, budget=0.2)


def small_suite(**changes: Any) -> Suite:
    settings: dict[str, Any] = {
        "timeline": SHORT,
        "tuning": QUICK,
        "runs": 5,
        "detectors": ("snapshot-chi2", "ewma"),
        "spoofers": ("step", {"name": "ramp", "rate_mps": "tuned"}),
        **changes,
    }
    return Suite(**settings)
