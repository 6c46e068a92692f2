"""Events that only look like spoofing: a step of the clock, a lost satellite, a front above."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..core.registry import require
from .signal_errors import IONOSPHERE_HEIGHT_M, NEVER, SHELL_RADIUS_M, FloatArray

STREAM = 0xBE  # key of the stream of an episode's domain from which its events are drawn
RANGES = (
    "clock_step_m",
    "satellite_loss_s",
    "front_slope_mm_per_km",
    "front_width_km",
    "front_speed_mps",
)


def part_of_episodes(event: str) -> Any:
    return setting(
        default=0.0, least=0.0, most=1.0, help=f"Part of the episodes that have {event}."
    )


@settings_record(frozen=True, kw_only=True)
class BenignEvents:
    """Events that come to some episodes, each at a time that is drawn; by default none does.

    All are drawn uniformly, times between the first epoch that detectors judge and the end of the
    episode.  A front of the ionosphere comes to the lines of sight one after the other, and behind
    it the delay grows by its slope times its speed, over its width; codes are delayed and carriers
    advanced.

    Fronts as `dattabarua2010` describes them, whose steepest had 425 mm/km; the default slopes are
    those of a mild one.  The other ranges have no source: they are a choice.
    """

    clock_step: float = part_of_episodes("a step of the receiver's clock")
    clock_step_m: tuple[float, float] = setting(
        default=(1.0, 10.0), unit="m", help="Range of its size; its sign is drawn."
    )
    satellite_loss: float = part_of_episodes("a loss of a satellite in view")
    satellite_loss_s: tuple[float, float] = setting(
        default=(10.0, 60.0), unit="s", help="Range of the time for which it is lost."
    )
    front: float = part_of_episodes("a front of the ionosphere")
    front_slope_mm_per_km: tuple[float, float] = setting(
        default=(20.0, 100.0), unit="mm/km", help="Range of its slope."
    )
    front_width_km: tuple[float, float] = setting(
        default=(25.0, 200.0), unit="km", help="Range of its width."
    )
    front_speed_mps: tuple[float, float] = setting(
        default=(100.0, 300.0), unit="m/s", help="Range of its speed against the lines of sight."
    )
    within_s: float | None = setting(
        default=None,
        above=0.0,
        omitted=True,
        unit="s",
        help="Time for which the parts are given: in an episode that is longer or shorter each "
        "event is as likely at any time.  By default they are parts of episodes of any length.",
    )

    def __post_init__(self) -> None:
        for name in RANGES:
            value = getattr(self, name)
            pair = tuple(float(x) for x in value) if np.shape(value) == (2,) else ()
            require(
                pair and 0.0 < pair[0] <= pair[1] < math.inf,
                f"`{name}` must be two numbers above 0, the least first, got {value!r}",
            )
            object.__setattr__(self, name, pair)

    @property
    def any(self) -> bool:
        return max(self.clock_step, self.satellite_loss, self.front) > 0.0

    def scale(self, part: float, lasts_s: float) -> float:
        """Part of the episodes of some length [s] that have an event."""
        return part if self.within_s is None else 1.0 - (1.0 - part) ** (lasts_s / self.within_s)


class EventWindow(NamedTuple):
    """When events may come, and what is in view. `first`, `last`: epochs; `interval_s` between
    epochs; `visible` (K, n) at all epochs; `look`: elevation and azimuth (b, n) at some."""

    first: int
    last: int
    interval_s: float
    visible: NDArray[np.bool_]
    look: Callable[[NDArray[np.int64]], tuple[FloatArray, FloatArray]]


def draw_events(
    events: BenignEvents, key: NDArray[np.uint64], window: EventWindow
) -> dict[str, Any]:
    """Events of one episode, by fields of `signal_errors.signal_shapes`. `key` (2,) of the
    episode's domain. All numbers are drawn, so that one event does not depend on whether another
    may come."""
    rng = np.random.default_rng([*key.tolist(), STREAM])
    u = rng.random(12)
    span = window.last - window.first + 1
    lasts_s = span * window.interval_s
    epochs = window.first + (u[:3] * span).astype(int)
    found: dict[str, Any] = {}
    if u[3] < events.scale(events.clock_step, lasts_s):
        size = _between(events.clock_step_m, u[4])
        found["clock_step"] = (float(epochs[0]), math.copysign(size, u[5] - 0.5))
    seen = np.flatnonzero(window.visible[epochs[1]])
    if u[6] < events.scale(events.satellite_loss, lasts_s):
        lasts = _between(events.satellite_loss_s, u[7]) / window.interval_s
        slot = seen[int(rng.random() * len(seen))]
        found["loss"] = (float(slot), float(epochs[1]), float(epochs[1]) + max(round(lasts), 1))
    if u[8] < events.scale(events.front, lasts_s):
        slope = 1e-6 * _between(events.front_slope_mm_per_km, u[9])
        width = 1e3 * _between(events.front_width_km, u[10])
        speed = _between(events.front_speed_mps, u[11])
        heading = 2.0 * math.pi * rng.random()
        k = epochs[2]
        elevation, azimuth = window.look(epochs[2:])
        along = _pierce_distance(elevation[0]) * np.cos(azimuth[0] - heading)
        arrival = k + (along - along.min()) / (speed * window.interval_s)
        found["front"] = (slope * speed * window.interval_s, slope * width)
        found["front_arrival"] = np.where(window.visible[k], arrival, NEVER)
    return found


def _between(pair: tuple[float, float], u: float) -> float:
    return pair[0] + u * (pair[1] - pair[0])


def _pierce_distance(elevation: FloatArray) -> FloatArray:
    """Distance along the ground to where a line of sight pierces the shell [m]."""
    E = np.maximum(elevation, 0.0)
    inside = SHELL_RADIUS_M / (SHELL_RADIUS_M + IONOSPHERE_HEIGHT_M) * np.cos(E)
    return SHELL_RADIUS_M * (0.5 * math.pi - E - np.arcsin(inside))
