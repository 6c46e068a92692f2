"""How far an attack can go unseen, whoever looks: floor, blind optimum and zero-alarm bound.

- `frontier_of`: the floor, the displacement that even a perfect detector would allow;
- `power`, `deflection_for`, `most_power`: what the best possible test can do;
- `zero_alarm_of`: what no attack exceeds in the mean without an alarm of its own doing;
- `Replay`: response replay, by which passive detectors judge any open-loop attack.
"""

from __future__ import annotations

from .analyst import Analyst
from .floor import (
    ASSUMPTIONS,
    Frontier,
    WorldFrontier,
    deflection,
    deflection_of_offsets,
    frontier_of,
)
from .linear import Commands, LinearRun, Response, record, respond, unit_commands
from .power import deflection_for, divergence_of, most_power, power
from .response import NotReplayable, Replay
from .restricted import Attacker, zero_alarm_of
from .zero_alarm import Bound

__all__ = [
    "ASSUMPTIONS",
    "Analyst",
    "Attacker",
    "Bound",
    "Commands",
    "Frontier",
    "LinearRun",
    "NotReplayable",
    "Replay",
    "Response",
    "WorldFrontier",
    "deflection",
    "deflection_for",
    "deflection_of_offsets",
    "divergence_of",
    "frontier_of",
    "most_power",
    "power",
    "record",
    "respond",
    "unit_commands",
    "zero_alarm_of",
]
