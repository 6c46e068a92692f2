"""Environments of the papers' scenarios."""

from typing import Any

from .v1 import EWMA

NOMINAL = {"thresholds": "nominal"}  # thresholds of the papers, as their own environments have them
PAPERS: dict[str, tuple[str, dict[str, Any]]] = {
    "ke2022": (
        "spoofgym/Zhong2025-v0",
        {
            "scenario": "ke2022",
            "attack": "paper-ideal",
            "detector": {"name": "innovation-rate", **NOMINAL},
            "timeline": {"warmup_s": 350.0, "live_s": 150.0, "attack_s": 200.0},
        },
    ),
    "shadmehri2025": (
        "spoofgym/LooselyCoupled-v0",
        {
            "detector": {
                "name": "windowed-chi2",
                "window": 1,
                "covariance": "estimated",
                "covariance_window": 100,
                **NOMINAL,
            }
        },
    ),
    "song2021": (
        "spoofgym/WheeledRobot-v0",
        {"detector": {"name": "acna", "variant": "production", **NOMINAL}},
    ),
    "wu2024": ("spoofgym/Snapshot-v0", {"detector": {"name": "srv-raim", **NOMINAL}}),
    "zhong2025": (
        "spoofgym/Zhong2025-v0",
        {"scenario": "zhong2025", "attack": "paper-ideal", "detector": {**EWMA, **NOMINAL}},
    ),
}
"""Environments of the papers' scenarios: id and keyword arguments, by the keys of the papers."""
