"""The picture of an episode as an array of pixels, and the window where it is shown.

The fixed part is drawn once and stored; a frame copies it, and draws the moving part on it.
Numbers change with every frame, and matplotlib lays out a text in milliseconds: their characters
are drawn once, and put into the frames as tiles.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...core.declared import check_word
from ...core.plots import RED, figure_class
from ...simulation.simulator import EpisodeLayout
from .history import CoreRecorder, RenderHistory
from .panels import ErrorPanel, ErrorPlane, FlightMap, Panel, SkyPlot, StatisticPanel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE_IN = (11.2, 7.0)
DPI = 100
NUMBERS = (
    ("time_s", "time [s]", "{:.1f}"),
    ("induced_m", "induced error [m]", "{:.2f}"),
    ("undetected_m", "undetected displacement [m]", "{:.2f}"),
    ("ratio", "statistic / threshold", "{:.3g}"),
)
"""Numbers of a history: name, text, format."""
CHARACTERS = "0123456789.-+einfa "
SIZE_PT = 10.0
LEFT, BELOW_TOP = 0.015, 0.912  # where the numbers start, as parts of the picture
WIDTH = 8  # characters that each of them may have


class Tiles:
    """Pictures of single characters.  `width`, `height`: of a tile [pixels]."""

    def __init__(self, dpi: float) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        em = SIZE_PT * dpi / 72.0
        self.width, self.height = math.ceil(0.602 * em), math.ceil(1.2 * em)
        count = len(CHARACTERS)
        figure = figure_class()(figsize=(count * self.width / dpi, self.height / dpi), dpi=dpi)
        canvas: Any = FigureCanvasAgg(figure)
        for k, letter in enumerate(CHARACTERS):
            figure.text(
                k / count, 0.25, letter, fontsize=SIZE_PT, family="monospace", fontweight="bold"
            )
        canvas.draw()
        strip = np.asarray(canvas.buffer_rgba())[..., :3]
        self._tiles = dict(zip(CHARACTERS, np.split(strip, count, axis=1), strict=True))

    def write(self, frame: NDArray[np.uint8], x: int, y: int, text: str) -> None:
        """Put a text into a frame, (H, W, 3); `x`, `y`: its left upper corner [pixels]."""
        row = np.concatenate([self._tiles[letter] for letter in text], axis=1)
        frame[y : y + row.shape[0], x : x + row.shape[1]] = row


class Headline:
    """Title, present numbers, and whether the detector has alarmed, on a figure with a canvas."""

    def __init__(self, figure: Figure, layout: EpisodeLayout) -> None:
        figure.text(LEFT, 0.975, layout.title, fontsize=13, fontweight="bold", va="top")
        self._alarm = figure.text(
            0.985, 0.975, "", fontsize=11, fontweight="bold", color=RED, ha="right", va="top"
        )
        self._tiles = Tiles(figure.dpi)
        self._corners = []
        x, height, width = LEFT, figure.bbox.height, figure.bbox.width
        for _, text, _ in NUMBERS:
            label = figure.text(x, BELOW_TOP, text, fontsize=SIZE_PT, va="baseline")
            box = label.get_window_extent()
            base = round(height * (1.0 - BELOW_TOP))
            corner = math.ceil(box.x1), base - round(0.75 * self._tiles.height)
            self._corners.append(corner)
            x = (corner[0] + (WIDTH + 3) * self._tiles.width) / width

    def fit(self, history: RenderHistory) -> bool:
        first = history.first_alarm
        if first is None or self._alarm.get_text():
            return False
        self._alarm.set_text(f"ALARM at {history.number('time_s')[first]:g} s")
        return True

    def write(self, history: RenderHistory, frame: NDArray[np.uint8]) -> None:
        for (x, y), (name, _, form) in zip(self._corners, NUMBERS, strict=True):
            number = form.format(history.number(name)[-1]).rjust(WIDTH)
            self._tiles.write(frame, x, y, number)


class Painter:
    """Draws the frames of one episode.

    Parameters
    ----------
    layout : EpisodeLayout
        What stays the same in it.
    largest_m : float
        Largest error of the episode where it is known [m]: up to it the map keeps its scale.
    """

    def __init__(self, layout: EpisodeLayout, largest_m: float = 0.0) -> None:
        figure = figure_class()(figsize=SIZE_IN, dpi=DPI)
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self._canvas: Any = FigureCanvasAgg(figure)
        self._figure = figure
        grid = figure.add_gridspec(
            2, 6, left=0.066, right=0.985, bottom=0.065, top=0.832, hspace=0.42, wspace=0.9
        )
        half = 2 if layout.has_sky else 3
        self._panels: list[Panel] = [
            FlightMap(figure.add_subplot(grid[0, :half]), layout, largest_m),
            ErrorPlane(figure.add_subplot(grid[0, half : 2 * half]), layout),
            StatisticPanel(figure.add_subplot(grid[1, :3]), layout),
            ErrorPanel(figure.add_subplot(grid[1, 3:]), layout),
        ]
        if layout.has_sky:
            self._panels.append(SkyPlot(figure.add_subplot(grid[0, 4:])))
        self._headline = Headline(figure, layout)
        self._background: Any = None

    def paint(self, history: RenderHistory) -> NDArray[np.uint8]:
        """Draw the episode so far, with at least one instant: (H, W, 3) uint8, a new array."""
        changed = [panel.fit(history) for panel in self._panels]
        changed.append(self._headline.fit(history))
        if self._background is None or any(changed):
            self._canvas.draw()
            self._background = self._canvas.copy_from_bbox(self._figure.bbox)
        self._canvas.restore_region(self._background)
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


RENDER_MODES = ("human", "rgb_array")


class Screen:
    """Records episodes, and draws the running one.

    Parameters
    ----------
    mode : {"human", "rgb_array"}
        Whether frames go to a window or to the caller.
    recorder : CoreRecorder
        Where frames come from.
    largest_m : float
        Largest error of the episode where it is known [m]: up to it the map keeps its scale.
    """

    def __init__(self, mode: str, recorder: CoreRecorder, largest_m: float = 0.0) -> None:
        check_word("render_mode", mode, RENDER_MODES)
        self.mode, self._recorder, self._largest_m = mode, recorder, largest_m
        self._history: RenderHistory | None = None
        self._painter: Painter | None = None
        self._window: Window | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_painter": None, "_window": None}

    def start_episode(self, info: Mapping[str, Any]) -> None:
        self._history = RenderHistory(self._recorder.start_episode(), self._recorder.interval_s)
        self._painter = None
        self.add(info)

    def add(self, info: Mapping[str, Any]) -> None:
        history = self._require_history("add")
        history.add(*self._recorder.frames(), info)
        if self.mode == "human":
            self.render()

    def _require_history(self, what: str) -> RenderHistory:
        if self._history is None:
            raise RuntimeError(f"no episode has started: call reset() before {what}()")
        return self._history

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the episode as it is: (H, W, 3) uint8; None in mode ``human``."""
        frame = self.frame()
        if self.mode == "rgb_array":
            return frame
        if self._window is None:
            self._window = Window(f"spoofgym: {self._require_history('render').layout.title}")
        self._window.show(frame)
        return None

    def frame(self) -> NDArray[np.uint8]:
        """Draw the episode as it is, in any mode: (H, W, 3) uint8, a new array."""
        history = self._require_history("render")
        if self._painter is None:
            self._painter = Painter(history.layout, self._largest_m)
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
                "MPLBACKEND to a backend with windows, such as TkAgg or QtAgg; Gymnasium's "
                "check_env needs none with skip_render_check=True"
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
