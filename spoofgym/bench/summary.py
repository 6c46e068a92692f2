"""The scores of a campaign, from what its folder keeps of every run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cells import Cell
from .metrics import (
    RESAMPLES,
    bootstrap_mean,
    clopper_pearson,
    clustered_proportion,
    counts_of,
    exceedance,
    percentiles,
    resamples,
    restricted_mean_delay,
)
from .rivals import compare_rivals, footing
from .store import ResultsFolder
from .suite import FORMAT, seed_sequences

ALERT_LIMITS_M = (5.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 556.0)
"""Levels of the P_HMI curve; 40 m is the horizontal alert limit of an approach with vertical
guidance, 556 m that of a non-precision approach (`icao-annex10`)."""


def summarize(folder: ResultsFolder) -> dict[str, Any]:
    """Scores of all finished cells.

    Parameters
    ----------
    folder : ResultsFolder
        Of a campaign.

    Returns
    -------
    dict
        JSON-able: ``scenario``, ``runs``, ``detectors`` (false alarms), ``cells`` (scores),
        ``differences`` (paired, between detectors), ``rivals`` (paired, between spoofers),
        ``tuning``, ``missing`` (cells).

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
    budget = float(config["tuning"]["budget"])
    samples = bootstrap_samples(config)
    counts = counts_of(samples)
    limits = sorted({*ALERT_LIMITS_M, config["alert_limit_m"]})
    searches = [folder.tuning(*pair) for pair in pairs]
    return {
        "campaign": next((cell.head["campaign"] for cell in cells.values()), None),
        "scenario": config["scenario"]["name"],
        "runs": config["runs"],
        "entropy": config["entropy"],
        "detectors": [
            score_detector(cells[detector, "none"])
            for detector in detectors
            if (detector, "none") in cells
        ],
        "budget": budget,
        "alert_limit_m": config["alert_limit_m"],
        "cells": [
            {
                **score_cell(cell, samples, counts, limits),
                **footing(cell, cells.get((cell.detector, "none")), budget, samples),
            }
            for cell in cells.values()
        ],
        "differences": _differences(cells, detectors, spoofers, samples),
        "rivals": compare_rivals(cells.values(), budget, samples),
        "tuning": [search.as_dict() for search in searches if search is not None],
        "missing": [
            f"{detector} / {spoofer}"
            for detector, spoofer in pairs
            if (detector, spoofer) not in cells
        ],
    }


def bootstrap_samples(config: dict[str, Any]) -> NDArray[np.int64]:
    """The same samples of runs for all cells: (S, R)."""
    seed = seed_sequences(config["entropy"], "bootstrap", config["scenario"]["name"], 1)[0]
    return resamples(config["runs"], np.random.Generator(np.random.PCG64(seed)), RESAMPLES)


def score_detector(clean: Cell) -> dict[str, Any]:
    """False alarms of a detector, from its runs without attack.

    Returns per run and per epoch of the window, and in the warm-up; RMS distance from the truth.
    """
    records = clean.records
    warm = int(records["warmup_alarm"].sum())
    return {
        "detector": clean.detector,
        "window_s": clean.window * clean.interval_s,
        "false_alarm_per_run": clopper_pearson(int(clean.alarmed.sum()), clean.runs).as_json(),
        "false_alarm_per_epoch": clustered_proportion(
            records["alarm_epochs"], clean.window
        ).as_json(),
        "warmup_alarm_per_run": clopper_pearson(warm, clean.runs).as_json(),
        "navigation_rms_m": float(np.sqrt(np.mean(records["navigation_rms_m"] ** 2)).round(4)),
    }


def score_cell(
    cell: Cell,
    samples: NDArray[np.int64],
    counts: NDArray[np.float64],
    limits: Sequence[float] = ALERT_LIMITS_M,
) -> dict[str, Any]:
    """Scores of one cell.

    `samples`, `counts` (S, R) bootstrap samples, and how often each run is in them; `limits`: of
    the P_HMI curve [m].
    """
    records, horizon = cell.records, cell.window * cell.interval_s
    displacement = records["undetected_displacement_m"]
    kept = ~records["warmup_alarm"]
    delay = np.where(cell.alarmed, records["first_alarm"] * cell.interval_s, horizon)
    arguments = (delay, cell.alarmed, horizon)
    mean = float(restricted_mean_delay(*arguments, weights=kept.astype(float)))
    drawn = restricted_mean_delay(*arguments, weights=counts * kept)
    return {
        "detector": cell.detector,
        "spoofer": cell.spoofer,
        "spoofer_settings": cell.head["spoofer_settings"],
        "tuned_within_budget": cell.head["tuned_within_budget"],
        "knowledge": cell.head["knowledge"],
        "attack": cell.head["attack"],
        "runs": cell.runs,
        "delay_s": percentiles(mean, drawn).as_json(),
        "delay_horizon_s": horizon,
        "delay_runs": int(kept.sum()),
        "delay_excluded": int((~kept).sum()),
        "undetected_displacement_m": bootstrap_mean(displacement, samples).as_json(),
        "largest_error_m": float(records["largest_error_m"].mean().round(4)),
        "p_hmi": [
            {"alert_limit_m": limit, **estimate.as_json()}
            for limit, estimate in zip(limits, exceedance(displacement, limits), strict=True)
        ],
    }


def _differences(
    cells: dict[tuple[str, str], Cell],
    detectors: list[str],
    spoofers: list[str],
    samples: NDArray[np.int64],
) -> list[dict[str, Any]]:
    """Undetected displacement by one detector less that by the first one, run by run."""
    found = []
    for spoofer in spoofers:
        first = cells.get((detectors[0], spoofer))
        if spoofer == "none" or first is None:
            continue
        reference = first.records["undetected_displacement_m"]
        for detector in detectors[1:]:
            other = cells.get((detector, spoofer))
            if other is not None:
                gap = other.records["undetected_displacement_m"] - reference
                difference = bootstrap_mean(gap, samples).as_json()
                found.append(
                    {
                        "spoofer": spoofer,
                        "detector": detector,
                        "reference": detectors[0],
                        "undetected_displacement_m": difference,
                    }
                )
    return found
