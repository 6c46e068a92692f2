"""What there is to see of the first receiver of a core and its clean twin; nothing is drawn."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ...simulators.base import Simulator, run_serially
from ...simulators.frame import EpisodeLayout, FrameData
from ..core import SpoofCore

FIRST = np.zeros(1, dtype=np.intp)
"""The receiver that is shown."""


class Recorder(Protocol):
    """Looks at the first receiver of a core, and at its clean twin.

    The twin is a copy taken at the onset that goes on without an attack, with the same noise and
    the same detector in the loop.
    """

    @property
    def interval_s(self) -> float:
        """Time between two frames [s]."""

    def begin(self) -> EpisodeLayout:
        """Take the twin; called at the onset of every episode."""

    def frames(self) -> tuple[FrameData, FrameData]:
        """Let the twin follow; the attacked receiver and the twin now."""


class CoreRecorder:
    """Recorder of the first receiver of any core of the spoofer's side.

    Parameters
    ----------
    core : SpoofCore
        Whose first receiver is shown.
    """

    def __init__(self, core: SpoofCore) -> None:
        self._core = core
        self._twin: Simulator | None = None

    @property
    def interval_s(self) -> float:
        """Time between two frames [s]."""
        setup = self._core.setup
        return setup.repeat * setup.interval_s

    def begin(self) -> EpisodeLayout:
        """Take the twin."""
        simulator = self._core.engine.simulator
        if self._twin is None:
            self._twin = self._core.setup.simulator(1, run_serially)
        self._twin.copy_rows(FIRST, simulator, FIRST)
        return simulator.layout()

    def frames(self) -> tuple[FrameData, FrameData]:
        """Let the twin follow; both at the same epoch."""
        simulator, twin = self._core.engine.simulator, self._twin
        if twin is None:
            raise RuntimeError("no episode has started: call begin() before frames()")
        while twin.epochs[0] < simulator.epochs[0]:
            twin.advance()
            twin.update(twin.judge().weights)
        return simulator.frame(), twin.frame()
