"""Made-up input files: a day of broadcast orbits, and one flight as every service writes it."""

from dataclasses import replace

import numpy as np
import pandas

from spoofgym.data.ephemerides import GPS_EPOCH, gps_seconds, join_ephemerides
from spoofgym.data.rinex import FIELDS
from spoofgym.data.tracks import FOOT, KNOT
from tests.truth.records import HOUR, later, one_record

HEADER = """\
     3.04           N: GNSS NAV DATA    G: GPS              RINEX VERSION / TYPE
                                                            END OF HEADER
"""


def make_orbits(first, last, satellites=24):
    """Records every 2 h between two dates, of satellites in six planes."""
    parts = []
    for k in range(satellites):
        plane, slot = k % 6, k // 6
        places = {"node": np.array([plane * np.pi / 3.0 - np.pi])}
        places["mean_anomaly"] = np.array([slot * np.pi / 2.0 + plane * 0.5 - np.pi])
        start = replace(one_record(f"G{k + 1:02d}", gps_seconds(first)), **places)
        hours = (last - first).total_seconds() / HOUR
        parts += [later(start, t * HOUR) for t in np.arange(0.0, hours + 0.1, 2.0)]
    return join_ephemerides(parts)


def write_orbits(path, orbits):
    text = [HEADER]
    for k, satellite in enumerate(orbits.satellite_id):
        cells = [[0.0] * 4 for _ in range(8)]
        for name, (line, column) in FIELDS.items():
            toe = orbits.time_of_ephemeris[k]
            if name == "second_of_week":
                value = toe % (168 * HOUR)
            else:
                value = getattr(orbits, name)[k]
            if name in ("mean_anomaly", "node"):
                value = np.remainder(value + np.pi, 2.0 * np.pi) - np.pi
            cells[line][column] = min(value, 255.0) if name == "issue" else value
        moment = GPS_EPOCH + np.timedelta64(round(toe), "s").astype(object)
        cells[0] = cells[0][1:]
        head = f"{satellite} {moment:%Y %m %d %H %M %S}"
        numbers = ["".join(f"{x:19.12E}" for x in row) for row in cells]
        text += [f"{head}{numbers[0]}\n", *(f"    {row}\n" for row in numbers[1:])]
    path.write_text("".join(text))
    return path


def make_table(flight, start_s, every=50, off_m=20.0):
    """Fixes of a flight, with some error, as an ADS-B decoder writes them."""
    rows = np.arange(0, flight.time.size, every)
    latitude, longitude, height = (value[rows] for value in flight.geodetic)
    off = off_m / 6.4e6 * np.random.default_rng(3).standard_normal((2, rows.size))
    north, east, down = flight.velocity_n[rows].T
    return pandas.DataFrame(
        {
            "timestamp": start_s + flight.time[rows],
            "icao24": "4b1801",
            "latitude": np.degrees(latitude + off[0]),
            "longitude": np.degrees(longitude + off[1]),
            "altitude": height / FOOT,
            "groundspeed": np.hypot(north, east) / KNOT,
            "track": np.degrees(np.arctan2(east, north)) % 360.0,
            "vertical_rate": -down / FOOT * 60.0,
        }
    )
