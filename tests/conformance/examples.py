"""A record of each class that has settings without defaults, for the tests of their bounds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from spoofgym.bench.experiments.dataset import Plan
from spoofgym.bench.runs.world import World
from spoofgym.detectors import Calibrated, LearnedDetector, SnapshotChi2
from spoofgym.detectors.learned import PolicyDetector
from spoofgym.envs.terms.action import Channels
from spoofgym.envs.terms.termination import AtDisplacement, AtStealthBudget, AtSteps
from spoofgym.policies.contract import FunctionPolicy
from spoofgym.spoofers.learned import OnnxPolicy

EXAMPLES: dict[type, Callable[[], Any]] = {
    # truth, data
    # -
    # -
    # attacks, spoofers
    OnnxPolicy: lambda: OnnxPolicy("ewma-ppo"),
    # -
    # receiver, simulation, calibration
    # -
    # -
    # detectors
    Calibrated: lambda: Calibrated(SnapshotChi2(), scale=1.0),
    LearnedDetector: lambda: LearnedDetector("trolley-guard"),
    PolicyDetector: lambda: PolicyDetector(policy=FunctionPolicy(abs)),
    # envs, duel
    Channels: lambda: Channels(("north",)),
    AtDisplacement: lambda: AtDisplacement(50.0),
    AtStealthBudget: lambda: AtStealthBudget(2.0),
    AtSteps: lambda: AtSteps(7),
    # -
    # bench, limits, cli
    Plan: lambda: Plan(World().setup, 40.0),
    # -
    # -
}
