"""Score of any detector in a task of its own: the worst family of attacks, and false alarms.

Each family's attacks are looked for on runs of the split `selection`, against that detector, and
the ones found play the evaluation runs, which have decided nothing.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from ...core.progress import NullProgress, ProgressBar, ProgressCallback
from ...core.registry import whole_number
from ...core.settings import compute_digest, describe, outside_sources
from ...detectors import Calibrated, Detector, LearnedDetector, detector_in_world
from ...detectors.calibrated import list_factors, resolve_thresholds
from ...envs.context import spoofer_context
from ...simulation.setup import Setup
from ...simulation.simulator import weighs
from ...tasks import (
    ANTENNA_PARTS,
    CANDIDATES,
    EVENTS,
    AttackFamily,
    DetectorTask,
    get_detector_task,
)
from ..runs.panel import NearAlarm, Panel, generators, in_any_world, play_searches, select_runs
from ..runs.players import (
    ATTACK,
    TUNED,
    PlayerSpec,
    add_tuned_setting,
    check_labels,
    refuse_oracles,
    specify_detector,
    specify_spoofer,
)
from ..runs.record import Protection
from ..runs.world import World
from ..scores.detector import CLEAN, WINDOW, DetectorScore, FamilyScore
from ..scores.statistics import BUDGET
from ..search.amplitude import Tuning, with_rates
from ..search.attack_suite import (
    ROUNDS,
    FamilyAttacks,
    Selection,
    SuiteAttack,
    expected_plays,
    list_fitting_attacks,
    play_winners,
)
from ..search.bounds import DisplacementBounds
from ..search.open_loop import AIMS, Optima
from .runner import Context, Experiment, run_experiment
from .store import Cell, MemoryStore, Reader, Result, Store
from .training_attacks import QUIET_TASKS

RUNS, SELECTION_RUNS = 400, 96
"""Evaluation runs of every family, and runs that its attacks are chosen on."""
SIFTED = 4
"""Part of the selection that sifts, as one in so many."""
SHIPPED = ("ewma-profile", "snapshot-chi2-profile")
"""Profiles of the letter c."""
SEARCHED = "o"
"""Letter of a family whose profiles are looked for against each detector."""
SEARCH_PLAYS = 4000.0
"""Runs that take about as long as a search for profiles."""
CACHED_PANELS = 24
"""Panels that are held in memory, the youngest ones."""
NEAR_ALARM = "chance-alarm"
"""Onset of which every detector has its own runs."""


class ScoredDetector(NamedTuple):
    """A detector with its thresholds, and whether it shares passes of the engine."""

    player: PlayerSpec
    judge: Detector
    passive: bool


def specify_detectors(detectors: Iterable[Any]) -> tuple[PlayerSpec, ...]:
    """Detectors that may be scored together."""
    entries = tuple(map(specify_detector, detectors))
    if not entries:
        raise ValueError("no detector is given")
    check_labels(entries)
    refuse_oracles(entries)
    return entries


def find_trained_holdout(judge: Detector, task: DetectorTask) -> str | None:
    """Family that a task holds out, and that a detector has learned from, as its card has it."""
    inner = judge.detector if isinstance(judge, Calibrated) else judge
    training = inner.card.training if isinstance(inner, LearnedDetector) else {}
    if "held_out" not in training:  # not learned, or not from a data set of spoofgym
        return None
    met = "quiet" if training.get("task") in QUIET_TASKS else "inherited"
    return met if met in {family.key for family in task.held_out} else None


class Worlds:
    """Worlds of one task, with and without an attack, and runs in them at their onsets."""

    def __init__(self, task: DetectorTask, entropy: int, threads: int | None) -> None:
        self.task, self.entropy, self.threads = task, entropy, threads
        self._setups: dict[str, Setup] = {}
        self._panels: dict[Any, Panel] = {}

    @cached_property
    def world(self) -> World:
        return World(settings=self.task.world_kwargs)

    def setup(self, **overrides: Any) -> Setup:
        """World of a family, or with an event, without a defence."""
        key = compute_digest(describe(overrides))
        if key not in self._setups:
            self._setups[key] = self.world.copy_with(**overrides).setup
        return self._setups[key]

    def build_detectors(self, detectors: Iterable[Any]) -> list[ScoredDetector]:
        """Detectors with their thresholds of the task's world; warns of one that has learned from
        what the task holds out, as its card has it."""
        specs = list(detectors)
        entries, world, found = specify_detectors(specs), self.world.setup, []
        for entry, spec in zip(entries, specs, strict=True):
            judge = detector_in_world(spec)
            resolve_thresholds(judge, world)
            if met := find_trained_holdout(judge, self.task):
                warnings.warn(
                    f"{entry.label} has learned from {met} counterfeits, which {self.task.key} "
                    "holds out: its score is not that of a detector that has never met them",
                    UserWarning,
                    stacklevel=2,
                )
            settled = in_any_world(judge)
            found.append(ScoredDetector(entry, settled, not weighs(world, settled)))
        return found

    def panel(
        self,
        group: Sequence[ScoredDetector],
        split: str,
        runs: int,
        onset: str | None = None,
        **overrides: Any,
    ) -> Panel:
        """Runs of a split at their onsets, for detectors that share them, in an altered world."""
        # two files may have one label; a panel keeps its judges, and so their ids
        judged = tuple(id(each.judge) for each in group)
        key = compute_digest(describe({"of": overrides, "onset": onset})), judged, split, runs
        if key not in self._panels:
            while len(self._panels) >= CACHED_PANELS:  # families in the same world share theirs
                del self._panels[next(iter(self._panels))]
            setup, judges = self.setup(**overrides), [each.judge for each in group]
            near = onset == NEAR_ALARM
            count, condition = (CANDIDATES * runs, None) if near else (runs, onset)
            numbers = select_runs(setup, self.entropy, split, count, condition)
            rngs = lambda: generators(setup, self.entropy, split, numbers)  # noqa: E731
            self._panels[key] = (
                NearAlarm(setup, judges[0], rngs, self.threads)
                if near
                else Panel(setup, judges, rngs, self.threads)
            )
        return self._panels[key]

    def search_open_loop(
        self, detector: ScoredDetector, tick: Callable[[float], None]
    ) -> tuple[SuiteAttack, ...]:
        """Best profiles that a search finds against a detector, for each of its aims."""
        bounds = DisplacementBounds(self.world, [detector.player], self.entropy, BUDGET)
        limit = self.task.alert_limit_m
        optima = Optima(bounds, Tuning(), threads=self.threads, alert_limit_m=limit)
        spoofer = specify_spoofer(add_tuned_setting({"name": "open-loop"}))
        found = optima.find(detector.player, spoofer, tick)["aims"]
        curves = {tuple(each["rates_mps"]) for each in found.values()}
        return tuple(SuiteAttack("c", with_rates(spoofer, [*x])) for x in sorted(curves))

    def list_attacks(self, family: AttackFamily) -> tuple[SuiteAttack, ...]:
        """Attacks of a family, each with one setting that is looked for; none of one whose profiles
        are looked for, too."""
        if family.letters == "m":
            spec = {**(family.attack or {}), "antenna_m": TUNED}
            return (SuiteAttack("m", PlayerSpec("meaconer", ATTACK, spec, "antenna_m")),)
        setup = self.setup(**self.task.get_overrides(family))
        suite = list_fitting_attacks(setup, spoofer_context(setup))
        found = [member for member in suite if member.letter in family.letters]
        if "c" in family.letters:
            shipped = (specify_spoofer(add_tuned_setting(name)) for name in SHIPPED)
            found += [SuiteAttack("c", player) for player in shipped]
        return tuple(found)


class DetectorEvaluator:
    """Scores detectors of one task on the same runs; those that only look share their passes.

    Its arguments are those of `evaluate_detector`, but for the detector.
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
        self.task = get_detector_task(task) if isinstance(task, str) else task
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
        """Scores in the order of the detectors; `show` opens a bar in place of `progress`."""
        found = self.protections(detectors)
        store = MemoryStore(None if self.folder is None else Store(self.folder))
        show = show or (lambda _: nullcontext(self.progress))
        return found.scores(
            run_experiment(found, store, threads=self.worlds.threads, progress=show)
        )

    def protections(self, detectors: Iterable[Any]) -> Protections:
        return Protections(self, self.worlds.build_detectors(detectors))


@dataclass(frozen=True)
class Protections(Experiment):
    """Worst attacks of every family on every detector, and its false alarms.

    Detectors that only look share the passes of a family.
    """

    name: ClassVar[str] = "protect"
    of: DetectorEvaluator
    detectors: Sequence[ScoredDetector]

    @property
    def config(self) -> dict[str, Any]:
        """The task; numbers of runs are of the cells."""
        task = self.of.task
        world = describe(task.world_kwargs)
        return {"task": task.key, "world": world, "alert_limit_m": task.alert_limit_m}

    @cached_property
    def parts(self) -> dict[str, tuple[Cell, AttackFamily | None, ScoredDetector]]:
        """Cells by key, each with its family and defence; no family for false alarms."""
        found, passive = {}, sum(each.passive for each in self.detectors)
        for family in (*self.of.families, None):
            name, plays = "false alarms", float(self.of.runs)
            if family is not None:
                name, members = family.key, len(self.of.worlds.list_attacks(family))
                members += len(AIMS) * (SEARCHED in family.letters)
                plays = expected_plays(members, self.of.selection, self.of.runs, ROUNDS)
                plays += SEARCH_PLAYS * (SEARCHED in family.letters)
            for each in self.detectors:
                shared = each.passive and (family is None or family.onset != NEAR_ALARM)
                group = f"{name}: {f'{passive} detectors' if shared else each.player.label}"
                key, identity = self._identity(name, family, each)
                found[key] = Cell(key, identity, plays, group=group), family, each
        return found

    def _identity(
        self, name: str, family: AttackFamily | None, defence: ScoredDetector
    ) -> tuple[str, dict[str, Any] | None]:
        """Key of a cell, and all that it depends on; None where no text says that."""
        key, outside = f"{name} {defence.player.label}", outside_sources(defence.judge)
        if None in outside.values():
            return key, None
        named = {
            "family": None if family is None else asdict(family),
            "detector": [defence.player.spec, *list_factors(defence.judge)],
            "sources": outside,
            "runs": [self.of.runs, self.of.entropy],
            "selection": asdict(self.of.selection),
        }
        return f"{key} {compute_digest(named)[:8]}", named

    def cells(self) -> Iterator[Cell]:
        return (cell for cell, _, _ in self.parts.values())

    def run_group(
        self, cells: Sequence[Cell], results: Reader, context: Context
    ) -> Iterator[Result]:
        """Search against detectors that share their runs, and play what was found."""
        _, (family, *_), group = zip(*(self.parts[cell.key] for cell in cells), strict=True)
        worlds, limit, settings = self.of.worlds, self.of.task.alert_limit_m, self.of.selection
        worlds.threads = context.threads
        if family is None:
            yield from self._false_alarms(group)
            return
        where = {"onset": family.onset, **self.of.task.get_overrides(family)}
        panel = worlds.panel(group, "selection", settings.runs, **where)
        members = worlds.list_attacks(family)
        antenna = ANTENNA_PARTS[0] * limit, ANTENNA_PARTS[1] * limit
        own = [members] * len(group)
        if SEARCHED in family.letters:
            share = SEARCH_PLAYS / len(group)
            tick = lambda part: context.tick(share * part)  # noqa: E731
            own = [(*members, *worlds.search_open_loop(each, tick)) for each in group]
        searches = [
            FamilyAttacks(panel, k, attacks, settings, antenna_m=antenna)
            for k, attacks in enumerate(own)
        ]
        requests = [(each.number, each.winners([limit])) for each in searches]
        found = list(zip(searches, play_searches(panel, requests, context.tick), strict=True))
        panel = worlds.panel(group, "evaluation", self.of.runs, **where)
        for k, winners in enumerate(play_winners(panel, found, context.tick)):
            head = {"detector": group[k].player.label}
            worst = Protection(head, winners, panel.counts[:, k], panel.sky, None)
            yield Result(*worst.parts())

    def _false_alarms(self, group: Sequence[ScoredDetector]) -> Iterator[Result]:
        """Alarms of detectors in runs without an attack, with an event and without."""
        worlds, runs = self.of.worlds, (group, "evaluation", self.of.runs)
        clean = worlds.panel(*runs)
        alarms = {WINDOW: clean.twin_alarm > 0, CLEAN: clean.warmup_alarm | (clean.twin_alarm > 0)}
        for event in EVENTS:  # all runs have it; their noise is the same
            domain = {**self.of.task.world_kwargs["domain"], "events": {event: 1.0}}
            panel = worlds.panel(*runs, domain=domain)
            alarms[event] = panel.warmup_alarm | (panel.twin_alarm > 0)
        for k in range(len(group)):
            yield Result({name: alarmed[:, k] for name, alarmed in alarms.items()})

    def scores(self, results: Reader) -> list[DetectorScore]:
        task, limit = self.of.task, self.of.task.alert_limit_m
        families: dict[str, list[FamilyScore]] = {each.player.label: [] for each in self.detectors}
        alarms = {}
        for key, (_, family, defence) in self.parts.items():
            label, found = defence.player.label, results[key]
            if family is None:
                alarms[label] = dict(found.arrays)
            else:
                worst = Protection.from_parts(found.arrays, found.record)
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
        As `make_detector` takes it, at 0.2 false alarms an hour where it requests none; the
        thresholds are those of the task's world everywhere.
    task : str or DetectorTask
        ``"D1"`` to ``"D3"``, ``"v1/D1"`` to ``"v1/D4"``, or one of your own.
    runs, selection_runs : int
        Evaluation runs of every family, which decide nothing, and runs that its attacks are chosen
        on.
    families : sequence of str, optional
        Keys of those that are played; by default all of the task.
    entropy : int
        Seed of all of them.
    threads : int, optional
        Threads of the engine.
    progress : ProgressCallback, optional
        Shows how far it is.
    folder : path-like, optional
        Its folder of the task holds what is finished; a killed process goes on from there.

    Returns
    -------
    DetectorScore
        Of the evaluation runs.

    Raises
    ------
    ValueError
        When the detector is not calibrated for the task's world; the message has the command that
        does so; or when a task or a family is unknown, or a number is out of range.

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
