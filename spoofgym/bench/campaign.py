"""A campaign: every detector against every spoofer, one finished cell after the other."""

from __future__ import annotations

from typing import Any, Protocol

from ..simulators.setup import Setup
from .cells import make_cell
from .entries import Entry, build_spoofer
from .run import Runs, WarmStart, play
from .shipped import card_behind, transferred
from .store import ResultsFolder
from .suite import Suite
from .tune import TuningResult, tune

WARMUP_SHARE = 1.0
"""Work of a warm-up, in cells."""


class Progress(Protocol):
    """Shows how far a campaign is."""

    def advance(self, amount: float, now: str) -> None:
        """Some work is done."""


class Silent:
    """Shows nothing."""

    def advance(self, amount: float, now: str) -> None:
        """Ignore it."""


def expected_work(suite: Suite, folder: ResultsFolder) -> float:
    """Work that is left, roughly."""
    total = 0.0
    for detector in suite.detector_entries:
        cells, searches = _open(suite, folder, detector)
        if cells:
            total += suite.runs * (1.0 + WARMUP_SHARE)
            total += suite.runs * sum(entry.label != "none" for entry in cells)
        if searches:
            total += suite.tuning.runs * (1.0 + WARMUP_SHARE)
            total += len(searches) * search_work(suite)
    return total


def search_work(suite: Suite) -> float:
    """Work of one search, roughly."""
    settings = suite.tuning
    return settings.values * settings.sift_runs + (settings.refined + 2) * settings.runs


def _open(suite: Suite, folder: ResultsFolder, detector: Entry) -> tuple[list[Entry], list[Entry]]:
    """Spoofers whose cell is not finished, and those among them that are not tuned yet."""
    cells = [
        entry for entry in suite.spoofer_entries if not folder.has_cell(detector.label, entry.label)
    ]
    searches = [
        entry
        for entry in cells
        if entry.tuned and folder.tuning(detector.label, entry.label) is None
    ]
    return cells, searches


def run_campaign(
    suite: Suite,
    folder: ResultsFolder,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
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
        As in `Engine`.
    progress : Progress, optional
        Shows how far it is.
    """
    progress = progress or Silent()
    for detector in suite.detector_entries:
        cells, searches = _open(suite, folder, detector)
        if searches:
            _search(suite, folder, detector, searches, threads, progress)
        if cells:
            _cells(suite, folder, detector, cells, threads, progress)


def _search(
    suite: Suite,
    folder: ResultsFolder,
    detector: Entry,
    searches: list[Entry],
    threads: int | None,
    progress: Progress,
) -> None:
    start, clean = training_start(suite, detector, threads, progress)
    for entry in searches:
        folder.put_tuning(search(suite, detector, entry, start, clean, progress))


def training_start(
    suite: Suite, detector: Entry, threads: int | None, progress: Progress
) -> tuple[WarmStart, Runs]:
    """Training runs of a detector at the onset, and what they do without attack."""
    runs = suite.tuning.runs
    now = f"{detector.label}: training runs"
    progress.advance(0.0, now)
    setup = suite.setup(detector)
    start = WarmStart(setup, suite.generators("training", runs), threads=threads)
    progress.advance(runs * WARMUP_SHARE, now)
    return start, play(start, "none", tick=lambda part: progress.advance(runs * part, now))


def search(
    suite: Suite,
    detector: Entry,
    entry: Entry,
    start: WarmStart,
    clean: Runs,
    progress: Progress,
) -> TuningResult:
    """Search for the setting of one spoofer."""
    now = f"{detector.label}: tuning {entry.label}"
    left = search_work(suite)

    def tick(amount: float) -> None:
        """Show it, but no more than was expected."""
        nonlocal left
        amount = min(amount, left)
        left -= amount
        progress.advance(amount, now)

    result = tune(start, clean, entry, detector.label, suite.tuning, tick=tick)
    progress.advance(left, now)
    return result


def _cells(
    suite: Suite,
    folder: ResultsFolder,
    detector: Entry,
    cells: list[Entry],
    threads: int | None,
    progress: Progress,
) -> None:
    now = f"{detector.label}: evaluation runs"
    progress.advance(0.0, now)
    setup = suite.setup(detector)
    start = WarmStart(setup, suite.generators("evaluation", suite.runs), threads=threads)
    progress.advance(suite.runs * WARMUP_SHARE, now)

    def tick_of(label: str) -> Any:
        return lambda part: progress.advance(suite.runs * part, f"{detector.label}: {label}")

    twin = play(start, "none", tick=tick_of("none"))
    for entry in cells:
        tuning = folder.tuning(detector.label, entry.label) if entry.tuned else None
        spec = entry.spec if tuning is None else entry.with_value(tuning.value)
        attacked = twin if entry.label == "none" else play(start, spec, tick=tick_of(entry.label))
        head = {
            "detector": detector.label,
            "spoofer": entry.label,
            "detector_settings": detector.spec,
            "spoofer_settings": spec,
            "knowledge": knowledge_of(entry, setup, detector),
            "attack": setup.attack.label,
            "tuned_within_budget": None if tuning is None else tuning.within_budget,
            "runs": suite.runs,
            "entropy": suite.entropy,
            "campaign": suite.digest,
        }
        folder.put_cell(make_cell(setup, head, start.warmup_alarm, attacked, twin))


def knowledge_of(entry: Entry, setup: Setup, detector: Entry) -> dict[str, Any]:
    """What a spoofer knows: while it attacks, and when it was designed.

    Returns ``run_time``; ``design_time``; ``detector``, the label of the one that it was made for,
    None where it was made for none, or has no card that says so; ``transfer``, what is another one
    here than where it was made.
    """
    spoofer = build_spoofer(entry.untuned)
    known: dict[str, Any] = {
        "run_time": spoofer.knowledge,
        "design_time": spoofer.designed_on,
        "detector": None,
        "transfer": [],
    }
    if entry.tuned:
        designed = "detector, receiver and scenario, by tuning"
        return {**known, "design_time": designed, "detector": detector.label}
    card = card_behind(spoofer)
    if card is None:
        return known
    made_for, differences = transferred(card, setup, detector)
    return {**known, "detector": made_for, "transfer": differences}
