"""A record of each class that has settings without defaults, for the tests of their bounds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from spoofgym.bench.experiments.dataset import Plan
from spoofgym.bench.runs.world import World
from spoofgym.envs.terms.action import Channels
from spoofgym.envs.terms.termination import AtDisplacement, AtStealthBudget, AtSteps

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
    # -
    # -
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
