"""The truth of a run: slots, ranges, visibility, a plain sky, and what is refused."""

import math

import numpy as np
import pytest

from spoofgym.earth.wgs84 import dcm_e_from_n, ecef_to_geodetic, geodetic_to_ecef, range_and_rate
from spoofgym.truth.flight import flight_from_velocity, inverse_kinematics
from spoofgym.truth.run import build_world, make_sky
from spoofgym.truth.satellites import CircularConstellation, SatelliteStates

from ..lazily import Lazily

STEP = 0.1
MASK = math.radians(10.0)


def trajectory(duration, step):
    count = round(duration / step) + 1
    zero = np.zeros(count)
    velocity = np.column_stack([zero, zero + 100.0, zero])
    start = math.radians(45.0), 0.3, 1000.0
    return inverse_kinematics(
        flight_from_velocity("east", *start, velocity, zero, zero, zero + math.pi / 2, step)
    )


EAST, LONG = Lazily(trajectory, 10.0, STEP), Lazily(trajectory, 1800.0, 1.0)


@pytest.fixture(scope="module")
def world():
    return build_world(EAST, CircularConstellation(), epoch_interval_s=0.5)


def test_epochs_follow_the_samples_and_local_axes_stand_at_the_true_position(world):
    assert (world.epochs, world.most_samples) == (21, 5)
    np.testing.assert_allclose(world.epoch_time, np.arange(21) * 0.5, atol=1e-12)
    np.testing.assert_array_equal(world.epoch_end, np.arange(21) * 5)
    np.testing.assert_array_equal(world.imu_time, EAST.time)
    samples = np.hstack([EAST.specific_force_b, EAST.angular_rate_b])
    np.testing.assert_array_equal(world.run[:6].T, samples)
    np.testing.assert_allclose(world.run[6], STEP)
    np.testing.assert_allclose(world.run[7], STEP**-0.5)
    assert world.run.flags.c_contiguous
    for name in ("position_e", "velocity_e", "C_eb"):
        np.testing.assert_array_equal(getattr(world, name), getattr(EAST, name)[::5])
    C_en = world.C_en[3]
    latitude, longitude, height = ecef_to_geodetic(world.position_e[3])
    higher = geodetic_to_ecef(latitude, longitude, height + 100.0) - world.position_e[3]
    np.testing.assert_allclose(C_en.T @ higher, [0.0, 0.0, -100.0], atol=1e-7)
    np.testing.assert_allclose(C_en.T @ world.velocity_e[3], [0.0, 100.0, 0.0], atol=1e-6)


def test_slots_hold_satellites_in_order_and_with_ranges_visible_above_the_mask(world):
    constellation = CircularConstellation()
    states, ids = constellation.states(world.epoch_time), constellation.satellite_ids
    named = [name for name in world.satellite_ids if name]
    assert world.satellite_ids == (*sorted(named), *[""] * (12 - len(named)))
    for array in (world.visible, world.satellites, *world.look(slice(None))):
        assert not array[:, len(named) :].any()
    assert world.visible.any()
    for s, name in enumerate(named):
        j = ids.index(name)
        np.testing.assert_array_equal(world.satellites[:, s, :3], states.position_e[:, j])
        np.testing.assert_array_equal(world.satellites[:, s, 3:6], states.velocity_e[:, j])
        for k in (0, 7, 20):
            p, want = world.satellites[k, s], (0.0, 0.0)
            if world.visible[k, s]:
                want = range_and_rate(p[:3], p[3:6], world.position_e[k], world.velocity_e[k])[:2]
            np.testing.assert_allclose(p[6:], want, rtol=1e-14, atol=1e-9)
    latitude, longitude, _ = ecef_to_geodetic(world.position_e)
    east, north = np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude)
    up = np.column_stack([east, north, np.sin(latitude)])
    states = CircularConstellation().states(world.epoch_time)
    sight = states.position_e - world.position_e[:, None, :]
    sine = np.einsum("kni,ki->kn", sight, up) / np.linalg.norm(sight, axis=-1)
    names = list(CircularConstellation().satellite_ids)
    for k in (0, 20):
        above = np.array(names)[sine[k] > math.sin(MASK)]
        assert np.array(world.satellite_ids)[world.visible[k]].tolist() == above.tolist()
    shown = [names.index(name) for name in world.satellite_ids if name]
    elevation = world.elevation[:, : len(shown)]
    np.testing.assert_allclose(np.sin(elevation), sine[:, shown], atol=1e-14)


def test_azimuth_goes_from_north_by_east():
    azimuth = np.arange(8) * math.pi / 4

    class Ring(CircularConstellation):
        """Eight satellites all around, at equal elevation."""

        def states(self, time):
            sight = np.column_stack(
                [0.766 * np.cos(azimuth), 0.766 * np.sin(azimuth), np.full(8, -0.643)]
            )
            latitude, longitude, _ = ecef_to_geodetic(EAST.position_e[0])
            position = EAST.position_e[0] + 2e7 * sight @ dcm_e_from_n(latitude, longitude).T
            shape = (len(time), 8, 3)
            return SatelliteStates(np.broadcast_to(position, shape), np.zeros(shape))

    ring = build_world(EAST, Ring(satellites=8))
    elevation, found = ring.look(slice(None))
    np.testing.assert_allclose(found[0, :8] % (2 * math.pi), azimuth, atol=1e-9)
    np.testing.assert_allclose(elevation[0, :8], math.atan2(0.643, 0.766), atol=1e-9)


def test_the_satellites_that_stay_longest_are_taken_and_rise_at_the_mask():
    crowd = CircularConstellation(satellites=99)
    few = build_world(LONG, crowd, epoch_interval_s=60.0, channels=8)
    many = build_world(LONG, crowd, epoch_interval_s=60.0, channels=32)
    assert all(few.satellite_ids)
    assert list(few.satellite_ids) == sorted(few.satellite_ids)
    stay = dict(zip(many.satellite_ids, many.visible.sum(axis=0), strict=True))
    taken = [stay.pop(name) for name in few.satellite_ids]
    assert min(taken) >= max(stay.values())
    assert len(set(stay.values())) > 1  # satellites rise and set in half an hour
    for s, name in enumerate(few.satellite_ids):
        other = many.satellite_ids.index(name)
        np.testing.assert_array_equal(few.satellites[:, s], many.satellites[:, other])
    crowd = CircularConstellation(satellites=60)
    world = build_world(LONG, crowd, epoch_interval_s=10.0, channels=32)
    at_once, seen = world.visible[0], world.visible.any(axis=0)
    rising, first = seen & ~at_once, world.first_elevation
    assert rising.any()
    assert (first[rising] > MASK).all()
    np.testing.assert_allclose(first[rising], MASK, atol=0.005)
    np.testing.assert_array_equal(first[at_once], world.elevation[0, at_once])
    np.testing.assert_array_equal(first[~seen], math.pi / 2)


def test_without_an_ephemeris_a_satellite_is_not_visible(world):
    ids = CircularConstellation().satellite_ids
    first, second = (ids.index(name) for name in world.satellite_ids[:2])

    class Gapped(CircularConstellation):
        """Without an ephemeris of one satellite for some time, and of another one at all."""

        def states(self, time):
            position, velocity = (array.copy() for array in super().states(time))
            gap = (np.asarray(time) > 2.0) & (np.asarray(time) < 4.0)
            position[gap, first], velocity[gap, first] = np.nan, np.nan
            velocity[:, second] = np.nan
            return SatelliteStates(position, velocity)

    gapped = build_world(EAST, Gapped())
    assert ids[second] not in gapped.satellite_ids
    assert gapped.satellite_ids[0] == ids[first]
    gap = (gapped.epoch_time > 2.0) & (gapped.epoch_time < 4.0)
    np.testing.assert_array_equal(gapped.visible[:, 0], ~gap)
    for array in (gapped.satellites, *gapped.look(slice(None))):
        assert np.isfinite(array).all()
        assert not array[gap, 0].any()
    np.testing.assert_array_equal(gapped.satellites[~gap, 0], world.satellites[~gap, 0])


@pytest.mark.parametrize(
    ("satellites", "settings", "said"),
    [
        (30, {"epoch_interval_s": 0.25}, "a multiple of the sample interval 0.1 s, got 0.25"),
        (30, {"epoch_interval_s": 20.0}, "a run of 10 s holds no epoch of 20"),
        (30, {"channels": 33}, "`channels` must be a whole number from 4 to 32, got 33"),
        (30, {"mask_deg": -1.0}, "`mask_deg` must be a number from 0 to 60, got -1"),
        (30, {"mask_deg": 59.0}, "needs 4 satellites above 59 deg, got [0-3] at time zero"),
        (8, {}, "a first fix needs 4 satellites above 10 deg"),
    ],
)
def test_what_cannot_be_is_refused(satellites, settings, said):
    with pytest.raises(ValueError, match=said):
        build_world(EAST, CircularConstellation(satellites=satellites), **settings)


CONSTELLATION = CircularConstellation(satellites=36)


def test_the_vehicle_moves_along_its_heading_under_the_highest_satellites():
    sky = make_sky(11, 2.0, 8, CONSTELLATION, speed_mps=30.0, heading_deg=90.0)
    moved = (sky.position_e[-1] - sky.position_e[0]) @ sky.C_en
    np.testing.assert_allclose(moved, [0.0, 600.0, 0.0], atol=1e-6)
    velocity = np.diff(sky.position_e, axis=0) / 2.0
    np.testing.assert_allclose(velocity, np.tile(sky.velocity_e, (10, 1)), atol=1e-6)
    with pytest.raises(ValueError, match=r"`satellites` must be at most \d+, .* got 30"):
        make_sky(3, 1.0, 30, CONSTELLATION)
    sky = make_sky(3, 1.0, 5, CONSTELLATION)
    everyone = CONSTELLATION.states(sky.time).position_e[0] - sky.position_e[0]
    up = -(everyone @ sky.C_en[:, 2]) / np.linalg.norm(everyone, axis=1)
    best = sorted(CONSTELLATION.satellite_ids[j] for j in np.argsort(-up)[:5])
    assert list(sky.satellite_ids) == best
    np.testing.assert_array_equal(
        sky.satellite_position_e[0] - sky.position_e[0],
        everyone[[CONSTELLATION.satellite_ids.index(name) for name in best]],
    )
