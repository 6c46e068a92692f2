"""How a statistic of every epoch does on a data set, by the rule of the benchmark."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import rankdata

from spoofgym.bench.experiments.dataset import Dataset, Episodes
from spoofgym.bench.runs.record import mask_valid_runs, undetected_displacement
from spoofgym.detectors.calibration_file import check_runs, compute_rank, run_probability

FloatArray = NDArray[np.float64]
CLASSIC = "classic_"
"""How observations that are classic detectors' statistics begin."""


class Scored(NamedTuple):
    """Score of a statistic.

    - `loss`: mean of min(D, AL) / AL over the runs that count, with D the undetected displacement
      of the attacked run and AL the alert limit;
    - `mean_m`: mean of D itself;
    - `threshold`: that a clean run exceeds with the probability that a rate of false alarms asks
      for;
    - `counted`: runs that count: silent before the attack, with a silent twin;
    - `area`: under the ROC curve of single epochs.
    """

    loss: float
    mean_m: float
    threshold: float
    counted: int
    area: float


def window_s(config: Mapping[str, Any]) -> float:
    """Judged time of an episode [s]."""
    epochs = config["epochs"]
    return float((epochs["steps"] + epochs["hold"]) * config["interval_s"])


def count_live(episodes: Episodes, config: Mapping[str, Any]) -> NDArray[np.int64]:
    """(E,) epochs of every episode before the onset."""
    epochs = config["epochs"]
    return np.asarray(episodes.epochs - (epochs["steps"] + epochs["hold"]))


def score_statistic(
    statistic: FloatArray,
    episodes: Episodes,
    config: Mapping[str, Any],
    false_alarms_per_hour: float,
) -> Scored:
    """Score a statistic at the threshold that these runs' own clean episodes give. `statistic`: (E,
    L) of every epoch; `episodes`: of a data set, clean and attacked in turn."""
    clean, live = episodes.clean, count_live(episodes, config)
    steps, hold = (config["epochs"][name] for name in ("steps", "hold"))
    check_runs(false_alarms_per_hour, int(clean.sum()), window_s(config), tail=False)
    window = np.arange(len(live))[:, None], live[:, None] + np.arange(steps + hold)
    judged = statistic[window]
    maxima = np.sort(judged[clean].max(axis=1))
    p = run_probability(false_alarms_per_hour, window_s(config))
    threshold = float(maxima[-compute_rank(p, len(maxima))])
    alarm = judged > threshold
    early = (statistic > threshold) & (np.arange(statistic.shape[1]) < live[:, None])
    # the two episodes of a run are neighbours, the clean one first
    counts = mask_valid_runs(early[~clean].any(axis=1), alarm[clean].any(axis=1))
    raised = alarm[~clean]
    first = np.where(raised.any(axis=1), raised.argmax(axis=1) + 1, 0)
    error = episodes.displacement_m[window][~clean, :steps].T
    undetected = undetected_displacement(error, first, hold)[counts]
    valid = episodes.valid
    under = area(statistic[valid], episodes.attack[valid])
    if not counts.any():
        return Scored(1.0, math.nan, threshold, 0, under)
    return Scored(
        float(np.minimum(undetected / config["length_m"], 1.0).mean()),
        float(undetected.mean()),
        threshold,
        int(counts.sum()),
        under,
    )


def area(statistic: FloatArray, attack: NDArray[np.bool_]) -> float:
    """Probability that an attacked epoch has a larger statistic than a clean one."""
    ranks, hits = rankdata(statistic).ravel(), attack.ravel()
    positive, negative = int(hits.sum()), int((~hits).sum())
    return float((ranks[hits].sum() - 0.5 * positive * (positive + 1)) / (positive * negative))


def score_non_learned(
    data: Dataset, episodes: Episodes, false_alarms_per_hour: float
) -> dict[str, Scored]:
    """Scores of the classic detectors whose statistics are among the observations, by name."""
    return {
        name.removeprefix(CLASSIC): score_statistic(
            episodes.observation[:, :, k].astype(np.float64),
            episodes,
            data.config,
            false_alarms_per_hour,
        )
        for k, name in enumerate(data.names)
        if name.startswith(CLASSIC) and "_slot" not in name
    }
