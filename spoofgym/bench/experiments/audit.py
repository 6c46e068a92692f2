"""Audit of any detector, which is calibrated first.

Each family's attacks are looked for on runs of the split `selection`, against that detector, and
the ones found play the evaluation runs, which have decided nothing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from ...core.progress import ProgressBar, show_on_terminal
from ...detectors import detector_in_world
from ...receiver.log import InnovationLog
from ...tasks import DetectorTask
from ..runs.players import specify_detectors
from ..scores.audit import Audit
from ..scores.detector import DetectorScore
from .audit_cells import AuditCells, AuditPlan
from .audit_worlds import check_contract
from .calibration import calibrate_players
from .log_audit import LogAuditor
from .runner import Experiment, run_experiment
from .store import MemoryStore, Reader, Store

OVERHEAD = 1.5
"""Time of an audit, in parts of that of its runs and warm-ups, each alone."""


class Auditor(AuditPlan):
    """Audits detectors of one task; those that only look share their passes. Arguments: of
    `AuditPlan`."""

    def scores(
        self, detectors: Iterable[Any], *, show: ProgressBar | None = None
    ) -> list[DetectorScore]:
        """Scores of detectors whose thresholds are known, in their order, and no more of them."""
        cells = AuditCells(self, self.worlds.build_detectors(detectors), scores_only=True)
        return cells.scores(self.run(cells, show))

    def run(self, cells: AuditCells, show: ProgressBar | None = None) -> Reader:
        return _play(cells, self.folder, self.worlds.threads, show)

    def prepare(
        self,
        detector: Any,
        show: ProgressBar | None = None,
        say: Callable[[str], None] = lambda _: None,
    ) -> AuditCells:
        """Cells of a detector, which is checked and calibrated first; `say` is given how long that
        and the audit take."""
        detector, broken = check_contract(detector, say)
        judge = detector_in_world(detector)  # whose process all below share
        worlds, world = self.worlds, self.worlds.world.setup
        (entry,) = specify_detectors([detector])
        text, whole_us = worlds.expect_calibration(detector, judge, self.size.ages)
        if text:
            say(
                f"{entry.label} has no thresholds for {self.task.key} yet: a calibration on {text},"
                " is stored and serves all later audits"
            )
        calibrate_players(worlds.world, [entry], threads=worlds.threads, progress=show)
        cells = AuditCells(self, worlds.build_detectors([detector]), broken=broken)
        epochs = sum(cell.work for cell in cells.cells()) * (world.steps + world.hold)
        minutes = OVERHEAD * epochs * whole_us / 6e7
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
    log: InnovationLog | str | os.PathLike[str] | None = None,
    **settings: Any,
) -> Audit:
    """Audit a detector: what the worst attack of a task's families does to it, and how surely.

    One that is not the package's own is checked first, in seconds; each is calibrated where that
    has not been done.  Each family's attacks are then chosen against it, and play runs that have
    decided nothing.  P(HMI | attack) is how often the error that an attack induces exceeds the
    alert limit with no alarm up to the time to alert after it, over the runs that are silent before
    the onset and without an attack; the worst family counts.

    Parameters
    ----------
    detector : str, mapping, Detector or type
        As an environment takes it: a name or a class is at 0.2 false alarms an hour where it
        requests no thresholds, an object keeps its own.  Thresholds are those of the task's world
        everywhere.  ``"module:Class"`` runs in a process of its own; others, in this one.
    task : str or DetectorTask
        ``"D1"`` to ``"D3"``, ``"v1/D1"`` to ``"v1/D4"``, or one of your own.
    budget : {"standard", "quick", "full"}
        Size of all that is played: some 4, 1 or 12 minutes of a processor for a plain detector in
        D1.
    progress : callable, optional
        Opens a bar, such as `spoofgym.core.progress.show_progress`; by default that one where
        stderr is a terminal.
    log : InnovationLog or path-like, optional
        Log of a receiver.  Its clean windows are played in place of a task, with thresholds from
        these windows.  Of the settings it has ``families``, ``threads`` and ``folder``.
    **settings
        ``runs`` and ``selection_runs``: evaluation runs of every family, which decide nothing, and
        runs that its attacks are chosen on; by default those of the budget.  ``families``: keys of
        those that are played; by default all of the task, and ``"shipped"`` where shipped spoofers
        were made for the detector and fit the task's world.  ``entropy``: seed of all of them; by
        default it is drawn, so that a detector that plays known seeds itself gains nothing, and a
        folder keeps that of its first audit.  ``threads``: of the engine.  ``folder``: its folder
        of the task holds what is finished, and the worst attacks; a killed process goes on there.

    Returns
    -------
    Audit
        Printed, it is the answer in a line, with warnings.

    Raises
    ------
    ValueError
        When a task or a family is unknown, a number is out of range, or the detector lacks what no
        run can do without.

    Examples
    --------
    >>> import spoofgym
    >>> found = spoofgym.audit("never", "D1", "quick", runs=4, selection_runs=4,
    ...                        families=["dashes"])
    >>> found.score.worst.family, found.score.p_hmi.value
    ('dashes', 1.0)
    """
    auditor: Auditor | LogAuditor = (
        Auditor(task, budget, **settings) if log is None else LogAuditor(log, budget, **settings)
    )
    show = progress or show_on_terminal
    cells = auditor.prepare(detector, show)
    return cells.conclude(_play(cells, auditor.folder, settings.get("threads"), show))


def _play(
    cells: Experiment, folder: Path | None, threads: int | None, show: ProgressBar | None
) -> Reader:
    store = MemoryStore(None if folder is None else Store(folder))
    return run_experiment(cells, store, threads=threads, progress=show)
