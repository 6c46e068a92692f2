"""The contract of an attack: commands in, offsets of pseudoranges and range rates out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from fnmatch import fnmatchcase
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..core.memory import Memory
from ..core.registry import build_record, require
from ..core.settings import get_kind
from ..truth.run import GroundTruth
from ._kernels import Commanded
from .equipment import (
    QUIET,
    REPLACED,
    Capture,
    CounterfeitErrors,
    Equipment,
    FloatArray,
    SpooferClock,
    TrackingError,
)

CONTROLS = ("rate", "acceleration")
ERRORS: dict[str, CounterfeitErrors | None] = {
    "inherited": None,
    "replaced": REPLACED,
    "quiet": QUIET,
}


class AttackContext(NamedTuple):
    """What an attack is given once.

    Attributes
    ----------
    receivers : int
        B.
    world : World
        Truth; the spoofer's equipment knows geometry and the target's true motion.
    """

    receivers: int
    world: GroundTruth


def _record(name: str, kind: type[Any], given: Any) -> Any:
    if isinstance(given, Mapping) and given.get("kind") == get_kind(kind):
        given = {key: value for key, value in given.items() if key != "kind"}
    return build_record(name, kind, given)


@settings_record(kw_only=True)
class Attack(ABC):
    r"""An attack commanded by rate or by acceleration of its offsets.

    The commanded offset D and its rate v follow from the commands by one kinematic step an epoch,

    .. math:: v^+ = v + a \tau, \qquad D^+ = D + v \tau + \tfrac12 a \tau^2

    where a command of acceleration is limited in size, and shortened where the rate would exceed
    its limit; a command of rate is held over the interval, :math:`D^+ = D + v^+ \tau`.

    Attributes
    ----------
    one_sided : bool
        Whether offsets cannot fall below zero.
    limits_size : bool
        Whether the limits apply to the size of the command as a vector, not to every element.
    takes_tracking : bool
        Whether it needs the target's position, which `tracking` makes uncertain.
    """

    one_sided: ClassVar[bool] = False
    limits_size: ClassVar[bool] = False
    takes_tracking: ClassVar[bool] = True
    reports: ClassVar[tuple[str, ...]] = ()  # keys of `report`
    channel_words: ClassVar[str] = ""  # further forms of `channels`, for messages
    control: str = setting(
        default="acceleration",
        one_of=CONTROLS,
        help="What an action of 1 commands: the limit of acceleration or of rate.",
    )
    acceleration_limit_mps2: float = setting(
        default=0.05,
        above=0.0,
        unit="m/s^2",
        help='Largest acceleration of the offset; not used with ``control="rate"``.',
    )
    rate_limit_mps: float = setting(
        default=5.0, above=0.0, unit="m/s", help="Largest rate of the offset."
    )
    coherent: bool = setting(
        default=True,
        help="Whether the range rates follow the commanded ranges.  If not, the code drifts away "
        "from the carrier, which a receiver could see: the attack is labelled "
        "``pseudorange-only``.",
    )
    channels: str | tuple[str, ...] = setting(
        default="all",
        help='Which satellites are counterfeited: ``"all"``, ids, or patterns such as ``"E*"`` for '
        "a whole constellation.",
    )
    errors: str | Mapping[str, Any] | CounterfeitErrors = setting(
        default="inherited",
        one_of=ERRORS,
        help='Errors of the counterfeit measurements.  ``"inherited"``: the authentic ones stay, '
        'which is idealised; ``"replaced"``: at the capture the noise of the receiver alone takes '
        'their place; ``"quiet"``: the same, blended in over 30 s, which a test for too large '
        "innovations never sees; else settings of what takes their place.",
    )
    tracking: Mapping[str, Any] | TrackingError | None = setting(
        default=None,
        help="How badly the spoofer knows the target's position; perfectly by default.",
    )
    spoofer_clock: Mapping[str, Any] | SpooferClock | None = setting(
        default=None, help="Clock of the spoofer; perfect by default."
    )
    capture: Mapping[str, Any] | Capture | None = setting(
        default=None,
        help="When channels follow the counterfeit signals; all of them at the onset by default.",
    )
    threat: str = setting(
        default="",
        help="Name in `THREATS` that the settings belong to, for results; `make_attack` sets it.",
    )

    def __post_init__(self) -> None:
        require(
            self.takes_tracking or self.tracking is None,
            f"`tracking` must be None, since a {self.kind} needs no position; got {self.tracking}",
        )
        self._check_channels()
        self._check_options()

    def _check_channels(self) -> None:
        if isinstance(self.channels, str):
            require(
                self.channels == "all" or "*" in self.channels,
                f"`channels` must be 'all'{self.channel_words} or a pattern such as 'E*' or some "
                f"satellite ids, got {self.channels!r}",
            )
        else:
            self.channels = tuple(self.channels)
            require(self.channels, "`channels` must name at least one satellite")
            require(
                len(set(self.channels)) >= len(self.channels),
                f"`channels` must name each satellite once, got {self.channels}",
            )

    def _check_options(self) -> None:
        if isinstance(self.errors, str):
            self.errors = ERRORS[self.errors] or "inherited"
        else:
            self.errors = _record("errors", CounterfeitErrors, self.errors)
        for name, kind in (
            ("tracking", TrackingError),
            ("spoofer_clock", SpooferClock),
            ("capture", Capture),
        ):
            given = getattr(self, name)
            if given is not None:
                setattr(self, name, _record(name, kind, given))

    @property
    @abstractmethod
    def kind(self) -> str:
        """Name of what is commanded."""

    @property
    def label(self) -> str:
        """Threat in a word, for results."""
        name = self.threat or self.kind + ("" if self.channels == "all" else "-partial")
        if not self.threat:
            options = {
                "quiet": self.errors == QUIET,
                "replaced": self.errors not in ("inherited", QUIET),
                "tracking": self.tracking is not None,
                "clock": self.spoofer_clock is not None,
                "capture": self.capture is not None,
            }
            name += "".join(f"-{word}" for word, chosen in options.items() if chosen)
        hint = "" if self.coherent or "pseudorange-only" in name else "-pseudorange-only"
        return name + hint

    @property
    def equipment(self) -> Equipment:
        """Options as records."""
        records: dict[str, Any] = {
            "errors": None if self.errors == "inherited" else self.errors,
            "tracking": self.tracking,
            "clock": self.spoofer_clock,
            "capture": self.capture,
        }
        return Equipment(**records)

    @property
    def replaces_errors(self) -> bool:
        """Whether ``memory["authentic"]`` says which authentic errors stay."""
        return self.errors != "inherited"

    @property
    def idle_is_clean(self) -> bool:
        """Whether an attack without commands leaves the measurements as they are, exactly."""
        imperfect = self.tracking is not None or self.spoofer_clock is not None
        return not (imperfect or self.replaces_errors)

    @property
    def is_smooth(self) -> bool:
        """Whether ranges change over an epoch by the mean of their rates at its two ends."""
        return True

    @property
    def unit_scale(self) -> float:
        """What an action of 1 commands [m/s^2] or [m/s]."""
        if self.control == "acceleration":
            return self.acceleration_limit_mps2
        return self.rate_limit_mps

    def unit_rates(self, world: GroundTruth) -> FloatArray:
        """(a,) rates that an action of 1 comes to, while acceleration does not limit it [m/s]."""
        return np.full(len(self.action_names(world)), float(self.rate_limit_mps))

    @property
    def kernel_settings(self) -> FloatArray:
        """(4,) whether rates are commanded, scale of an action, limit of the rate, coherence."""
        rules = (self.control == "rate", self.unit_scale, self.rate_limit_mps, self.coherent)
        return np.array(rules, dtype=np.float64)

    def select_channels(self, world: GroundTruth) -> NDArray[np.bool_]:
        """Which channels are counterfeited.

        Parameters
        ----------
        world : World
            Names its slots.

        Returns
        -------
        ndarray
            (n,) bool.

        Raises
        ------
        ValueError
            When a satellite is not in the world, or a pattern fits none; lists those that are.
        """
        present = [name for name in world.satellite_ids if name]
        wanted = (self.channels,) if isinstance(self.channels, str) else self.channels
        patterns = ["*" if name == "all" else name for name in wanted]
        for pattern in patterns:
            require(
                any(fnmatchcase(name, pattern) for name in present),
                f"satellite {pattern!r} is not in view on {world.name!r}; in view: "
                f"{', '.join(present)}",
            )
        return np.array(
            [
                bool(name) and any(fnmatchcase(name, pattern) for pattern in patterns)
                for name in world.satellite_ids
            ]
        )

    @abstractmethod
    def action_names(self, world: GroundTruth) -> tuple[str, ...]:
        """Name of every element of an action.

        Parameters
        ----------
        world : World
            Names its slots.

        Returns
        -------
        tuple of str
            Names, with unit.
        """

    def bind(self, context: AttackContext) -> None:
        """Prepare for a batch of receivers.

        Parameters
        ----------
        context : AttackContext
            Sizes and world.
        """
        self.world = context.world
        self.mask = self.select_channels(context.world)
        axes = len(self.action_names(context.world))
        self.idle = np.zeros((context.receivers, axes))
        self.slots = np.flatnonzero(self.mask)
        self.memory = Memory(context.receivers)
        b = context.receivers
        self.memory.declare_all(
            displacement=np.zeros((b, axes)),
            rate=np.zeros((b, axes)),
            onset=np.zeros(b, dtype=np.int64),
            key=np.zeros((b, 2), dtype=np.uint64),
        )
        self._equipment = self.equipment
        self.is_perfect = self._equipment.perfect
        self._equipment.declare(self.memory, context.world.channels)

    def start_episodes(
        self, rows: NDArray[np.intp], keys: NDArray[np.uint64], onsets: NDArray[np.int64]
    ) -> None:
        """Begin new episodes of some receivers; their memory has been reset before.

        Parameters
        ----------
        rows : ndarray
            Which receivers.
        keys : ndarray
            (b, 2) keys of the attack's noise in these episodes, for `spoofgym.truth.noise.normals`.
        onsets : ndarray
            (b,) epochs of the world after which the attack begins.
        """
        self.memory["onset"][rows] = onsets
        self.memory["key"][rows] = keys
        self._equipment.start_episodes(self.memory, self.world, rows, keys, onsets)

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

        Parameters
        ----------
        action : ndarray or None
            (B, a) in [-1, 1]; None holds the rate.
        epochs : ndarray
            (B,) the epoch that each receiver is at.
        d_range, d_rate : ndarray
            (B, n), written [m], [m/s].
        lo, hi : int
            Slice of receivers to work on.
        """
        memory, world, offsets = self.memory, self.world.at_hand, (d_range, d_rate, lo, hi)
        self._equipment.advance(memory, world, epochs, lo, hi)
        given = self.idle if action is None else action
        moved = memory["displacement"], memory["rate"]
        commanded = Commanded(given, action is None, self.kernel_settings, *moved)
        self._displace(commanded, (epochs, world.epoch_truth, self.mask, *offsets))
        self._equipment.transmit(memory, world, self.mask, self.coherent, epochs, *offsets)

    def report(self, epochs: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        """What the information of a step has of the attack.

        Parameters
        ----------
        epochs : ndarray
            (B,) the epoch that each receiver is at.

        Returns
        -------
        dict
            Arrays (B, ...) by `reports`.
        """
        return {}

    def _displace(self, commanded: Commanded, rest: tuple[Any, ...]) -> None:
        """What a command adds with perfect equipment; `rest`: of the arguments of the kernels, from
        `epochs` on. An attack has this or a `command` of its own."""
        raise NotImplementedError(f"{type(self).__name__} has no command")
