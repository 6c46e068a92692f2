"""Learning of stable-baselines3 that may diverge."""

from __future__ import annotations

from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm

from spoofgym.spoofers.learned import finite


def learn(model: BaseAlgorithm, steps: int, **how: Any) -> str | None:
    """Let a model learn; any other error than that of a diverged policy is raised as it is.

    `**how`: as its own ``learn`` takes it.  Returns what torch said where a distribution had no
    number for its mean, in an update or in the next rollout; the weights of the model are not
    finite then.  They may also be so where nothing was said, after the last minibatch.
    """
    try:
        model.learn(steps, **how)
    except ValueError as error:
        if finite(model.policy):
            raise
        return str(error).partition("\n")[0]
    return None
