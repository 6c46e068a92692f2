"""The picture of an episode as an array of pixels.

What stays is drawn once and kept; a frame copies it, and draws upon it what moves.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._pictures import figure_class
from ...simulators.frame import EpisodeLayout
from .headline import Headline
from .history import RenderHistory
from .panels import ErrorPanel, ErrorPlane, FlightMap, Panel, SkyPlot, StatisticPanel

SIZE_IN = (11.2, 7.0)
DPI = 100


class Painter:
    """Draws the frames of one episode.

    Parameters
    ----------
    layout : EpisodeLayout
        What stays the same in it.

    Raises
    ------
    ImportError
        When matplotlib is not installed.
    """

    def __init__(self, layout: EpisodeLayout) -> None:
        figure = figure_class()(figsize=SIZE_IN, dpi=DPI)
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self._canvas: Any = FigureCanvasAgg(figure)
        self._figure = figure
        grid = figure.add_gridspec(
            2, 6, left=0.066, right=0.985, bottom=0.065, top=0.832, hspace=0.42, wspace=0.9
        )
        half = 2 if layout.has_sky else 3
        self._panels: list[Panel] = [
            FlightMap(figure.add_subplot(grid[0, :half]), layout),
            ErrorPlane(figure.add_subplot(grid[0, half : 2 * half]), layout),
            StatisticPanel(figure.add_subplot(grid[1, :3]), layout),
            ErrorPanel(figure.add_subplot(grid[1, 3:]), layout),
        ]
        if layout.has_sky:
            self._panels.append(SkyPlot(figure.add_subplot(grid[0, 4:])))
        self._headline = Headline(figure, layout)
        self._kept: Any = None

    def paint(self, history: RenderHistory) -> NDArray[np.uint8]:
        """Draw the episode as it stands.

        `history`: of this painter's layout, with at least one instant; returns (H, W, 3) uint8, a
        new array.
        """
        changed = [panel.fit(history) for panel in self._panels]
        changed.append(self._headline.fit(history))
        if self._kept is None or any(changed):
            self._canvas.draw()
            self._kept = self._canvas.copy_from_bbox(self._figure.bbox)
        self._canvas.restore_region(self._kept)
        for panel in self._panels:
            panel.follow(history)
            for artist in panel.artists:
                self._figure.draw_artist(artist)
        pixels = np.asarray(self._canvas.buffer_rgba())
        frame = np.empty((*pixels.shape[:2], 3), dtype=np.uint8)
        for colour in range(3):  # ten times as fast as a copy of pixels[..., :3]
            frame[..., colour] = pixels[..., colour]
        self._headline.write(history, frame)
        return frame
