"""What a search for a profile is told, where it begins, and what it keeps of every generation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

KNOTS = (8, 16)
"""Fewest and most knots of a search."""


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """How a profile is searched for.

    - `knots`: of the curve, 8 to 16;
    - `cross`: whether a second curve across the heading is searched for as well;
    - `population`: candidates of a generation;
    - `batch`: runs that each of them plays;
    - `restarts`: how often a search that has converged begins again from its mean;
    - `budget`: how much more often than without attack an alarm may come;
    - `seed`: of the candidates, and of the order of the runs.
    """

    knots: int = 12
    cross: bool = False
    heading_deg: float = 90.0
    population: int = 12
    batch: int = 48
    restarts: int = 0
    budget: float = 0.05
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the settings."""
        if not KNOTS[0] <= self.knots <= KNOTS[1]:
            raise ValueError(f"`knots` must be {KNOTS[0]} to {KNOTS[1]}, got {self.knots}")
        for name, least in (("population", 4), ("batch", 2), ("restarts", 0), ("seed", 0)):
            if getattr(self, name) < least:
                raise ValueError(f"`{name}` must be at least {least}, got {getattr(self, name)}")
        if not 0.0 < self.budget < 1.0:
            raise ValueError(f"`budget` must be above 0 and below 1, got {self.budget}")


@dataclass(frozen=True)
class Start:
    """Where a search begins.

    - `rates_mps`: (knots,) curve along the heading; it must move;
    - `displacement_m`: mean undetected displacement that it reaches, above 0; the scale of the
      price of alarms;
    - `sigma`: standard deviation of the first generation, in units of the largest rate;
    - `smooth`: part of its variance that neighbouring knots share.
    """

    rates_mps: list[float]
    displacement_m: float
    sigma: float = 0.1
    smooth: float = 0.5

    def __post_init__(self) -> None:
        """Check that it is one."""
        if not (self.unit_mps > 0.0 and self.displacement_m > 0.0):
            raise ValueError("the start must move, and get somewhere before the first alarm")

    @property
    def unit_mps(self) -> float:
        """Largest rate."""
        return float(np.abs(self.rates_mps).max())


@dataclass(frozen=True)
class Generation:
    """One generation: what was tried, and what came of it.

    - `losses`: minus their Lagrangians, which CMA-ES was told;
    - `displacement_m`: mean undetected displacement over all candidates;
    - `alarm_rate`, `soft_alarms`: their mean alarm rate, counted, and with runs that came close.
    """

    points: list[list[float]]
    losses: list[float]
    displacement_m: float
    alarm_rate: float
    soft_alarms: float
