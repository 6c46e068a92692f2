"""False position, per-channel offsets, and meaconing: signals recorded and replayed."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..truth.run import GroundTruth
from ._kernels import Commanded, displaced_ranges, false_position, meaconer, per_channel
from .base import Attack, AttackContext
from .equipment import FloatArray, checked_vector

AXES = {"n": "north", "e": "east", "d": "down"}


def tabulate_axes(world: GroundTruth, letters: str) -> FloatArray:
    """(K, a, 6) local axes, of the letters n, e and d, at every epoch in ECEF axes, and their rates
    of change [1/s]; of worlds that have been built."""
    columns = ["ned".index(letter) for letter in letters]

    def compute(part: GroundTruth) -> FloatArray:
        both = (each[:, :, columns] for each in (part.C_en, part.axes_turning))
        return np.concatenate([*both], axis=1).transpose(0, 2, 1)

    return world.at_hand.tabulate(("axes", letters), (len(columns), 6), compute)


@settings_record(kw_only=True)
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
    """

    limits_size: ClassVar[bool] = True
    axes: str = setting(
        default="ne",
        help='Letters of the commanded axes, from ``"n"``, ``"e"`` and ``"d"``, in the order of '
        'the action.  Displacement is scored horizontally, hence the default ``"ne"``.',
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.axes or len(set(self.axes)) < len(self.axes) or set(self.axes) - set(AXES):
            raise ValueError(
                f"`axes` must be made of 'n', 'e' and 'd', each at most once, got {self.axes!r}"
            )

    @property
    def kind(self) -> str:
        return "false-position"

    def action_names(self, world: GroundTruth) -> tuple[str, ...]:
        return tuple(f"{AXES[letter]}_{self.control}" for letter in self.axes)

    @property
    def axes_e(self) -> FloatArray:
        """(K, a, 6) commanded axes in ECEF axes, and their rates of change [1/s]."""
        return tabulate_axes(self.world, self.axes)

    def _displace(self, commanded: Commanded, rest: tuple[Any, ...]) -> None:
        false_position(commanded, self.axes_e, self.memory["target_error"], *rest)


@settings_record(kw_only=True)
class PerChannel(Attack):
    """Offset added to the pseudorange of each captured satellite, as in `docs/papers.md`.

    The spoofer changes the authentic range itself; with `tracking`, it changes the range at a wrong
    position, which it takes for the authentic one.  The limits apply to each channel separately.
    Offsets of satellites that are not in view have no effect.
    """

    @property
    def kind(self) -> str:
        return "per-channel"

    def action_names(self, world: GroundTruth) -> tuple[str, ...]:
        mask = self.select_channels(world)
        ids = [name for name, taken in zip(world.satellite_ids, mask, strict=True) if taken]
        return tuple(f"{name}_{self.control}" for name in ids)

    def _displace(self, commanded: Commanded, rest: tuple[Any, ...]) -> None:
        per_channel(commanded, self.slots, *rest)
        if self.tracking is not None:
            displaced_ranges(self.memory["target_error"], self.coherent, *rest)


@settings_record(kw_only=True)
class Meaconer(Attack):
    r"""Replays the signals that the meaconer's antenna receives, with one delay.

    .. math:: \Delta\rho_j = \rho_j(r_m) - \rho_j(r) + |r_m - r| + D, \qquad D \ge 0

    and the range rates are the derivatives.  The victim's position becomes that of the antenna at
    :math:`r_m`; the path from there to the victim and the delay D, the only command, are common to
    all channels and go into the victim's clock.  There is no freedom per axis or per satellite.
    The motion of the satellites during the delay is left out: it is below 4 mm per kilometre of D.
    A meaconer needs no position, so it takes no `tracking`.
    """

    one_sided: ClassVar[bool] = True
    takes_tracking: ClassVar[bool] = False
    antenna_m: tuple[float, float, float] = setting(
        default=(0.0, 0.0, 0.0),
        unit="m",
        help="Way (3,) north, east, down from the target's to the meaconer's antenna at the onset.",
    )
    follows: bool = setting(
        default=True,
        help="Whether the antenna stays there, in the axes at the target's true position; if not, "
        "it stays where it was on the Earth.",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self.antenna_m = checked_vector("antenna_m", self.antenna_m)

    @property
    def kind(self) -> str:
        return "meaconer"

    @property
    def idle_is_clean(self) -> bool:
        return super().idle_is_clean and self.follows and self.antenna_m == (0.0, 0.0, 0.0)

    @property
    def is_smooth(self) -> bool:
        return self.follows  # the way from an antenna that stays behind bends

    def action_names(self, world: GroundTruth) -> tuple[str, ...]:
        return (f"delay_{self.control}",)

    def bind(self, context: AttackContext) -> None:
        super().bind(context)
        none = np.zeros((context.receivers, 3))
        self.memory.declare_all(antenna=none, antenna_rate=none)

    def start_episodes(
        self, rows: NDArray[np.intp], keys: NDArray[np.uint64], onsets: NDArray[np.int64]
    ) -> None:
        super().start_episodes(rows, keys, onsets)
        self.memory["antenna"][rows] = (self.world.at_hand.C_en[onsets] * self.antenna_m).sum(
            axis=2
        )

    def _displace(self, commanded: Commanded, rest: tuple[Any, ...]) -> None:
        world, memory, (epochs, *_, lo, hi) = self.world.at_hand, self.memory, rest
        if self.follows:
            coming, here = epochs[lo:hi] + 1, slice(lo, hi)
            memory["antenna"][here] = (world.C_en[coming] * self.antenna_m).sum(axis=2)
            memory["antenna_rate"][here] = (world.axes_turning[coming] * self.antenna_m).sum(axis=2)
        antenna = memory["antenna"], memory["antenna_rate"]
        meaconer(commanded, antenna, self.follows, memory["onset"], *rest)
