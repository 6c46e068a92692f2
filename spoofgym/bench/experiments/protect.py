"""Score of any detector in a task of its own: the worst family of attacks, and false alarms.

Each family's attacks are looked for on runs of the split `selection`, against that detector, and
the ones found play the evaluation runs, which have decided nothing.  Finished parts are kept in a
folder, one file for a detector and a family, so that a killed process goes on from there.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.progress import NullProgress, ProgressCallback, RemainingWork
from ...core.registry import whole_number
from ...envs.spoofer_binding import spoofer_context
from ...tasks import ANTENNA_PARTS, EVENTS, AttackFamily, DetectorTask, detector_task_of
from ..runs.record import MEASURES, Protection
from ..scores.detector import (
    CLEAN,
    WINDOW,
    DetectorScore,
    FamilyScore,
    false_alarms_of,
    false_alarms_text,
)
from ..search.settings import Selection
from ..search.worst_attack import ROUNDS, FamilySearch, expected_plays, winner_of
from ..search.worst_attack import PlayedFamily as Played
from .protect_parts import Parts
from .task_worlds import Defence, Worlds, sharing

RUNS, SELECTION_RUNS = 400, 96
"""Evaluation runs of every family, and runs that its attacks are chosen on."""
SIFTED = 4
"""Part of the selection that sifts, as one in so many."""


class DetectorEvaluator:
    """Scores detectors of one task on the same runs; those that only look share their passes.

    Parameters
    ----------
    task : str or DetectorTask
        ``"D1"`` to ``"D4"``, or one of your own.
    runs : int
        Evaluation runs of every family, which decide nothing.
    selection_runs : int
        Runs that each family's attacks are chosen on.
    families : sequence of str, optional
        Keys of those that are played; by default all of the task.
    entropy : int
        Seed of all of them.
    threads : int, optional
        Threads of the engine.
    progress : ProgressCallback, optional
        Shows how far it is; `expected_work` is the whole.
    folder : path-like, optional
        Where finished parts are kept, and looked for.

    Raises
    ------
    ValueError
        When a task or a family is unknown, or a number is out of range.
    """

    def __init__(
        self,
        task: str | DetectorTask = "D1",
        *,
        runs: int = RUNS,
        selection_runs: int = SELECTION_RUNS,
        families: Sequence[str] | None = None,
        entropy: int = 0,
        threads: int | None = None,
        progress: ProgressCallback | None = None,
        folder: str | os.PathLike[str] | None = None,
    ) -> None:
        self.task = detector_task_of(task) if isinstance(task, str) else task
        self.runs = whole_number("`runs`", runs, 2)
        few = whole_number("`selection_runs`", selection_runs, 4)
        self.selection = Selection(runs=few, sift_runs=max(few // SIFTED, 1))
        keys = [each.key for each in self.task.families] if families is None else list(families)
        if not keys:
            raise ValueError("`families` must name at least one family of attacks, got none")
        self.families = tuple(self.task.family(key) for key in dict.fromkeys(keys))
        self.entropy = whole_number("`entropy`", entropy)
        self.progress = progress or NullProgress()
        self.worlds = Worlds(self.task, self.entropy, threads)
        where = None if folder is None else Path(folder)
        self._parts = Parts(where, self.task, self.runs, self.selection, self.entropy)

    def expected_work(self, detectors: Iterable[Any]) -> float:
        """Work that is left for some detectors, roughly.

        Parameters
        ----------
        detectors : iterable
            As of `evaluate_detector`.

        Returns
        -------
        float
            As `progress` is given it.
        """
        defences = self.worlds.defences(detectors)
        left = (self._parts.open(family, defences) for family in self.families)
        work = sum(
            self._work(family, group)
            for family, open_ in zip(self.families, left, strict=True)
            for group in sharing(open_, family)
        )
        return work + len(self._parts.open(None, defences)) * self.runs

    def _work(self, family: AttackFamily, group: Sequence[Defence]) -> float:
        plays = expected_plays(len(self.worlds.members(family)), self.selection, self.runs, ROUNDS)
        return plays * (1.0 + 0.25 * (len(group) - 1))

    def scores(self, detectors: Iterable[Any]) -> list[DetectorScore]:
        """Score detectors.

        Parameters
        ----------
        detectors : iterable
            As of `evaluate_detector`.

        Returns
        -------
        list of DetectorScore
            In their order; paired with one another.
        """
        defences = self.worlds.defences(detectors)
        found: dict[str, list[FamilyScore]] = {each.entry.label: [] for each in defences}
        for family in self.families:
            protections = self._family(family, defences)
            limit = self.task.alert_limit_m
            for label, protection in protections.items():
                score = FamilyScore(family.key, family.held_out, limit, protection)
                found[label].append(score)
        alarms = self._false_alarms(defences)
        return [
            DetectorScore(
                task=self.task.key,
                detector=label,
                alert_limit_m=self.task.alert_limit_m,
                runs=self.runs,
                selection_runs=self.selection.runs,
                entropy=self.entropy,
                families=tuple(families),
                false_alarms=alarms[label],
                window_s=self.worlds.world.setup.window_s,
            )
            for label, families in found.items()
        ]

    def _family(self, family: AttackFamily, defences: Sequence[Defence]) -> dict[str, Protection]:
        found = {}
        for each in defences:
            text = self._parts.kept(family, each)
            if text is not None:
                found[each.entry.label] = Protection.from_text(text)
        for group in sharing(self._parts.open(family, defences), family):
            found |= self._searched(family, group)
        return found

    def _searched(self, family: AttackFamily, group: Sequence[Defence]) -> dict[str, Protection]:
        """Search for the worst attacks on detectors that share their runs, and score them."""
        names = ", ".join(each.entry.label for each in group[:3]) + (" ..." * (len(group) > 3))
        work = self._work(family, group)
        left = RemainingWork(self.progress, work, f"{self.task.key}, {family.key}: {names}")
        left.tick(0.0)
        members, limit = self.worlds.members(family), self.task.alert_limit_m
        antenna = ANTENNA_PARTS[0] * limit, ANTENNA_PARTS[1] * limit
        panel = self.worlds.panel(family, group, "selection", self.selection.runs)
        context = spoofer_context(panel.setup)
        looked = Played(panel, members, left.tick)
        searches = (
            FamilySearch(looked, k, context, self.selection, antenna) for k in range(len(group))
        )
        chosen = [search.winners([limit]) for search in searches]
        panel = self.worlds.panel(family, group, "evaluation", self.runs)
        scored = Played(panel, members, left.tick)
        found = {}
        for k, (each, aims) in enumerate(zip(group, chosen, strict=True)):
            winners = tuple(
                winner_of(members[m], value, sought, {MEASURES[0]: scored(m, value, self.runs)[k]})
                for (m, value), sought in aims.items()
            )
            head = self._parts.head(family, each)
            protection = Protection(head, winners, panel.counts[:, k], panel.sky, None)
            self._parts.keep(family, each, protection.to_text())
            found[each.entry.label] = protection
        left.end()
        return found

    def _false_alarms(self, defences: Sequence[Defence]) -> dict[str, dict[str, NDArray[np.bool_]]]:
        """Alarms of every detector in runs without an attack, with an event and without."""
        found = {}
        for each in defences:
            text = self._parts.kept(None, each)
            if text is not None:
                found[each.entry.label] = false_alarms_of(text)
        for group in sharing(self._parts.open(None, defences), None):
            clean = self.worlds.panel(None, group, "evaluation", self.runs)
            alarms = {
                WINDOW: clean.twin_alarm > 0,
                CLEAN: clean.warmup_alarm | (clean.twin_alarm > 0),
            }
            for event in EVENTS:
                panel = self.worlds.with_event(event, group, self.runs)
                alarms[event] = panel.warmup_alarm | (panel.twin_alarm > 0)
            for k, each in enumerate(group):
                own = {name: alarmed[:, k] for name, alarmed in alarms.items()}
                self._parts.keep(None, each, false_alarms_text(self._parts.head(None, each), own))
                found[each.entry.label] = own
                self.progress.advance(self.runs, f"{self.task.key}: false alarms")
        return found


def evaluate_detector(
    detector: Any,
    task: str | DetectorTask = "D1",
    *,
    runs: int = RUNS,
    selection_runs: int = SELECTION_RUNS,
    families: Sequence[str] | None = None,
    entropy: int = 0,
    threads: int | None = None,
    progress: ProgressCallback | None = None,
    folder: str | os.PathLike[str] | None = None,
) -> DetectorScore:
    """Score a detector by the worst family of attacks of a task, on runs that decided nothing.

    The score is P(HMI | attack): how often the error that an attack induces exceeds the alert limit
    with no alarm up to the time to alert after it, over the runs that are silent before the onset
    and without an attack; the largest over the families.  Each family's attacks are chosen against
    this detector.  Its false alarms are given with it.

    Parameters
    ----------
    detector : str, mapping or Detector
        As `make_detector` takes it, at 0.2 false alarms an hour where it asks for nothing; the
        thresholds are those of the task's world everywhere.
    task : str or DetectorTask
        ``"D1"`` to ``"D4"``, or one of your own.
    runs, selection_runs, families, entropy, threads, progress, folder : optional
        As in `DetectorEvaluator`.

    Returns
    -------
    DetectorScore
        Of the evaluation runs.

    Raises
    ------
    ValueError
        When the detector is not calibrated for the task's world; the message has the command that
        does so; and as in `DetectorEvaluator`.

    Examples
    --------
    >>> import spoofgym
    >>> score = spoofgym.evaluate_detector("never", "D1", runs=4, selection_runs=4,
    ...                                    families=["dashes"])
    >>> score.worst.family, score.p_hmi.value
    ('dashes', 1.0)
    """
    judge = DetectorEvaluator(
        task,
        runs=runs,
        selection_runs=selection_runs,
        families=families,
        entropy=entropy,
        threads=threads,
        progress=progress,
        folder=folder,
    )
    return judge.scores([detector])[0]
