"""What the vector views of both sides share: a changed pool asks for a reset."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..envs.env import C
from ..envs.options import Array, mask_of
from ..envs.vector_env import CoreVectorEnv

POOL_CHANGED = "the pool has changed"
RESET_FIRST = f"{POOL_CHANGED}: call reset() before step()"
RESET_ALL = f"{POOL_CHANGED}: the next reset must be that of all receivers"


class PooledVectorView(CoreVectorEnv[C]):
    """Vector environment of one side of the duel; `set_pool` of a subclass sets `pool_changed`.

    Attributes
    ----------
    pool_changed : bool
        Whether the pool has changed since the last reset.
    """

    pool_changed: bool = False

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        if self.pool_changed:
            mask = mask_of(options, self.num_envs)
            if mask is not None and not mask.all():
                raise ValueError(RESET_ALL)
        begun = super().reset(seed=seed, options=options)
        self.pool_changed = False
        return begun

    def step(self, actions: Any) -> Any:
        if self.pool_changed:
            raise RuntimeError(RESET_FIRST)
        return super().step(actions)
