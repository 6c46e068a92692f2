"""Cells of an audit: the worst attack of every family, false alarms, ages and the floor."""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from ... import tasks
from ...core.children import release_free_memory
from ...core.files import check_writable, write_file
from ...core.reading import name_file, read_json
from ...core.registry import check_choice, slug, whole_number
from ...core.settings import compute_digest, describe, outside_sources
from ...detectors import detector_in_world
from ...detectors.calibrated import find_requested_rate, list_factors
from ..runs.panel import play_searches
from ..runs.players import add_tuned_setting, specify_spoofer
from ..runs.record import Protection, Winner
from ..scores.audit import TRANSFER, AgeProbe, Audit
from ..scores.detector import CLEAN, WINDOW, DetectorScore, FamilyScore
from ..search import attack_suite
from ..search.amplitude import with_rates
from ..search.bounds import DisplacementBounds, expect_onset
from ..search.open_loop import AIMS, OpenLoopSearch
from .audit_worlds import (
    AGES,
    AGES_S,
    BUDGETS,
    FALSE_ALARMS,
    FLOOR,
    NEAR_ALARM,
    RAMPS,
    SEARCHED,
    TRAINED,
    ScoredDetector,
    Worlds,
)
from .runner import Context, Experiment
from .store import Cell, Reader, Result
from .suite import DETECTOR_FILE, find_task_card, stored_cards

SIFTED = 4
"""Part of the selection that sifts, as one in so many."""
ENTROPY = "entropy"
"""File of a folder: the entropy that was drawn for its runs."""
SEARCH_PLAYS = 12000.0
"""Runs that take about as long as a search for profiles."""
FLOOR_PLAYS = 500.0
"""Runs that take about as long as a world of the floor."""


def choose_entropy(folder: Path | None, given: int | None) -> int:
    """Entropy that is given, or one that no detector has seen; of a folder, that of its first
    audit. A folder that can't be written to is refused here."""
    if given is not None:
        if folder is not None:
            check_writable(folder)
        return whole_number("`entropy`", given)
    drawn = secrets.randbits(32)
    if folder is not None:
        try:
            write_file(folder / ENTROPY, f"{drawn}\n".encode(), exclusive=True)
        except FileExistsError:  # another shard's, too
            with name_file(folder / ENTROPY):
                drawn = whole_number("the entropy", read_json(folder / ENTROPY, object))
    return drawn


class AuditPlan:
    """What is played to audit detectors of one task, on the same runs. Its arguments are those of
    `audit`."""

    def __init__(
        self,
        task: str | tasks.DetectorTask = "D1",
        budget: str = "standard",
        *,
        runs: int | None = None,
        selection_runs: int | None = None,
        families: Sequence[str] | None = None,
        entropy: int | None = None,
        threads: int | None = None,
        folder: str | os.PathLike[str] | None = None,
    ) -> None:
        self.task = tasks.get_detector_task(task) if isinstance(task, str) else task
        check_choice("budget", budget, BUDGETS)
        self.budget, self.size = budget, BUDGETS[budget]
        self.runs = whole_number("`runs`", self.size.runs if runs is None else runs, 2)
        few = self.size.selection_runs if selection_runs is None else selection_runs
        few = whole_number("`selection_runs`", few, 4)
        self.selection = attack_suite.Selection(runs=few, sift_runs=max(few // SIFTED, 1))
        keys = [each.key for each in self.task.families] if families is None else list(families)
        if not keys:
            raise ValueError("`families` must name at least one family of attacks, got none")
        if families is None:
            keys.append(TRAINED.key)
        own = {TRAINED.key: TRAINED}
        self.families = tuple(own.get(key) or self.task.family(key) for key in dict.fromkeys(keys))
        root = None if folder is None else Path(folder)
        self.folder = None if root is None else root / self.task.key
        self.entropy = choose_entropy(root, entropy)
        self.worlds = Worlds(self.task, self.entropy, threads)

    def list_families(self, detector: str) -> list[str]:
        """Keys of the families that a detector of a name meets."""
        made = any(detector in made_for for made_for in self.worlds.shipped.values())
        return [each.key for each in self.families if each != TRAINED or made]


@dataclass(frozen=True)
class AuditCells(Experiment):
    """Worst attacks of every family on detectors, which share passes where they only look, their
    false alarms, what they find at several ages, and the floor. `scores_only`: without the last
    two; `broken`: the first rule of the contract that the first detector breaks."""

    name: ClassVar[str] = "audit"
    of: AuditPlan
    detectors: Sequence[ScoredDetector]
    scores_only: bool = False
    broken: str | None = None

    @property
    def config(self) -> dict[str, Any]:
        """The task; numbers of runs are of the cells."""
        task = self.of.task
        world = describe(task.world_kwargs)
        return {"task": task.key, "world": world, "alert_limit_m": task.alert_limit_m}

    @cached_property
    def card(self) -> dict[str, Any]:
        """What is stored of the task for spoofers that has the same world."""
        return find_task_card(self.of.task)

    @cached_property
    def parts(self) -> dict[str, tuple[Cell, tasks.AttackFamily | str, ScoredDetector]]:
        """Cells by key, each with its family, or what it is in place of one, and its defence."""
        found, passive = {}, sum(each.passive for each in self.detectors)
        for part in (*self.of.families, FALSE_ALARMS, *(() if self.scores_only else (AGES,))):
            shared = part != AGES
            if isinstance(part, tasks.AttackFamily):
                shared = part.onset != NEAR_ALARM
            name = part if isinstance(part, str) else part.key
            for each in self.detectors:
                if part == TRAINED and (self.scores_only or not self._list_attacks(part, each)):
                    continue
                shares = shared and each.passive
                group = f"{name}: {f'{passive} detectors' if shares else each.player.label}"
                key, identity = self._identity(name, part, each)
                plays = self._expect_plays(part, each)
                found[key] = Cell(key, identity, plays, group=group), part, each
        if not any(isinstance(part, tasks.AttackFamily) for _, part, _ in found.values()):
            label = self.detectors[0].player.label
            raise ValueError(f"no shipped spoofer was made for {label} and fits {self.of.task.key}")
        worlds = self.of.size.floor_worlds
        if not (self.scores_only or worlds == 0 or "floor_m" in self.card):
            named = {"worlds": worlds, "entropy": self.of.entropy, "rate": self.requested_per_hour}
            key = f"{FLOOR} {compute_digest(named)[:8]}"
            work = FLOOR_PLAYS * (worlds or self.of.worlds.world.setup.bounds.worlds)
            found[key] = Cell(key, named, work, group=FLOOR), FLOOR, self.detectors[0]
        return found

    def _list_attacks(
        self, part: tasks.AttackFamily, defence: ScoredDetector
    ) -> tuple[attack_suite.SuiteAttack, ...]:
        return self.of.worlds.list_attacks(part, defence.player)

    def _expect_plays(self, part: tasks.AttackFamily | str, defence: ScoredDetector) -> float:
        """Runs that a cell plays, and those that take as long as its own warm-ups."""
        size, runs, world = self.of.size, float(self.of.runs), self.of.worlds.world.setup
        window = float(world.steps + world.hold)
        if part == AGES:
            flown = sum(AGES_S[: size.ages]) / world.interval_s
            return size.twins * (size.ages * (len(RAMPS) + 1) + flown / window)
        before = expect_onset(world) / window
        if isinstance(part, str):
            return runs * (1 + len(tasks.EVENTS)) * (1.0 + before)
        own = 0.0  # other families share theirs
        if part.onset is not None or self.of.task.get_overrides(part):
            own = before * (runs + self.of.selection.runs)
            own *= tasks.CANDIDATES if part.onset == NEAR_ALARM else 1
        members = len(self._list_attacks(part, defence))
        if SEARCHED in part.letters:
            members += len(AIMS) + len(self.card.get("optima_mps", {}))
        plays = attack_suite.expected_plays(
            members, self.of.selection, self.of.runs, attack_suite.ROUNDS
        )
        return own + plays + self.search_plays * (SEARCHED in part.letters)

    @property
    def search_plays(self) -> float:
        return SEARCH_PLAYS * self.of.size.search.generations / OpenLoopSearch().generations

    @property
    def requested_per_hour(self) -> float | None:
        """Rate of false alarms that the first detector is calibrated to."""
        return find_requested_rate(detector_in_world(self.detectors[0].player.fixed_spec))

    def _identity(
        self, name: str, part: tasks.AttackFamily | str, defence: ScoredDetector
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
        elif isinstance(part, tasks.AttackFamily) and SEARCHED in part.letters:
            named["search"] = asdict(self.of.size.search)
        elif part == TRAINED:
            named["spoofers"] = [each.player.spec for each in self._list_attacks(TRAINED, defence)]
        return f"{key} {compute_digest(named)[:8]}", named

    def cells(self) -> Iterator[Cell]:
        return (cell for cell, _, _ in self.parts.values())

    def run_group(
        self, cells: Sequence[Cell], results: Reader, context: Context
    ) -> Iterator[Result]:
        """Search against detectors that share their runs, and play what was found."""
        _, (part, *_), group = zip(*(self.parts[cell.key] for cell in cells), strict=True)
        worlds, size = self.of.worlds, self.of.size
        worlds.threads = context.threads
        release_free_memory()
        if isinstance(part, tasks.AttackFamily):
            yield from self._play_family(part, group, context)
        elif part == FALSE_ALARMS:
            yield from self._false_alarms(group)
        elif part == AGES:
            for each in group:
                yield Result(worlds.probe_ages(each.judge, size.twins, size.ages)._asdict())
        else:
            few, entropy = size.floor_worlds, self.of.entropy
            bounds = DisplacementBounds(worlds.world, [group[0].player], entropy, floor_worlds=few)
            work = cells[0].work
            floor = bounds.compute_lower_limit(lambda part: context.tick(work * part))
            yield Result(record=floor)

    def _play_family(
        self, family: tasks.AttackFamily, group: Sequence[ScoredDetector], context: Context
    ) -> Iterator[Result]:
        worlds = self.of.worlds
        where = {"onset": family.onset, **self.of.task.get_overrides(family)}
        own = [self._list_attacks(family, each) for each in group]
        heads: list[dict[str, Any]] = [{"detector": each.player.label} for each in group]
        transfers: tuple[attack_suite.SuiteAttack, ...] = ()
        if SEARCHED in family.letters:
            share, stored = self.search_plays / len(group), self.card.get("optima_mps", {})
            spoofer = specify_spoofer(add_tuned_setting({"name": "open-loop"}))
            found_elsewhere = (with_rates(spoofer, rates) for rates in stored.values())
            transfers = tuple(attack_suite.SuiteAttack(TRANSFER, each) for each in found_elsewhere)
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
            yield Result(*Protection(head, worst, panel.counts[:, k], panel.sky, None).parts())

    def _find_worst(
        self,
        where: Mapping[str, Any],
        group: Sequence[ScoredDetector],
        own: Sequence[tuple[attack_suite.SuiteAttack, ...]],
        context: Context,
    ) -> list[tuple[Winner, ...]]:
        """The worst of each detector's attacks, chosen on the selection, on the evaluation runs."""
        worlds, limit, settings = self.of.worlds, self.of.task.alert_limit_m, self.of.selection
        panel = worlds.panel(group, "selection", settings.runs, **where)
        antenna = tasks.ANTENNA_PARTS[0] * limit, tasks.ANTENNA_PARTS[1] * limit
        searches = [
            attack_suite.FamilyAttacks(panel, k, attacks, settings, antenna_m=antenna)
            for k, attacks in enumerate(own)
        ]
        requests = [(each.number, each.winners([limit])) for each in searches]
        chosen = list(zip(searches, play_searches(panel, requests, context.tick), strict=True))
        panel = worlds.panel(group, "evaluation", self.of.runs, **where)
        return attack_suite.play_winners(panel, chosen, context.tick)

    def _false_alarms(self, group: Sequence[ScoredDetector]) -> Iterator[Result]:
        """Alarms of detectors in runs without an attack, with an event and without."""
        worlds, runs = self.of.worlds, (group, "evaluation", self.of.runs)
        clean = worlds.panel(*runs)
        alarms = {WINDOW: clean.twin_alarm > 0, CLEAN: clean.warmup_alarm | (clean.twin_alarm > 0)}
        for event in tasks.EVENTS:  # all runs have it; their noise is the same
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
            elif isinstance(part, tasks.AttackFamily):
                worst = Protection.from_parts(*results[key][:2])
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
        self.of.worlds.release()
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
            broken=self.broken,
        )
        write_attacks(self.of.folder, found)
        return found

    def _find_reference(self) -> dict[str, Any] | None:
        """Stored score of the best non-learned detector: in this task, or in the campaign of the
        task for spoofers."""
        if scored := stored_cards(DETECTOR_FILE).get(self.of.task.key):
            best, by = scored["best_classic"], "audit"
            row = next(each for each in scored["detectors"] if each["detector"] == best)
            names = "exceeded_m", "p_hmi", "worst_family", "false_alarms_per_hour"
            figures = {name: row[name] for name in names}
        elif self.card:
            best, by = self.card["detector"], "campaign"
            figures = {"exceeded_m": self.card["protection_m"][best]}
        else:
            return None
        return {"detector": best, "by": by, **figures}


def write_attacks(folder: Path | None, found: Audit) -> None:
    """Write the worst attacks beside the results, to play wherever a spoofer is named."""
    if folder is None:
        return
    for name, spec in found.attacks.items():
        path = folder / "attacks" / f"{slug(found.score.detector)}-{name}.json"
        write_file(path, (json.dumps(spec) + "\n").encode())
