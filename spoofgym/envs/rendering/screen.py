"""What an environment with a render mode keeps: the history, and a window where it is shown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...core.plots import figure_class
from ...core.registry import check_choice
from .figure import DPI, SIZE_IN, Painter
from .history import CoreRecorder, RenderHistory

RENDER_MODES = ("human", "rgb_array")


class Screen:
    """Records episodes, and draws the running one.

    Parameters
    ----------
    mode : {"human", "rgb_array"}
        Whether frames go to a window or to the caller.
    recorder : CoreRecorder
        Where frames come from.
    """

    def __init__(self, mode: str, recorder: CoreRecorder) -> None:
        check_choice("render mode", mode, RENDER_MODES)
        self.mode, self._recorder = mode, recorder
        self._history: RenderHistory | None = None
        self._painter: Painter | None = None
        self._window: Window | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_painter": None, "_window": None}

    def begin(self, info: Mapping[str, Any]) -> None:
        self._history = RenderHistory(self._recorder.begin(), self._recorder.interval_s)
        self._painter = None
        self.add(info)

    def add(self, info: Mapping[str, Any]) -> None:
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
        if self._window is not None:
            self._window.close()
        self._window = self._painter = None


class Window:
    """A window on the screen."""

    def __init__(self, title: str) -> None:
        figure_class()  # which says how to install matplotlib
        import matplotlib
        from matplotlib import pyplot

        self._figure = pyplot.figure(figsize=SIZE_IN, dpi=DPI)
        if self._figure.canvas.required_interactive_framework is None:
            pyplot.close(self._figure)
            raise RuntimeError(
                "render_mode='human' needs a display, and matplotlib's backend "
                f"{matplotlib.get_backend()!r} has no window: use render_mode='rgb_array', or set "
                "MPLBACKEND to a backend with windows, such as TkAgg or QtAgg"
            )
        manager = self._figure.canvas.manager
        if manager is not None:
            manager.set_window_title(title)
            manager.show()
        self._ax = self._figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._ax.set_axis_off()
        self._image: Any = None

    def show(self, frame: NDArray[np.uint8]) -> None:
        """Show a frame; nothing where the user has closed the window.  `frame` (H, W, 3) uint8."""
        from matplotlib import pyplot

        if not pyplot.fignum_exists(self._figure.number):
            return
        if self._image is None:
            self._image = self._ax.imshow(frame)
        else:
            self._image.set_data(frame)
        self._figure.canvas.draw()
        self._figure.canvas.flush_events()

    def close(self) -> None:
        from matplotlib import pyplot

        pyplot.close(self._figure)
