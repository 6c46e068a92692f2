"""Offsets of single pseudoranges, each commanded for itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..sim.world import World
from ._kernels import displaced_ranges, per_channel
from .base import Attack, FloatArray


@dataclass(kw_only=True)
class PerChannel(Attack):
    """Offset added to the pseudorange of every captured satellite, as in the five papers.

    What the spoofer changes is the authentic range itself; with `tracking`, the range that it takes
    for the authentic one, at a wrong position.  The limits apply to each channel for itself.
    Offsets of satellites that are not in view have no effect.

    Parameters
    ----------
    control, acceleration_limit_mps2, rate_limit_mps, coherent, channels, errors, tracking
        As in `Attack`.
    spoofer_clock, capture, threat
        As in `Attack`.
    """

    described_as = "PerChannel"

    @property
    def kind(self) -> str:
        return "per-channel"

    def action_names(self, world: World) -> tuple[str, ...]:
        """Name of every element of an action. Returns for example ``("S05_acceleration", ...)``, in
        the order of the slots."""
        mask = self.captured(world)
        ids = [name for name, taken in zip(world.satellite_ids, mask, strict=True) if taken]
        return tuple(f"{name}_{self.control}" for name in ids)

    def command(
        self,
        action: FloatArray | None,
        epochs: NDArray[np.int64],
        d_range: FloatArray,
        d_rate: FloatArray,
        lo: int,
        hi: int,
    ) -> None:
        """Take one command, and write what it adds to the measurements of the coming epoch.
        `action` (B, a) in [-1, 1]; None holds the rate; `epochs` (B,) the epoch that each receiver
        is at; `d_range`, `d_rate` (B, n), written [m], [m/s]."""
        world = self.world
        self._prepare(epochs, lo, hi)
        per_channel(
            self.idle if action is None else action,
            action is None,
            self.control == "rate",
            self.unit_scale,
            self.rate_limit_mps,
            self.memory["displacement"],
            self.memory["rate"],
            self.slots,
            self.coherent,
            epochs,
            world.epoch_time,
            d_range,
            d_rate,
            lo,
            hi,
        )
        if self.tracking is not None:
            displaced_ranges(
                self.memory["target_error"],
                self.coherent,
                epochs,
                world.satellites,
                world.position_e,
                world.velocity_e,
                self.mask,
                d_range,
                d_rate,
                lo,
                hi,
            )
        self._transmit(epochs, d_range, d_rate, lo, hi)
