"""The scores of a campaign, from what its folder keeps of every run."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.settings import digest_of
from ..runs.players import PlayerSpec
from ..runs.record import Aim, Protection, RunRecord, Winner
from ..scores.campaign import bracket_of, compare, number, operating_point, score_detector
from ..scores.scores import (
    ALIKE,
    bootstrap_exceeded,
    by_chance,
    clusters_of,
    missed_in_time,
    survival,
)
from ..scores.statistics import (
    NOTHING,
    Estimate,
    bootstrap_mean,
    exceedance,
    largest_of_share,
    percentiles,
    resamples_of,
    wilson,
)
from ..search.amplitude import TuningResult
from .store import Cell, Result, Store

TABLE, SUMMARY, PICTURE = OUTPUTS = "results.md", "summary.json", "campaign.png"
"""Files beside the cells of a campaign."""
FLOOR, SEARCH, RUNS, PROTECTION, BOUND = "floor", "search", "runs", "protection", "bound"
"""Kinds of cells: of the world, of a detector and a spoofer, of a detector."""
ATTACK_SUITE = "attack suite"
Labelled = PlayerSpec | str | None

SURVIVAL_TIMES = 8
"""At how many times the share of undetected attacks is told."""


def key_of(kind: str, detector: Labelled = None, spoofer: Labelled = None) -> str:
    """Key of a cell."""
    labels = (each if isinstance(each, str) else each.label for each in (detector, spoofer) if each)
    return " / ".join((*labels, kind))


class CampaignResults:
    """What the finished cells of a campaign hold; None of what is not finished.

    - `store`: its folder; `config`: of the campaign.
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
        return self.store.get(Cell(key_of(kind, *labels), {}))

    def runs(self, detector: str, spoofer: str) -> RunRecord | None:
        """What a pair did."""
        found = self._get(RUNS, detector, spoofer)
        return None if found is None else RunRecord.of_parts(found.arrays, found.record)

    def search(self, detector: str, spoofer: str) -> TuningResult | None:
        """What was found for a spoofer against a detector."""
        found = self._get(SEARCH, detector, spoofer)
        return None if found is None else TuningResult.from_dict(found.record)

    def protection(self, detector: str) -> Protection | None:
        """What the worst attacks of the suite did against a detector."""
        found = self._get(PROTECTION, detector)
        return None if found is None else Protection.of_parts(found.arrays, found.record)

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
    points = {label: operating_point(config, label) for label in detectors}
    budget = float(config["tuning"]["budget"])
    scores = [score_runs(found, limits, budget) for found in records.values()]
    protected = [score_protection(found, limits) for found in known]
    tuned = [search.as_dict() for pair in pairs if (search := results.search(*pair)) is not None]
    bounds = {each: bound for each in detectors if (bound := results.limits(each)) is not None}
    bracket = {"floor": results.limits(), "zero_alarm": bounds}

    def bracketed(label: str) -> dict[str, Any]:
        point = {"detector": label, **points[label]}
        own = [[row for row in rows if row["detector"] == label] for rows in (scores, tuned)]
        worst = next((row for row in protected if row["detector"] == label), None)
        return bracket_of(point, bracket, own[0], worst, own[1])

    missing = [f"{detector} / {spoofer}" for detector, spoofer in pairs]
    if config["attack_suite"] is not None:
        missing += [f"{detector} / {ATTACK_SUITE}" for detector in detectors]
    finished = {f"{d} / {s}" for d, s in records} | {
        f"{x.detector} / {ATTACK_SUITE}" for x in known
    }
    return {
        "campaign": digest_of(results.store.config) if records else None,
        "scenario": config["scenario"]["name"],
        "runs": config["runs"],
        "entropy": config["entropy"],
        "budget": budget,
        "alert_limit_m": config["alert_limit_m"],
        "attack_suite": config["attack_suite"],
        "detectors": [
            {**score_detector(records[label, "none"]), **points[label], "bracket": bracketed(label)}
            for label in detectors
            if (label, "none") in records
        ],
        "cells": scores,
        "protection": protected,
        "comparisons": compare(
            list(records.values()), known, {k: p["footing"] for k, p in points.items()}
        ),
        "limits": bracket,
        "tuning": tuned,
        "missing": [each for each in missing if each not in finished],
    }


def score_runs(cell: RunRecord, limits: Sequence[float], budget: float) -> dict[str, Any]:
    """Scores of one cell; `limits` of the P_HMI curve [m]."""
    counts, stealth = cell.counts, cell.stealth
    kept = cell.displacement_m[counts]
    zeroed = np.where(cell.alarmed[counts], 0.0, kept)
    samples = resamples_of(clusters_of(cell.sky)[counts])
    return {
        "detector": cell.detector,
        "spoofer": cell.spoofer,
        "spoofer_settings": cell.head["spoofer_settings"],
        "tuned_within_budget": cell.head["tuned_within_budget"],
        "knowledge": cell.head["knowledge"],
        "attack": cell.head["attack"],
        "runs": cell.runs,
        "counted": stealth.runs,
        "silent_before_onset": float((~cell.records["warmup_alarm"]).mean().round(6)),
        "alarm_rate": wilson(stealth.alarms, stealth.runs).as_json(),
        "within_budget": stealth.seems_to_keep(budget),
        "stealthy_displacement_m": bootstrap_mean(kept, samples).as_json(),
        "median_m": number(np.median(kept)) if len(kept) else None,
        "alarmed_as_0_m": bootstrap_mean(zeroed, samples).as_json(),
        "largest_error_m": float(cell.records["largest_error_m"].mean().round(4)),
        "p_hmi": [
            {"alert_limit_m": limit, **estimate.as_json()}
            for limit, estimate in zip(limits, exceedance(kept, limits), strict=True)
        ],
        **times_of(cell),
    }


def times_of(cell: RunRecord) -> dict[str, Any]:
    """When the attack was noticed, of the runs that are silent before the onset.

    ``missed``: of the runs that count whose error crosses the alert limit, those without an alarm
    up to the time to alert after; ``after_crossing_s``: of the same, median from the crossing to
    the alarm; ``detected`` and ``chance``: alarms by the end, by what raised them; ``delay_s``:
    median from the onset to a detection; ``survival``: share still undetected by time.
    """
    records, step = cell.records, cell.interval_s
    silent = ~records["warmup_alarm"]
    first, twin = records["first_alarm"][silent], records["twin_alarm"][silent]
    chance = by_chance(first, twin)
    detected = (first > 0) & ~chance
    alarm, crossing = records["first_alarm"][cell.counts], records["crossing"][cell.counts]
    missed = missed_in_time(alarm, crossing, int(cell.head["hold"]))
    horizon = cell.window * step
    # a run is observed up to its alarm by chance, or up to that of its twin
    seen = np.where(twin > 0, twin * step, horizon)
    delay = np.where(detected, first * step, seen)
    times = np.linspace(0.0, horizon, SURVIVAL_TIMES + 1)[1:]
    late = (alarm - crossing)[(alarm > 0) & (crossing > 0)] * step
    found: dict[str, Any] = {
        "missed": wilson(int(missed.sum()), len(missed)).as_json(),
        "detected": wilson(int(detected.sum()), len(first)).as_json(),
        "chance": wilson(int(chance.sum()), len(first)).as_json(),
        "delay_s": _median(
            first[detected] * step, clusters_of(cell.sky)[silent][detected]
        ).as_json(),
        "after_crossing_s": number(np.median(late)) if len(late) else None,
        "horizon_s": horizon,
        "survival": [],
    }
    if len(first) and cell.spoofer != "none":
        curve = survival(delay, detected, times)
        rows = zip(*curve, strict=True)
        found["survival"] = [
            dict(zip(curve._fields, map(number, row), strict=True)) for row in rows
        ]
    return found


def _median(x: NDArray[Any], clusters: NDArray[np.int64]) -> Estimate:
    """Median with a percentile interval, by resamples of these runs alone."""
    if not len(x):
        return NOTHING
    drawn = largest_of_share(x, 0.5, resamples_of(clusters))
    return percentiles(float(np.median(x)), drawn)


def score_protection(found: Protection, limits: Sequence[float]) -> dict[str, Any]:
    """Protection of a detector: what the worst attacks exceed, and P(HMI | attack). The worst of
    all winners counts, whatever each was chosen for, so that P(HMI | attack) never grows with the
    limit, nor does what is exceeded with the share, and neither contradicts the other."""
    aims = [aim for winner in found.winners for aim in winner.aims]
    searched = sorted({aim.limit_m for aim in aims if aim.limit_m is not None} & set(limits))
    skies = None if found.skies is None else len(found.skies)
    return {
        "detector": found.detector,
        "counted": int(found.counts.sum()),
        "exceeded": [_exceeded(found, aim) for aim in aims if aim.share is not None],
        "p_hmi": [
            _hazardous(found, measure, limit)
            for measure in found.winners[0].displacement
            for limit in searched
        ],
        "worst_skies": skies,
    }


def _exceeded(found: Protection, aim: Aim) -> dict[str, Any]:
    """What the worst attack exceeds in a share of the runs."""
    assert aim.share is not None  # as chosen by the caller
    winner, rows = found.worst(aim), found.rows(aim)
    x = winner.displacement[aim.measure][rows]
    # the worst skies are few, and the interval is for these alone
    alike = np.arange(len(found.sky)) if aim.skies else clusters_of(found.sky)
    estimate = bootstrap_exceeded(x, aim.share, resamples_of(alike[rows]))
    if aim.skies:
        everywhere = aim._replace(skies=False)
        attack = found.worst(everywhere).displacement[aim.measure][found.counts]
        if estimate.value < (1.0 - ALIKE) * everywhere.reached(attack):
            estimate = NOTHING  # the few runs of the choice have not found the worst skies
    value = estimate.as_json()
    named = {"measure": aim.measure, "share": aim.share, "worst_skies": aim.skies}
    return {**named, "runs": len(x), **value, **_attack(winner)}


def _hazardous(found: Protection, measure: str, limit: float) -> dict[str, Any]:
    """P(HMI | attack) at an alert limit [m]."""
    aim = Aim(measure, limit_m=limit)
    winner = found.worst(aim)
    (p,) = exceedance(winner.displacement[measure][found.counts], [limit])
    return {"measure": measure, "alert_limit_m": limit, **p.as_json(), **_attack(winner)}


def _attack(winner: Winner) -> dict[str, Any]:
    named = {"letter": winner.letter, "spoofer": winner.spoofer}
    return {**named, "setting": winner.setting, "at": winner.value}
