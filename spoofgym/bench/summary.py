"""The scores of a campaign, from what its folder keeps of every run."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cells import Cell
from .metrics import (
    RESAMPLES,
    Estimate,
    bootstrap_mean,
    clopper_pearson,
    clustered_proportion,
    counts_of,
    exceedance,
    percentiles,
    resamples,
    restricted_mean_delay,
    wilson,
)
from .store import ResultsFolder
from .suite import seed_sequences

ALERT_LIMITS_M = (5.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 556.0)
"""Levels of the P_HMI curve; 40 m is the horizontal alert limit of an approach with vertical
guidance, 556 m that of a non-precision approach (`icao-annex10`)."""
TABLE_LIMIT_M = 40.0


def as_json(estimate: Estimate) -> dict[str, float | None]:
    """Estimate by names, None where it is unknown.

    Parameters
    ----------
    estimate : Estimate
        Number and interval.

    Returns
    -------
    dict
        ``value``, ``low``, ``high``.
    """
    return {
        name: None if math.isnan(number) else round(number, 6)
        for name, number in estimate._asdict().items()
    }


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
        ``differences`` (paired, between detectors), ``tuning``, ``missing`` (cells).
    """
    config = folder.config()
    detectors = [entry["label"] for entry in config["detectors"]]
    spoofers = [entry["label"] for entry in config["spoofers"]]
    pairs = [(detector, spoofer) for detector in detectors for spoofer in spoofers]
    cells = {pair: folder.cell(*pair) for pair in pairs if folder.has_cell(*pair)}
    samples = bootstrap_samples(config)
    counts = counts_of(samples)
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
        "cells": [score_cell(cell, samples, counts) for cell in cells.values()],
        "differences": _differences(cells, detectors, spoofers, samples),
        "tuning": [search.as_dict() for search in searches if search is not None],
        "missing": [
            f"{detector} / {spoofer}"
            for detector, spoofer in pairs
            if (detector, spoofer) not in cells
        ],
    }


def bootstrap_samples(config: dict[str, Any]) -> NDArray[np.int64]:
    """The same samples of runs for all cells.

    Parameters
    ----------
    config : dict
        Of the campaign.

    Returns
    -------
    ndarray
        (S, R).
    """
    seed = seed_sequences(config["entropy"], "bootstrap", config["scenario"]["name"], 1)[0]
    return resamples(config["runs"], np.random.Generator(np.random.PCG64(seed)), RESAMPLES)


def score_detector(clean: Cell) -> dict[str, Any]:
    """False alarms of a detector, from its runs without attack.

    Parameters
    ----------
    clean : Cell
        The ``none`` cell.

    Returns
    -------
    dict
        Per run and per epoch of the window, and in the warm-up; RMS distance from the truth.
    """
    records = clean.records
    warm = int(records["warmup_alarm"].sum())
    return {
        "detector": clean.detector,
        "window_s": clean.window * clean.interval_s,
        "false_alarm_per_run": as_json(clopper_pearson(int(clean.alarmed.sum()), clean.runs)),
        "false_alarm_per_epoch": as_json(
            clustered_proportion(records["alarm_epochs"], clean.window)
        ),
        "warmup_alarm_per_run": as_json(clopper_pearson(warm, clean.runs)),
        "navigation_rms_m": float(np.sqrt(np.mean(records["navigation_rms_m"] ** 2)).round(4)),
    }


def score_cell(
    cell: Cell, samples: NDArray[np.int64], counts: NDArray[np.float64]
) -> dict[str, Any]:
    """Scores of one cell.

    Parameters
    ----------
    cell : Cell
        All runs.
    samples, counts : ndarray
        (S, R) bootstrap samples, and how often each run is in them.

    Returns
    -------
    dict
        JSON-able.
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
        "alarm_rate": as_json(wilson(int(cell.alarmed.sum()), cell.runs)),
        "delay_s": as_json(percentiles(mean, drawn)),
        "delay_horizon_s": horizon,
        "delay_runs": int(kept.sum()),
        "delay_excluded": int((~kept).sum()),
        "undetected_displacement_m": as_json(bootstrap_mean(displacement, samples)),
        "largest_error_m": float(records["largest_error_m"].mean().round(4)),
        "p_hmi": [
            {"alert_limit_m": limit, **as_json(estimate)}
            for limit, estimate in zip(
                ALERT_LIMITS_M, exceedance(displacement, ALERT_LIMITS_M), strict=True
            )
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
                difference = as_json(bootstrap_mean(gap, samples))
                found.append(
                    {
                        "spoofer": spoofer,
                        "detector": detector,
                        "reference": detectors[0],
                        "undetected_displacement_m": difference,
                    }
                )
    return found
