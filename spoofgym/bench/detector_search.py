"""The search for the worst attacks of a family on a detector, whose settings it looks for.

What just passes an alert limit unnoticed is a narrow range of settings, and from one value of the
grid to the next a displacement doubles: gaps are halved before anything is chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..attacks import make_attack
from ..spoofers import SpooferContext
from .attack_search import Search
from .attack_suite import Member
from .detector_runs import Panel
from .entries import Entry
from .protection import MEASURES
from .searches import Selection, log_spaced
from .specs import Spec

FloatArray = NDArray[np.float64]
ROUNDS, FINE = 3, (-1.0, -0.5, 0.5, 1.0)
"""How often the gaps beside the best values that sift are halved, and steps of what is left that
all runs play."""
IDLE: Spec = {"name": "profile", "rates_mps": [0.0, 0.0]}
"""A spoofer that commands nothing, and transmits."""


@dataclass(frozen=True)
class AntennaEntry(Entry):
    """A meaconer whose antenna's distance is looked for; its settings are those of the attack."""

    def with_value(self, value: float) -> Spec:
        """Meaconer with its antenna so far to the east [m]."""
        return {**self.spec, str(self.tuned): [0.0, value, 0.0]}


class Played:
    """Displacements of a panel's detectors by member, value and number of runs, each played once.
    What one detector's search has played is there for the others."""

    def __init__(self, panel: Panel, members: Sequence[Member], tick: Callable[[float], None]):
        self.panel, self.members, self.tick = panel, members, tick
        self._found: dict[tuple[int, float, int], FloatArray] = {}

    def __call__(self, member: int, value: float, runs: int) -> FloatArray:
        """(D, R') [m]."""
        key = member, value, runs
        if key not in self._found:
            entry = self.members[member].entry
            spec, attack = entry.with_value(value), None
            if isinstance(entry, AntennaEntry):
                spec, attack = IDLE, make_attack(spec)
            self._found[key] = self.panel.displacement(spec, runs, attack)
            self.tick(runs)
        return self._found[key]


class FamilySearch(Search):
    """The search for the worst attacks of a family on one detector of a panel."""

    by_skies = False
    neighbours, rounds = FINE, ROUNDS

    def __init__(
        self,
        played: Played,
        number: int,
        context: SpooferContext,
        settings: Selection,
        antenna_m: tuple[float, float],
    ) -> None:
        panel = played.panel
        super().__init__(panel.start, panel.clean, played.members, context, settings)
        self.counts, self.sky = panel.counts[:, number], panel.sky
        self._played, self._number, self._antenna_m = played, number, antenna_m

    def _grid(self, member: Member) -> list[float]:
        if isinstance(member.entry, AntennaEntry):
            return log_spaced(*self._antenna_m, self.settings.values)
        return super()._grid(member)

    def _play(self, member: int, value: float, runs: int) -> dict[str, FloatArray]:
        return {MEASURES[0]: self._played(member, value, runs)[self._number]}
