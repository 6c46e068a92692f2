"""Raw measurements, from files to innovations: a drive of the engine, a walk, a counterfeit."""

from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest

from spoofgym import InnovationLog
from spoofgym.calibration.log import bind_to_log
from spoofgym.data.ephemerides import gps_seconds
from spoofgym.data.inertial import read_inertial
from spoofgym.data.observations import read_observations
from spoofgym.data.rinex import read_ionosphere, read_navigation
from spoofgym.earth.wgs84 import dcm_e_from_n, ecef_to_geodetic, geodetic_to_ecef
from spoofgym.receiver.epoch import FILTER
from spoofgym.receiver.log import RANGES
from spoofgym.receiver.raw_measurements import (
    _compare_turns,
    _Measured,
    compute_saastamoinen,
    solve_raw,
)

from ..command_line import call, refused
from ..data.files import write_orbits
from ..data.observed import (
    GALILEO_OFFSET_M,
    MAPPING,
    RANGE_SD,
    RATE_SD,
    make_drive,
    write_inertial,
    write_observations,
)

pytest.importorskip("pandas")
GEOID_M = -21.387  # at the place of the walk, below the ellipsoid
WALK = """\
header = false
lever_arm_m = [0.0, 0.05, 0.0]
[time]
column = 1
unit = "s"
scale = "unix-gps"
[specific_force]
columns = [-3, -2, -4]
unit = "g"
[angular_rate]
columns = [-6, -5, -7]
unit = "rad/s"
"""


@pytest.fixture(scope="module")
def drive():
    return make_drive(datetime(2024, 9, 14, 22, 10))


@pytest.fixture(scope="module")
def files(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    (folder / "imu.toml").write_text(MAPPING)
    write_inertial(folder / "imu.csv", drive)
    write_orbits(folder / "brdc.24n", drive.orbits)
    write_observations(folder / "drive.24o", drive)
    return folder


def solve(folder, observations, **settings):
    seen = read_observations(folder / observations)
    samples = read_inertial(folder / "imu.csv", folder / "imu.toml", seen.time[0])
    orbits = read_navigation(folder / "brdc.24n", "GEC")
    factors = RANGE_SD / 2.5, RATE_SD / 0.1
    return solve_raw(seen, orbits, samples, noise_factors=factors, **settings)


def compute_nis(log):
    """Mean square of the innovations of ranges and of rates, whitened by all of their S."""
    found, n = [], len(log.channels)
    for part in (slice(0, n), slice(n, None)):
        z, S = log.innovation[:, part], log.innovation_cov[:, part, part]
        white = np.linalg.solve(S, np.nan_to_num(z)[..., None])[..., 0]
        found.append(np.nansum(z * white) / np.isfinite(z).sum())
    return found


def compute_errors(solution, start, time, position_e, velocity_e):
    """(K, 3) errors of position and velocity, in ECEF axes, at the epochs of a solution."""
    at = start + solution.time
    return [
        getattr(solution, name) - np.stack([np.interp(at, time, x) for x in true.T], axis=1)
        for name, true in (("position_e", position_e), ("velocity_e", velocity_e))
    ]


@pytest.mark.parametrize("version", [2, 3])
def test_a_drive_is_solved_from_its_files(drive, files, version):
    name = f"drive{version}.24o"
    write_observations(files / name, drive, version, ends="\r\n")
    log, ((start, solution),) = solve(files, name)
    flight = drive.flight
    errors = compute_errors(
        solution, start, drive.start + flight.time, flight.position_e, flight.velocity_e
    )
    position, velocity = (np.sqrt((x[20:] ** 2).mean(axis=0)) for x in errors)
    assert (position < 1.5).all()
    assert (velocity < 0.08).all()
    assert not solution.flag.any()
    ranges, rates = compute_nis(log)
    assert 0.7 < ranges < 1.1
    assert 0.5 < rates < 1.1  # clock and sensors of the drive are better than assumed
    text = "; ".join(log.about["lines"])
    assert "1 steps of the receiver's clock by whole ms" in text
    if version == 3:
        found = float(text.split("clock of system E is ")[1].split()[0])
        assert found == pytest.approx(GALILEO_OFFSET_M, abs=0.5)
    assert {x[0] for x in log.channels} == ({"G", "E"} if version == 3 else {"G"})


def test_one_command_writes_the_log(files, tmp_path):
    names = [files / x for x in ("drive.24o", "brdc.24n", "imu.csv")]
    out = tmp_path / "drive.npz"
    result = call("log", "import", *names, "--mapping", files / "imu.toml", "-o", out)
    assert "piece 1 starts at 0.00 s" in result.stdout
    log = InnovationLog.load(out)
    assert {*FILTER, *RANGES, "axes"} == set(log.more)
    assert refused("log", "import", *names, "-o", out).count("--mapping")
    for idle in (("--grade", "tactical"), ("--noise-factors", "2", "2")):
        assert "for raw measurements" in refused("log", "import", out, "-o", out, *idle)
    assert "orbits are missing" in refused("log", "import", names[0], names[2], "-o", out)


def test_wrong_units_are_noticed(files, tmp_path):
    (tmp_path / "imu.toml").write_text(MAPPING.replace('"g"', '"m/s^2"'))
    for name in ("imu.csv", "brdc.24n", "drive.24o"):
        (tmp_path / name).symlink_to(files / name)
    with pytest.raises(ValueError, match="is it in g"):
        solve(tmp_path, "drive.24o")
    (tmp_path / "imu.toml").write_text(MAPPING.replace('"unix"', '"gps"'))
    with pytest.raises(ValueError, match=r"is `time\.scale` right"):
        solve(tmp_path, "drive.24o")


def test_the_troposphere_is_that_of_the_standard_atmosphere():
    zenith = compute_saastamoinen(np.array(np.pi / 2), np.array(np.radians(45.0)), np.array(0.0))
    assert zenith == pytest.approx(2.307 + 0.085, abs=0.01)  # dry, and half of saturated air
    low = compute_saastamoinen(np.array(np.radians(30.0)), np.array(0.8), np.array(0.0))
    assert low == pytest.approx(2.0 * zenith, rel=1e-3)


def test_the_walk_agrees_with_its_kinematic_solution(data_folder, tmp_path):
    folder = data_folder / "ublox_walk"
    (tmp_path / "imu.toml").write_text(WALK)
    seen = read_observations(folder / "walk_rawx.csv.gz")
    orbits = read_navigation(folder / "walk_convbin.nav", "GEC")
    samples = read_inertial(
        folder / "walk_0827_imu_1730_sf.csv.gz", tmp_path / "imu.toml", seen.time[0]
    )
    rows = [x.split() for x in (folder / "walk_0827_gnss_1730_sf.pos").read_text().splitlines()[1:]]
    moments = [datetime.strptime(" ".join(x[:2]), "%Y/%m/%d %H:%M:%S.%f") for x in rows]
    values = np.array([x[2:] for x in rows], dtype=float)
    latitude, longitude = np.radians(values[:, :2]).T
    place = geodetic_to_ecef(latitude, longitude, values[:, 2] + GEOID_M)
    C_en = dcm_e_from_n(latitude[0], longitude[0])
    velocity = values[:, 13:16] * [1.0, 1.0, -1.0] @ C_en.T
    before, matched = (
        solve_raw(seen, orbits, samples, noise_factors=x)[0] for x in ((1.0, 1.0), (2.5, 1.5))
    )
    _, ((start, solution),) = solve_raw(seen, orbits, samples, noise_factors=(2.5, 2.0))
    time = np.array([gps_seconds(x) for x in moments])
    errors = compute_errors(solution, start, time, place, velocity)
    off, slow = (np.sqrt(((x @ C_en) ** 2).mean(axis=0)) for x in errors)
    assert (slow <= 0.16).all()
    assert (off < 8.0).all()  # the ionosphere is in the ranges
    assert (np.std(errors[0] @ C_en, axis=0) < 1.5).all()
    assert not solution.flag.any()
    stated, fitted = (compute_nis(x) for x in (before, matched))
    assert stated[0] > 5.0
    assert stated[1] > 2.0
    assert fitted == pytest.approx([1.0, 1.0], abs=0.1)


def test_a_counterfeit_is_seen_in_what_was_found(data_folder):
    folder = data_folder / "hksc_spoofed"
    seen = read_observations(folder / "COM8_220214_013336.obs")
    assert len(set(seen.segment.tolist())) == 4
    orbits = read_navigation(folder / "hksc045a.22n")
    log, solutions = solve_raw(seen, orbits, None, noise_factors=(13.0, 1.0))
    text = "\n".join(log.about["lines"])
    off = float(text.split("G31, whose pseudoranges are off by ")[1].split()[0])
    assert off == pytest.approx(-98_700.0, abs=100.0)
    drift = float(text.split("clock drifts by ")[1].split()[0])
    assert drift == pytest.approx(2417.0, abs=5.0)
    assert "is it a transmitter?" in text
    true = geodetic_to_ecef(np.radians(22.322172083), np.radians(114.14118797), 20.24)
    for _, solution in solutions:
        assert np.linalg.norm(solution.position_e[-1] - true) < 150.0
    assert [len(x.time) for _, x in solutions] == [283, 297, 299, 173]
    assert "left out: 87 epochs" in text  # one has four ranges, which agree with a fix of their own
    # a test of ranges blames it in every scene, wherever it is measured; the filter takes no notice
    log, again = solve_raw(seen, orbits, None, noise_factors=(13.0, 1.0), keep_odd=True)
    for (_, one), (_, other) in zip(solutions, again, strict=True):
        np.testing.assert_allclose(one.position_e, other.position_e, rtol=0, atol=0.01)
    detector, _ = bind_to_log({"name": "raim", "sigma_m": 100.0}, log)
    odd, alarmed, blamed = log.channels.index("G31"), [], []
    for epoch in log.epochs():
        alarmed.append(bool(detector.judge(epoch).alarm.any()))
        blamed.append(detector.memory["group"][0, odd] == 2)
    counts = [(np.array(x)[log.segment == k].sum()) for x in (alarmed, blamed) for k in range(1, 5)]
    assert counts == [188, 269, 268, 173, 188, 268, 268, 173]


def test_the_broadcast_ionosphere_brings_a_station_to_its_height(data_folder, tmp_path):
    folder = data_folder / "gnss_broadcast"
    text = (folder / "07590920.05o").read_text().replace("4    L1    C1", "4    D1    C1", 1)
    (tmp_path / "station.05o").write_text(text)  # it has no Doppler shifts: rates are of the ranges
    seen, orbits = read_observations(tmp_path / "station.05o"), folder / "07590920.05n"
    seen = replace(seen, range_rate=np.gradient(seen.pseudorange, seen.time, axis=0))
    true = np.array([-3976219.5082, 3382372.5671, 3652512.9849])
    C_en, down = dcm_e_from_n(*ecef_to_geodetic(true)[:2]), []
    for model in (None, read_ionosphere(orbits)):
        measured = _Measured(seen, read_navigation(orbits), ionosphere=model)
        north, east, low = ((measured.fixes[:, :3] - true) @ C_en).mean(axis=0)
        assert np.hypot(north, east) < 1.0
        down.append(low)
    assert down[0] < -5.0
    assert abs(down[1]) < 1.0
    assert "that of GPS's broadcast model" in measured.lines[-2]


def test_turns_that_are_not_those_of_the_velocity_are_named(drive, files):
    write_observations(files / "turns.24o", drive, 3)
    seen = read_observations(files / "turns.24o")
    measured = _Measured(seen, read_navigation(files / "brdc.24n", "GEC"))
    samples = read_inertial(files / "imu.csv", files / "imu.toml", seen.time[0])
    assert _compare_turns(measured, samples) == []
    (line,) = _compare_turns(measured, samples._replace(time=samples.time - 18.0))
    assert "turns of the sensor are those of the velocity -18 s away: is `time.scale`" in line
    for factor, cause in ((-1.0, "axis turned round"), (57.3, "deg/s for rad/s")):
        rate = samples.angular_rate_b * [1.0, 1.0, factor]
        (line,) = _compare_turns(measured, samples._replace(angular_rate_b=rate))
        assert cause in line
