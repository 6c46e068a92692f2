"""The average of a policy's weights while it is trained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray


class WeightAverage:
    r"""Exponential average of the weights of a model's policy.

    .. math:: \bar{w}_k = a\,\bar{w}_{k-1} + (1 - a)\,w_k

    Single updates of a policy jitter, and so do its scores; those of the average do not.

    Parameters
    ----------
    keeps : float
        a, in [0, 1): how much of the average stays at every update.

    Notes
    -----
    Polyak and Juditsky, "Acceleration of stochastic approximation by averaging", SIAM Journal on
    Control and Optimization 30 (1992).
    """

    def __init__(self, keeps: float) -> None:
        self.keeps = keeps
        self.weights: dict[str, NDArray[np.float64]] = {}

    def update(self, model: Any) -> None:
        """Take the weights of a model into the average; the first ones are the average.

        Parameters
        ----------
        model : BaseAlgorithm
            A model of stable-baselines3.
        """
        for name, weight in model.policy.named_parameters():
            now = weight.detach().cpu().numpy().astype(np.float64)
            before = self.weights.get(name, now)
            self.weights[name] = self.keeps * before + (1.0 - self.keeps) * now

    @contextmanager
    def applied(self, model: Any) -> Iterator[None]:
        """Let a model have the average as its weights for a while.

        Parameters
        ----------
        model : BaseAlgorithm
            The model that was averaged; it has its own weights again afterwards.

        Yields
        ------
        None
            Meanwhile it acts by the average.
        """
        parameters = dict(model.policy.named_parameters())
        own = {name: weight.detach().clone() for name, weight in parameters.items()}
        for name, average in self.weights.items():
            parameters[name].data.copy_(own[name].new_tensor(average))
        try:
            yield
        finally:
            for name, weight in own.items():
                parameters[name].data.copy_(weight)

    def state(self) -> dict[str, Any]:
        """The average, JSON-able and exact."""
        return {name: weight.tolist() for name, weight in self.weights.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a checkpoint.

        Parameters
        ----------
        state : mapping
            From `state`.
        """
        self.weights = {name: np.array(values) for name, values in state.items()}
