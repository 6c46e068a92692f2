"""The threshold of a frozen detector, from clean episodes, with its confidence interval."""

from __future__ import annotations

import dataclasses
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..core.files import write_file
from ..detectors.calibration_file import compute_rank

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PolicyCalibration:
    """Threshold of one frozen detector for a run-level false-alarm rate.

    Attributes
    ----------
    threshold : float
        What the statistic is compared with, in (0, 1].
    threshold_low, threshold_high : float
        Confidence interval of the quantile that it estimates.
    confidence : float
        Of the interval.
    false_alarm : float
        Probability that a clean run alarms, at most.
    runs : int
        Clean runs that it is made of.
    detector : str or None
        Digest of the frozen policy; None where there is no telling.
    settings : str
        Digest of world, victim, timeline and delay.
    """

    threshold: float
    threshold_low: float
    threshold_high: float
    confidence: float
    false_alarm: float
    runs: int
    detector: str | None
    settings: str

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it to a JSON file."""
        write_file(Path(path), (json.dumps(dataclasses.asdict(self), indent=1) + "\n").encode())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> PolicyCalibration:
        """Read it from a JSON file."""
        try:
            fields: dict[str, Any] = json.loads(Path(path).read_text(encoding="utf-8"))
            return cls(**fields)
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path} is no calibration: {error}") from error


def compute_threshold(
    largest: FloatArray, false_alarm: float, confidence: float
) -> tuple[float, float, float]:
    r"""Threshold that a new clean run exceeds with at most a given probability.

    With the largest statistics of n clean runs in order, :math:`x_{(1)} \le \dots \le x_{(n)}`, it
    is :math:`x_{(k)}`, :math:`k = \lceil (1 - \alpha)(n + 1) \rceil`: a run like these exceeds it
    with probability :math:`\alpha` at most, whatever their distribution.  The quantile itself lies
    between :math:`x_{(l)}` and :math:`x_{(u)}`, where l and u are quantiles of the binomial
    distribution of n and :math:`1 - \alpha`.

    `largest` (n,) largest statistic of every clean run, in [0, 1].
    """
    from scipy.stats import binom

    ordered, n = np.sort(largest), len(largest)
    k = n + 1 - compute_rank(false_alarm, n)
    tail = 0.5 * (1.0 - confidence)
    lower = int(binom.ppf(tail, n, 1.0 - false_alarm))
    upper = int(binom.ppf(1.0 - tail, n, 1.0 - false_alarm)) + 1
    return (
        float(ordered[k - 1]),
        float(ordered[lower - 1]) if lower >= 1 else 0.0,
        float(ordered[upper - 1]) if upper <= n else 1.0,
    )
