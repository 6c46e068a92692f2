"""A drive that a receiver records: RINEX observations, orbits, and a table of inertial samples."""

from dataclasses import replace
from datetime import timedelta
from typing import NamedTuple

import numpy as np

from spoofgym.data.ephemerides import GPS_EPOCH, Ephemerides, gps_seconds, propagate_orbits
from spoofgym.earth.wgs84 import (
    EARTH_RATE,
    SPEED_OF_LIGHT,
    STANDARD_GRAVITY,
    dcm_e_from_n,
    ecef_to_geodetic,
    look_angles,
)
from spoofgym.receiver.raw_measurements import compute_saastamoinen
from spoofgym.truth.flight import Flight, inverse_kinematics
from spoofgym.truth.manoeuvres import Accelerate, Steer, Straight, fly

from .files import make_orbits

WAVE = SPEED_OF_LIGHT / 1575.42e6
BIAS_M, DRIFT_MPS, STEP_AT_S = 60_000.0, 30.0, 30.0
"""Of the receiver's clock, which is put right by a millisecond once."""
GALILEO_OFFSET_M = 25.0
RANGE_SD, RATE_SD = 1.0, 0.05
MAPPING = """\
[time]
column = "stamp"
unit = "ms"
scale = "unix"
[specific_force]
columns = ["ay", "-ax", "az"]
unit = "g"
[angular_rate]
columns = ["gy", "-gx", "gz"]
unit = "deg/s"
"""


class Drive(NamedTuple):
    """What is true: motion, epochs (K,) after the start, ranges and their rates (K, n)."""

    flight: Flight
    start: float
    orbits: Ephemerides
    times: np.ndarray
    satellites: list[str]
    ranges: np.ndarray
    rates: np.ndarray

    def at(self, name):
        """(K, 3) of the flight at the epochs."""
        values = getattr(self.flight, name)
        return np.stack([np.interp(self.times, self.flight.time, x) for x in values.T], axis=1)


def make_drive(moment):
    """A car at epochs that are not those of its samples, under satellites of GPS and Galileo."""
    course = [Straight(15.0), Steer(90.0), Accelerate(4.0), Straight(30.0)]
    place = {"latitude_deg": 47.0, "longitude_deg": 8.0, "height_m": 400.0}
    flight = inverse_kinematics(fly(course, **place, speed_mps=12.0, heading_deg=40.0))
    orbits = make_orbits(moment - timedelta(hours=1), moment + timedelta(hours=2), 48)
    galileo = np.char.replace(orbits.satellite_id, "G", "E")
    orbits = replace(
        orbits,
        satellite_id=np.where(galileo > "E24", galileo, orbits.satellite_id),
        clock_bias=np.full(len(orbits), 3e-5),
        clock_drift=np.full(len(orbits), 1e-10),
        group_delay=np.full(len(orbits), 4e-9),
    )
    times = np.arange(0.3337, flight.time[-1], 0.25)
    drive = Drive(flight, gps_seconds(moment), orbits, times, [], np.zeros(0), np.zeros(0))
    names, ranges, rates = orbits.satellite_ids, [], []
    for name in names:
        middle, place = _compute_ranges(drive, name, 0.0)
        before, after = (_compute_ranges(drive, name, t)[0] for t in (-0.05, 0.05))
        r = drive.at("position_e")
        latitude, longitude, height = ecef_to_geodetic(r)
        elevation = look_angles(place[:, None], r, dcm_e_from_n(latitude, longitude))[0][:, 0]
        middle = middle + compute_saastamoinen(elevation, latitude, height)
        ranges.append(np.where(elevation > np.radians(5.0), middle, np.nan))
        rates.append((after - before) / 0.1)
    seen = [j for j in range(len(names)) if np.isfinite(ranges[j]).all()]
    return drive._replace(
        satellites=[names[j] for j in seen],
        ranges=np.stack([ranges[j] for j in seen], axis=1),
        rates=np.stack([rates[j] for j in seen], axis=1),
    )


def _compute_ranges(drive, name, after):
    """Pseudoranges by a clock that is right, a little after the epochs, by exact turns of the axes;
    and (K, 3) where the satellite was."""
    e, r = drive.orbits, drive.at("position_e") + after * drive.at("velocity_e")
    time = drive.start + drive.times + after
    own = np.flatnonzero(e.satellite_id == name)
    record = own[np.abs(e.time_of_ephemeris[own] - time[0]).argmin()]
    travel = np.full(time.shape, 0.07)
    for _ in range(4):
        states = propagate_orbits(
            e, np.full(time.shape, record), time - travel - e.time_of_ephemeris[record]
        )
        angle, (x, y, z) = EARTH_RATE * travel, states.position_e.T
        turned = [np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x, z]
        travel = np.linalg.norm(np.stack(turned, axis=1) - r, axis=1) / SPEED_OF_LIGHT
    clock = e.clock_bias[record] - e.group_delay[record]
    clock = clock + e.clock_drift[record] * (time - travel - e.time_of_clock[record])
    clock -= 2.0 * (states.position_e * states.velocity_e).sum(axis=1) / SPEED_OF_LIGHT**2
    return SPEED_OF_LIGHT * (travel - clock), states.position_e


def write_observations(path, drive, version=3, ends="\n"):
    """RINEX with GPS and, in version 3, Galileo."""
    rng = np.random.default_rng(0)
    label, types = "SYS / # / OBS TYPES", ["G    4 C1C L1C D1C S1C", "E    4 C1C L1C D1C S1C"]
    if version == 2:
        label, types = "# / TYPES OF OBSERV", ["     6    C1    L1    L2    P2    S1    D1"]
    head = f"{version + 0.11:9.2f}           OBSERVATION DATA    M"
    lines = [f"{head:60}RINEX VERSION / TYPE", *(f"{x:60}{label}" for x in types)]
    lines.append(f"{'':60}END OF HEADER")
    names = [x for x in drive.satellites if version == 3 or x[0] == "G"]
    for k, time in enumerate(drive.times):
        bias = BIAS_M + DRIFT_MPS * time - 1e-3 * SPEED_OF_LIGHT * (time > STEP_AT_S)
        moment = drive.start + time + bias / SPEED_OF_LIGHT
        date = GPS_EPOCH + timedelta(seconds=int(moment))
        stamp = f"{date:%m %d %H %M} {date.second + moment % 1.0:10.7f}  0{len(names):3d}"
        if version == 2:
            lines.append(f" {date:%y} {stamp}{''.join(names[:12])}")
            lines += [f"{'':32}{''.join(names[12:])}"] if names[12:] else []
        else:
            lines.append(f"> {date:%Y} {stamp}")
        for name in names:
            j = drive.satellites.index(name)
            length = drive.ranges[k, j] + bias + GALILEO_OFFSET_M * (name[0] == "E")
            length += rng.normal(0.0, RANGE_SD)
            shift = -(drive.rates[k, j] + DRIFT_MPS + rng.normal(0.0, RATE_SD)) / WAVE
            values = [f"{length:14.3f}  ", f"{shift:14.3f}  "]
            if version == 2:
                lines += [f"{values[0]}{'':48}{45.0:14.3f}", values[1]]
            else:
                lines.append(f"{name}{values[0]}{'':16}{values[1]}{45.0:14.3f}")
    path.write_bytes(ends.join([*lines, ""]).encode())
    return path


def write_inertial(path, drive):
    """CSV of a sensor that is turned by 90 degrees, with constant errors, and stamps in UTC."""
    rng, flight = np.random.default_rng(1), drive.flight
    force = flight.specific_force_b / STANDARD_GRAVITY + rng.normal(0.0, 1e-3)
    turn = np.degrees(flight.angular_rate_b) + rng.normal(0.0, 0.02)
    by_sensor = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    stamp = 1e3 * (drive.start + flight.time[1:] + 315_964_800.0 - 18.0)
    table = np.hstack([stamp[:, None], force @ by_sensor.T, turn @ by_sensor.T])
    np.savetxt(path, table, "%.15g", ",", header="stamp,ax,ay,az,gx,gy,gz", comments="")
    return path
