"""What a spoofer observes: a list of small terms, each with names and bounds.

Knowledge at run time has three levels: ``blind`` (own commands and time), ``tracking`` (also the
target's true motion and the satellites in view) and ``oracle`` (also the victim's statistics and
errors).  Every value is divided by a stated scale and clipped to finite bounds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from ..._registry import check_choice, check_finite
from ...simulators.divergence import Divergence
from ...simulators.setup import Setup
from .._kernels import own_command, time_fractions
from .base import Snapshot

FloatArray = NDArray[np.float64]
KNOWLEDGE = ("blind", "tracking", "oracle")


class ObservationTerm(Protocol):
    """One part of the observation: a `DynamicTerm`, or one with a `table`.

    ``table(setup)`` gives the (K, k) values at every epoch of the run, or None where they depend on
    more than the epoch.

    Attributes
    ----------
    knowledge : str
        Least level of knowledge that it takes.
    """

    knowledge: ClassVar[str]

    def names(self, setup: Setup) -> tuple[str, ...]:
        """Name of every element, k names."""

    def bounds(self, setup: Setup) -> tuple[float, float]:
        """Least and largest value of all elements, finite; the setup is not simulated yet."""


class DynamicTerm(ObservationTerm, Protocol):
    """A term that depends on what has happened.

    One of the commanded displacement and rate, each times a factor, may have ``factors(setup)``:
    a float [1/m], and (a,) [s/m] for the rate of every axis.  A kernel then writes it.
    """

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write the values into `out` (B, k); clipping follows."""


class _Term:
    """What the terms below share: fixed bounds, and settings that are scales above 0."""

    limits: ClassVar[tuple[float, float]] = (-10.0, 10.0)

    def __post_init__(self) -> None:
        """Check the settings."""
        for name, value in vars(self).items():
            if name != "largest":
                check_finite(name, value, "> 0")

    def bounds(self, setup: Setup) -> tuple[float, float]:
        """Least and largest value of all elements."""
        return self.limits


@dataclass(frozen=True)
class OwnCommand(_Term):
    """Commanded displacement and rate.

    Parameters
    ----------
    scale_m : float
        Displacement that is observed as 1, above 0; the rate's scale is its limit.
    """

    scale_m: float = 100.0
    knowledge: ClassVar[str] = "blind"

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``own_displacement_*`` and ``own_rate_*`` for every element of the action."""
        axes = [name.rsplit("_", 1)[0] for name in setup.action_names]
        return (*(f"own_displacement_{a}" for a in axes), *(f"own_rate_{a}" for a in axes))

    def factors(self, setup: Setup) -> tuple[float, FloatArray]:
        """Factors on displacement, and on the rate of every axis, for kernels that write both."""
        limits = np.broadcast_to(setup.attack.rate_limit_mps, len(setup.action_names))
        return 1.0 / self.scale_m, 1.0 / limits

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write displacement and rate over their scales."""
        simulator = snapshot.simulator
        displacement, rate = simulator.commanded_displacement, simulator.commanded_rate
        own_command(displacement, rate, *self.factors(snapshot.setup), out)


@dataclass(frozen=True)
class Time(_Term):
    """Parts of the command phase that are over, and left."""

    knowledge: ClassVar[str] = "blind"
    limits: ClassVar[tuple[float, float]] = (0.0, 1.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``time_since_onset`` and ``time_left``."""
        return ("time_since_onset", "time_left")

    def table(self, setup: Setup) -> NDArray[np.float32] | None:
        """The two fractions, where every epoch belongs to one onset."""
        onsets = setup.onsets
        if onsets is None:
            return None
        epochs = len(setup.epoch_time)
        table = np.empty((epochs, 2), dtype=np.float32)
        time_fractions(np.arange(epochs), onsets, setup.steps, table)
        return table

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write the two fractions."""
        simulator = snapshot.simulator
        time_fractions(simulator.epochs, simulator.onset, snapshot.setup.steps, out)


@dataclass(frozen=True)
class TargetMotion(_Term):
    """True position since the onset, and true velocity, in local axes at the onset.

    Parameters
    ----------
    position_scale_m, velocity_scale_mps : float
        What is observed as 1, above 0.
    """

    position_scale_m: float = 10_000.0
    velocity_scale_mps: float = 100.0
    knowledge: ClassVar[str] = "tracking"

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``target_position_*`` and ``target_velocity_*``, as far as the victim has them."""
        return tuple(f"target_{name}" for name in setup.motion_names)

    def table(self, setup: Setup) -> NDArray[np.float32] | None:
        """Position and velocity over their scales, where every epoch belongs to one onset."""
        return setup.motion_table(1.0 / self.position_scale_m, 1.0 / self.velocity_scale_mps)

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write position and velocity over their scales."""
        snapshot.simulator.motion(1.0 / self.position_scale_m, 1.0 / self.velocity_scale_mps, out)


@dataclass(frozen=True)
class TargetDirection(_Term):
    """Direction in which displacement counts: its north and its east component."""

    knowledge: ClassVar[str] = "blind"
    limits: ClassVar[tuple[float, float]] = (-1.0, 1.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``target_direction_north`` and ``target_direction_east``."""
        return ("target_direction_north", "target_direction_east")

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write cosine and sine of the heading."""
        for i, heading in enumerate(snapshot.simulator.heading.tolist()):
            out[i, 0], out[i, 1] = math.cos(heading), math.sin(heading)


@dataclass(frozen=True)
class SatelliteGeometry(_Term):
    """Line of sight to every slot in local axes, then whether it is visible, or spoofed."""

    knowledge: ClassVar[str] = "tracking"
    limits: ClassVar[tuple[float, float]] = (-1.0, 1.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``sight_*_SLOT``, and ``visible_SLOT`` or ``spoofed_SLOT``."""
        if not setup.geometry_names:
            raise ValueError(f"{setup.whose} has no satellites to observe")
        return setup.geometry_names

    def table(self, setup: Setup) -> FloatArray | None:
        """Unit vectors, 0 where not visible, then 1 or 0."""
        return setup.geometry_table()

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write what is no table."""
        snapshot.simulator.geometry(out)


@dataclass(frozen=True)
class StatisticRatio(_Term):
    """The detector's statistic over its threshold: 1 is an alarm.

    Parameters
    ----------
    largest : bool
        Whether only the largest of all channels is observed.
    """

    largest: bool = False
    knowledge: ClassVar[str] = "oracle"
    limits: ClassVar[tuple[float, float]] = (0.0, 10.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``statistic_ratio_SLOT``, or ``statistic_ratio`` for one of the whole receiver."""
        if self.largest or setup.detector.scope == "receiver":
            return ("statistic_ratio",)
        if not setup.weight_names:
            raise ValueError(f"{setup.whose} has no channels: observe the `largest` ratio")
        return tuple(f"statistic_ratio_{name}" for name in setup.weight_names)

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write the ratios of the last verdict; 0 before the first."""
        verdict = snapshot.simulator.verdict
        if verdict is None:
            out[:] = 0.0
        elif self.largest:
            out[:, 0] = snapshot.simulator.ratio()
        else:
            np.divide(verdict.statistic, verdict.threshold, out=out, casting="unsafe")


@dataclass(frozen=True)
class GainWeight(_Term):
    """The detector's weight on every pseudorange, or on the position; 1 from a monitor."""

    knowledge: ClassVar[str] = "oracle"
    limits: ClassVar[tuple[float, float]] = (0.0, 1.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``weight_SLOT`` or ``weight_AXIS``."""
        return tuple(f"weight_{name}" for name in setup.weight_names)

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write the weights of the last update."""
        out[:] = snapshot.simulator.observed_weights()


@dataclass(frozen=True)
class EstimateError(_Term):
    """Error of the victim's position in local axes at the onset.

    Parameters
    ----------
    scale_m : float
        What is observed as 1, above 0.
    """

    scale_m: float = 100.0
    knowledge: ClassVar[str] = "oracle"

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``error_north``, ``error_east``, and ``error_down`` of some victims."""
        return tuple(f"error_{name}" for name in setup.error_names)

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write estimate minus truth."""
        out[:] = snapshot.simulator.error_n() * (1.0 / self.scale_m)


@dataclass(frozen=True)
class DivergenceSpent(_Term):
    """Divergence that the attack has caused so far, over a budget; see `Divergence`.

    Parameters
    ----------
    budget_nats : float
        Divergence that is observed as 1, above 0; that of `AtStealthBudget` if there is one.
    """

    budget_nats: float = 2.0
    knowledge: ClassVar[str] = "oracle"
    limits: ClassVar[tuple[float, float]] = (0.0, 10.0)
    needs: ClassVar[tuple[type[Divergence], ...]] = (Divergence,)

    def names(self, setup: Setup) -> tuple[str, ...]:
        """``divergence_spent``."""
        return ("divergence_spent",)

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write the part of the budget that is spent."""
        spent = snapshot.simulator.monitor(Divergence).memory["divergence"]
        out[:, 0] = spent / self.budget_nats


OBSERVATION_TERMS: dict[str, type[ObservationTerm]] = {
    "own-command": OwnCommand,
    "time": Time,
    "target-motion": TargetMotion,
    "target-direction": TargetDirection,
    "satellite-geometry": SatelliteGeometry,
    "statistic-ratio": StatisticRatio,
    "gain-weight": GainWeight,
    "estimate-error": EstimateError,
    "divergence-spent": DivergenceSpent,
}
"""Terms by name; one's own may be added."""


def default_terms(setup: Setup, knowledge: str) -> tuple[ObservationTerm, ...]:
    """Terms that a level of knowledge allows, with the scales of the victim.

    The target direction is among them where it differs from episode to episode.

    Parameters
    ----------
    setup : Setup
        Of any victim.
    knowledge : {"blind", "tracking", "oracle"}
        The level.

    Returns
    -------
    tuple of ObservationTerm
        In the order of the observation.
    """
    check_choice("knowledge", knowledge, KNOWLEDGE)
    scales = setup.scales
    terms: list[ObservationTerm] = [
        OwnCommand(scales["displacement_m"]),
        Time(),
        TargetMotion(scales["position_m"], scales.get("velocity_mps", 1.0)),
        *([SatelliteGeometry()] if setup.geometry_names else []),
        StatisticRatio(setup.ratio_is_largest),
        GainWeight(),
        EstimateError(scales["error_m"]),
        *([TargetDirection()] if setup.target_heading_deg == "random" else []),
    ]
    level = KNOWLEDGE.index(knowledge)
    return tuple(term for term in terms if KNOWLEDGE.index(term.knowledge) <= level)
