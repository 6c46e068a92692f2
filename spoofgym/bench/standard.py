"""The standard suite: every detector that suits one task's world, against the usual spoofers.

Tests of range rates are there a second time where their defaults test pseudoranges, or both.

World and alert limit are those of the task, the rate of false alarms is the standard one, and the
sizes are such that two idle cores play it in a quarter of an hour.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..detectors.calibrated import STANDARD_RATE
from ..simulators.calibration import suitable_detectors
from ..simulators.setup import Setup
from ..tasks import RANGE_RATE_TESTS, SUITE, task_of
from .specs import spec_of_judge
from .suite import Suite
from .victims import CONTROLS

STANDARD = "standard"
SUITES = (STANDARD,)
"""Names of `spoofgym bench --suite`."""
TASK = "T3"
RATE = STANDARD_RATE
"""False alarms an hour of all detectors."""
SPOOFERS = ("ramp", "accelerating-ramp", "snapshot-chi2-profile", "blind-optimum", "feedback")
"""Each is fitted to the alarm budget."""
SIZES = {"seeds": 400, "training_seeds": 128, "selection_seeds": 48}
"""Evaluation, training and selection runs, where no others are given."""


def everyone_in(setup: Setup, rescaled: bool = False) -> list[dict[str, Any]]:
    """The controls and all classics that suit a world; `rescaled`: also with their innovations."""
    found = [dict(each) for each in CONTROLS]
    for each in suitable_detectors(setup):
        own = {"name": spec_of_judge(each)["name"]}
        if own not in found:
            found.append(own)
        if rescaled and each.drifts:
            found.append({**own, "thresholds": "rescaled"})
    return found


def in_order(everyone: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Controls, solution separation, tests of range rates, which are added, and the others."""
    controls = [dict(spec) for spec in CONTROLS]
    first = [*controls, {"name": "solution-separation"}, *map(dict, RANGE_RATE_TESTS)]
    return [*first, *(dict(spec) for spec in everyone if spec not in first)]


def standard_kwargs() -> dict[str, Any]:
    """Keyword arguments of a `Suite`, but for its detectors."""
    task = task_of(TASK)
    limit = {} if task.alert_limit_m is None else {"alert_limit_m": task.alert_limit_m}
    note = f"suite {STANDARD}: the world of task {task.key} of {SUITE}"
    return {**task.world_kwargs, **limit, "notes": (note,)}


def standard_world() -> Suite:
    return nobody_in(standard_kwargs())


def nobody_in(settings: Mapping[str, Any]) -> Suite:
    """A suite for its world alone, by keyword arguments of a `Suite`: nobody plays."""
    return Suite(**{**settings, "detectors": ["never"], "spoofers": []})
