"""Audit of any detector: its size, its calibration, and what it says.

Each family's attacks are looked for on runs of the split `selection`, against that detector, and
the ones found play the evaluation runs, which have decided nothing.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ...calibration.thresholds import PASSIVE_RUNS, WEIGHING_RUNS
from ...core.files import write_file
from ...core.progress import ProgressBar
from ...core.registry import check_choice, whole_number
from ...detectors import detector_in_world
from ...detectors.build import bare_detector
from ...detectors.calibrated import resolve_thresholds, unwrap
from ...detectors.isolated import isolate
from ...simulation.simulator import weighs
from ...tasks import (
    DetectorTask,
    get_detector_task,
)
from ..runs.players import specify_detectors
from ..scores.audit import Audit
from ..scores.detector import DetectorScore
from ..search.attack_suite import (
    Selection,
)
from ..search.bounds import expect_onset
from ..search.open_loop import OpenLoopSearch
from .audit_cells import AuditCells
from .audit_worlds import Worlds
from .calibration import calibrate_players
from .runner import run_experiment
from .store import MemoryStore, Reader, Store


class AuditBudget(NamedTuple):
    """Size of an audit.

    - `runs`: evaluation runs of every family; `selection_runs`: those that its attacks are chosen
      on; `search`: of profiles against the detector;
    - `twins`: runs of every age; `ages`: how many of `AGES_S`;
    - `floor_worlds`: worlds of the floor where none is stored, None for all, 0 for no floor.
    """

    runs: int
    selection_runs: int
    search: OpenLoopSearch
    twins: int
    ages: int
    floor_worlds: int | None


BUDGETS = {
    "quick": AuditBudget(40, 24, OpenLoopSearch(runs=96, batch=24, generations=6), 16, 4, 0),
    "standard": AuditBudget(400, 96, OpenLoopSearch(runs=256), 64, 5, 4),
    "full": AuditBudget(1500, 384, OpenLoopSearch(), 192, 5, None),
}
"""Sizes by their names: about 1, 3 and 12 minutes of a processor for a plain detector in D1."""
SIFTED = 4
"""Part of the selection that sifts, as one in so many."""
ENTROPY = "entropy"
"""File of a folder: the entropy that was drawn for its runs."""
OVERHEAD = 4.0
"""Time of an audit, in parts of that of its attacks from the onset on."""


def draw_entropy(folder: Path | None) -> int:
    """Entropy that no detector has seen; of a folder, that of its first audit."""
    drawn = secrets.randbits(32)
    if folder is not None:
        try:
            write_file(folder / ENTROPY, f"{drawn}\n".encode(), exclusive=True)
        except FileExistsError:  # another shard's, too
            drawn = int((folder / ENTROPY).read_text())
    return drawn


class Auditor:
    """Audits detectors of one task on the same runs; those that only look share their passes.

    - `task`, `budget`: as `audit` takes them;
    - `runs`, `selection_runs`: evaluation runs of every family, which decide nothing, and runs that
      its attacks are chosen on; by default those of the budget;
    - `families`: keys of those that are played; by default all of the task;
    - `entropy`: seed of all of them. By default it is drawn, so that a detector that plays known
      seeds itself gains nothing; a folder keeps that of its first audit;
    - `threads`: of the engine;
    - `folder`: its folder of the task holds what is finished, and the worst attacks; a killed
      process goes on from there.
    """

    def __init__(
        self,
        task: str | DetectorTask = "D1",
        budget: str = "standard",
        *,
        runs: int | None = None,
        selection_runs: int | None = None,
        families: Sequence[str] | None = None,
        entropy: int | None = None,
        threads: int | None = None,
        folder: str | os.PathLike[str] | None = None,
    ) -> None:
        self.task = get_detector_task(task) if isinstance(task, str) else task
        check_choice("budget", budget, BUDGETS)
        self.budget, self.size = budget, BUDGETS[budget]
        self.runs = whole_number("`runs`", self.size.runs if runs is None else runs, 2)
        few = self.size.selection_runs if selection_runs is None else selection_runs
        few = whole_number("`selection_runs`", few, 4)
        self.selection = Selection(runs=few, sift_runs=max(few // SIFTED, 1))
        keys = [each.key for each in self.task.families] if families is None else list(families)
        if not keys:
            raise ValueError("`families` must name at least one family of attacks, got none")
        self.families = tuple(self.task.family(key) for key in dict.fromkeys(keys))
        root = None if folder is None else Path(folder)
        self.folder = None if root is None else root / self.task.key
        drawn = draw_entropy(root) if entropy is None else entropy
        self.entropy = whole_number("`entropy`", drawn)
        self.worlds = Worlds(self.task, self.entropy, threads)

    def scores(
        self, detectors: Iterable[Any], *, show: ProgressBar | None = None
    ) -> list[DetectorScore]:
        """Scores of detectors whose thresholds are known, in their order, and no more of them."""
        cells = AuditCells(self, self.worlds.build_detectors(detectors), scores_only=True)
        return cells.scores(self.run(cells, show))

    def run(self, cells: AuditCells, show: ProgressBar | None = None) -> Reader:
        store = MemoryStore(None if self.folder is None else Store(self.folder))
        return run_experiment(cells, store, threads=self.worlds.threads, progress=show)

    def prepare(
        self,
        detector: Any,
        show: ProgressBar | None = None,
        say: Callable[[str], None] = lambda _: None,
    ) -> AuditCells:
        """Cells of a detector, which is calibrated first; `say` is given how long both take. A
        foreign one that is given as text has a process of its own."""
        detector = isolate(detector) if isinstance(detector, str | Mapping) else detector
        judge, worlds = detector_in_world(detector), self.worlds  # whose process all below share
        (entry,), world = specify_detectors([detector]), worlds.world.setup
        bare, missing = unwrap(bare_detector(detector)), 0
        try:
            resolve_thresholds(judge, world)
        except ValueError:
            missing = WEIGHING_RUNS if weighs(world, bare) else PASSIVE_RUNS
        _, whole_us = worlds.measure_cost(bare, self.size.ages)
        window = world.steps + world.hold
        if missing:
            minutes = missing * (expect_onset(world) + window) * whole_us / 6e7
            say(
                f"{entry.label} has no thresholds for {self.task.key} yet: a calibration on "
                f"{missing} clean runs, some {max(minutes, 1.0):.0f} min of a processor, is "
                "stored and serves all later audits"
            )
        calibrate_players(worlds.world, [entry], threads=worlds.threads, progress=show)
        cells = AuditCells(self, worlds.build_detectors([detector]))
        minutes = OVERHEAD * sum(cell.work for cell in cells.cells()) * window * whole_us / 6e7
        say(
            f"{self.task.key}: the {self.budget} audit takes some {max(minutes, 1.0):.0f} min of a "
            "processor, less what is finished"
        )
        return cells


def audit(
    detector: Any,
    task: str | DetectorTask = "D1",
    budget: str = "standard",
    *,
    progress: ProgressBar | None = None,
    **settings: Any,
) -> Audit:
    """Audit a detector: what the worst attack of a task's families does to it, and how surely.

    It is calibrated first where that has not been done.  Each family's attacks are then chosen
    against it, and play runs that have decided nothing.  P(HMI | attack) is how often the error
    that an attack induces exceeds the alert limit with no alarm up to the time to alert after it,
    over the runs that are silent before the onset and without an attack; the worst family counts.

    Parameters
    ----------
    detector : str, mapping or Detector
        As `make_detector` takes it, at 0.2 false alarms an hour where it requests none; the
        thresholds are those of the task's world everywhere.  ``"module:Class"`` runs in a process
        of its own; an object, in this one.
    task : str or DetectorTask
        ``"D1"`` to ``"D3"``, ``"v1/D1"`` to ``"v1/D4"``, or one of your own.
    budget : {"standard", "quick", "full"}
        Size of all that is played: some 3, 1 or 12 minutes of a processor for a plain detector in
        D1.
    progress : callable, optional
        Opens a bar, such as `spoofgym.core.progress.show_progress`.
    **settings
        As `Auditor` takes them: ``runs``, ``selection_runs``, ``families``, ``entropy``,
        ``threads``, ``folder``.

    Returns
    -------
    Audit
        Printed, it is the answer in a line, with warnings.

    Raises
    ------
    ValueError
        When a task or a family is unknown, or a number is out of range.

    Examples
    --------
    >>> import spoofgym
    >>> found = spoofgym.audit("never", "D1", "quick", runs=4, selection_runs=4,
    ...                        families=["dashes"])
    >>> found.score.worst.family, found.score.p_hmi.value
    ('dashes', 1.0)
    """
    auditor = Auditor(task, budget, **settings)
    cells = auditor.prepare(detector, progress)
    return cells.conclude(auditor.run(cells, progress))
