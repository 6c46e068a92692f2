"""A record of each class that has settings without defaults, for the tests of their bounds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

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
    # -
    # -
    # envs, duel
    # -
    # -
    # bench, limits, cli
    # -
    # -
}
