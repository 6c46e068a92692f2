"""The bracket of a campaign: floor, open-loop attack and zero-alarm bound of every detector.

The floor is what even a perfect detector would allow at the same rate of false alarms, for what
each figure requires: to miss an attack that keeps the alarm budget, to find half of the attacks,
or 95 % of them.  It is the same for all detectors.  The zero-alarm bound is what no attack exceeds
in the mean without raising an alarm itself.  Between them lies what was found.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ...detectors.calibrated import STANDARD_RATE
from ...detectors.calibration_file import run_probability
from ...limits import Frontier, compute_frontier, deflection_for
from ...limits.bounds import WorkCallback, WorldSample, ZeroAlarm, draw_worlds, zero_alarm_bounds
from ...limits.floor import QUANTILES, check_linear_victim
from ...simulation.setup import Setup
from ...simulation.tight import TightlyCoupledSetup
from ..runs.players import PlayerSpec
from ..runs.world import World
from ..scores.statistics import BUDGET

WORLDS = 4  # drawn worlds over which zero-alarm bounds are taken
HEADING = "unknown"  # what a perfect detector knows of the attack's heading; it knows the rest


def purposes(p_fa: float, budget: float) -> dict[str, float]:
    return {
        "stealthy": 1.0 - (1.0 - p_fa) * (1.0 - budget),
        "half": 0.5,
        "few": 0.95,
        "certain": 0.999,
    }


def compute_lower_limits(
    frontier: Frontier, p_fa: float, budget: float, heading: str = HEADING
) -> dict[str, dict[str, Any]]:
    """Floors by purpose: the median over worlds, its 95 % interval, and the 10th and 90th
    percentile [m]. None where the frontier has no end."""
    found = {}
    for name, p_d in purposes(p_fa, budget).items():
        low, middle, high = (
            _finite(frontier.lower_limit_m(p_fa, p_d, heading=heading, quantile=q))
            for q in QUANTILES
        )
        found[name] = {
            "p_d": p_d,
            "deflection": deflection_for(p_fa, p_d, heading=heading),
            "value": middle,
            "low": low,
            "high": high,
            "interval": [
                _finite(x) for x in frontier.lower_limit_interval_m(p_fa, p_d, heading=heading)
            ],
        }
    return found


def tabulate_lower_limits(
    frontier: Frontier, rates: Sequence[float], budget: float
) -> dict[str, Any]:
    """Lower limits of the first rate, and of all ``rates``."""
    each = [(p_fa, compute_lower_limits(frontier, p_fa, budget)) for p_fa in rates]
    return {
        "p_fa": each[0][0],
        "heading": HEADING,
        "worlds": len(frontier.per_deflection),
        "sensors_known": frontier.sensors_known,
        "assumptions": list(frontier.assumptions),
        "floor_m": each[0][1],
        "rates": [{"p_fa": p_fa, "floor_m": found} for p_fa, found in each],
    }


def restate_lower_limits(stored: Mapping[str, Any], setup: Setup) -> dict[str, Any]:
    """Stored lower limits as `DisplacementBounds.compute_lower_limit` has them: at the standard
    rate of false alarms, over all skies of a world."""
    p_fa, floor_m = run_probability(STANDARD_RATE, setup.window_s), stored["floor_m"]
    return {
        "p_fa": p_fa,
        "heading": HEADING,
        "worlds": setup.bounds.worlds,
        "sensors_known": False,
        "assumptions": stored["assumptions"],
        "floor_m": floor_m,
        "rates": [{"p_fa": p_fa, "floor_m": floor_m}],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def expect_onset(setup: Setup) -> float:
    """Mean number of epochs before the onset; ages are log-uniform."""
    youngest, oldest = setup.youngest, setup.onset
    drawn = youngest < oldest
    return (oldest - youngest) / math.log(oldest / youngest) if drawn else float(oldest)


class DisplacementBounds:
    """Floor of a world and zero-alarm bounds of detectors in it, over so many that are drawn.
    `budget`: of alarms, which the floor keeps; `floor_worlds`: of the floor, by default one under
    every sky."""

    def __init__(
        self,
        world: World,
        detectors: Sequence[PlayerSpec],
        entropy: int = 0,
        budget: float = BUDGET,
        worlds: int = WORLDS,
        floor_worlds: int | None = None,
    ) -> None:
        self.world, self.detectors, self.entropy = world, detectors, entropy
        self.budget, self.worlds, self.floor_worlds = budget, worlds, floor_worlds
        self._cases: list[WorldSample] | None = None
        self._bounds: dict[str, ZeroAlarm] = {}

    @property
    def setup(self) -> TightlyCoupledSetup | None:
        setup = self.world.setup
        return setup if isinstance(setup, TightlyCoupledSetup) else None

    def compute_lower_limit(self, tick: WorkCallback | None = None) -> dict[str, Any]:
        """Floor over the drawn worlds, or why it is missing."""
        if self.setup is None:
            return {"why": f"no limit is known for {self.world.setup.whose}"}
        try:
            frontier = compute_frontier(
                self.setup, worlds=self.floor_worlds, entropy=self.entropy, tick=tick
            )
        except ValueError as error:
            return {"why": str(error)}
        return tabulate_lower_limits(frontier, self.rates, self.budget)

    @property
    def rates(self) -> list[float]:
        """Probabilities of a false alarm in a run of the detectors, the standard one for none."""
        points = map(self.world.points, self.detectors)
        found = dict.fromkeys(float(point.per_run) for each in points for point in each)
        return list(found) or [run_probability(STANDARD_RATE, self.world.setup.window_s)]

    def zero_alarm(self, detector: PlayerSpec, tick: WorkCallback | None = None) -> ZeroAlarm:
        if self.setup is None:
            return ZeroAlarm(None, None, "", f"no limit is known for {self.world.setup.whose}", [])
        if detector.label not in self._bounds:
            found = zero_alarm_bounds(self.setup, self.world.judge(detector), self.cases(), tick)
            self._bounds[detector.label] = found
        return self._bounds[detector.label]

    def cases(self, tick: WorkCallback | None = None) -> list[WorldSample]:
        if self._cases is None:
            setup = check_linear_victim(self.world.setup)
            self._cases = draw_worlds(setup, self.worlds, self.entropy, tick)
        return self._cases
