"""T1-T6 and v1/D1 to v1/D4 of `spoofgym-bench-v1`, which `v2` replaces.

They stay playable.  Every attack of theirs begins at one age and is as long as the bank of the
detector that they crown; the inertial sensors' constants never wander, and solution separation is
that of a filter that does not model the world.

A task is an environment with detectors of a stated rate of false alarms, and an alarm budget.
What a spoofer scores is its stealthy displacement by the rules of the benchmark; it is read
together with what ramps and the open-loop attack get there, and with the task's floor and
zero-alarm bound.  T1 and T2 are historical: the world of the papers.

v1/D1 to v1/D4 are for detectors, in the worlds of T3 to T6.  They may be trained and tuned on the
public families of attacks, and are scored by the worst of all families, most of which they have
never met, and by their false alarms, also where something happens that looks like spoofing.
"""

from __future__ import annotations

from dataclasses import replace

from .base import COMMON, RANGE_RATES, RATE, AttackFamily, DetectorTask, Task

EWMA = {"name": "ewma", "smoothing": 0.1, "weight_scale": 0.3}
DRAWN = {
    "start_s": [0.0, None],
    "turned_deg": [0.0, 360.0],
    "constellation_time_s": [0.0, 86_400.0],
    "worlds": 32,
    "turn_on": "drawn",
}
"""What every headline draws: onset, heading, sky and the turn-on constants of the sensors.  Which
way an attack pushes is fixed, so that its angle to the flight is drawn, too."""
LONG_SEPARATION = {"name": "solution-separation", "longest_s": 360.0, "spacing_s": 60.0}
"""A bank of coasting solutions that covers an attack of 325 s."""

TASKS: dict[str, Task] = {
    task.key: task
    for task in (
        Task(
            "T1",
            "the papers' world, snapshot chi-square",
            {"scenario": "zhong2025", "attack": "false-position-ideal"},
            ({"name": "snapshot-chi2", **RATE},),
            historical=True,
        ),
        Task(
            "T2",
            "the papers' world, EWMA chart with weights",
            {"scenario": "zhong2025", "attack": "false-position-ideal"},
            ({**EWMA, **RATE},),
            historical=True,
        ),
        Task(
            "T3",
            "drawn worlds, matched receiver, solution separation, alert limit 20 m",
            {"scenario": "trolley", "receiver": "matched", "domain": DRAWN},
            ({"name": "solution-separation", **RATE},),
            20.0,
        ),
        Task(
            "T4",
            "tactical sensors, five minutes along an airway, alert limit 556 m",
            {
                "scenario": {"name": "trolley-tactical", "flight": "airway"},
                "receiver": "matched",
                "timeline": {"warmup_s": 500.0, "live_s": 420.0, "attack_s": 325.0},
                "domain": DRAWN,
            },
            ({**LONG_SEPARATION, **RATE},),
            556.0,
        ),
        Task(
            "T5",
            "drawn worlds, a counterfeit that is quieter than nature, alert limit 20 m",
            {"scenario": "trolley", "receiver": "matched", "attack": "quiet", "domain": DRAWN},
            ({"name": "solution-separation", **RATE},),
            20.0,
        ),
        Task(
            "T6",
            "one of eight hidden detectors, whose thresholds differ, alert limit 40 m",
            {"scenario": "trolley", "receiver": "matched", "domain": DRAWN},
            tuple(
                {**detector, "false_alarms_per_hour": rate}
                for detector in (
                    {"name": "solution-separation"},
                    {"name": "aime", **RANGE_RATES},
                    {"name": "sequential-chi2", **RANGE_RATES},
                    {"name": "cumulative-bank", **RANGE_RATES},
                )
                for rate in (0.1, 0.4)
            ),
            40.0,
        ),
    )
}
"""The tasks by their keys."""
PUBLIC = (
    COMMON["ramps"],
    COMMON["profiles"],
    AttackFamily("blind-optima", "the shipped profiles, optimised on other detectors", "c"),
    COMMON["feedback"],
    COMMON["dashes"],
)
EARLY = {"warmup_s": 140.0, "live_s": 120.0}
"""The flight of T3, T5 and T6 turns up to its 176th second, before their attacks begin: here the
receiver has been on for a minute less, and the onset is as early as 140 s."""


def _held_out(quiet: bool, timeline: dict[str, float] | None) -> tuple[AttackFamily, ...]:
    plain, subset = {"name": "false-position"}, COMMON["subset"]
    inherited = AttackFamily(
        "inherited", "nature's errors stay in the counterfeit", "ah", True, plain
    )
    if quiet:
        subset = replace(subset, attack={**(subset.attack or {}), "errors": "quiet"})
    return (
        inherited if quiet else COMMON["quiet"],
        subset,
        COMMON["meaconer"],
        *(replace(COMMON[key], timeline=timeline) for key in ("turn", "satellite-switch")),
        COMMON["chance-alarm"],
    )


QUIETER = "a counterfeit that is quieter than nature, alert limit 20 m"
DETECTOR_TASKS: dict[str, DetectorTask] = {
    key: DetectorTask(key, title, TASKS[of], (*PUBLIC, *_held_out(quiet, timeline)))
    for key, title, of, quiet, timeline in (
        ("v1/D1", "drawn worlds, alert limit 20 m", "T3", False, EARLY),
        ("v1/D2", TASKS["T4"].title, "T4", False, None),
        ("v1/D3", QUIETER, "T5", True, EARLY),
        ("v1/D4", "drawn worlds, alert limit 40 m", "T6", False, EARLY),
    )
}
"""The tasks for detectors by their keys."""
