"""Victims of the benchmark, and the detectors that suit each."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..envs.spoofer_binding import ENV_ID
from ..simulators import (
    LooselyCoupledSetup,
    SnapshotSetup,
    TightlyCoupledSetup,
    WheeledRobotSetup,
    loosely_coupled,
    wheeled_robot,
)
from ..simulators.setup import Setup
from .entries import DEFAULT_DETECTORS


class Victim(NamedTuple):
    """Kind of victim, and its detectors in a campaign by default."""

    setup: type[Setup]
    detectors: tuple[dict[str, Any], ...]


LOOSE = loosely_coupled.DEFAULT_DETECTOR
VICTIMS = {
    ENV_ID: Victim(TightlyCoupledSetup, DEFAULT_DETECTORS),
    "spoofgym/LooselyCoupled-v0": Victim(LooselyCoupledSetup, (LOOSE,)),
    "spoofgym/Snapshot-v0": Victim(SnapshotSetup, ({"name": "raim"}, {"name": "srv-raim"})),
    "spoofgym/WheeledRobot-v0": Victim(
        WheeledRobotSetup, ({"name": "rio"}, wheeled_robot.DEFAULT_DETECTOR)
    ),
}
"""By environment."""
