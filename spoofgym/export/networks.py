"""The deterministic action of a model as one torch module, normalization and amplitude included."""

from __future__ import annotations

from typing import Any

import torch

from ..spoofers.model import Normalization, refuse_state

GAUSSIANS = (
    "DiagGaussianDistribution",
    "SquashedDiagGaussianDistribution",
    "StateDependentNoiseDistribution",
)
"""Distributions of stable-baselines3 whose mean is the deterministic action."""


class Actor(torch.nn.Module):
    """Deterministic action of a model, of observations that nothing has normalized.

    Scaled by an amplitude as `spoofgym.spoofers.Scaled` does it; `own`: elements of the `size`
    observations that are the spoofer's own commands.
    """

    def __init__(
        self, model: Any, found: Normalization | None, amplitude: float, size: int, own: list[int]
    ) -> None:
        super().__init__()
        self.mean = _mean_of(model)
        self.clip = None if found is None else found.clip
        if found is not None:
            # in single precision the difference comes first, as in the model's own
            self.register_buffer("center", torch.as_tensor(found.mean, dtype=torch.float64))
            self.register_buffer("scale", torch.as_tensor(found.scale, dtype=torch.float64))
        self.amplitude = float(amplitude)
        divisor = torch.ones(size)
        divisor[own] = self.amplitude
        self.register_buffer("divisor", divisor)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Actions (B, a) of observations (B, o)."""
        seen = observation / self.get_buffer("divisor")
        if self.clip is not None:
            apart = seen.double() - self.get_buffer("center")
            seen = torch.clamp(apart / self.get_buffer("scale"), -self.clip, self.clip).float()
        action = torch.clamp(self.mean(seen), -1.0, 1.0)
        return torch.clamp(action * self.amplitude, -1.0, 1.0)


class _ActorCritic(torch.nn.Module):
    """Mean action of PPO and A2C."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy, self.squashed = policy, bool(policy.squash_output)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        features = self.policy.extract_features(seen, self.policy.pi_features_extractor)
        mean = self.policy.action_net(self.policy.mlp_extractor.forward_actor(features))
        return torch.tanh(mean) if self.squashed else mean


class _Squashed(torch.nn.Module):
    """Mean action of SAC."""

    def __init__(self, actor: Any) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        features = self.actor.extract_features(seen, self.actor.features_extractor)
        return torch.tanh(self.actor.mu(self.actor.latent_pi(features)))


def _mean_of(model: Any) -> torch.nn.Module:
    policy = getattr(model, "policy", model)
    refuse_state(policy)
    if hasattr(policy, "mlp_extractor") and hasattr(policy, "action_net"):
        kind = type(getattr(policy, "action_dist", None)).__name__
        if kind not in GAUSSIANS:
            raise TypeError(
                "only a policy with a Gaussian action can be exported, got "
                f"{type(policy).__name__} with {kind}"
            )
        return _ActorCritic(policy)
    actor = getattr(policy, "actor", None)
    if isinstance(actor, torch.nn.Module):
        return _Squashed(actor) if hasattr(actor, "latent_pi") else actor
    if isinstance(policy, torch.nn.Module):
        return policy
    raise TypeError(
        "a model of stable-baselines3, its policy or a torch module can be exported, got "
        f"{type(model).__name__}"
    )
