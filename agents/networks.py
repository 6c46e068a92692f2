"""Shapes of networks, as stable-baselines3 takes them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch


@dataclass(frozen=True, kw_only=True)
class MlpShape:
    """Policy and value function in networks of their own, of equal tanh layers.

    Parameters
    ----------
    width : int
        Units of a layer.
    layers : int
        How many.
    log_std_init : float
        Logarithm of the standard deviation that actions are drawn with at first.
    ortho_init : bool
        Whether the weights begin orthogonal.
    """

    width: int = 64
    layers: int = 2
    log_std_init: float = -1.0
    ortho_init: bool = True

    def __post_init__(self) -> None:
        """Check the settings."""
        for name in ("width", "layers"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                raise ValueError(f"`{name}` must be a whole number of at least 1, got {value!r}")
        if not math.isfinite(self.log_std_init):
            raise ValueError(f"`log_std_init` must be finite, got {self.log_std_init}")

    def policy_kwargs(self) -> dict[str, Any]:
        """Settings of an ``MlpPolicy``.

        Returns
        -------
        dict
            For ``PPO("MlpPolicy", env, policy_kwargs=...)``.
        """
        hidden = [self.width] * self.layers
        return {
            "net_arch": {"pi": list(hidden), "vf": list(hidden)},
            "activation_fn": torch.nn.Tanh,
            "log_std_init": self.log_std_init,
            "ortho_init": self.ortho_init,
        }
