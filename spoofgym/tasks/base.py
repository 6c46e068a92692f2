"""What a task is: an environment whose settings never change, for a spoofer or for a detector."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

from ..core.registry import check_choice

ALARM_PRICE = 1.5
"""What an alarm costs in the reward of the environments, as by default elsewhere, in lengths."""


def name_environment(key: str, version: int) -> str:
    """Id of a task's environment; the key of an older version's task is ``v1/D1`` or the like."""
    return f"spoofgym/Bench{key.rpartition('/')[2]}-v{version}"


@dataclass(frozen=True)
class Task:
    """One task for spoofers.

    Attributes
    ----------
    key, title : str
        Name, and what it requires, in a line.
    settings : dict
        Keyword arguments of `SpoofEnv`, JSON-able, but for the detector.
    detectors : tuple of dict
        Those that the spoofer meets, as `make_detector` takes them; of several, every episode draws
        one, which the spoofer does not know.
    alert_limit_m : float or None
        Error that the navigation must not exceed unnoticed [m].
    historical : bool
        Whether it stays for results published on its world, and is solved there.
    version : int
        Of the suite that it is of.
    """

    key: str
    title: str
    settings: dict[str, Any]
    detectors: tuple[dict[str, Any], ...]
    alert_limit_m: float | None = None
    historical: bool = False
    version: int = 1

    @property
    def suite(self) -> str:
        """Name of the tasks of a version together; a change of any of them makes another one."""
        return f"spoofgym-bench-v{self.version}"

    @property
    def env_id(self) -> str:
        return name_environment(self.key, self.version)

    @property
    def rule(self) -> str:
        """How amplitudes of spoofers are fitted to the alarm budget; figures of the first suite are
        by the upper limit of the alarm rate."""
        return "upper-limit" if self.version == 1 else "exact"

    @property
    def pooled(self) -> bool:
        return len(self.detectors) > 1

    @property
    def detector(self) -> dict[str, Any]:
        """The detector of the task, a pool if it has several, for `make_detector`; a copy."""
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
RANGE_RATES = {"signals": "range_rate"}
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

    Attributes
    ----------
    key, title : str
        Name, and what it does, in a line.
    letters : str
        Attacks of the suite; ``"c"`` are the shipped profiles, ``"m"`` is a meaconer at the worst
        distance of its antenna, ``"o"`` profiles that are searched for against the detector.
    held_out : bool
        Whether no detector may be trained or tuned on it.
    attack : dict or None
        In place of that of the task's world.
    timeline, domain : dict or None
        What differs from those of that world.
    onset : str or None
        One of `ONSETS`.
    """

    key: str
    title: str
    letters: str
    held_out: bool = False
    attack: dict[str, Any] | None = None
    timeline: dict[str, float] | None = None
    onset: str | None = None
    domain: dict[str, Any] | None = None


COMMON = {
    family.key: family
    for family in (
        AttackFamily("ramps", "drifts at a constant or a growing rate", "a"),
        AttackFamily("profiles", "drifts whose rate grows by one of three fixed curves", "b"),
        AttackFamily(
            "feedback", "a drift that slows as the detector's statistic, which it sees, grows", "e"
        ),
        AttackFamily(
            "dashes", "no drift, then one at a constant rate in the attack's last 40 or 15 %", "h"
        ),
        AttackFamily(
            "quiet",
            "signals with less noise than real ones",
            "ah",
            True,
            {"name": "false-position", "errors": "quiet"},
        ),
        AttackFamily(
            "subset",
            "every second satellite is spoofed",
            "ah",
            True,
            {"name": "false-position", "channels": [f"slot{k:02d}" for k in range(0, 12, 2)]},
        ),
        AttackFamily(
            "meaconer",
            "another antenna's signals, east of the target, replayed",
            "m",
            True,
            {"name": "meaconer"},
        ),
        AttackFamily("turn", "onset in a turn", "ah", True, onset="turn"),
        AttackFamily(
            "satellite-switch",
            f"onset within {SWITCH_WITHIN_S:g} s of a satellite's rise or set",
            "ah",
            True,
            onset="satellite-switch",
        ),
        AttackFamily(
            "chance-alarm",
            f"onset within {NEAR_ALARM_S:g} s after a false alarm, or a statistic close to one",
            "ah",
            True,
            onset="chance-alarm",
        ),
    )
}
"""Families that both suites have, by their keys."""


@dataclass(frozen=True)
class DetectorTask:
    """A task for detectors.

    Attributes
    ----------
    key, title : str
        Name, and its world, in a line.
    task : Task
        Whose world and alert limit it has.
    families : tuple of AttackFamily
        Attacks that it is scored by.
    """

    key: str
    title: str
    task: Task
    families: tuple[AttackFamily, ...]

    @property
    def suite(self) -> str:
        return self.task.suite

    @property
    def env_id(self) -> str:
        return name_environment(self.key, self.task.version)

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

    def get_overrides(self, family: AttackFamily) -> dict[str, Any]:
        """Settings of the world in which a family attacks, where they are others; a copy."""
        found = {} if family.attack is None else {"attack": family.attack}
        for name in ("timeline", "domain"):
            if (changed := getattr(family, name)) is not None:
                found[name] = {**self.world_kwargs.get(name, {}), **changed}
        return copy.deepcopy(found)

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
        # where ages are drawn, nothing that a learner is shown gives the onset away
        within = {"onset": "within"} if "age_s" in self.world_kwargs["domain"] else {}
        return {**self.world_kwargs, **within, "pool": self.pool}


def _round_setting(value: float) -> float:
    return float(f"{value:.4g}")


def _rate(value: float) -> float:
    return _round_setting(min(value, RATE_LIMIT_MPS))
