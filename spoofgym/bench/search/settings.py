"""How settings are searched for, under the alarm budget and without it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...core.registry import whole_number
from ..scores.statistics import BUDGET, fewest_runs


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """How a spoofer's setting is searched for.

    Parameters
    ----------
    runs : int
        Training runs.
    sift_runs : int
        How many of them are enough to find the neighbourhood.
    values : int
        Log-spaced values over the whole range that are sifted.
    refined : int
        Log-spaced values around a peak within the budget, tried on all training runs.
    budget : float
        Largest P(alarm | silent twin), which its upper 95 % limit on the training runs keeps.
    """

    runs: int = 1024
    sift_runs: int = 64
    values: int = 20
    refined: int = 5
    budget: float = BUDGET

    def __post_init__(self) -> None:
        for name, least in (("runs", 2), ("sift_runs", 1), ("values", 3), ("refined", 2)):
            count = whole_number(f"`tuning.{name}`", getattr(self, name), least)
            object.__setattr__(self, name, count)
        if not 0.0 < self.budget < 1.0:
            raise ValueError(f"`tuning.budget` must be in (0, 1), got {self.budget}")
        if self.runs < fewest_runs(self.budget):
            raise ValueError(
                f"`tuning.runs` must be at least {fewest_runs(self.budget)} for a budget of "
                f"{self.budget:g}: with fewer, not even runs without any alarm show that it is "
                f"kept; got {self.runs}"
            )


@dataclass(frozen=True, kw_only=True)
class Selection:
    """How the worst attack of the suite is looked for. `runs`: runs of the split `selection`;
    `sift_runs`: how many of them play the whole suite; `values`: log-spaced values of every
    member's setting."""

    runs: int = 192
    sift_runs: int = 48
    values: int = 10

    def __post_init__(self) -> None:
        for name, least in (("runs", 1), ("sift_runs", 1), ("values", 2)):
            count = whole_number(f"`selection.{name}`", getattr(self, name), least)
            object.__setattr__(self, name, count)


def log_spaced(low: float, high: float, count: int) -> list[float]:
    return [rounded_down(value) for value in np.geomspace(low, high, count)]


def rounded_down(value: float) -> float:
    """Number rounded down to four digits, so that a choice can be written down."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 3.0)
    return float(f"{math.floor(value / digit + 1e-6) * digit:.6g}")
