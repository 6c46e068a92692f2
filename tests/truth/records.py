"""Broadcast records of one made-up orbit, for the tests of what reads and screens them."""

from dataclasses import fields, replace
from datetime import datetime

import numpy as np

from spoofgym.data.ephemerides import (
    GPS_EARTH_RATE,
    GPS_GRAVITATIONAL_CONSTANT,
    SECONDS_PER_WEEK,
    Ephemerides,
    gps_seconds,
    join_ephemerides,
)

HOUR = 3600.0
SATURDAY_22 = gps_seconds(datetime(2024, 9, 14, 22))
ORBIT = {
    "root_semi_major_axis": 5153.7,
    "eccentricity": 0.012,
    "mean_anomaly": 0.7,
    "mean_motion_correction": 4.6e-9,
    "perigee": -1.9,
    "node": 2.3,
    "node_rate": -8.1e-9,
    "inclination": 0.965,
    "inclination_rate": 2.0e-10,
    "cuc": -4.0e-6,
    "cus": 5.5e-6,
    "cic": 3.0e-8,
    "cis": -9.0e-8,
    "crc": 275.0,
    "crs": -90.0,
}


def one_record(satellite="G05", toe=SATURDAY_22, /, **changes):
    values = dict.fromkeys((field.name for field in fields(Ephemerides)), 0.0)
    values |= ORBIT | {"time_of_clock": toe, "time_of_ephemeris": toe} | changes
    columns = {name: np.array([value]) for name, value in values.items()}
    return Ephemerides(**columns | {"satellite_id": np.array([satellite])})


def joined(*records):
    return join_ephemerides(records)


def later(record, by, **changes):
    e = record
    week = SECONDS_PER_WEEK
    toe = e.time_of_ephemeris + by
    n = np.sqrt(GPS_GRAVITATIONAL_CONSTANT / e.root_semi_major_axis**6) + e.mean_motion_correction
    turned = GPS_EARTH_RATE * (toe % week - e.time_of_ephemeris % week - by)
    moved = replace(
        e,
        time_of_ephemeris=toe,
        time_of_clock=toe,
        issue=e.issue + by,
        mean_anomaly=e.mean_anomaly + n * by,
        node=e.node + e.node_rate * by + turned,
        inclination=e.inclination + e.inclination_rate * by,
    )
    return replace(moved, **{k: getattr(moved, k) + v for k, v in changes.items()})


def chain(*wrong_m, interval=2.0 * HOUR):
    """Records of one satellite, each with the along-track error given [m]."""
    first = one_record()
    radius = ORBIT["root_semi_major_axis"] ** 2
    errors = [error / radius for error in wrong_m]
    return joined(*(later(first, k * interval, mean_anomaly=e) for k, e in enumerate(errors)))
