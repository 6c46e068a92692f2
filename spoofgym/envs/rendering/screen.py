"""What an environment with a render mode keeps: history, painter, window."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._registry import check_choice
from .history import RenderHistory
from .painter import Painter
from .recorders import Recorder
from .window import Window

RENDER_MODES = ("human", "rgb_array")


class Screen:
    """Records episodes, and draws the running one.

    Parameters
    ----------
    mode : {"human", "rgb_array"}
        Whether frames go to a window or to the caller.
    recorder : Recorder
        Where frames come from.

    Raises
    ------
    ValueError
        When there is no such mode.
    """

    def __init__(self, mode: str, recorder: Recorder) -> None:
        check_choice("render mode", mode, RENDER_MODES)
        self.mode, self._recorder = mode, recorder
        self._history: RenderHistory | None = None
        self._painter: Painter | None = None
        self._window: Window | None = None

    def __getstate__(self) -> dict[str, Any]:
        """State without pictures, which a copy draws again."""
        return {**self.__dict__, "_painter": None, "_window": None}

    def begin(self, info: Mapping[str, Any]) -> None:
        """Start an episode, at its onset."""
        self._history = RenderHistory(self._recorder.begin(), self._recorder.interval_s)
        self._painter = None
        self.add(info)

    def add(self, info: Mapping[str, Any]) -> None:
        """Record a step; in mode ``human`` show it."""
        history = self._begun("add")
        history.add(*self._recorder.frames(), info)
        if self.mode == "human":
            self.render()

    def _begun(self, what: str) -> RenderHistory:
        if self._history is None:
            raise RuntimeError(f"no episode has started: call reset() before {what}()")
        return self._history

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the episode as it is: (H, W, 3) uint8; None in mode ``human``."""
        frame = self.frame()
        if self.mode == "rgb_array":
            return frame
        if self._window is None:
            self._window = Window(f"spoofgym: {self._begun('render').layout.title}")
        self._window.show(frame)
        return None

    def frame(self) -> NDArray[np.uint8]:
        """Draw the episode as it is, in any mode: (H, W, 3) uint8, a new array."""
        history = self._begun("render")
        if self._painter is None:
            self._painter = Painter(history.layout)
        return self._painter.paint(history)

    def close(self) -> None:
        """Close the window; once more does nothing."""
        if self._window is not None:
            self._window.close()
        self._window = self._painter = None
