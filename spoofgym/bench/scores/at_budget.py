r"""Scores at exactly the alarm budget, with intervals that include the fit of the amplitude.

A run's **alarm amplitude** is the smallest amplitude of an attack at which the detector alarms in
the judged window.  With the alarm amplitudes a of the R runs that count, the amplitude at a budget
p is their p-quantile, so that exactly a share p of the runs alarms,

.. math:: A_p = a_{(k)} + (p R - k) (a_{(k+1)} - a_{(k)}), \qquad k = \lfloor p R \rfloor

and the score is the mean undetected displacement there, :math:`D(A_p)`, where D is played at some
amplitudes and interpolated between them.

The bootstrap (`efron1979`) draws skies with all their runs, fits the amplitude to each draw, and
takes the displacement there.  (To draw runs within the skies, too, would count their noise twice:
where skies are alike, 95 % intervals would hold the truth in 99 % of cases.)  The threshold is
itself an order statistic of clean runs: its factor c is drawn too (`Calibration.draw_factors`), and
the displacement follows by its elasticity in the threshold, :math:`c^\eta`.

An attack that is the best of several is chosen on one half of the runs and scored on the other,
and the other way round, in every draw.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..runs.record import MEASURES
from .scores import select_clusters
from .statistics import (
    NOTHING,
    RESAMPLES,
    Estimate,
    FloatArray,
    draw_resamples,
    largest_of_share,
    percentiles,
    weighted_quantile,
)

AMPLITUDE = "amplitude"
PARTS = ("amplitudes", "alarm_amplitude", "alarmed", "sky")  # arrays that are stored as they are


@dataclass(frozen=True)
class AlarmCurve:
    """What an attack does at J `amplitudes`, increasing, around the budget, on R counted runs.

    - `alarm_amplitude` (R,); the first or the last amplitude where it lies beyond them;
    - `displacement` by measure (J, R), undetected [m]; `alarmed` (J, R); `sky` (R,) of each run;
    - `chosen`: that of the amplitudes at the budget; `silent_share` that alarms at none in the
      range;
    - `elasticity` of amplitude and measures in the threshold, at a constant share of alarms;
    - `factors` (S,) on the thresholds, as drawn from their calibration, `RESAMPLES` of them; None
      where the threshold is no estimate.
    """

    amplitudes: FloatArray
    alarm_amplitude: FloatArray
    displacement: Mapping[str, FloatArray]
    alarmed: NDArray[np.bool_]
    sky: NDArray[np.int64]
    chosen: float
    silent_share: float = math.nan
    elasticity: Mapping[str, float] = field(default_factory=dict)
    factors: FloatArray | None = None

    @property
    def runs(self) -> int:
        return len(self.alarm_amplitude)

    def first(self, count: int) -> AlarmCurve:
        """The first of its runs alone, with the threshold as it is."""
        return replace(
            self,
            alarm_amplitude=self.alarm_amplitude[:count],
            displacement={name: each[:, :count] for name, each in self.displacement.items()},
            alarmed=self.alarmed[:, :count],
            sky=self.sky[:count],
            elasticity={},
            factors=None,
        )

    def fit(self, budget: float, samples: FloatArray) -> FloatArray:
        """(S,) amplitude at the budget in bootstrap samples (S, R)."""
        return weighted_quantile(self.alarm_amplitude, budget, samples)

    def compute_mean(self, values: FloatArray, at: FloatArray, samples: FloatArray) -> FloatArray:
        """(S,) mean of `values` (J, R) at an amplitude (S,) of each sample; NaN of no run."""
        with np.errstate(invalid="ignore"):
            return self.interpolate((samples @ values.T) / samples.sum(axis=1)[:, None], at)

    def interpolate(self, scores: FloatArray, at: FloatArray) -> FloatArray:
        """(S,) scores (S, J) of samples at the amplitudes, at one (S,) of each sample."""
        if len(self.amplitudes) == 1:
            return np.asarray(scores[:, 0])
        low = np.clip(np.searchsorted(self.amplitudes, at) - 1, 0, len(self.amplitudes) - 2)
        part = (at - self.amplitudes[low]) / np.diff(self.amplitudes)[low]
        each, part = np.arange(len(at)), np.clip(part, 0.0, 1.0)
        return np.asarray((1.0 - part) * scores[each, low] + part * scores[each, low + 1])

    def parts(self) -> dict[str, NDArray[Any]]:
        """Arrays of what another attack is compared with."""
        name = MEASURES[0]
        found: dict[str, NDArray[Any]] = {
            **{part: getattr(self, part) for part in PARTS},
            name: self.displacement[name].astype(np.float32),
            "elasticity": np.array(self.elasticity.get(name, 0.0)),
        }
        return found if self.factors is None else {**found, "factors": self.factors}

    @classmethod
    def from_parts(cls, arrays: Mapping[str, NDArray[Any]], chosen: float) -> AlarmCurve:
        """Inverse of `parts`, with `chosen`."""
        name, whole = MEASURES[0], {part: arrays[part] for part in PARTS}
        return cls(
            **cast("Any", whole),
            displacement={name: arrays[name].astype(np.float64)},
            chosen=chosen,
            elasticity={name: float(arrays["elasticity"])},
            factors=arrays.get("factors"),
        )


class AtBudget(NamedTuple):
    """An attack at exactly the alarm budget, with 95 % intervals: the `amplitude` by alarm
    amplitudes; the `alarm_rate` there, less where runs are silent again above theirs; mean
    undetected displacement by measure [m]; `within_range`: whether the amplitudes reach down to the
    budget."""

    budget: float
    amplitude: Estimate
    alarm_rate: float
    displacement: Mapping[str, Estimate]
    within_range: bool
    counted: int
    silent_share: float

    def as_json(self) -> dict[str, Any]:
        return {
            "budget": self.budget,
            AMPLITUDE: self.amplitude.as_json(),
            "alarm_rate": None if math.isnan(self.alarm_rate) else round(self.alarm_rate, 6),
            **{name: each.as_json() for name, each in self.displacement.items()},
            "within_range": self.within_range,
            "counted": self.counted,
            "silent_share": None if math.isnan(self.silent_share) else round(self.silent_share, 6),
        }


def _draw(sky: NDArray[np.int64]) -> FloatArray:
    """(1 + S, R) all runs once, and bootstrap samples of them."""
    return np.concatenate([np.ones((1, len(sky))), draw_resamples(select_clusters(sky), RESAMPLES)])


def _scores(curve: AlarmCurve, budget: float, samples: FloatArray) -> dict[str, FloatArray]:
    """(1 + S,) amplitude and displacements in samples, the first of which is the estimate."""
    at = curve.fit(budget, samples)
    found = {AMPLITUDE: at} | {
        name: curve.compute_mean(values, at, samples) for name, values in curve.displacement.items()
    }
    if curve.factors is not None:
        drawn = np.concatenate([[1.0], curve.factors])
        found = {name: x * drawn ** curve.elasticity.get(name, 0.0) for name, x in found.items()}
    return found


def _estimate(drawn: FloatArray) -> Estimate:
    return percentiles(float(drawn[0]), drawn[1:])


def compute_at_budget(curve: AlarmCurve, budget: float) -> dict[str, float]:
    """Amplitude and displacements by measure [m] at the budget, without intervals."""
    if not curve.runs:
        return dict.fromkeys((AMPLITUDE, *curve.displacement), math.nan)
    once = _scores(replace(curve, factors=None), budget, np.ones((1, curve.runs)))
    return {name: float(value[0]) for name, value in once.items()}


def score_at_budget(curve: AlarmCurve, budget: float) -> AtBudget:
    if not curve.runs:
        nothing = dict.fromkeys(curve.displacement, NOTHING)
        return AtBudget(budget, NOTHING, math.nan, nothing, False, 0, curve.silent_share)
    samples = _draw(curve.sky)
    drawn = _scores(curve, budget, samples)
    at = drawn.pop(AMPLITUDE)
    rate = curve.compute_mean(curve.alarmed.astype(np.float64), at[:1], samples[:1])
    return AtBudget(
        budget=budget,
        amplitude=_estimate(at),
        alarm_rate=float(rate[0]),
        displacement={name: _estimate(each) for name, each in drawn.items()},
        within_range=bool(curve.alarmed[0].mean() <= budget),
        counted=curve.runs,
        silent_share=curve.silent_share,
    )


def exceed_at_budget(curve: AlarmCurve, budget: float, part: float) -> Estimate:
    """What is exceeded undetected in a part of the runs, at the amplitude of the budget [m]."""
    if not curve.runs:
        return NOTHING
    samples, name = _draw(curve.sky), MEASURES[0]
    each = [largest_of_share(x, part, samples) for x in curve.displacement[name]]
    drawn = curve.interpolate(np.stack(each, axis=1), curve.fit(budget, samples))
    if curve.factors is not None:
        drawn *= np.concatenate([[1.0], curve.factors]) ** curve.elasticity.get(name, 0.0)
    return _estimate(drawn)


def compare_at_budget(first: AlarmCurve, second: AlarmCurve, budget: float) -> Estimate:
    """Displacement of the first less that of the second, of runs that are not the same [m]. Their
    skies are drawn together, and so is the threshold."""
    if not first.runs or not second.runs:
        return NOTHING
    both = _draw(np.concatenate([first.sky, second.sky]))
    parts = both[:, : first.runs], both[:, first.runs :]
    x, y = (
        _scores(curve, budget, samples)[MEASURES[0]]
        for curve, samples in zip((first, second), parts, strict=True)
    )
    return _estimate(x - y)


def ratio_at_budget(first: AlarmCurve, second: AlarmCurve, budget: float) -> Estimate:
    """Displacement of the first over that of the second on the same runs. Both amplitudes are
    fitted again in every draw, of runs and of the threshold, which they share."""
    if not np.array_equal(first.sky, second.sky):
        raise ValueError("a paired ratio needs two attacks on the same runs")
    if not first.runs:
        return NOTHING
    samples = _draw(first.sky)
    x, y = (_scores(curve, budget, samples)[MEASURES[0]] for curve in (first, second))
    return _estimate(x / y)


def score_best(curves: Sequence[AlarmCurve], budget: float) -> Estimate:
    """Displacement of the best of several attacks on the same runs [m], chosen on one half of the
    runs and scored on the other, both ways round; choices are made again in every draw."""
    sky, runs = curves[0].sky, curves[0].runs
    if runs < 2:
        return NOTHING
    half = np.empty(runs, dtype=np.int64)
    half[np.argsort(sky, kind="stable")] = np.arange(runs) % 2  # every sky is halved
    samples = _draw(sky)
    halves = [
        np.array([_scores(x, budget, samples * (half == h))[MEASURES[0]] for x in curves])
        for h in (0, 1)
    ]
    each = np.arange(len(samples))
    scored = [y[x.argmax(axis=0), each] for x, y in (halves, halves[::-1])]
    return _estimate(0.5 * (scored[0] + scored[1]))
