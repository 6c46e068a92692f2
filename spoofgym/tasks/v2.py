"""S1-S3 and D1-D3 of `spoofgym-bench-v2`: environments whose settings never change.

S1 to S3 are for spoofers, D1 to D3 for detectors, in the same worlds.  Attacks last 150, 600 and
1800 s.  They begin when receiver and detectors have been on for a minute to an hour, of which the
logarithm is uniform; sky, heading, part of the flight and the constants of the inertial sensors are
drawn for every episode, the sensors' biases wander, and events that look like spoofing come by
chance.  The detector is solution separation with a filter of its own that models the world, and a
bank that covers the attack.  `docs/tasks.md` has what a task must pass before it is one.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from .base import COMMON, RATE, AttackFamily, DetectorTask, Task

AGES_S = (60.0, 3600.0)
"""Of receiver and detectors at the onset."""
TIME_TO_ALERT_S = 10.0


def _world(scenario: dict[str, Any], attack_s: float, decision_s: float) -> dict[str, Any]:
    events = {"clock_step": 0.1, "satellite_loss": 0.1, "front": 0.1}
    return {
        "scenario": {**scenario, "in_run": "wandering", "imu_rate_hz": 20.0},
        "receiver": "matched",
        "timeline": {"warmup_s": AGES_S[0], "live_s": 50.0, "attack_s": attack_s},
        "decision_interval_s": decision_s,
        "between": "linear",
        "domain": {
            "start_s": [0.0, None],
            "age_s": list(AGES_S),
            "turned_deg": [0.0, 360.0],
            "constellation_time_s": [0.0, 86_400.0],
            "worlds": 32,
            "turns": 8,
            "turn_on": "drawn",
            "events": {**events, "within_s": attack_s + TIME_TO_ALERT_S},
        },
    }


def _reference(attack_s: float) -> dict[str, Any]:
    """Solution separation on a filter that models the world, with a bank that covers an attack."""
    return {
        "name": "solution-separation",
        "filter": "augmented",
        "spacing": "geometric",
        "longest_s": attack_s + TIME_TO_ALERT_S,
        **RATE,
    }


TASKS: dict[str, Task] = {
    task.key: replace(task, version=2)
    for task in (
        Task(
            "S1",
            "airborne signals, tactical sensors, 150 s in a terminal area, alert limit 30 m",
            _world({"name": "aviation-actual", "flight": "terminal"}, 150.0, 10.0),
            (_reference(150.0),),
            30.0,
        ),
        Task(
            "S2",
            "aviation sensors, ten minutes in a terminal area, alert limit 70 m",
            _world({"name": "trolley", "flight": "terminal"}, 600.0, 30.0),
            (_reference(600.0),),
            70.0,
        ),
        Task(
            "S3",
            "aviation sensors, half an hour en route, alert limit 556 m",
            _world({"name": "trolley", "flight": "en-route"}, 1800.0, 60.0),
            (_reference(1800.0),),
            556.0,
        ),
    )
}
"""The tasks for spoofers by their keys."""

FAMILIES = (
    COMMON["ramps"],
    COMMON["profiles"],
    AttackFamily(
        "open-loop", "a drift whose rate over time a search finds against this detector", "o"
    ),
    *(family for key, family in COMMON.items() if key not in ("ramps", "profiles")),
    AttackFamily(
        "early",
        "onset 10 s to a minute after switch-on",
        "ah",
        True,
        timeline={"warmup_s": 10.0, "live_s": 5.0},
        domain={"age_s": [10.0, AGES_S[0]]},
    ),
    AttackFamily(
        "late",
        "onset one to two hours after switch-on",
        "ah",
        True,
        domain={"age_s": [AGES_S[1], 7200.0]},
    ),
)
"""Attacks of campaigns and of tasks for detectors, one list for both."""

DETECTOR_TASKS: dict[str, DetectorTask] = {
    key: DetectorTask(key, TASKS[of].title, TASKS[of], FAMILIES)
    for key, of in (("D1", "S1"), ("D2", "S2"), ("D3", "S3"))
}
"""The tasks for detectors by their keys."""
