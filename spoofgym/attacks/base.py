"""The contract of an attack: commands in, offsets of pseudoranges and range rates out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._memory import Memory
from ..sim.world import World

FloatArray = NDArray[np.float64]
CONTROLS = ("rate", "acceleration")


class AttackContext(NamedTuple):
    """What an attack is told once.

    Attributes
    ----------
    receivers : int
        B.
    world : World
        Truth; the spoofer's equipment knows geometry and the target's true motion.
    """

    receivers: int
    world: World


@dataclass(kw_only=True)
class Attack(ABC):
    r"""An attack commanded by rate or by acceleration of its offsets.

    The commanded offset D and its rate v follow from the commands by one kinematic step an epoch,

    .. math:: v^+ = v + a \tau, \qquad D^+ = D + v \tau + \tfrac12 a \tau^2

    where a command of acceleration is limited in size, and shortened where the rate would exceed
    its limit; a command of rate is held over the interval, :math:`D^+ = D + v^+ \tau`.

    Parameters
    ----------
    control : {"acceleration", "rate"}
        What an action of 1 commands: the limit of acceleration or of rate.
    acceleration_limit_mps2 : float
        Largest acceleration of the offset, above 0; not used with ``control="rate"``.
    rate_limit_mps : float
        Largest rate of the offset, above 0.
    coherent : bool
        Whether the range rates follow the commanded ranges.  If not, the code drifts away from the
        carrier, which a receiver could see: the attack is labelled ``pseudorange-only``.
    channels : "all" or tuple of str
        Ids of the satellites that are counterfeited.
    """

    control: str = "acceleration"
    acceleration_limit_mps2: float = 0.05
    rate_limit_mps: float = 5.0
    coherent: bool = True
    channels: str | tuple[str, ...] = "all"

    def __post_init__(self) -> None:
        """Check the settings."""
        if self.control not in CONTROLS:
            raise ValueError(
                f"`control` must be one of {', '.join(map(repr, CONTROLS))}, got {self.control!r}"
            )
        for name in ("acceleration_limit_mps2", "rate_limit_mps"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"`{name}` must be finite and > 0, got {value}")
        if isinstance(self.channels, str):
            if self.channels != "all":
                raise ValueError(
                    f"`channels` must be 'all' or some satellite ids, got {self.channels!r}"
                )
        else:
            self.channels = tuple(self.channels)
            if not self.channels:
                raise ValueError("`channels` must name at least one satellite")

    @property
    @abstractmethod
    def kind(self) -> str:
        """Name of what is commanded."""

    @property
    def label(self) -> str:
        """Threat in a word, for results."""
        partial = "" if self.channels == "all" else "-partial"
        return f"{self.kind}{partial}" + ("" if self.coherent else "-pseudorange-only")

    @property
    def unit_scale(self) -> float:
        """What an action of 1 commands [m/s^2] or [m/s]."""
        if self.control == "acceleration":
            return self.acceleration_limit_mps2
        return self.rate_limit_mps

    def captured(self, world: World) -> NDArray[np.bool_]:
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
            When a satellite is not in the world; those that are, are listed.
        """
        present = [name for name in world.satellite_ids if name]
        if self.channels == "all":
            return np.array([bool(name) for name in world.satellite_ids])
        for name in self.channels:
            if name not in present:
                raise ValueError(
                    f"satellite {name!r} is not in view on {world.name!r}; in view: "
                    f"{', '.join(present)}"
                )
        return np.array([name in self.channels and bool(name) for name in world.satellite_ids])

    @abstractmethod
    def action_names(self, world: World) -> tuple[str, ...]:
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
        self.mask = self.captured(context.world)
        axes = len(self.action_names(context.world))
        self._idle = np.zeros((context.receivers, axes))
        self.memory = Memory(context.receivers)
        self.memory.declare("displacement", np.zeros((context.receivers, axes)))
        self.memory.declare("rate", np.zeros((context.receivers, axes)))
        self.memory.declare("onset", np.zeros(context.receivers, dtype=np.int64))
        self.memory.declare("key", np.zeros((context.receivers, 2), dtype=np.uint64))

    def begin(
        self, rows: NDArray[np.intp], keys: NDArray[np.uint64], onsets: NDArray[np.int64]
    ) -> None:
        """Begin new episodes of some receivers; their memory has been reset before.

        Parameters
        ----------
        rows : ndarray
            Which receivers.
        keys : ndarray
            (b, 2) keys of the attack's noise in these episodes, for `spoofgym.sim.noise.normals`.
        onsets : ndarray
            (b,) epochs of the world after which the attack begins.
        """
        self.memory["onset"][rows] = onsets
        self.memory["key"][rows] = keys

    @abstractmethod
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
