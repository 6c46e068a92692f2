"""Exploration that falls while a policy learns."""

from __future__ import annotations

from stable_baselines3.common.callbacks import BaseCallback


class Exploration(BaseCallback):
    """Lets the logarithm of a Gaussian policy's standard deviation fall linearly.

    A detector meets what is explored, and what is scored is the mean.  Noise that is as large as
    the attack makes PPO learn an attack that suits the noise.

    Parameters
    ----------
    first, last : float
        Logarithm at the first step and from the last one on.
    steps : int
        Steps of all receivers together, of the whole training.
    """

    def __init__(self, first: float, last: float, steps: int) -> None:
        super().__init__()
        self.first, self.last, self.steps = first, last, steps

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        part = min(self.num_timesteps / self.steps, 1.0)
        level = self.first + (self.last - self.first) * part
        self.model.policy.log_std.data.fill_(level)
