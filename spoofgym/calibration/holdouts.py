"""What shows that calibrations hold: fresh runs, runs of other worlds, and their first runs again.

`hold_out` counts alarms on runs that nothing was calibrated on, `transfer` on those of another
world, and `check` replays the first runs of a file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from ..core.progress import ProgressBar, no_progress
from ..detectors import Calibrated, Detector
from ..detectors.calibrated import describe_identity
from ..detectors.calibration_file import TOLERANCE, Calibration, hourly_rate, run_probability
from ..simulation.setup import Setup
from .clean_runs import CleanRuns, Player, measuring, plan_passes
from .thresholds import DetectorSpec, inner_detectors, list_rates

HOLDOUT_PASSIVE, HOLDOUT_WEIGHING = 100_000, 1_000
"""Runs of a hold-out by default."""
AGES_S = (0.0, 60.0, 180.0, 600.0, 1800.0, 3600.0)
"""Ages from which on alarms are counted apart [s]."""
CONFIDENCE = 0.99
"""Of all intervals of a hold-out together."""


class HoldOut(NamedTuple):
    """Alarms of a calibrated detector on runs that it was not calibrated on.

    - `alarms` in the judged window, `early` before the attack; `promised`: probability for a run;
    - `low`, `high`: central interval of the count that the ranks of the calibration predict; None
      in another world, and for a fitted tail, which predict none;
    - `per_hour`: measured rate; `false_alarms_per_hour`: rate that is promised;
    - `worlds`: runs and alarms of each world that was drawn, of a domain with several;
    - `ages`: where ages are drawn, the least at the judged window's start [s], of `AGES_S`, with
      runs and alarms from there to the next: the hazard by the time since switch-on.
    """

    name: str
    runs: int
    alarms: int
    promised: float
    low: int | None
    high: int | None
    per_hour: float
    early: int
    window_s: float
    worlds: tuple[tuple[int, int], ...]
    false_alarms_per_hour: float
    ages: tuple[tuple[float, int, int], ...] = ()

    @property
    def per_hour_by_age(self) -> dict[float, float]:
        """Measured rate from each least age on, up to the next."""
        return {age: hourly_rate(alarms / n, self.window_s) for age, n, alarms in self.ages}

    @property
    def worst_world(self) -> tuple[float, float] | None:
        """Largest rate an hour of a world, and that which chance alone shows if all are alike. The
        second is the median of the largest, of binomial counts with the share of all runs; None
        where a single world was drawn."""
        if len(self.worlds) < 2:
            return None
        from scipy.stats import binom

        runs, alarms = np.array(self.worlds).T
        shares = np.unique(np.arange(runs.max() + 1) / runs.max())
        all_below = binom.cdf(np.floor(shares[:, None] * runs), runs, self.alarms / self.runs)
        by_chance = float(shares[np.argmax(all_below.prod(axis=1) >= 0.5)])
        largest = float((alarms / runs).max())
        return hourly_rate(largest, self.window_s), hourly_rate(by_chance, self.window_s)

    @property
    def holds(self) -> bool | None:
        """Whether the count lies in the interval; None without one."""
        if self.low is None or self.high is None:
            return None
        return self.low <= self.alarms <= self.high

    def as_dict(self) -> dict[str, Any]:
        worst = self.worst_world or (None, None)
        return {
            **self._asdict(),
            "per_hour": _finite(self.per_hour),
            "holds": self.holds,
            "worst_world_per_hour": _finite(worst[0]),
            "worst_world_by_chance": _finite(worst[1]),
            "per_hour_by_age": [[age, _finite(x)] for age, x in self.per_hour_by_age.items()],
        }


def _finite(rate: float | None) -> float | None:
    return rate if rate is not None and math.isfinite(rate) else None


def apply_calibration(calibration: Calibration, detector: Detector, rate: float) -> Calibrated:
    made = Calibrated(
        detector, false_alarms_per_hour=rate, rescaled=calibration.rescale is not None
    )
    made.take(calibration, rate)
    return made


def hold_out(
    setup: Setup,
    calibrations: Sequence[Calibration],
    detectors: DetectorSpec | Sequence[DetectorSpec],
    *,
    false_alarms_per_hour: float | Sequence[float],
    runs: int | None = None,
    cells: int | None = None,
    threads: int | None = None,
    progress: ProgressBar | None = None,
    split: str = "holdout",
    predicted: bool = True,
    player: Callable[..., Player] = Player,
) -> list[HoldOut]:
    """Count the alarms of calibrated detectors, in their order, on runs of the split `holdout`;
    several rates share their runs, but for an alarm that is a state. `cells`: hold-outs whose
    intervals hold together, all of these by default; `predicted`: whether the ranks of the
    calibration predict the count, in its own world alone; the others as in `calibrate`."""
    rates = list_rates(false_alarms_per_hour)
    parts = list(zip(calibrations, inner_detectors(detectors), strict=True))
    made = [[apply_calibration(c, d, rate) for c, d in parts] for rate in rates]
    groups = []
    for judges, (which, alone) in product(made, plan_passes(setup, made[0])):
        new = judges is made[0]
        those = [judges[k] for k in which if new or judges[k].detector.alarm_is_state]
        if those:
            count = runs or (HOLDOUT_WEIGHING if alone else HOLDOUT_PASSIVE)
            groups.append((those, count, alone))
    played: dict[int, CleanRuns] = {}
    with (progress or no_progress)(sum(count for _, count, _ in groups)) as bar:
        runner = player(setup, threads=threads, progress=bar)
        for those, count, alone in groups:
            found = runner.play(those, range(count), split=split, in_loop=alone, now="hold-out")
            played |= {id(judge): found.column(k) for k, judge in enumerate(those)}
    counted = cells or len(parts) * len(rates), predicted, setup.window_s
    held = []
    for judges in made:
        for first, judge in zip(made[0], judges, strict=True):
            mine = played.get(id(judge)) or _at_scale(played[id(first)], first, judge)
            held.append(_count_alarms(judge, mine, *counted))
    runner.forget()
    return held


def _at_scale(found: CleanRuns, played: Calibrated, judge: Calibrated) -> CleanRuns:
    """The same runs with another factor on the thresholds, where the alarm is no state."""
    assert judge.scale  # as it was looked up
    assert played.scale
    factor = judge.scale / played.scale
    return found._replace(early=found.before > factor, alarmed=found.judged > factor)


def _count_alarms(
    detector: Calibrated, found: CleanRuns, cells: int, predicted: bool, window_s: float
) -> HoldOut:
    """What has been found in a world whose judged window has this length."""
    point, runs = detector.point, len(found.alarmed)
    assert point is not None  # as it was looked up
    low = high = None
    if predicted and point.rank:
        low, high = predictive_interval(runs, point.runs, point.rank, cells)
    alarms = int(found.alarmed.sum())
    rate = hourly_rate(alarms / runs, window_s)
    promised = run_probability(point.false_alarms_per_hour, window_s)
    name = detector.detector.label or str(describe_identity(detector.detector)["name"])
    worlds = [found.world == each for each in np.unique(found.world)]
    each = tuple((int(there.sum()), int(found.alarmed[there].sum())) for there in worlds)
    early = int(found.early.sum())
    ages: tuple[tuple[float, int, int], ...] = ()
    if np.ptp(found.age_s) > 0.0:
        bins = np.searchsorted(AGES_S, found.age_s, side="right") - 1
        counted = zip(AGES_S, [found.alarmed[bins == k] for k in range(len(AGES_S))], strict=True)
        ages = tuple((age, len(own), int(own.sum())) for age, own in counted if len(own))
    nominal = point.false_alarms_per_hour
    counts = runs, alarms, promised, low, high, rate, early, window_s, each, nominal, ages
    return HoldOut(name, *counts)


def predictive_interval(runs: int, calibrated: int, rank: int, cells: int = 1) -> tuple[int, int]:
    """Central interval of the fresh runs, of all cells together, that exceed the order statistic of
    `rank` from the top of `calibrated` ones: their count is beta-binomial."""
    from scipy.stats import betabinom

    tail = 0.5 * (1.0 - CONFIDENCE) / cells
    law = betabinom(runs, rank, calibrated + 1 - rank)
    return int(law.ppf(tail)), int(law.ppf(1.0 - tail))


def transfer(
    setup: Setup,
    calibrations: Sequence[Calibration],
    detectors: DetectorSpec | Sequence[DetectorSpec],
    **settings: Any,
) -> list[HoldOut]:
    """Count alarms in a world where detectors were not calibrated, as `hold_out`, but without
    intervals."""
    return hold_out(setup, calibrations, detectors, predicted=False, **settings)


def check(
    setup: Setup,
    calibrations: Sequence[Calibration],
    detectors: DetectorSpec | Sequence[DetectorSpec],
    *,
    threads: int | None = None,
) -> None:
    """Replay the first runs of calibrations, and raise where a maximum is another one. Not those of
    a detector that draws by the last bits of innovations: its runs differ by processor, not its
    rate."""
    pairs = list(zip(calibrations, inner_detectors(detectors), strict=True))
    for calibration, detector in pairs:
        identity, rescaled = describe_identity(detector), calibration.rescale is not None
        calibration.check_matches(setup.conditions.settings, identity, setup.name, rescaled)
    same: dict[tuple[int, str, tuple[int, ...]], list[tuple[Calibration, Detector]]] = {}
    for calibration, detector in pairs:
        if not detector.draws:
            numbers = tuple(run for run, _, _ in calibration.witnesses)
            key = calibration.entropy, calibration.seed_name, numbers
            same.setdefault(key, []).append((calibration, detector))
    for (entropy, seed_name, numbers), group in same.items():
        player = Player(setup, entropy, seed_name, threads)
        for which, alone in plan_passes(setup, [detector for _, detector in group]):
            judges = [_rescale_detector(*group[k]) for k in which]
            found = player.play(judges, numbers, in_loop=alone, now="replaying")
            for i, k in enumerate(which):
                calibration, detector = group[k]
                _compare(calibration, found.column(i), measuring(detector)[1])


def _rescale_detector(calibration: Calibration, detector: Detector) -> Detector:
    plain = measuring(detector)[0]
    if calibration.rescale is None:
        return plain
    return Calibrated(plain, 1.0, rescaled=True, rescale=calibration.rescale)


def _compare(calibration: Calibration, found: CleanRuns, unit: float) -> None:
    """Raise where replayed maxima are not those of the file."""
    for k, (run, *stored) in enumerate(calibration.witnesses):
        again = (found.before[k] * unit, found.judged[k] * unit)
        for where, there, here in zip(("before the attack", "in it"), stored, again, strict=True):
            if not abs(here - there) <= TOLERANCE * max(abs(there), 1e-12):
                raise ValueError(
                    f"{calibration.path or calibration.detector['name']} no longer holds: the "
                    f"largest ratio of statistic to threshold of run {run} {where} is stored as "
                    f"{there:.9g} and is {here:.9g} now: the code or its versions have changed; "
                    "make it again with `spoofgym calibrate ... --overwrite`"
                )
