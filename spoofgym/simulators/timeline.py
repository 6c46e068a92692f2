"""Phases of an episode, and the decisions of its attack."""

from __future__ import annotations

from dataclasses import dataclass

from .._registry import check_finite

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
        Last part of it in which the detectors judge; an alarm there is a false alarm.  By default
        it lets the slowest memory settle, so that a detector is not better or worse for having just
        been switched on.
    attack_s : float
        Command phase.
    time_to_alert_s : float
        Time to alert: how long the offsets hold their rate after the command phase, with alarms
        live; what was induced within this time of an alarm does not count.
    """

    described_as = "Timeline"
    warmup_s: float = 200.0
    live_s: float = 180.0
    attack_s: float = 150.0
    time_to_alert_s: float = 10.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            check_finite(name, value, "> 0" if name == "attack_s" else ">= 0")
        if self.live_s > self.warmup_s:
            raise ValueError(
                f"`live_s` must be at most `warmup_s` = {self.warmup_s}, got {self.live_s}"
            )

    def epochs(self, interval_s: float) -> tuple[int, int, int, int]:
        """Epochs of the filter-only and the monitored warm-up, the command phase, and the hold."""
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


def epochs_of_decision(decision_interval_s: float | None, interval_s: float, steps: int) -> int:
    """Epochs of a decision; by default every epoch is one."""
    if decision_interval_s is None:
        return 1
    check_finite("decision_interval_s", decision_interval_s, "> 0")
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
