"""Shapes of networks, as stable-baselines3 takes them."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
    """First elements of an observation, scaled; the others are hidden.

    Parameters
    ----------
    observation_space : Box
        (o,) observations.
    seen : int
        How many elements are not hidden.
    scale : sequence of float, optional
        (o,) factors on the elements; 1 by default.
    """

    def __init__(
        self, observation_space: spaces.Box, seen: int, scale: Sequence[float] | None = None
    ) -> None:
        size = observation_space.shape[0]
        if not 1 <= seen <= size:
            raise ValueError(f"`seen` must be in [1, {size}], got {seen}")
        if scale is not None and len(scale) != size:
            raise ValueError(f"`scale` must have {size} elements, got {len(scale)}")
        if scale is not None and not all(math.isfinite(factor) for factor in scale):
            raise ValueError(f"`scale` must be finite, got {list(scale)}")
        super().__init__(observation_space, size)
        factor = torch.ones(size) if scale is None else torch.tensor(scale, dtype=torch.float32)
        self.register_buffer("factor", torch.where(torch.arange(size) < seen, factor, 0.0))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Scale what is seen, and hide the rest.

        Parameters
        ----------
        observation : Tensor
            (B, o).

        Returns
        -------
        Tensor
            (B, o), zeros for what is hidden.
        """
        return observation * self.factor


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
    scale : sequence of float, optional
        (o,) factors on the elements for both.
    """

    def __init__(
        self, *args: Any, seen: int, scale: Sequence[float] | None = None, **kwargs: Any
    ) -> None:
        super().__init__(
            *args,
            share_features_extractor=False,
            features_extractor_class=FirstElements,
            features_extractor_kwargs={"seen": seen, "scale": scale},
            **kwargs,
        )
        self.seen = seen
        size = self.observation_space.shape[0]
        everything = FirstElements(self.observation_space, size, scale)
        self.vf_features_extractor.load_state_dict(everything.state_dict())
