"""The contract of a spoofer: what it knows, an observation in, an action out along its heading."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..policies.contract import Policy

FloatArray = NDArray[np.float64]
LEVELS = ("blind", "tracking", "oracle")
REPORTED = "reported"
KNOWLEDGE = (*LEVELS, *(f"{level}+{REPORTED}" for level in LEVELS))
AXES = ("north", "east", "down", "clock")
"""Axes by which the actions of a false position are named; a heading leaves the last two alone."""
TARGET = "target"  # heading that follows the target direction
TARGET_NAMES = ("target_direction_north", "target_direction_east")
"""Elements of an observation that give the target direction."""
UNIT = 1e-3  # how much the length of an observed direction may differ from 1


class SpooferContext(NamedTuple):
    """What a spoofer is given once, before the first command.

    Attributes
    ----------
    receivers : int
        B.
    interval_s : float
        Time between commands.
    steps : int
        Commands of an episode.
    control : {"rate", "acceleration", "setpoint", "offset"}
        What an action of 1 commands: the limit of the rate or of the acceleration, a wanted rate
        that the acceleration follows, or an offset.
    acceleration_limit_mps2, rate_limit_mps : float
        Of the attack; with control by rate the first one does not bind.
    action_names : tuple of str
        (a,) name of every element of an action, as the attack gives them.
    observation_names : tuple of str
        (o,) name of every element of an observation.
    observation_low, observation_high : tuple of float
        (o,) bounds of every element; empty where they are not known.
    setpoint_mps : float or None
        Rate that an action of 1 requests, with control by set-point.
    base : BaseAttack or None
        What the actions of a policy are added to, where it plays that itself.
    """

    receivers: int
    interval_s: float
    steps: int
    control: str
    acceleration_limit_mps2: float
    rate_limit_mps: float
    action_names: tuple[str, ...]
    observation_names: tuple[str, ...] = ()
    observation_low: tuple[float, ...] = ()
    observation_high: tuple[float, ...] = ()
    setpoint_mps: float | None = None
    base: Any = None

    @property
    def largest_rate(self) -> tuple[str, float]:
        """Largest rate that actions can request [m/s], after the name of what limits it."""
        if self.setpoint_mps is not None and self.setpoint_mps < self.rate_limit_mps:
            return "full_scale_mps` of the action `rate-setpoint", self.setpoint_mps
        return "rate_limit_mps", self.rate_limit_mps


def sees_statistics(knowledge: str) -> bool:
    """Whether this knowledge is an oracle's: the victim's statistics, which no spoofer can have."""
    return knowledge.startswith("oracle")


class Spoofer(Policy[SpooferContext]):
    """A spoofer with memory of B receivers.

    A subclass declares its arrays in `bind` (``self.memory.declare(name, initial)``, with a leading
    axis of receivers) and keeps nothing else from one command to the next, as detectors do.

    Attributes
    ----------
    knowledge : str
        What it observes at run time, one of `KNOWLEDGE`: its own commands and time (blind); also
        the target's true motion and the satellites (tracking); also the victim's statistics
        (oracle); to each of them ``+reported`` adds the position that the victim broadcasts.
    tunable : str or None
        Setting that a search under an alarm budget varies; more of it displaces further.  None for
        the factor on all commands that every spoofer has, `Scaled`.
    label : str or None
        Short name in results; by default it is made of the registered name and the settings.
    designed_on : str
        What it was optimised on before the attack: detector, receiver, scenario; or nothing.
    action_terms : str, mapping, sequence or None
        How its actions command the attack, as ``action=`` of `SpoofEnv`; None as there by default.
    decision_interval_s : float or None
        Time between its decisions; None for every decision of the world.
    between : {"hold", "linear"}
        What it commands between decisions of its own, as in environments.
    transmits : bool
        Whether it counterfeits at all.  An attack that is commanded nothing may still be seen, by
        its tracking error or its delay; where nothing is transmitted, measurements are authentic.
    memory : Memory
        What it remembers of every receiver.
    """

    knowledge: str
    tunable: ClassVar[str | None] = None
    transmits: ClassVar[bool] = True
    action_terms: Any = "full-command"
    decision_interval_s: float | None = None
    between: str = "hold"
    label: str | None = None
    designed_on: str = "nothing"

    @abstractmethod
    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        """Command the coming epoch: (B, a) in [-1, 1], C-contiguous, of observations (B, o)."""

    @classmethod
    def tuning_range(cls, context: SpooferContext) -> tuple[float, float]:
        """Range of the tunable setting that is worth a search, both above 0."""
        raise ValueError(f"{cls.__name__} has no setting to tune")


def list_axes(action_names: tuple[str, ...]) -> list[str]:
    """Axes or channels of an action, (a,): its names without their unit."""
    return [name.rsplit("_", 1)[0] for name in action_names]


def has_heading(action_names: tuple[str, ...]) -> bool:
    """Whether the axes are those of a false position, besides residuals that it leaves alone."""
    return {a for a in list_axes(action_names) if not a.startswith("residual")} <= set(AXES)


def direction(action_names: tuple[str, ...], heading_deg: float) -> FloatArray:
    """Unit command along a heading, or the same command for every channel: (a,) in [-1, 1]."""
    axes = list_axes(action_names)
    if not has_heading(action_names):
        return np.ones(len(axes))
    heading = math.radians(heading_deg % 360.0)
    wanted = {"north": math.cos(heading), "east": math.sin(heading), "down": 0.0, "clock": 0.0}
    for name, part in wanted.items():
        if abs(part) < 1e-12:
            wanted[name] = 0.0
        elif name not in axes:
            raise ValueError(
                f"`heading_deg` = {heading_deg:g} needs a command to the {name}, but the attack "
                f"commands {', '.join(action_names)}"
            )
    return np.array([wanted.get(name, 0.0) for name in axes])


class HeadingCommand:
    """Unit command along a heading, clockwise from north, or that of every observation, turned by
    `turned_deg`; or the same command for every channel."""

    def __init__(
        self, context: SpooferContext, heading_deg: float | str, turned_deg: float = 0.0
    ) -> None:
        names = context.action_names
        _check_offsets(context)
        self._columns: list[int] = []
        self._size, self._turned = len(names), math.radians(turned_deg)
        if isinstance(heading_deg, str) and has_heading(names):
            self._columns, self._places = _columns(context), _places(names)
        else:
            fixed = 0.0 if isinstance(heading_deg, str) else heading_deg
            self._fixed = direction(names, fixed + turned_deg)

    def __call__(self, observation: NDArray[np.float32]) -> FloatArray:
        """Unit command (B, a), or (a,) where no observation (B, o) gives the target direction."""
        if not self._columns:
            return self._fixed
        north, east = (observation[:, k].astype(np.float64) for k in self._columns)
        right = np.abs(np.hypot(north, east) - 1.0) < UNIT
        if not right.all():
            row = np.flatnonzero(~right)[0]
            raise ValueError(
                f"the target direction that receiver {row} observes, ({north[row]:g}, "
                f"{east[row]:g}), has not the length 1: `heading_deg` = 'target' needs "
                "observations as the environment makes them"
            )
        cosine, sine = math.cos(self._turned), math.sin(self._turned)
        command = np.zeros((len(observation), self._size))
        command[:, self._places[0]] = cosine * north - sine * east
        command[:, self._places[1]] = sine * north + cosine * east
        return np.clip(command, -1.0, 1.0)


def _check_offsets(context: SpooferContext) -> None:
    """A script of rates along a heading needs rates, and a basis that has a heading."""
    names = context.action_names
    if context.control == "offset":
        raise ValueError(
            "a scripted spoofer commands rates: it needs `control` 'rate', got 'offset'"
        )
    if context.control == "setpoint" and names[0].startswith("slot"):
        raise ValueError(
            "a scripted spoofer pushes along a heading: it needs the `basis` 'position+clock' or "
            f"'rotated', got 'satellites' with {', '.join(names)}"
        )


def _columns(context: SpooferContext) -> list[int]:
    seen = context.observation_names
    if not set(TARGET_NAMES) <= set(seen):
        raise ValueError(
            f"`heading_deg` = 'target' needs {' and '.join(TARGET_NAMES)} among the observations: "
            "add them by target_heading_deg='random', or by the observation term "
            "'target-direction'"
        )
    return [seen.index(name) for name in TARGET_NAMES]


def _places(action_names: tuple[str, ...]) -> list[int]:
    axes = list_axes(action_names)
    for name in AXES[:2]:
        if name not in axes:
            raise ValueError(
                f"`heading_deg` = 'target' needs a command to the {name}, but the attack commands "
                f"{', '.join(action_names)}"
            )
    return [axes.index(name) for name in AXES[:2]]


@settings_record(kw_only=True)
class ScriptedSpoofer(Spoofer):
    r"""Pushes along one line by a rule for the rate of every epoch, open loop.

    The rate v and the displacement D that it has commanded follow the attack's own kinematics,

    .. math:: D^+ = D + \tfrac12 (v + v^+) \tau \quad\text{by acceleration}, \qquad
        D^+ = D + v^+ \tau \quad\text{by rate}

    and a subclass chooses the rate it wants next; limits are enforced here.
    """

    heading_deg: float | str = setting(
        default=90.0,
        one_of=(TARGET,),
        unit="deg",
        help="Direction of a false position, clockwise from north; or the target direction, where "
        'it is observed: ``target_heading_deg="random"`` draws it for every episode.  An attack on '
        "single channels has no heading: the same offset is commanded on all of its channels, and "
        "moves the receiver's clock alone where these are all satellites in view.",
    )

    knowledge = "blind"

    def bind(self, context: SpooferContext) -> None:
        """Prepare for a batch of receivers, by its sizes, limits and names."""
        super().bind(context)
        self._aim = HeadingCommand(context, self.heading_deg)
        for name in ("step", "rate", "displacement"):
            self.memory.declare(name, np.zeros(context.receivers))

    @abstractmethod
    def next_rate(self, step: FloatArray, rate: FloatArray, displacement: FloatArray) -> FloatArray:
        """Rate (B,) that is wanted at the end of the coming epoch [m/s], of those so far (B,)."""

    def wanted_rate(self, observation: NDArray[np.float32]) -> FloatArray:
        """(B,) `next_rate` of all receivers [m/s]; a spoofer that is not blind looks here."""
        memory = self.memory
        return self.next_rate(memory["step"], memory["rate"], memory["displacement"])

    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        """Command the coming epoch: (B, a) in [-1, 1], within the limits of the attack."""
        memory, wanted = self.memory, self.wanted_rate(observation)
        size, rate, mean = self._follow(
            memory["rate"], wanted, lambda size, most: np.minimum(np.maximum(size, -most), most)
        )
        memory["displacement"] = memory["displacement"] + mean * self.context.interval_s
        memory["rate"] = rate
        memory["step"] = memory["step"] + 1.0
        return np.ascontiguousarray(size[:, None] * self._aim(observation))

    def _follow(
        self, rate: FloatArray, wanted: FloatArray, shorten: Callable[..., FloatArray]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Size of the command from one rate towards another, and the rate after and the mean rate
        of the epoch; ``shorten(vector, most)`` keeps the attack's limits."""
        context = self.context
        _, limit = context.largest_rate
        allowed = shorten(wanted, limit)
        if context.control == "rate":
            return allowed / limit, allowed, allowed
        most = context.acceleration_limit_mps2 * context.interval_s
        size = shorten((allowed - rate) / most, 1.0)
        after = rate + size * most
        mean = 0.5 * (rate + after)
        setpoint = context.setpoint_mps
        return size if setpoint is None else allowed / setpoint, after, mean


def check_limit(spoofer: Spoofer, name: str, limit_name: str, limit: float) -> None:
    value: Any = getattr(spoofer, name)
    if abs(value) > limit:
        raise ValueError(
            f"`{name}` = {value:g} is more than the attack allows: `{limit_name}` = {limit:g}"
        )
