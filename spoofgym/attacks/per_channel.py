"""Offsets of single pseudoranges, each commanded for itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..sim.world import World
from .base import Attack, AttackContext, FloatArray


@dataclass(kw_only=True)
class PerChannel(Attack):
    """Offset added to the pseudorange of every captured satellite, as in the five papers.

    The limits apply to each channel for itself.  Offsets of satellites that are not in view have no
    effect.

    Parameters
    ----------
    control, acceleration_limit_mps2, rate_limit_mps, coherent, channels
        As in `Attack`.
    """

    @property
    def kind(self) -> str:
        """Name of what is commanded."""
        return "per-channel"

    def action_names(self, world: World) -> tuple[str, ...]:
        """Name of every element of an action.

        Parameters
        ----------
        world : World
            Names its slots.

        Returns
        -------
        tuple of str
            For example ``("S05_acceleration", ...)``, in the order of the slots.
        """
        mask = self.captured(world)
        ids = [name for name, taken in zip(world.satellite_ids, mask, strict=True) if taken]
        return tuple(f"{name}_{self.control}" for name in ids)

    def bind(self, context: AttackContext) -> None:
        """Prepare for a batch of receivers.

        Parameters
        ----------
        context : AttackContext
            Sizes and world.
        """
        super().bind(context)
        self._slots = np.flatnonzero(self.mask)

    def offsets(
        self, epochs: NDArray[np.int64], d_range: FloatArray, d_rate: FloatArray
    ) -> None:
        """Write what the present command adds to the measurements of the coming epoch.

        Parameters
        ----------
        epochs : ndarray
            (B,) the coming epoch; not needed here.
        d_range, d_rate : ndarray
            (B, n), written [m], [m/s].
        """
        d_range[:] = 0.0
        d_rate[:] = 0.0
        d_range[:, self._slots] = self.memory["displacement"]
        if self.coherent:
            d_rate[:, self._slots] = self.memory["rate"]
