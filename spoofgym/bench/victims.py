"""Victims of the benchmark, and the detectors that suit each."""

from __future__ import annotations

from typing import Any, NamedTuple

from ..envs.spoofer_binding import SETUPS
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


CONTROLS = ({"name": "never"}, {"name": "lottery"})
"""Negative controls, which every table of the benchmark has."""
SKIES = 32
HEADLINE_DOMAIN = {
    "start_s": [0.0, None],
    "turned_deg": [0.0, 360.0],
    "constellation_time_s": [0.0, 86_400.0],
    "worlds": SKIES,
    "turn_on": "drawn",
}
"""What is drawn for every run of a headline: the onset, where the flight heads, the sky, one of
`SKIES`, and the turn-on constants of the inertial sensors.  Which way an attack pushes is fixed, so
that its angle to the flight is drawn, too."""
LOOSE = loosely_coupled.DEFAULT_DETECTOR
DEFAULTS: dict[type[Setup], tuple[dict[str, Any], ...]] = {
    TightlyCoupledSetup: DEFAULT_DETECTORS,
    LooselyCoupledSetup: (LOOSE,),
    SnapshotSetup: ({"name": "raim"}, {"name": "srv-raim"}),
    WheeledRobotSetup: ({"name": "rio"}, wheeled_robot.DEFAULT_DETECTOR),
}
VICTIMS = {env_id: Victim(setup, DEFAULTS[setup]) for env_id, setup in SETUPS.items()}
"""By environment."""
