"""Made-up input files: a day of broadcast orbits, and one flight as every service writes it."""

import json
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
            of_week = name == "second_of_week"
            value = toe % (168 * HOUR) if of_week else getattr(orbits, name)[k]
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


def _write(path, text, encoding="utf-8"):
    path.write_text(text, encoding=encoding)
    return path


def _dump(path, found):
    return _write(path, json.dumps(found))


def _si(t):
    """Time, place, altitude [m], speed [m/s], course and climb [m/s] of every row."""
    speed = t["groundspeed"] * KNOT
    climb = t["vertical_rate"] * FOOT / 60.0
    place = t["timestamp"], t["latitude"], t["longitude"], t["altitude"] * FOOT
    return zip(*place, speed, t["track"], climb, strict=True)


def _opensky_states(folder, t):
    answers = [
        {"time": s, "states": [
            ["4b1801", "SWR1", "CH", s - 0.5, s, lon, lat, h, False, v, c, w, None, h + 9.0,
             None, False, 0]
        ]}
        for s, lat, lon, h, v, c, w in _si(t)
    ]  # fmt: skip
    answers.insert(0, {"time": t["timestamp"][0] - 5.0, "states": None})
    return _write(folder / "states.jsonl", "\n".join(map(json.dumps, answers)))


def _opensky_track(folder, t):
    path = [[s, lat, lon, h, c, False] for s, lat, lon, h, _, c, _ in _si(t)]
    return _dump(folder / "track.json", {"icao24": "4b1801", "callsign": "SWR1", "path": path})


def _opensky_csv(folder, t):
    head = "time,icao24,lat,lon,velocity,heading,vertrate,callsign,onground,baroaltitude,"
    lines = [
        f"{s!r},4b1801,{lat!r},{lon!r},{v!r},{c!r},{w!r},SWR1,False,{h!r},{h + 9.0!r},{s - 0.5!r}"
        for s, lat, lon, h, v, c, w in (map(float, row) for row in _si(t))
    ]
    return _write(folder / "s.csv", "\n".join([f"{head}geoaltitude,lastposupdate", *lines]))


def _readsb_trace(folder, t):
    base = t["timestamp"][0] - 60.0
    rows = [[30.0, t["latitude"][0], t["longitude"][0], "ground", 4.0, 90.0, 0, None, None]]
    rows += [
        [r.timestamp - base, r.latitude, r.longitude, r.altitude, r.groundspeed, r.track, 0,
         r.vertical_rate, {"alt_geom": 9, "track": 1.0}, "adsb_icao", r.altitude + 99.0]
        for r in t.itertuples()
    ]  # fmt: skip
    about = {"icao": "4b1801", "r": "HB-ABC", "t": "A320", "timestamp": base}
    return _dump(folder / "trace_full_4b1801.json", {**about, "trace": rows})


def _readsb_aircraft(folder, t):
    """One file a second put after another, with an aircraft of which no position is known."""
    answers = [
        {"now": r.timestamp, "messages": 1, "aircraft": [
            {"hex": "4b1801", "flight": "SWR1    ", "alt_baro": r.altitude, "alt_geom": 1.0,
             "gs": r.groundspeed, "track": r.track, "baro_rate": r.vertical_rate, "lat": r.latitude,
             "lon": r.longitude, "seen_pos": 0.5, "mlat": [], "lastPosition": {"lat": 1.0}},
        ]}
        for r in t.itertuples()
    ]  # fmt: skip
    return _dump(folder / "aircraft.json", answers)


def _flightradar_csv(folder, t):
    head = "Timestamp,UTC,Callsign,Position,Altitude,Speed,Direction"
    lines = [
        f'{r.timestamp!r},2024-09-14T22:00:00Z,SWR1,"{r.latitude!r},{r.longitude!r}",{r.altitude!r},'
        f"{r.groundspeed!r},{r.track!r}"
        for r in t.itertuples()
    ]
    return _write(folder / "fr24.csv", "\r\n".join([head, *lines]), "utf-8-sig")


def _flightradar_playback(folder, t):
    rows = [
        {"latitude": r.latitude, "longitude": r.longitude, "heading": r.track,
         "altitude": {"feet": r.altitude, "meters": 1}, "timestamp": r.timestamp,
         "speed": {"kmh": 1, "kts": r.groundspeed, "mph": 1}, "verticalSpeed": {"fpm": 0, "ms": 0}}
        for r in t.itertuples()
    ]  # fmt: skip
    flight = {"aircraft": {"model": "A320"}, "identification": {"id": "x"}, "track": rows}
    return _dump(folder / "p.json", {"result": {"response": {"data": {"flight": flight}}}})


def _flightradar_tracks(folder, t):
    rows = [
        {"timestamp": f"{pandas.Timestamp(r.timestamp, unit='s').isoformat()}Z", "lat": r.latitude,
         "lon": r.longitude, "alt": r.altitude, "gspeed": r.groundspeed, "track": r.track,
         "vspeed": 0, "squawk": "1000"}
        for r in t.itertuples()
    ]  # fmt: skip
    return _dump(folder / "tracks.json", [{"fr24_id": "35f2", "tracks": rows}])


def _virtual_radar(folder, t):
    answers = [
        {"acList": [{"Id": 1, "Icao": "4B1801", "Call": "SWR1", "Lat": r.latitude,
                     "Long": r.longitude, "Alt": r.altitude, "Spd": r.groundspeed, "Trak": r.track,
                     "Vsi": 0, "PosTime": int(r.timestamp * 1e3)}]}
        for r in t.itertuples()
    ]  # fmt: skip
    return _dump(folder / "AircraftList.json", answers)


def _flightaware(folder, t):
    rows = [
        {"fa_flight_id": "SWR1-1", "altitude": r.altitude / 100.0, "groundspeed": r.groundspeed,
         "heading": r.track, "latitude": r.latitude, "longitude": r.longitude,
         "timestamp": f"{pandas.Timestamp(r.timestamp, unit='s').isoformat()}Z", "update_type": "A"}
        for r in t.itertuples()
    ]  # fmt: skip
    return _dump(folder / "fa.json", {"actual_distance": 9, "positions": rows})


def _base_station(folder, t):
    """Lines of dump1090 on port 30003, with old ends of lines."""
    lines = []
    for r in t.itertuples():
        day, hour = str(pandas.Timestamp(r.timestamp, unit="s")).split(" ")
        moment = f"{day.replace('-', '/')},{hour}"
        values = f"SWR1,{r.altitude!r},{r.groundspeed!r},{r.track!r},{r.latitude!r},{r.longitude!r}"
        lines.append(f"MSG,3,1,1,4B1801,1,{moment},{moment},{values},0,1000,0,0,0,0")
    return _write(folder / "sbs.csv", "\r".join(lines))


def _thousands(folder, t):
    swap = str.maketrans(",.", ".,")
    t = t.assign(altitude=[f"{x:,.9f}".translate(swap) for x in t["altitude"]])
    t.to_csv(folder / "de.csv", sep="\t", decimal=",", index=False)
    return folder / "de.csv"


def _spreadsheet(folder, t):
    names = {"altitude": "Altitude (ft)", "groundspeed": "Ground speed [km/h]", "timestamp": "Time"}
    table = t.assign(groundspeed=t["groundspeed"] * 1.852, icao24="4e5432").rename(columns=names)
    table.to_csv(folder / "sheet.csv", sep=";", decimal=",", index=False, encoding="utf-8-sig")
    return folder / "sheet.csv"


SERVICES = {
    "OpenSky states": _opensky_states,
    "OpenSky track": _opensky_track,
    "OpenSky CSV": _opensky_csv,
    "readsb trace": _readsb_trace,
    "readsb aircraft": _readsb_aircraft,
    "Flightradar24 CSV": _flightradar_csv,
    "Flightradar24 playback": _flightradar_playback,
    "Flightradar24 tracks": _flightradar_tracks,
    "spreadsheet": _spreadsheet,
    "Virtual Radar": _virtual_radar,
    "FlightAware": _flightaware,
    "dump1090": _base_station,
    "points for thousands": _thousands,
}
