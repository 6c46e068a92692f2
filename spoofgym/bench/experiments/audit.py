"""Audit of any detector: calibration, the worst family of attacks, false alarms, limits, ages.

Each family's attacks are looked for on runs of the split `selection`, against that detector, and
the ones found play the evaluation runs, which have decided nothing.
"""

from __future__ import annotations

import json
import os
import secrets
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...calibration.thresholds import PASSIVE_RUNS, WEIGHING_RUNS
from ...core.files import write_file
from ...core.progress import ProgressBar
from ...core.registry import check_choice, slug, whole_number
from ...core.settings import compute_digest, describe, outside_sources
from ...detectors import Detector, LearnedDetector, detector_in_world
from ...detectors.build import bare_detector
from ...detectors.calibrated import calibrated_parts, list_factors, resolve_thresholds, unwrap
from ...detectors.isolated import isolate
from ...envs.context import spoofer_context
from ...receiver.log import InnovationLog
from ...simulation.setup import Setup
from ...simulation.simulator import weighs
from ...tasks import (
    ANTENNA_PARTS,
    CANDIDATES,
    DETECTOR_TASKS,
    EVENTS,
    AttackFamily,
    DetectorTask,
    get_detector_task,
)
from ..runs.panel import NearAlarm, Panel, generators, in_any_world, play_searches, select_runs
from ..runs.play import Runs, WarmStart, play
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
from ..runs.record import MEASURES, Protection, Winner, record_runs
from ..runs.world import World
from ..scores.audit import TRANSFER, AgeProbe, Audit
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
from ..search.bounds import DisplacementBounds, expect_onset
from ..search.open_loop import AIMS, OpenLoopSearch, Optima
from .audit_sizes import (
    AGAIN,
    AGES,
    AGES_S,
    ALIKE,
    BUDGETS,
    FALSE_ALARMS,
    FLOOR,
    LIVE_AFTER_S,
    RAMPS,
    SEARCHED,
    AuditBudget,
)
from .calibration import calibrate_players
from .log_audit import LogAuditor
from .runner import Context, Experiment, run_experiment
from .store import Cell, MemoryStore, Reader, Result, Store
from .suite import DETECTOR_FILE, stored_cards
from .training_attacks import QUIET_TASKS

SIFTED = 4
"""Part of the selection that sifts, as one in so many."""
SHIPPED = ("ewma-profile", "snapshot-chi2-profile")
"""Profiles of the letter c."""
SEARCH_PLAYS = 4000.0
"""Runs that take about as long as a search for profiles."""
CACHED_PANELS = 24
"""Panels that are held in memory, the youngest ones."""
NEAR_ALARM = "chance-alarm"
"""Onset of which every detector has its own runs."""
ENTROPY = "entropy"
"""File of a folder: the entropy that was drawn for its runs."""
TIMED, TIMED_EPOCHS = 64, 40
"""Receivers and epochs by which a detector's time is measured."""
FLOOR_PLAYS = 500.0
"""Runs that take about as long as a world of the floor."""
OVERHEAD = 4.0
"""Time of an audit, in parts of that of its attacks from the onset on."""


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
    inner = unwrap(judge)
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

    def start_at_ages(self, judge: Detector, runs: int, ages: int, youngest: int = 0) -> WarmStart:
        """The same runs at each of the first ages in front of a detector, those of the first age
        first; `youngest`: so many of the first age alone. All at their onset where a task draws no
        ages."""
        settings, given = self.task.world_kwargs, None
        changed, times = {}, AGES_S[:ages]
        if "age_s" in settings["domain"]:
            changed["domain"] = {**settings["domain"], "age_s": [times[0], times[-1]]}
            phases = {"warmup_s": times[0], "live_s": times[0] - LIVE_AFTER_S}
            changed["timeline"] = {**settings["timeline"], **phases}
            given = {"age_s": np.repeat(times, runs)[: youngest or None]}
        setup = self.setup(**changed).copy_with(detector=in_any_world(judge))
        numbers = np.tile(np.arange(runs), ages if given else 1)[: youngest or None]
        rngs = generators(setup, self.entropy, "evaluation", numbers)
        return WarmStart(setup, rngs, threads=self.threads, given=given)

    def probe_ages(self, judge: Detector, size: AuditBudget) -> AgeProbe:
        """Play the same ramps at several ages, and the youngest runs twice."""
        start, limit = self.start_at_ages(judge, size.twins, size.ages), self.task.alert_limit_m
        clean, setup = play(start, "none"), start.setup
        most, attack_s = spoofer_context(setup).rate_limit_mps, setup.steps * setup.interval_s
        rates = [min(part * limit / attack_s, most) for part in RAMPS]
        ramps = [play(start, {"name": "ramp", "rate_mps": rate}) for rate in rates]
        early = start.warmup_alarm
        each = [record_runs(setup, {}, early, runs, clean, limit).records for runs in ramps]
        found = {name: np.array([records[name] for records in each]) for name in each[0]}
        first, crossing = found["first_alarm"], found["crossing"]
        late = (first == 0) | (first > crossing + setup.hold)
        judged = start.simulator.verdict
        threshold = np.full(start.receivers, np.nan)
        if judged is not None:
            threshold = judged.threshold.mean(axis=1)

        def by_age(values: NDArray[Any]) -> NDArray[Any]:
            return values.reshape(*values.shape[:-1], -1, size.twins)

        counts = ~early & (clean.first_alarm == 0)
        again = self.start_at_ages(judge, size.twins, size.ages, min(AGAIN, size.twins))
        return AgeProbe(
            age_s=np.round(by_age(start.simulator.ages * setup.interval_s).mean(axis=1), 3),
            rate_mps=np.array(rates),
            counts=by_age(counts),
            found=by_age(first > 0),
            crossed=by_age(crossing > 0),
            missed=by_age((crossing > 0) & late),
            displacement=by_age(found[MEASURES[0]]),
            threshold=by_age(threshold).mean(axis=1),
            sky=by_age(found["sky"][0])[0],
            alike=np.array(_compare_twice(start, clean, again)),
        )

    def measure_cost(self, judge: Detector, ages: int) -> tuple[float, float]:
        """Time of a processor that a detector takes for an epoch of a receiver, and the whole
        simulation [us]."""
        simulator = self.start_at_ages(judge, TIMED, ages, TIMED).engine().simulator
        spent, begun = 0.0, time.process_time()
        for _ in range(TIMED_EPOCHS):
            simulator.advance()
            now = time.process_time()
            verdict = simulator.judge()
            spent += time.process_time() - now
            simulator.update(verdict.weights)
        scale = 1e6 / (TIMED * TIMED_EPOCHS)
        return scale * spent, scale * (time.process_time() - begun)

    def search_open_loop(
        self, detector: ScoredDetector, settings: OpenLoopSearch, tick: Callable[[float], None]
    ) -> tuple[tuple[SuiteAttack, ...], dict[str, Any]]:
        """Best profiles that a search finds against a detector, for each of its aims; and the
        zero-alarm bound."""
        bounds = DisplacementBounds(self.world, [detector.player], self.entropy, BUDGET)
        limit = self.task.alert_limit_m
        optima = Optima(
            bounds, Tuning(), threads=self.threads, alert_limit_m=limit, settings=settings
        )
        spoofer = specify_spoofer(add_tuned_setting({"name": "open-loop"}))
        found = optima.find(detector.player, spoofer, tick)["aims"]
        curves = {tuple(each["rates_mps"]) for each in found.values()}
        attacks = tuple(SuiteAttack("c", with_rates(spoofer, [*x])) for x in sorted(curves))
        return attacks, bounds.zero_alarm(detector.player).as_json()

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


def _compare_twice(start: WarmStart, clean: Runs, again: WarmStart) -> bool:
    """Whether a detector says the same of the same epochs in a smaller batch."""
    few, twin = again.receivers, play(again, "none")
    same = np.array_equal(twin.first_alarm, clean.first_alarm[:few])
    same &= np.array_equal(again.warmup_alarm, start.warmup_alarm[:few])
    return bool(same and np.allclose(twin.peak, clean.peak[:few], rtol=ALIKE, equal_nan=True))


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

    Its arguments are those of `audit`, but for the detector.
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


@dataclass(frozen=True)
class AuditCells(Experiment):
    """Worst attacks of every family on every detector, its false alarms, what it finds at several
    ages, and the floor. `scores_only`: without the last two.

    Detectors that only look share the passes of a family.
    """

    name: ClassVar[str] = "audit"
    of: Auditor
    detectors: Sequence[ScoredDetector]
    scores_only: bool = False

    @property
    def config(self) -> dict[str, Any]:
        """The task; numbers of runs are of the cells."""
        task = self.of.task
        world = describe(task.world_kwargs)
        return {"task": task.key, "world": world, "alert_limit_m": task.alert_limit_m}

    @cached_property
    def card(self) -> dict[str, Any]:
        """What is stored of the task for spoofers that has the same world."""
        known = self.of.task.key in DETECTOR_TASKS
        return stored_cards().get(self.of.task.task.key, {}) if known else {}

    @cached_property
    def parts(self) -> dict[str, tuple[Cell, AttackFamily | str, ScoredDetector]]:
        """Cells by key, each with its family, or what it is in place of one, and its defence."""
        found, passive = {}, sum(each.passive for each in self.detectors)
        for part in (*self.of.families, FALSE_ALARMS, *(() if self.scores_only else (AGES,))):
            plays, shared = self._expect_plays(part), part != AGES
            if isinstance(part, AttackFamily):
                shared = part.onset != NEAR_ALARM
            name = part if isinstance(part, str) else part.key
            for each in self.detectors:
                shares = shared and each.passive
                group = f"{name}: {f'{passive} detectors' if shares else each.player.label}"
                key, identity = self._identity(name, part, each)
                found[key] = Cell(key, identity, plays, group=group), part, each
        worlds = self.of.size.floor_worlds
        if not (self.scores_only or worlds == 0 or "floor_m" in self.card):
            named = {"worlds": worlds, "entropy": self.of.entropy, "rate": self.requested_per_hour}
            key = f"{FLOOR} {compute_digest(named)[:8]}"
            work = FLOOR_PLAYS * (worlds or self.of.worlds.world.setup.bounds.worlds)
            found[key] = Cell(key, named, work, group=FLOOR), FLOOR, self.detectors[0]
        return found

    def _expect_plays(self, part: AttackFamily | str) -> float:
        size, runs = self.of.size, float(self.of.runs)
        if part == AGES:
            return float(size.twins * size.ages * (len(RAMPS) + 1))
        if isinstance(part, str):
            return runs * (1 + len(EVENTS))
        members = len(self.of.worlds.list_attacks(part))
        if SEARCHED in part.letters:
            members += len(AIMS) + len(self.card.get("optima_mps", {}))
        plays = expected_plays(members, self.of.selection, self.of.runs, ROUNDS)
        return plays + self.search_plays * (SEARCHED in part.letters)

    @property
    def search_plays(self) -> float:
        return SEARCH_PLAYS * self.of.size.search.generations / OpenLoopSearch().generations

    @property
    def requested_per_hour(self) -> float | None:
        """Rate of false alarms that the first detector is calibrated to."""
        parts = calibrated_parts(detector_in_world(self.detectors[0].player.fixed_spec))
        return max((x.false_alarms_per_hour or 0.0 for x in parts), default=0.0) or None

    def _identity(
        self, name: str, part: AttackFamily | str, defence: ScoredDetector
    ) -> tuple[str, dict[str, Any] | None]:
        """Key of a cell, and all that it depends on; None where no text says that."""
        key, outside = f"{name} {defence.player.label}", outside_sources(defence.judge)
        if None in outside.values():
            return key, None
        named: dict[str, Any] = {
            "family": part if isinstance(part, str) else asdict(part),
            "detector": [defence.player.spec, *list_factors(defence.judge)],
            "sources": outside,
            "runs": [self.of.runs, self.of.entropy],
            "selection": asdict(self.of.selection),
        }
        if part == AGES:
            named["runs"] = [self.of.size.twins, self.of.size.ages, self.of.entropy]
        elif isinstance(part, AttackFamily) and SEARCHED in part.letters:
            named["search"] = asdict(self.of.size.search)
        return f"{key} {compute_digest(named)[:8]}", named

    def cells(self) -> Iterator[Cell]:
        return (cell for cell, _, _ in self.parts.values())

    def run_group(
        self, cells: Sequence[Cell], results: Reader, context: Context
    ) -> Iterator[Result]:
        """Search against detectors that share their runs, and play what was found."""
        _, (part, *_), group = zip(*(self.parts[cell.key] for cell in cells), strict=True)
        worlds = self.of.worlds
        worlds.threads = context.threads
        if isinstance(part, AttackFamily):
            yield from self._play_family(part, group, context)
        elif part == FALSE_ALARMS:
            yield from self._false_alarms(group)
        elif part == AGES:
            for each in group:
                yield Result(worlds.probe_ages(each.judge, self.of.size)._asdict())
        else:
            few, entropy = self.of.size.floor_worlds, self.of.entropy
            bounds = DisplacementBounds(worlds.world, [group[0].player], entropy, floor_worlds=few)
            yield Result(record=bounds.compute_lower_limit())

    def _play_family(
        self, family: AttackFamily, group: Sequence[ScoredDetector], context: Context
    ) -> Iterator[Result]:
        worlds = self.of.worlds
        where = {"onset": family.onset, **self.of.task.get_overrides(family)}
        own: list[tuple[SuiteAttack, ...]] = [worlds.list_attacks(family)] * len(group)
        heads: list[dict[str, Any]] = [{"detector": each.player.label} for each in group]
        transfers: tuple[SuiteAttack, ...] = ()
        if SEARCHED in family.letters:
            share, transfers = self.search_plays / len(group), self._list_transfers()
            tick = lambda part: context.tick(share * part)  # noqa: E731
            for k, each in enumerate(group):
                curves, bound = worlds.search_open_loop(each, self.of.size.search, tick)
                own[k], heads[k]["zero_alarm"] = (*own[k], *curves), bound
        winners = self._find_worst(where, group, own, context)
        if transfers:  # apart, so that the best of both kinds are compared
            others = self._find_worst(where, group, [transfers] * len(group), context)
            winners = [(*mine, *theirs) for mine, theirs in zip(winners, others, strict=True)]
        panel = worlds.panel(group, "evaluation", self.of.runs, **where)
        for k, (head, worst) in enumerate(zip(heads, winners, strict=True)):
            found = Protection(head, worst, panel.counts[:, k], panel.sky, None)
            yield Result(*found.parts())

    def _find_worst(
        self,
        where: Mapping[str, Any],
        group: Sequence[ScoredDetector],
        own: Sequence[tuple[SuiteAttack, ...]],
        context: Context,
    ) -> list[tuple[Winner, ...]]:
        """The worst of each detector's attacks, chosen on the selection, on the evaluation runs."""
        worlds, limit, settings = self.of.worlds, self.of.task.alert_limit_m, self.of.selection
        panel = worlds.panel(group, "selection", settings.runs, **where)
        antenna = ANTENNA_PARTS[0] * limit, ANTENNA_PARTS[1] * limit
        searches = [
            FamilyAttacks(panel, k, attacks, settings, antenna_m=antenna)
            for k, attacks in enumerate(own)
        ]
        requests = [(each.number, each.winners([limit])) for each in searches]
        chosen = list(zip(searches, play_searches(panel, requests, context.tick), strict=True))
        panel = worlds.panel(group, "evaluation", self.of.runs, **where)
        return play_winners(panel, chosen, context.tick)

    def _list_transfers(self) -> tuple[SuiteAttack, ...]:
        """Profiles that are stored as found against other detectors in the task's world."""
        spoofer = specify_spoofer(add_tuned_setting({"name": "open-loop"}))
        stored = self.card.get("optima_mps", {}).values()
        return tuple(SuiteAttack(TRANSFER, with_rates(spoofer, rates)) for rates in stored)

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
        for key, (_, part, defence) in self.parts.items():
            label = defence.player.label
            if part == FALSE_ALARMS:
                alarms[label] = dict(results[key].arrays)
            elif isinstance(part, AttackFamily):
                found = results[key]
                worst = Protection.from_parts(found.arrays, found.record)
                families[label].append(FamilyScore(part.key, part.held_out, limit, worst))
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
        return self.conclude(results).as_dict()

    def conclude(self, results: Reader) -> Audit:
        """Audit of the first detector; the worst attacks are written beside its results."""
        parts = {part: key for key, (_, part, _) in self.parts.items() if isinstance(part, str)}
        limits = results[parts[FLOOR]].record if FLOOR in parts else self.card
        first, size = self.detectors[0], self.of.size
        found = Audit(
            score=self.scores(results)[0],
            title=self.of.task.title,
            budget=self.of.budget,
            requested_per_hour=self.requested_per_hour,
            probe=AgeProbe(**results[parts[AGES]].arrays),
            floor_m=limits.get("floor_m"),
            reference=self._find_reference(),
            cost_us=self.of.worlds.measure_cost(first.judge, size.ages)[0],
        )
        if self.of.folder is not None:
            for name, spec in found.attacks.items():
                path = self.of.folder / "attacks" / f"{slug(first.player.label)}-{name}.json"
                write_file(path, (json.dumps(spec) + "\n").encode())
        return found

    def _find_reference(self) -> dict[str, Any] | None:
        """Stored score of the best non-learned detector: in this task, or in the campaign of the
        task for spoofers."""
        if scored := stored_cards(DETECTOR_FILE).get(self.of.task.key):
            best, by = scored["best_classic"], "audit"
            row = next(each for each in scored["detectors"] if each["detector"] == best)
            exceeded = row["exceeded_m"]
        elif self.card:
            best, by = self.card["detector"], "campaign"
            exceeded = self.card["protection_m"][best]
        else:
            return None
        return {"detector": best, "by": by, "exceeded_m": exceeded}


def audit(
    detector: Any,
    task: str | DetectorTask = "D1",
    budget: str = "standard",
    *,
    runs: int | None = None,
    selection_runs: int | None = None,
    families: Sequence[str] | None = None,
    entropy: int | None = None,
    threads: int | None = None,
    progress: ProgressBar | None = None,
    folder: str | os.PathLike[str] | None = None,
    log: InnovationLog | str | os.PathLike[str] | None = None,
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
    runs, selection_runs : int, optional
        Evaluation runs of every family, which decide nothing, and runs that its attacks are chosen
        on; by default those of the budget.
    families : sequence of str, optional
        Keys of those that are played; by default all of the task.
    entropy : int, optional
        Seed of all of them.  By default it is drawn, so that a detector that plays known seeds
        itself gains nothing; a folder keeps that of its first audit.
    threads : int, optional
        Threads of the engine.
    progress : callable, optional
        Opens a bar, such as `spoofgym.core.progress.show_progress`.
    folder : path-like, optional
        Its folder of the task holds what is finished, and the worst attacks; a killed process goes
        on from there.
    log : InnovationLog or path-like, optional
        Log of a receiver, on whose clean windows it plays in place of a task; it has neither
        entropy nor numbers of runs, and thresholds are those of its own windows.

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
    sizes: Any = {"runs": runs, "selection_runs": selection_runs, "families": families}
    auditor: Auditor | LogAuditor = (
        Auditor(task, budget, **sizes, entropy=entropy, threads=threads, folder=folder)
        if log is None
        else LogAuditor(log, budget, families=families, threads=threads, folder=folder)
    )
    cells = auditor.prepare(detector, progress)
    store = MemoryStore(None if auditor.folder is None else Store(auditor.folder))
    return cells.conclude(run_experiment(cells, store, threads=threads, progress=progress))
