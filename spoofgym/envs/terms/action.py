"""What a spoofer commands: a list of small terms, each with names and a linear map.

Every element of an action lies in [-1, 1].  A term maps its elements to the command that the attack
takes; the commands of all terms are added, and the attack limits their sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...simulators.setup import Setup

FloatArray = NDArray[np.float64]


class ActionTerm(Protocol):
    """One part of the action."""

    def names(self, setup: Setup) -> tuple[str, ...]:
        """Name of every element, k names; a ValueError where the attack can't be commanded so."""

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        """(B, a, k): the command is its product with the k elements; (B,) headings in radians."""


def _columns(setup: Setup, wanted: Sequence[str], word: str) -> list[int]:
    """Which elements of the command belong to some axes or satellites."""
    stems = [name.rsplit("_", 1)[0] for name in setup.action_names]
    for stem in wanted:
        if stem not in stems:
            raise ValueError(
                f"the attack has no {word} {stem!r} to command; valid: {', '.join(stems)}"
            )
    return [stems.index(stem) for stem in wanted]


@dataclass(frozen=True)
class FullCommand:
    """Every element that the attack takes, as it is."""

    def names(self, setup: Setup) -> tuple[str, ...]:
        """Those of the attack."""
        return setup.action_names

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        """The identity."""
        axes = len(setup.action_names)
        return np.tile(np.eye(axes), (len(heading_rad), 1, 1))


@dataclass(frozen=True)
class AlongTarget:
    """One element along the direction in which displacement counts.

    The attack must be a false position with commands north and east.
    """

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``along_target_acceleration`` or ``along_target_rate``."""
        if setup.target_heading_deg == "worst":
            raise ValueError(
                "an element along the target direction needs one; `target_heading_deg` is 'worst'"
            )
        north, east = _columns(setup, ("north", "east"), "axis")
        limits = np.broadcast_to(setup.attack.rate_limit_mps, len(setup.action_names))
        if limits[north] != limits[east]:
            raise ValueError(
                "an element along the target direction needs the same limit north and east, got "
                f"{limits[north]:g} and {limits[east]:g}"
            )
        return (f"along_target_{setup.attack.control}",)

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        """Cosine and sine of the heading."""
        north, east = _columns(setup, ("north", "east"), "axis")
        result = np.zeros((len(heading_rad), len(setup.action_names), 1))
        result[:, north, 0], result[:, east, 0] = np.cos(heading_rad), np.sin(heading_rad)
        return result


@dataclass(frozen=True)
class AcrossTarget:
    """One element across the direction in which displacement counts, to its right.

    The attack must be a false position with commands north and east.
    """

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``across_target_acceleration`` or ``across_target_rate``."""
        AlongTarget().names(setup)
        return (f"across_target_{setup.attack.control}",)

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        """Minus sine and cosine of the heading."""
        return AlongTarget().matrix(setup, heading_rad + np.pi / 2.0)


@dataclass(frozen=True)
class Channels:
    """One element for each of some channels or axes; the others are left alone.

    Parameters
    ----------
    ids : tuple of str
        Satellites of an attack per channel, such as ``"S05"``, or axes of a false position, such as
        ``"north"``.
    """

    ids: tuple[str, ...]

    def __post_init__(self) -> None:
        """Check the names."""
        ids = (self.ids,) if isinstance(self.ids, str) else tuple(self.ids)
        if not ids or len(set(ids)) < len(ids) or not all(isinstance(i, str) for i in ids):
            raise ValueError(f"`ids` must be different names, at least one, got {self.ids!r}")
        object.__setattr__(self, "ids", ids)

    def names(self, setup: Setup) -> tuple[str, ...]:
        """Those of the attack."""
        names = setup.action_names
        return tuple(names[i] for i in _columns(setup, self.ids, "channel"))

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        """Columns of the identity."""
        columns = _columns(setup, self.ids, "channel")
        return FullCommand().matrix(setup, heading_rad)[:, :, columns]


@dataclass(frozen=True)
class CommonOffset:
    """One element for all channels alike, which the victim's clock takes for its own.

    The attack must command every channel for itself.
    """

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``common_acceleration`` or ``common_rate``."""
        if setup.attack.kind != "per-channel":
            raise ValueError(
                "a common offset needs an attack per channel, 'per-channel', got "
                f"{setup.attack.kind!r}"
            )
        return (f"common_{setup.attack.control}",)

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        """A column of 1."""
        return np.ones((len(heading_rad), len(setup.action_names), 1))


ACTION_TERMS: dict[str, type[ActionTerm]] = {
    "full-command": FullCommand,
    "along-target": AlongTarget,
    "across-target": AcrossTarget,
    "channels": Channels,
    "common-offset": CommonOffset,
}
"""Terms by name; one's own may be added."""


class CommandMap:
    """Commands of a list of terms, in the order of the action: `names` (k,) of its elements.

    `is_plain` says that an action is the command.
    """

    def __init__(self, terms: Sequence[ActionTerm], setup: Setup) -> None:
        if not terms:
            raise ValueError("an action needs at least one term")
        self.setup, self._terms = setup, tuple(terms)
        names = [name for term in terms for name in term.names(setup)]
        if len(set(names)) < len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise ValueError(f"two terms command by the same name: {', '.join(twice)}")
        self.names = tuple(names)
        self.is_plain = len(self._terms) == 1 and isinstance(self._terms[0], FullCommand)
        self._matrix = np.zeros((0, 0, 0))

    def aim(self, heading_rad: FloatArray) -> None:
        """Take the directions (B,) of the running episodes, clockwise from north."""
        if not self.is_plain:
            parts = [term.matrix(self.setup, heading_rad) for term in self._terms]
            self._matrix = np.ascontiguousarray(np.concatenate(parts, axis=2))

    def command(self, action: FloatArray) -> FloatArray:
        """Command (B, a), C-contiguous, of an action (B, k) in [-1, 1]; the attack limits it."""
        if self.is_plain:
            return action
        # a sum of products, since the bits of a matrix product depend on the size of the batch
        result: FloatArray = (self._matrix * action[:, None, :]).sum(axis=2)
        return result
