"""What detectors have in common that test whether pseudoranges of an epoch agree."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, cast

import numpy as np
from numpy.typing import NDArray

from ...receiver.epoch import Epoch
from ..base import Detector, DetectorContext, Verdict
from ..thresholds import check_probability
from .consistency import (
    MIN_SATELLITES,
    SearchData,
    check_channels,
    check_test,
    fit_thresholds,
    frame_axes,
    line_up_all,
    noise_sd,
    search_data,
    write_groups,
)

FloatArray = NDArray[np.float64]


class ConsistencyTest(Detector):
    """Residual test of all satellites in view; after an alarm, a search of groups that agree. A
    subclass is a dataclass with the settings below, which `Raim` describes."""

    sigma_m: float | None
    confidence: float
    false_alarm: float
    exclude: bool
    frame: str = "ecef"

    needs: ClassVar[frozenset[str]] = frozenset({"pseudorange", "satellite_position"})

    def __post_init__(self) -> None:
        check_test(self.sigma_m, self.confidence)
        check_probability("false_alarm", self.false_alarm)

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        b, n = context.receivers, context.channels
        check_channels(n)
        sigma = noise_sd(self.sigma_m, context.epoch_sd, n)
        most = max(n, MIN_SATELLITES)
        self._limit = fit_thresholds(sigma, 1.0 - self.confidence, most)
        self._alarm_limit = fit_thresholds(sigma, self.false_alarm, most)
        self._axes = np.tile(np.eye(3), (b, 1, 1))
        self._data = search_data(b, n)  # overwritten at every epoch
        self.memory.declare("group", np.zeros((b, n), dtype=np.int8))

    @abstractmethod
    def search(self, data: SearchData) -> None:
        """Divide the satellites of every receiver with an alarm: `found` and `mask`."""

    def judge(self, epoch: Epoch) -> Verdict:
        """Test one epoch. Returns (B, 1) SSE of all in view [m], threshold and alarm; (B, 2n)
        weights with `exclude`."""
        b, n = epoch.visible.shape
        statistic, threshold = np.empty((b, 1)), np.empty((b, 1))
        weights = np.empty((b, 2 * n))
        line_up_all(
            cast(FloatArray, epoch.pseudorange),
            cast(FloatArray, epoch.satellite_position),
            epoch.visible,
            epoch.predicted_position,
            self._axes if self.frame == "ecef" else frame_axes(epoch.predicted_position),
            self._alarm_limit,
            self._data,
            statistic,
            threshold,
            self.memory["group"],
            weights,
        )
        alarm: NDArray[np.bool_] = statistic > threshold
        if alarm.any():
            self.search(self._data)
            write_groups(self._data, epoch.visible, self.memory["group"], weights)
        return Verdict(statistic, threshold, alarm, weights if self.exclude else None)
