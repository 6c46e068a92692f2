"""The scores of a campaign, from what its folder keeps of every run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..runs.record import Aim, Cell, Protection, Winner
from ..scores.bounds import bracket_of
from ..scores.clean import number, operating_point, score_detector
from ..scores.paired import compare
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
from .results_folder import ResultsFolder
from .suite import FORMAT

SURVIVAL_TIMES = 8
"""At how many times the share of undetected attacks is told."""


def summarize(folder: ResultsFolder) -> dict[str, Any]:
    """Scores of all finished cells.

    Parameters
    ----------
    folder : ResultsFolder
        Of a campaign.

    Returns
    -------
    dict
        JSON-able: ``scenario``, ``runs``, ``detectors`` (rates of false alarms, price,
        ``bracket``), ``cells`` (spoofers), ``protection`` (detectors), ``comparisons``
        (detectors with the negative controls at the same rate, run by run), ``limits`` (``floor``
        of the world, ``zero_alarm`` bounds by detector), ``tuning``, ``missing`` (cells).

    Raises
    ------
    ValueError
        When the results are of another format.
    """
    config = folder.config()
    if config["format"] != FORMAT:
        raise ValueError(
            f"{folder.path} holds results of format {config['format']}, written by spoofgym "
            f"{config['versions']['spoofgym']}; this one scores format {FORMAT}: play them again"
        )
    detectors = [entry["label"] for entry in config["detectors"]]
    spoofers = [entry["label"] for entry in config["spoofers"]]
    pairs = [(detector, spoofer) for detector in detectors for spoofer in spoofers]
    cells = {pair: folder.cell(*pair) for pair in pairs if folder.has_cell(*pair)}
    protections = [folder.protection(detector) for detector in detectors]
    known = [found for found in protections if found is not None]
    limits = sorted({*config["alert_limits_m"], config["alert_limit_m"]})
    searches = [folder.tuning(*pair) for pair in pairs]
    points = {label: operating_point(config, label) for label in detectors}
    played = [label for label in detectors if (label, "none") in cells]
    unplayed = [] if config["attack_suite"] is None else detectors
    budget = float(config["tuning"]["budget"])
    scores = [score_cell(cell, limits, budget) for cell in cells.values()]
    protected = [score_protection(found, limits) for found in known]
    tuned = [search.as_dict() for search in searches if search is not None]
    bounds = {label: found for label in detectors if (found := folder.limits(label)) is not None}
    bracket = {"floor": folder.limits(None), "zero_alarm": bounds}

    def bracketed(label: str) -> dict[str, Any]:
        point = {"detector": label, **points[label]}
        own = [[row for row in rows if row["detector"] == label] for rows in (scores, tuned)]
        worst = next((row for row in protected if row["detector"] == label), None)
        return bracket_of(point, bracket, own[0], worst, own[1])

    return {
        "campaign": next((cell.head["campaign"] for cell in cells.values()), None),
        "scenario": config["scenario"]["name"],
        "runs": config["runs"],
        "entropy": config["entropy"],
        "budget": budget,
        "alert_limit_m": config["alert_limit_m"],
        "attack_suite": config["attack_suite"],
        "detectors": [
            {
                **score_detector(cells[label, "none"]),
                **points[label],
                "bracket": bracketed(label),
            }
            for label in played
        ],
        "cells": scores,
        "protection": protected,
        "comparisons": compare(
            list(cells.values()), known, {k: p["footing"] for k, p in points.items()}
        ),
        "limits": bracket,
        "tuning": tuned,
        "missing": [
            f"{detector} / {spoofer}"
            for detector, spoofer in pairs
            if (detector, spoofer) not in cells
        ]
        + [
            f"{detector} / attack suite"
            for detector in unplayed
            if detector not in {found.detector for found in known}
        ],
    }


def score_cell(cell: Cell, limits: Sequence[float], budget: float) -> dict[str, Any]:
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


def times_of(cell: Cell) -> dict[str, Any]:
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
