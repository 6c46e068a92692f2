"""How far an attack can go unseen, whoever looks: floor, open-loop attack and zero-alarm bound.

- `compute_frontier`: the floor, the displacement that even a perfect detector would allow;
- `power`, `deflection_for`: what the best possible test can do;
- `compute_zero_alarm`: what no attack exceeds in the mean without raising an alarm itself;
- `Replay`: response replay, by which passive detectors judge any open-loop attack.
"""

from __future__ import annotations

from .bounds import Attacker, compute_zero_alarm
from .floor import ASSUMPTIONS, Analyst, Frontier, WorldFrontier, compute_frontier
from .linear import Commands, LinearRun, Response, record, respond, unit_commands
from .power import deflection_for, power
from .response import NotReplayable, Replay
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
    "compute_frontier",
    "compute_zero_alarm",
    "deflection_for",
    "power",
    "record",
    "respond",
    "unit_commands",
]
