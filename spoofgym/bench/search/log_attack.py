"""What attacks reach unseen on the noise of a log: families of attacks at the alarm budget."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...calibration.log import judge_log, label_spec
from ...core.registry import require
from ...limits.bounds import ZeroAlarm
from ...limits.log_replay import FEWEST_WINDOWS, RATE_LIMIT_MPS, LogReplay
from ...receiver.log import InnovationLog
from ...spoofers import SpooferContext, make_spoofer
from ..runs.record import MEASURES, undetected_displacement
from ..scores import statistics
from ..scores.at_budget import AtBudget, score_at_budget
from .alarm_amplitude import ReplayRuns, trace_alarms
from .amplitude import Tuning
from .backends import ReplayBackend
from .open_loop import JUDGED, LADDER, SHAPES, OpenLoopOptimizer, OpenLoopSearch

PLAIN = ("ramp", "accelerating ramp")
STEP, SEARCHED = "step", "open-loop"
MOVED = MEASURES[0]
UNITS = {
    "ramp": "m/s",
    STEP: "m",
    "accelerating ramp": "m/s at its end",
    SEARCHED: "m/s in the mean",
}
"""Families of attacks, and the unit of the amplitude of each."""


class FamilyReach(NamedTuple):
    """A family of attacks at which a share of the windows alarms: amplitude and displacement with
    intervals over windows; `at_limit`: whether not even the largest amplitude alarms more often;
    `rates_mps` at the knots of a curve that was found."""

    family: str
    unit: str
    score: AtBudget
    at_limit: bool
    rates_mps: tuple[float, ...] = ()

    def as_json(self) -> dict[str, Any]:
        named = {name: getattr(self, name) for name in ("family", "unit", "at_limit")}
        return {**named, "rates_mps": list(self.rates_mps), **self.score.as_json()}


class PlayedSpoofer(NamedTuple):
    """A spoofer at its own size: share of the windows that alarm, and the mean displacement until
    they do, with intervals over windows [m]."""

    spoofer: str
    alarm_rate: statistics.Estimate
    displacement: statistics.Estimate

    def as_json(self) -> dict[str, Any]:
        parts = {"alarm_rate": self.alarm_rate.as_json(), MOVED: self.displacement.as_json()}
        return {"spoofer": self.spoofer, **parts}


class LogAttack(NamedTuple):
    """What attacks reach against a detector on a log.

    - `factor` on its thresholds, for `false_alarms_per_hour`, None for its own;
    - `windows` of `window_s` that are attacked, each after `live_s`; `clean_alarms` of them alarm
      without an attack, or before it, and do not count;
    - `families`, at the alarm budget that the windows support and where half of them alarm, or the
      spoofers that were named, `played`; `zero_alarm`: what none exceeds in the mean without alarm.
    """

    detector: str
    factor: float
    false_alarms_per_hour: float | None
    windows: int
    clean_alarms: int
    window_s: float
    live_s: float
    families: tuple[FamilyReach, ...]
    zero_alarm: ZeroAlarm
    played: tuple[PlayedSpoofer, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """All of it, JSON-able."""
        parts = {x: [each.as_json() for each in getattr(self, x)] for x in ("families", "played")}
        return {**self._asdict(), **parts, "zero_alarm": self.zero_alarm.as_json()}


def attack_log(
    log: InnovationLog,
    detectors: Sequence[Any],
    false_alarms_per_hour: float | None = None,
    *,
    attack_s: float = 150.0,
    time_to_alert_s: float = 10.0,
    heading_deg: float = 90.0,
    rate_limit_mps: float = RATE_LIMIT_MPS,
    search: OpenLoopSearch | None = None,
    spoofers: Sequence[Any] = (),
    threads: int | None = None,
) -> list[LogAttack]:
    """Say what attacks reach unseen on a log's noise, by the linear response of its filter.

    Parameters
    ----------
    log : InnovationLog
        Clean, with the matrices of its filter.
    detectors : sequence
        Passive ones, as `make_detector` takes them.
    false_alarms_per_hour : float, optional
        Rate for which thresholds come from the log's own windows; by default they are those that a
        detector has by itself.
    attack_s, time_to_alert_s : float
        Length of an attack, and of the time to alert [s]; a window has both.
    heading_deg : float
        Of the false position, clockwise from north.
    rate_limit_mps : float
        Largest rate of the false position [m/s].
    search : OpenLoopSearch, optional
        Of the optimized open-loop attack, on every second window; it is scored on the others.
    spoofers : sequence
        What plays as it is in place of the families, as `make_spoofer` takes it: those that observe
        nothing.
    threads : int, optional
        That judge attacks.

    Returns
    -------
    list of LogAttack
        In the order of the detectors.

    Raises
    ------
    ValueError
        Where the log has no matrices or too few windows, or a detector alarms in nearly all.
    """
    rate = false_alarms_per_hour
    limits = {"heading_deg": heading_deg, "rate_limit_mps": rate_limit_mps, "threads": threads}
    window_s, found = attack_s + time_to_alert_s, []
    for spec in detectors:
        factor, label = 1.0, label_spec(spec)
        sizes: dict[str, Any] = {"attack_s": attack_s, "time_to_alert_s": time_to_alert_s, **limits}
        replay = LogReplay(log, spec, **sizes)
        if rate is not None:
            factor = judge_log(log, [spec], rate, window_s)[0].factor
            replay = LogReplay(log, spec, factor, **sizes)
        backend = ReplayBackend(replay, 0, "target")
        require(
            backend.runs >= FEWEST_WINDOWS,
            f"{label} alarms in {replay.runs - backend.runs} of {replay.runs} windows without an "
            "attack: take thresholds of the log, by false_alarms_per_hour",
        )
        budget = max(statistics.BUDGET, -math.expm1(math.log(statistics.LEVEL) / backend.runs))
        families = [
            score
            for share in (budget, 0.5) * (not spoofers)
            for score in (
                _score_plain(backend, PLAIN[0], share),
                _score_step(backend, replay, share),
                _score_plain(backend, PLAIN[1], share),
                _score_search(backend, search or OpenLoopSearch(), share),
            )
        ]
        runs = replay.runs, replay.runs - backend.runs
        lengths = replay.epochs * replay.interval_s, replay.live * replay.interval_s
        bound = replay.bound_zero_alarm()
        head = label, factor, rate, *runs, *lengths
        played = [_play_named(backend, replay, spec) for spec in spoofers]
        found.append(LogAttack(*head, tuple(families), bound, tuple(played)))
    return found


def make_context(replay: LogReplay) -> SpooferContext:
    """What a spoofer knows of the windows of a log."""
    limit, names = replay.limits[0], ("north_rate", "east_rate")
    times = replay.interval_s, replay.steps, "rate", limit / replay.interval_s, limit
    return SpooferContext(1, *times, names)


def play_spoofer(
    replay: LogReplay, spec: Any, rows: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(R,) undetected displacement by a spoofer that observes nothing [m], and whether each of the
    windows `rows` (R,) alarms."""
    spoofer, context = make_spoofer(spec), make_context(replay)
    rates = list[float]()
    label, most = label_spec(spec), context.rate_limit_mps
    require(spoofer.knowledge == "blind", f"{label} observes its victim, and a log does not answer")
    spoofer.bind(context)
    spoofer.reset()
    require("rate" in spoofer.memory.declared, f"{label} moves no false position along a line")
    for _ in range(replay.steps):
        spoofer.act(np.zeros((1, 0), dtype=np.float32))
        rates.append(getattr(spoofer, "amplitude", 1.0) * float(spoofer.memory["rate"][0]))
    found = replay.play(0, np.clip(rates, -most, most)[None], rows=rows)
    error, alarm = found.error[: replay.attack_epochs, 0], found.first_alarm[0]
    hold = replay.epochs - replay.attack_epochs
    return undetected_displacement(error, alarm, hold), alarm > 0


def _play_named(backend: ReplayBackend, replay: LogReplay, spec: Any) -> PlayedSpoofer:
    moved, alarmed = play_spoofer(replay, spec, backend.rows)
    own = statistics.bounded_mean(alarmed, backend.rows, 0.0)
    mean = statistics.bootstrap_mean(moved, statistics.draw_resamples(backend.rows))
    return PlayedSpoofer(Path(label_spec(spec)).stem, own, mean)


def _score(runs: ReplayRuns, family: str, budget: float, rates: Any = ()) -> FamilyReach:
    curve = trace_alarms(runs, Tuning(budget=budget))
    score, free = score_at_budget(curve, budget), curve.alarmed[-1].mean() <= budget
    return FamilyReach(family, UNITS[family], score, bool(free), tuple(rates))


def _score_plain(backend: ReplayBackend, family: str, budget: float) -> FamilyReach:
    shape = SHAPES[family](np.linspace(0.0, 1.0, backend.steps))
    limit = backend.limits[0]
    runs = ReplayRuns(backend, [(shape, backend.rows)], (LADDER[0] * limit, limit))
    return _score(runs, family, budget)


def _score_step(backend: ReplayBackend, replay: LogReplay, budget: float) -> FamilyReach:
    stepped = copy.copy(backend)
    stepped.replay = replay.copy_with_steps()
    metre = np.eye(backend.steps)[0] / replay.interval_s
    largest = backend.limits[0] * replay.attack_epochs * replay.interval_s
    runs = ReplayRuns(stepped, [(metre, backend.rows)], (LADDER[0] * backend.limits[0], largest))
    return _score(runs, STEP, budget)


def _score_search(backend: ReplayBackend, search: OpenLoopSearch, budget: float) -> FamilyReach:
    """A curve that is found on every second window, on the others; and the other way round."""
    if not backend.sums:
        smaller = {name: min(getattr(search, name), most) for name, most in JUDGED.items()}
        search = replace(search, **smaller)
    parts, found, largest = [], [], []
    for first in (0, 1):
        half = copy.copy(backend)
        half.rows = backend.rows[first::2]
        half.runs = len(half.rows)
        optimizer = OpenLoopOptimizer(half, budget, search)
        found.append(optimizer.search().rates_mps)
        curve = optimizer.curves(found[-1][None])[0]
        parts.append((curve / curve.mean(), backend.rows[1 - first :: 2]))
        largest.append(backend.limits[0] * curve.mean() / np.abs(curve).max())
    most = float(min(largest))
    runs = ReplayRuns(backend, parts, (LADDER[0] * most, most))
    return _score(runs, SEARCHED, budget, [float(f"{rate:.6g}") for rate in found[0]])
