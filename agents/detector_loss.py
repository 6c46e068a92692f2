"""What a detector learns by: a logistic loss of every epoch, and what is scored, made smooth."""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch.nn import functional

LARGEST_PART = 20
"""A threshold is the mean of one in so many clean maxima, the largest ones."""


def logistic(
    odds: torch.Tensor, attack: torch.Tensor, moved: torch.Tensor, valid: torch.Tensor
) -> torch.Tensor:
    """Weighted logistic loss of all epochs; clean and attacked ones weigh the same in total.
    `odds`: (E, L) logarithm of the odds of an attack; `attack`: (E, L) bool, whether an attack is
    on; `moved`: (E, L) displacement in alert limits, at most 1: the weight of an attacked epoch;
    `valid`: (E, L) bool, which epochs count."""
    weight = torch.where(attack, moved, (~attack).float())
    loss = functional.binary_cross_entropy_with_logits(odds, attack.float(), reduction="none")
    parts = [
        (loss * weight)[kind].sum() / weight[kind].sum().clamp(min=1.0)
        for kind in (attack, ~attack & valid)
    ]
    return parts[0] + parts[1]


def compute_undetected(
    odds: torch.Tensor,
    moved: torch.Tensor,
    clean: torch.Tensor,
    live: torch.Tensor,
    epochs: Mapping[str, int],
) -> torch.Tensor:
    """Mean of min(D, AL) / AL, with the probability of no alarm in place of none. `clean`: (E,)
    bool, which episodes are clean; some are, and some are not; `live`: (E,) epochs before the
    onset; `epochs`: ``"steps"`` and ``"hold"`` of an episode."""
    steps, hold = epochs["steps"], epochs["hold"]
    window = live[:, None] + torch.arange(steps + hold)
    odds, moved = odds.gather(1, window), moved.gather(1, window)
    maxima = odds[clean].amax(dim=1)
    threshold = maxima.topk(math.ceil(len(maxima) / LARGEST_PART)).values.mean()
    so_far = odds[~clean].cummax(dim=1).values[:, hold:]
    farthest = moved[~clean, :steps].cummax(dim=1).values
    gained = torch.diff(farthest, dim=1, prepend=torch.zeros(len(farthest), 1))
    return (gained * torch.sigmoid(threshold - so_far)).sum(dim=1).mean()
