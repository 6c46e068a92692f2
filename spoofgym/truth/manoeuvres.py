"""Flights made of manoeuvres: straight stretches, turns, climbs, changes of speed.

Every manoeuvre is a pulse of one rate (turn rate, climb rate or acceleration) that rises and
falls as a raised cosine, so that attitude and specific force have no steps and the change of
heading, height or speed comes out exactly.  Yaw lies along the velocity and pitch is the
flight-path angle; wind, angle of attack and the effect of the Earth's rotation on the bank angle
are left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from ..core.declared import check_number, setting, settings_record
from ..core.registry import require
from ..earth.wgs84 import STANDARD_GRAVITY
from .flight import Flight, flight_from_velocity


@dataclass(frozen=True)
class Pulse:
    """A rate that rises, holds and falls, with raised-cosine edges. `ramp`: duration of each edge
    [s]; `hold`: duration between them [s]."""

    peak: float
    ramp: float
    hold: float

    @classmethod
    def of_area(cls, area: float, peak: float, ramp: float) -> Pulse:
        """Pulse of a given integral; its peak is lowered when the edges alone are too much. `ramp`:
        duration of each edge [s]."""
        hold = max(0.0, abs(area) / peak - ramp)
        return cls(area / (ramp + hold), ramp, hold)

    @classmethod
    def idle(cls, duration: float) -> Pulse:
        return cls(0.0, 0.0, duration)

    @property
    def duration(self) -> float:
        return 2.0 * self.ramp + self.hold

    def rate(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        inside = np.clip(np.minimum(time, self.duration - time), 0.0, self.ramp)
        return self.peak * 0.5 * (1.0 - np.cos(np.pi * inside / self.ramp))

    def total(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.peak * (self._edge(time) - self._edge(time - self.ramp - self.hold))

    def _edge(self, time: NDArray[np.float64]) -> NDArray[np.float64]:
        """Integral of a rise from 0 to 1 that stays there. `time` (N,) rises."""
        inside = np.clip(time, 0.0, self.ramp)
        end = np.searchsorted(time, self.ramp) + 1  # the sine stays as it is from there on
        swing = self.ramp / (2.0 * np.pi) * np.sin(np.pi * inside[:end] / self.ramp)
        value = 0.5 * inside
        value[:end] -= swing
        value[end:] -= swing[-1]
        return value + np.maximum(time - self.ramp, 0.0)


Axis = Literal["none", "turn", "steer", "climb", "speed"]


def ramp_setting(default: float, help: str) -> Any:
    return setting(default=default, above=0.0, unit="s", help=help)


STEEPEST_BANK_DEG = 75.0  # largest bank of a turn [deg], 3.9 g
STEEPEST_PATH_DEG = 60.0  # largest flight-path angle of a climb [deg]


class Manoeuvre(Protocol):
    """What `fly` needs of a manoeuvre: the axis it acts on, and its pulse."""

    axis: ClassVar[Axis]

    def pulse(self, speed: float, start: float) -> Pulse:
        """Pulse of rate on the axis, entered with a speed [m/s] at a time of the flight [s]."""


@settings_record(frozen=True)
class Straight:
    """Straight and level motion for a while."""

    axis: ClassVar[Axis] = "none"
    duration_s: float = setting(above=0.0, unit="s", help="Duration.")

    def pulse(self, speed: float, start: float) -> Pulse:
        return Pulse.idle(self.duration_s)


@settings_record(frozen=True)
class Until:
    """Straight and level motion until a time of the flight."""

    axis: ClassVar[Axis] = "none"
    time_s: float = setting(above=0.0, unit="s", help="Time since the start of the flight.")

    def pulse(self, speed: float, start: float) -> Pulse:
        require(
            self.time_s >= start,
            f"`time_s` must not lie before the end of the previous manoeuvre, {start:g} s, "
            f"got {self.time_s:g} s",
        )
        return Pulse.idle(self.time_s - start)


@settings_record(frozen=True)
class Turn:
    r"""A coordinated level turn: no lateral specific force.

    .. math::
        \tan\phi = v\,\dot\psi / g
    """

    axis: ClassVar[Axis] = "turn"
    angle_deg: float = setting(unit="deg", help="Change of heading, positive to the right.")
    bank_deg: float = setting(
        default=25.0,
        above=0.0,
        below=STEEPEST_BANK_DEG,
        unit="deg",
        help="Largest bank, positive in either direction.",
    )
    ramp_s: float = ramp_setting(
        5.0, "Time to roll in and to roll out; the roll rate stays below tan(bank) pi / (2 ramp)."
    )

    def pulse(self, speed: float, start: float) -> Pulse:
        require(speed > 0.0, f"a banked turn needs a speed above 0 m/s, got {speed:g} m/s")
        peak = STANDARD_GRAVITY * math.tan(math.radians(self.bank_deg)) / speed
        return Pulse.of_area(math.radians(self.angle_deg), peak, self.ramp_s)


@settings_record(frozen=True)
class Steer:
    """A turn on wheels, without bank."""

    axis: ClassVar[Axis] = "steer"
    angle_deg: float = setting(unit="deg", help="Change of heading, positive to the right.")
    rate_degps: float = setting(
        default=7.0,
        above=0.0,
        unit="deg/s",
        help="Largest turn rate, positive in either direction.",
    )
    ramp_s: float = ramp_setting(1.0, "Time to turn the wheel in and back.")

    def pulse(self, speed: float, start: float) -> Pulse:
        peak = math.radians(self.rate_degps)
        return Pulse.of_area(math.radians(self.angle_deg), peak, self.ramp_s)


@settings_record(frozen=True)
class Climb:
    """A change of height at constant speed along the path."""

    axis: ClassVar[Axis] = "climb"
    height_m: float = setting(unit="m", help="Change of height, negative to descend.")
    rate_mps: float = setting(
        default=10.0,
        above=0.0,
        unit="m/s",
        help="Largest vertical speed, positive in either direction.",
    )
    ramp_s: float = ramp_setting(
        10.0,
        "Time to pull up and to level off; the change of the normal acceleration stays below about "
        "rate pi / (2 ramp).",
    )

    def pulse(self, speed: float, start: float) -> Pulse:
        steepest = speed * math.sin(math.radians(STEEPEST_PATH_DEG))
        require(
            self.rate_mps <= steepest,
            f"`rate_mps` must be at most {steepest:.3g} m/s at a speed of {speed:g} m/s "
            f"({STEEPEST_PATH_DEG:g} deg), got {self.rate_mps:g} m/s",
        )
        return Pulse.of_area(self.height_m, self.rate_mps, self.ramp_s)


@settings_record(frozen=True)
class Accelerate:
    """A change of speed on a straight and level path."""

    axis: ClassVar[Axis] = "speed"
    change_mps: float = setting(unit="m/s", help="Change of speed, negative to slow down.")
    acceleration_mps2: float = setting(
        default=1.0,
        above=0.0,
        unit="m/s^2",
        help="Largest acceleration, positive in either direction.",
    )
    ramp_s: float = ramp_setting(2.0, "Time for the acceleration to set in and to cease.")

    def pulse(self, speed: float, start: float) -> Pulse:
        if speed + self.change_mps < -1e-9:
            raise ValueError(
                f"`change_mps` must be at least {-speed:g} m/s at this speed, "
                f"got {self.change_mps:g} m/s"
            )
        return Pulse.of_area(self.change_mps, self.acceleration_mps2, self.ramp_s)


def fly(
    manoeuvres: Sequence[Manoeuvre],
    *,
    latitude_deg: float,
    longitude_deg: float,
    height_m: float,
    speed_mps: float,
    heading_deg: float,
    rate_hz: float = 100.0,
    name: str = "flight",
) -> Flight:
    """Flight that carries out manoeuvres one after the other.

    `manoeuvres`: manoeuvres in the order of time; `latitude_deg`, `longitude_deg`, `height_m`:
    start: geodetic latitude and longitude [deg], height above the ellipsoid [m]; `speed_mps`: speed
    at the start, along the path [m/s]; `heading_deg`: heading at the start, clockwise from north
    [deg]; `rate_hz`: samples a second [Hz].
    """
    check_number("latitude_deg", latitude_deg, above=-90.0, below=90.0)
    check_number("longitude_deg", longitude_deg)
    check_number("rate_hz", rate_hz, above=0.0)
    check_number("speed_mps", speed_mps, least=0.0)
    require(manoeuvres, "`manoeuvres` must have at least one manoeuvre, got none")
    pulses = _chain(manoeuvres, speed_mps)
    last = pulses[-1]
    time = np.arange(int((last.start + last.pulse.duration) * rate_hz + 1e-6) + 1) / rate_hz
    speed = speed_mps + _sum(pulses, ["speed"], time, total=True)
    heading = math.radians(heading_deg) + _sum(pulses, ["turn", "steer"], time, total=True)
    climb = _sum(pulses, ["climb"], time)
    path = np.arcsin(climb / np.where(climb == 0.0, 1.0, speed))
    roll = np.arctan(speed * _sum(pulses, ["turn"], time) / STANDARD_GRAVITY)
    horizontal = speed * np.cos(path)
    velocity_n = np.stack(
        [horizontal * np.cos(heading), horizontal * np.sin(heading), -climb], axis=-1
    )
    return flight_from_velocity(
        name,
        math.radians(latitude_deg),
        math.radians(longitude_deg),
        height_m,
        velocity_n,
        roll,
        path,
        heading,
        1.0 / rate_hz,
    )


@dataclass(frozen=True)
class _Placed:
    axis: Axis
    start: float
    pulse: Pulse


def _chain(manoeuvres: Sequence[Manoeuvre], speed: float) -> list[_Placed]:
    placed = []
    start = 0.0
    for manoeuvre in manoeuvres:
        pulse = manoeuvre.pulse(speed, start)
        placed.append(_Placed(manoeuvre.axis, start, pulse))
        start += pulse.duration
        if manoeuvre.axis == "speed":
            speed = max(0.0, speed + pulse.peak * (pulse.ramp + pulse.hold))
    return placed


def _sum(
    placed: Sequence[_Placed], axes: Sequence[Axis], time: NDArray[np.float64], total: bool = False
) -> NDArray[np.float64]:
    value = np.zeros_like(time)
    for item in placed:
        if item.axis in axes:
            first = np.searchsorted(time, item.start)
            last = np.searchsorted(time, item.start + item.pulse.duration) + 2
            part = slice(first, None if total else last)  # elsewhere it is 0
            local = time[part] - item.start
            value[part] += item.pulse.total(local) if total else item.pulse.rate(local)
    return value


_CRUISE: dict[str, float] = {
    "latitude_deg": 50.425,
    "longitude_deg": -3.5958,
    "height_m": 10000.0,
    "speed_mps": 200.0,
    "heading_deg": 90.0,
}
_TURNS: tuple[Manoeuvre, Manoeuvre] = (
    Turn(45.0, bank_deg=14.04, ramp_s=4.0),
    Turn(-45.0, bank_deg=14.04, ramp_s=4.0),
)
_CLIMB = Climb(500.0, rate_mps=20.0, ramp_s=11.0)


def zhong2025() -> Flight:
    """Flight of zhong2025: 418 s at 200 m/s, two turns of 45 deg and a climb of 500 m. Its own
    equivalent of the aircraft profile of Groves' software: the manoeuvres lie on the same middles
    in time, with smooth edges where the profile's bank has steps."""
    right, left = _TURNS
    turns: list[Manoeuvre] = [Until(18.0), right, Until(112.3), left]
    return fly([*turns, Until(207.0), _CLIMB, Until(418.0)], **_CRUISE, name="zhong2025")


def car() -> Flight:
    """Drive of 60 s, after the car profile of Groves' software. From a standstill to 20 m/s
    northwards, right by 90 deg, up a ramp, left by 90 deg, and to a stop."""
    return fly(
        [
            Until(1.0),
            Accelerate(20.0, acceleration_mps2=3.0, ramp_s=1.5),
            Until(14.0),
            Steer(90.0, rate_degps=7.5, ramp_s=1.0),
            Climb(3.0, rate_mps=0.8, ramp_s=2.0),
            Until(33.5),
            Steer(-90.0, rate_degps=7.5, ramp_s=1.0),
            Until(50.0),
            Accelerate(-20.0, acceleration_mps2=3.0, ramp_s=1.5),
            Until(60.0),
        ],
        latitude_deg=51.0,
        longitude_deg=0.0,
        height_m=10.0,
        speed_mps=0.0,
        heading_deg=0.0,
        name="car",
    )


def ke2022() -> Flight:
    """Flight of ke2022: 746 s at 200 m/s, two turns of 45 deg and two climbs of 500 m. The paper
    gives the duration, the speed, the two turns and that there are climbs, but not when they come.
    Here one climb lies before the attack at 350 to 550 s and one after it."""
    right, left = _TURNS
    turns: list[Manoeuvre] = [Until(60.0), right, Until(180.0), left]
    legs = [*turns, Until(280.0), _CLIMB, Until(600.0), _CLIMB, Until(746.0)]
    return fly(legs, **_CRUISE, name="ke2022")


def shadmehri2025() -> Flight:
    """Flight of shadmehri2025: an airliner for a minute, 200 m/s eastwards and 50 m/s northwards.
    The paper takes a recorded flight that it does not name, and gives these two velocities and the
    rate of the inertial sensors, 160 Hz. Here the manoeuvres are mild: 6 deg to the right, a climb
    of 30 m, and 6 deg back, which ends after the paper's onset at 20 s."""
    return fly(
        [
            Until(2.0),
            Turn(6.0, bank_deg=12.0, ramp_s=3.0),
            Climb(30.0, rate_mps=6.0, ramp_s=4.0),
            Turn(-6.0, bank_deg=12.0, ramp_s=3.0),
            Until(60.0),
        ],
        latitude_deg=35.7,
        longitude_deg=51.4,
        height_m=3000.0,
        speed_mps=math.hypot(200.0, 50.0),
        heading_deg=math.degrees(math.atan2(200.0, 50.0)),
        rate_hz=160.0,
        name="shadmehri2025",
    )


def airway() -> Flight:
    """Flight of 40 minutes along an airway: 200 m/s, a turn or a change of level every few minutes.
    No paper's flight: for attacks of half an hour. Turns are of 20 to 40 deg at standard rate or
    less, levels change by 1000 ft and 2000 ft."""
    legs: list[Manoeuvre] = []
    for k, (turn, climb) in enumerate(
        [(30.0, 0.0), (-40.0, 304.8), (0.0, 609.6), (20.0, 0.0), (-30.0, -304.8), (40.0, 0.0)]
    ):
        legs.append(Until(400.0 * k + 120.0))
        if turn:
            legs.append(Turn(turn, bank_deg=20.0, ramp_s=4.0))
        if climb:
            legs.append(Until(400.0 * k + 260.0))
            legs.append(Climb(climb, rate_mps=7.6, ramp_s=8.0))
    legs.append(Until(2400.0))
    return fly(legs, **_CRUISE, name="airway")


def approach() -> Flight:
    """Flight of ten minutes that ends on an approach: downwind, two turns, down the glide path. No
    paper's flight. A jet flies downwind at 90 m/s and 1500 m, descends by 300 m, turns left by 90
    deg onto base at 230 s and again onto final at 275 s, slows down to 75 m/s, and goes down a path
    of 3 deg to 300 m: an attack of 150 s after a warm-up of 200 s meets both turns."""
    return fly(
        [
            Until(100.0),
            Climb(-300.0, rate_mps=6.0, ramp_s=6.0),
            Until(230.0),
            Turn(-90.0, bank_deg=25.0, ramp_s=5.0),
            Until(275.0),
            Turn(-90.0, bank_deg=25.0, ramp_s=5.0),
            Accelerate(-15.0, acceleration_mps2=1.0, ramp_s=3.0),
            Until(335.0),
            Climb(-900.0, rate_mps=3.9, ramp_s=8.0),
            Until(600.0),
        ],
        latitude_deg=50.70,
        longitude_deg=-3.60,
        height_m=1500.0,
        speed_mps=90.0,
        heading_deg=80.0,
        name="approach",
    )


LONG_S = 9060.0  # an onset two hours after switch-on, and half an hour of attack


def en_route(rate_hz: float = 100.0) -> Flight:
    """Flight of 2 h 31 min en route: 200 m/s, a turn or a change of level every 400 s. No paper's
    flight: for attacks of half an hour whose onset comes up to two hours after switch-on. Turns are
    of 20 to 40 deg at less than standard rate, levels change by 1000 ft and 2000 ft; of ten
    manoeuvres, headings and levels come back to where they began."""
    cycle: list[Manoeuvre] = []
    for turn, height in ((30.0, 609.6), (-40.0, -304.8), (20.0, 304.8), (-30.0, -609.6)):
        cycle += [Turn(turn, bank_deg=20.0, ramp_s=4.0), Climb(height, rate_mps=7.6, ramp_s=8.0)]
    cycle += [Turn(40.0, bank_deg=20.0, ramp_s=4.0), Turn(-20.0, bank_deg=20.0, ramp_s=4.0)]
    legs: list[Manoeuvre] = []
    for k in range(23):
        legs += [Until(400.0 * k + 100.0), cycle[k % len(cycle)]]
    return fly([*legs, Until(LONG_S)], **_CRUISE, rate_hz=rate_hz, name="en-route")


def terminal(rate_hz: float = 100.0) -> Flight:
    """Flight of 2 h 31 min in a terminal area: holding, down level by level and up again. No
    paper's flight: for attacks of some minutes whose onset comes up to two hours after switch-on. A
    jet flies right-hand laps of 5 min at 110 m/s, two turns of 180 deg at 25 deg of bank with a
    minute between them, and changes level on the way in: eight laps down by 1000 ft each, four up
    by 2000 ft, and so on, so that at most a minute is straight and level."""
    legs: list[Manoeuvre] = []
    for lap in range(30):
        height, rate = (-304.8, 6.0) if lap % 12 < 8 else (609.6, 12.0)
        half = Turn(180.0, bank_deg=25.0, ramp_s=5.0)
        climb = Climb(height, rate_mps=rate, ramp_s=6.0)
        legs += [Until(300.0 * lap + 10.0), half, Straight(60.0), half, climb]
    return fly(
        [*legs, Until(LONG_S)],
        latitude_deg=50.70,
        longitude_deg=-3.60,
        height_m=3600.0,
        speed_mps=110.0,
        heading_deg=80.0,
        rate_hz=rate_hz,
        name="terminal",
    )


FLIGHTS: dict[str, Callable[[], Flight]] = {  # the ready-made flights by name
    "airway": airway,
    "approach": approach,
    "car": car,
    "en-route": en_route,
    "ke2022": ke2022,
    "shadmehri2025": shadmehri2025,
    "terminal": terminal,
    "zhong2025": zhong2025,
}
