"""Meaconing: authentic signals are recorded and replayed, as another antenna received them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..truth.run import World
from ._kernels import Commanded, meaconer
from .base import Attack, AttackContext
from .equipment import checked_vector


@dataclass(kw_only=True)
class Meaconer(Attack):
    r"""Record and replay: the ranges of the meaconer's antenna, and one delay.

    .. math:: \Delta\rho_j = \rho_j(r_m) - \rho_j(r) + |r_m - r| + D, \qquad D \ge 0

    and the range rates are the derivatives.  The victim's position becomes that of the antenna at
    :math:`r_m`; the way from there to the victim and the delay D, the one command, are common to
    all channels and go into its clock.  There is no freedom per axis or per satellite.  Within a
    delay of D the satellites move by less than 4 mm per kilometre of D, which is left out.

    Parameters
    ----------
    control, acceleration_limit_mps2, rate_limit_mps, coherent, channels, errors
        As in `Attack`, for the delay in metres.
    tracking : None
        A meaconer needs no position; anything else is refused.
    spoofer_clock, capture, threat
        As in `Attack`.
    antenna_m : tuple of float
        (3,) north, east, down from the target's to the meaconer's antenna at the onset.
    follows : bool
        Whether the antenna stays there, in the axes at the target's true position; if not, it stays
        where it was on the Earth.
    """

    described_as = "Meaconer"
    one_sided: ClassVar[bool] = True
    antenna_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    follows: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self.antenna_m = checked_vector("antenna_m", self.antenna_m)
        if self.tracking is not None:
            raise ValueError(
                f"`tracking` must be None, since a meaconer needs no position; got {self.tracking}"
            )

    @property
    def kind(self) -> str:
        return "meaconer"

    @property
    def idle_is_clean(self) -> bool:
        return super().idle_is_clean and self.follows and self.antenna_m == (0.0, 0.0, 0.0)

    def action_names(self, world: World) -> tuple[str, ...]:
        return (f"delay_{self.control}",)

    def bind(self, context: AttackContext) -> None:
        super().bind(context)
        self.memory.declare("antenna", np.zeros((context.receivers, 3)))
        self.memory.declare("antenna_rate", np.zeros((context.receivers, 3)))

    def begin(
        self, rows: NDArray[np.intp], keys: NDArray[np.uint64], onsets: NDArray[np.int64]
    ) -> None:
        super().begin(rows, keys, onsets)
        self.memory["antenna"][rows] = (self.world.C_en[onsets] * self.antenna_m).sum(axis=2)

    def _displace(self, commanded: Commanded, rest: tuple[Any, ...]) -> None:
        world, memory, (epochs, *_, lo, hi) = self.world, self.memory, rest
        if self.follows:
            coming, here = epochs[lo:hi] + 1, slice(lo, hi)
            memory["antenna"][here] = (world.C_en[coming] * self.antenna_m).sum(axis=2)
            memory["antenna_rate"][here] = (world.axes_turning[coming] * self.antenna_m).sum(axis=2)
        antenna = memory["antenna"], memory["antenna_rate"]
        meaconer(commanded, antenna, self.follows, memory["onset"], *rest)
