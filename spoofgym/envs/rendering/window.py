"""A window that shows frames, by whichever backend matplotlib has for this display."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._pictures import figure_class
from .painter import DPI, SIZE_IN


class Window:
    """A window on the screen."""

    def __init__(self, title: str) -> None:
        figure_class()  # tells how to install matplotlib
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
        ax = self._figure.add_axes((0.0, 0.0, 1.0, 1.0))
        ax.set_axis_off()
        self._ax = ax
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
        """Close it; once more does nothing."""
        from matplotlib import pyplot

        pyplot.close(self._figure)
