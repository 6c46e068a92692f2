"""Scenarios: flight x GNSS errors x grade of the inertial sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import lru_cache, partial
from typing import Any, TypeGuard

import numpy as np

from ..core.compile import recall_arrays
from ..core.declared import setting, settings_record
from ..core.registry import build_record, check_choice, require
from .events import BenignEvents
from .flight import Flight, Headings
from .gnss_errors import ERRORS, GnssErrors
from .manoeuvres import FLIGHTS, terminal
from .run import (
    CHANNELS,
    FEWEST_CHANNELS,
    HIGHEST_MASK_DEG,
    MASK_DEG,
    MOST_CHANNELS,
    GroundTruth,
    build_world,
)
from .satellites import (
    TWO_CONSTELLATIONS,
    CircularConstellation,
    CombinedConstellation,
    Constellation,
)
from .sensors import IMU_GRADES
from .skies import Rules, Skies

_OF_WORLD = (  # settings that a world depends on
    *("flight", "constellation", "epoch_interval_s", "channels", "mask_deg"),
    *("turned_deg", "imu_rate_hz"),
)
TURN_ON = ("specimen", "drawn")  # inertial constants: of the data sheet, or drawn per episode
IN_RUN = ("constant", "wandering")  # biases of inertial sensors during an episode


@settings_record(frozen=True, kw_only=True)
class Scenario:
    """The authentic world of an episode, as a recipe.

    Notes
    -----
    At a lower `imu_rate_hz` a step costs less.  Velocity and attitude are the flight's at the
    remaining samples, its position is their integral again (millimetres apart), and the true
    specific force and angular rate over each longer sample are those from which the receiver's
    mechanization gets there, so that coning and sculling leave no error.  Sensor errors are those
    of a sensor whose increments are summed up: the same biases, scale factors and noise densities,
    and quantization of the same increments, whose level on a longer sample is the smaller in
    proportion.
    """

    name: str = setting(default="custom", help="Name that results show.")
    flight: str | Flight = setting(default="zhong2025", help="A name in `FLIGHTS`, or a flight.")
    errors: str | GnssErrors = setting(default="zhong2025", help="A name in `ERRORS`, or errors.")
    imu: str = setting(
        default="aviation", help="Grade of the inertial sensors, a name in `IMU_GRADES`."
    )
    constellation: Constellation = setting(
        default_factory=CircularConstellation, help="The satellites."
    )
    epoch_interval_s: float = setting(
        default=0.5,
        above=0.0,
        unit="s",
        help="Time between epochs, a multiple of the interval between inertial samples.",
    )
    channels: int = setting(
        default=CHANNELS,
        least=FEWEST_CHANNELS,
        most=MOST_CHANNELS,
        help="Number of slots for satellites.",
    )
    mask_deg: float = setting(
        default=MASK_DEG,
        least=0.0,
        most=HIGHEST_MASK_DEG,
        unit="deg",
        help="Least elevation of a satellite that the receiver uses.",
    )
    turned_deg: float = setting(
        default=0.0,
        unit="deg",
        help="Turn of the whole flight about the vertical where it begins, clockwise.",
    )
    imu_rate_hz: float | None = setting(
        default=None,
        above=0.0,
        omitted=True,
        unit="Hz",
        help="Samples of the inertial sensors that the receiver gets per second; None for the "
        "flight's own rate.",
    )
    assumed: str | GnssErrors | None = setting(
        default=None,
        omitted=True,
        help='Errors that a receiver with the tuning ``"matched"`` assumes, a name or errors; '
        "None for those that the world has.",
    )
    turn_on: str = setting(
        default="specimen",
        one_of=TURN_ON,
        omitted=True,
        help="Inertial sensors with the constants of the grade's data sheet, or with others in "
        "every episode, as large in the mean.",
    )
    in_run: str = setting(
        default="constant",
        one_of=IN_RUN,
        omitted=True,
        help="Biases of the inertial sensors that stay the same for an episode, or that wander by "
        "the in-run instability of their grade.",
    )
    events: BenignEvents | None = setting(
        default=None, omitted=True, help="Events that only look like spoofing; None for no events."
    )

    def __post_init__(self) -> None:
        if isinstance(self.flight, str):
            check_choice("flight", self.flight, FLIGHTS)
        if isinstance(self.errors, str):
            check_choice("errors", self.errors, ERRORS)
        if isinstance(self.assumed, str):
            check_choice("assumed errors", self.assumed, ERRORS)
        check_choice("imu grade", self.imu, IMU_GRADES)
        if isinstance(self.events, Mapping):
            object.__setattr__(self, "events", build_record("events", BenignEvents, self.events))
        events = self.events is None or isinstance(self.events, BenignEvents)
        require(events, f"`events` must be settings of events or None, got {self.events!r}")

    @property
    def label(self) -> str:
        """Name for results, with the rate of the inertial sensors where that is not the flight's.

        Examples
        --------
        >>> from spoofgym.truth.scenario import make_scenario
        >>> make_scenario({"name": "zhong2025", "imu_rate_hz": 20}).label
        'zhong2025@20Hz'
        """
        return at_rate(self.name, self.imu_rate_hz)

    @property
    def gnss_errors(self) -> GnssErrors:
        return ERRORS[self.errors] if isinstance(self.errors, str) else self.errors

    @property
    def assumed_errors(self) -> GnssErrors:
        if self.assumed is None:
            return self.gnss_errors
        return ERRORS[self.assumed] if isinstance(self.assumed, str) else self.assumed

    def world(self) -> GroundTruth:
        if isinstance(self.flight, str) and _is_analytic(self.constellation):
            return _named_world(self.bare)
        return self.chained_world([(0.0, self.constellation)])

    @property
    def bare(self) -> Scenario:
        """Scenario with nothing but what its world depends on."""
        return Scenario(name="", **{name: getattr(self, name) for name in _OF_WORLD})

    def chained_world(self, skies: Sequence[tuple[float, Constellation]]) -> GroundTruth:
        """Worlds of the flight under some skies, one after the other: `Skies`, or the only one.
        `skies`: turn of the flight, on top of `turned_deg` [deg], and satellites of each."""
        headings = partial(_steer, self.flight, self.imu_rate_hz, self.epoch_interval_s)
        rules = Rules(self.epoch_interval_s, self.channels, self.mask_deg)
        places = [(math.radians(self.turned_deg + turn), each) for turn, each in skies]
        if len(places) > 1:
            return Skies(headings, places, rules)
        ((angle, constellation),) = places
        return build_world(headings().trajectory(angle), constellation, **rules._asdict())


def _steer(flight: str | Flight, imu_rate_hz: float | None, epoch_interval_s: float) -> Headings:
    """Headings of a flight; those of the package's own with fewer samples are computed once, since
    a flight of hours takes seconds."""
    make = FLIGHTS[flight] if isinstance(flight, str) else lambda: flight
    rates = imu_rate_hz, epoch_interval_s
    if imu_rate_hz is None or getattr(make, "__module__", "") != terminal.__module__:
        return Headings.sample(make(), *rates)

    def fly() -> dict[str, Any]:
        found = Headings.sample(make(), *rates)
        return {name: np.asarray(x) for name, x in vars(found).items() if name != "whole"}

    name = f"{flight}-{imu_rate_hz:g}Hz-{epoch_interval_s:g}s"
    stored: dict[str, Any] = recall_arrays(__name__, name, fly)
    stored |= {name: stored[name].item() for name in ("name", "step", "count")}
    return Headings(**stored)


def at_rate(name: str, imu_rate_hz: float | None) -> str:
    return name if imu_rate_hz is None else f"{name}@{imu_rate_hz:g}Hz"


def _is_analytic(
    constellation: Constellation,
) -> TypeGuard[CircularConstellation | CombinedConstellation]:
    """Whether a constellation is made of circular ones alone, so that equal ones are one."""
    if isinstance(constellation, CombinedConstellation):
        return all(map(_is_analytic, constellation.parts))
    return isinstance(constellation, CircularConstellation)


@lru_cache(maxsize=8)
def _named_world(scenario: Scenario) -> GroundTruth:
    return scenario.chained_world([(0.0, scenario.constellation)])


_AVIATION: dict[str, Any] = {
    "flight": "approach",
    "assumed": "aviation-overbound",
    "imu": "tactical",
    "turn_on": "drawn",
    "events": BenignEvents(clock_step=0.1, satellite_loss=0.1, front=0.1),
}
_KE2022: dict[str, Any] = {"flight": "ke2022", "epoch_interval_s": 1.0}
_PRESETS: dict[str, dict[str, Any]] = {
    "zhong2025": {},
    "zhong2025-white": {"errors": "white"},
    "zhong2025-tactical": {"imu": "tactical"},
    "zhong2025-consumer": {"imu": "consumer"},
    "groves": {"errors": "groves"},
    "trolley": {"errors": "trolley"},
    "trolley-tactical": {"errors": "trolley", "imu": "tactical"},
    "trolley-consumer": {"errors": "trolley", "imu": "consumer"},
    "trolley-two-constellations": {
        "errors": "trolley",
        "constellation": TWO_CONSTELLATIONS,
        "channels": 24,
    },
    "aviation-actual": {"errors": "aviation-actual", **_AVIATION},
    "aviation-overbound": {"errors": "aviation-overbound", **_AVIATION},
    "ke2022": {"errors": "ke2022", **_KE2022},
    "ke2022-white": {"errors": "white", **_KE2022},
}
SCENARIOS: dict[str, Callable[[], Scenario]] = {
    name: partial(Scenario, name=name, **settings) for name, settings in _PRESETS.items()
}
"""Scenarios by name: the flight of `zhong2025` under the errors and grades that they name, also
with a second constellation whose ids begin with E, and that of `ke2022` at 1 Hz, with the satellite
biases of its errors and without; and an approach with tactical sensors whose constants are drawn,
under errors of airborne signals: in `aviation-actual` they are what happens, in
`aviation-overbound` what a receiver has to assume, which the matched one does in both."""


def make_scenario(spec: str | Mapping[str, Any] | Scenario) -> Scenario:
    """Scenario by name, or by name with some settings replaced.

    Examples
    --------
    >>> from spoofgym.truth.scenario import make_scenario
    >>> make_scenario({"name": "zhong2025", "imu": "tactical"}).imu
    'tactical'
    """
    if isinstance(spec, Scenario):
        return spec
    if isinstance(spec, str):
        spec = {"name": spec}
    if not isinstance(spec, Mapping):
        raise TypeError(
            f"a scenario is a name ({', '.join(sorted(SCENARIOS))}), a dict or a Scenario, "
            f"got {spec!r}"
        )
    settings = dict(spec)
    name = settings.pop("name", "zhong2025")
    check_choice("scenario", name, SCENARIOS)
    valid = [item.name for item in fields(Scenario) if item.name != "name"]
    for key in settings:
        require(key in valid, f"a scenario has no setting {key!r}; valid: {', '.join(valid)}")
    scenario = SCENARIOS[name]()
    named = sorted(settings.keys() - {"imu_rate_hz"})  # which is in the label
    changed = "".join(f" {key}={settings[key]}" for key in named)
    return replace(scenario, name=f"{scenario.name}{changed}", **settings)
