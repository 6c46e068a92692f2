"""Shapes of networks, as stable-baselines3 takes them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor


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


class FirstElements(BaseFeaturesExtractor):
    """First elements of an observation; the others are hidden.

    Parameters
    ----------
    observation_space : Box
        (o,) observations.
    seen : int
        How many elements are not hidden.
    """

    def __init__(self, observation_space: spaces.Box, seen: int) -> None:
        size = observation_space.shape[0]
        if not 1 <= seen <= size:
            raise ValueError(f"`seen` must be in [1, {size}], got {seen}")
        super().__init__(observation_space, size)
        self.seen = seen
        self.register_buffer("mask", (torch.arange(size) < seen).to(torch.float32))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Hide what is not seen.

        Parameters
        ----------
        observation : Tensor
            (B, o).

        Returns
        -------
        Tensor
            (B, o), zeros for what is hidden.
        """
        return observation * self.mask


class InformedCritic(ActorCriticPolicy):
    """Policy that sees the first elements of an observation, with a critic that sees all of it.

    The critic is needed for learning alone.  One that sees how close the detector is to an alarm
    expects it, so that alarms by chance do not count as the fault of an action (asymmetric
    actor-critic, `pinto2018`).

    Parameters
    ----------
    *args, **kwargs
        Of `ActorCriticPolicy`.
    seen : int
        How many elements the policy sees.
    """

    def __init__(self, *args: Any, seen: int, **kwargs: Any) -> None:
        super().__init__(
            *args,
            share_features_extractor=False,
            features_extractor_class=FirstElements,
            features_extractor_kwargs={"seen": seen},
            **kwargs,
        )
        self.seen = seen
        self.vf_features_extractor.mask.fill_(1.0)
