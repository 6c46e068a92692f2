"""Calibration of detectors on clean runs of a world, and what shows that it holds.

`calibrate` plays the runs and writes one small file a detector; environments, the benchmark and the
duel look them up (`spoofgym.detectors.Calibrated`).  `hold_out` counts alarms on fresh runs,
`transfer` on runs of another world, and `check` replays the first runs of a file.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from .._registry import whole_number
from ..detectors import DETECTORS, Calibrated, Detector, PooledDetector, make_detector
from ..detectors.calibrated import STANDARD_RATE, check_drifts, identity_of
from ..detectors.calibration import (
    STANDARD_RATES,
    TOLERANCE,
    WITNESSES,
    Calibration,
    check_rate,
    check_runs,
    file_name,
    hourly_rate,
    kept_ranks,
    rank_of,
    rounded,
    rounded_up,
    run_probability,
    stored,
    user_folder,
)
from .clean_runs import CleanRuns, Player, Progress, measuring, weighs
from .monitors import Monitor
from .setup import Setup

FloatArray = NDArray[np.float64]
PASSIVE_RUNS, WEIGHING_RUNS = 20_000, 2_000
"""Clean runs by default: passive detectors share theirs."""
HOLDOUT_PASSIVE, HOLDOUT_WEIGHING = 100_000, 1_000
"""Runs of a hold-out by default."""
RESCALE_RUNS = 512
"""Runs whose innovations the factors of the variant `rescaled` are taken from, at most."""
CONFIDENCE = 0.99
"""Of all intervals of a hold-out together."""
DetectorSpec = str | Mapping[str, Any] | Detector


class HoldOut(NamedTuple):
    """Alarms of a calibrated detector on runs that it was not calibrated on.

    - `name`: of the detector;
    - `runs`, `alarms`: runs, and those with an alarm in the judged window;
    - `promised`: probability of one for a run;
    - `low`, `high`: central interval of the count that the ranks of the calibration predict; None
      in another world, and for a fitted tail, which predict none;
    - `per_hour`: measured rate;
    - `early`: runs with an alarm before the attack;
    - `worlds`: runs and alarms of each world that was drawn, of a domain with several;
    - `false_alarms_per_hour`: rate that is promised.
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

    @property
    def worst_world(self) -> tuple[float, float] | None:
        """Largest rate an hour of a world, and that which chance alone shows if all are alike.

        The second is the median of the largest, of binomial counts with the share of all runs;
        None where a single world was drawn.
        """
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
        """All of it, JSON-able."""
        worst = self.worst_world or (None, None)
        return {
            **self._asdict(),
            "per_hour": _finite(self.per_hour),
            "holds": self.holds,
            "worst_world_per_hour": _finite(worst[0]),
            "worst_world_by_chance": _finite(worst[1]),
        }


def _finite(rate: float | None) -> float | None:
    return rate if rate is not None and math.isfinite(rate) else None


def calibrate(
    setup: Setup,
    detectors: DetectorSpec | Sequence[DetectorSpec],
    *,
    runs: int | None = None,
    false_alarms_per_hour: float | Sequence[float] = STANDARD_RATE,
    rescaled: bool = False,
    entropy: int = 0,
    threads: int | None = None,
    chunk: int = 256,
    progress: Progress | None = None,
    folder: Path | None = None,
    overwrite: bool = False,
    strict: bool = True,
) -> list[Calibration]:
    """Calibrate detectors in a world, or read what has been calibrated.

    Parameters
    ----------
    setup : Setup
        The world; its own detector and attack play no part.
    detectors : str, mapping, Detector, or a sequence of them
        As `make_detector` takes them; pools give their members.  Those that never alarm are left
        out.
    runs : int, optional
        Clean runs; by default `PASSIVE_RUNS`, or `WEIGHING_RUNS` for a detector that de-weights.
    false_alarms_per_hour : float or sequence of float
        Rates that must be had; a file has many more, where the alarm is no state.
    rescaled : bool
        The variant whose innovations are rescaled, of detectors with a drift term.
    entropy : int
        Seed of the random number generators.
    threads : int, optional
        Threads that play runs; all useful cores by default.
    chunk : int
        Runs that are played side by side; results do not depend on it.
    progress : Progress, optional
        Shows how far it is, in runs.
    folder : Path, optional
        Where the files go, and the only place where they are looked for; by default
        `spoofgym.detectors.calibration.user_folder`, after the package's own.
    overwrite : bool
        Whether to play again what has been calibrated.
    strict : bool
        Whether a degenerate statistic raises, after all files are written; if not, its calibration
        says so when it is asked for an operating point.

    Returns
    -------
    list of Calibration
        In the order of the detectors; written to their files.

    Raises
    ------
    ValueError
        When the runs are too few for a rate, or a statistic is degenerate.
    """
    rates = _rates(false_alarms_per_hour)
    parts = inner_detectors(detectors)
    if runs is not None:
        runs = whole_number("`runs`", runs, 1)
    work = _Work(setup, rates, rescaled, whole_number("`entropy`", entropy), folder, overwrite)
    with locked(setup):
        store = user_folder() / "unfinished"
        player = Player(
            setup, entropy=entropy, threads=threads, chunk=chunk, store=store, progress=progress
        )
        for group, count, in_loop in work.groups(parts, runs):
            work.check_enough(group, count)
            work.play(player, group, count, in_loop)
        work.overwrite = False
        done = [work.found(part, runs) for part in parts]
    found = [each for each in done if each is not None]
    for each in found if strict else ():
        for rate in rates:
            each.point(rate)
    return found


def expected_runs(
    setup: Setup,
    detectors: DetectorSpec | Sequence[DetectorSpec],
    *,
    runs: int | None = None,
    false_alarms_per_hour: float | Sequence[float] = STANDARD_RATE,
    rescaled: bool = False,
    folder: Path | None = None,
    overwrite: bool = False,
) -> int:
    """Clean runs that `calibrate` would play now, but for those of a bisection; 0 for none."""
    work = _Work(setup, _rates(false_alarms_per_hour), rescaled, 0, folder, overwrite)
    groups = work.groups(inner_detectors(detectors), runs)
    for group, count, _ in groups:
        work.check_enough(group, count)
    return sum(count for _, count, _ in groups)


def _rates(given: float | Sequence[float]) -> tuple[float, ...]:
    several = given if isinstance(given, Sequence | np.ndarray) else [given]
    return tuple(map(check_rate, several))


def inner_detectors(specs: DetectorSpec | Iterable[DetectorSpec]) -> list[Detector]:
    """Detectors without what is asked of their thresholds, pools by their members, each once."""
    if isinstance(specs, str | Mapping | Detector):
        specs = [specs]
    found: dict[str, Detector] = {}
    for spec in specs:
        made = make_detector(spec)
        for each in made.judges if isinstance(made, PooledDetector) else (made,):
            inner = each.detector if isinstance(each, Calibrated) else each
            if inner.calibrates:
                found.setdefault(repr(identity_of(inner)), inner)
    return list(found.values())


def suitable_detectors(setup: Setup) -> list[Detector]:
    """All detectors of the package that fit this victim, with their own settings.

    Without pools, oracles, and those that never alarm.
    """
    measured = "satellites" if setup.geometry_names else "position"
    kinds = [kind for name, kind in DETECTORS.items() if name != "pool"]
    wanted = [kind for kind in kinds if kind.calibrates and not kind.oracle]
    fit = [kind for kind in wanted if kind.measures in (measured, "any")]
    return [kind() for kind in fit if kind.needs <= setup.has]


@contextmanager
def locked(setup: Setup) -> Iterator[None]:
    """Let one process at a time calibrate in a world; the others wait, and find its files."""
    from filelock import FileLock

    folder = user_folder()
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / f"{setup.conditions.digest}.lock"):
        yield


class _Work:
    """One call of `calibrate`: what it asks for, and where the files are."""

    def __init__(
        self,
        setup: Setup,
        rates: Sequence[float],
        rescaled: bool,
        entropy: int,
        folder: Path | None,
        overwrite: bool,
    ) -> None:
        self.setup, self.rates, self.rescaled = setup, rates, rescaled
        self.entropy, self.overwrite = entropy, overwrite
        self.folder, self.own = user_folder() if folder is None else folder, folder

    def found(self, detector: Detector, runs: int | None) -> Calibration | None:
        """A calibration with so many runs or more that has all rates; None where there is none."""
        if self.overwrite:
            return None
        identity = identity_of(detector)
        for each in stored(self.setup.conditions, identity, self.rescaled, self.own):
            enough = each.runs >= (runs or 1) and each.entropy == self.entropy
            if enough and all(each.has(rate) for rate in self.rates):
                return each
        return None

    def groups(
        self, parts: list[Detector], runs: int | None
    ) -> list[tuple[list[Detector], int, bool]]:
        """Detectors that are to be played together, how many runs, and whether in the loop."""
        if self.rescaled:
            for part in parts:
                check_drifts(part)
        missing = [part for part in parts if self.found(part, runs) is None]
        heavy = [weighs(self.setup, part) for part in missing]
        light = [part for part, alone in zip(missing, heavy, strict=True) if not alone]
        together = [(light, runs or PASSIVE_RUNS, False)] if light else []
        alone = [part for part, each in zip(missing, heavy, strict=True) if each]
        return together + [([part], runs or WEIGHING_RUNS, True) for part in alone]

    def check_enough(self, group: list[Detector], runs: int) -> None:
        """Raise where so many runs don't tell a rate, before anything is played."""
        for rate in self.rates:
            tail = not any(each.alarm_is_state for each in group)
            check_runs(rate, runs, self.setup.window_s, tail=tail)

    def play(self, player: Player, group: list[Detector], runs: int, in_loop: bool) -> None:
        """Play all runs of some detectors, and write their files."""
        pairs = [measuring(each) for each in group]
        rescale = rescale_factors(player, min(runs, RESCALE_RUNS)) if self.rescaled else None
        played = [each for each, _ in pairs]
        if rescale is not None:
            played = [Calibrated(each, 1.0, rescaled=True, rescale=rescale) for each in played]
        names = [str(identity_of(each)["name"]) for each in group]
        now = f"{', '.join(names[:3])}{' ...' if len(names) > 3 else ''}: clean runs"
        numbers = range(runs)
        found = player.play(played, numbers, in_loop=in_loop, now=now)
        for k, (detector, (_, unit)) in enumerate(zip(group, pairs, strict=True)):
            mine = found.column(k)
            mine = mine._replace(before=mine.before * unit, judged=mine.judged * unit)
            if not (np.isfinite(mine.before).all() and np.isfinite(mine.judged).all()):
                raise ValueError(
                    f"{names[k]}: a ratio of statistic to threshold is not finite, so that its "
                    "runs have no order"
                )
            self._write(player, detector, mine, in_loop, rescale)
        player.forget(played, numbers, in_loop=in_loop)

    def _write(
        self,
        player: Player,
        detector: Detector,
        found: CleanRuns,
        in_loop: bool,
        rescale: tuple[float, ...] | None,
    ) -> None:
        conditions, runs = self.setup.conditions, len(found.judged)
        bisected = detector.alarm_is_state
        if bisected:
            ranks, largest = self._bisected(player, detector, found, in_loop)
        else:
            order = np.sort(found.judged)[::-1]
            ranks = kept_ranks(runs, self.setup.window_s, [*STANDARD_RATES, *self.rates])
            largest = rounded_up(order[np.array(ranks) - 1])
        early = np.sort(found.before)[::-1]
        sparse = sorted({min(int(1.1**power), runs) for power in range(400)})
        identity = identity_of(detector)
        made = Calibration(
            world=conditions.settings,
            detector=identity,
            window_s=self.setup.window_s,
            runs=runs,
            entropy=self.entropy,
            seed_name=player.seed_name,
            ranks=tuple(ranks),
            largest=tuple(largest.tolist()),
            before=tuple((rank, rounded(early[rank - 1])) for rank in sparse),
            witnesses=tuple(
                (run, rounded(found.before[run]), rounded(found.judged[run]))
                for run in range(min(WITNESSES, runs))
            ),
            rescale=rescale,
            bisected=bisected,
        )
        made.save(self.folder / file_name(conditions.digest, identity, self.rescaled))

    def _bisected(
        self, player: Player, detector: Detector, found: CleanRuns, in_loop: bool
    ) -> tuple[list[int], FloatArray]:
        """Ranks of the rates, and the factors at which so many runs less one alarm."""

        def alarms(scale: float, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
            """Which of some runs alarm in the judged window, their alarm scaled."""
            scaled: Any = dataclasses.replace(detector, alarm_scale=scale)  # type: ignore[type-var]
            return player.play([scaled], rows, in_loop=in_loop, now="bisection").alarmed[:, 0]

        runs, window_s = len(found.judged), self.setup.window_s
        asked = {
            rank_of(run_probability(r, window_s), runs) for r in (*STANDARD_RATES, *self.rates)
        }
        ranks = sorted(rank for rank in asked if 1 <= rank <= runs)
        return ranks, np.array([bisect(found.before, found.judged, r, alarms) for r in ranks])


def bisect(
    before: FloatArray,
    judged: FloatArray,
    rank: int,
    alarms: Callable[[float, NDArray[np.int64]], NDArray[np.bool_]],
) -> float:
    """Smallest factor on the threshold, of the ratios, at which fewer than `rank` runs alarm.

    `before`, `judged` (R,) largest ratios of runs without any alarm.  Up to its first alarm a run
    is the same at any factor, so that only those above it before the attack are played again, by
    ``alarms(factor, runs)``.
    """
    values = rounded_up(np.unique(np.concatenate([before, judged])))

    def count(scale: float) -> int:
        early = before > scale
        again = np.flatnonzero(early)
        known = int((judged[~early] > scale).sum())
        return known + (int(alarms(scale, again).sum()) if len(again) else 0)

    high = len(values) - 1
    # where four times as many runs would alarm, and all below
    order = np.sort(judged)[::-1]
    low = int(np.searchsorted(values, order[min(4 * rank + 20, len(order)) - 1])) - 1
    if low >= 0 and count(float(values[low])) < rank:
        high, low = low, -1
    while high - low > 1:
        middle = (low + high) // 2
        if count(float(values[middle])) < rank:
            high = middle
        else:
            low = middle
    return float(values[high])


class InnovationSums(Monitor):
    """Squares of the innovations' common mode and complement, as they are and as believed.

    `memory`: ``sums`` (B, 8): of pseudoranges, then of range rates, common mode and its belief,
    complement and its belief.
    """

    needs = frozenset({"innovation_cov"})

    def bind(self, simulator: Any) -> None:
        """Prepare for the receivers of a simulator."""
        self.memory = Memory(simulator.receivers)
        self.memory.declare("sums", np.zeros((simulator.receivers, 8)))

    def update(self, simulator: Any) -> None:
        """Add an epoch."""
        epoch, sums = simulator.epoch, self.memory["sums"]
        visible = epoch.visible.astype(np.float64)
        n = visible.shape[1]
        count = np.maximum(visible.sum(axis=1), 1.0)
        for signal in range(2):
            rows = slice(signal * n, (signal + 1) * n)
            z, S = epoch.innovation[:, rows] * visible, epoch.innovation_cov[:, rows, rows]
            mean = z.sum(axis=1) / count
            rest = (z - mean[:, None]) * visible
            total = (S * visible[:, :, None] * visible[:, None, :]).sum(axis=(1, 2))
            own = (np.einsum("bjj->bj", S) * visible).sum(axis=1)
            sums[:, 4 * signal] += mean * mean
            sums[:, 4 * signal + 1] += total / (count * count)
            sums[:, 4 * signal + 2] += (rest * rest).sum(axis=1)
            sums[:, 4 * signal + 3] += own - total / count


def rescale_factors(player: Player, runs: int) -> tuple[float, ...]:
    """Factors on common mode and complement, so that clean innovations are as large as believed."""
    parts: list[FloatArray] = []

    def take(simulator: Any) -> None:
        parts.append(simulator.monitor(InnovationSums).memory["sums"])

    player.each(InnovationSums(), range(runs), take)
    sums = np.concatenate(parts).sum(axis=0)
    real, believed = sums[0::2], sums[1::2]
    sound = (real > 0.0) & (believed > 0.0)
    factors = np.sqrt(np.where(sound, believed, 1.0) / np.where(sound, real, 1.0))
    return tuple(rounded(factor) for factor in factors)


def calibrated(calibration: Calibration, detector: Detector, rate: float) -> Calibrated:
    """Detector with the thresholds of a calibration at a rate."""
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
    chunk: int = 256,
    progress: Progress | None = None,
    split: str = "holdout",
    predicted: bool = True,
) -> list[HoldOut]:
    """Count the alarms of calibrated detectors on runs of the split `holdout`.

    Parameters
    ----------
    setup : Setup
        The world that is played.
    calibrations : sequence of Calibration
        In the order of the detectors.
    detectors : str, mapping, Detector, or a sequence of them
        As `calibrate` takes them.
    false_alarms_per_hour : float or sequence of float
        Rate at which they work; several share their runs, but for an alarm that is a state.
    runs : int, optional
        By default `HOLDOUT_PASSIVE`, or `HOLDOUT_WEIGHING` for a detector that de-weights.
    cells : int, optional
        Hold-outs that are made together, whose intervals hold together; all of these by default.
    threads, chunk, progress
        As in `calibrate`.
    split : str
        Of the seeds.
    predicted : bool
        Whether the ranks of the calibration predict the count: they do in its own world alone.

    Returns
    -------
    list of HoldOut
        In the order of the detectors; of several rates one after the other.
    """
    rates = _rates(false_alarms_per_hour)
    parts = list(zip(calibrations, inner_detectors(detectors), strict=True))
    made = [[calibrated(c, d, rate) for c, d in parts] for rate in rates]
    heavy = [weighs(setup, each) for each in made[0]]
    player = Player(setup, threads=threads, chunk=chunk, progress=progress)

    def played(group: list[int], judges: list[Calibrated]) -> dict[int, CleanRuns]:
        in_loop = heavy[group[0]]
        count = runs or (HOLDOUT_WEIGHING if in_loop else HOLDOUT_PASSIVE)
        those = [judges[k] for k in group]
        found = player.play(those, range(count), split=split, in_loop=in_loop, now="hold-out")
        return {k: found.column(i) for i, k in enumerate(group)}

    light = [k for k, alone in enumerate(heavy) if not alone]
    groups = ([light] if light else []) + [[k] for k, alone in enumerate(heavy) if alone]
    first: dict[int, CleanRuns] = {}
    for group in groups:
        first |= played(group, made[0])
    counted = cells or len(parts) * len(rates), predicted, setup.window_s
    held = []
    for judges in made:
        for k, judge in enumerate(judges):
            again = judges is not made[0] and judge.detector.alarm_is_state
            found = played([k], judges)[k] if again else _at_scale(first[k], made[0][k], judge)
            held.append(_counted(judge, found, *counted))
    return held


def _at_scale(found: CleanRuns, played: Calibrated, judge: Calibrated) -> CleanRuns:
    """The same runs with another factor on the thresholds, where the alarm is no state."""
    if judge is played:
        return found
    assert judge.scale  # as it was looked up
    assert played.scale
    factor = judge.scale / played.scale
    return found._replace(early=found.before > factor, alarmed=found.judged > factor)


def _counted(
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
    name = str(identity_of(detector.detector)["name"])
    worlds = [found.world == each for each in np.unique(found.world)]
    each = tuple((int(there.sum()), int(found.alarmed[there].sum())) for there in worlds)
    early = int(found.early.sum())
    asked = point.false_alarms_per_hour
    return HoldOut(name, runs, alarms, promised, low, high, rate, early, window_s, each, asked)


def predictive_interval(runs: int, calibrated: int, rank: int, cells: int = 1) -> tuple[int, int]:
    """Central interval of the fresh runs that exceed an order statistic, of all cells together.

    How often a fresh run exceeds the order statistic of `rank` from the top of n is beta
    distributed, and their count beta-binomial.  `runs`: fresh ones; `calibrated`: n.
    """
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
    """Count the alarms of detectors that were calibrated elsewhere on clean runs of this world.

    Parameters
    ----------
    setup : Setup
        Another world.
    calibrations, detectors
        As in `hold_out`.
    **settings
        The others of `hold_out`.

    Returns
    -------
    list of HoldOut
        Without intervals: nothing is promised elsewhere.
    """
    return hold_out(setup, calibrations, detectors, predicted=False, **settings)


def check(
    setup: Setup,
    calibrations: Sequence[Calibration],
    detectors: DetectorSpec | Sequence[DetectorSpec],
    *,
    threads: int | None = None,
) -> None:
    """Replay the first runs of calibrations, and raise where a maximum is another one.

    Parameters
    ----------
    setup : Setup
        Their world.
    calibrations : sequence of Calibration
        In the order of the detectors.
    detectors : str, mapping, Detector, or a sequence of them
        As `calibrate` takes them.
    threads : int, optional
        As in `calibrate`.

    Raises
    ------
    ValueError
        When a calibration is of something else, or the code behaves differently now.
    """
    parts = inner_detectors(detectors)
    pairs = list(zip(calibrations, parts, strict=True))
    for calibration, detector in pairs:
        unlike = calibration.differences(setup.conditions.settings, identity_of(detector))
        if unlike:
            raise ValueError(
                f"{calibration.path} is a calibration for something else than "
                f"{calibration.detector['name']} in {setup.name}: {'; '.join(unlike)}"
            )
    light: dict[tuple[Any, ...], list[tuple[Calibration, Detector]]] = {}
    for k, (calibration, detector) in enumerate(pairs):
        numbers = tuple(run for run, _, _ in calibration.witnesses)
        alone = weighs(setup, detector)
        key = (calibration.entropy, calibration.seed_name, numbers, k if alone else None)
        light.setdefault(key, []).append((calibration, detector))
    for (entropy, seed_name, numbers, alone), group in light.items():
        player = Player(setup, entropy=entropy, seed_name=seed_name, threads=threads)
        judges = [_as_measured(c, d) for c, d in group]
        found = player.play(judges, numbers, in_loop=alone is not None, now="replaying")
        for i, (calibration, detector) in enumerate(group):
            unit = measuring(detector)[1]
            _compare(calibration, found.column(i), unit)


def _as_measured(calibration: Calibration, detector: Detector) -> Detector:
    plain = measuring(detector)[0]
    if calibration.rescale is None:
        return plain
    return Calibrated(plain, 1.0, rescaled=True, rescale=calibration.rescale)


def _compare(calibration: Calibration, found: CleanRuns, unit: float) -> None:
    """Raise where replayed maxima are not those of the file."""
    for k, (run, *kept) in enumerate(calibration.witnesses):
        again = (found.before[k] * unit, found.judged[k] * unit)
        for where, there, here in zip(("before the attack", "in it"), kept, again, strict=True):
            if not abs(here - there) <= TOLERANCE * max(abs(there), 1e-12):
                raise ValueError(
                    f"{calibration.path or calibration.detector['name']} no longer holds: the "
                    f"largest ratio of run {run} {where} is {there:.9g} there, {here:.9g} here, so "
                    "that the code, or what it computes, is another one; make it again with "
                    "`spoofgym calibrate ... --overwrite`"
                )
