"""Offsets of the pseudoranges of all or some satellites, commanded in a basis of choice."""

from __future__ import annotations

import dataclasses
import re
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from ..core.declared import setting, settings_record
from ..core.registry import require
from ..truth.noise import normals, pad_count
from ..truth.run import GroundTruth
from . import _offset_kernels as kernels
from .base import Attack, AttackContext
from .commands import AXES, tabulate_axes
from .equipment import FloatArray

BASES = {
    "satellites": kernels.SATELLITES,
    "position+clock": kernels.POSITION_CLOCK,
    "rotated": kernels.ROTATED,
}
SOME = re.compile(r"(\d+) (?:of (\d+)|(highest|lowest|drawn))")
FEWEST = 2  # captured channels: the offset of one alone is no attack on a position
FIX = 4  # unknowns of a fix


@settings_record(kw_only=True)
class Offsets(Attack):
    r"""Offsets of pseudoranges, by satellite or by what they imply: position, clock, residual.

    With the unit vectors :math:`u_s` from the receiver to the captured satellites, a displacement D
    of the implied position and a common offset b, the offset of a channel is

    .. math:: \Delta\rho_s = \rho_s(r + D) - \rho_s(r) + b + \sum_j R_{js} c_j \approx
        -u_s \cdot D + b + \sum_j R_{js} c_j

    where the rows of R are unit vectors orthogonal to the columns :math:`-u_s` and 1, and to one
    another: what a test of the consistency of these channels sees, and no position or clock does.
    All of it is computed from the geometry of every epoch, so that a displacement that is held
    stays consistent while satellites and target move.  Range rates are the derivatives.

    An action of 1 requests a rate, or an offset, of its axis.  Limits shorten the *whole vector*,
    since shortened single channels would not fit together any more: the largest rate of a channel
    with ``basis="satellites"``; else :math:`|\dot D| + |\dot b| + |\dot c|`, which no channel
    exceeds.  Axes that change no measurement, such as slots of satellites that are not in view, are
    masked: commands there have no effect.
    """

    reports: ClassVar[tuple[str, ...]] = ("offsets_m", "requested_offsets_m", "action_mask")
    channel_words: ClassVar[str] = ", 'K of N', 'K highest', 'K lowest', 'K drawn'"
    control: str = setting(
        default="rate",
        one_of=("rate", "offset"),
        help="What an action commands: the rate of the amplitude of its axis, or the amplitude "
        "itself at the end of the interval.",
    )
    basis: str = setting(
        default="satellites",
        one_of=BASES,
        help='Axes of the action.  ``"satellites"``: one a captured slot; ``"position+clock"``: '
        'north, east and down, and the common offset of all captured; ``"rotated"``: these and '
        'the residual axes, together the space of ``"satellites"``.',
    )
    slot_order: str = setting(
        default="id",
        one_of=("id", "elevation"),
        help="Order of the slots: that of the receiver's channels, or by elevation at the onset, "
        "the highest first.",
    )
    scales_mps: tuple[float, ...] = setting(
        default=(1.0, 0.25, 0.05),
        above=0.0,
        unit="m/s",
        help="Rates that an action of 1 requests: of position and of single satellites, of the "
        "common offset, of residuals.",
    )
    span_s: float = setting(
        default=150.0,
        above=0.0,
        unit="s",
        help="An offset of 1 is what these rates come to in this time, in actions with "
        '``control="offset"`` and in observations: 150, 37.5 and 7.5 m.',
    )

    def __post_init__(self) -> None:
        self.scales_mps = tuple(self.scales_mps)
        require(
            len(self.scales_mps) == 3,
            f"`scales_mps` must be three numbers: position, clock, residual; got {self.scales_mps}",
        )
        super().__post_init__()

    def _check_channels(self) -> None:
        match = self._some
        if match is None:
            super()._check_channels()
        count = FEWEST if isinstance(self.channels, str) else len(self.channels)
        require(
            (count if match is None else int(match[1])) >= FEWEST,
            f"`channels` must capture at least {FEWEST} satellites, got {self.channels!r}",
        )

    @property
    def _some(self) -> re.Match[str] | None:
        return SOME.fullmatch(self.channels) if isinstance(self.channels, str) else None

    @property
    def kind(self) -> str:
        return "offsets"

    def select_channels(self, world: GroundTruth) -> NDArray[np.bool_]:
        some = self._some
        if some is None:
            mask = super().select_channels(world)
        else:
            mask = np.array([bool(name) for name in world.satellite_ids])
            most, count = int(mask.sum()), int(some[1])
            fits = f"'{min(count, most)} of {most}'"
            require(
                count <= most and int(some[2] or most) == most,
                f"`channels` {self.channels!r} does not fit {world.name!r}, which has {most} "
                f"satellites: such as {fits}, '{min(count, most)} highest' or "
                f"'{min(count, most)} drawn'",
            )
            if some[2]:
                mask &= np.cumsum(mask) <= count
        require(
            mask.sum() >= FEWEST,
            f"`channels` {self.channels!r} captures {mask.sum()} satellites of {world.name!r}, at "
            f"least {FEWEST} are needed",
        )
        return mask

    def count_slots(self, world: GroundTruth) -> int:
        some = self._some
        mask = self.select_channels(world)
        return int(some[1]) if some is not None else int(mask.sum())

    @property
    def varies(self) -> bool:
        """Whether other channels may be captured, or in another order, in every episode."""
        by_sky = self._some is not None and not self._some[2]
        return by_sky or self.slot_order == "elevation"

    def axis_names(self, world: GroundTruth) -> tuple[str, ...]:
        """(a,) names of the axes."""
        slots = self.count_slots(world)
        if self.basis == "satellites":
            return tuple(f"slot{s:02d}" for s in range(slots))
        more = max(slots - FIX, 0) if self.basis == "rotated" else 0
        return (*AXES.values(), "clock", *(f"residual{s:02d}" for s in range(more)))

    def action_names(self, world: GroundTruth) -> tuple[str, ...]:
        return tuple(f"{name}_{self.control}" for name in self.axis_names(world))

    def unit_rates(self, world: GroundTruth) -> FloatArray:
        position, clock, residual = self.scales_mps
        axes = len(self.axis_names(world))
        if self.basis == "satellites":
            return np.full(axes, position)
        return np.array([position] * 3 + [clock] + [residual] * (axes - FIX))

    def action_scales(self, world: GroundTruth) -> FloatArray:
        """(a,) what an action of 1 requests [m/s], or [m] with ``control="offset"``."""
        return self.unit_rates(world) * (self.span_s if self.control == "offset" else 1.0)

    @property
    def unit_scale(self) -> float:
        """Rate of a position or satellite that an action of 1 requests [m/s]."""
        return self.scales_mps[0]

    def measure_size(self, vector: FloatArray) -> float:
        """Size of a vector (a,) of amplitudes or of their rates, as limits take it."""
        return float(kernels.measure_size(np.ascontiguousarray(vector), BASES[self.basis]))

    def bind(self, context: AttackContext) -> None:
        super().bind(context)
        world, b, n = context.world, context.receivers, context.world.channels
        slots, axes = self.count_slots(world), self.idle.shape[1]
        self.memory.declare_all(
            requested=np.zeros((b, axes)),
            taken=np.tile(self.mask, (b, 1)),
            orders=np.zeros((b, slots), dtype=np.int64),
            bases=np.zeros((b, max(axes - FIX, 0) * (self.basis == "rotated")), dtype=np.int64),
            residual=np.full((b, n), np.nan),
        )
        limits = self.rate_limit_mps, self.acceleration_limit_mps2
        numbers = *map(float, limits), bool(self.coherent), self.action_scales(world)
        self._rules = kernels.Rules(BASES[self.basis], self.control == "offset", *numbers)

    @property
    def axes_e(self) -> FloatArray:
        """(K, 3, 6) local axes, as of `FalsePosition`."""
        return tabulate_axes(self.world, "ned")

    def start_episodes(
        self, rows: NDArray[np.intp], keys: NDArray[np.uint64], onsets: NDArray[np.int64]
    ) -> None:
        super().start_episodes(rows, keys, onsets)
        elevation, _ = self.world.at_hand.look(onsets)
        for row, key, onset, height in zip(rows, keys, onsets, elevation, strict=True):
            order = self._order_slots(self._rank(key, int(onset), height), int(onset), height)
            taken = np.zeros_like(self.mask)
            taken[order] = self.mask[order]
            self.memory["taken"][row], self.memory["orders"][row] = taken, order
            self.memory["bases"][row] = self._choose_bases(order, int(onset))

    def _rank(self, key: NDArray[np.uint64], onset: int, elevation: FloatArray) -> NDArray[np.intp]:
        """Channels of the world by precedence of capture: in view first."""
        some, place = self._some, np.arange(len(self.mask), dtype=np.float64)
        if some is not None and some[3] == "drawn":
            place = np.empty(pad_count(len(self.mask)))
            normals(key[0], key[1], 2 * onset + 1, place)
        elif some is not None and some[3]:
            place = -elevation if some[3] == "highest" else elevation
        hidden = ~self.world.at_hand.visible[onset] if some is not None and some[3] else ~self.mask
        return np.lexsort((place[: len(self.mask)], hidden, ~self.mask))

    def _order_slots(
        self, rank: NDArray[np.intp], onset: int, elevation: FloatArray
    ) -> NDArray[np.intp]:
        chosen = np.sort(rank[: self.memory["orders"].shape[1]])
        if self.slot_order == "elevation":
            empty = ~self.world.at_hand.satellites[onset, chosen, :3].any(axis=1)
            chosen = chosen[np.lexsort((-elevation[chosen], empty))]
        return chosen

    def _choose_bases(self, order: NDArray[np.intp], onset: int) -> NDArray[np.intp]:
        """(R,) channels of the residual axes: all but the four of the best geometry at the onset,
        which fix the position, so that the axes never lose their directions."""
        if not self.memory["bases"].shape[1]:
            return order[:0]
        world = self.world.at_hand
        seen = world.visible[onset, order]
        sight = world.satellites[onset, order, :3] - world.position_e[onset]
        sight /= np.linalg.norm(sight, axis=1, keepdims=True)
        design = np.column_stack([sight, np.ones(len(order))]) * seen[:, None]
        pivots = qr(design.T, mode="economic", pivoting=True)[2]
        return np.asarray(order[np.sort(pivots[FIX:])])

    def command(
        self,
        action: FloatArray | None,
        epochs: NDArray[np.int64],
        d_range: FloatArray,
        d_rate: FloatArray,
        lo: int,
        hi: int,
    ) -> None:
        super().command(action, epochs, d_range, d_rate, lo, hi)
        if self.is_perfect:
            return
        # own clock and errors are those of the channels that are captured in this episode
        memory, free = self.memory, ~self.memory["taken"][lo:hi]
        d_range[lo:hi][free] = d_rate[lo:hi][free] = 0.0
        memory["captured"][lo:hi][free] = False
        memory["authentic"][lo:hi][np.tile(free, 2)] = 1.0

    def _displace(self, commanded: Any, rest: tuple[Any, ...]) -> None:
        epochs, truth, _, *written = rest
        kernels.command_offsets(
            *(commanded.action, commanded.hold, self._rules, self._moved, self._capturing),
            *(self.axes_e, self.memory["target_error"], epochs, truth, *written),
        )

    @property
    def _moved(self) -> kernels.Moved:
        return kernels.Moved(*(self.memory[name] for name in kernels.Moved._fields))

    @property
    def _capturing(self) -> kernels.Capturing:
        return kernels.Capturing(*(self.memory[name] for name in kernels.Capturing._fields))

    def report(self, epochs: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """Offsets (B, S) of the slots at the epochs (B,) that receivers are at, as they are, and as
        actions requested them [m]; and (B, a) bool, whether an action of each axis counts next."""
        known = self._rules, self._capturing, self.axes_e, self.memory["target_error"]
        shape, moved = self.memory["orders"].shape, self._moved
        played, requested = np.empty((2, *shape))
        live = np.empty(self.idle.shape, dtype=np.bool_)
        truth = epochs, self.world.at_hand.epoch_truth
        kernels.list_offsets(moved.displacement, *known, *truth, played, live)
        kernels.list_offsets(moved.requested, *known, *truth, requested, live)
        return {"offsets_m": played, "requested_offsets_m": requested, "action_mask": live}


def as_offsets(attack: Attack, **chosen: Any) -> Offsets:
    """An attack by offsets with the limits, equipment and channels of another one.

    Parameters
    ----------
    attack : Attack
        A false position, offsets per channel, or offsets already, whose settings stay.
    **chosen : object
        Settings of `Offsets` that replace them.

    Returns
    -------
    Offsets
        Not bound yet.

    Raises
    ------
    ValueError
        For a meaconer, which has no freedom by satellite.

    Examples
    --------
    >>> from spoofgym.attacks import as_offsets, make_attack
    >>> as_offsets(make_attack("tracking-1m"), basis="rotated", channels="5 of 8").label
    'offsets-partial-tracking'
    """
    require(
        not attack.one_sided,
        f"`control` and `basis` need an attack that offsets single satellites, got {attack.kind!r}",
    )
    shared = Offsets if isinstance(attack, Offsets) else Attack
    fields = [each.name for each in dataclasses.fields(shared)]
    own = {"threat"} if shared is Offsets else {"threat", "control"}
    common = {name: getattr(attack, name) for name in fields if name not in own}
    return Offsets(**{**common, **chosen})
