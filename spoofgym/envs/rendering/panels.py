"""Panels of the picture of an episode.

A panel draws once what stays, keeps the artists that move, and lets them follow the history.  Its
`fit` says whether something that stays had to change, its axes for instance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...core.plots import BLUE, GREEN, GREY, GRID, ORANGE, RED, style
from ...simulation.domain import FloatArray
from ...simulation.simulator import EpisodeLayout, SkyData
from .history import RenderHistory

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

SMALL = 8.5  # size of the type of labels
LEAST_M = 2.0  # smallest range of errors that is shown
NAME_DRIFT = 0.02  # how far a satellite goes on a sky plot of radius 1 before its name follows
NAME_SIZE = (0.2, 0.1)  # width and height of a satellite's name on such a plot
Box = tuple[float, float, float, float]  # left, bottom, width and height
MAGNIFIED = 0.2  # largest error on the map, as a part of the map
MOST_LINEAR = 5.0  # ratio of statistic and threshold from which on the axis is logarithmic


STEPS = (1.0, 2.0, 5.0, 10.0)
"""Round numbers, times powers of ten; axes that end there seldom change, and are seldom drawn."""


def moving_line(ax: Axes, look: str, **settings: Any) -> Line2D:
    (line,) = ax.plot([], [], look, animated=True, **settings)
    return line


class Way:
    """A line with a dot at its end, as they move."""

    def __init__(self, ax: Axes, look: str, color: str, **settings: Any) -> None:
        self.line = moving_line(ax, look, color=color, **settings)
        self.end = moving_line(ax, "o", color=color, ms=5.5, mec="white", mew=0.8)

    def follow(self, way_ne: FloatArray) -> None:
        north, east = way_ne.T
        self.line.set_data(east, north)
        self.end.set_data(east[-1:], north[-1:])


def head(ax: Axes, title: str, columns: int = 4, unit: str = "") -> None:
    if unit:
        ax.set_xlabel(f"east [{unit}]", fontsize=SMALL, labelpad=2)
        ax.set_ylabel(f"north [{unit}]", fontsize=SMALL, labelpad=2)
    ax.set_title(title, loc="left", fontsize=10, fontweight="bold", pad=20)
    place: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (-0.02, 0.985)}
    gaps: dict[str, Any] = {"columnspacing": 1.0, "handletextpad": 0.5, "borderaxespad": 0.1}
    ax.legend(ncols=columns, frameon=False, fontsize=SMALL, handlelength=1.5, **place, **gaps)
    ax.tick_params(labelsize=SMALL)
    ax.locator_params(nbins=6)


def round_up(value: float) -> float:
    """Least of 1, 2, 5, 10, 20 ... that is no less than a value.

    >>> round_up(3.1), round_up(0.02), round_up(60.0)
    (5.0, 0.02, 100.0)
    """
    power = 10.0 ** math.floor(math.log10(value))
    return next(step for step in STEPS if step * power >= value * (1.0 - 1e-9)) * power


def round_down(value: float) -> float:
    """Largest of 1, 2, 5, 10, 20 ... that is no more than a value.

    >>> round_down(3.1), round_down(0.02), round_down(60.0)
    (2.0, 0.02, 50.0)
    """
    power = 10.0 ** math.floor(math.log10(value) + 1e-9)
    return next(s for s in reversed(STEPS) if s * power <= value * (1.0 + 1e-9)) * power


def equal_limits(ax: Axes, low: tuple[float, float], high: tuple[float, float]) -> None:
    """Show a rectangle from corner `low` to `high`, (x, y), with one scale for both axes."""
    box = ax.get_window_extent()
    scale = max((high[0] - low[0]) / box.width, (high[1] - low[1]) / box.height)
    for middle, size, limit in (
        (0.5 * (low[0] + high[0]), box.width, ax.set_xlim),
        (0.5 * (low[1] + high[1]), box.height, ax.set_ylim),
    ):
        limit(middle - 0.5 * scale * size, middle + 0.5 * scale * size)


class FlightMap:
    """The flight, with both estimates; their errors are magnified, by a factor that is shown. It
    falls where an error exceeds `largest_m`."""

    def __init__(self, ax: Axes, layout: EpisodeLayout, largest_m: float = LEAST_M) -> None:
        style(ax)
        self._ax = ax
        extent = np.ptp(layout.track_ne, axis=0).max()
        self._unit, name = (1000.0, "km") if extent > 2000.0 else (1.0, "m")
        self._extent = max(float(extent), 1.0)
        north, east = (layout.track_ne / self._unit).T
        ax.plot(east, north, color=GRID, lw=5, solid_capstyle="round", label="way ahead", zorder=1)
        self._ways = [
            Way(ax, "-", BLUE, lw=1.4, label="clean twin"),
            Way(ax, "-", ORANGE, lw=1.8, label="estimate"),
            Way(ax, "-", "black", lw=1.6, label="truth"),
        ]
        self.artists: list[Artist] = [*(w.line for w in self._ways), *(w.end for w in self._ways)]
        margin = 1.1 * MAGNIFIED * self._extent / self._unit
        low, high = (east.min() - margin, north.min() - margin), (east.max(), north.max())
        equal_limits(ax, low, (high[0] + margin, high[1] + margin))
        head(ax, "Track", unit=name)
        self._scale = ax.text(
            0.02, 0.02, "", transform=ax.transAxes, fontsize=SMALL, color=GREY, zorder=5
        )
        self._magnify(self._choose_factor(largest_m))

    def _choose_factor(self, largest_m: float) -> float:
        return max(round_down(MAGNIFIED * self._extent / max(largest_m, LEAST_M)), 1.0)

    def _magnify(self, factor: float) -> None:
        self._factor = factor
        self._scale.set_text(
            f"errors drawn {factor:,.0f} times as large" if factor > 1.0 else "errors to scale"
        )

    def fit(self, history: RenderHistory) -> bool:
        factor = self._choose_factor(float(history.number("error_m").max()))
        if factor >= self._factor:
            return False
        self._magnify(factor)
        return True

    def follow(self, history: RenderHistory) -> None:
        truth = history.pair("position_ne")
        errors = history.pair("twin_error_ne"), history.pair("error_ne"), np.zeros_like(truth)
        for way, error in zip(self._ways, errors, strict=True):
            way.follow((truth + self._factor * error) / self._unit)


class ErrorPlane:
    """Estimate minus truth, north and east, with circles of equal distance."""

    def __init__(self, ax: Axes, layout: EpisodeLayout) -> None:
        style(ax)
        self._ax, self._radius = ax, 0.0
        ax.plot(0, 0, "+", color="black", ms=9, mew=1.4, ls="none", label="truth")
        self._ways: dict[str, Way] = {}
        if layout.commands_position:
            self._ways["displacement_ne"] = Way(ax, "--", GREEN, lw=1.5, label="commanded")
        self._ways["twin_error_ne"] = Way(ax, "-", BLUE, lw=1.5, label="clean twin")
        self._ways["error_ne"] = Way(ax, "-", ORANGE, lw=1.5, label="estimate")
        self._alarm = moving_line(ax, "X", color=RED, ms=9, mec="white", mew=0.8)
        self.artists: list[Artist] = [a for w in self._ways.values() for a in (w.line, w.end)]
        self.artists.append(self._alarm)
        self._circles: list[Artist] = []
        head(ax, "Estimate minus truth", unit="m")

    def fit(self, history: RenderHistory) -> bool:
        from matplotlib.patches import Circle

        largest = max(_largest(np.abs(history.pair(name))) for name in self._ways)
        radius = round_up(max(1.1 * largest, LEAST_M))
        if radius <= self._radius:
            return False
        self._radius = radius
        equal_limits(self._ax, (-1.06 * radius, -1.06 * radius), (1.06 * radius, 1.06 * radius))
        for circle in self._circles:
            circle.remove()
        self._circles = [
            self._ax.add_patch(Circle((0, 0), part * radius, fill=False, ec="#bbbbbb", lw=0.7))
            for part in (0.5, 1.0)
        ]
        return True

    def follow(self, history: RenderHistory) -> None:
        for name, way in self._ways.items():
            way.follow(history.pair(name))
        first = history.first_alarm
        if first is not None:
            north, east = history.pair("error_ne")[first]
            self._alarm.set_data([east], [north])


class SkyPlot:
    """Satellites by azimuth and elevation, zenith in the middle: authentic, spoofed, excluded."""

    def __init__(self, ax: Axes) -> None:
        from matplotlib.patches import Circle

        ax.set_axis_off()
        equal_limits(ax, (-1.16, -1.16), (1.16, 1.16))
        ax.add_patch(Circle((0, 0), 1.0, fc="#f6f8fa", ec=GREY, lw=1.0))
        for elevation_deg in (30.0, 60.0):
            radius = 1.0 - elevation_deg / 90.0
            ax.add_patch(Circle((0, 0), radius, fill=False, ec="#cccccc", lw=0.7))
            ax.text(0.02, radius - 0.02, f"{elevation_deg:.0f}°", fontsize=7, color=GREY, va="top")
        ax.plot([-1, 1], [0, 0], color="#cccccc", lw=0.7)
        ax.plot([0, 0], [-1, 1], color="#cccccc", lw=0.7)
        for letter, x, y in (("N", 0, 1.09), ("E", 1.09, 0), ("S", 0, -1.09), ("W", -1.09, 0)):
            ax.text(x, y, letter, ha="center", va="center", fontsize=SMALL, color=GREY)
        shape: dict[str, Any] = {"ms": 10.5, "mew": 1.2, "ls": "none"}
        self._authentic = moving_line(ax, "o", color="white", mec=BLUE, label="authentic", **shape)
        self._spoofed = moving_line(ax, "o", color=ORANGE, mec="white", label="spoofed", **shape)
        shape = {"ms": 8, "mew": 1.6, "ls": "none"}
        self._excluded = moving_line(ax, "x", color="black", label="excluded", **shape)
        self._ax = ax
        self._names: list[Text] = []
        self._named: tuple[FloatArray, NDArray[np.bool_]] | None = None
        self.artists: list[Artist] = [self._authentic, self._spoofed, self._excluded]
        head(ax, "Satellites", 3)

    def fit(self, history: RenderHistory) -> bool:
        sky = history.sky
        if sky is None:
            return False
        place = _on_sky(sky)
        if self._named is not None:
            before, visible = self._named
            moved = np.abs(place - before)[:, sky.visible].max(initial=0.0)
            if moved < NAME_DRIFT and np.array_equal(visible, sky.visible):
                return False
        if not self._names:
            self._names = [
                self._ax.text(0, 0, name, fontsize=7, ha="left", va="bottom") for name in sky.names
            ]
        for text, seen, (x, y) in zip(
            self._names, sky.visible, place_names(place, sky.visible), strict=True
        ):
            text.set_visible(bool(seen))
            text.set_position((x, y))
        self._named = place, sky.visible.copy()
        return True

    def follow(self, history: RenderHistory) -> None:
        sky = history.sky
        if sky is None:
            return
        x, y = _on_sky(sky)
        for line, shown in (
            (self._authentic, sky.visible & ~sky.spoofed),
            (self._spoofed, sky.visible & sky.spoofed),
            (self._excluded, sky.visible & (sky.weight <= 0.0)),
        ):
            line.set_data(x[shown], y[shown])


def place_names(place: FloatArray, visible: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Lower left corners of names next to satellites at `place` (2, n), free of others if possible.
    `visible` (n,) bool: which of them are drawn."""
    width, height = NAME_SIZE
    marks = [(x - 0.08, y - 0.08, 0.16, 0.16) for x, y in place.T.tolist()]
    names: list[Box] = []
    corners = []
    for k, ((x, y), seen) in enumerate(zip(place.T.tolist(), visible.tolist(), strict=True)):
        others = [mark for i, mark in enumerate(marks) if i != k and visible[i]]
        right, left, above, below = x + 0.06, x - 0.06 - width, y + 0.04, y - 0.04 - height
        tried = [(right, above), (left, above), (right, below), (left, below)]
        tried += [(right, y - height / 2), (left, y - height / 2)]
        corner = min(tried, key=lambda at: _overlap((*at, width, height), others + names))
        if seen:
            names.append((*corner, width, height))
        corners.append(corner)
    return corners


def _overlap(box: Box, others: Sequence[Box]) -> float:
    if not others:
        return 0.0
    mine, theirs = np.array(box), np.array(others)
    right = np.minimum(mine[:2] + mine[2:], theirs[:, :2] + theirs[:, 2:])
    return float(np.maximum(right - np.maximum(mine[:2], theirs[:, :2]), 0.0).prod(axis=1).sum())


def _on_sky(sky: SkyData) -> FloatArray:
    """(2, n) to the right and up on a sky plot of radius 1, north up and east to the right."""
    radius = 1.0 - 2.0 * sky.elevation / np.pi
    return np.stack([radius * np.sin(sky.azimuth), radius * np.cos(sky.azimuth)])


class TimePanel:
    """What panels over time share: phases, and the time of the first alarm."""

    def __init__(self, ax: Axes, layout: EpisodeLayout) -> None:
        style(ax)
        self._ax = ax
        end = layout.attack_s + layout.hold_s
        ax.set_xlim(0.0, end)
        if layout.hold_s:
            ax.axvspan(layout.attack_s, end, color=GREY, alpha=0.12, lw=0)
            look: dict[str, Any] = {"rotation": 90, "fontsize": 7, "color": GREY, "va": "bottom"}
            across = ax.get_xaxis_transform()
            ax.text(layout.attack_s, 0.03, " time to alert", transform=across, **look)
        ax.set_xlabel("time since the onset [s]", fontsize=SMALL, labelpad=2)
        self._first = moving_line(ax, "-", color=RED, lw=1.1)
        self._first.set_transform(ax.get_xaxis_transform())
        self.artists: list[Artist] = [self._first]
        self._top = 0.0

    def _find_limit(self, history: RenderHistory) -> float:
        """Where the axis has to end."""
        raise NotImplementedError

    def fit(self, history: RenderHistory) -> bool:
        """Raise the axis where something has grown."""
        top = self._find_limit(history)
        if top <= self._top:
            return False
        self._top = self._raise_limit(top)
        self._ax.set_ylim(0.0, self._top)
        return True

    def _raise_limit(self, top: float) -> float:
        return top

    def follow(self, history: RenderHistory) -> None:
        first = history.first_alarm
        if first is not None:
            time = history.number("time_s")[first]
            self._first.set_data([time, time], [0.0, 1.0])


class StatisticPanel(TimePanel):
    """Largest statistic over its threshold, attacked and twin; logarithmic where it explodes."""

    def __init__(self, ax: Axes, layout: EpisodeLayout) -> None:
        super().__init__(ax, layout)
        ax.axhline(1.0, color="black", lw=1.0, ls=":", label="threshold")
        self._twin = moving_line(ax, "-", color=BLUE, lw=1.0, label="clean twin")
        self._attacked = moving_line(ax, "-", color=ORANGE, lw=1.6, label="attacked")
        self._alarms = moving_line(ax, "o", color=RED, ms=3.5, ls="none", label="alarm")
        self.artists += [self._twin, self._attacked, self._alarms]
        head(ax, "Statistic over threshold")

    def _find_limit(self, history: RenderHistory) -> float:
        largest = max(_largest(history.number(name)) for name in ("ratio", "twin_ratio"))
        return 2.0 if largest < 1.8 else round_up(1.15 * largest)

    def _raise_limit(self, top: float) -> float:
        if top <= MOST_LINEAR:
            return top
        self._ax.set_yscale("symlog", linthresh=1.0)
        self._ax.yaxis.set_major_formatter("{x:g}")
        return float(10.0 ** np.ceil(np.log10(top)))

    def follow(self, history: RenderHistory) -> None:
        super().follow(history)
        time, ratio, alarm = history.number("time_s"), history.number("ratio"), history.alarm
        self._twin.set_data(time, history.number("twin_ratio"))
        self._attacked.set_data(time, ratio)
        self._alarms.set_data(time[alarm], ratio[alarm])


class ErrorPanel(TimePanel):
    """Distance from the clean twin, what was commanded, and what of it counts as undetected."""

    def __init__(self, ax: Axes, layout: EpisodeLayout) -> None:
        super().__init__(ax, layout)
        self._lines: list[tuple[str, Line2D]] = [
            ("error_m", moving_line(ax, "-", color="#aaaaaa", lw=1.0, label="from truth")),
            ("induced_m", moving_line(ax, "-", color=ORANGE, lw=1.8, label="from clean twin")),
            ("undetected_m", moving_line(ax, "-", color="black", lw=1.2, label="undetected")),
        ]
        self._commanded = None
        if layout.commands_position:
            self._commanded = moving_line(ax, "--", color=GREEN, lw=1.3, label="commanded")
            self.artists.append(self._commanded)
        self.artists += [line for _, line in self._lines]
        head(ax, "Displacement of the victim [m]")

    def _find_limit(self, history: RenderHistory) -> float:
        sizes = [history.number(name) for name, _ in self._lines]
        if self._commanded is not None:
            sizes.append(_size(history.pair("displacement_ne")))
        return round_up(max(1.08 * max(map(_largest, sizes)), LEAST_M))

    def follow(self, history: RenderHistory) -> None:
        super().follow(history)
        time = history.number("time_s")
        for name, line in self._lines:
            line.set_data(time, history.number(name))
        # nothing more counts in the time to alert, which is part of the last step
        counted, last = history.number("counted_s"), history.number("undetected_m")
        self._lines[-1][1].set_data(np.append(counted, time[-1]), np.append(last, last[-1]))
        if self._commanded is not None:
            self._commanded.set_data(time, _size(history.pair("displacement_ne")))


def _size(pair: FloatArray) -> FloatArray:
    return np.hypot(pair[:, 0], pair[:, 1])


def _largest(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else 0.0


Panel = FlightMap | ErrorPlane | SkyPlot | StatisticPanel | ErrorPanel
