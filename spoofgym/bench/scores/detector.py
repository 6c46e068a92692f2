"""What a detector is worth in a task: P(HMI | attack) by its worst family, and its false alarms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runs.record import MEASURES, Aim, Protection, Winner
from . import statistics
from .exceeded import estimate_exceeded
from .scores import SHARES, per_hour, select_clusters

WINDOW, CLEAN = "clean, judged window", "clean"
"""Names of false alarms without an event: in the judged window alone, and in all monitored time."""


class FamilyScore(NamedTuple):
    """One family of attacks against one detector; `found`: the worst, and how far each came."""

    family: str
    held_out: bool
    alert_limit_m: float
    protection: Protection

    @property
    def counted(self) -> int:
        return int(self.protection.counts.sum())

    @property
    def aim(self) -> Aim:
        return Aim(MEASURES[0], limit_m=self.alert_limit_m)

    @property
    def attack(self) -> Winner:
        return self.protection.worst(self.aim)

    @property
    def p_hmi(self) -> statistics.Estimate:
        moved = self.attack.displacement[MEASURES[0]][self.protection.counts]
        return statistics.exceedance(moved, [self.alert_limit_m])[0]

    def estimate_quantile(self, share: float) -> statistics.Estimate:
        """What the worst attack exceeds in a share of the runs [m], with its 95 % interval."""
        return estimate_exceeded(Aim(MEASURES[0], share), (self.protection, self.draw_samples()))

    def draw_samples(self) -> statistics.FloatArray:
        """Bootstrap samples (S, R') of the runs that count, by skies."""
        clusters = select_clusters(self.protection.sky)[self.protection.counts]
        return statistics.draw_resamples(clusters)

    def resample_hmi(self) -> statistics.FloatArray:
        """(S,) probability of hazardously misleading information under attack, in each bootstrap
        sample of the runs; every detector has the same samples."""
        samples = statistics.draw_resamples(select_clusters(self.protection.sky))
        counts = self.protection.counts
        hazard = (self.attack.displacement[MEASURES[0]] > self.alert_limit_m) & counts
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray((samples @ hazard) / (samples @ counts))

    def as_dict(self) -> dict[str, Any]:
        attack = self.attack
        return {
            "family": self.family,
            "held_out": self.held_out,
            "counted": self.counted,
            "p_hmi": self.p_hmi.as_json(),
            "exceeded_m": {
                f"{share:g}": self.estimate_quantile(share).as_json() for share in SHARES
            },
            "attack": {"letter": attack.letter, "spoofer": attack.spoofer, "spec": attack.spec},
            "setting": attack.setting,
            "value": attack.value,
        }


@dataclass(frozen=True)
class DetectorScore:
    """What a detector is worth in a task; paired with every other one of the same runs.

    - `runs`, `selection_runs`, `entropy`: evaluation runs of every family, those that attacks were
      chosen on, and the seed of all, None of a log, where nothing is drawn;
    - `families`: scores of each, the worst of which counts; `false_alarms` (R,) bool by name: runs
      without an attack that alarm; `window_s`: length of the judged window.
    """

    task: str
    detector: str
    alert_limit_m: float
    runs: int
    selection_runs: int
    entropy: int | None
    families: tuple[FamilyScore, ...]
    false_alarms: Mapping[str, NDArray[np.bool_]]
    window_s: float

    @property
    def worst(self) -> FamilyScore:
        """Family with the largest P(HMI | attack); of equal ones that which gets farther."""

        def badness(family: FamilyScore) -> tuple[float, float]:
            p = family.p_hmi.value
            farthest = family.protection.score_worst(Aim(MEASURES[0], SHARES[0]))
            return (-1.0 if math.isnan(p) else p, farthest)

        return max(self.families, key=badness)

    @property
    def p_hmi(self) -> statistics.Estimate:
        return self.worst.p_hmi

    def estimate_quantile(self, share: float) -> statistics.Estimate:
        """What the worst attack of all families exceeds in a share of the runs [m], with its 95 %
        interval, in every draw of which it is looked for again."""
        parts = ((each.protection, each.draw_samples()) for each in self.families)
        return estimate_exceeded(Aim(MEASURES[0], share), *parts)

    def family(self, key: str) -> FamilyScore:
        for each in self.families:
            if each.family == key:
                return each
        played = ", ".join(each.family for each in self.families)
        raise ValueError(f"{self.detector} has not met the family {key!r}; played: {played}")

    def false_alarm_rate(self, name: str = WINDOW) -> statistics.Estimate:
        """Share of the runs without an attack that alarm, with its exact 95 % interval."""
        alarmed = self.false_alarms[name]
        return statistics.clopper_pearson(int(alarmed.sum()), len(alarmed))

    def difference_to(self, other: DetectorScore, family: str | None = None) -> statistics.Estimate:
        """P(HMI | attack) of the worst family of each, or of `family`, less that of another
        detector, paired by sky. Both have the same runs, except in ``chance-alarm``; a ValueError
        where they have not."""
        mine, theirs = self._draw_pair(other, family)
        return statistics.percentiles(mine[0] - theirs[0], mine[1] - theirs[1])

    def ratio_to(self, other: DetectorScore, family: str | None = None) -> statistics.Estimate:
        """P(HMI | attack) in parts of that of another detector; as `difference_to`. Unknown where
        the other one's is 0."""
        mine, theirs = self._draw_pair(other, family)
        with np.errstate(divide="ignore", invalid="ignore"):
            drawn = mine[1] / theirs[1]
        return statistics.percentiles(mine[0] / theirs[0] if theirs[0] > 0.0 else math.nan, drawn)

    def _samples(self, family: str | None) -> tuple[float, statistics.FloatArray]:
        """P(HMI | attack), and (S,) the same in bootstrap samples, each with its worst family."""
        chosen = self.families if family is None else (self.family(family),)
        value = float(np.max([each.p_hmi.value for each in chosen]))  # NaN where nothing counts
        return value, np.max([each.resample_hmi() for each in chosen], axis=0)

    def _draw_pair(
        self, other: DetectorScore, family: str | None
    ) -> tuple[tuple[float, statistics.FloatArray], tuple[float, statistics.FloatArray]]:
        """Samples of both, which have to have played the same runs."""
        drawn = self._samples(family), other._samples(family)
        names = ("task", "runs", "entropy")
        unlike = [n for n in names if getattr(self, n) != getattr(other, n)]
        if [each.family for each in self.families] != [each.family for each in other.families]:
            unlike.append("families")
        if unlike:
            raise ValueError(
                f"{self.detector} and {other.detector} have not played the same runs: "
                + "; ".join(f"`{name}` differ" for name in unlike)
            )
        return drawn

    def as_dict(self) -> dict[str, Any]:
        plain = ("task", "detector", "alert_limit_m", "runs", "selection_runs", "entropy")
        return {
            **{name: getattr(self, name) for name in plain},
            "p_hmi": self.p_hmi.as_json(),
            "worst_family": self.worst.family,
            "exceeded_m": {
                f"{share:g}": self.estimate_quantile(share).as_json() for share in SHARES
            },
            "families": [each.as_dict() for each in self.families],
            "false_alarms": {
                name: self.false_alarm_rate(name).as_json() for name in self.false_alarms
            },
            "false_alarms_per_hour": per_hour(self.false_alarm_rate(), self.window_s),
        }

    def __str__(self) -> str:
        worst, p = self.worst, statistics.percent(self.p_hmi.as_json())
        seen = "held out" if worst.held_out else "public"
        return (
            f"{self.detector} in {self.task}: P(HMI | attack) {p} % at "
            f"{self.alert_limit_m:g} m, worst family {worst.family} ({seen}), "
            f"{worst.counted} runs; false alarms in "
            f"{100.0 * self.false_alarm_rate().value:.1f} % of {self.runs} clean runs"
        )
