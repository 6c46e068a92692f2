"""What the vector views of both sides share: a changed pool asks for a reset."""

from __future__ import annotations

from typing import Any

from ..envs.game_env import G
from ..envs.game_vector_env import GameVectorEnv

RESET_FIRST = "the pool has changed: call reset() before step()"


class PooledVectorView(GameVectorEnv[G]):
    """Vector environment of one side of the duel; `set_pool` of a subclass sets `pool_changed`.

    Attributes
    ----------
    pool_changed : bool
        Whether the pool has changed since the last reset.
    """

    pool_changed: bool = False

    def reset(self, **kwargs: Any) -> Any:
        """Begin an episode in every receiver.

        Parameters
        ----------
        **kwargs
            ``seed`` and ``options``, as in `GameVectorEnv`.

        Returns
        -------
        observation, info
            As in `GameVectorEnv`.
        """
        self.pool_changed = False
        return super().reset(**kwargs)

    def step(self, actions: Any) -> Any:
        """Run one epoch of every receiver.

        Parameters
        ----------
        actions : array_like
            (B, a) in [-1, 1].

        Returns
        -------
        observation, reward, terminated, truncated, info
            As in `GameVectorEnv`.
        """
        if self.pool_changed:
            raise RuntimeError(RESET_FIRST)
        return super().step(actions)
