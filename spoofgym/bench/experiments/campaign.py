"""Detectors x spoofers.

The standard suite: every detector that suits one task's world, against the usual spoofers.

Tests of range rates are there a second time where their defaults test pseudoranges, or both.

World and alert limit are those of the task, the rate of false alarms is the standard one, and the
sizes are such that two idle cores play it in a quarter of an hour.
"""

from __future__ import annotations

import signal
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray

from ...calibration.thresholds import suitable_detectors
from ...core.progress import NullProgress, ProgressCallback, RemainingWork
from ...detectors.build import spec_of_judge
from ...detectors.calibrated import STANDARD_RATE
from ...envs.spoofer_binding import spoofer_context
from ...simulation.engine import processors
from ...simulation.setup import Setup
from ...tasks import RANGE_RATE_TESTS, SUITE, task_of
from ..runs.play import Runs, WarmStart, play
from ..runs.players import PlayerSpec, knowledge_of
from ..runs.record import Aim, Cell, Protection, make_cell
from ..runs.world import CONTROLS
from ..scores.scores import counted
from ..search.amplitude import TuningResult, tune
from ..search.attack_suite import SuiteAttack
from ..search.open_loop import AIMS, Optima
from ..search.worst_attack import Search, measured, winner_of
from .remaining import WARMUP_SHARE, left_of, protection_work, search_work, work_of
from .results_folder import ResultsFolder
from .suite import Suite


def run_campaign(
    suite: Suite,
    folder: ResultsFolder,
    *,
    threads: int | None = None,
    jobs: int = 1,
    progress: ProgressCallback | None = None,
) -> None:
    """Run all cells that are not finished yet.

    Every cell is written as soon as it is finished, so that an interruption loses one at most.

    Parameters
    ----------
    suite : Suite
        What is run.
    folder : ResultsFolder
        Opened with the same suite.
    threads : int, optional
        As in `Engine`, in each process.
    jobs : int
        Processes that play detectors, one detector each at a time.
    progress : ProgressCallback, optional
        Shows how far it is.
    """
    if jobs < 1:
        raise ValueError(f"`jobs` must be at least 1, got {jobs}")
    shown, player = progress or NullProgress(), Player(suite, folder, threads)
    if jobs == 1:
        for detector in suite.detector_entries:
            player.play(detector, shown)
    else:
        _in_processes(suite, folder, threads, jobs, shown)
    player.limits(shown)


class Player:
    """Plays the detectors of a campaign; what they share is computed once."""

    def __init__(self, suite: Suite, folder: ResultsFolder, threads: int | None) -> None:
        self.suite, self.folder, self.threads = suite, folder, threads
        self.optima = suite.optima(threads)
        self.brackets = self.optima.brackets

    def play(self, detector: PlayerSpec, progress: ProgressCallback) -> None:
        """Run the cells of a detector that are not finished, its searches and its protection."""
        suite, folder, threads = self.suite, self.folder, self.threads
        cells, searches, protect = left_of(suite, folder, detector)
        if searches:
            _search(suite, folder, detector, searches, threads, progress, self.optima)
        members = _members(suite, folder, detector) if protect else ()
        winners = _worst(suite, detector, members, threads, progress) if protect else None
        if cells or winners is not None:
            _cells(suite, folder, detector, cells, winners, threads, progress)

    def limits(self, progress: ProgressCallback) -> None:
        """Compute the floor of the world, and the zero-alarm bounds of the detectors."""
        self.floor(progress)
        for detector in self.suite.detector_entries:
            self.bound(detector, progress)

    def floor(self, progress: ProgressCallback) -> None:
        if self.folder.limits(None) is None:
            progress.advance(0.0, "floor")
            self.folder.put_limits(None, self.brackets.floor())

    def bound(self, detector: PlayerSpec, progress: ProgressCallback) -> None:
        """Compute the zero-alarm bound of a detector."""
        if self.folder.limits(detector.label) is None:
            progress.advance(0.0, f"{detector.label}: zero-alarm bound")
            found = self.brackets.zero_alarm(detector).as_json()
            self.folder.put_limits(detector.label, found)


def _in_processes(
    suite: Suite, folder: ResultsFolder, threads: int | None, jobs: int, progress: ProgressCallback
) -> None:
    """Play the detectors, each in one of some processes, which write into the same folder."""
    work = {each.label: work_of(suite, folder, each) for each in suite.detector_entries}
    left = [label for label in work if work[label] > 0.0]
    each = threads or max(1, processors() // jobs)
    progress.advance(0.0, f"{len(left)} detectors, {jobs} at a time")
    asked = (delayed(_played)(suite, folder.path, label, each) for label in (*left, None))
    for label in Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)(asked):
        if label is not None:
            progress.advance(work[label], f"{label} is finished")


_players: dict[str, Player] = {}
"""Of this process, for the campaign that it plays."""


def _played(suite: Suite, path: Path, label: str | None, threads: int) -> str | None:
    """Play one detector of a campaign in a process of its own; the floor for None."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process that waits for it decides
    if suite.digest not in _players:
        _players.clear()
        _players[suite.digest] = Player(suite, ResultsFolder(path), threads)
    player = _players[suite.digest]
    if label is None:
        player.floor(NullProgress())
        return None
    (detector,) = (entry for entry in suite.detector_entries if entry.label == label)
    player.play(detector, NullProgress())
    player.bound(detector, NullProgress())
    return label


def _search(
    suite: Suite,
    folder: ResultsFolder,
    detector: PlayerSpec,
    searches: list[PlayerSpec],
    threads: int | None,
    progress: ProgressCallback,
    optima: Optima,
) -> None:
    start, clean = training_start(suite, detector, threads, progress)
    for entry in searches:
        folder.put_tuning(search(detector, entry, start, clean, progress, optima))


def _members(suite: Suite, folder: ResultsFolder, detector: PlayerSpec) -> tuple[SuiteAttack, ...]:
    """The attack suite, with the blind optima that were found against the detector."""
    found: list[SuiteAttack] = []
    for entry in suite.spoofer_entries:
        result = folder.tuning(detector.label, entry.label) if entry.searched else None
        if result is not None and result.found is not None:
            each = (result.found["played"], *(result.found["aims"][name] for name in AIMS))
            curves = [with_rates(entry, curve["rates_mps"]) for curve in each]
            own = [curve for k, curve in enumerate(curves) if curve not in curves[:k]]
            found += [SuiteAttack("c", curve, True) for curve in own]
    return (*suite.members, *found)


def with_rates(entry: PlayerSpec, rates_mps: list[float]) -> PlayerSpec:
    """A blind optimum with the rates of a curve."""
    return replace(entry, spec={**entry.spec, "rates_mps": rates_mps})


def training_start(
    suite: Suite, detector: PlayerSpec, threads: int | None, progress: ProgressCallback
) -> tuple[WarmStart, Runs]:
    """Training runs of a detector at the onset, and what they do without attack."""
    return _start(suite, detector, "training", suite.tuning.runs, threads, progress)


def _start(
    suite: Suite,
    detector: PlayerSpec,
    split: str,
    runs: int,
    threads: int | None,
    progress: ProgressCallback,
) -> tuple[WarmStart, Runs]:
    now, setup = f"{detector.label}: {split} runs", suite.setup(detector)
    return start_of(setup, suite.generators(split, runs), now, threads, progress)


def start_of(
    setup: Setup,
    rngs: Sequence[np.random.Generator],
    now: str,
    threads: int | None,
    progress: ProgressCallback,
) -> tuple[WarmStart, Runs]:
    """Runs at the onset, and what they do without attack."""
    progress.advance(0.0, now)
    start = WarmStart(setup, rngs, threads=threads)
    progress.advance(len(rngs) * WARMUP_SHARE, now)
    return start, play(start, "none", tick=lambda part: progress.advance(len(rngs) * part, now))


def search(
    detector: PlayerSpec,
    entry: PlayerSpec,
    start: WarmStart,
    clean: Runs,
    progress: ProgressCallback,
    optima: Optima,
) -> TuningResult:
    """Search for the setting of one spoofer, and for the curve of a blind optimum before."""
    work = search_work(optima.tuning)
    left = RemainingWork(progress, work, f"{detector.label}: tuning {entry.label}")
    if not entry.searched:
        result = tune(start, clean, entry, detector.label, optima.tuning, tick=left.tick)
        left.end()
        return result
    most = 0.25 * work
    found = optima.find(detector, entry, lambda part: left.tick(most * part))
    curves = optima.curves_to_fit(found)
    fits = {
        name: tune(
            start,
            clean,
            with_rates(entry, rates),
            detector.label,
            optima.tuning,
            tick=lambda part: left.tick(part / len(curves)),
        )
        for name, rates in curves.items()
    }
    best = max(fits, key=lambda name: fits[name].score)
    left.end()
    found["fitted_m"] = {name: fit.score for name, fit in fits.items()}
    found["played"] = {"curve": best, "rates_mps": curves[best]}
    return replace(fits[best], found=found)


class _Worst(NamedTuple):
    """The worst attacks on a detector: by member and value, each with its aims, and the skies."""

    found: dict[tuple[int, float], list[Aim]]
    members: tuple[SuiteAttack, ...]
    skies: NDArray[np.int64] | None
    left: RemainingWork


def _worst(
    suite: Suite,
    detector: PlayerSpec,
    members: tuple[SuiteAttack, ...],
    threads: int | None,
    progress: ProgressCallback,
) -> _Worst:
    """Look for the worst attacks on runs of the selection."""
    assert suite.selection is not None  # as `_open` has seen
    runs = suite.selection.runs
    start, clean = _start(suite, detector, "selection", runs, threads, progress)
    expected = protection_work(suite) - runs * (1.0 + WARMUP_SHARE)
    left = RemainingWork(progress, expected, f"{detector.label}: worst attack")
    context = spoofer_context(start.setup)
    looked = Search(start, clean, members, context, suite.selection, left.tick)
    found = looked.winners(suite.alert_limits_m)
    return _Worst(found, members, looked.skies, left)


def _cells(
    suite: Suite,
    folder: ResultsFolder,
    detector: PlayerSpec,
    cells: list[PlayerSpec],
    worst: _Worst | None,
    threads: int | None,
    progress: ProgressCallback,
) -> None:
    start, twin = _start(suite, detector, "evaluation", suite.runs, threads, progress)
    for entry in cells:
        tuning = folder.tuning(detector.label, entry.label) if entry.tuned else None
        spec = entry.spec
        if tuning is not None:
            chosen = entry
            if tuning.found is not None:
                chosen = with_rates(entry, tuning.found["played"]["rates_mps"])
            spec = chosen.with_value(tuning.value)
        within = None if tuning is None else tuning.within_budget
        folder.put_cell(_cell(suite, detector, entry, spec, within, start, twin, progress))
    if worst is not None:
        folder.put_protection(_protection(suite, detector, worst, start, twin))
        worst.left.end()


def _cell(
    suite: Suite,
    detector: PlayerSpec,
    entry: PlayerSpec,
    spec: dict[str, Any],
    within_budget: bool | None,
    start: WarmStart,
    twin: Runs,
    progress: ProgressCallback,
) -> Cell:
    now = f"{detector.label}: {entry.label}"
    attacked = twin
    if entry.label != "none":
        attacked = play(start, spec, tick=lambda part: progress.advance(suite.runs * part, now))
    head = {
        "detector": detector.label,
        "spoofer": entry.label,
        "detector_settings": detector.spec,
        "spoofer_settings": spec,
        "knowledge": knowledge_of(entry, start.setup, detector),
        "attack": start.setup.attack.label,
        "tuned_within_budget": within_budget,
        "runs": suite.runs,
        "entropy": suite.entropy,
        "campaign": suite.digest,
    }
    return make_cell(start.setup, head, start.warmup_alarm, attacked, twin, suite.alert_limit_m)


def _protection(
    suite: Suite, detector: PlayerSpec, worst: _Worst, start: WarmStart, twin: Runs
) -> Protection:
    """Let the worst attacks play the evaluation runs."""
    winners = []
    for (number, value), aims in worst.found.items():
        member = worst.members[number]
        spec = member.player.with_value(value)
        attacked = play(
            start, spec, drop_alarmed=True, tick=lambda part: worst.left.tick(suite.runs * part)
        )
        winners.append(winner_of(member, value, aims, measured(start.setup, attacked, twin)))
    head = {
        "detector": detector.label,
        "attack_suite": suite.config["attack_suite"],
        "entropy": suite.entropy,
        "campaign": suite.digest,
    }
    counts = counted(start.warmup_alarm, twin.first_alarm)
    sky = twin.onset // start.setup.epochs_each
    return Protection(head, tuple(winners), counts, sky, worst.skies)


STANDARD = "standard"
SUITES = (STANDARD,)
"""Names of `spoofgym bench --suite`."""
TASK = "T3"
RATE = STANDARD_RATE
"""False alarms an hour of all detectors."""
SPOOFERS = ("ramp", "accelerating-ramp", "snapshot-chi2-profile", "blind-optimum", "feedback")
"""Each is fitted to the alarm budget."""
SIZES = {"seeds": 400, "training_seeds": 128, "selection_seeds": 48}
"""Evaluation, training and selection runs, where no others are given."""


def everyone_in(setup: Setup, rescaled: bool = False) -> list[dict[str, Any]]:
    """The controls and all classics that suit a world; `rescaled`: also with their innovations."""
    found = [dict(each) for each in CONTROLS]
    for each in suitable_detectors(setup):
        own = {"name": spec_of_judge(each)["name"]}
        if own not in found:
            found.append(own)
        if rescaled and each.drifts:
            found.append({**own, "thresholds": "rescaled"})
    return found


def in_order(everyone: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Controls, solution separation, tests of range rates, which are added, and the others."""
    controls = [dict(spec) for spec in CONTROLS]
    first = [*controls, {"name": "solution-separation"}, *map(dict, RANGE_RATE_TESTS)]
    return [*first, *(dict(spec) for spec in everyone if spec not in first)]


def standard_kwargs() -> dict[str, Any]:
    """Keyword arguments of a `Suite`, but for its detectors."""
    task = task_of(TASK)
    limit = {} if task.alert_limit_m is None else {"alert_limit_m": task.alert_limit_m}
    note = f"suite {STANDARD}: the world of task {task.key} of {SUITE}"
    return {**task.world_kwargs, **limit, "notes": (note,)}
