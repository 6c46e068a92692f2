"""What a spoofer commands: a list of small terms, each with names and a linear map.

Every element of an action lies in [-1, 1].  A term maps its elements to the command that the attack
takes; the commands of all terms are added, and the attack limits their sum.  A set-point is the
exception: it stands alone, its elements are a wanted rate, and the acceleration follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from ...core.declared import setting, settings_record
from ...simulation.domain import FloatArray
from ...simulation.setup import Setup
from ...spoofers.base import list_axes
from ...spoofers.build import make_spoofer, spec_of_spoofer
from ...spoofers.residual import SUFFIX, BaseAttack, check_base
from .._kernels import follow_rate


class ActionTerm(Protocol):
    """One part of the action."""

    def names(self, setup: Setup) -> tuple[str, ...]:
        """Name of every element, k names; a ValueError where the attack can't be commanded so."""

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        """(B, a, k): the command is its product with the k elements; (B,) headings in radians."""


def _columns(setup: Setup, wanted: Sequence[str], word: str) -> list[int]:
    stems = list_axes(setup.action_names)
    for stem in wanted:
        if stem not in stems:
            raise ValueError(
                f"the attack has no {word} {stem!r} to command; valid: {', '.join(stems)}"
            )
    return [stems.index(stem) for stem in wanted]


def _horizontal_limit(setup: Setup, whose: str) -> float:
    north, east = _columns(setup, ("north", "east"), "axis")
    limits = np.broadcast_to(setup.attack.rate_limit_mps, len(setup.action_names))
    if limits[north] != limits[east]:
        raise ValueError(
            f"{whose} needs the same limit north and east, got "
            f"{limits[north]:g} and {limits[east]:g}"
        )
    return float(limits[north])


@settings_record(frozen=True)
class FullCommand:
    """Every element that the attack takes, as it is."""

    def names(self, setup: Setup) -> tuple[str, ...]:
        return setup.action_names

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        axes = len(setup.action_names)
        return np.tile(np.eye(axes), (len(heading_rad), 1, 1))


@settings_record(frozen=True)
class AlongTarget:
    """One element along the direction in which displacement counts.

    The attack must be a false position with commands north and east.
    """

    along_target: ClassVar[bool] = True

    def names(self, setup: Setup) -> tuple[str, ...]:
        if setup.target_heading_deg == "worst":
            raise ValueError(
                "an element along the target direction needs `target_heading_deg` as an angle or "
                "'random', got 'worst'"
            )
        _horizontal_limit(setup, "an element along the target direction")
        return (f"along_target_{setup.attack.control}",)

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        north, east = _columns(setup, ("north", "east"), "axis")
        result = np.zeros((len(heading_rad), len(setup.action_names), 1))
        result[:, north, 0], result[:, east, 0] = np.cos(heading_rad), np.sin(heading_rad)
        return result


@settings_record(frozen=True)
class AcrossTarget:
    """One element across the direction in which displacement counts, to its right.

    The attack must be a false position with commands north and east.
    """

    def names(self, setup: Setup) -> tuple[str, ...]:
        AlongTarget().names(setup)
        return (f"across_target_{setup.attack.control}",)

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        return AlongTarget().matrix(setup, heading_rad + np.pi / 2.0)


@settings_record(frozen=True)
class Channels:
    """One element for each of some channels or axes; the others are left alone."""

    ids: tuple[str, ...] = setting(
        help='Satellites of an attack per channel, such as ``"S05"``, or axes of a false position, '
        'such as ``"north"``; different ones.'
    )

    def __post_init__(self) -> None:
        ids = (self.ids,) if isinstance(self.ids, str) else tuple(self.ids)
        if not ids or len(set(ids)) < len(ids) or not all(isinstance(i, str) for i in ids):
            raise ValueError(f"`ids` must be different names, at least one, got {self.ids!r}")
        object.__setattr__(self, "ids", ids)

    def names(self, setup: Setup) -> tuple[str, ...]:
        names = setup.action_names
        return tuple(names[i] for i in _columns(setup, self.ids, "channel"))

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        columns = _columns(setup, self.ids, "channel")
        return FullCommand().matrix(setup, heading_rad)[:, :, columns]


@settings_record(frozen=True)
class CommonOffset:
    """One element for all channels alike, which the victim's clock takes for its own.

    The attack must command every channel for itself.
    """

    def names(self, setup: Setup) -> tuple[str, ...]:
        if setup.attack.kind != "per-channel":
            raise ValueError(
                "a common offset needs an attack per channel, 'per-channel', got "
                f"{setup.attack.kind!r}"
            )
        return (f"common_{setup.attack.control}",)

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        return np.ones((len(heading_rad), len(setup.action_names), 1))


@settings_record(frozen=True)
class RateSetpoint:
    r"""Wanted rate of the displacement; the acceleration follows within the attack's limits.

    With the wanted rate w, the rate v so far, the attack's limits :math:`a_{max}` and
    :math:`v_{max}` and the time :math:`\tau` between epochs, every epoch takes

    .. math:: v^+ = \mathrm{cut}\left(v + \mathrm{cut}(w - v, a_{max} \tau), v_{max}\right)

    where :math:`\mathrm{cut}(x, l)` shortens a vector x to the length l: first the limit of the
    acceleration, then that of the rate.  An attack that is commanded by rate takes w at once, and
    its limit must be as large as the full scale.  The attack must be a false position with commands
    north and east.
    """

    dimensions: int = setting(
        default=1, least=1, most=2, help="Along the target direction (1), or north and east (2)."
    )
    full_scale_mps: float = setting(
        default=1.0,
        above=0.0,
        unit="m/s",
        help="Rate that an action of 1 requests. 1 m/s over the default window of 150 s are 150 m; "
        "the attacks that go unnoticed there are at 0.02 to 0.9 m/s.",
    )

    @property
    def along_target(self) -> bool:
        return self.dimensions == 1

    def names(self, setup: Setup) -> tuple[str, ...]:
        if setup.attack.kind == "offsets":
            raise ValueError(
                "an attack by offsets follows wanted rates itself: leave the set-point out, or "
                "take 'full-command' or 'along-target'"
            )
        if self.along_target:
            AlongTarget().names(setup)
            return ("along_target_setpoint",)
        _horizontal_limit(setup, "a rate set-point")
        return ("north_setpoint", "east_setpoint")

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        if self.along_target:
            return AlongTarget().matrix(setup, heading_rad)
        return Channels(("north", "east")).matrix(setup, heading_rad)


@settings_record(frozen=True)
class Residual:
    """A correction of the attack of a spoofer, whose actions it is added to.

    An action of 0 plays that attack as it is.  It stands alone.
    """

    spoofer: Any = setting(
        help="The base: a name, a name with settings, an ``.onnx`` file or an object, as "
        "`make_spoofer` takes it, which observes no more than the environment shows."
    )
    scale: float | None = setting(
        default=None,
        above=0.0,
        most=2.0,
        help="What a correction of 1 adds, in units of the action; None for 0.4 of the largest "
        "action of the base over an episode, for one that looks at nothing but a direction.",
    )
    action: Any = setting(
        default=None,
        help="Action terms that base and correction are of; None for the environment's own.",
    )

    def __post_init__(self) -> None:
        made = self.base.spoofer  # or what is wrong with it
        check_base(made)
        # in full, with the digest of a file: cards and stored results are of this base alone
        object.__setattr__(self, "spoofer", spec_of_spoofer(made))

    @cached_property
    def base(self) -> BaseAttack:
        """The base, not bound yet."""
        return BaseAttack(make_spoofer(self.spoofer), self.scale)

    def names(self, setup: Setup) -> tuple[str, ...]:
        return CommandMap([self], setup).names

    def matrix(self, setup: Setup, heading_rad: FloatArray) -> FloatArray:
        terms = self.list_terms(setup)
        return np.concatenate([each.matrix(setup, heading_rad) for each in terms], axis=2)

    def list_terms(self, setup: Setup) -> tuple[ActionTerm, ...]:
        """Terms that base and correction are of."""
        from . import make_terms  # which lists this one

        if self.action is None:
            return default_action(setup)
        terms = make_terms("action", self.action)
        if any(isinstance(each, Residual) for each in terms):
            raise ValueError("actions correct one base alone, and two are given")
        return terms


ACTION_TERMS: dict[str, type[ActionTerm]] = {
    "rate-setpoint": RateSetpoint,
    "full-command": FullCommand,
    "along-target": AlongTarget,
    "across-target": AcrossTarget,
    "channels": Channels,
    "common-offset": CommonOffset,
    "residual": Residual,
}


def default_action(setup: Setup) -> tuple[ActionTerm, ...]:
    """Action of an environment that is given none: the rate set-point of a victim that follows one,
    along the target direction or, where that is ``"worst"``, north and east; else what the attack
    takes, as it is with offsets."""
    if setup.attack.kind == "offsets" or not (
        setup.follows_setpoint and {"north", "east"} <= {*list_axes(setup.action_names)}
    ):
        return (FullCommand(),)
    return (RateSetpoint(2 if setup.target_heading_deg == "worst" else 1),)


class CommandMap:
    """Commands of a list of terms, in the order of the action: `names` (k,) of its elements.

    `is_plain`: an action is the command; `along_target`: all of it is along the target direction;
    `setpoint_mps`: rate that an action of 1 requests, None without a set-point; `base`: attack that
    actions are to be added to before they are given, with the names of corrections.
    """

    def __init__(self, terms: Sequence[ActionTerm], setup: Setup) -> None:
        if not terms:
            raise ValueError("an action needs at least one term")
        self.base: BaseAttack | None = None
        if any(isinstance(term, Residual) for term in terms):
            terms = self._take_base(terms, setup)
        self.setup, self.terms = setup, tuple(terms)
        names = [name for term in terms for name in term.names(setup)]
        if len(set(names)) < len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise ValueError(f"two action terms have the same command: {', '.join(twice)}")
        self.names = tuple(f"{name}{SUFFIX}" for name in names) if self.base else tuple(names)
        first = self.terms[0]
        alone = len(self.terms) == 1
        if not alone and any(isinstance(term, RateSetpoint) for term in terms):
            raise ValueError(
                "a rate set-point commands everything: no other action term can be added to it, "
                f"got {', '.join(type(term).__name__ for term in terms)}"
            )
        self.is_plain = alone and isinstance(first, FullCommand)
        self.along_target = alone and bool(getattr(first, "along_target", False))
        self.setpoint_mps = first.full_scale_mps if isinstance(first, RateSetpoint) else None
        self._rules = np.zeros(3)
        if self.setpoint_mps is not None:
            self._rules = _following(setup, self.setpoint_mps)
        self._matrix = np.zeros((0, 0, 0))
        self._out = np.zeros((0, 0))

    def _take_base(self, terms: Sequence[ActionTerm], setup: Setup) -> Sequence[ActionTerm]:
        """Keep the base of a correction; the terms that base and correction are of."""
        first = terms[0]
        if len(terms) > 1 or not isinstance(first, Residual):
            raise ValueError("a correction stands alone: give other terms as its `action`")
        self.base = first.base
        return first.list_terms(setup)

    def aim(self, heading_rad: FloatArray) -> None:
        """Take the directions (B,) of the running episodes, clockwise from north."""
        if not self.is_plain:
            parts = [term.matrix(self.setup, heading_rad) for term in self.terms]
            self._matrix = np.ascontiguousarray(np.concatenate(parts, axis=2))
            self._out = np.empty(self._matrix.shape[:2])

    def command(self, action: FloatArray, rate: FloatArray) -> FloatArray:
        """Command (B, a), C-contiguous, of an action (B, k), and the rate (B, a) so far [m/s]; the
        attack limits it. The array is overwritten by the next call."""
        if self.is_plain:
            return action
        follow_rate(action, self._matrix, self._rules, rate, self._out)
        return self._out


def _following(setup: Setup, setpoint_mps: float) -> FloatArray:
    """Factors of `follow_rate`: on the wanted rate, on the rate so far, and whether to shorten."""
    attack = setup.attack
    if attack.control == "rate":
        limit = _horizontal_limit(setup, "a rate set-point")
        if setpoint_mps > limit:
            raise ValueError(
                "`full_scale_mps` must be at most the limit of the rate by which the attack is "
                f"commanded, {limit:g}, got {setpoint_mps:g}"
            )
        return np.array([setpoint_mps / limit, 0.0, 1.0])
    most = attack.acceleration_limit_mps2 * setup.interval_s
    return np.array([setpoint_mps / most, 1.0 / most, 1.0])


class Decisions:
    """The last two decisions (B, k) of B receivers; the setup says how often one is due."""

    def __init__(self, setup: Setup, receivers: int, size: int) -> None:
        self.setup = setup
        self._before, self._last = np.zeros((receivers, size)), np.zeros((receivers, size))

    def due(self, epoch: Any) -> Any:
        return epoch % self.setup.repeat == 0

    def take(self, action: FloatArray, rows: Any = slice(None)) -> None:
        self._before[rows] = self._last[rows]
        self._last[rows] = action[rows]

    def action(self, epoch: int | NDArray[np.int64]) -> FloatArray:
        """Action (B, k) of an epoch, one or (B,) of them."""
        since = np.asarray(epoch)[..., None] % self.setup.repeat
        return self.setup.command(self._before, self._last, since)

    def forget(self, rows: Any) -> None:
        self._before[rows] = self._last[rows] = 0.0

    def of(self, rows: NDArray[np.intp]) -> Decisions:
        part = Decisions(self.setup, len(rows), self._last.shape[1])
        part._before, part._last = self._before[rows], self._last[rows]
        return part
