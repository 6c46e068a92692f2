"""Score of any detector in a task of its own: the worst family of attacks, and false alarms.

Each family's attacks are looked for on runs of the split `selection`, against that detector, and
the ones found play the evaluation runs, which have decided nothing.  Finished parts are kept in a
folder, one file for a detector and a family, so that a killed process goes on from there.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._describe import describe, digest_of, outside_sources
from .._files import write_file
from .._registry import whole_number
from ..attacks import make_attack
from ..detector_tasks import (
    ANTENNA_PARTS,
    CANDIDATES,
    EVENTS,
    AttackFamily,
    DetectorTask,
    detector_task_of,
)
from ..detectors import Calibrated, Detector, PooledDetector
from ..detectors.calibrated import resolve
from ..envs.spoofer_binding import spoofer_context
from ..simulators.clean_runs import Progress, Silent, weighs
from ..simulators.setup import Setup
from ..spoofers import SpooferContext
from .attack_suite import Member, fitting_members
from .campaign import Left
from .comparisons import CONTROLS
from .detector_runs import NearAlarm, Panel, generators, in_any_world, numbers_of
from .detector_score import (
    CLEAN,
    WINDOW,
    DetectorScore,
    FamilyScore,
    false_alarms_of,
    false_alarms_text,
)
from .entries import TUNED, Entry, check_labels, detector_entry, fitted, refuse_oracles
from .entries import spoofer_entry as entry_of_spoofer
from .protection import MEASURES, Protection, Search, Winner, expected_plays
from .searches import Selection, log_spaced
from .specs import Spec, make_judge, slug
from .suite import Suite, versions

FloatArray = NDArray[np.float64]
RUNS, SELECTION_RUNS = 400, 96
"""Evaluation runs of every family, and runs that its attacks are chosen on."""
SIFTED = 4
"""Part of the selection that sifts, as one in so many."""
FINE = (-0.5, -0.33, -0.16, 0.16, 0.33, 0.5)
"""Steps around the best of the values that sift: what just passes an alert limit is a narrow range
of settings, and between two values of the grid a displacement grows by more than half."""
SHIPPED = ("ewma-profile", "snapshot-chi2-profile")
"""Profiles of the letter c."""
KEPT_PANELS = 24
"""Panels that are held in memory, the youngest ones."""
IDLE: Spec = {"name": "profile", "rates_mps": [0.0, 0.0]}
"""A spoofer that commands nothing, and transmits."""


@dataclass(frozen=True)
class AntennaEntry(Entry):
    """A meaconer whose antenna's distance is looked for; its settings are those of the attack."""

    def with_value(self, value: float) -> Spec:
        """Meaconer with its antenna so far to the east [m]."""
        return {**self.spec, str(self.tuned): [0.0, value, 0.0]}


class Defence(NamedTuple):
    """A detector with its thresholds, and whether it shares passes of the engine."""

    entry: Entry
    judge: Detector
    passive: bool


class Played:
    """Displacements of a panel's detectors by member, value and number of runs, each played once.

    What one detector's search has played is there for the others.
    """

    def __init__(self, panel: Panel, members: Sequence[Member], tick: Callable[[float], None]):
        self.panel, self.members, self.tick = panel, members, tick
        self._found: dict[tuple[int, float, int], FloatArray] = {}

    def __call__(self, member: int, value: float, runs: int) -> FloatArray:
        """(D, R') [m]."""
        key = member, value, runs
        if key not in self._found:
            entry = self.members[member].entry
            spec, attack = entry.with_value(value), None
            if isinstance(entry, AntennaEntry):
                spec, attack = IDLE, make_attack(spec)
            self._found[key] = self.panel.displacement(spec, runs, attack)
            self.tick(runs)
        return self._found[key]


class FamilySearch(Search):
    """The search for the worst attacks of a family on one detector of a panel."""

    by_skies = False
    neighbours = FINE

    def __init__(
        self,
        played: Played,
        number: int,
        context: SpooferContext,
        settings: Selection,
        antenna_m: tuple[float, float],
    ) -> None:
        panel = played.panel
        super().__init__(panel.start, panel.clean, played.members, context, settings)
        self.counts, self.sky = panel.counts[:, number], panel.sky
        self._played, self._number, self._antenna_m = played, number, antenna_m

    def _grid(self, member: Member) -> list[float]:
        if isinstance(member.entry, AntennaEntry):
            return log_spaced(*self._antenna_m, self.settings.values)
        return super()._grid(member)

    def _play(self, member: int, value: float, runs: int) -> dict[str, FloatArray]:
        return {MEASURES[0]: self._played(member, value, runs)[self._number]}


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
    progress : Progress, optional
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
        progress: Progress | None = None,
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
        self.entropy, self.threads = whole_number("`entropy`", entropy), threads
        self.progress = progress or Silent()
        self.folder = None if folder is None else Path(folder)
        self._suites: dict[str, Suite] = {}
        self._panels: dict[Any, Panel] = {}

    # --- worlds --------------------------------------------------------------------------------

    @cached_property
    def suite(self) -> Suite:
        """The task's world, without anybody in it."""
        return self.suite_of(["never"])

    def suite_of(self, detectors: Sequence[Any]) -> Suite:
        """Suite of the task's world with some detectors, which `calibrate_suite` takes.

        Parameters
        ----------
        detectors : sequence
            As of `evaluate_detector`.

        Returns
        -------
        Suite
            Nobody plays in it.
        """
        return Suite(**self.world_kwargs, detectors=detectors, spoofers=[])

    @property
    def world_kwargs(self) -> dict[str, Any]:
        """Settings of the world; a copy."""
        return self.task.world_kwargs

    def setup(self, **overrides: Any) -> Setup:
        """World of a family, or with an event, without a defence."""
        key = digest_of(describe(overrides))
        if key not in self._suites:
            settings = {**self.world_kwargs, **overrides}
            self._suites[key] = Suite(**settings, detectors=["never"], spoofers=[])
        return self._suites[key].world

    # --- detectors -----------------------------------------------------------------------------

    def defences(self, detectors: Iterable[Any]) -> list[Defence]:
        """Detectors with their thresholds of the task's world.

        Parameters
        ----------
        detectors : iterable
            As of `evaluate_detector`.

        Returns
        -------
        list of Defence
            In their order.
        """
        specs = list(detectors)
        if not specs:
            raise ValueError("no detector is given")
        entries = tuple(map(detector_entry, specs))
        check_labels(entries)
        refuse_oracles(entries)
        world, found = self.suite.world, []
        for entry, spec in zip(entries, specs, strict=True):
            judge = make_judge(spec)
            resolve(judge, world)
            settled = in_any_world(judge)
            alone = entry.spec["name"] in CONTROLS or weighs(world, settled)
            found.append(Defence(entry, settled, not alone))
        return found

    def _together(
        self, defences: Sequence[Defence], family: AttackFamily | None
    ) -> list[list[Defence]]:
        """Groups of detectors that share their passes."""
        alone = family is not None and ("e" in family.letters or family.onset == "chance-alarm")
        shared = [each for each in defences if each.passive and not alone]
        others = [[each] for each in defences if each not in shared]
        return [*([shared] if shared else []), *others]

    # --- runs ----------------------------------------------------------------------------------

    def _panel(
        self, family: AttackFamily | None, group: Sequence[Defence], split: str, runs: int
    ) -> Panel:
        """Runs of a split at their onsets, for detectors that share them."""
        overrides = {} if family is None else family.overrides
        onset = None if family is None else family.onset
        labels = tuple(each.entry.label for each in group)
        key = digest_of(describe({"of": overrides, "onset": onset})), labels, split, runs
        if key not in self._panels:
            while len(self._panels) >= KEPT_PANELS:  # families in the same world share theirs
                del self._panels[next(iter(self._panels))]
            setup, judges = self.setup(**overrides), [each.judge for each in group]
            near = onset == "chance-alarm"
            asked = (CANDIDATES if near else 1) * runs
            numbers = numbers_of(setup, self.entropy, split, asked, None if near else onset)

            def rngs() -> list[np.random.Generator]:
                return generators(setup, self.entropy, split, numbers)

            threads = self.threads
            self._panels[key] = (
                NearAlarm(setup, judges[0], rngs, threads)
                if near
                else Panel(setup, judges, rngs, threads)
            )
        return self._panels[key]

    def members(self, family: AttackFamily) -> tuple[Member, ...]:
        """Attacks of a family.

        Parameters
        ----------
        family : AttackFamily
            Of the task.

        Returns
        -------
        tuple of Member
            Each has one setting that is looked for.
        """
        found: list[Member] = []
        if family.letters == "m":
            spec = {**(family.attack or {}), "antenna_m": TUNED}
            return (Member("m", AntennaEntry("meaconer", spec), False),)
        setup = self.setup(**family.overrides)
        for member in fitting_members(setup, spoofer_context(setup)):
            if member.letter in family.letters:
                found.append(member)
        if "c" in family.letters:
            found += [Member("c", entry_of_spoofer(fitted(name)), False) for name in SHIPPED]
        return tuple(found)

    # --- scores --------------------------------------------------------------------------------

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
        defences = self.defences(detectors)
        left = (self._open(family, defences) for family in self.families)
        work = sum(
            self._work(family, group)
            for family, open_ in zip(self.families, left, strict=True)
            for group in self._together(open_, family)
        )
        return work + len(self._open(None, defences)) * self.runs

    def _work(self, family: AttackFamily, group: Sequence[Defence]) -> float:
        plays = expected_plays(len(self.members(family)), self.selection, self.runs)
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
        defences = self.defences(detectors)
        found: dict[str, list[FamilyScore]] = {each.entry.label: [] for each in defences}
        for family in self.families:
            protections = self._family(family, defences)
            for label, protection in protections.items():
                score = FamilyScore(
                    family.key, family.held_out, self.task.alert_limit_m, protection
                )
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
                window_s=self.suite.world.window_s,
            )
            for label, families in found.items()
        ]

    def _family(self, family: AttackFamily, defences: Sequence[Defence]) -> dict[str, Protection]:
        """The worst attacks of a family on every detector."""
        found = {}
        for each in defences:
            text = self._kept(family, each)
            if text is not None:
                found[each.entry.label] = Protection.from_text(text)
        for group in self._together(self._open(family, defences), family):
            found |= self._searched(family, group)
        return found

    def _searched(self, family: AttackFamily, group: Sequence[Defence]) -> dict[str, Protection]:
        """Search for the worst attacks on detectors that share their runs, and score them."""
        names = ", ".join(each.entry.label for each in group[:3]) + (" ..." * (len(group) > 3))
        work = self._work(family, group)
        left = Left(self.progress, work, f"{self.task.key}, {family.key}: {names}")
        left.tick(0.0)
        members, limit = self.members(family), self.task.alert_limit_m
        antenna = tuple(part * limit for part in ANTENNA_PARTS)
        panel = self._panel(family, group, "selection", self.selection.runs)
        context = spoofer_context(panel.setup)
        looked = Played(panel, members, left.tick)
        chosen = [
            FamilySearch(looked, k, context, self.selection, (antenna[0], antenna[1])).winners(
                [limit]
            )
            for k in range(len(group))
        ]
        panel = self._panel(family, group, "evaluation", self.runs)
        scored = Played(panel, members, left.tick)
        found = {}
        for k, (each, aims) in enumerate(zip(group, chosen, strict=True)):
            winners = tuple(
                Winner(
                    letter=members[m].letter,
                    spoofer=members[m].entry.label,
                    setting=str(members[m].entry.tuned),
                    value=value,
                    spec=members[m].entry.with_value(value),
                    aims=tuple(sought),
                    displacement={MEASURES[0]: scored(m, value, self.runs)[k]},
                )
                for (m, value), sought in aims.items()
            )
            head = self._head(family, each)
            protection = Protection(head, winners, panel.counts[:, k], panel.sky, None)
            self._keep(family, each, protection.to_text())
            found[each.entry.label] = protection
        left.end()
        return found

    def _false_alarms(self, defences: Sequence[Defence]) -> dict[str, dict[str, NDArray[np.bool_]]]:
        """Alarms of every detector in runs without an attack, with an event and without."""
        found = {}
        for each in defences:
            text = self._kept(None, each)
            if text is not None:
                found[each.entry.label] = false_alarms_of(text)
        for group in self._together(self._open(None, defences), None):
            clean = self._panel(None, group, "evaluation", self.runs)
            alarms = {
                WINDOW: clean.twin_alarm > 0,
                CLEAN: clean.warmup_alarm | (clean.twin_alarm > 0),
            }
            for event in EVENTS:
                panel = self._with_event(event, group)
                alarms[event] = panel.warmup_alarm | (panel.twin_alarm > 0)
            for k, each in enumerate(group):
                own = {name: alarmed[:, k] for name, alarmed in alarms.items()}
                self._keep(None, each, false_alarms_text(self._head(None, each), own))
                found[each.entry.label] = own
                self.progress.advance(self.runs, f"{self.task.key}: false alarms")
        return found

    def _with_event(self, event: str, group: Sequence[Defence]) -> Panel:
        """The clean evaluation runs, all of them with an event; the noise is the same."""
        domain = {**self.world_kwargs["domain"], "events": {event: 1.0}}
        setup, numbers = self.setup(domain=domain), np.arange(self.runs)
        judges = [each.judge for each in group]
        return Panel(
            setup,
            judges,
            lambda: generators(setup, self.entropy, "evaluation", numbers),
            self.threads,
        )

    # --- what is kept --------------------------------------------------------------------------

    @cached_property
    def _versions(self) -> dict[str, str]:
        return versions()

    def _head(self, family: AttackFamily | None, defence: Defence) -> dict[str, Any]:
        """What a part depends on, JSON-able."""
        judge = defence.judge
        parts = judge.judges if isinstance(judge, PooledDetector) else (judge,)
        scales = [each.scale for each in parts if isinstance(each, Calibrated)]
        return {
            "detector": defence.entry.label,
            "task": self.task.key,
            "family": None if family is None else dataclasses.asdict(family),
            "world": describe(self.world_kwargs),
            "alert_limit_m": self.task.alert_limit_m,
            "detector_settings": defence.entry.spec,
            "scales": scales,
            "outside": outside_sources(judge),
            "runs": self.runs,
            "selection": dataclasses.asdict(self.selection),
            "entropy": self.entropy,
            "versions": self._versions,
        }

    def _path(self, family: AttackFamily | None, defence: Defence) -> Path | None:
        """File of a part, named by all that it depends on; None where nothing is kept."""
        head = self._head(family, defence)
        if self.folder is None or None in head["outside"].values():
            return None
        name = "false-alarms" if family is None else family.key
        file = f"{slug(defence.entry.label)}--{name}--{digest_of(head)}.json"
        return self.folder / self.task.key / file

    def _kept(self, family: AttackFamily | None, defence: Defence) -> str | None:
        path = self._path(family, defence)
        return path.read_text(encoding="utf-8") if path is not None and path.is_file() else None

    def _keep(self, family: AttackFamily | None, defence: Defence, text: str) -> None:
        path = self._path(family, defence)
        if path is not None:
            write_file(path, text.encode())

    def _open(self, family: AttackFamily | None, defences: Sequence[Defence]) -> list[Defence]:
        """Detectors whose part is not finished."""
        paths = ((each, self._path(family, each)) for each in defences)
        return [each for each, path in paths if path is None or not path.is_file()]


def evaluate_detector(
    detector: Any,
    task: str | DetectorTask = "D1",
    *,
    runs: int = RUNS,
    selection_runs: int = SELECTION_RUNS,
    families: Sequence[str] | None = None,
    entropy: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
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
