"""From settings that fit into JSON to a game."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .._registry import build_record, check_choice
from ..attacks import Attack, make_attack
from ..detectors import Detector, make_detector
from ..receiver import TightlyCoupled
from ..sim.scenario import Scenario, make_scenario
from .domain import Domain
from .ends import AtAlarm, EndTerm
from .game import Game
from .observations import KNOWLEDGE, ObservationTerm, TargetDirection, terms_of
from .played import check_end_at_alarm
from .rewards import default_rewards
from .setup import Setup, Timeline
from .terms import ActionSpec, EndSpec, ObservationSpec, RewardSpec, make_terms

DEFAULT_DETECTOR: dict[str, Any] = {"name": "ewma", "smoothing": 0.1, "weight_scale": 0.3}
DEFAULT_ATTACK = "false-position"
DEFAULT_PENALTY_M = 10.0
RECEIVERS: dict[str, dict[str, Any]] = {
    "paper": {"tuning": "paper"},
    "matched": {"tuning": "matched"},
}
"""Victims by name: the noise that they assume as the papers print it, or as the world has it."""


WatchSpec = str | Mapping[str, Any] | Detector | Sequence[str | Mapping[str, Any] | Detector]
"""Detectors beside the one in the loop."""


def make_watch(spec: WatchSpec) -> tuple[Detector, ...]:
    """Detectors beside the one in the loop."""
    if isinstance(spec, str | Mapping | Detector):
        spec = (spec,)
    if not isinstance(spec, Sequence):
        raise TypeError(f"`watch` must be a detector or a list of detectors, got {spec!r}")
    return tuple(make_detector(each) for each in spec)


def make_setup(
    *,
    scenario: str | Mapping[str, Any] | Scenario = "zhong2025",
    receiver: str | Mapping[str, Any] | TightlyCoupled | None = None,
    attack: str | Mapping[str, Any] | Attack = DEFAULT_ATTACK,
    detector: str | Mapping[str, Any] | Detector | None = None,
    timeline: Mapping[str, float] | Timeline | None = None,
    domain: Mapping[str, Any] | Domain | None = None,
    target_heading_deg: float | str = 90.0,
    decision_interval_s: float | None = None,
    between: str = "hold",
) -> Setup:
    """Everything that the receivers of an engine share.

    Parameters
    ----------
    scenario : str, mapping or Scenario
        As `make_scenario` takes it.
    receiver : str, mapping or TightlyCoupled, optional
        A name in `RECEIVERS`, or settings of `TightlyCoupled`; its grade is that of the scenario's
        sensors by default.
    attack : str, mapping or Attack
        As `make_attack` takes it.
    detector : str, mapping or Detector, optional
        As `make_detector` takes it; `DEFAULT_DETECTOR` by default.
    timeline : mapping or Timeline, optional
        Settings of `Timeline`.
    domain : mapping or Domain, optional
        Settings of `Domain`.
    target_heading_deg, decision_interval_s, between : optional
        As in `Setup`.

    Returns
    -------
    Setup
        For `Engine` or `Game`.
    """
    world = make_scenario(scenario)
    if isinstance(receiver, str):
        check_choice("receiver", receiver, RECEIVERS)
        receiver = RECEIVERS[receiver]
    circumstances = build_record("domain", Domain, domain)
    victim = build_record("receiver", TightlyCoupled, receiver, {"grade": world.imu})
    if isinstance(receiver, Mapping) and "grade" in receiver:
        _check_grade(victim.grade, circumstances.imu)
    phases = build_record("timeline", Timeline, timeline)
    judge = make_detector(DEFAULT_DETECTOR if detector is None else detector)
    return Setup(
        world,
        victim,
        make_attack(attack),
        judge,
        phases,
        circumstances,
        target_heading_deg,
        decision_interval_s,
        between,
    )


def _check_grade(grade: str, grades: Sequence[str]) -> None:
    """Raise where a receiver is told another grade than those that its sensors are drawn from."""
    if any(other != grade for other in grades):
        raise ValueError(
            f"`receiver` has the grade {grade!r}, but is tuned for the grade that it draws from "
            f"the domain's `imu` {', '.join(grades)}: leave out one"
        )


def default_terms(setup: Setup, knowledge: str) -> tuple[ObservationTerm, ...]:
    """Terms of a level, and the target direction where it differs from episode to episode."""
    drawn = (TargetDirection(),) if setup.target_heading_deg == "random" else ()
    return (*terms_of(knowledge), *drawn)


def make_game(
    receivers: int,
    setup: Setup,
    *,
    knowledge: str = "tracking",
    observation: ObservationSpec | None = None,
    action: ActionSpec | None = None,
    reward: RewardSpec | None = None,
    end: EndSpec | None = None,
    watch: WatchSpec = (),
    alarm_penalty_m: float = 10.0,
    end_at_alarm: bool = True,
    threads: int | None = None,
    prefetch: bool = False,
    twin: bool = False,
) -> Game:
    """Game with the observation of a level of knowledge.

    Parameters
    ----------
    receivers : int
        B.
    setup : Setup
        World, victim, attack, detector, timeline.
    knowledge : {"blind", "tracking", "oracle"}
        What the spoofer observes, where `observation` does not say it.
    observation, action, reward, end : optional
        Terms, as `make_terms` takes them.
    watch : sequence of str, mapping or Detector
        Detectors beside the one in the loop, each as `make_detector` takes it.
    alarm_penalty_m : float
        Price of an alarm, where `reward` does not say it.
    end_at_alarm : bool
        Whether an alarm ends the episode, where `end` does not say it.
    threads, prefetch, twin : optional
        As in `Game`.

    Returns
    -------
    Game
        Not reset yet.

    Raises
    ------
    ValueError
        When a setting is unknown, or two of them contradict each other.
    """
    check_choice("knowledge", knowledge, KNOWLEDGE)
    check_end_at_alarm(end_at_alarm)
    terms = None if end is None else make_terms("end", end)
    _check_beside(alarm_penalty_m, reward, end_at_alarm, terms)
    return Game(
        receivers,
        setup,
        observation=(
            default_terms(setup, knowledge)
            if observation is None
            else make_terms("observation", observation)
        ),
        action=None if action is None else make_terms("action", action),
        reward=(
            default_rewards(alarm_penalty_m) if reward is None else make_terms("reward", reward)
        ),
        end=terms,
        watch=make_watch(watch),
        end_at_alarm=end_at_alarm,
        threads=threads,
        prefetch=prefetch,
        twin=twin,
    )


def _check_beside(
    alarm_penalty_m: float,
    reward: RewardSpec | None,
    end_at_alarm: bool,
    end: Sequence[EndTerm] | None,
) -> None:
    """Raise where lists of terms leave a setting without an effect."""
    if reward is not None and alarm_penalty_m != DEFAULT_PENALTY_M:
        raise ValueError(
            f"`alarm_penalty_m` is part of the default reward, and `reward` is given: list "
            f"{{'name': 'alarm-penalty', 'penalty_m': {alarm_penalty_m!r}}} there"
        )
    if end is not None and not end_at_alarm and any(isinstance(term, AtAlarm) for term in end):
        raise ValueError("`end` lists 'at-alarm', but `end_at_alarm` is False: leave out one")
