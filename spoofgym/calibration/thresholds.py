"""Calibration of detectors on clean runs of a world.

`calibrate` plays the runs and writes one small file a detector; environments, the benchmark and the
duel look them up (`spoofgym.detectors.Calibrated`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.memory import Memory
from ..core.progress import ProgressBar, no_progress
from ..core.registry import whole_number
from ..detectors import DETECTORS, Calibrated, Detector
from ..detectors import calibration_file as files
from ..detectors.build import bare_detector
from ..detectors.calibrated import STANDARD_RATE, check_drifts, describe_identity, unwrap
from ..simulation.monitors import Monitor
from ..simulation.setup import Setup
from .clean_runs import CleanRuns, Player, measuring, plan_passes

FloatArray = NDArray[np.float64]
PASSIVE_RUNS, WEIGHING_RUNS = 20_000, 2_000
"""Clean runs by default: passive detectors share theirs."""
RESCALE_RUNS = 512
"""Runs whose innovations the factors of the variant `rescaled` are taken from, at most."""
DetectorSpec = str | Mapping[str, Any] | Detector


def calibrate_detectors(
    setup: Setup,
    detectors: DetectorSpec | Sequence[DetectorSpec],
    *,
    runs: int | None = None,
    false_alarms_per_hour: float | Sequence[float] = STANDARD_RATE,
    rescaled: bool = False,
    entropy: int = 0,
    threads: int | None = None,
    progress: ProgressBar | None = None,
    folder: Path | None = None,
    overwrite: bool = False,
    strict: bool = True,
    player: Callable[..., Player] = Player,
) -> list[files.Calibration]:
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
    progress : callable, optional
        Opens a bar for a number of runs, such as `spoofgym.core.progress.show_progress`.
    folder : Path, optional
        Where the files go, and the only place where they are looked for; by default
        `spoofgym.detectors.calibration_file.user_folder`, after the package's own.
    overwrite : bool
        Whether to play again what has been calibrated.
    strict : bool
        Whether a degenerate statistic raises, after all files are written; if not, its calibration
        raises when an operating point is requested.
    player : callable
        Makes what plays the runs, by the fields of `Player`.

    Returns
    -------
    list of Calibration
        In the order of the detectors; written to their files.

    Raises
    ------
    ValueError
        When the runs are too few for a rate, or a statistic is degenerate.
    """
    rates = list_rates(false_alarms_per_hour)
    parts = inner_detectors(detectors)
    if runs is not None:
        runs = whole_number("`runs`", runs, 1)
    work = _Work(setup, rates, rescaled, whole_number("`entropy`", entropy), folder, overwrite)
    with _lock_folder(setup) if work.groups(parts, runs) else nullcontext():
        groups = work.groups(parts, runs)
        left = sum(count for _, count, _ in groups)
        with (progress if progress and left else no_progress)(left) as bar:
            runner = player(setup, entropy=entropy, threads=threads, progress=bar)
            for group, count, in_loop in groups:
                work.play(runner, group, count, in_loop)
        work.overwrite = False
        done = [work.find_stored(part, runs) for part in parts]
    found = [each for each in done if each is not None]
    for each in found if strict else ():
        for rate in rates:
            each.point(rate)
    return found


def _lock_folder(setup: Setup) -> AbstractContextManager[Any]:
    """Lock of the user's folder: others wait, and find the files."""
    from filelock import FileLock

    home = files.user_folder()
    try:
        home.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(
            f"calibrations can't be stored in {home} ({error.strerror}); set "
            f"{files.FOLDER_VARIABLE} to a folder that can be written"
        ) from error
    return FileLock(home / f"{setup.conditions.digest}.lock")


def list_rates(given: float | Sequence[float]) -> tuple[float, ...]:
    several = given if isinstance(given, Sequence | np.ndarray) else [given]
    return tuple(map(files.check_rate, several))


def inner_detectors(specs: DetectorSpec | Iterable[DetectorSpec]) -> list[Detector]:
    """Detectors without requests for thresholds, pools by their members, each once."""
    if isinstance(specs, str | Mapping | Detector):
        specs = [specs]
    found: dict[str, Detector] = {}
    for spec in specs:
        made = bare_detector(spec)
        for each in made.judges or (made,):
            inner = unwrap(each)
            if inner.calibrates:
                found.setdefault(repr(describe_identity(inner)), inner)
    return list(found.values())


def suitable_detectors(setup: Setup) -> list[Detector]:
    """All detectors of the package that fit this victim, with their own settings. Without pools,
    oracles, and those that never alarm."""
    measured = "satellites" if setup.geometry_names else "position"
    kinds = [kind for name, kind in DETECTORS.items() if name != "pool"]
    wanted = [kind for kind in kinds if kind.calibrates and not kind.oracle]
    fit = [kind for kind in wanted if kind.measures in (measured, "any")]
    return [kind() for kind in fit if kind.needs <= setup.has]


@dataclass
class _Work:
    """One call of `calibrate`: what it requests, and where the files are."""

    setup: Setup
    rates: Sequence[float]
    rescaled: bool
    entropy: int
    folder: Path | None
    overwrite: bool

    def find_stored(self, detector: Detector, runs: int | None) -> files.Calibration | None:
        """A calibration with so many runs or more that has all rates; None without one."""
        if self.overwrite:
            return None
        identity = describe_identity(detector)
        for each in files.load_stored(self.setup.conditions, identity, self.rescaled, self.folder):
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
        missing = [part for part in parts if self.find_stored(part, runs) is None]
        found = [
            ([missing[k] for k in which], runs or (WEIGHING_RUNS if alone else PASSIVE_RUNS), alone)
            for which, alone in plan_passes(self.setup, missing)
        ]
        for group, count, _ in found:
            tail = not any(each.alarm_is_state for each in group)
            for rate in self.rates:  # an error if so many runs are too few for it
                files.check_runs(rate, count, self.setup.window_s, tail=tail)
        return found

    def play(self, player: Player, group: list[Detector], runs: int, in_loop: bool) -> None:
        """Play all runs of some detectors, and write their files."""
        pairs = [measuring(each) for each in group]
        rescale = rescale_factors(player, min(runs, RESCALE_RUNS)) if self.rescaled else None
        played = [each for each, _ in pairs]
        if rescale is not None:
            played = [Calibrated(each, 1.0, rescaled=True, rescale=rescale) for each in played]
        names = [str(describe_identity(each)["name"]) for each in group]
        now = f"{', '.join(names[:3])}{' ...' if len(names) > 3 else ''}: clean runs"
        found = player.play(played, range(runs), in_loop=in_loop, now=now)
        for k, (detector, (_, unit)) in enumerate(zip(group, pairs, strict=True)):
            mine = found.column(k)
            mine = mine._replace(before=mine.before * unit, judged=mine.judged * unit)
            if not (np.isfinite(mine.before).all() and np.isfinite(mine.judged).all()):
                raise ValueError(
                    f"{names[k]}: a ratio of statistic to threshold is not finite, so its runs "
                    "can't be sorted"
                )
            self._write(player, detector, mine, in_loop, rescale)
        player.forget()

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
        largest = None
        if bisected:
            ranks, largest = self._bisect_factors(player, detector, found, in_loop)
        else:
            ranks = files.list_stored_ranks(
                runs, self.setup.window_s, [*files.STANDARD_RATES, *self.rates]
            )
        identity = describe_identity(detector)
        made = files.Calibration.from_maxima(
            found.before,
            found.judged,
            ranks=ranks,
            largest=largest,
            world=conditions.settings,
            detector=identity,
            window_s=self.setup.window_s,
            entropy=self.entropy,
            seed_name=player.seed_name,
            rescale=rescale,
            bisected=bisected,
        )
        folder = self.folder or files.user_folder()
        made.save(folder / files.file_name(conditions.digest, identity, self.rescaled))

    def _bisect_factors(
        self, player: Player, detector: Detector, found: CleanRuns, in_loop: bool
    ) -> tuple[list[int], FloatArray]:
        """Ranks of the rates, and the factors at which so many runs less one alarm."""

        def alarms(scale: float, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
            """Which of some runs alarm in the judged window, their alarm scaled."""
            scaled: Any = dataclasses.replace(detector, alarm_scale=scale)  # type: ignore[type-var]
            return player.play([scaled], rows, in_loop=in_loop, now="bisection").alarmed[:, 0]

        runs, window_s = len(found.judged), self.setup.window_s
        wanted = {
            files.compute_rank(files.run_probability(r, window_s), runs)
            for r in (*files.STANDARD_RATES, *self.rates)
        }
        ranks = sorted(rank for rank in wanted if 1 <= rank <= runs)
        return ranks, np.array([bisect(found.before, found.judged, r, alarms) for r in ranks])


def bisect(
    before: FloatArray,
    judged: FloatArray,
    rank: int,
    alarms: Callable[[float, NDArray[np.int64]], NDArray[np.bool_]],
) -> float:
    """Smallest factor on the threshold at which fewer than `rank` runs alarm, of their largest
    ratios (R,) without any alarm. Up to its first alarm a run is the same at any factor, so that
    only those above it before the attack are played again, by ``alarms(factor, runs)``."""
    values = files.round_digits_up(np.unique(np.concatenate([before, judged])))

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
    complement and its belief."""

    needs = frozenset({"innovation_cov"})

    def bind(self, simulator: Any) -> None:
        self.memory = Memory(simulator.receivers)
        self.memory.declare("sums", np.zeros((simulator.receivers, 8)))

    def update(self, simulator: Any) -> None:
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
    parts = [
        simulator.monitor(InnovationSums).memory["sums"]
        for simulator in player.simulators(InnovationSums(), range(runs))
    ]
    sums = np.concatenate(parts).sum(axis=0)
    real, believed = sums[0::2], sums[1::2]
    sound = (real > 0.0) & (believed > 0.0)
    factors = np.sqrt(np.where(sound, believed, 1.0) / np.where(sound, real, 1.0))
    return tuple(files.round_digits(factor) for factor in factors)
