"""Terms of what a learned detector observes, each with names and bounds.

A term reads an `Epoch`, which has no field of truth, and what the detector remembers of earlier
ones.  Every value is divided by a stated scale, and clipped to finite bounds.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..core.memory import Memory
from ..core.registry import build, build_spec
from ..earth.wgs84 import dcm_e_from_n, ecef_to_geodetic
from ..receiver.epoch import Epoch
from ..receiver.kalman import normalized_innovation_squared
from ._own_filter_kernels import whiten_shifts
from .base import Detector, DetectorContext, FloatArray, Verdict, find_name, judge_epoch
from .build import make_detector
from .calibrated import Calibrated
from .innovation import average_smoothing
from .solution_separation import SolutionSeparation

Written = NDArray[np.float32]
LOCAL_AXES, BODY_AXES = ("north", "east", "down"), ("forward", "right", "below")


class DetectorTerm(ABC):
    """One part of what a learned detector observes; a frozen dataclass.

    Attributes
    ----------
    needs : frozenset of str
        Optional fields of `Epoch` that it reads, as of a `Detector`.
    from_start, needs_model : bool
        Whether it is shown the filter-only warm-up, too, and takes a victim with a model of its
        errors, as of a `Detector`.
    """

    needs: ClassVar[frozenset[str]] = frozenset()
    from_start: ClassVar[bool] = False
    needs_model: ClassVar[bool] = False

    @abstractmethod
    def names(self, channels: int) -> tuple[str, ...]:
        """Name of every element, for as many slots."""

    @abstractmethod
    def bounds(self) -> tuple[float, float]:
        """Least and largest value, finite."""

    def bound(self, context: DetectorContext) -> Self:
        """Term for a batch of receivers: itself, unless it keeps a `memory` of its own."""
        return self

    def declare(self, memory: Memory, channels: int) -> None:  # noqa: B027  (few need it)
        """Declare what is remembered; nothing by default."""

    def watch(self, epoch: Epoch) -> None:  # noqa: B027  (few need it)
        """See an epoch of the filter-only warm-up, if `from_start`."""

    @abstractmethod
    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        """Write the values of an epoch, (B, k); clipping follows."""


def slots(word: str, channels: int) -> tuple[str, ...]:
    return tuple(f"{word}_slot{s:02d}" for s in range(channels))


class _Term(DetectorTerm):
    """A term of the package: `words` begin the names, one each or one for every slot; `limits` are
    the least and the largest value."""

    words: ClassVar[tuple[str, ...]]
    limits: ClassVar[tuple[float, float]]
    per_slot: ClassVar[bool] = True

    def names(self, channels: int) -> tuple[str, ...]:
        if not self.per_slot:
            return self.words
        return tuple(name for word in self.words for name in slots(word, channels))

    def bounds(self) -> tuple[float, float]:
        return self.limits


@dataclass(frozen=True)
class Innovation(_Term):
    """Innovations over their standard deviations; 0 where a slot is invisible."""

    words: ClassVar[tuple[str, ...]] = ("range_innovation", "rate_innovation")
    limits: ClassVar[tuple[float, float]] = (-10.0, 10.0)

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        np.divide(epoch.innovation, np.sqrt(epoch.innovation_variance), out=out, casting="unsafe")


@settings_record(frozen=True)
class AverageInnovation(_Term):
    r"""Exponentially weighted average of the same, over its standard deviation if it were white.

    .. math:: \Lambda_k = \lambda z_k / \sigma_k + (1 - \lambda) \Lambda_{k-1}, \qquad
        \Lambda_k / \sqrt{\lambda / (2 - \lambda)}

    `roberts1959`.  A satellite that sets starts again.
    """

    words: ClassVar[tuple[str, ...]] = ("range_average", "rate_average")
    limits: ClassVar[tuple[float, float]] = (-30.0, 30.0)
    smoothing: float = average_smoothing("Lambda; the default averages over some ten epochs.")

    def declare(self, memory: Memory, channels: int) -> None:
        memory.declare("average", np.zeros((memory.receivers, 2 * channels)))

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        present = np.concatenate([epoch.visible, epoch.visible], axis=1)
        value = epoch.innovation / np.sqrt(epoch.innovation_variance)
        before = memory["average"]
        after = np.where(present, before + self.smoothing * (value - before), 0.0)
        memory["average"] = after
        np.multiply(
            after, np.sqrt((2.0 - self.smoothing) / self.smoothing), out=out, casting="unsafe"
        )


@settings_record(frozen=True)
class InnovationSd(_Term):
    """Standard deviations of the innovations."""

    words: ClassVar[tuple[str, ...]] = ("range_sd", "rate_sd")
    limits: ClassVar[tuple[float, float]] = (0.0, 10.0)
    range_scale_m: float = setting(
        default=10.0, above=0.0, unit="m", help="What is observed as 1 of ranges."
    )
    rate_scale_mps: float = setting(
        default=1.0, above=0.0, unit="m/s", help="What is observed as 1 of range rates."
    )

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        n, sd = epoch.visible.shape[1], np.sqrt(epoch.innovation_variance)
        out[:, :n] = epoch.visible * sd[:, :n] * (1.0 / self.range_scale_m)
        out[:, n:] = epoch.visible * sd[:, n:] * (1.0 / self.rate_scale_mps)


@dataclass(frozen=True)
class ChiSquare(_Term):
    """Normalized innovations squared, of both kinds together, over the degrees of freedom."""

    words: ClassVar[tuple[str, ...]] = ("chi_square_ratio",)
    limits: ClassVar[tuple[float, float]] = (0.0, 10.0)
    per_slot: ClassVar[bool] = False
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        m = epoch.innovation.shape[1]
        belief = cast(FloatArray, epoch.innovation_cov)
        statistic = normalized_innovation_squared(epoch.innovation, belief, 0, m)
        freedom = np.maximum(2 * epoch.visible.sum(axis=1), 1)
        # an infinite one, of a covariance that is not positive definite, is cut like others
        out[:, 0] = np.minimum(statistic / freedom, 1e6)


@dataclass(frozen=True)
class InView(_Term):
    """Whether a slot has a visible satellite."""

    words: ClassVar[tuple[str, ...]] = ("visible",)
    limits: ClassVar[tuple[float, float]] = (0.0, 1.0)

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        out[:] = epoch.visible


@settings_record(frozen=True)
class PredictedMotion(_Term):
    """Velocity that the filter predicts, in local axes, and what the inertial sensors measure."""

    words: ClassVar[tuple[str, ...]] = (
        *(f"predicted_velocity_{axis}" for axis in LOCAL_AXES),
        *(f"specific_force_{axis}" for axis in BODY_AXES),
        *(f"angular_rate_{axis}" for axis in BODY_AXES),
    )
    limits: ClassVar[tuple[float, float]] = (-10.0, 10.0)
    per_slot: ClassVar[bool] = False
    velocity_scale_mps: float = setting(
        default=100.0, above=0.0, unit="m/s", help="Velocity that is observed as 1."
    )
    force_scale_mps2: float = setting(
        default=10.0, above=0.0, unit="m/s^2", help="Specific force that is observed as 1."
    )
    rate_scale_rps: float = setting(
        default=0.1, above=0.0, unit="rad/s", help="Angular rate that is observed as 1."
    )

    needs: ClassVar[frozenset[str]] = frozenset({"imu_delta"})

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        latitude, longitude, _ = ecef_to_geodetic(epoch.predicted_position)
        C_en = dcm_e_from_n(latitude, longitude)
        velocity_n = (epoch.predicted_velocity[:, :, None] * C_en).sum(axis=1)
        out[:, :3] = velocity_n * (1.0 / self.velocity_scale_mps)
        mean = cast(FloatArray, epoch.imu_delta) / epoch.interval[:, None]
        out[:, 3:6] = mean[:, :3] * (1.0 / self.force_scale_mps2)
        out[:, 6:] = mean[:, 3:] * (1.0 / self.rate_scale_rps)


@settings_record(frozen=True)
class Elapsed(_Term):
    """Time since the detector was switched on, in the last part of the warm-up."""

    words: ClassVar[tuple[str, ...]] = ("elapsed",)
    limits: ClassVar[tuple[float, float]] = (0.0, 10.0)
    per_slot: ClassVar[bool] = False
    scale_s: float = setting(default=600.0, above=0.0, unit="s", help="Time that is observed as 1.")

    def declare(self, memory: Memory, channels: int) -> None:
        memory.declare("elapsed", np.zeros(memory.receivers))

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        memory["elapsed"] = memory["elapsed"] + epoch.interval
        out[:, 0] = memory["elapsed"] * (1.0 / self.scale_s)


@settings_record(frozen=True)
class ExclusionLeft(_Term):
    """Part of the allowance of exclusion that is left."""

    words: ClassVar[tuple[str, ...]] = ("exclusion_left",)
    limits: ClassVar[tuple[float, float]] = (0.0, 1.0)
    per_slot: ClassVar[bool] = False
    exclusion_s: float | None = setting(
        default=None,
        least=0.0,
        unit="s",
        help="The allowance, that of the detector; without a limit all is left.",
    )

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        out[:, 0] = 1.0
        if self.exclusion_s:
            out[:, 0] -= memory["excluded_s"] / self.exclusion_s


@dataclass(frozen=True)
class LineOfSight(_Term):
    """Unit vectors from the predicted position to the satellites, in local axes.

    0 where a slot is invisible.
    """

    words: ClassVar[tuple[str, ...]] = tuple(f"sight_{axis}" for axis in LOCAL_AXES)
    limits: ClassVar[tuple[float, float]] = (-1.0, 1.0)
    needs: ClassVar[frozenset[str]] = frozenset({"satellite_position"})

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        place = cast(FloatArray, epoch.satellite_position)
        away = np.where(epoch.visible[:, :, None], place - epoch.predicted_position[:, None], 0.0)
        length = np.sqrt((away * away).sum(axis=2, keepdims=True))
        sight_e = away / np.maximum(length, 1.0)
        latitude, longitude, _ = ecef_to_geodetic(epoch.predicted_position)
        C_en = dcm_e_from_n(latitude, longitude)
        sight_n = (sight_e[:, :, :, None] * C_en[:, None, :, :]).sum(axis=2)
        n = epoch.visible.shape[1]
        for axis in range(3):
            out[:, axis * n : (axis + 1) * n] = sight_n[:, :, axis]


@settings_record(frozen=True)
class Classic(_Term):
    r"""Logarithm of a passive detector's statistic over its nominal threshold.

    .. math:: \ln (\text{statistic} / \text{threshold}), \text{ within } -5 \text{ and } 5

    One value where it judges the receiver as a whole, else one for every slot; -5 where the
    statistic is 0, as where a slot is invisible.
    """

    limits: ClassVar[tuple[float, float]] = (-5.0, 5.0)
    detector: str | Mapping[str, Any] = setting(
        default="snapshot-chi2",
        help="As `make_detector` takes it, without a word on thresholds, such as "
        '``{"name": "solution-separation"}``.  It must not take weight off measurements: for '
        '`ewma` that is ``{"name": "ewma", "weight_scale": None}``.',
    )
    label: str | None = setting(
        default=None,
        help="What it is called in the names of the observation; by default as its detector.",
    )

    _judge: ClassVar[Detector]

    def __post_init__(self) -> None:
        made = make_detector(self.detector)
        name = find_name(type(made))
        if isinstance(made, Calibrated) or made.judges or name is None:
            raise ValueError(
                "`detector` of a classic term must be one of the package with its nominal "
                f"thresholds, and neither a pool nor a learned one, got {self.detector!r}"
            )
        if made.oracle:
            raise ValueError(
                f"`detector` of a classic term must be no oracle, got {self.detector!r}"
            )
        if isinstance(self.detector, str):
            object.__setattr__(self, "detector", {"name": self.detector})
        object.__setattr__(self, "_judge", made)
        for trait in ("needs", "from_start", "needs_model"):
            object.__setattr__(self, trait, getattr(made, trait))
        if self.label is None:
            object.__setattr__(self, "label", name.replace("-", "_"))

    def names(self, channels: int) -> tuple[str, ...]:
        word = f"classic_{self.label}"
        return slots(word, channels) if self._judge.scope == "channel" else (word,)

    def bound(self, context: DetectorContext) -> Self:
        own = replace(self)
        own._judge.bind(context)
        return own

    @property
    def memory(self) -> Memory:
        return self._judge.memory

    def watch(self, epoch: Epoch) -> None:
        self._judge.watch(epoch)

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        verdict = judge_epoch(self._judge, epoch)
        if verdict.weights is not None:
            raise ValueError(
                f"`detector` of a classic term must be passive, and {self.detector!r} takes weight "
                "off measurements; where it has a `weight_scale`, give it None"
            )
        self._write_ratio(verdict, out)

    @staticmethod
    def _write_ratio(verdict: Verdict, out: Written) -> None:
        """Write the logarithm of statistic over threshold, as far as the least that is shown."""
        least = np.exp(Classic.limits[0]) * verdict.threshold
        np.log(np.maximum(verdict.statistic, least) / verdict.threshold, out=out, casting="unsafe")


@settings_record(frozen=True)
class FilterShift(Classic):
    r"""The same of `solution-separation`, and what the innovations of the filter that it tests say
    of one horizontal shift of position and velocity.

    With J the columns of the design for north and east, height and clock of both kinds, the score
    is :math:`b = J^T S^{-1} z`, of covariance :math:`F = J^T S^{-1} J`.  What is left of it when
    height and clock are free, and then of the position when the velocity is, too, is divided by its
    root of covariance: two vectors whose elements have variance 1 and are independent, of one epoch
    and of several, where the innovations are white and of covariance S.  That is so of a filter
    that models its world, as ``filter="augmented"`` has it, whatever its age.  0 with fewer
    satellites than an update takes.
    """

    limits: ClassVar[tuple[float, float]] = (-30.0, 30.0)
    detector: str | Mapping[str, Any] = setting(
        default_factory=lambda: {
            "name": "solution-separation",
            "filter": "augmented",
            "spacing": "geometric",
        },
        help="Detector `solution-separation`, with its settings.",
    )

    _fewest: ClassVar[int]

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self._judge, SolutionSeparation):
            raise ValueError(
                "`detector` of the term filter-shift must be solution-separation, got "
                f"{self.detector!r}"
            )

    def names(self, channels: int) -> tuple[str, ...]:
        shifts = (f"shift_{what}_{axis}" for what in SHIFTED for axis in LOCAL_AXES[:2])
        return (*super().names(channels), *shifts)

    def bound(self, context: DetectorContext) -> Self:
        own = super().bound(context)
        object.__setattr__(own, "_fewest", context.min_satellites)
        return own

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        judge = cast(SolutionSeparation, self._judge)
        filtered = judge.filter_epoch(epoch)
        self._write_ratio(judge.judge_filtered(filtered), out[:, :1])
        model = filtered.design, filtered.innovation, filtered.innovation_cov
        design, z, S = (cast(FloatArray, each) for each in model)
        shifts = np.empty((len(z), len(SHIFTED) * 2))
        place = epoch.predicted_position, self._fewest
        whiten_shifts(design, z, S, epoch.visible, *place, shifts)
        out[:, 1:] = shifts


SHIFTED = "velocity", "position"
"""What the shift of `FilterShift` is of, in the order of its elements."""
DETECTOR_TERMS: dict[str, type[DetectorTerm]] = {
    "average-innovation": AverageInnovation,
    "chi-square": ChiSquare,
    "classic": Classic,
    "elapsed": Elapsed,
    "exclusion-left": ExclusionLeft,
    "filter-shift": FilterShift,
    "in-view": InView,
    "innovation": Innovation,
    "innovation-sd": InnovationSd,
    "line-of-sight": LineOfSight,
    "predicted-motion": PredictedMotion,
}
ALL_TERMS: tuple[DetectorTerm, ...] = (
    Innovation(),
    AverageInnovation(),
    InnovationSd(),
    ChiSquare(),
    InView(),
    PredictedMotion(),
    Elapsed(),
)
"""Those that are observed by default, with their scales; what is left of the allowance follows."""
TermSpec = str | Mapping[str, Any] | DetectorTerm


def make_detector_terms(specs: Iterable[TermSpec] | TermSpec) -> tuple[DetectorTerm, ...]:
    """Terms from names, names and settings, or objects.

    Parameters
    ----------
    specs : str, mapping, DetectorTerm, or a sequence of them
        A name in `DETECTOR_TERMS`; ``{"name": ..., "setting": value, ...}``; or an object.

    Returns
    -------
    tuple of DetectorTerm
        In the order given.

    Examples
    --------
    >>> make_detector_terms(["in-view", {"name": "elapsed", "scale_s": 60.0}])
    (InView(), Elapsed(scale_s=60.0))
    """
    several = [specs] if isinstance(specs, str | Mapping | DetectorTerm) else list(specs)
    if not several:
        raise ValueError(f"`terms` must name at least one of {', '.join(sorted(DETECTOR_TERMS))}")
    return tuple(build("detector term", DETECTOR_TERMS, DetectorTerm, each) for each in several)


def written_terms(terms: Sequence[DetectorTerm]) -> tuple[dict[str, Any], ...]:
    """Terms as `make_detector_terms` takes them, JSON-able."""
    for term in terms:
        if type(term) not in DETECTOR_TERMS.values():
            raise TypeError(
                f"{type(term).__qualname__} has no name in `DETECTOR_TERMS`, by which a card could "
                "list it"
            )
    return tuple(build_spec("detector term", DETECTOR_TERMS, term) for term in terms)


class DetectorObserver:
    """Observations of a list of terms.

    Parameters
    ----------
    terms : sequence of DetectorTerm
        In the order of the observation.
    channels : int
        Slots.

    Attributes
    ----------
    names : tuple of str
        (o,) name of every element.
    low, high : ndarray
        (o,) float32 bounds.
    """

    def __init__(self, terms: Sequence[DetectorTerm], channels: int) -> None:
        self._parts: list[tuple[DetectorTerm, slice]] = []
        names: list[str] = []
        bounds: list[tuple[float, float]] = []
        for term in terms:
            own = term.names(channels)
            self._parts.append((term, slice(len(names), len(names) + len(own))))
            names += own
            bounds += [term.bounds()] * len(own)
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"`terms` observe the same twice: {', '.join(twice[:4])}")
        self.names = tuple(names)
        self.low, self.high = (np.array(side, np.float32) for side in zip(*bounds, strict=True))
        self._channels = channels

    def bind(self, context: DetectorContext) -> list[Memory]:
        """Bind the terms to a batch; returns what some of them remember by themselves."""
        self._parts = [(term.bound(context), part) for term, part in self._parts]
        own = [getattr(term, "memory", None) for term, _ in self._parts]
        return [memory for memory in own if memory is not None]

    def declare(self, memory: Memory) -> None:
        """Declare the memory of the terms, and the observation, 0 before the first epoch."""
        memory.declare("observation", np.zeros((memory.receivers, len(self.names)), np.float32))
        for term, _ in self._parts:
            term.declare(memory, self._channels)

    def watch(self, epoch: Epoch) -> None:
        """Show an epoch of the filter-only warm-up to the terms that are to see it."""
        for term, _ in self._parts:
            if term.from_start:
                term.watch(epoch)

    def look(self, epoch: Epoch, memory: Memory) -> None:
        """Take in one epoch; the observation is ``memory["observation"]`` from then on."""
        out = np.empty((memory.receivers, len(self.names)), dtype=np.float32)
        for term, part in self._parts:
            term(epoch, memory, out[:, part])
        np.maximum(out, self.low, out=out)
        np.minimum(out, self.high, out=out)
        memory["observation"] = out
