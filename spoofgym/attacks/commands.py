"""False position and per-channel offsets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..truth.run import World
from ._kernels import Commanded, displaced_ranges, false_position, per_channel
from .base import Attack, AttackContext

AXES = {"n": "north", "e": "east", "d": "down"}


@dataclass(kw_only=True)
class FalsePosition(Attack):
    r"""Counterfeit position, displaced from the true one.

    .. math:: \Delta\rho_j = \rho_j(r + D) - \rho_j(r), \qquad
        \Delta\dot\rho_j = \dot\rho_j(r + D, v + \dot D) - \dot\rho_j(r, v)

    The true position is what the spoofer takes for it: with `tracking`, its error is added to D.
    The displacement D is commanded in the north-east-down axes at the true position of the epoch,
    which move with the target: a displacement to the east that is held keeps its height, however
    far the target flies.  The velocity of the counterfeit has the turning of the axes in it, so
    that range rates remain the derivatives of the ranges.  The limits apply to the size of the
    vector.

    Parameters
    ----------
    control, acceleration_limit_mps2, rate_limit_mps, coherent, channels, errors, tracking
        As in `Attack`.
    spoofer_clock, capture, threat
        As in `Attack`.
    axes : str
        Letters of the commanded axes, from ``"n"``, ``"e"`` and ``"d"``, in the order of the
        action.  Displacement is scored horizontally, hence the default ``"ne"``.
    """

    described_as = "FalsePosition"
    axes: str = "ne"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.axes or len(set(self.axes)) < len(self.axes) or set(self.axes) - set(AXES):
            raise ValueError(
                f"`axes` must be made of 'n', 'e' and 'd', each at most once, got {self.axes!r}"
            )

    @property
    def kind(self) -> str:
        return "false-position"

    def action_names(self, world: World) -> tuple[str, ...]:
        return tuple(f"{AXES[letter]}_{self.control}" for letter in self.axes)

    def bind(self, context: AttackContext) -> None:
        super().bind(context)
        columns = ["ned".index(letter) for letter in self.axes]
        axes = context.world.C_en, context.world.axes_turning
        self.axes_e = np.concatenate([each[:, :, columns] for each in axes], axis=1)
        self.axes_e = np.ascontiguousarray(self.axes_e.transpose(0, 2, 1))

    def _displace(self, commanded: Commanded, rest: tuple[Any, ...]) -> None:
        false_position(commanded, self.axes_e, self.memory["target_error"], *rest)


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
        mask = self.captured(world)
        ids = [name for name, taken in zip(world.satellite_ids, mask, strict=True) if taken]
        return tuple(f"{name}_{self.control}" for name in ids)

    def _displace(self, commanded: Commanded, rest: tuple[Any, ...]) -> None:
        per_channel(commanded, self.slots, *rest)
        if self.tracking is not None:
            displaced_ranges(self.memory["target_error"], self.coherent, *rest)
