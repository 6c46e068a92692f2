"""What a picture shows of an episode so far: arrays, filled one step at a time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...simulators.frame import EpisodeLayout, FrameData, SkyData

FloatArray = NDArray[np.float64]
NUMBERS = ("time_s", "counted_s", "ratio", "twin_ratio", "induced_m", "error_m", "undetected_m")
"""What there is one of at every instant."""


class RenderHistory:
    """An episode from its onset to now; K instants of it.

    Parameters
    ----------
    layout : EpisodeLayout
        What does not change in it.
    decision_s : float
        Time between two instants, but for the last one, which comes after the time to alert.

    Attributes
    ----------
    layout : EpisodeLayout
        The same.
    count : int
        Instants so far, K.
    sky : SkyData or None
        The present one.
    """

    def __init__(self, layout: EpisodeLayout, decision_s: float) -> None:
        self.layout, self.count = layout, 0
        self._decision_s = decision_s
        self.sky: SkyData | None = None
        size = layout.steps + 1
        self._numbers = {name: np.full(size, np.nan) for name in NUMBERS}
        self._pairs = {
            name: np.full((size, 2), np.nan)
            for name in ("position_ne", "error_ne", "twin_error_ne", "displacement_ne")
        }
        self._alarm = np.zeros(size, dtype=np.bool_)

    def add(self, attacked: FrameData, twin: FrameData, info: Mapping[str, Any]) -> None:
        """Append an instant."""
        k, self.count = self.count, self.count + 1
        apart = attacked.error_ne - twin.error_ne
        since = info["time_s"] - self.layout.onset_s
        for name, value in {
            "time_s": since,
            "counted_s": min(since, k * self._decision_s),
            "ratio": attacked.ratio,
            "twin_ratio": twin.ratio,
            "induced_m": np.hypot(apart[0], apart[1]),
            "error_m": np.hypot(attacked.error_ne[0], attacked.error_ne[1]),
            "undetected_m": info.get("undetected_displacement_m", 0.0),
        }.items():
            self._numbers[name][k] = value
        for name, pair in {
            "position_ne": attacked.position_ne,
            "error_ne": attacked.error_ne,
            "twin_error_ne": twin.error_ne,
            "displacement_ne": attacked.displacement_ne,
        }.items():
            if pair is not None:
                self._pairs[name][k] = pair
        self._alarm[k] = info.get("alarm", False)
        self.sky = attacked.sky

    def number(self, name: str) -> FloatArray:
        """A number at every instant.

        `name`: ``time_s`` since the onset; ``counted_s``, that of the last command; ``ratio`` and
        ``twin_ratio`` of the statistic to its threshold; ``induced_m`` from the clean twin;
        ``error_m`` from the truth; ``undetected_m``, the undetected displacement; returns (K,) a
        view.
        """
        return self._numbers[name][: self.count]

    def pair(self, name: str) -> FloatArray:
        """A north and an east at every instant: (K, 2) [m], a view."""
        return self._pairs[name][: self.count]

    @property
    def alarm(self) -> NDArray[np.bool_]:
        """(K,) bool, a view."""
        return self._alarm[: self.count]

    @property
    def first_alarm(self) -> int | None:
        """Index of the first alarm."""
        return int(self.alarm.argmax()) if self.alarm.any() else None
