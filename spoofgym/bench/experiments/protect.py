"""Score of any detector in a task of its own: the worst family of attacks, and false alarms.

Each family's attacks are looked for on runs of the split `selection`, against that detector, and
the ones found play the evaluation runs, which have decided nothing.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from ...core.progress import NullProgress, ProgressBar, ProgressCallback
from ...core.registry import whole_number
from ...core.settings import describe, digest_of, outside_sources
from ...detectors.calibrated import factors_of
from ...tasks import ANTENNA_PARTS, EVENTS, AttackFamily, DetectorTask, detector_task_of
from ..runs.panel import play_searches
from ..runs.record import Protection
from ..scores.detector import CLEAN, WINDOW, DetectorScore, FamilyScore
from ..search.settings import Selection
from ..search.worst_attack import ROUNDS, FamilyAttacks, expected_plays, play_winners
from .runner import Context, Experiment, run
from .store import Cell, MemoryStore, Reader, Result, Store
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
        Shows how far it is.
    folder : path-like, optional
        Whose folder of the task has what is finished; a killed process goes on from there.

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
        self.folder = None if folder is None else Path(folder) / self.task.key

    def scores(
        self, detectors: Iterable[Any], *, show: ProgressBar | None = None
    ) -> list[DetectorScore]:
        """Score detectors.

        Parameters
        ----------
        detectors : iterable
            As of `evaluate_detector`.
        show : ProgressBar, optional
            Opens a bar in place of `progress`.

        Returns
        -------
        list of DetectorScore
            In their order; paired with one another.
        """
        found = self.protections(detectors)
        store = MemoryStore(None if self.folder is None else Store(self.folder))
        show = show or (lambda _: nullcontext(self.progress))
        return found.scores(run(found, store, threads=self.worlds.threads, progress=show))

    def protections(self, detectors: Iterable[Any]) -> Protections:
        """Experiment of the `scores`."""
        return Protections(self, self.worlds.defences(detectors))


@dataclass(frozen=True)
class Protections(Experiment):
    """Worst attacks of every family on every detector, and its false alarms.

    Detectors that only look share the passes of a family.
    """

    name: ClassVar[str] = "protect"
    of: DetectorEvaluator
    defences: Sequence[Defence]

    @property
    def config(self) -> dict[str, Any]:
        """The task; numbers of runs are of the cells."""
        task = self.of.task
        world = describe(task.world_kwargs)
        return {"task": task.key, "world": world, "alert_limit_m": task.alert_limit_m}

    @cached_property
    def parts(self) -> dict[str, tuple[Cell, AttackFamily | None, Defence]]:
        """Cells by key, of which family, and of whom; no family for false alarms."""
        found = {}
        for family in (*self.of.families, None):
            for group in sharing(self.defences, family):
                work = float(self.of.runs)
                if family is not None:
                    members, seeds = self.of.worlds.members(family), self.of.selection
                    plays = expected_plays(len(members), seeds, self.of.runs, ROUNDS)
                    work = plays * (0.75 + 0.25 * len(group)) / len(group)
                name = "false alarms" if family is None else family.key
                names = [each.entry.label for each in group]
                label = f"{name}: {', '.join([*names[:3], *(['...'] if names[3:] else [])])}"
                for each in group:
                    key, identity = self._identity(name, family, each)
                    found[key] = Cell(key, identity, work, group=label), family, each
        return found

    def _identity(
        self, name: str, family: AttackFamily | None, defence: Defence
    ) -> tuple[str, dict[str, Any] | None]:
        """Key of a cell, and all that it depends on; None where no text says that."""
        key, outside = f"{name} {defence.entry.label}", outside_sources(defence.judge)
        if None in outside.values():
            return key, None
        named = {
            "family": None if family is None else asdict(family),
            "detector": [defence.entry.spec, *factors_of(defence.judge)],
            "sources": outside,
            "runs": [self.of.runs, self.of.entropy],
            "selection": asdict(self.of.selection),
        }
        return f"{key} {digest_of(named)[:8]}", named

    def cells(self) -> Iterator[Cell]:
        """One for a detector and a family."""
        return (cell for cell, _, _ in self.parts.values())

    def run(self, cell: Cell, results: Reader, context: Context) -> Result:
        """Search against a detector alone."""
        return next(self.run_group([cell], results, context))

    def run_group(
        self, cells: Sequence[Cell], results: Reader, context: Context
    ) -> Iterator[Result]:
        """Search against detectors that share their runs."""
        _, (family, *_), group = zip(*(self.parts[cell.key] for cell in cells), strict=True)
        self.of.worlds.threads = context.threads
        if family is None:
            return self._false_alarms(group)
        return self._searched(family, group, context.tick)

    def _searched(
        self, family: AttackFamily, group: Sequence[Defence], tick: Callable[[float], None]
    ) -> Iterator[Result]:
        """Search for the worst attacks on detectors, and let them play the evaluation runs."""
        worlds, limit, settings = self.of.worlds, self.of.task.alert_limit_m, self.of.selection
        antenna = ANTENNA_PARTS[0] * limit, ANTENNA_PARTS[1] * limit
        members = worlds.members(family)
        panel = worlds.panel(family, group, "selection", settings.runs)
        searches = [
            FamilyAttacks(panel, k, members, settings, antenna_m=antenna) for k in range(len(group))
        ]
        asked = [(each.number, each.winners([limit])) for each in searches]
        found = list(zip(searches, play_searches(panel, asked, tick), strict=True))
        panel = worlds.panel(family, group, "evaluation", self.of.runs)
        for k, winners in enumerate(play_winners(panel, found, tick)):
            head = {"detector": group[k].entry.label}
            worst = Protection(head, winners, panel.counts[:, k], panel.sky, None)
            yield Result(*worst.parts())

    def _false_alarms(self, group: Sequence[Defence]) -> Iterator[Result]:
        """Alarms of detectors in runs without an attack, with an event and without."""
        clean = self.of.worlds.panel(None, group, "evaluation", self.of.runs)
        window = clean.twin_alarm > 0
        alarms = {WINDOW: window, CLEAN: clean.warmup_alarm | window}
        for event in EVENTS:
            panel = self.of.worlds.with_event(event, group, self.of.runs)
            alarms[event] = panel.warmup_alarm | (panel.twin_alarm > 0)
        for k in range(len(group)):
            yield Result({name: alarmed[:, k] for name, alarmed in alarms.items()})

    def scores(self, results: Reader) -> list[DetectorScore]:
        """Scores in the order of the detectors."""
        task, limit = self.of.task, self.of.task.alert_limit_m
        families: dict[str, list[FamilyScore]] = {each.entry.label: [] for each in self.defences}
        alarms = {}
        for key, (_, family, defence) in self.parts.items():
            label, found = defence.entry.label, results[key]
            if family is None:
                alarms[label] = dict(found.arrays)
            else:
                worst = Protection.of_parts(found.arrays, found.record)
                families[label].append(FamilyScore(family.key, family.held_out, limit, worst))
        return [
            DetectorScore(
                task=task.key,
                detector=label,
                alert_limit_m=limit,
                runs=self.of.runs,
                selection_runs=self.of.selection.runs,
                entropy=self.of.entropy,
                families=tuple(each),
                false_alarms=alarms[label],
                window_s=self.of.worlds.world.setup.window_s,
            )
            for label, each in families.items()
        ]

    def report(self, results: Reader) -> dict[str, Any]:
        """Scores, and paired differences to the first detector."""
        scores = self.scores(results)
        rows = [{**x.as_dict(), "less_first": x.difference_to(scores[0]).as_json()} for x in scores]
        return {"detectors": rows}


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
