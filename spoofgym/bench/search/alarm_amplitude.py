"""Alarm amplitudes of single runs, and an attack at exactly the alarm budget by them.

1. A few runs sift log-spaced values of the whole range for the neighbourhood of the budget.
2. All runs play values around it, in growing steps, until the share of alarms is well below the
   budget at one end and well above it at the other.
3. Runs that alarm first between two of these halve the ratio until their alarm amplitude is known
   to `RESOLUTION`: all at once, each with its own value, from the same seeds.  The first crossing
   counts, since a run may be silent again above it.
4. All runs play the amplitude at the budget, too.
5. Some of the runs are played at thresholds that are `FACTOR` times as high, too, for the
   elasticity of the score.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...detectors import Calibrated
from ...detectors.calibrated import resolve_thresholds
from ...envs.spoofer_binding import get_tuning_range
from ...spoofers import make_spoofer
from ..runs.panel import Panel, PanelAttack
from ..runs.players import PlayerSpec
from ..runs.record import MEASURES, Mask, measure_displacement, undetected_displacement
from ..scores import statistics
from ..scores.at_budget import AMPLITUDE, AlarmCurve, compute_at_budget, score_at_budget
from ..scores.scores import Stealth, select_clusters
from .amplitude import Trial, Tuning, TuningResult
from .backends import ReplayBackend, Rows

RESOLUTION = 1.005  # ratio of two values between which a run's alarm amplitude is known to lie
STEP, GROWTH = 1.1, 1.25
"""Ratio of the first two values that all runs play, and the power by which it grows."""
ERRORS, LEAST = 4.0, 0.2
"""Standard errors of a share of alarms by which these values go beyond the budget, and the part of
the budget that is far enough below it."""
FACTOR, FACTOR_RUNS = 1.1, 128
"""On the thresholds, for the elasticity of a score, and how many runs it is taken from at most."""
Played = tuple[Mask, dict[str, statistics.FloatArray]]
"""Which runs alarm (R,), and their undetected displacement by measure (R,) [m]."""


class EngineRuns:
    """Runs of a panel on the engine that count, in `sky` (R,), against one of its detectors, and
    any spoofer at any value of its setting within a `span`."""

    def __init__(
        self,
        panel: Panel,
        number: int,
        entry: PlayerSpec,
        tick: Callable[[float], None] = lambda _: None,
    ) -> None:
        self.panel, self.number, self.player, self.tick = panel, number, entry, tick
        low, high = get_tuning_range(make_spoofer(entry.with_value(1.0)), panel.setup)
        self.span = low, high if entry.largest is None else entry.largest
        self.rows = np.flatnonzero(panel.counts[:, number])
        self.sky, self.twin = panel.sky[self.rows], panel.clean[number].take(self.rows)

    def play(self, value: float) -> Played:
        """All runs at one value."""
        attack = PanelAttack(self.player.with_value(value), self.panel.runs)
        (runs,) = self.panel.play([(attack, self.number)], tick=self.tick)
        own = runs.take(self.rows)
        return own.first_alarm > 0, measure_displacement(self.panel.setup, own, self.twin)

    def sift(self, values: Sequence[float], count: int) -> Mask:
        """(V, r) whether the first runs, about so many, alarm at some values."""
        attacks = [PanelAttack(self.player.with_value(value), count) for value in values]
        played = self.panel.play([(each, self.number) for each in attacks], tick=self.tick)
        rows = self.rows[self.rows < count]
        return np.array([runs.first_alarm[rows] > 0 for runs in played])

    def alarms(self, values: statistics.FloatArray, rows: Rows) -> Mask:
        """(r,) whether some runs alarm, each at its own value."""
        different, which = np.unique(values, return_inverse=True)
        specs = [self.player.with_value(value) for value in different.tolist()]
        runs = self.panel.play_each(self.number, specs, which, self.rows[rows])
        return np.asarray(runs.first_alarm > 0)


class ReplayRuns:
    """The same of a response replay under curves of the rate; a value is a factor on them. `parts`:
    a curve (steps,), and the rows of the replay that it plays on."""

    def __init__(
        self,
        backend: ReplayBackend,
        parts: Sequence[tuple[statistics.FloatArray, Rows]],
        span: tuple[float, float],
    ) -> None:
        self.backend, self.parts, self.span = backend, parts, span
        self.sky = np.concatenate([rows for _, rows in parts]).astype(np.int64)

    def play(self, value: float) -> Played:
        replay, alarmed, moved = self.backend.replay, [], []
        hold = replay.epochs - replay.attack_epochs
        for curve, rows in self.parts:
            found = replay.play(self.backend.number, value * curve[None], rows=rows)
            first, error = found.first_alarm[0], found.error[: replay.attack_epochs, 0]
            alarmed.append(first > 0)
            moved.append(undetected_displacement(error, first, hold))
        return np.concatenate(alarmed), {MEASURES[0]: np.concatenate(moved)}

    def sift(self, values: Sequence[float], count: int) -> Mask:
        alarmed = []
        for curve, rows in self.parts:
            curves, few = np.outer(values, curve), rows[: math.ceil(count / len(self.parts))]
            found = self.backend.replay.play(self.backend.number, curves, rows=few)
            alarmed.append(found.first_alarm > 0)
        return np.concatenate(alarmed, axis=1)

    def alarms(self, values: statistics.FloatArray, rows: Rows) -> Mask:
        alarmed, first = np.zeros(len(rows), dtype=np.bool_), 0
        for curve, own in self.parts:
            mine = (rows >= first) & (rows < first + len(own))
            if mine.any():
                some, scale = own[rows[mine] - first], values[mine]
                found = self.backend.replay.play(
                    self.backend.number, curve[None], rows=some, scale=scale
                )
                alarmed[mine] = found.first_alarm[0] > 0
            first += len(own)
        return alarmed


AttackedRuns = EngineRuns | ReplayRuns


def trace_alarms(
    runs: AttackedRuns, settings: Tuning, start: float | None = None, errors: float = ERRORS
) -> AlarmCurve:
    """Play an attack around the budget, and find the alarm amplitudes there. `start`: a value near
    it; sifted for by default. `errors`: how far around, in standard errors."""
    silent, low, high = math.nan, *runs.span
    if start is None:
        grid = statistics.build_log_grid(low, high, settings.values)
        alarmed = np.logical_or.accumulate(runs.sift(grid, settings.sift_runs))
        share = alarmed.mean(axis=1) if alarmed.size else np.zeros(len(grid))
        silent, high = 1.0 - float(share[-1]), grid[-1]
        start = float(np.exp(np.interp(settings.budget, share, np.log(grid))))
    if not len(runs.sky):
        none = np.zeros((1, 0))
        return AlarmCurve(
            np.array([low]), none[0], {MEASURES[0]: none}, none > 0.0, runs.sky, low, silent
        )
    played = _play_around(runs, settings.budget, start, (low, high), errors)
    values = np.array(sorted(played))
    alarmed = np.array([played[value][0] for value in values.tolist()])
    edges = _bisect(runs, values, alarmed)
    at = statistics.rounded_down(
        float(statistics.weighted_quantile(edges, settings.budget, np.ones((1, len(edges))))[0])
    )
    if at not in played:
        played[at] = runs.play(at)
    values = np.array(sorted(played))
    moved = [played[value][1] for value in values.tolist()]
    return AlarmCurve(
        amplitudes=values,
        alarm_amplitude=edges,
        displacement={name: np.array([each[name] for each in moved]) for name in moved[0]},
        alarmed=np.array([played[value][0] for value in values.tolist()]),
        sky=runs.sky,
        chosen=at,
        silent_share=silent,
    )


def _play_around(
    runs: AttackedRuns, budget: float, start: float, span: tuple[float, float], errors: float
) -> dict[float, Played]:
    """What is played on all runs, by value."""
    start = min(max(start, span[0]), span[1])
    played = {start: runs.play(start)}
    error = errors * _share_error(played[start][0], runs.sky, budget)
    ends = (-1, max(budget - error, LEAST * budget)), (1, budget + error)
    for sign, end in ends:
        value, power = start, 1.0
        while sign * (end - float(played[value][0].mean())) > 0.0 and value != span[sign > 0]:
            value = min(max(value * STEP ** (sign * power), span[0]), span[1])
            played[value], power = runs.play(value), power * GROWTH
    return played


def _share_error(alarmed: Mask, sky: NDArray[np.int64], budget: float) -> float:
    """Standard error of a share of alarms at the budget, of runs that come in skies as the alarms
    (R,) at a value near it do."""
    independent, share = math.sqrt(budget * (1.0 - budget) / len(sky)), float(alarmed.mean())
    if not 0.0 < share < 1.0:
        return independent
    samples = statistics.draw_resamples(select_clusters(sky))
    spread = np.std(samples @ alarmed / samples.sum(axis=1))
    return independent * max(float(spread) / math.sqrt(share * (1.0 - share) / len(sky)), 1.0)


def _bisect(
    runs: AttackedRuns, values: statistics.FloatArray, alarmed: Mask
) -> statistics.FloatArray:
    """(R,) alarm amplitudes, by which runs alarm (V, R) at some values."""
    crossed, first = alarmed.any(axis=0), alarmed.argmax(axis=0)
    high = np.where(crossed, values[first], values[-1])
    low = np.where(crossed & (first > 0), values[np.maximum(first - 1, 0)], high)
    while len(rows := np.flatnonzero(high > RESOLUTION * low)):
        middle = np.sqrt(low[rows] * high[rows])
        above = runs.alarms(middle, rows)
        high[rows[above]], low[rows[~above]] = middle[above], middle[~above]
    return np.asarray(np.sqrt(low * high))


def measure_elasticity(
    panel: Panel, number: int, entry: PlayerSpec, settings: Tuning, curve: AlarmCurve
) -> dict[str, float]:
    """Elasticity of amplitude and displacements in the thresholds, at the budget; empty where they
    are not scaled. `curve`: of the attack at the thresholds as they are."""
    if not isinstance(panel.judges[number], Calibrated):
        return {}
    count = min(panel.runs, FACTOR_RUNS)
    here = compute_at_budget(curve.first(int(panel.counts[:count, number].sum())), settings.budget)
    if not here[AMPLITUDE] > 0.0:
        return {}
    runs = EngineRuns(panel.at_thresholds(number, FACTOR, count), number, entry)
    higher = trace_alarms(runs, settings, FACTOR * here[AMPLITUDE], 0.0)
    above = compute_at_budget(higher, settings.budget)
    return {
        name: math.log(above[name] / value) / math.log(FACTOR)
        for name, value in here.items()
        if min(value, above[name]) > 0.0
    }


def draw_threshold_factors(panel: Panel, number: int) -> statistics.FloatArray | None:
    """(S,) factors on the thresholds that other clean runs would have given; None where they do not
    come from clean runs, or differ between the members of a pool."""
    judge = panel.judges[number]
    if not isinstance(judge, Calibrated):
        return None
    resolve_thresholds(judge, panel.world)
    calibration = judge.find_calibration(panel.world)
    if calibration is None or judge.point is None:
        return None
    rng = np.random.default_rng(judge.point.runs)
    return calibration.draw_factors(judge.point, statistics.RESAMPLES, rng)


def tune_at_budget(
    panel: Panel,
    number: int,
    entry: PlayerSpec,
    detector: str,
    settings: Tuning,
    tick: Callable[[float], None] = lambda _: None,
) -> TuningResult:
    curve = trace_alarms(EngineRuns(panel, number, entry, tick), settings)
    factors = draw_threshold_factors(panel, number)
    if factors is not None and curve.runs:
        curve = replace(curve, elasticity=measure_elasticity(panel, number, entry, settings, curve))
    curve = replace(curve, factors=factors)
    score = score_at_budget(curve, settings.budget)
    trials = []
    for k, value in enumerate(curve.amplitudes.tolist()):
        mean = float(curve.displacement[MEASURES[0]][k].mean()) if curve.runs else 0.0
        found = Stealth(curve.runs, int(curve.alarmed[k].sum()), mean)
        trials.append(Trial.of(value, panel.runs, found, found.seems_to_keep(settings.budget)))
    return TuningResult(
        detector=detector,
        spoofer=entry.label,
        setting=str(entry.tuned),
        value=curve.chosen,
        within_budget=score.within_range,
        budget=settings.budget,
        runs=panel.runs,
        counted=curve.runs,
        clean_alarm_rate=float((panel.twin_alarm[:, number] > 0).mean()),
        warmup_alarms=int(panel.warmup_alarm[:, number].sum()),
        trials=tuple(trials),
        at_budget=score.as_json(),
        trace=curve,
    )
