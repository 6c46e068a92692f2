"""The truth of a run: slots, ranges, visibility, and what is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest

from spoofgym.earth.wgs84 import dcm_e_from_n, ecef_to_geodetic, geodetic_to_ecef, range_and_rate
from spoofgym.truth.flight import flight_from_velocity, inverse_kinematics
from spoofgym.truth.run import build_world
from spoofgym.truth.satellites import CircularConstellation, SatelliteStates

STEP = 0.1


def trajectory(duration=10.0, speed=100.0, latitude_deg=45.0, step=STEP):
    count = round(duration / step) + 1
    zero = np.zeros(count)
    velocity = np.column_stack([zero, zero + speed, zero])
    start = math.radians(latitude_deg), 0.3, 1000.0
    return inverse_kinematics(
        flight_from_velocity("east", *start, velocity, zero, zero, zero + math.pi / 2, step)
    )


EAST = trajectory()


@pytest.fixture(scope="module")
def world():
    return build_world(EAST, CircularConstellation(), epoch_interval_s=0.5)


def test_epochs_follow_the_samples(world):
    assert world.epochs == 21
    np.testing.assert_allclose(world.epoch_time, np.arange(21) * 0.5, atol=1e-12)
    np.testing.assert_array_equal(world.epoch_end, np.arange(21) * 5)
    np.testing.assert_array_equal(world.imu_time, EAST.time)
    np.testing.assert_array_equal(world.run[:3].T, EAST.specific_force_b)
    np.testing.assert_array_equal(world.run[3:6].T, EAST.angular_rate_b)
    np.testing.assert_allclose(world.run[6], STEP)
    np.testing.assert_allclose(world.run[7], STEP**-0.5)
    assert world.run.flags.c_contiguous
    assert world.most_samples == 5
    np.testing.assert_array_equal(world.position_e, EAST.position_e[::5])
    np.testing.assert_array_equal(world.velocity_e, EAST.velocity_e[::5])
    np.testing.assert_array_equal(world.C_eb, EAST.C_eb[::5])
    # the samples up to an epoch last until the epoch
    lasted = np.concatenate([[0.0], np.cumsum(world.run[6])])
    np.testing.assert_allclose(lasted[world.epoch_end], world.epoch_time)


def test_slots_are_ordered_by_id_and_then_empty(world):
    named = [name for name in world.satellite_ids if name]
    assert named == sorted(named)
    assert world.channels == 12
    assert world.satellite_ids == (*named, *[""] * (12 - len(named)))
    empty = slice(len(named), None)
    assert not world.visible[:, empty].any()
    for array in (world.satellites, world.elevation, world.azimuth):
        assert not array[:, empty].any()


def test_ranges_are_those_of_range_and_rate(world):
    assert world.visible.any()
    for k in (0, 7, 20):
        for s in range(world.channels):
            p = world.satellites[k, s]
            want = (0.0, 0.0)
            if world.visible[k, s]:
                want = range_and_rate(p[:3], p[3:6], world.position_e[k], world.velocity_e[k])[:2]
            np.testing.assert_allclose(p[6:], want, rtol=1e-14, atol=1e-9)


def test_satellites_are_those_of_the_constellation(world):
    states = CircularConstellation().states(world.epoch_time)
    ids = CircularConstellation().satellite_ids
    for s, name in enumerate(world.satellite_ids):
        if name:
            j = ids.index(name)
            np.testing.assert_array_equal(world.satellites[:, s, :3], states.position_e[:, j])
            np.testing.assert_array_equal(world.satellites[:, s, 3:6], states.velocity_e[:, j])


def test_a_satellite_is_visible_above_the_mask(world):
    latitude, longitude, _ = ecef_to_geodetic(world.position_e)
    up = np.column_stack(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ]
    )
    states = CircularConstellation().states(world.epoch_time)
    sight = states.position_e - world.position_e[:, None, :]
    sine = np.einsum("kni,ki->kn", sight, up) / np.linalg.norm(sight, axis=-1)
    above = sine > math.sin(math.radians(10.0))
    names = np.array(CircularConstellation().satellite_ids)
    for k in (0, 20):
        named = np.array(world.satellite_ids)[world.visible[k]]
        assert list(named) == list(names[above[k]])
    for s, name in enumerate(world.satellite_ids):
        if name:
            j = list(names).index(name)
            np.testing.assert_allclose(np.sin(world.elevation[:, s]), sine[:, j], atol=1e-14)


class Ring(CircularConstellation):
    """The sky of one's own choice: eight satellites all around, at equal elevation."""

    def states(self, time):
        azimuth = np.arange(8) * math.pi / 4
        sight = np.column_stack(
            [0.766 * np.cos(azimuth), 0.766 * np.sin(azimuth), np.full(8, -0.643)]
        )
        latitude, longitude, _ = ecef_to_geodetic(EAST.position_e[0])
        position = EAST.position_e[0] + 2e7 * sight @ dcm_e_from_n(latitude, longitude).T
        shape = (len(time), 8, 3)
        return SatelliteStates(np.broadcast_to(position, shape), np.zeros(shape))


def test_azimuth_goes_from_north_by_east():
    ring = build_world(EAST, Ring(satellites=8))
    np.testing.assert_allclose(
        ring.azimuth[0, :8] % (2 * math.pi), np.arange(8) * math.pi / 4, atol=1e-9
    )
    np.testing.assert_allclose(ring.elevation[0, :8], math.atan2(0.643, 0.766), atol=1e-9)


def test_of_more_satellites_than_channels_those_that_stay_longest_are_taken():
    crowd = CircularConstellation(satellites=99)
    long = trajectory(1800.0, step=1.0)
    few = build_world(long, crowd, epoch_interval_s=60.0, channels=8)
    many = build_world(long, crowd, epoch_interval_s=60.0, channels=32)
    assert all(many.satellite_ids[:20])
    assert all(few.satellite_ids)
    assert list(few.satellite_ids) == sorted(few.satellite_ids)
    stay = dict(zip(many.satellite_ids, many.visible.sum(axis=0), strict=True))
    taken = [stay[name] for name in few.satellite_ids]
    left = [epochs for name, epochs in stay.items() if name not in few.satellite_ids]
    assert min(taken) >= max(left)
    # satellites rise and set in half an hour
    assert not many.visible.all(axis=0)[: len([n for n in many.satellite_ids if n])].all()
    for s, name in enumerate(few.satellite_ids):
        other = many.satellite_ids.index(name)
        np.testing.assert_array_equal(few.satellites[:, s], many.satellites[:, other])


def test_the_first_elevation_of_a_rising_satellite_is_at_the_mask():
    long = trajectory(1800.0, step=1.0)
    crowd = CircularConstellation(satellites=60)
    world = build_world(long, crowd, epoch_interval_s=10.0, channels=32)
    rising = ~world.visible[0] & world.visible.any(axis=0)
    assert rising.any()
    first = world.first_elevation
    assert (first[rising] > math.radians(10.0)).all()
    np.testing.assert_allclose(first[rising], math.radians(10.0), atol=0.005)
    at_once = world.visible[0]
    np.testing.assert_array_equal(first[at_once], world.elevation[0, at_once])
    np.testing.assert_array_equal(first[~world.visible.any(axis=0)], math.pi / 2)


class Gapped(CircularConstellation):
    """Without an ephemeris of one satellite for some time, and of another one at all."""

    def states(self, time):
        states = super().states(time)
        position, velocity = states.position_e.copy(), states.velocity_e.copy()
        visible = build_world(EAST, CircularConstellation())
        first, second = (
            CircularConstellation().satellite_ids.index(visible.satellite_ids[s]) for s in (0, 1)
        )
        gap = (np.asarray(time) > 2.0) & (np.asarray(time) < 4.0)
        position[gap, first], velocity[gap, first] = np.nan, np.nan
        velocity[:, second] = np.nan
        return SatelliteStates(position, velocity)


def test_without_an_ephemeris_a_satellite_is_not_visible(world):
    gapped = build_world(EAST, Gapped())
    first, second = world.satellite_ids[:2]
    assert second not in gapped.satellite_ids
    assert gapped.satellite_ids[0] == first
    gap = (gapped.epoch_time > 2.0) & (gapped.epoch_time < 4.0)
    np.testing.assert_array_equal(gapped.visible[:, 0], ~gap)
    for array in (gapped.satellites, gapped.elevation, gapped.azimuth):
        assert np.isfinite(array).all()
        assert not array[gap, 0].any()
    np.testing.assert_array_equal(gapped.satellites[~gap, 0], world.satellites[~gap, 0])


def test_a_rotation_of_earth_and_sky_leaves_ranges_alone():
    """Turned about the axis of the Earth, all that is relative stays."""
    turned = replace_longitude(EAST, 1.0)
    # the sky turns with it: nodes move by the same angle, which an offset in time cannot do alone
    world = build_world(EAST, CircularConstellation())

    class Turned(CircularConstellation):
        def states(self, time):
            states = super().states(time)
            c, s = math.cos(1.0), math.sin(1.0)
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            return SatelliteStates(states.position_e @ turn.T, states.velocity_e @ turn.T)

    other = build_world(turned, Turned())
    assert other.satellite_ids == world.satellite_ids
    np.testing.assert_allclose(other.satellites[..., 6:], world.satellites[..., 6:], atol=2e-7)
    np.testing.assert_allclose(other.elevation, world.elevation, atol=1e-12)
    np.testing.assert_allclose(other.run, world.run, atol=1e-7)


def replace_longitude(flight, by):
    c, s = math.cos(by), math.sin(by)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return replace(
        flight,
        position_e=flight.position_e @ turn.T,
        velocity_e=flight.velocity_e @ turn.T,
        C_eb=turn @ flight.C_eb,
    )


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"epoch_interval_s": 0.25}, "a multiple of the sample interval 0.1 s, got 0.25"),
        ({"epoch_interval_s": 0.0}, "a multiple of the sample interval"),
        ({"epoch_interval_s": -0.5}, "a multiple of the sample interval"),
        ({"epoch_interval_s": 20.0}, "a run of 10 s holds no epoch of 20"),
        ({"channels": 3}, "`channels` must be a whole number from 4 to 32, got 3"),
        ({"channels": 33}, "`channels` must be a whole number from 4 to 32, got 33"),
        ({"mask_deg": -1.0}, "`mask_deg` must be a number from 0 to 60, got -1"),
        ({"mask_deg": math.nan}, "`mask_deg` must be a number from 0 to 60, got nan"),
        ({"mask_deg": 59.0}, "only [0-3] satellites are above 59 deg at time zero"),
    ],
)
def test_what_cannot_be_is_refused(settings, said):
    with pytest.raises(ValueError, match=said):
        build_world(EAST, CircularConstellation(), **settings)


def test_too_few_satellites_are_refused():
    with pytest.raises(ValueError, match=r"satellites are above 10 deg .* a first fix needs 4"):
        build_world(EAST, CircularConstellation(satellites=8))


def test_no_satellite_in_view_at_all_is_refused():
    class Below(CircularConstellation):
        def states(self, time):
            states = super().states(time)
            return SatelliteStates(states.position_e * np.nan, states.velocity_e)

    with pytest.raises(ValueError, match="only 0 satellites are above 10 deg"):
        build_world(EAST, Below())


def test_local_axes_stand_at_the_true_position(world):
    C_en = world.C_en[3]
    latitude, longitude, height = ecef_to_geodetic(world.position_e[3])
    higher = geodetic_to_ecef(latitude, longitude, height + 100.0) - world.position_e[3]
    np.testing.assert_allclose(C_en.T @ higher, [0.0, 0.0, -100.0], atol=1e-7)
    np.testing.assert_allclose(C_en.T @ world.velocity_e[3], [0.0, 100.0, 0.0], atol=1e-6)
