"""A campaign: detectors x spoofers, the worst attacks of the suite, and limits.

Passive detectors share the passes of the engine, a few of them at a time.  A detector that takes
weight off measurements has passes of its own.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby, product
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.children import release_free_memory
from ...core.progress import ProgressCallback
from ...core.settings import compute_digest
from ...detectors.calibrated import resolve_thresholds
from ...simulation.simulator import weighs
from ..runs.on_device import find_lacking
from ..runs.panel import Panel, PanelAttack, play_searches
from ..runs.players import PlayerSpec, describe_knowledge
from ..runs.record import MEASURES, Protection, RunRecord, record_runs
from ..scores import campaign as scoring
from ..scores.at_budget import exceed_at_budget, score_best
from ..scores.scores import SHARES
from ..search.amplitude import TuningResult, search_work, with_rates
from ..search.attack_suite import BESIDE, SuiteAttack, WorstAttacks, expected_plays, play_winners
from ..search.bounds import restate_lower_limits
from ..search.open_loop import Optima, fit
from .runner import Context, Experiment, run_experiment
from .store import OUTPUTS, Cell, Reader, Result, Store
from .suite import Suite

FLOOR, SEARCH, RUNS, PROTECTION, BOUND = "floor", "search", "runs", "protection", "bound"
"""Kinds of cells: of the world, of a detector and a spoofer, of a detector."""
ATTACK_SUITE = "attack suite"
Labelled = PlayerSpec | str | None
PANEL, FEWEST = 4, 2
"""Passive detectors that share passes, at most: they are finished together, and by one process;
and groups of them at least, so that two processors have work."""
WARM_UP = 2.0  # work of a warm-up and of the clean twins, in runs of an attack


def build_key(kind: str, detector: Labelled = None, spoofer: Labelled = None) -> str:
    labels = (each if isinstance(each, str) else each.label for each in (detector, spoofer) if each)
    return " / ".join((*labels, kind))


class CampaignResults:
    """What the finished cells of a campaign hold; None of what is not finished.

    Parameters
    ----------
    store : Store
        Its folder, opened.
    config : mapping
        Of the campaign.
    """

    def __init__(self, store: Store, config: Mapping[str, Any]) -> None:
        self.store, self.config = store, config

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> CampaignResults:
        """Results in a folder, whatever plays there."""
        store = Store(path)
        store.reopen("campaign")
        return cls(store, store.config["config"])

    @property
    def path(self) -> Path:
        """The folder."""
        return self.store.path

    def _get(self, kind: str, *labels: str) -> Result | None:
        return self.store.get(Cell(build_key(kind, *labels), {}))

    def runs(self, detector: str, spoofer: str) -> RunRecord | None:
        """What a pair did."""
        found = self._get(RUNS, detector, spoofer)
        return None if found is None else RunRecord.from_parts(*found[:2])

    def columns(self) -> dict[str, NDArray[Any]]:
        """All finished runs as columns (R,): detector, spoofer, run, and what all pairs record."""
        sides = ([each["label"] for each in self.config[x]] for x in ("detectors", "spoofers"))
        found = [each for pair in product(*sides) if (each := self.runs(*pair)) is not None]
        if not found:
            raise ValueError(f"{self.path} holds no finished cell yet")
        tables = [
            {
                "detector": np.full(each.runs, each.detector),
                "spoofer": np.full(each.runs, each.spoofer),
                "run": np.arange(each.runs),
                **{name: x for name, x in each.records.items() if x.ndim == 1},
            }
            for each in found
        ]
        names = [name for name in tables[0] if all(name in each for each in tables)]
        return {name: np.concatenate([each[name] for each in tables]) for name in names}

    def search(self, detector: str, spoofer: str) -> TuningResult | None:
        """What was found for a spoofer against a detector."""
        found = self._get(SEARCH, detector, spoofer)
        return None if found is None else TuningResult.from_dict(found.record, found.arrays)

    @property
    def searches(self) -> dict[tuple[str, str], TuningResult]:
        """What was found so far, by detector and spoofer."""
        players = (self.config[side] for side in ("detectors", "spoofers"))
        pairs = product(*([entry["label"] for entry in each] for each in players))
        return {pair: search for pair in pairs if (search := self.search(*pair)) is not None}

    def protection(self, detector: str) -> Protection | None:
        """What the worst attacks of the suite did against a detector."""
        found = self._get(PROTECTION, detector)
        return None if found is None else Protection.from_parts(*found[:2])

    def limits(self, *detector: str) -> dict[str, Any] | None:
        """Zero-alarm bound of a detector, or the floor of the world."""
        found = self._get(BOUND if detector else FLOOR, *detector)
        return None if found is None else dict(found.record)


def summarize(results: CampaignResults) -> dict[str, Any]:
    """Scores of all finished cells.

    Parameters
    ----------
    results : CampaignResults
        Of a campaign.

    Returns
    -------
    dict
        JSON-able: ``scenario``, ``runs``, ``detectors`` (rates of false alarms, price,
        ``bracket``), ``cells`` (spoofers), ``protection`` (detectors), ``comparisons``
        (detectors with the negative controls at the same rate, run by run), ``limits`` (``floor``
        of the world, ``zero_alarm`` bounds by detector), ``tuning``, ``missing`` (cells).
    """
    config = results.config
    detectors = [entry["label"] for entry in config["detectors"]]
    pairs = [(label, entry["label"]) for label in detectors for entry in config["spoofers"]]
    records = {pair: found for pair in pairs if (found := results.runs(*pair)) is not None}
    known = [worst for each in detectors if (worst := results.protection(each)) is not None]
    limits = sorted({*config["alert_limits_m"], config["alert_limit_m"]})
    points = {label: scoring.operating_point(config, label) for label in detectors}
    budget = float(config["tuning"]["budget"])
    searches = results.searches
    scores = [
        with_exact_score(scoring.score_runs(found, limits, budget), searches.get(pair))
        for pair, found in records.items()
    ]
    protected = [scoring.score_protection(found, limits) for found in known]
    tuned = [search.as_dict() for search in searches.values()]
    bounds = {each: bound for each in detectors if (bound := results.limits(each)) is not None}
    bracket = {"floor": results.limits(), "zero_alarm": bounds}

    def score_bounds(label: str) -> dict[str, Any]:
        point = {"detector": label, **points[label]}
        own = [[row for row in rows if row["detector"] == label] for rows in (scores, tuned)]
        worst = next((row for row in protected if row["detector"] == label), None)
        return scoring.compute_bounds(point, bracket, own[0], worst, own[1])

    missing = [f"{detector} / {spoofer}" for detector, spoofer in pairs]
    if config["attack_suite"] is not None:
        missing += [f"{detector} / {ATTACK_SUITE}" for detector in detectors]
    finished = {f"{d} / {s}" for d, s in records} | {
        f"{x.detector} / {ATTACK_SUITE}" for x in known
    }
    return {
        "campaign": compute_digest(results.store.config) if records else None,
        "scenario": config["scenario"]["name"],
        "runs": config["runs"],
        "entropy": config["entropy"],
        "budget": budget,
        "alert_limit_m": config["alert_limit_m"],
        "attack_suite": config["attack_suite"],
        "detectors": [
            {
                **scoring.score_detector(records[label, "none"]),
                **points[label],
                "bracket": score_bounds(label),
                **score_strongest([searches[pair] for pair in pairs if pair in searches], label),
            }
            for label in detectors
            if (label, "none") in records
        ],
        "cells": scores,
        "protection": protected,
        "comparisons": scoring.compare_controls(
            list(records.values()), known, {k: p["footing"] for k, p in points.items()}
        ),
        "limits": bracket,
        "tuning": tuned,
        "missing": [each for each in missing if each not in finished],
    }


def with_exact_score(cell: dict[str, Any], search: TuningResult | None) -> dict[str, Any]:
    """Scores of a cell; at exactly the budget where it was fitted so, with the interval of that."""
    if search is None or search.at_budget is None:
        return cell
    exact = search.at_budget
    found = {**cell, "stealthy_displacement_m": exact[MEASURES[0]], "at_budget": exact}
    if (curve := search.trace) is not None:
        parts = {x: exceed_at_budget(curve, search.budget, x).as_json() for x in SHARES}
        found["exceeded_m"] = {f"{x:g}": each for x, each in parts.items()}
    return found


def score_strongest(searches: Sequence[TuningResult], detector: str) -> dict[str, Any]:
    """The strongest of the attacks on a detector at exactly the budget, chosen on other runs than
    it is scored on; nothing where fewer than two were fitted so."""
    own = [x for x in searches if x.detector == detector and x.trace is not None]
    traces = [each.trace for each in own if each.trace is not None]
    if len(traces) < 2:
        return {}
    return {"strongest_at_budget_m": score_best(traces, own[0].budget).as_json()}


def run_campaign(
    suite: Suite,
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    threads: int | None = None,
    jobs: int = 1,
    progress: ProgressCallback | None = None,
) -> CampaignResults:
    """Run all parts of a campaign that are not finished yet, each written as soon as it is.

    Parameters
    ----------
    suite : Suite
        What is run.
    path : path-like
        Folder of the results.
    overwrite : bool
        Whether to replace the results of another campaign.
    threads : int, optional
        As in `Engine`, in each process.
    jobs : int
        Processes of this machine.
    progress : ProgressCallback, optional
        Shows how far it is.

    Returns
    -------
    CampaignResults
        What `summarize` takes.
    """
    campaign, show = Campaign(suite), None if progress is None else lambda _: nullcontext(progress)
    settings: dict[str, Any] = {"jobs": jobs, "threads": threads, "overwrite": overwrite}
    return campaign.results(run_experiment(campaign, Store(path), progress=show, **settings))


@dataclass(frozen=True)
class Campaign(Experiment):
    """What every detector and spoofer of a suite do, and what limits them; `fit_only`: spoofers are
    fitted, and nothing else is played; `device`: where detectors are played that there are on a
    device, with the same bits; the others on the processor."""

    name: ClassVar[str] = "campaign"
    outputs: ClassVar[tuple[str, ...]] = OUTPUTS
    suite: Suite
    fit_only: bool = False
    device: str = "cpu"

    @property
    def config(self) -> dict[str, Any]:
        """Everything that the results depend on; nothing is left for single cells to say."""
        return self.suite.config

    def results(self, reader: Reader) -> CampaignResults:
        return CampaignResults(reader.store, self.config)

    def report(self, results: Reader) -> dict[str, Any]:
        return summarize(self.results(results))

    @cached_property
    def lacking(self) -> dict[str, str]:
        """Why detectors are played on the processor, by their labels, where a device is given."""
        suite, found = self.suite, {}
        for entry in suite.detector_players if self.device != "cpu" else ():
            if lacking := find_lacking(suite.setup(entry), self.device):
                found[entry.label] = lacking
        return found

    def _find_device(self, detectors: Sequence[PlayerSpec]) -> str:
        return "cpu" if any(each.label in self.lacking for each in detectors) else self.device

    @cached_property
    def panels(self) -> list[list[PlayerSpec]]:
        """Detectors that are played together."""
        setup, passive, others = self.suite.world.setup, list[PlayerSpec](), list[PlayerSpec]()
        for entry in self.suite.detector_players:
            judge = entry.build()
            resolve_thresholds(judge, setup)
            alone = weighs(setup, judge) or self._find_device([entry]) != "cpu"
            (others if alone else passive).append(entry)
        count = max(-(-len(passive) // PANEL), min(len(passive), FEWEST))
        return [*(passive[k::count] for k in range(count)), *([entry] for entry in others)]

    @cached_property
    def parts(self) -> dict[str, _Part]:
        """Cells by key; those of detectors that are played together are a group."""
        suite, found = self.suite, {build_key(FLOOR): _Part(Cell(build_key(FLOOR), {}), FLOOR)}
        players = suite.spoofer_players
        steps: list[tuple[str, PlayerSpec | None]] = [(SEARCH, x) for x in players if x.tuned]
        steps += [(RUNS, each) for each in players]
        steps += [] if suite.selection is None else [(PROTECTION, None)]
        for panel in self.panels:
            group = ", ".join(each.label for each in panel)
            for kind, spoofer in (*steps, (BOUND, None)):
                for detector in panel:
                    before = [each for each in players if each.needs_search and kind == PROTECTION]
                    before += [spoofer] if spoofer and spoofer.tuned and kind == RUNS else []
                    after = tuple(build_key(SEARCH, detector, each) for each in before)
                    key, work = build_key(kind, detector, spoofer), self._work(kind, spoofer)
                    cell = Cell(key, {}, work, after, group)
                    found[key] = _Part(cell, kind, detector, spoofer, panel)
        return found

    def cells(self) -> Iterator[Cell]:
        kinds = (SEARCH,) if self.fit_only else (FLOOR, SEARCH, RUNS, PROTECTION, BOUND)
        return (part.cell for part in self.parts.values() if part.kind in kinds)

    def _work(self, kind: str, spoofer: PlayerSpec | None) -> float:
        suite = self.suite
        if kind == SEARCH:
            curves = spoofer is not None and spoofer.needs_search
            return search_work(suite.tuning, suite.runs, curves=curves)
        if kind == RUNS:
            return suite.runs * (WARM_UP if spoofer and spoofer.label == "none" else 1.0)
        if kind == PROTECTION and suite.selection is not None:
            plays = expected_plays(len(suite.suite_attacks), suite.selection, suite.runs)
            return plays + sum(BESIDE) * suite.runs
        return 1.0

    def run_group(
        self, cells: Sequence[Cell], results: Reader, context: Context
    ) -> Iterator[Result]:
        parts = [self.parts[cell.key] for cell in cells]
        if parts[0].kind == FLOOR:
            context.cache.clear()  # replays and panels take as much memory again
            release_free_memory()
            suite = self.suite
            if suite.floor is None:
                record = suite.optima(context.threads).bounds.compute_lower_limit(context.tick)
            else:
                record = restate_lower_limits(suite.floor, suite.world.setup)
            yield Result(record=record)
            return
        optima: Optima = context.cache.setdefault("optima", self.suite.optima(context.threads))
        optima.device = self._find_device(parts[0].panel)
        play = _Players(self.suite, parts[0].panel, self.results(results), context, optima.device)
        for (kind, spoofer), some in groupby(parts, lambda part: (part.kind, part.spoofer)):
            numbers = {play.detectors.index(each): each for _, _, each, *_ in some if each}
            if kind == BOUND:
                bounds = map(optima.bounds.zero_alarm, numbers.values())
                yield from (Result(record=each.as_json()) for each in bounds)
            elif spoofer is None:
                yield from (Result(*each.parts()) for each in play.protections(numbers))
            elif kind == SEARCH:
                tuning = self.suite.tuning
                panel = play.panel(tuning.split, self.suite.fit_runs)
                found = fit(panel, numbers, spoofer, tuning, lambda: optima, context.tick)
                yield from (Result(each.arrays(), each.as_dict()) for each in found)
            else:
                yield from (Result(*each.parts()) for each in play.records(numbers, spoofer))


class _Part(NamedTuple):
    """A cell, what it is of, and which detectors are played together."""

    cell: Cell
    kind: str
    detector: PlayerSpec | None = None
    spoofer: PlayerSpec | None = None
    panel: Sequence[PlayerSpec] = ()


class _Players(NamedTuple):
    """Detectors that are played together."""

    suite: Suite
    detectors: Sequence[PlayerSpec]
    results: CampaignResults
    context: Context
    device: str

    def panel(self, split: str, runs: int) -> Panel:
        """Runs of a split at their onset; those of the last detectors stay in the cache."""
        suite = self.suite
        panels: dict[Any, Panel] = self.context.cache.setdefault("panels", {})
        labels = tuple(each.label for each in self.detectors)
        if (labels, split) not in panels:
            for key in [key for key in panels if key[0] != labels]:
                del panels[key]
            panels[labels, split] = Panel(
                suite.world.setup,
                [each.build() for each in self.detectors],
                lambda: suite.generators(split, runs),
                self.context.threads,
                suite.world.watched_for(suite.spoofer_players),
                self.device,
            )
        return panels[labels, split]

    def records(self, detectors: Mapping[int, PlayerSpec], spoofer: PlayerSpec) -> list[RunRecord]:
        """What a spoofer does in the evaluation runs of detectors, by their numbers."""
        suite, panel = self.suite, self.panel("evaluation", self.suite.runs)
        heads = [self._head(panel, number, spoofer) for number in detectors]
        played = [panel.clean[number] for number in detectors]
        if spoofer.label != "none":
            attacks = [PanelAttack(head["spoofer_settings"], suite.runs) for head in heads]
            requests = list(zip(attacks, detectors, strict=True))
            played = panel.play(requests, drop=False, tick=self.context.tick)
        return [
            record_runs(
                panel.setup,
                head,
                panel.warmup_alarm[:, number],
                attacked,
                panel.clean[number],
                suite.alert_limit_m,
            )
            for number, head, attacked in zip(detectors, heads, played, strict=True)
        ]

    def _head(self, panel: Panel, number: int, spoofer: PlayerSpec) -> dict[str, Any]:
        """The pair that plays, and its settings."""
        detector, spec, within = self.detectors[number], spoofer.spec, None
        judge = panel.judges[number]
        protects_s = getattr(getattr(judge, "detector", judge), "longest_s", None)
        found = self.results.search(detector.label, spoofer.label) if spoofer.tuned else None
        if found is not None:
            chosen = spoofer
            if found.found is not None:
                chosen = with_rates(spoofer, found.found["played"]["rates_mps"])
            spec, within = chosen.with_value(found.value), found.within_budget
        return {
            "detector": detector.label,
            "spoofer": spoofer.label,
            "detector_settings": detector.spec,
            "spoofer_settings": spec,
            "knowledge": describe_knowledge(spoofer, panel.setup, detector),
            "attack": panel.setup.attack.label,
            "tuned_within_budget": within,
            "judges_channels": judge.scope == "channel",
            **({} if protects_s is None else {"protects_s": protects_s}),
        }

    def protections(self, detectors: Mapping[int, PlayerSpec]) -> Iterator[Protection]:
        """What the worst attacks of the suite do against detectors, by their numbers."""
        suite, tick = self.suite, self.context.tick
        assert suite.selection is not None  # as the cell says
        panel = self.panel("selection", suite.selection.runs)
        searches = []
        for number, each in detectors.items():
            members = *suite.suite_attacks, *list_optima(suite, self.results, each)
            searches.append(WorstAttacks(panel, number, members, suite.selection))
        requests = [(each.number, each.winners(suite.alert_limits_m)) for each in searches]
        found = list(zip(searches, play_searches(panel, requests, tick), strict=True))
        panel = self.panel("evaluation", suite.runs)
        for (search, _), winners in zip(found, play_winners(panel, found, tick), strict=True):
            head, counts = {"detector": detectors[search.number].label}, panel.counts
            yield Protection(head, winners, counts[:, search.number], panel.sky, search.skies)


def list_optima(suite: Suite, results: CampaignResults, detector: PlayerSpec) -> list[SuiteAttack]:
    """Curves that were found against a detector, as members of the attack suite."""
    members: list[SuiteAttack] = []
    for entry in suite.spoofer_players:
        result = results.search(detector.label, entry.label) if entry.needs_search else None
        if result is not None and result.found is not None:
            each = (result.found["played"], *result.found["aims"].values())
            curves = [with_rates(entry, curve["rates_mps"]) for curve in each]
            own = [curve for k, curve in enumerate(curves) if curve not in curves[:k]]
            members += [SuiteAttack("c", curve) for curve in own]
    return members
