from dataclasses import replace

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from spoofgym.earth.wgs84 import EARTH_RATE, GRAVITATIONAL_CONSTANT
from spoofgym.truth.satellites import CircularConstellation, CombinedConstellation

PROPERTY = settings(deadline=None, max_examples=50)
EARTH_RATE_E = np.array([0.0, 0.0, EARTH_RATE])
TIMES = st.floats(-1e5, 1e5)
CONSTELLATIONS = st.builds(
    CircularConstellation,
    satellites=st.integers(1, 40),
    radius_m=st.floats(7e6, 5e7),
    inclination_deg=st.floats(0.0, 180.0),
    time_offset_s=st.floats(-1e5, 1e5),
)


def inertial(time, position_e, velocity_e):
    """Position and velocity in the inertial axes that are the ECEF axes at time 0."""
    a = EARTH_RATE * time
    C_ie = np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0.0, 0.0, 1.0]])
    return position_e @ C_ie.T, (velocity_e + np.cross(EARTH_RATE_E, position_e)) @ C_ie.T


@pytest.mark.parametrize(
    "name", ["golden_aviation_profile1_1Hz.mat", "golden_tactical_profile3_first120s_1Hz.mat"]
)
def test_golden_satellites(data_folder, name):
    rows = scipy.io.loadmat(data_folder / "groves_reference" / name)["gnss_meas"]
    times, epoch = np.unique(rows[:, 0], return_inverse=True)
    position_e, velocity_e = CircularConstellation().states(times)
    distance = np.linalg.norm(position_e[epoch] - rows[:, None, 3:6], axis=-1)
    satellite = distance.argmin(axis=1)
    assert_allclose(position_e[epoch, satellite], rows[:, 3:6], rtol=0, atol=1e-6)
    assert_allclose(velocity_e[epoch, satellite], rows[:, 6:9], rtol=0, atol=1e-9)
    same_epoch = np.diff(epoch) == 0
    assert (np.diff(satellite)[same_epoch] > 0).all()


@PROPERTY
@given(constellation=CONSTELLATIONS, time=TIMES)
def test_orbits_are_circles_in_planes_that_stand_still(constellation, time):
    states = constellation.states([time, 0.0])
    position_i, velocity_i = inertial(time, states.position_e[0], states.velocity_e[0])
    r = constellation.radius_m
    assert_allclose(np.linalg.norm(position_i, axis=-1), r, rtol=1e-13)
    speed = np.sqrt(GRAVITATIONAL_CONSTANT / r)
    assert_allclose(np.linalg.norm(velocity_i, axis=-1), speed, rtol=1e-13)
    assert_allclose(np.vecdot(position_i, velocity_i), 0.0, atol=1e-12 * r * speed)
    normal = np.cross(position_i, velocity_i) / (r * speed)
    first = np.cross(*inertial(0.0, states.position_e[1], states.velocity_e[1])) / (r * speed)
    assert_allclose(normal, first, atol=1e-9)
    assert_allclose(normal[:, 2], np.cos(np.deg2rad(constellation.inclination_deg)), atol=1e-12)
    shifted = replace(constellation, time_offset_s=constellation.time_offset_s + time)
    assert_allclose(shifted.states([0.0]).position_e[0], states.position_e[0], atol=1e-3)


def test_five_satellites_on_each_of_six_planes_have_ids_in_order():
    position_e, velocity_e = CircularConstellation().states([0.0])
    h = np.cross(*inertial(0.0, position_e[0], velocity_e[0]))
    node_deg = np.rad2deg(np.arctan2(h[:, 0], -h[:, 1])) % 360.0
    planes, count = np.unique(np.round(node_deg / 60.0).astype(int) % 6, return_counts=True)
    assert_array_equal(planes, np.arange(6))
    assert_array_equal(count, 5)
    assert_allclose(np.round(node_deg / 60.0) * 60.0, node_deg, atol=1e-9)
    constellation = CircularConstellation()
    assert constellation.satellite_ids == tuple(f"S{k:02d}" for k in range(1, 31))
    for array in constellation.states(np.arange(4)):
        assert array.shape == (4, 30, 3)
        assert array.flags.c_contiguous


def test_constellations_combined_are_those_they_are_made_of():
    own = CircularConstellation()
    other = CircularConstellation(satellites=4, prefix="A", planes=2, radius_m=3e7)
    both = CombinedConstellation((own, other))
    assert both.satellite_ids == tuple(sorted(own.satellite_ids + other.satellite_ids))
    for part in (own, other):
        places = [both.satellite_ids.index(name) for name in part.satellite_ids]
        for found, want in zip(both.states([0.0, 50.0]), part.states([0.0, 50.0]), strict=True):
            assert_array_equal(found[:, places], want)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: CombinedConstellation((CircularConstellation(),) * 2), "'S01' twice"),
        (lambda: CombinedConstellation(()), "at least one constellation, got none"),
        (lambda: CircularConstellation(prefix="g"), "capital letter, A to Z, got 'g'"),
        (lambda: CircularConstellation().states([0.0, np.nan]), "finite, got nan"),
    ],
)
def test_what_cannot_be_is_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()
