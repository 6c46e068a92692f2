"""Many open-loop profiles on the same runs, side by side in one engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spoofgym.bench.runs.play import WarmStart, displacement_of, play
from spoofgym.bench.scores.scores import counted
from spoofgym.simulation import Setup
from spoofgym.spoofers import Profile, SpooferContext
from spoofgym.spoofers.profile import sampled

FloatArray = NDArray[np.float64]
MOST_RECEIVERS = 1024
"""Largest batch of one engine; more of them cost memory and bring no speed."""


class Outcome(NamedTuple):
    """What P profiles did on R runs.

    - `displacement_m`: (P, R) undetected displacement [m];
    - `alarm`: (P, R) bool, whether the run alarmed;
    - `peak`: (P, R) largest ratio of a statistic to its threshold; of an alarmed run above 1;
    - `counts`: (R,) bool, which runs count: silent before the onset and without attack.
    """

    displacement_m: FloatArray
    alarm: NDArray[np.bool_]
    peak: FloatArray
    counts: NDArray[np.bool_]

    @property
    def alarm_rate(self) -> FloatArray:
        """(P,) part of the runs that count with an alarm."""
        return np.asarray(self.alarm[:, self.counts].mean(axis=1))

    @property
    def mean_m(self) -> FloatArray:
        """(P,) mean undetected displacement over the runs that count [m]."""
        return np.asarray(self.displacement_m[:, self.counts].mean(axis=1))


@dataclass(kw_only=True)
class Population(Profile):
    """Several profiles, each on an equal share of the receivers, in their order.

    - rates_mps, cross_rates_mps, heading_deg, label, designed_on: as in `Profile`; the rates are
      those of the first profile;
    - `members`: all of them, with the same heading, all with cross rates or none.
    """

    members: tuple[Profile, ...] = ()

    def bind(self, context: SpooferContext) -> None:
        """Prepare for a batch of receivers."""
        super().bind(context)
        count, steps = len(self.members), context.steps
        self._along = np.concatenate([sampled(m.rates_mps, steps) for m in self.members])
        self._across = np.concatenate(
            [sampled(m.cross_rates_mps or (0.0, 0.0), steps) for m in self.members]
        )
        member = np.arange(context.receivers) * count // context.receivers
        self.memory.declare("member", member)

    def _row(self, step: FloatArray) -> NDArray[np.int64]:
        """Place of the coming epoch in the sampled curves, which lie one after the other."""
        steps = self.context.steps
        within = np.minimum(step.astype(np.int64), steps - 1)
        return np.asarray(self.memory["member"] * steps + within)


def population(profiles: Sequence[Profile]) -> Population:
    """Profiles side by side."""
    first = profiles[0]
    return Population(
        heading_deg=first.heading_deg,
        rates_mps=first.rates_mps,
        cross_rates_mps=first.cross_rates_mps,
        members=tuple(profiles),
    )


class RunPool:
    """Runs at the onset of the attack, and what they do without it.

    - `setup`: world, victim, attack, detector and timeline.
    """

    def __init__(
        self, setup: Setup, rngs: Sequence[np.random.Generator], *, threads: int | None = None
    ) -> None:
        self.setup, self.runs = setup, len(rngs)
        self.start = WarmStart(setup, rngs, threads=threads)
        self.clean = play(self.start, "none")

    def play(self, profiles: Sequence[Profile], rows: NDArray[np.intp] | None = None) -> Outcome:
        """Let profiles attack the same runs. `profiles`: with the same heading, all with cross
        rates or none."""
        rows = np.arange(self.runs) if rows is None else rows
        share = max(MOST_RECEIVERS // len(rows), 1)
        parts = [
            self._play(profiles[first : first + share], rows)
            for first in range(0, len(profiles), share)
        ]
        displacement, alarm, peak = (np.concatenate(column) for column in zip(*parts, strict=True))
        counts = counted(self.start.warmup_alarm[rows], self.clean.first_alarm[rows])
        if not counts.any():
            raise ValueError(
                f"none of {len(rows)} runs is silent without attack: nothing can be learned of how "
                "an attack is noticed; give the detector another rate of false alarms"
            )
        return Outcome(displacement, alarm, peak, counts)

    def _play(
        self, profiles: Sequence[Profile], rows: NDArray[np.intp]
    ) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
        """Displacement, alarm and peak, (P, R) each."""
        shape, everyone = (len(profiles), len(rows)), np.tile(rows, len(profiles))
        attacked = play(self.start.take(everyone), population(profiles), drop_alarmed=True)
        displacement = displacement_of(self.setup, attacked, self.clean.take(everyone))
        alarm = attacked.alarm.any(axis=0)
        return displacement.reshape(shape), alarm.reshape(shape), attacked.peak.reshape(shape)
