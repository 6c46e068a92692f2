"""What all receivers of an engine share: world, victim, attack, detector, phases of an episode."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from .._registry import check_choice
from ..attacks import Attack
from ..detectors import Detector
from ..receiver import TightlyCoupled
from ..sim.scenario import Scenario
from ..sim.world import World
from .cases import Cases, worlds_of
from .domain import Bounds, Domain
from .witness import Witness

FloatArray = NDArray[np.float64]
MOST_EPOCHS = 100_000
"""Longest episode."""
FIRST_FIX = 4
"""Satellites that a first fix takes."""
TARGETS = ("random", "worst")
"""Target directions that are no number."""
BETWEEN = ("hold", "linear")
"""What is commanded between two decisions."""


@dataclass(frozen=True, kw_only=True)
class Timeline:
    """Phases of an episode.

    Parameters
    ----------
    warmup_s : float
        Clean run before the attack.
    live_s : float
        Last part of it in which the detectors judge; an alarm there is a false alarm.
    attack_s : float
        Command phase.
    time_to_alert_s : float
        Time to alert: how long the offsets hold their rate after the command phase, with alarms
        live; what was induced within this time of an alarm does not count.
    """

    warmup_s: float = 200.0
    live_s: float = 60.0
    attack_s: float = 150.0
    time_to_alert_s: float = 10.0

    def __post_init__(self) -> None:
        """Check the lengths."""
        for name in ("warmup_s", "live_s", "attack_s", "time_to_alert_s"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"`{name}` must be finite and >= 0, got {value}")
        if self.attack_s <= 0.0:
            raise ValueError(f"`attack_s` must be > 0, got {self.attack_s}")
        if self.live_s > self.warmup_s:
            raise ValueError(
                f"`live_s` must be at most `warmup_s` = {self.warmup_s}, got {self.live_s}"
            )

    def epochs(self, interval_s: float) -> tuple[int, int, int, int]:
        """Phases in epochs."""
        length = self.warmup_s + self.attack_s + self.time_to_alert_s
        if length > MOST_EPOCHS * interval_s:
            raise ValueError(
                f"an episode must have at most {MOST_EPOCHS} epochs; {length:g} s at intervals of "
                f"{interval_s:g} s are {length / interval_s:.0f}"
            )
        warmup = round(self.warmup_s / interval_s)
        live = min(round(self.live_s / interval_s), warmup)
        attack = max(round(self.attack_s / interval_s), 1)
        return warmup - live, live, attack, round(self.time_to_alert_s / interval_s)


def check_settles(detector: Detector, epochs: int) -> None:
    """Raise where a detector is silent for a whole episode."""
    if detector.silent_epochs >= epochs:
        raise ValueError(
            f"{type(detector).__name__} can't alarm in its first {detector.silent_epochs} epochs, "
            f"and an episode has {epochs} in which it judges; shorten its windows"
        )


class Setup:
    """What all batches of an engine share, computed once.

    Parameters
    ----------
    scenario : Scenario
        The authentic world.
    receiver : TightlyCoupled
        The victim.
    attack : Attack
        What the spoofer can do; copied for every batch.
    detector : Detector
        Copied for every batch.
    timeline : Timeline
        Phases of an episode.
    domain : Domain, optional
        What differs from episode to episode; nothing by default.
    target_heading_deg : float or {"random", "worst"}
        Direction in which displacement counts, clockwise from north; drawn for every episode; or
        that in which it is largest.
    decision_interval_s : float, optional
        Time between decisions, a multiple of the interval between epochs, of which the attack
        window holds a whole number; every epoch by default.
    between : {"hold", "linear"}
        What is commanded at the epochs between: the decision that was taken, or the line from the
        one before to it, which is reached when the next is due.

    Attributes
    ----------
    world : World
        All worlds of the domain, one after the other: an epoch of it tells world and time.
    cases : Cases
        Combinations of world, sensors and errors.
    onset : int
        Epochs from the begin of an episode to the onset of the attack.
    bounds : Bounds
        What an episode chooses from.
    repeat : int
        Epochs of a decision.
    bias_sd, noise_variance, noise, first_C_eb
        Of the first case, for an episode that begins as early as it can.
    witnesses : tuple of Witness
        What looks at every epoch beside the detector; copied for every batch.

    Raises
    ------
    ValueError
        When the run is shorter than the episode.
    """

    def __init__(
        self,
        scenario: Scenario,
        receiver: TightlyCoupled,
        attack: Attack,
        detector: Detector,
        timeline: Timeline,
        domain: Domain | None = None,
        target_heading_deg: float | str = 90.0,
        decision_interval_s: float | None = None,
        between: str = "hold",
    ) -> None:
        self.scenario, self.receiver, self.timeline = scenario, receiver, timeline
        self.attack, self.detector = attack, detector
        self.domain = Domain() if domain is None else domain
        self.target_heading_deg = checked_target(target_heading_deg)
        self.witnesses: tuple[Witness, ...] = ()
        interval = scenario.epoch_interval_s
        self.quiet, self.live, self.steps, self.hold = timeline.epochs(interval)
        self.onset = self.quiet + self.live
        self.decision_interval_s, self.between = decision_interval_s, between
        check_choice("between", between, BETWEEN)
        if between != "hold" and decision_interval_s is None:
            raise ValueError(
                f"`between` {between!r} needs a `decision_interval_s`: without one there is no "
                "epoch between two decisions"
            )
        self.repeat = _repeat(decision_interval_s, interval, self.steps)
        # one decision more, which a finished receiver may run until it is reset
        length = self.onset + self.steps + self.hold + self.repeat
        worlds = worlds_of(scenario, self.domain)
        first, last = self._starts(length, worlds[0])
        self.cases = Cases(worlds, scenario, receiver, self.domain, length, last + length)
        self.world: World = self.cases.world
        heading = self.target_heading_deg
        self.bounds = Bounds(
            self.cases.worlds,
            self.cases.grades,
            self.cases.errors,
            first,
            last,
            None if heading == "random" else float(np.radians(_number(heading))),
        )
        self._check_first_fixes()
        case = self.cases[0]
        self.bias_sd, self.noise_variance, self.noise = (
            case.bias_sd,
            case.noise_variance,
            case.noise,
        )
        self.first_C_eb = self.cases.first_C_eb(np.zeros(1, np.int64), np.array([first]))[0]

    @property
    def epochs_each(self) -> int:
        """Epochs of each of the worlds."""
        return self.world.epochs // self.bounds.worlds

    @property
    def onsets(self) -> NDArray[np.int64] | None:
        """(K,) onset of the episodes that each epoch is part of; None where the start is drawn."""
        if self.bounds.first != self.bounds.last:
            return None
        epochs = np.arange(self.world.epochs)
        begun: NDArray[np.int64] = epochs - epochs % self.epochs_each
        return begun + self.bounds.first + self.onset

    def command(
        self, before: FloatArray, action: FloatArray, epoch: int | NDArray[np.int64]
    ) -> FloatArray:
        """Command of one of the epochs of a decision.

        `before`, `action` (B, a) decision before, and this one; `epoch`: which epoch of the
        decision, from 0 on; (B, 1) where receivers differ; returns (B, a).
        """
        if self.between == "hold":
            return action
        count = np.asarray(epoch) + 1
        # the line reaches its end exactly, not but for rounding
        on_the_way = before + (count / self.repeat) * (action - before)
        return np.where(count == self.repeat, action, on_the_way)

    def altered(
        self, *, detector: Detector | None = None, witnesses: Sequence[Witness] | None = None
    ) -> Setup:
        """The same world and attack, with another detector or other witnesses."""
        other = copy.copy(self)
        if detector is not None:
            other.detector = detector
        if witnesses is not None:
            other.witnesses = tuple(witnesses)
        return other

    def _starts(self, length: int, world: World) -> tuple[int, int]:
        """First and last epoch at which an episode of a length may begin."""
        interval = self.scenario.epoch_interval_s
        early, late = self.domain.start_s
        room = world.epochs - 1 - length
        first = math.ceil(early / interval - 1e-6)
        last = room if late is None else math.floor(late / interval + 1e-6)
        if first > last and late is not None:
            raise ValueError(
                f"`start_s` must hold an epoch, of which there is one every {interval:g} s, got "
                f"{self.domain.start_s}"
            )
        if max(first, last) > room:
            line = self.timeline
            begun = f" from a begin at {max(first, last) * interval:g} s" if first or last else ""
            raise ValueError(
                f"an episode takes {length * interval:g} s{begun} (warm-up {line.warmup_s:g} s, "
                f"attack {line.attack_s:g} s, time to alert {line.time_to_alert_s:g} s, and one "
                f"decision of {self.repeat * interval:g} s in reserve), but "
                f"{world.name!r} lasts {world.epoch_time[-1]:g} s"
            )
        return first, last

    def _check_first_fixes(self) -> None:
        bounds, each = self.bounds, self.epochs_each
        seen = self.world.visible.sum(axis=1).reshape(bounds.worlds, each)
        few = np.argwhere(seen[:, bounds.first : bounds.last + 1] < FIRST_FIX)
        if len(few):
            world, epoch = few[0]
            time = self.world.epoch_time[bounds.first + epoch]
            raise ValueError(
                f"a first fix needs {FIRST_FIX} satellites; world {world} of the domain has fewer "
                f"at {time:g} s"
            )


def checked_target(target_heading_deg: float | str) -> float | str:
    """Raise unless there is such a target direction."""
    if isinstance(target_heading_deg, str):
        check_choice("target_heading_deg", target_heading_deg, TARGETS)
    elif not isinstance(target_heading_deg, Real) or not np.isfinite(float(target_heading_deg)):
        raise ValueError(
            f"`target_heading_deg` must be a finite number, 'random' or 'worst', got "
            f"{target_heading_deg!r}"
        )
    return target_heading_deg


def _repeat(decision_interval_s: float | None, interval_s: float, steps: int) -> int:
    """Epochs of a decision."""
    if decision_interval_s is None:
        return 1
    if not (math.isfinite(decision_interval_s) and decision_interval_s > 0.0):
        raise ValueError(f"`decision_interval_s` must be finite and > 0, got {decision_interval_s}")
    repeat = round(decision_interval_s / interval_s)
    if repeat < 1 or abs(repeat * interval_s - decision_interval_s) > 1e-6 * interval_s:
        raise ValueError(
            f"`decision_interval_s` must be a multiple of the interval between epochs, "
            f"{interval_s:g} s, got {decision_interval_s}"
        )
    if steps % repeat:
        raise ValueError(
            f"the attack window of {steps * interval_s:g} s must hold a whole number of decisions, "
            f"got `decision_interval_s` {decision_interval_s}"
        )
    return repeat


def _number(heading: float | str) -> float:
    return 0.0 if isinstance(heading, str) else float(heading)
