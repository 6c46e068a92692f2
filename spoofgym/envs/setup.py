"""What all receivers of an engine share: world, victim, attack, detector, phases of an episode."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..attacks import Attack
from ..detectors import Detector
from ..earth.attitude import euler_to_dcm
from ..receiver import TightlyCoupled
from ..receiver.matching import assumed_noise
from ..sim.scenario import Scenario
from ..sim.world import World
from .witness import Witness

MOST_EPOCHS = 100_000
"""Longest episode."""


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
        """Phases in epochs.

        Parameters
        ----------
        interval_s : float
            Time between epochs.

        Returns
        -------
        quiet, live, attack, hold : int
            Warm-up without and with detectors, command phase, hold.

        Raises
        ------
        ValueError
            When an episode would have more than `MOST_EPOCHS` epochs, all of which are kept in
            memory.
        """
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
    """Raise where a detector is silent for a whole episode.

    Parameters
    ----------
    detector : Detector
        Bound.
    epochs : int
        Epochs of an episode in which it judges.

    Raises
    ------
    ValueError
        When its windows are not full before the episode ends.
    """
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

    Attributes
    ----------
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
    ) -> None:
        self.scenario, self.receiver, self.timeline = scenario, receiver, timeline
        self.attack, self.detector = attack, detector
        self.witnesses: tuple[Witness, ...] = ()
        self.world: World = scenario.world()
        interval = scenario.epoch_interval_s
        self.quiet, self.live, self.steps, self.hold = timeline.epochs(interval)
        self.onset = self.quiet + self.live
        # one epoch more, which a finished receiver may run until it is reset
        last = self.onset + self.steps + self.hold + 1
        if last >= self.world.epochs:
            raise ValueError(
                f"an episode takes {last * interval:g} s (warm-up {timeline.warmup_s:g} s, attack "
                f"{timeline.attack_s:g} s, time to alert {timeline.time_to_alert_s:g} s), but "
                f"{self.world.name!r} lasts {self.world.epoch_time[-1]:g} s"
            )
        self.bias_sd = scenario.gnss_errors.bias_sd(self.world.first_elevation)
        self.noise_variance, self.noise = assumed_noise(
            receiver, scenario.gnss_errors, self.bias_sd, self.world, last
        )
        self.onset_C_en = np.ascontiguousarray(self.world.local_frame(self.onset))
        C_en = self.world.local_frame(0)
        error = euler_to_dcm(*(-np.radians(scenario.imu_grade.attitude_error_deg)))
        C_ne = C_en.T
        # the error turns the local axes: C_nb (estimated) = dC C_nb
        self.first_C_eb = C_en @ (error.T @ (C_ne @ self.world.C_eb[0]))

    def altered(
        self, *, detector: Detector | None = None, witnesses: Sequence[Witness] | None = None
    ) -> Setup:
        """The same world and attack, with another detector or other witnesses.

        Parameters
        ----------
        detector : Detector, optional
            In the loop.
        witnesses : sequence of Witness, optional
            Beside it.

        Returns
        -------
        Setup
            A new one that shares the world.
        """
        other = copy.copy(self)
        if detector is not None:
            other.detector = detector
        if witnesses is not None:
            other.witnesses = tuple(witnesses)
        return other
