"""Where a scripted spoofer pushes: along a heading, or along the target direction it observes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .context import SpooferContext

FloatArray = NDArray[np.float64]
AXES = ("north", "east", "down", "clock")
"""Axes by which the actions of a false position are named; a heading leaves the last two alone."""
TARGET = "target"
"""Heading that follows the target direction."""
TARGET_NAMES = ("target_direction_north", "target_direction_east")
"""Elements of an observation that give the target direction."""
UNIT = 1e-3
"""How much the length of an observed direction may differ from 1."""


def axes_of(action_names: tuple[str, ...]) -> list[str]:
    """What an action's elements are of: axes, or channels. Returns (a,) names without their
    unit."""
    return [name.rsplit("_", 1)[0] for name in action_names]


def has_heading(action_names: tuple[str, ...]) -> bool:
    return set(axes_of(action_names)) <= set(AXES)


def direction(action_names: tuple[str, ...], heading_deg: float) -> FloatArray:
    """Unit command along a heading, or the same command for every channel: (a,) in [-1, 1]."""
    axes = axes_of(action_names)
    if not has_heading(action_names):
        return np.ones(len(axes))
    heading = math.radians(heading_deg % 360.0)
    wanted = {"north": math.cos(heading), "east": math.sin(heading), "down": 0.0, "clock": 0.0}
    for name, part in wanted.items():
        if abs(part) < 1e-12:
            wanted[name] = 0.0
        elif name not in axes:
            raise ValueError(
                f"`heading_deg` = {heading_deg:g} needs a command to the {name}, but the attack "
                f"commands {', '.join(action_names)}"
            )
    return np.array([wanted[name] for name in axes])


def check_heading(heading_deg: float | str) -> None:
    if isinstance(heading_deg, str):
        right = heading_deg == TARGET
    else:
        number = isinstance(heading_deg, int | float) and not isinstance(heading_deg, bool)
        right = number and math.isfinite(heading_deg)
    if not right:
        raise ValueError(f"`heading_deg` must be a finite number or 'target', got {heading_deg!r}")


class Aim:
    """Unit command along a heading, or the same command for every channel.

    - `context`: names of actions and observations;
    - `heading_deg`: clockwise from north, or that of every observation;
    - `turned_deg`: to be added to it.
    """

    def __init__(
        self, context: SpooferContext, heading_deg: float | str, turned_deg: float = 0.0
    ) -> None:
        names = context.action_names
        self._columns: list[int] = []
        self._size, self._turned = len(names), math.radians(turned_deg)
        if isinstance(heading_deg, str) and has_heading(names):
            self._columns, self._places = _columns(context), _places(names)
        else:
            fixed = 0.0 if isinstance(heading_deg, str) else heading_deg
            self._fixed = direction(names, fixed + turned_deg)

    def __call__(self, observation: NDArray[np.float32]) -> FloatArray:
        """Unit command. `observation` (B, o); looked at for the target direction alone; returns
        (a,) the same for all receivers, or (B, a)."""
        if not self._columns:
            return self._fixed
        north, east = (observation[:, k].astype(np.float64) for k in self._columns)
        right = np.abs(np.hypot(north, east) - 1.0) < UNIT
        if not right.all():
            row = np.flatnonzero(~right)[0]
            raise ValueError(
                f"the target direction that receiver {row} observes, ({north[row]:g}, "
                f"{east[row]:g}), has not the length 1: `heading_deg` = 'target' needs "
                "observations as the environment makes them"
            )
        cosine, sine = math.cos(self._turned), math.sin(self._turned)
        command = np.zeros((len(observation), self._size))
        command[:, self._places[0]] = cosine * north - sine * east
        command[:, self._places[1]] = sine * north + cosine * east
        return np.clip(command, -1.0, 1.0)


def _columns(context: SpooferContext) -> list[int]:
    seen = context.observation_names
    if not set(TARGET_NAMES) <= set(seen):
        raise ValueError(
            f"`heading_deg` = 'target' needs {' and '.join(TARGET_NAMES)} among the observations: "
            "they are there with target_heading_deg='random', and with the observation term "
            "'target-direction'"
        )
    return [seen.index(name) for name in TARGET_NAMES]


def _places(action_names: tuple[str, ...]) -> list[int]:
    axes = axes_of(action_names)
    for name in AXES[:2]:
        if name not in axes:
            raise ValueError(
                f"`heading_deg` = 'target' needs a command to the {name}, but the attack commands "
                f"{', '.join(action_names)}"
            )
    return [axes.index(name) for name in AXES[:2]]
