"""Terms of what a learned detector observes, each with names and bounds.

A term holds an `Epoch`, which has no field of truth, and what the detector remembers of earlier
ones.  Every value is divided by a stated scale, and clipped to finite bounds.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from ..._memory import Memory
from ...earth.frames import dcm_e_from_n, ecef_to_geodetic
from ...receiver.epoch import Epoch
from ...receiver.nis import normalized_innovation_squared
from ..base import DetectorContext

FloatArray = NDArray[np.float64]
Written = NDArray[np.float32]


class DetectorTerm(ABC):
    """One part of what a learned detector observes; a frozen dataclass.

    Attributes
    ----------
    needs : frozenset of str
        Optional fields of `Epoch` that it reads, as of a `Detector`.
    """

    needs: ClassVar[frozenset[str]] = frozenset()

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

    @abstractmethod
    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        """Write the values of an epoch, (B, k); clipping follows."""


def slots(word: str, channels: int) -> tuple[str, ...]:
    return tuple(f"{word}_slot{s:02d}" for s in range(channels))


def innovation_sd(epoch: Epoch) -> FloatArray:
    """Standard deviation of every innovation, as the filter believes it.

    Returns (B, m) root of the diagonal of S [m], [m/s].
    """
    return np.sqrt(epoch.innovation_variance)


@dataclass(frozen=True)
class Innovation(DetectorTerm):
    """Innovations over their standard deviations; 0 where a slot is invisible."""

    described_as = "Innovation"

    def names(self, channels: int) -> tuple[str, ...]:
        """``range_innovation_*`` and ``rate_innovation_*``."""
        return slots("range_innovation", channels) + slots("rate_innovation", channels)

    def bounds(self) -> tuple[float, float]:
        """-10 and 10."""
        return -10.0, 10.0

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        """Write z over its standard deviation."""
        np.divide(epoch.innovation, innovation_sd(epoch), out=out, casting="unsafe")


@dataclass(frozen=True)
class AverageInnovation(DetectorTerm):
    r"""Exponentially weighted average of the same, over its standard deviation if it were white.

    .. math:: \Lambda_k = \lambda z_k / \sigma_k + (1 - \lambda) \Lambda_{k-1}, \qquad
        \Lambda_k / \sqrt{\lambda / (2 - \lambda)}

    Parameters
    ----------
    smoothing : float
        Lambda, in (0, 1]; the default averages over some ten epochs.

    Notes
    -----
    `roberts1959`.  A satellite that sets starts again.
    """

    described_as = "AverageInnovation"
    smoothing: float = 0.1

    def __post_init__(self) -> None:
        if not 0.0 < self.smoothing <= 1.0:
            raise ValueError(f"`smoothing` must be in (0, 1], got {self.smoothing}")

    def names(self, channels: int) -> tuple[str, ...]:
        """``range_average_*`` and ``rate_average_*``."""
        return slots("range_average", channels) + slots("rate_average", channels)

    def bounds(self) -> tuple[float, float]:
        """-30 and 30."""
        return -30.0, 30.0

    def declare(self, memory: Memory, channels: int) -> None:
        """The averages, 0 at first."""
        memory.declare("average", np.zeros((memory.receivers, 2 * channels)))

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        present = np.concatenate([epoch.visible, epoch.visible], axis=1)
        value = epoch.innovation / innovation_sd(epoch)
        before = memory["average"]
        after = np.where(present, before + self.smoothing * (value - before), 0.0)
        memory["average"] = after
        np.multiply(
            after, np.sqrt((2.0 - self.smoothing) / self.smoothing), out=out, casting="unsafe"
        )


@dataclass(frozen=True)
class InnovationSd(DetectorTerm):
    """Standard deviations of the innovations.

    Parameters
    ----------
    range_scale_m, rate_scale_mps : float
        What is observed as 1.
    """

    described_as = "InnovationSd"
    range_scale_m: float = 10.0
    rate_scale_mps: float = 1.0

    def names(self, channels: int) -> tuple[str, ...]:
        """``range_sd_*`` and ``rate_sd_*``."""
        return slots("range_sd", channels) + slots("rate_sd", channels)

    def bounds(self) -> tuple[float, float]:
        """0 and 10."""
        return 0.0, 10.0

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        """Write them; 0 where a slot is invisible."""
        n, sd = epoch.visible.shape[1], innovation_sd(epoch)
        out[:, :n] = epoch.visible * sd[:, :n] * (1.0 / self.range_scale_m)
        out[:, n:] = epoch.visible * sd[:, n:] * (1.0 / self.rate_scale_mps)


@dataclass(frozen=True)
class ChiSquare(DetectorTerm):
    """Normalized innovations squared, of both kinds together, over the degrees of freedom."""

    described_as = "ChiSquare"
    needs: ClassVar[frozenset[str]] = frozenset({"innovation_cov"})

    def names(self, channels: int) -> tuple[str, ...]:
        """``chi_square_ratio``."""
        return ("chi_square_ratio",)

    def bounds(self) -> tuple[float, float]:
        """0 and 10."""
        return 0.0, 10.0

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        """Write the ratio; 1 is what the filter expects."""
        m = epoch.innovation.shape[1]
        belief = cast(FloatArray, epoch.innovation_cov)
        statistic = normalized_innovation_squared(epoch.innovation, belief, 0, m)
        freedom = np.maximum(2 * epoch.visible.sum(axis=1), 1)
        # an infinite one, of a covariance that is not positive definite, is cut like others
        out[:, 0] = np.minimum(statistic / freedom, 1e6)


@dataclass(frozen=True)
class InView(DetectorTerm):
    """Whether a slot has a visible satellite."""

    described_as = "InView"

    def names(self, channels: int) -> tuple[str, ...]:
        """``visible_*``."""
        return slots("visible", channels)

    def bounds(self) -> tuple[float, float]:
        """0 and 1."""
        return 0.0, 1.0

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        """Write 1 or 0."""
        out[:] = epoch.visible


@dataclass(frozen=True)
class PredictedMotion(DetectorTerm):
    """Velocity that the filter predicts, in local axes, and what the inertial sensors measure.

    Parameters
    ----------
    velocity_scale_mps, force_scale_mps2, rate_scale_rps : float
        What is observed as 1: velocity, specific force, angular rate.
    """

    described_as = "PredictedMotion"
    velocity_scale_mps: float = 100.0
    force_scale_mps2: float = 10.0
    rate_scale_rps: float = 0.1

    needs: ClassVar[frozenset[str]] = frozenset({"imu_delta"})

    def names(self, channels: int) -> tuple[str, ...]:
        """``predicted_velocity_*``, ``specific_force_*`` and ``angular_rate_*``."""
        local = tuple(f"predicted_velocity_{a}" for a in ("north", "east", "down"))
        body = ("forward", "right", "below")
        return (
            *local,
            *(f"specific_force_{a}" for a in body),
            *(f"angular_rate_{a}" for a in body),
        )

    def bounds(self) -> tuple[float, float]:
        """-10 and 10."""
        return -10.0, 10.0

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        """Write velocity, mean specific force and mean angular rate of the interval."""
        latitude, longitude, _ = ecef_to_geodetic(epoch.predicted_position)
        C_en = dcm_e_from_n(latitude, longitude)
        velocity_n = (epoch.predicted_velocity[:, :, None] * C_en).sum(axis=1)
        out[:, :3] = velocity_n * (1.0 / self.velocity_scale_mps)
        mean = cast(FloatArray, epoch.imu_delta) / epoch.interval[:, None]
        out[:, 3:6] = mean[:, :3] * (1.0 / self.force_scale_mps2)
        out[:, 6:] = mean[:, 3:] * (1.0 / self.rate_scale_rps)


@dataclass(frozen=True)
class Elapsed(DetectorTerm):
    """Time since the detector was switched on, in the last part of the warm-up.

    Parameters
    ----------
    scale_s : float
        What is observed as 1.
    """

    described_as = "Elapsed"
    scale_s: float = 600.0

    def names(self, channels: int) -> tuple[str, ...]:
        """``elapsed``."""
        return ("elapsed",)

    def bounds(self) -> tuple[float, float]:
        """0 and 10."""
        return 0.0, 10.0

    def declare(self, memory: Memory, channels: int) -> None:
        memory.declare("elapsed", np.zeros(memory.receivers))

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        memory["elapsed"] = memory["elapsed"] + epoch.interval
        out[:, 0] = memory["elapsed"] * (1.0 / self.scale_s)


@dataclass(frozen=True)
class ExclusionLeft(DetectorTerm):
    """Part of the allowance of exclusion that is left.

    Parameters
    ----------
    exclusion_s : float or None
        The allowance, that of the detector; without a limit all is left.
    """

    described_as = "ExclusionLeft"
    exclusion_s: float | None = None

    def names(self, channels: int) -> tuple[str, ...]:
        """``exclusion_left``."""
        return ("exclusion_left",)

    def bounds(self) -> tuple[float, float]:
        """0 and 1."""
        return 0.0, 1.0

    def __call__(self, epoch: Epoch, memory: Memory, out: Written) -> None:
        out[:, 0] = 1.0
        if self.exclusion_s:
            out[:, 0] -= memory["excluded_s"] / self.exclusion_s


@dataclass(frozen=True)
class LineOfSight(DetectorTerm):
    """Unit vectors from the predicted position to the satellites, in local axes.

    0 where a slot is invisible.
    """

    described_as = "LineOfSight"
    needs: ClassVar[frozenset[str]] = frozenset({"satellite_position"})

    def names(self, channels: int) -> tuple[str, ...]:
        """``sight_north_*``, ``sight_east_*`` and ``sight_down_*``."""
        axes = ("north", "east", "down")
        return tuple(name for axis in axes for name in slots(f"sight_{axis}", channels))

    def bounds(self) -> tuple[float, float]:
        """-1 and 1."""
        return -1.0, 1.0

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
