"""What a picture shows of an episode so far, and where it comes from; nothing is drawn here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...simulation.domain import FloatArray
from ...simulation.simulator import EpisodeLayout, FrameData, Simulator, SkyData, run_serially
from ..core import SpoofCore

NUMBERS = ("time_s", "counted_s", "ratio", "twin_ratio", "induced_m", "error_m", "undetected_m")
"""Time since the onset, and that of the last command; statistic over threshold; errors from the
clean twin and from the truth; the undetected displacement."""
PAIRS = ("position_ne", "error_ne", "twin_error_ne", "displacement_ne")


class RenderHistory:
    """An episode from its onset to now; `count` K instants of it.

    Parameters
    ----------
    layout : EpisodeLayout
        What does not change in it.
    decision_s : float
        Time between two instants, but for the last one, which comes after the time to alert.
    """

    def __init__(self, layout: EpisodeLayout, decision_s: float) -> None:
        self.layout, self.count = layout, 0
        self._decision_s = decision_s
        self.sky: SkyData | None = None
        size = layout.steps + 1
        self._numbers = {name: np.full(size, np.nan) for name in NUMBERS}
        self._pairs = {name: np.full((size, 2), np.nan) for name in PAIRS}
        self._alarm = np.zeros(size, dtype=np.bool_)

    def add(self, attacked: FrameData, twin: FrameData, info: Mapping[str, Any]) -> None:
        k, self.count = self.count, self.count + 1
        since = info["time_s"] - self.layout.onset_s
        times = since, min(since, k * self._decision_s)
        errors = np.hypot(*(attacked.error_ne - twin.error_ne)), np.hypot(*attacked.error_ne)
        undetected = info.get("undetected_displacement_m", 0.0)
        numbers = *times, attacked.ratio, twin.ratio, *errors, undetected
        for name, value in zip(NUMBERS, numbers, strict=True):
            self._numbers[name][k] = value
        ways = attacked.position_ne, attacked.error_ne, twin.error_ne, attacked.displacement_ne
        for name, pair in zip(PAIRS, ways, strict=True):
            if pair is not None:
                self._pairs[name][k] = pair
        self._alarm[k] = info.get("alarm", False)
        self.sky = attacked.sky

    def number(self, name: str) -> FloatArray:
        """One of `NUMBERS` at every instant: (K,), a view."""
        return self._numbers[name][: self.count]

    def pair(self, name: str) -> FloatArray:
        """A north and an east at every instant: (K, 2) [m], a view."""
        return self._pairs[name][: self.count]

    @property
    def alarm(self) -> NDArray[np.bool_]:
        return self._alarm[: self.count]

    @property
    def first_alarm(self) -> int | None:
        return int(self.alarm.argmax()) if self.alarm.any() else None


class CoreRecorder:
    """Looks at the first receiver of a core of the spoofer's side, and at its clean twin.

    The twin is a copy taken at the onset that goes on without an attack, with the same noise and
    the same detector in the loop.

    Parameters
    ----------
    core : SpoofCore
        Of any victim.
    """

    def __init__(self, core: SpoofCore) -> None:
        self._core = core
        self._twin: Simulator | None = None

    @property
    def interval_s(self) -> float:
        setup = self._core.setup
        return setup.repeat * setup.interval_s

    def start_episode(self) -> EpisodeLayout:
        simulator = self._core.engine.simulator
        if self._twin is None:
            self._twin = self._core.setup.simulator(1, run_serially)
        first = np.zeros(1, dtype=np.intp)
        self._twin.copy_rows(first, simulator, first)
        return simulator.layout()

    def frames(self) -> tuple[FrameData, FrameData]:
        """Let the twin follow; the attacked receiver and the twin now."""
        simulator, twin = self._core.engine.simulator, self._twin
        if twin is None:
            raise RuntimeError("no episode has started: call begin() before frames()")
        while twin.epochs[0] < simulator.epochs[0]:
            twin.advance()
            twin.update(twin.judge().weights)
        return simulator.frame(), twin.frame()
