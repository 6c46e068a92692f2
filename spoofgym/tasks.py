"""T1-T6 and D1-D4 of `spoofgym-bench-v1`: environments whose settings never change.

A task is an environment with detectors of a stated rate of false alarms, and an alarm budget.
What a spoofer scores is its stealthy displacement by the rules of the benchmark; it is read
together with what ramps and the blind optimum get there, and with the task's floor and zero-alarm
bound.  T1 and T2 are historical: the world of the papers.  T3 to T6 had to pass the admission test
of `docs/tasks.md`.

D1 to D4 are for detectors, in the worlds of T3 to T6.  They may be trained and tuned on the public
families of attacks, and are scored by the worst of all families, most of which they have never met,
and by their false alarms, also where something happens that looks like spoofing.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

from .core.registry import check_choice

SUITE = "spoofgym-bench-v1"  # name of the tasks together; a change of any of them makes another one
ALARM_PRICE = 1.5
"""What an alarm costs in the reward of the environments, as by default elsewhere, in lengths."""
BUDGET = 0.05  # largest P(alarm | silent twin) of a spoofer that scores


@dataclass(frozen=True)
class Task:
    """One task.

    - `title`: what it requires, in a line;
    - `settings`: keyword arguments of `SpoofEnv`, JSON-able, but for the detector;
    - `detectors`: those that the spoofer meets, as `make_detector` takes them; of several, every
      episode draws one, which the spoofer does not know;
    - `alert_limit_m`: error that the navigation must not exceed unnoticed, or None;
    - `historical`: stays for results published on its world, and is solved there.
    """

    key: str
    title: str
    settings: dict[str, Any]
    detectors: tuple[dict[str, Any], ...]
    alert_limit_m: float | None = None
    historical: bool = False

    @property
    def env_id(self) -> str:
        return f"spoofgym/Bench{self.key}-v1"

    @property
    def pooled(self) -> bool:
        return len(self.detectors) > 1

    @property
    def detector(self) -> dict[str, Any]:
        """The detector of the task, a pool if it has several, as `make_detector` takes it; a
        copy."""
        detector = {"name": "pool", "members": list(self.detectors)}
        return copy.deepcopy(detector if self.pooled else self.detectors[0])

    @property
    def env_kwargs(self) -> dict[str, Any]:
        length = {} if self.alert_limit_m is None else {"length_m": self.alert_limit_m}
        if not self.pooled:
            return {**self.world_kwargs, **length, "detector": self.detector}
        # a view pays no alarm penalty unless it is set to, and all tasks are paid alike
        pool = {"pool": list(self.detectors), "alarm_price": ALARM_PRICE}
        return copy.deepcopy({**self.settings, **length, **pool})

    @property
    def world_kwargs(self) -> dict[str, Any]:
        return copy.deepcopy(self.settings)

    @property
    def suite_kwargs(self) -> dict[str, Any]:
        limit = {} if self.alert_limit_m is None else {"alert_limit_m": self.alert_limit_m}
        return {**self.world_kwargs, "detectors": (self.detector,), **limit}


RATE = {"false_alarms_per_hour": 0.2}
"""Of every detector of the tasks, but for the hidden ones of T6."""
NOMINAL = {"thresholds": "nominal"}  # thresholds of the papers, as their own environments have them
EWMA = {"name": "ewma", "smoothing": 0.1, "weight_scale": 0.3}
DRAWN = {
    "start_s": [0.0, None],
    "turned_deg": [0.0, 360.0],
    "constellation_time_s": [0.0, 86_400.0],
    "worlds": 32,
    "turn_on": "drawn",
}
"""What every headline draws: onset, heading, sky and the turn-on constants of the sensors."""
RANGE_RATES = {"signals": "range_rate"}
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
RANGE_RATE_TESTS: tuple[dict[str, Any], ...] = tuple(
    {"name": name, **RANGE_RATES}
    for name in (
        "aime",
        "cumulative-bank",
        "cusum",
        "fma",
        "sequential-chi2",
        "shewhart",
        "snapshot-chi2",
        "windowed-chi2",
    )
)
"""Detectors that test range rates alone, where their defaults test pseudoranges, or both."""


def get_task(key: str) -> Task:
    """Task by its key.

    Parameters
    ----------
    key : str
        ``"T1"`` to ``"T6"``.

    Returns
    -------
    Task
        The task.

    Raises
    ------
    ValueError
        Without such a task; the valid ones are listed.

    Examples
    --------
    >>> from spoofgym.tasks import get_task
    >>> get_task("T4").alert_limit_m
    556.0
    """
    check_choice("task", key, TASKS)
    return TASKS[key]


PAPERS: dict[str, tuple[str, dict[str, Any]]] = {
    "ke2022": (
        "spoofgym/TightlyCoupled-v0",
        {
            "scenario": "ke2022",
            "attack": "paper-ideal",
            "detector": {"name": "innovation-rate", **NOMINAL},
            "timeline": {"warmup_s": 350.0, "live_s": 150.0, "attack_s": 200.0},
        },
    ),
    "shadmehri2025": (
        "spoofgym/LooselyCoupled-v0",
        {
            "detector": {
                "name": "windowed-chi2",
                "window": 1,
                "covariance": "estimated",
                "covariance_window": 100,
                **NOMINAL,
            }
        },
    ),
    "song2021": (
        "spoofgym/WheeledRobot-v0",
        {"detector": {"name": "acna", "variant": "production", **NOMINAL}},
    ),
    "wu2024": ("spoofgym/Snapshot-v0", {"detector": {"name": "srv-raim", **NOMINAL}}),
    "zhong2025": (
        "spoofgym/TightlyCoupled-v0",
        {"scenario": "zhong2025", "attack": "paper-ideal", "detector": {**EWMA, **NOMINAL}},
    ),
}
"""Environments of the papers' scenarios: id and keyword arguments, by the keys of the papers."""


TURNING_DEGPS = 0.3  # A flight turns where its track turns faster than this
SWITCH_WITHIN_S = 10.0  # time before or after the onset at which a satellite rises or sets
NEAR_ALARM_S = 60.0
"""Last part of the monitored warm-up, in which a detector came closest to an alarm."""
CANDIDATES = 4  # of so many runs, those closest to an alarm are one: the closest quarter
ONSETS = ("turn", "satellite-switch", "chance-alarm")
"""Conditions on the onset of an attack; runs are chosen by them, and nothing else is changed."""
ANTENNA_PARTS = (0.25, 4.0)
"""Distance of a meaconer's antenna from its target, in parts of the alert limit."""
PARTS = (0.5, 1.0, 2.0)
"""Displacements of the learners' pool at the end of the attack, in parts of the alert limit."""
EVENTS = ("clock_step", "satellite_loss", "front")
"""Events that look like spoofing but are not, as in `spoofgym.truth.events`."""
MEAN_GROWTH = 2.375
"""Mean rate of feedback over a window, in parts of its first one, while there is room."""
RATE_LIMIT_MPS = 5.0  # of the tasks' attacks


@dataclass(frozen=True)
class AttackFamily:
    """Attacks that have something in common, of which the worst one counts.

    - `letters`: attacks of the suite; ``"c"`` are the shipped profiles, ``"m"`` is a meaconer at
      the worst distance of its antenna;
    - `held_out`: whether no detector may be trained or tuned on it;
    - `attack`, `timeline`: in place of those of the task's world; `onset`: one of `ONSETS`.
    """

    key: str
    title: str
    letters: str
    held_out: bool = False
    attack: dict[str, Any] | None = None
    timeline: dict[str, float] | None = None
    onset: str | None = None

    @property
    def overrides(self) -> dict[str, Any]:
        parts = {"attack": self.attack, "timeline": self.timeline}
        return copy.deepcopy({name: x for name, x in parts.items() if x is not None})


@dataclass(frozen=True)
class DetectorTask:
    """A task for detectors: the world and the alert limit of another task, and families of
    attacks."""

    key: str
    title: str
    world_of: str
    families: tuple[AttackFamily, ...]

    @property
    def env_id(self) -> str:
        return f"spoofgym/Bench{self.key}-v1"

    @property
    def task(self) -> Task:
        return TASKS[self.world_of]

    @property
    def alert_limit_m(self) -> float:
        limit = self.task.alert_limit_m
        assert limit is not None  # as all tasks that are not historical have one
        return limit

    @property
    def world_kwargs(self) -> dict[str, Any]:
        return self.task.world_kwargs

    @property
    def public(self) -> tuple[AttackFamily, ...]:
        return tuple(each for each in self.families if not each.held_out)

    @property
    def held_out(self) -> tuple[AttackFamily, ...]:
        return tuple(each for each in self.families if each.held_out)

    def family(self, key: str) -> AttackFamily:
        named = {each.key: each for each in self.families}
        check_choice(f"family of attacks of {self.key}", key, named)
        return named[key]

    @property
    def pool(self) -> list[dict[str, Any]]:
        """Spoofers of the public families for a learner, with their settings; a new list."""
        attack_s = float(self.world_kwargs.get("timeline", {}).get("attack_s", 150.0))
        found: list[dict[str, Any]] = []
        for part in PARTS:  # of the alert limit, by which each would displace; each once
            mean = part * self.alert_limit_m / attack_s
            several: list[dict[str, Any]] = [
                {"name": "ramp", "rate_mps": _rate(mean)},
                {
                    "name": "accelerating-ramp",
                    "acceleration_mps2": _round_setting(2.0 * mean / attack_s),
                },
                {
                    "name": "profile",
                    "rates_mps": [_rate(3.0 * mean * (k / 12) ** 2) for k in range(13)],
                    "label": f"quadratic-{part:g}",
                },
                *(
                    {
                        "name": "dash",
                        "rate_mps": _rate(mean / x),
                        "last_s": _round_setting(x * attack_s),
                    }
                    for x in (0.4, 0.15)
                ),
                # which reads the learner's statistic, and gets so far where it had room throughout
                {"name": "feedback", "rate_mps": _round_setting(mean / MEAN_GROWTH)},
            ]
            found += [spec for spec in several if spec not in found]
        return found

    @property
    def env_kwargs(self) -> dict[str, Any]:
        return {**self.world_kwargs, "pool": self.pool}


def _round_setting(value: float) -> float:
    return float(f"{value:.4g}")


def _rate(value: float) -> float:
    return _round_setting(min(value, RATE_LIMIT_MPS))


PUBLIC = (
    AttackFamily("ramps", "ramps and accelerating ramps", "a"),
    AttackFamily("profiles", "profiles of the rate", "b"),
    AttackFamily("blind-optima", "the shipped profiles, optimised on other detectors", "c"),
    AttackFamily("feedback", "a ramp that yields where the statistic grows", "e"),
    AttackFamily("dashes", "nothing, and then as fast as allowed", "h"),
)
EVERY_SECOND = [f"slot{k:02d}" for k in range(0, 12, 2)]
"""Every second channel of the receivers, in the order of the satellites' ids."""
EARLY = {"warmup_s": 140.0, "live_s": 120.0}
"""The flight of T3, T5 and T6 turns up to its 176th second, before their attacks begin: here the
receiver has been on for a minute less, and the onset is as early as 140 s."""


def _held_out(quiet: bool, timeline: dict[str, float] | None) -> tuple[AttackFamily, ...]:
    plain = {"name": "false-position"}
    own = {**plain, "errors": "quiet"} if quiet else plain
    errors = (
        AttackFamily("inherited", "nature's errors stay in the counterfeit", "ah", True, plain)
        if quiet
        else AttackFamily(
            "quiet", "a counterfeit quieter than nature", "ah", True, {**plain, "errors": "quiet"}
        )
    )
    return (
        errors,
        AttackFamily(
            "subset",
            "every second channel moves, the others stay",
            "ah",
            True,
            {**own, "channels": EVERY_SECOND},
        ),
        AttackFamily(
            "meaconer",
            "another antenna's signals, east of the target, replayed",
            "m",
            True,
            {"name": "meaconer"},
        ),
        AttackFamily("turn", "onset in a turn", "ah", True, None, timeline, "turn"),
        AttackFamily(
            "satellite-switch",
            f"onset within {SWITCH_WITHIN_S:g} s of a satellite's rise or set",
            "ah",
            True,
            None,
            timeline,
            "satellite-switch",
        ),
        AttackFamily(
            "chance-alarm",
            f"onset after an alarm by chance, or near one, in the last {NEAR_ALARM_S:g} s",
            "ah",
            True,
            onset="chance-alarm",
        ),
    )


DETECTOR_TASKS: dict[str, DetectorTask] = {
    task.key: task
    for task in (
        DetectorTask(
            "D1", "drawn worlds, alert limit 20 m", "T3", (*PUBLIC, *_held_out(False, EARLY))
        ),
        DetectorTask(
            "D2",
            "tactical sensors, five minutes along an airway, alert limit 556 m",
            "T4",
            (*PUBLIC, *_held_out(False, None)),
        ),
        DetectorTask(
            "D3",
            "a counterfeit that is quieter than nature, alert limit 20 m",
            "T5",
            (*PUBLIC, *_held_out(True, EARLY)),
        ),
        DetectorTask(
            "D4", "drawn worlds, alert limit 40 m", "T6", (*PUBLIC, *_held_out(False, EARLY))
        ),
    )
}
"""The tasks for detectors by their keys."""


def get_detector_task(key: str) -> DetectorTask:
    """Task for detectors by its key, ``"D1"`` to ``"D4"``; a ValueError lists the valid ones."""
    check_choice("task for detectors", key, DETECTOR_TASKS)
    return DETECTOR_TASKS[key]
