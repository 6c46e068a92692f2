"""What an audit says: a detector's score, what it finds at several ages, limits, and warnings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...detectors.calibrated import NOISY_WARMUP
from ...detectors.calibration_file import run_probability
from ..runs.record import MEASURES, Aim, Mask, Protection
from .detector import CLEAN, WINDOW, DetectorScore, FamilyScore
from .exceeded import draw_exceeded
from .scores import SHARES, select_clusters
from .statistics import (
    NOTHING,
    Estimate,
    FloatArray,
    bounded_mean,
    draw_resamples,
    format_number,
    interval,
    percent,
    percentiles,
)

SEARCHED, RIVALS = "open-loop", ("ramps", "profiles", "dashes")
"""Family that is searched for against a detector, and those that it must not be behind."""
TRANSFER = "t"  # letter of attacks that were found against other detectors
BEHIND = 0.02  # part of the displacement by which a search may be behind
BENIGN = 2.0  # times its usual rate from which on alarms at benign events are warned of
FALL = 0.1
"""Part of the test ramps by which a detector finds less at a greater age before it is warned of."""
BLIND = 0.2  # part of what it found before that a blind detector still finds
GROWN = 1.5  # factor on a threshold from which on it has grown


class AgeProbe(NamedTuple):
    """What a detector makes of the same L ramps in the same R runs at A ages, `age_s` (A,) from
    switch-on to the onset [s].

    - `counts` (A, R) runs that are silent without an attack; `found`, `crossed`, `missed` (L, A, R)
      whether there was an alarm, the error passed the alert limit, and did so with none in time;
    - `displacement` (L, A, R) undetected [m]; `threshold` (A,) mean at the onset; `sky` (R,);
    - `alike` () whether it said the same of the same epochs twice.
    """

    age_s: FloatArray
    rate_mps: FloatArray
    counts: Mask
    found: Mask
    crossed: Mask
    missed: Mask
    displacement: FloatArray
    threshold: FloatArray
    sky: NDArray[np.int64]
    alike: Mask

    @property
    def share(self) -> FloatArray:
        """(A, R) part of the ramps that is found in each run."""
        return np.asarray(self.found.mean(axis=0))

    def estimate_share(self, age: int) -> Estimate:
        return self._estimate_mean(self.share[age], self.counts[age])

    def compare_ages(self, age: int, other: int) -> Estimate:
        """Part of the ramps that is found at an age less that at another one, paired by runs.

        Where all runs agree at either age, as where none finds any, a bootstrap has no width of
        it. Then the interval is that between what the bounds of both ages leave, exact ones
        (`clopper1934` in `bounded_mean`) for an age without a width: low less high to high less
        low, which holds the paired one.  By Bonferroni both bounds fail in at most 10 % of cases,
        and the difference in fewer.
        """
        both = self.counts[age] & self.counts[other]
        one, two = (self.share[k] for k in (age, other))
        paired = self._estimate_mean(one - two, both, -1.0)
        if not both.any() or min(np.ptp(one[both]), np.ptp(two[both])) > 0.0:
            return paired
        a, b = (self._estimate_mean(each, both) for each in (one, two))
        return Estimate(paired.value, a.low - b.high, a.high - b.low)

    def compare_to(self, other: AgeProbe, age: int) -> Estimate:
        """Part of the ramps that is found less that which another detector finds in the same runs,
        paired by these."""
        both = self.counts[age] & other.counts[age]
        return self._estimate_mean(self.share[age] - other.share[age], both, -1.0)

    def estimate_missed(self) -> Estimate:
        """Part of the ramps beyond the alert limit with no alarm in time, over all ages."""
        crossed = self.crossed.sum(axis=(0, 1))
        rows = crossed > 0
        return self._estimate_mean(self.missed.sum(axis=(0, 1)) / np.maximum(crossed, 1), rows)

    def _estimate_mean(self, values: FloatArray, rows: Mask, least: float = 0.0) -> Estimate:
        return bounded_mean(values[rows], select_clusters(self.sky)[rows], least)

    def exceed_in_half(self) -> list[float | None]:
        """What the farthest of the ramps exceeds in half of the runs at each age [m]."""
        each = zip(self.counts, self.displacement.swapaxes(0, 1), strict=True)
        return [
            float(np.median(moved[:, rows], axis=1).max()) if rows.any() else None
            for rows, moved in each
        ]

    def warn(self) -> Iterator[str]:
        """That it finds much less, or nothing, at some greater age."""
        shares = [self.estimate_share(k).value for k in range(len(self.age_s))]
        known = [k for k, share in enumerate(shares) if not math.isnan(share)]
        best = max(known, key=lambda k: shares[k], default=0)
        later = [(k, self.compare_ages(k, best)) for k in known if k > best]
        worse = [(k, less) for k, less in later if less.high < 0.0 and less.value <= -FALL]
        if not worse:
            return
        first = next((each for each in worse if shares[each[0]] <= BLIND * shares[best]), None)
        k, less = first or worse[-1]
        more = Estimate(-less.value, -less.high, -less.low)
        words = "finds less the longer it has been switched on"
        if first is not None:
            ages = (format_age(self.age_s[j]) for j in (k - 1, k))
            words = "goes blind between {} and {} after switch-on".format(*ages)
        if (grown := self.threshold[k] / self.threshold[best]) > GROWN:
            words += f", as its threshold grows, {grown:.1f}-fold by then"
        yield (
            f"{words}: it finds {100.0 * shares[best]:.0f} % of the test ramps when they begin "
            f"{format_age(self.age_s[best])} after switch-on, {100.0 * shares[k]:.0f} % after "
            f"{format_age(self.age_s[k])}: a difference of {percent(more.as_json(), 0)} percentage "
            "points in the same runs"
        )

    def as_dict(self) -> dict[str, Any]:
        ages = range(len(self.age_s))
        return {
            "age_s": self.age_s.tolist(),
            "rate_mps": self.rate_mps.tolist(),
            "found": [self.estimate_share(k).as_json() for k in ages],
            "exceeded_in_half_m": self.exceed_in_half(),
            "missed": self.estimate_missed().as_json(),
        }


@dataclass(frozen=True)
class Audit:
    """Audit of one detector in one task: `requested_per_hour`, None for thresholds of its own;
    `floor_m` that even a perfect detector allows, by purpose, and `reference`, figures of the best
    non-learned one, None where not known; `cost_us`: time for an epoch of a receiver [us];
    `broken`: the first rule of the contract of detectors that it breaks."""

    score: DetectorScore
    title: str
    budget: str
    requested_per_hour: float | None
    probe: AgeProbe
    floor_m: Mapping[str, Any] | None
    reference: Mapping[str, Any] | None
    cost_us: float
    broken: str | None = None

    @cached_property
    def figures(self) -> dict[str, Any]:
        """The score as JSON."""
        return self.score.as_dict()

    def find_worst(self, share: float) -> FamilyScore:
        """Family whose worst attack exceeds most in a share of the runs."""
        key = f"{share:g}"
        rows = {
            each["family"]: each["exceeded_m"][key]["value"] for each in self.figures["families"]
        }
        return max(self.score.families, key=lambda each: rows[each.family] or -1.0)

    @property
    def attacks(self) -> dict[str, dict[str, Any]]:
        """Settings of the worst attack of every family by P(HMI), and of the answer's."""
        found = {each.family: each.attack.spec for each in self.score.families}
        half = self.find_worst(SHARES[0]).protection.worst(Aim(MEASURES[0], SHARES[0]))
        return {**found, "worst": half.spec}

    @cached_property
    def warnings(self) -> list[str]:
        """What is wrong with the detector, or with the audit, in words."""
        return [*self._warn()]

    def _warn(self) -> Iterator[str]:
        score, probe = self.score, self.probe
        if self.broken is not None:
            yield self.broken
        if not probe.alike:
            yield "two calls on the same epochs differ: the figures are those of one call"
        if score.false_alarms[CLEAN].all():
            yield "alarms in every run, with an attack and without one: it says nothing"
        elif not (probe.found.any() or score.false_alarms[CLEAN].any()):
            yield "never alarms, with an attack or without one"
        else:
            yield from probe.warn()
        yield from self._warn_of_false_alarms()
        yield from self._warn_of_search()

    def _warn_of_false_alarms(self) -> Iterator[str]:
        score, alarms = self.score, self.score.false_alarms
        if self.requested_per_hour is not None:
            rate = self.figures["false_alarms_per_hour"]
            measured = f"over {rate['low']:.2g}" if rate["value"] is None else interval(rate)
            promise = run_probability(self.requested_per_hour, score.window_s)
            if score.false_alarm_rate().low > promise:
                yield (
                    f"false alarms {measured} an hour, above the "
                    f"{self.requested_per_hour:g} that it is calibrated to"
                )
        usual = score.false_alarm_rate(CLEAN)
        if usual.low > NOISY_WARMUP and usual.value < 1.0:
            yield (
                f"alarms since switch-on in {100.0 * usual.value:.0f} % of the runs without an "
                "attack; attacks are scored on the others"
            )
        words = []
        for name in (each for each in alarms if each not in (WINDOW, CLEAN)):
            rate = score.false_alarm_rate(name)
            if rate.low > BENIGN * max(usual.value, 1.0 / score.runs):
                event = name.replace("_", " ")
                words.append(f"{100.0 * rate.value:.0f} % of the runs with a {event}")
        if words:
            yield (
                f"takes benign events for attacks: alarms in {', '.join(words)}, in "
                f"{100.0 * usual.value:.0f} % of those without"
            )

    def _warn_of_search(self) -> Iterator[str]:
        by_key = {each.family: each for each in self.score.families}
        if SEARCHED in by_key:
            every = by_key[SEARCHED].protection
            rivals = {key: by_key[key].protection for key in RIVALS if key in by_key}
            parts = {adapted: select_winners(every, adapted) for adapted in (True, False)}
            if parts[False].winners:
                rivals["attacks that were found against other detectors"] = parts[False]
            for name, other in rivals.items() if parts[True].winners else ():
                less = compare_exceeded(other, parts[True], SHARES[0])
                if less.low > BEHIND * every.score_worst(Aim(MEASURES[0], SHARES[0])):
                    yield (
                        f"the search failed: what {name} exceed in half of the runs is {less} m "
                        f"more than {SEARCHED} exceeds, which was searched for against this "
                        f"detector: distrust {SEARCHED}"
                    )
        floor = self.floor_m and self.floor_m["half"]["value"]
        found = self.figures["exceeded_m"][f"{SHARES[0]:g}"]
        if floor and found["high"] is not None and found["high"] < floor:
            yield (
                f"no attack gets beyond the {format_number(floor)} m that even a perfect detector "
                "allows: the search failed, or it alarms too often"
            )

    @property
    def answer(self) -> str:
        """The audit in a line."""
        found, worst = self.figures["exceeded_m"][f"{SHARES[0]:g}"], self.find_worst(SHARES[0])
        if found["value"] is None:
            return f"{self.score.detector}: no score, as no run is silent without an attack"
        rate = self.figures["false_alarms_per_hour"]["value"]
        measured = "in every window" if rate is None else f"{rate:.2g}/h"
        promise = "thresholds as published"
        if self.requested_per_hour is not None:
            promise = f"requested {self.requested_per_hour:g}"
        return (
            f"{self.score.detector}: {format_number(found['value'])} m in half of the runs (worst: "
            f"{worst.family}), false alarms {measured} ({promise})"
        )

    def as_dict(self) -> dict[str, Any]:
        return {
            **self.figures,
            "title": self.title,
            "window_s": self.score.window_s,
            "budget": self.budget,
            "requested_per_hour": self.requested_per_hour,
            "worst_in_half": self.find_worst(SHARES[0]).family,
            "worst_in_few": self.find_worst(SHARES[1]).family,
            "ages": self.probe.as_dict(),
            "floor_m": self.floor_m,
            "zero_alarm": self.zero_alarm,
            "reference": self.reference,
            "cost_us": round(self.cost_us, 3),
            "warnings": self.warnings,
            "answer": self.answer,
        }

    @property
    def zero_alarm(self) -> dict[str, Any] | None:
        """Bound of any attack that raises no alarm; None where no profile was searched for."""
        heads = (each.protection.head for each in self.score.families)
        return next((head["zero_alarm"] for head in heads if "zero_alarm" in head), None)

    def __str__(self) -> str:
        return "\n".join([*self.warnings, self.answer])


def select_winners(found: Protection, adapted: bool) -> Protection:
    """Those of the worst attacks that were looked for against the detector, or the others."""
    winners = (each for each in found.winners if (each.letter != TRANSFER) == adapted)
    return replace(found, winners=tuple(winners))


def compare_exceeded(one: Protection, other: Protection, share: float) -> Estimate:
    """What the worst of some attacks exceeds less that of others in the same runs [m]."""
    aim, rows = Aim(MEASURES[0], share), one.counts
    if not rows.any():
        return NOTHING
    samples = draw_resamples(select_clusters(one.sky)[rows])
    both = [draw_exceeded(each, aim, rows, samples) for each in (one, other)]
    return percentiles(one.score_worst(aim) - other.score_worst(aim), both[0] - both[1])


def format_age(age_s: float) -> str:
    """Time in words, as people say it."""
    return f"{age_s:.0f} s" if age_s < 60.0 else f"{age_s / 60.0:.0f} min"
