"""What a spoofer observes: a list of small terms, each with names and bounds.

Knowledge at run time has three levels: ``blind`` (own commands and time), ``tracking`` (also the
target's true motion and the satellites in view) and ``oracle`` (also the victim's statistics and
errors).  To each of them ``reported`` may be added, the position that the victim itself broadcasts.
Every value is divided by a stated scale and clipped to finite bounds.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ...core.declared import check_word, setting, settings_record
from ...simulation._kernels import read_reports
from ...simulation.divergence import Divergence
from ...simulation.domain import FloatArray
from ...simulation.monitors import HISTORY_EPOCHS, PastPositions
from ...simulation.setup import Setup
from ...simulation.simulator import Simulator
from ...spoofers.base import KNOWLEDGE, LEVELS, REPORTED, list_axes
from .._kernels import own_command, time_fractions


class Snapshot(NamedTuple):
    """The episodes after a step, `step` (B,) epochs after the attack started, with all truth: terms
    choose what an agent may see.  `twin`: clean twins, if any."""

    setup: Setup
    simulator: Simulator
    step: NDArray[np.int64]
    twin: Simulator | None = None


def holds_for_call(term: object, name: str) -> bool:
    """Whether an attribute, which kernels use in place of `__call__`, is of the same class as it: a
    subclass with another `__call__` inherits the attribute, which is not true of it any more."""
    first = next((cls for cls in type(term).__mro__ if {name, "__call__"} & vars(cls).keys()), None)
    return first is not None and {name, "__call__"} <= vars(first).keys()


class ObservationTerm(Protocol):
    """One part of the observation: a `DynamicTerm`, or one with a `table`.

    ``table(setup)`` gives the (K, k) values at every epoch of the run, or None where they depend on
    more than the epoch.  `knowledge` is the least level of knowledge that it takes, and whether it
    takes ``reported``: one of `KNOWLEDGE`, or ``"reported"`` at any level.  A term of measurements,
    commands and the truth alone has ``latent = False``; one without it may hold an error of the
    victim's estimate, for which there is no bound by divergence.
    """

    knowledge: ClassVar[str]

    def names(self, setup: Setup) -> tuple[str, ...]:
        """Name of every element, k names."""

    def bounds(self, setup: Setup) -> tuple[float, float]:
        """Least and largest value of all elements, finite; the setup is not simulated yet."""


class DynamicTerm(ObservationTerm, Protocol):
    """A term that depends on what has happened. One of the commanded displacement and rate may have
    ``factors(setup)``, by which a kernel writes it."""

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write the values into `out` (B, k); clipping follows."""


class _Term:
    """What the terms below share: fixed bounds."""

    latent: ClassVar[bool] = True
    limits: ClassVar[tuple[float, float]] = (-10.0, 10.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        raise NotImplementedError

    def bounds(self, setup: Setup) -> tuple[float, float]:
        return self.limits


@settings_record(frozen=True)
class OwnCommand(_Term):
    """Commanded displacement and rate."""

    scale_m: float = setting(
        default=40.0, above=0.0, unit="m", help="Displacement that is observed as 1."
    )
    rate_scale_mps: float = setting(
        default=0.25, above=0.0, unit="m/s", help="Rate that is observed as 1."
    )
    along_target: bool = setting(
        default=False,
        help="Whether their parts along the target direction are observed, instead of every axis; "
        "the attack must be a false position with commands north and east.",
    )
    latent: ClassVar[bool] = False
    knowledge: ClassVar[str] = "blind"
    limits: ClassVar[tuple[float, float]] = (-100.0, 100.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        axes = list_axes(setup.action_names)
        if self.along_target:
            lacking = [axis for axis in ("north", "east") if axis not in axes]
            if lacking:
                raise ValueError(
                    "a command along the target direction has parts north and east; the attack "
                    f"commands {', '.join(axes)}"
                )
            axes = ["along_target"]
        return (*(f"own_displacement_{a}" for a in axes), *(f"own_rate_{a}" for a in axes))

    def factors(self, setup: Setup) -> tuple[float, FloatArray, int, int]:
        """Factors on displacement and on the rate of every axis; columns north and east, where only
        their parts along the target direction are observed, else -1."""
        axes = list_axes(setup.action_names)
        columns = (axes.index("north"), axes.index("east")) if self.along_target else (-1, -1)
        return 1.0 / self.scale_m, np.full(len(axes), 1.0 / self.rate_scale_mps), *columns

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        _, _, displacement, rate, direction = snapshot.simulator.step_arrays()
        per_displacement, per_rate, north, east = self.factors(snapshot.setup)
        own_command(displacement, rate, direction, north, east, per_displacement, per_rate, out)


@settings_record(frozen=True)
class OwnOffsets(_Term):
    """Commanded offsets and rates; 1 is what an action of 1 for the whole attack reaches.

    Where skies differ between episodes, it also has whether an action of each axis counts, and
    where the captured satellites do, which channels are captured.
    """

    knowledge: ClassVar[str] = "blind"
    latent: ClassVar[bool] = False
    limits: ClassVar[tuple[float, float]] = (-100.0, 100.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        if setup.attack.kind != "offsets":
            raise ValueError(f"own offsets need the attack 'offsets', got {setup.attack.kind!r}")
        axes = list_axes(setup.action_names)
        masked = axes if self._masks(setup) else []
        channels = range(setup.world.channels if setup.attack.varies else 0)
        return (
            *(f"own_offset_{axis}" for axis in axes),
            *(f"own_rate_{axis}" for axis in axes),
            *(f"counts_{axis}" for axis in masked),
            *(f"captured_slot{s:02d}" for s in channels),
        )

    def _masks(self, setup: Setup) -> bool:
        bounds = setup.bounds
        return bool(setup.attack.varies or bounds.worlds > 1 or bounds.first != bounds.last)

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        setup, simulator = snapshot.setup, snapshot.simulator
        scales = setup.attack.unit_rates(setup.world)
        a, n = len(scales), out.shape[1]
        out[:, :a] = simulator.commanded_displacement / (scales * setup.attack.span_s)
        out[:, a : 2 * a] = simulator.commanded_rate / scales
        if n > 2 * a:
            out[:, 2 * a : 3 * a] = simulator.report_attack()["action_mask"]
            out[:, 3 * a :] = simulator.commands["taken"][:, : n - 3 * a]


@settings_record(frozen=True)
class Time(_Term):
    """Parts of the command phase that are over, and left."""

    latent: ClassVar[bool] = False
    knowledge: ClassVar[str] = "blind"
    limits: ClassVar[tuple[float, float]] = (0.0, 1.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        return ("time_since_onset", "time_left")

    def table(self, setup: Setup) -> NDArray[np.float32] | None:
        onsets = setup.onsets
        if onsets is None:
            return None
        table = np.empty((len(setup.epoch_time), 2), dtype=np.float32)
        time_fractions(np.arange(len(table)), onsets, setup.steps, table)
        return table

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        simulator = snapshot.simulator
        time_fractions(simulator.epochs, simulator.onset, snapshot.setup.steps, out)


ROUNDING = 1e-6  # more than the last bits of a line of sight


def _varying(setup: Setup, table: NDArray[Any], least: float) -> NDArray[np.intp]:
    """Which columns of a table (K, k) change in the attack windows of all episodes by so much."""
    bounds, each = setup.bounds, setup.epochs_each
    first = bounds.first + setup.youngest
    last = bounds.last + setup.onset + setup.steps + setup.hold
    windows = table.reshape(bounds.worlds, each, -1)[:, first : last + 1]
    return np.flatnonzero(np.ptp(windows.reshape(-1, table.shape[1]), axis=0) >= least)


class _Tabled(_Term):
    """Terms that leave out what changes by less than `least_change`, where windows are fixed."""

    least_change: float

    def _whole(self, setup: Setup) -> tuple[tuple[str, ...], NDArray[Any] | None]:
        """All names, and (K, k) their values at every epoch, where each belongs to one onset."""
        raise NotImplementedError

    def names(self, setup: Setup) -> tuple[str, ...]:
        names, table = self._whole(setup)
        if table is None:
            return names
        return tuple(names[k] for k in _varying(setup, table, self.least_change))

    def table(self, setup: Setup) -> NDArray[Any] | None:
        _, table = self._whole(setup)
        return None if table is None else table[:, _varying(setup, table, self.least_change)]


@settings_record(frozen=True)
class TargetMotion(_Tabled):
    """True position since the onset, and true velocity, in local axes at the onset."""

    position_scale_m: float = setting(
        default=10_000.0, above=0.0, unit="m", help="Change of position that is observed as 1."
    )
    velocity_scale_mps: float = setting(
        default=100.0, above=0.0, unit="m/s", help="Velocity that is observed as 1."
    )
    least_change: float = setting(
        default=0.05,
        least=0.0,
        help="An element that changes by less than this, in units of its scale, over the attack "
        "windows of all episodes is uninformative, and left out, where these windows are fixed; "
        "0 for all.",
    )
    latent: ClassVar[bool] = False
    knowledge: ClassVar[str] = "tracking"

    def _whole(self, setup: Setup) -> tuple[tuple[str, ...], NDArray[Any] | None]:
        scales = 1.0 / self.position_scale_m, 1.0 / self.velocity_scale_mps
        names = tuple(f"target_{name}" for name in setup.motion_names)
        return names, setup.motion_table(*scales)

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        snapshot.simulator.motion(1.0 / self.position_scale_m, 1.0 / self.velocity_scale_mps, out)


@settings_record(frozen=True)
class TargetDirection(_Term):
    """Direction in which displacement counts: its north and its east component."""

    latent: ClassVar[bool] = False
    knowledge: ClassVar[str] = "blind"
    limits: ClassVar[tuple[float, float]] = (-1.0, 1.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        return ("target_direction_north", "target_direction_east")

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        for i, heading in enumerate(snapshot.simulator.heading.tolist()):
            out[i, 0], out[i, 1] = math.cos(heading), math.sin(heading)


@settings_record(frozen=True)
class SatelliteGeometry(_Tabled):
    """Line of sight to every slot in local axes, then whether it is visible, or spoofed."""

    least_change: float = setting(
        default=0.05,
        least=0.0,
        help="As in `TargetMotion`: what changes by less is left out, such as all of it in a "
        "window of minutes in one world.",
    )
    latent: ClassVar[bool] = False
    knowledge: ClassVar[str] = "tracking"
    limits: ClassVar[tuple[float, float]] = (-1.0, 1.0)

    def _whole(self, setup: Setup) -> tuple[tuple[str, ...], NDArray[Any] | None]:
        if not setup.geometry_names:
            raise ValueError(f"{setup.whose} has no satellites to observe")
        some = setup.probe_geometry()
        if some is not None and (np.ptp(some, axis=0) > self.least_change + ROUNDING).all():
            return setup.geometry_names, None  # all of it changes, and no world is built to know it
        return setup.geometry_names, setup.geometry_table()

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        snapshot.simulator.geometry(out)


@settings_record(frozen=True)
class StatisticRatio(_Term):
    """The detector's statistic over its threshold: 1 is an alarm."""

    largest: bool = setting(
        default=False, help="Whether only the largest of all channels is observed."
    )
    latent: ClassVar[bool] = False
    knowledge: ClassVar[str] = "oracle"
    limits: ClassVar[tuple[float, float]] = (0.0, 10.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        if self.largest or setup.detector.scope == "receiver":
            return ("statistic_ratio",)
        if not setup.weight_names:
            raise ValueError(f"{setup.whose} has no channels: observe the `largest` ratio")
        return tuple(f"statistic_ratio_{name}" for name in setup.weight_names)

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        verdict = snapshot.simulator.verdict
        if verdict is None:
            out[:] = 0.0
        elif self.largest:
            out[:, 0] = snapshot.simulator.ratio()
        else:
            np.divide(verdict.statistic, verdict.threshold, out=out, casting="unsafe")


@settings_record(frozen=True)
class GainWeight(_Term):
    """The detector's weight on every pseudorange, or on the position; 1 if it is passive."""

    latent: ClassVar[bool] = False
    knowledge: ClassVar[str] = "oracle"
    limits: ClassVar[tuple[float, float]] = (0.0, 1.0)

    def names(self, setup: Setup) -> tuple[str, ...]:
        return tuple(f"weight_{name}" for name in setup.weight_names)

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        out[:] = snapshot.simulator.observed_weights()


@settings_record(frozen=True)
class EstimateError(_Term):
    """Error of the victim's position in the local axes of the epoch."""

    scale_m: float = setting(default=40.0, above=0.0, unit="m", help="Error that is observed as 1.")
    knowledge: ClassVar[str] = "oracle"

    def names(self, setup: Setup) -> tuple[str, ...]:
        return tuple(f"error_{name}" for name in setup.error_names)

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        out[:] = snapshot.simulator.error_n() * (1.0 / self.scale_m)


@settings_record(frozen=True)
class DivergenceSpent(_Term):
    """Divergence that the attack has caused so far, over a budget; see `Divergence`."""

    budget_nats: float = setting(
        default=2.0,
        above=0.0,
        unit="nats",
        help="Divergence that is observed as 1; that of `AtStealthBudget` if there is one.",
    )
    latent: ClassVar[bool] = False
    knowledge: ClassVar[str] = "oracle"
    limits: ClassVar[tuple[float, float]] = (0.0, 10.0)
    needs: ClassVar[tuple[type[Divergence], ...]] = (Divergence,)

    def names(self, setup: Setup) -> tuple[str, ...]:
        return ("divergence_spent",)

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        spent = snapshot.simulator.monitor(Divergence).memory["divergence"]
        out[:, 0] = spent / self.budget_nats


@settings_record(frozen=True)
class ReportedPosition(_Term):
    """The victim's own broadcast position since the onset, in local axes there, and its age.

    What the newest report says that has arrived; nothing, which is 0, before there is one.
    """

    scale_m: float = setting(
        default=10_000.0,
        above=0.0,
        unit="m",
        help="Distance that is observed as 1; of an age that is 1 s.",
    )
    interval_s: float = setting(
        default=0.5,
        above=0.0,
        unit="s",
        help="Time between reports; an epoch where it is shorter. Twice a second as of ADS-B.",
    )
    latency_s: float = setting(
        default=0.6,
        least=0.0,
        unit="s",
        help="Largest latency of a report; that of each is drawn for itself between 0 and this.",
    )
    step_m: float = setting(
        default=5.0,
        least=0.0,
        unit="m",
        help="Steps of the position; 0 for none. An ideal link has neither latency nor steps.",
    )
    knowledge: ClassVar[str] = REPORTED
    needs: ClassVar[tuple[type[PastPositions], ...]] = (PastPositions,)
    word: ClassVar[str] = "position"
    less_true: ClassVar[bool] = False

    def names(self, setup: Setup) -> tuple[str, ...]:
        every, latency = self._epochs(setup)
        if every + latency > HISTORY_EPOCHS - 2:
            most = (HISTORY_EPOCHS - 2) * setup.interval_s
            raise ValueError(
                "`interval_s` and `latency_s` of reports must be at most "
                f"{most:g} s together with epochs of {setup.interval_s:g} s, got "
                f"{self.interval_s:g} and {self.latency_s:g}"
            )
        return (*(f"reported_{self.word}_{axis}" for axis in ("north", "east")), "report_age")

    def _epochs(self, setup: Setup) -> tuple[int, float]:
        interval = setup.interval_s
        return max(1, round(self.interval_s / interval)), self.latency_s / interval

    def rules(self, setup: Setup) -> FloatArray:
        """Those of `read_reports`."""
        how = setup.interval_s, self.scale_m, self.step_m, float(self.less_true)
        return np.array([*self._epochs(setup), *how])

    def __call__(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        simulator, setup = snapshot.simulator, snapshot.setup
        past = simulator.monitor(PastPositions).memory
        remembered = past["past_position"], past["past_epochs"]
        now = simulator.epochs, simulator.onset, simulator.memory["key"]
        read_reports(*remembered, *now, setup.true_position, setup.C_en, self.rules(setup), out)


@settings_record(frozen=True)
class ReportedDeviation(ReportedPosition):
    """The victim's own broadcast position less the target's true one at the time of the report.

    The spoofer knows that time, and tracks the target; its own tracking error is not in this.
    """

    scale_m: float = setting(
        default=40.0,
        above=0.0,
        unit="m",
        help="Distance that is observed as 1; of an age that is 1 s.",
    )
    knowledge: ClassVar[str] = f"tracking+{REPORTED}"
    limits: ClassVar[tuple[float, float]] = (-100.0, 100.0)
    word: ClassVar[str] = "deviation"
    less_true: ClassVar[bool] = True


OBSERVATION_TERMS: dict[str, type[ObservationTerm]] = {
    "own-command": OwnCommand,
    "own-offsets": OwnOffsets,
    "time": Time,
    "target-motion": TargetMotion,
    "target-direction": TargetDirection,
    "satellite-geometry": SatelliteGeometry,
    "statistic-ratio": StatisticRatio,
    "gain-weight": GainWeight,
    "estimate-error": EstimateError,
    "divergence-spent": DivergenceSpent,
    "reported-position": ReportedPosition,
    "reported-deviation": ReportedDeviation,
}


def default_terms(
    setup: Setup, knowledge: str, *, along_target: bool = False
) -> tuple[ObservationTerm, ...]:
    """Terms that a level of knowledge allows, with the scales of the victim.

    Parameters
    ----------
    setup : Setup
        Of any victim; the target direction is observed where it differs between episodes.
    knowledge : str
        One of `KNOWLEDGE`: the level, and ``+reported`` for what the victim broadcasts.
    along_target : bool
        Whether all commands are along the target direction, so that only that of them is observed.

    Returns
    -------
    tuple of ObservationTerm
        In the order of the observation.
    """
    check_word("knowledge", knowledge, KNOWLEDGE)
    scales, whole = setup.scales, setup.detector.scope == "receiver"
    level, reported = split_knowledge(knowledge)
    report = ReportedDeviation(scales["length_m"]) if level else ReportedPosition()
    terms: list[ObservationTerm] = [
        OwnOffsets()
        if setup.attack.kind == "offsets" and not along_target
        else OwnCommand(scales["length_m"], setup.rate_scale_mps, along_target),
        Time(),
        *([TargetDirection()] if setup.target_heading_deg == "random" else []),
        TargetMotion(scales["position_m"], scales.get("velocity_mps", 1.0)),
        *([SatelliteGeometry()] if setup.geometry_names else []),
        *([] if setup.ratio_is_largest or whole else [StatisticRatio()]),
        StatisticRatio(largest=True),
        GainWeight(),
        EstimateError(scales["length_m"]),
    ]
    known = [term for term in terms if LEVELS.index(term.knowledge) <= level]
    return (*known, report) if reported else tuple(known)


def split_knowledge(knowledge: str) -> tuple[int, bool]:
    """Place of the level in `LEVELS`, and whether the victim's reports are known."""
    level, _, more = knowledge.partition("+")
    return (0 if level == REPORTED else LEVELS.index(level)), REPORTED in (level, more)
