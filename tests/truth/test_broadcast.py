from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from spoofgym.data.ephemerides import (
    GPS_EARTH_RATE,
    GPS_GRAVITATIONAL_CONSTANT,
    SECONDS_PER_WEEK,
    BroadcastConstellation,
    gps_seconds,
    propagate_orbits,
    screen,
    solve_kepler,
)
from spoofgym.data.rinex import read_navigation

from .records import HOUR, ORBIT, SATURDAY_22, chain, joined, later, one_record

PROPERTY = settings(deadline=None, max_examples=50)


def test_gps_seconds_of_known_weeks_and_of_civil_time_with_leap_seconds():
    assert gps_seconds(datetime(1980, 1, 6)) == 0.0
    # header of igs15904.sp3: week 1590, second 345600
    assert gps_seconds(datetime(2010, 7, 1)) == 1590 * SECONDS_PER_WEEK + 345600.0
    # the 10-bit week number rolled over on this day
    assert gps_seconds(datetime(2019, 4, 7)) == 2048 * SECONDS_PER_WEEK
    kathmandu = timezone(timedelta(hours=5, minutes=45))
    for moment, leap_seconds in (
        (datetime(1980, 1, 6), 0),
        (datetime(2008, 12, 31, 23, 59, 59), 14),
        (datetime(2010, 7, 1), 15),  # LEAP SECONDS in the header of brdc1820.10n
        (datetime(2012, 10, 31), 16),  # and of brdc3050.12n
        (datetime(2016, 12, 31, 23, 59, 59), 17),
        (datetime(2017, 1, 1), 18),
    ):
        civil = moment.replace(tzinfo=UTC)
        assert gps_seconds(civil) == gps_seconds(moment) + leap_seconds
        assert gps_seconds(civil.astimezone(kathmandu)) == gps_seconds(civil)


@PROPERTY
@given(mean_anomaly=st.floats(-10.0, 10.0), eccentricity=st.floats(0.0, 0.5) | st.just(0.02))
def test_kepler_equation_holds(mean_anomaly, eccentricity):
    E = solve_kepler(mean_anomaly, eccentricity)
    residual = E - eccentricity * np.sin(E) - mean_anomaly
    assert abs(np.remainder(residual + np.pi, 2.0 * np.pi) - np.pi) < 5e-15


@PROPERTY
@given(
    elapsed=st.floats(-4.0 * HOUR, 4.0 * HOUR),
    shape=st.tuples(st.floats(0.0, 0.1), st.floats(-np.pi, np.pi), st.floats(-np.pi, np.pi)),
    corrections=st.lists(st.floats(-1.0, 1.0), min_size=8, max_size=8),
)
def test_velocity_is_the_derivative_of_position(elapsed, shape, corrections):
    # corrections a hundred times those of GPS, so that each of their rates is seen
    names = ("cuc", "cus", "cic", "cis", "crc", "crs", "inclination_rate", "node_rate")
    scales = (1e-3, 1e-3, 1e-4, 1e-4, 3e4, 3e4, 1e-7, 1e-6)
    changes = {n: s * c for n, s, c in zip(names, scales, corrections, strict=True)}
    changes |= zip(("eccentricity", "mean_anomaly", "perigee"), shape, strict=True)
    times = elapsed + np.array([-0.1, 0.0, 0.1])
    position_e, velocity_e = propagate_orbits(one_record(**changes), [0, 0, 0], times)
    assert_allclose(velocity_e[1], (position_e[2] - position_e[0]) / 0.2, rtol=0, atol=2e-6)


@PROPERTY
@given(elapsed=st.floats(-2e4, 2e4), eccentricity=st.floats(0.0, 0.2))
def test_without_corrections_it_is_the_two_body_orbit(elapsed, eccentricity):
    shape = {"root_semi_major_axis", "mean_anomaly", "perigee", "node", "inclination"}
    none = dict.fromkeys(ORBIT.keys() - shape, 0.0)
    record = one_record(**none | {"eccentricity": eccentricity})
    position_e, velocity_e = propagate_orbits(record, [0, 0], [0.0, elapsed])
    earth_rate = np.array([0.0, 0.0, GPS_EARTH_RATE])
    velocity_i = velocity_e + np.cross(earth_rate, position_e)
    a = ORBIT["root_semi_major_axis"] ** 2
    r = np.linalg.norm(position_e, axis=-1)
    assert (r >= a * (1.0 - eccentricity) * (1.0 - 1e-12)).all()
    assert (r <= a * (1.0 + eccentricity) * (1.0 + 1e-12)).all()
    vis_viva = GPS_GRAVITATIONAL_CONSTANT * (2.0 / r - 1.0 / a)
    assert_allclose(np.vecdot(velocity_i, velocity_i), vis_viva, rtol=1e-12)
    h = np.cross(position_e, velocity_i)
    magnitude = np.sqrt(GPS_GRAVITATIONAL_CONSTANT * a * (1.0 - eccentricity**2))
    assert_allclose(np.linalg.norm(h, axis=-1), magnitude, rtol=1e-12)
    assert_allclose(h[:, 2], magnitude * np.cos(ORBIT["inclination"]), rtol=1e-11)


@pytest.mark.parametrize("by", [-16.0, 16.0, 4 * HOUR])
def test_a_record_of_the_next_week_continues_the_orbit(by):
    first = one_record("G05", SATURDAY_22 + 2 * HOUR - 16.0)
    second = later(first, by)
    times = np.linspace(0.0, HOUR, 7)
    index = np.zeros(times.size, dtype=int)
    assert_allclose(
        propagate_orbits(first, index, times).position_e,
        propagate_orbits(second, index, times - by).position_e,
        rtol=0,
        atol=1e-5,
    )


@pytest.mark.parametrize("late", [0.0, 1800.0])
def test_the_nearest_record_is_followed_whenever_the_run_starts(late):
    records = chain(0.0, 50.0, 0.0)  # 22:00, 00:00 of the next week, 02:00
    constellation = BroadcastConstellation(records, SATURDAY_22 + late)
    times = np.array([-1.9, 0.9, 1.1, 2.9, 3.1, 5.9]) * HOUR
    used = np.array([0, 0, 1, 1, 2, 2])
    expected = propagate_orbits(records, used, times - used * 2 * HOUR)
    states = constellation.states(times - late)
    assert_allclose(states.position_e[:, 0], expected.position_e, rtol=0, atol=1e-6)
    assert_allclose(states.velocity_e[:, 0], expected.velocity_e, rtol=0, atol=1e-9)


def test_nothing_unhealthy_is_flown_nor_beyond_two_hours_of_a_record():
    constellation = BroadcastConstellation(chain(0.0, 0.0, interval=6 * HOUR), SATURDAY_22)
    times = np.array([-2.01, -2.0, 2.0, 2.01, 3.99, 4.0, 8.0, 8.01]) * HOUR
    known = [False, True, True, False, False, True, True, False]
    for array in constellation.states(times):
        assert_array_equal(np.isfinite(array).all(axis=(1, 2)), known)
        assert_array_equal(np.isnan(array).all(axis=(1, 2)), np.logical_not(known))
    first = one_record()
    others = one_record("G02", health=1.0), one_record("G11")
    records = joined(first, later(first, 2 * HOUR, health=63.0), *others)
    constellation = BroadcastConstellation(records, SATURDAY_22)
    assert constellation.satellite_ids == ("G02", "G05", "G11")
    known = np.isfinite(constellation.states([0.0, 1.5 * HOUR]).position_e).all(axis=-1)
    assert_array_equal(known, [[False, True, True], [False, False, True]])
    for order in [(0.0, 1.0), (1.0, 0.0)]:  # of records for one time the unhealthy one is obeyed
        records = joined(*(one_record(health=health) for health in order), one_record("G9"))
        states = BroadcastConstellation(records, SATURDAY_22).states([-60.0, 0.0, 60.0])
        assert np.isnan(states.position_e[:, 0]).all()
        assert states.position_e.flags.c_contiguous


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: gps_seconds(datetime(1979, 12, 31)), "1980-01-06"),
        (lambda: BroadcastConstellation(one_record(), 0.0), r"2024-09-14 22:00:00 .* got 0.0"),
        (lambda: BroadcastConstellation(one_record(health=1.0), SATURDAY_22), "none of the 1"),
        (lambda: one_record(eccentricity=1.0), r"0 <= e < 1, got 1\.0"),
        (lambda: one_record(root_semi_major_axis=0.0), r"positive, got 0\.0"),
        (lambda: one_record(node=np.nan), "`node` must be finite, got nan for G05, record 0"),
        (lambda: replace(one_record(), cuc=np.zeros(2)), r"`cuc` must have shape \(1,\)"),
        (lambda: one_record().node.fill(0.0), "read-only"),
    ],
)
def test_what_cannot_be_is_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()


def read_sp3(path):
    """Epochs and, for each satellite, (K, 3) precise positions, ECEF [m]; NaN where missing."""
    dates = []
    positions = {}
    for line in path.read_text().splitlines():
        if line.startswith("*"):
            year, month, day, hour, minute = map(int, line[1:].split()[:5])
            dates.append(datetime(year, month, day, hour, minute))
        elif line.startswith("P"):
            xyz = [float(line[k : k + 14]) * 1e3 for k in (4, 18, 32)]
            positions.setdefault(line[1:4], []).append(xyz if any(xyz) else [np.nan] * 3)
    return dates, {satellite: np.array(rows) for satellite, rows in positions.items()}


def test_orbits_of_a_day_agree_with_the_precise_ones(data_folder):
    folder = data_folder / "gnss_broadcast"
    dates, precise = read_sp3(folder / "igs15904.sp3")
    records = read_navigation(folder / "brdc1820.10n")
    kept, report = screen(records)
    constellation = BroadcastConstellation(kept, gps_seconds(dates[0]))
    states = constellation.states([gps_seconds(date) - constellation.start for date in dates])
    ids = constellation.satellite_ids
    expected = np.stack([precise[satellite] for satellite in ids], axis=1)
    error = np.linalg.norm(states.position_e - expected, axis=-1)
    flown = np.isfinite(error)
    assert np.sqrt(np.mean(error[flown] ** 2)) <= 2.5
    assert error[flown].max() <= 8.0

    # the one bad record, 20,900 km off, would be the only one of G01 that is marked healthy
    bad = gps_seconds(datetime(2010, 7, 1, 6))
    assert [(r.satellite_id, r.time_of_ephemeris) for r in report.rejections] == [("G01", bad)]
    assert report.rejections[0].disagreement > 1e7
    assert report.duplicates == report.unresolved == 0
    assert not flown[:, ids.index("G01")].any()
    unscreened = BroadcastConstellation(records, bad).states([0.0]).position_e[0, ids.index("G01")]
    assert np.linalg.norm(unscreened - precise["G01"][24]) > 2e7
    # all day long there is a record of each of the others but G25, unhealthy as well
    others = [k for k, satellite in enumerate(ids) if satellite not in {"G01", "G25"}]
    assert flown[:, others].all()


def test_unhealthy_satellites_of_a_day(data_folder):
    path = data_folder / "gnss_broadcast" / "brdc3050.12n"
    kept, report = screen(read_navigation(path))
    constellation = BroadcastConstellation(kept, gps_seconds(datetime(2012, 10, 31, 12)))
    assert set(kept.satellite_id[~kept.healthy].tolist()) == {"G24", "G27"}
    assert set(kept.satellite_id[kept.healthy].tolist()).isdisjoint({"G24", "G27"})
    assert report.unhealthy == (~kept.healthy).sum()
    assert (report.rejected, report.unresolved) == (0, 0)
    known = np.isfinite(constellation.states([0.0]).position_e[0]).all(axis=-1)
    ids = np.array(constellation.satellite_ids)
    assert set(ids[~known].tolist()) == {"G24", "G27"}


def rejected_records(ephemerides):
    _, report = screen(ephemerides)
    toe = ephemerides.time_of_ephemeris.tolist()
    return [toe.index(rejection.time_of_ephemeris) for rejection in report.rejections]


@PROPERTY
@given(count=st.integers(3, 9), data=st.data(), error=st.floats(110.0, 2e7) | st.floats(-2e7, -110))
def test_a_single_bad_record_is_found_wherever_it_stands(count, data, error):
    bad = data.draw(st.integers(0, count - 1))
    errors = [0.0] * count
    errors[bad] = error
    records = chain(*errors)
    assert rejected_records(records) == [bad]
    kept, report = screen(records)
    assert (report.records, report.rejected, report.unresolved) == (count, 1, 0)
    assert len(kept) == count - 1


@PROPERTY
@given(errors=st.lists(st.floats(-45.0, 45.0), min_size=1, max_size=9))
def test_broadcast_errors_are_no_contradiction(errors):
    kept, report = screen(chain(*errors))
    assert (len(kept), report.rejected, report.unresolved) == (len(errors), 0, 0)


@pytest.mark.parametrize(
    ("errors", "bad"),
    [
        ((0, 0, 5000, -9000, 0, 0), [2, 3]),
        ((0, 5000, -9000, 0), [1, 2]),
        ((5000, -9000, 0, 0), [0, 1]),
        ((0, 500, 0, 2e6, 0), [1, 3]),
        ((5000, 0, 0, -9000), [0, 3]),
    ],
)
def test_two_bad_records_are_found(errors, bad):
    # half an hour apart, so that records beyond the bad ones are near enough to compare
    assert rejected_records(chain(*errors, interval=0.5 * HOUR)) == bad


@pytest.mark.parametrize(
    ("records", "counts"),
    [
        (chain(0, 0, 5000, -9000, 0, 0), (2, 0, 0)),  # in a row, two hours apart
        (chain(0, 0, 5000, 5000, 0, 0), (0, 2, 0)),  # wrong alike: they confirm each other
        (chain(0, 5000), (0, 1, 0)),  # of which either may be wrong
        (one_record(), (0, 0, 1)),
        (chain(0, 5000, 0, interval=4.1 * HOUR), (0, 0, 3)),  # too far apart to be compared
        (chain(0, 5000, 0, interval=4.0 * HOUR), (1, 0, 2)),
    ],
)
def test_what_neighbours_cannot_tell_is_kept_and_counted(records, counts):
    kept, report = screen(records)
    assert (report.rejected, report.unresolved, report.unchecked) == counts
    assert len(kept) == len(records) - report.rejected


def test_unhealthy_neighbours_bear_witness_and_copies_and_other_satellites_none():
    # G01 in brdc1820.10n: the only record marked healthy is the wrong one
    records = chain(0, 0, 2e7, 0)
    records = replace(records, health=np.array([63.0, 63.0, 0.0, 63.0]))
    kept, report = screen(records)
    assert (rejected_records(records), report.unhealthy) == ([2], 3)
    assert not kept.healthy.any()
    records = chain(0, 5000, 0)
    rounded = replace(records, node=records.node * (1.0 + 1e-13))
    kept, report = screen(joined(records, rounded, records))
    assert (report.records, report.duplicates, report.rejected) == (9, 6, 1)
    assert_array_equal(kept.time_of_ephemeris, SATURDAY_22 + np.array([0.0, 4.0]) * HOUR)
    kept, report = screen(joined(one_record(), one_record(health=63.0), one_record()))
    assert (report.duplicates, report.unhealthy) == (2, 1)
    assert_array_equal(kept.health, [63.0])  # the unhealthy one stays
    other = one_record("G06", mean_anomaly=2.0)
    records = joined(chain(0, 0, 5000, 0), other, later(other, 2 * HOUR), later(other, 4 * HOUR))
    assert rejected_records(records) == [2]
    assert screen(records)[0].satellite_id.tolist() == ["G05"] * 3 + ["G06"] * 3


@PROPERTY
@given(order=st.permutations(range(7)))
def test_the_order_of_the_records_does_not_matter(order):
    records = chain(0, 0, 5000, 0, 0, -9000, 0)
    kept, report = screen(records)
    shuffled, same_report = screen(records.take(order))
    assert same_report == report
    assert_array_equal(shuffled.time_of_ephemeris, kept.time_of_ephemeris)
