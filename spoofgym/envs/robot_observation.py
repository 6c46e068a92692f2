"""What the spoofer of a wheeled robot observes, by knowledge.

``blind``: its own offset and rate, and the time.  ``tracking``: also the robot's true motion.
``oracle``: also statistic over threshold, weight of the fix, and error of the estimate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._registry import check_choice
from .observations import KNOWLEDGE

FloatArray = NDArray[np.float64]

LEAST_LEVEL = {
    "own_displacement_north": "blind",
    "own_displacement_east": "blind",
    "own_rate_north": "blind",
    "own_rate_east": "blind",
    "time_since_onset": "blind",
    "time_left": "blind",
    "target_position_north": "tracking",
    "target_position_east": "tracking",
    "target_velocity_north": "tracking",
    "target_velocity_east": "tracking",
    "statistic_ratio": "oracle",
    "weight": "oracle",
    "estimate_error_north": "oracle",
    "estimate_error_east": "oracle",
}
"""Every element, and the least level of knowledge that it takes."""
BOUNDS = {
    "own_rate_north": (-1.0, 1.0),
    "own_rate_east": (-1.0, 1.0),
    "time_since_onset": (0.0, 1.0),
    "time_left": (0.0, 1.0),
    "statistic_ratio": (0.0, 10.0),
    "weight": (0.0, 1.0),
}
"""Bounds other than -10 and 10."""


class Values(NamedTuple):
    """What can be observed, over its scales, in the order of `LEAST_LEVEL`.

    Attributes
    ----------
    displacement, rate, time : ndarray
        (B, 2) own offset and its rate; parts of the command phase that are over and left.
    position, velocity : ndarray
        (B, 2) true motion since the onset.
    verdict, error : ndarray
        (B, 2) statistic over threshold and weight; error of the estimate.
    """

    displacement: FloatArray
    rate: FloatArray
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    verdict: FloatArray
    error: FloatArray


def elements(knowledge: str) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Elements of a level, and their bounds.

    Returns `names` (o,) one per element; `low`, `high` (o,) finite bounds.
    """
    check_choice("knowledge", knowledge, KNOWLEDGE)
    level = KNOWLEDGE.index(knowledge)
    names = tuple(name for name, least in LEAST_LEVEL.items() if KNOWLEDGE.index(least) <= level)
    bounds = np.array([BOUNDS.get(name, (-10.0, 10.0)) for name in names])
    return names, bounds[:, 0].copy(), bounds[:, 1].copy()


def write(values: Values, out: NDArray[np.float32]) -> None:
    """Write the first elements.  `out` (B, o), written, not clipped; o gives the level."""
    pairs = out.shape[1] // 2
    for i, pair in enumerate(values[:pairs]):
        out[:, 2 * i : 2 * i + 2] = pair
