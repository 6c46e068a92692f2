"""What a spoofer knows before its first command."""

from __future__ import annotations

from typing import NamedTuple


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
    control : {"rate", "acceleration", "setpoint"}
        What an action of 1 commands: the limit of the rate or of the acceleration, or a wanted rate
        that the acceleration follows.
    acceleration_limit_mps2, rate_limit_mps : float
        Of the attack; with control by rate the first one does not bind.
    action_names : tuple of str
        (a,) name of every element of an action, as the attack gives them.
    observation_names : tuple of str
        (o,) name of every element of an observation.
    observation_low, observation_high : tuple of float
        (o,) bounds of every element; empty where they are not known.
    setpoint_mps : float or None
        Rate that an action of 1 asks for, with control by set-point.
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

    @property
    def largest_rate(self) -> tuple[str, float]:
        """Largest rate that actions can ask for [m/s], after the name of what limits it."""
        if self.setpoint_mps is not None and self.setpoint_mps < self.rate_limit_mps:
            return "full_scale_mps` of the action `rate-setpoint", self.setpoint_mps
        return "rate_limit_mps", self.rate_limit_mps
