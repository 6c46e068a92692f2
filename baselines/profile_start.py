"""Where a search begins: the best of some curves, and how far around it it looks at first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from spoofgym.spoofers.profile import sampled

from .profile_search import PRICE, begin, profile_at, start_point
from .profile_settings import SearchSettings, Start
from .runs import RunPool

FloatArray = NDArray[np.float64]
SPREADS = ((0.1, 0.5), (0.1, 0.98), (0.05, 0.98), (0.025, 0.98), (0.0125, 0.98))
"""Standard deviation of the first generation, and part of the variance that neighbouring knots
share, from the widest spread on; a detector of jumps bears smooth curves only."""
KEPT = 0.7
"""The first spread is taken that leaves its candidates such a part of the displacement at the
start, on the average; the last one where none does."""


def start_between(
    pool: RunPool, settings: SearchSettings, rate_mps: float, acceleration_mps2: float
) -> Start:
    """Best of the curves between a ramp and an accelerating ramp, which are both tuned."""
    window = pool.setup.steps * pool.setup.interval_s
    ramp = np.full(settings.knots, rate_mps)
    faster = acceleration_mps2 * window * np.linspace(0.0, 1.0, settings.knots)
    curves = [
        scale * (w * ramp + (1.0 - w) * faster)
        for w in (0.0, 0.25, 0.5, 0.75, 1.0)
        for scale in (1.0, 1.15)
    ]
    return best_start(pool, settings, curves)


def best_start(pool: RunPool, settings: SearchSettings, curves: Sequence[FloatArray]) -> Start:
    """Best of some curves, and a spread around it. `curves`: (knots,) each [m/s]."""
    limit = pool.setup.attack.rate_limit_mps
    profiles = [profile_at(settings, curve, limit) for curve in curves]
    outcome = pool.play(profiles, np.arange(min(pool.runs, 2 * settings.batch)))
    displacement = outcome.mean_m
    beyond = np.maximum(outcome.alarm_rate - settings.budget, 0.0)
    best = int(np.argmax(displacement * (1.0 - PRICE * beyond)))
    start = Start(list(profiles[best].rates_mps), float(displacement[best]))
    rows = np.arange(min(pool.runs, settings.batch))
    for sigma, smooth in SPREADS:
        start = replace(start, sigma=sigma, smooth=smooth)
        cma = begin(settings, start, start_point(settings, start), settings.seed)
        points = [cma.ask() * start.unit_mps for _ in range(settings.population)]
        tried = pool.play([profile_at(settings, point, limit) for point in points], rows)
        if tried.mean_m.mean() >= KEPT * start.displacement_m:
            break
    return start


def resampled(rates_mps: Sequence[float], knots: int) -> list[float]:
    """A curve by another number of knots. Returns (knots,) [m/s]."""
    inner = sampled(tuple(rates_mps), knots - 1)
    return [float(rates_mps[0]), *inner.tolist()]
