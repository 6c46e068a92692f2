"""A record of each class that has settings without defaults, for the tests of their bounds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

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
    # -
    # -
    # bench, limits, cli
    # -
    # -
}
