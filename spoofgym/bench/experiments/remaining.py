"""Work of campaigns and searches, roughly, in runs of a cell; and what a campaign has left."""

from __future__ import annotations

from ..runs.players import PlayerSpec
from ..search.settings import Tuning
from .results_folder import ResultsFolder
from .suite import Suite

WARMUP_SHARE = 1.0
"""Work of a warm-up, in cells."""


def expected_work(suite: Suite, folder: ResultsFolder) -> float:
    return sum(work_of(suite, folder, detector) for detector in suite.detector_entries)


def work_of(suite: Suite, folder: ResultsFolder, detector: PlayerSpec) -> float:
    total = 0.0
    cells, searches, protect = left_of(suite, folder, detector)
    if cells or protect:
        total += suite.runs * (1.0 + WARMUP_SHARE)
        total += suite.runs * sum(entry.label != "none" for entry in cells)
    if searches:
        total += suite.tuning.runs * (1.0 + WARMUP_SHARE)
        total += len(searches) * search_work(suite.tuning)
    return total + (protection_work(suite) if protect else 0.0)


def search_work(settings: Tuning) -> float:
    return settings.values * settings.sift_runs + (settings.refined + 2) * settings.runs


def protection_work(suite: Suite) -> float:
    """Work of the search for the worst attacks on a detector, and of those, roughly."""
    settings = suite.selection
    if settings is None:
        return 0.0
    sifting = len(suite.members) * settings.values * settings.sift_runs
    return sifting + (12.0 + 1.0 + WARMUP_SHARE) * settings.runs + 5.0 * suite.runs


def left_of(
    suite: Suite, folder: ResultsFolder, detector: PlayerSpec
) -> tuple[list[PlayerSpec], list[PlayerSpec], bool]:
    """Spoofers whose cell is not finished, those that are not tuned, whether to play the suite."""
    cells = [
        entry for entry in suite.spoofer_entries if not folder.has_cell(detector.label, entry.label)
    ]
    searches = [
        entry
        for entry in cells
        if entry.tuned and folder.tuning(detector.label, entry.label) is None
    ]
    protect = suite.selection is not None and folder.protection(detector.label) is None
    return cells, searches, protect
