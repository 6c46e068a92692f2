"""Limits of axes that seldom change, so that what does not move is seldom drawn anew."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEPS = (1.0, 2.0, 5.0, 10.0)


def round_up(value: float) -> float:
    """Least of 1, 2, 5, 10, 20 ... that is no less than a value.

    Examples
    --------
    >>> round_up(3.1), round_up(0.02), round_up(60.0)
    (5.0, 0.02, 100.0)
    """
    power = 10.0 ** math.floor(math.log10(value))
    return next(step for step in STEPS if step * power >= value * (1.0 - 1e-9)) * power


def round_down(value: float) -> float:
    """Largest of 1, 2, 5, 10, 20 ... that is no more than a value.

    Examples
    --------
    >>> round_down(3.1), round_down(0.02), round_down(60.0)
    (2.0, 0.02, 50.0)
    """
    power = 10.0 ** math.floor(math.log10(value) + 1e-9)
    return next(s for s in reversed(STEPS) if s * power <= value * (1.0 + 1e-9)) * power


def equal_limits(ax: Axes, low: tuple[float, float], high: tuple[float, float]) -> None:
    """Show a rectangle in the middle of a panel, with one scale for both axes.

    `low`, `high`: corners (x, y) of the rectangle.
    """
    box = ax.get_window_extent()
    scale = max((high[0] - low[0]) / box.width, (high[1] - low[1]) / box.height)
    for middle, size, limit in (
        (0.5 * (low[0] + high[0]), box.width, ax.set_xlim),
        (0.5 * (low[1] + high[1]), box.height, ax.set_ylim),
    ):
        limit(middle - 0.5 * scale * size, middle + 0.5 * scale * size)
