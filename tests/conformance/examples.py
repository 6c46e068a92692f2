"""A record of each class that has settings without defaults, for the tests of their bounds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from spoofgym.detectors import Calibrated, LearnedDetector, SnapshotChi2
from spoofgym.detectors.learned import PolicyDetector
from spoofgym.policies.contract import FunctionPolicy

EXAMPLES: dict[type, Callable[[], Any]] = {
    # truth, data
    # -
    # -
    # attacks, spoofers
    # -
    # -
    # receiver, simulation, calibration
    # -
    # -
    # detectors
    Calibrated: lambda: Calibrated(SnapshotChi2(), scale=1.0),
    LearnedDetector: lambda: LearnedDetector("trolley-guard"),
    PolicyDetector: lambda: PolicyDetector(policy=FunctionPolicy(abs)),
    # envs, duel
    # -
    # -
    # bench, limits, cli
    # -
    # -
}
