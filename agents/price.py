"""The price of an alarm follows the alarm budget, as a Lagrange multiplier does."""

from __future__ import annotations

from spoofgym.envs.terms.reward import default_rewards
from spoofgym.sb3 import SpoofVecEnv

LEAST, MOST = 1.0, 8.0
"""In lengths.  With less a policy that has found nothing learns that alarms are for nothing; with
more a few alarms drown what else there is to learn."""


def next_price(price: float, amplitude: float, gain: float) -> float:
    """Price in lengths after a fit of the amplitude: more where it had to be scaled down.

    It is divided by the amplitude to the power of `gain`, within a factor of two and from `LEAST`
    to `MOST`.
    """
    if gain == 0.0:
        return price
    factor = min(max(max(amplitude, 1e-3) ** -gain, 0.5), 2.0)
    return min(max(price * factor, LEAST), MOST)


def set_price(envs: SpoofVecEnv, price: float) -> None:
    """Let an alarm cost `price` lengths from now on, unless the reward is one's own."""
    core = envs.core
    if core.settings["reward"] is None:
        envs.set_rewards(default_rewards(price * core.length_m))
