"""Replay against a plain receiver, with satellites that rise and set and uneven epochs."""

from dataclasses import replace

import numpy as np
import pytest

from spoofgym.earth.wgs84 import dcm_e_from_n, ecef_to_geodetic, range_and_rate
from spoofgym.receiver import NavState, NoiseModel, Recording, TightlyCoupled, replay
from spoofgym.truth.flight import inverse_kinematics
from spoofgym.truth.manoeuvres import Climb, Straight, Turn, fly
from spoofgym.truth.satellites import CircularConstellation

from . import reference

N = 10
STEP = 0.02
EPOCH_SAMPLES = (25, 25, 50, 5, 70, 25, 1)
"""Numbers of samples between epochs, in turn."""
SAMPLE_SD = np.repeat([5e-3, 2e-5], 3)


@pytest.fixture(scope="module")
def flight():
    manoeuvres = [Straight(6.0), Turn(30.0), Climb(40.0), Straight(10.0)]
    place = {"latitude_deg": 48.0, "longitude_deg": 11.0, "height_m": 500.0}
    motion = {"speed_mps": 80.0, "heading_deg": 30.0, "rate_hz": 1.0 / STEP}
    return inverse_kinematics(fly(manoeuvres, **place, **motion))


@pytest.fixture(scope="module")
def truth(flight):
    """Satellites in view, (K, N, 3), and their ranges and rates, (K, N), at uneven epochs."""
    ends = np.cumsum(np.resize(EPOCH_SAMPLES, 1000))
    ends = ends[ends < len(flight.time)]
    states = CircularConstellation(satellites=36).states(flight.time[ends])
    latitude, longitude, _ = ecef_to_geodetic(flight.position_e[0])
    up = -dcm_e_from_n(latitude, longitude)[:, 2]
    sight = states.position_e[0] - flight.position_e[0]
    chosen = np.sort(np.argsort(-(sight @ up) / np.linalg.norm(sight, axis=1))[:N])
    position, velocity = states.position_e[:, chosen], states.velocity_e[:, chosen]
    ranges = np.empty((len(ends), N, 2))
    for k, j in np.ndindex(len(ends), N):
        own = flight.position_e[ends[k]], flight.velocity_e[ends[k]]
        ranges[k, j] = range_and_rate(position[k, j], velocity[k, j], *own)[:2]
    return ends, position, velocity, ranges


def recorded(flight, truth):
    ends, position, velocity, ranges = truth
    rng, K, time = np.random.default_rng(0), len(ends), flight.time[ends]
    pseudorange = ranges[..., 0] + 5000.0 + 30.0 * time[:, None]
    pseudorange += rng.normal(0.0, 1.5, (K, N))
    range_rate = ranges[..., 1] + 30.0 + rng.normal(0.0, 0.05, (K, N))
    position, velocity = position.copy(), velocity.copy()
    pseudorange[: K // 3, 2] = np.nan  # rises
    range_rate[K // 2 :, 5] = np.nan  # sets
    position[K // 4 : K // 2, 7, 1] = np.nan  # without an ephemeris for a while
    velocity[::3, 8] = np.nan  # flickers
    pseudorange[K - 6 : K - 3, 3:] = np.nan  # three are left: the receiver coasts
    range_rate[K // 5] = np.nan  # none
    felt = np.hstack([flight.specific_force_b, flight.angular_rate_b])
    felt += np.repeat([2e-3, 1e-5], 3) + rng.normal(0.0, SAMPLE_SD, felt.shape)
    return Recording(
        imu_time=flight.time[1:],
        specific_force_b=felt[:, :3],
        angular_rate_b=felt[:, 3:],
        gnss_time=time,
        pseudorange=pseudorange,
        range_rate=range_rate,
        satellite_position_e=position,
        satellite_velocity_e=velocity,
    )


def initial(flight):
    return NavState(
        position_e=flight.position_e[0] + np.array([3.0, -4.0, 5.0]),
        velocity_e=flight.velocity_e[0] + np.array([0.05, 0.1, -0.05]),
        C_eb=(np.eye(3) + reference.skew([1e-4, -2e-4, 1e-4])) @ flight.C_eb[0],
        clock_bias_m=5004.0,
        clock_drift_mps=30.1,
    )


OWN = NoiseModel(1.5, 0.05, 0.1, 0.01)
RECEIVERS = {
    "tactical": TightlyCoupled(grade="tactical"),
    "plain": TightlyCoupled(grade="aviation", covariance_update="plain"),
    "general": TightlyCoupled(grade="consumer", covariance_update="general"),
    "own noise": TightlyCoupled(grade="tactical", noise=OWN),
    "never coasts": TightlyCoupled(grade="tactical", min_satellites=0),
}


@pytest.mark.parametrize("name", RECEIVERS)
def test_the_replay_is_the_plain_receiver(flight, truth, name):
    receiver, recording = RECEIVERS[name], recorded(flight, truth)
    start, model = initial(flight), receiver.noise_model
    solution = replay(recording, receiver, initial=start)
    R = np.repeat([model.pseudorange_sd**2, model.range_rate_sd**2], N)
    believed = receiver.initial_covariance(), receiver.noise_psd(), R
    rest = start, receiver.min_satellites
    epochs = [*reference.replay(recording, truth[0], *believed, *rest)]
    want = {each: np.array([epoch[each] for epoch in epochs]) for each in epochs[0]}
    # single measurements are of 2e7 m, hence rounded to 4e-9 m
    for names, atol in (
        (("innovation", "position_e"), 1e-6),
        (("velocity_e", "accel_bias_b"), 1e-7),
        (("C_eb", "gyro_bias_b"), 1e-9),
    ):
        for each in names:
            mine, theirs = getattr(solution, each), want[each]
            np.testing.assert_allclose(mine, theirs, rtol=0, atol=atol, err_msg=each)
    np.testing.assert_allclose(solution.clock_bias_m, want["clock"][:, 0], rtol=0, atol=1e-6)
    np.testing.assert_allclose(solution.clock_drift_mps, want["clock"][:, 1], rtol=0, atol=1e-7)
    np.testing.assert_allclose(solution.sd, want["sd"], rtol=1e-7)
    np.testing.assert_array_equal(solution.coasting, want["coasting"])
    assert solution.coasting.any() == (name != "never coasts")
    absent = ~np.isfinite(recording.pseudorange) | ~np.isfinite(recording.range_rate)
    assert not solution.innovation[np.hstack([absent, absent])].any()


def test_what_tells_nothing_changes_nothing(flight, truth):
    recording, last = recorded(flight, truth), truth[0][-1]
    range_rate = np.array(recording.range_rate)
    range_rate[np.isnan(recording.pseudorange)] = 1e9
    samples = ("imu_time", "specific_force_b", "angular_rate_b")
    cut = {name: getattr(recording, name)[:last] for name in samples}
    late = {"gnss_time": recording.gnss_time + 1e-12}  # as times of files are
    whole, *others = (
        replay(replace(recording, **each), TightlyCoupled(), initial=initial(flight)).position_e
        for each in ({}, {"range_rate": range_rate}, cut, late)
    )
    np.testing.assert_array_equal(others[0], whole)
    np.testing.assert_array_equal(others[1], whole)
    np.testing.assert_allclose(others[2], whole, rtol=0, atol=1e-6)


def test_an_orthonormal_attitude_stays_one_and_a_matched_receiver_needs_a_world(flight, truth):
    found, off = [], []
    for conventions in ("groves", "orthonormal"):
        receiver = TightlyCoupled(conventions=conventions)
        C = replay(recorded(flight, truth), receiver, initial=initial(flight)).C_eb
        found.append(C)
        off.append(np.abs(C @ C.transpose(0, 2, 1) - np.eye(3)).max())
    assert off[1] < 1e-12 < off[0]
    np.testing.assert_allclose(*found, rtol=0, atol=1e-6)
    recording, start = recorded(flight, truth), initial(flight)
    with pytest.raises(ValueError, match="a replay knows no world to match"):
        replay(recording, TightlyCoupled(tuning="matched"), initial=start)
    replay(recording, TightlyCoupled(tuning="matched", noise=NoiseModel()), initial=start)


def test_the_noise_may_be_given_by_epoch_and_channel(flight, truth):
    recording, start = recorded(flight, truth), initial(flight)
    receiver = TightlyCoupled(grade="tactical")
    noise = np.tile(np.repeat([6.25, 0.01], N), (len(truth[0]), 1))
    a = replay(recording, receiver, initial=start)
    b = replay(recording, receiver, initial=start, noise_variance=noise)
    np.testing.assert_array_equal(a.position_e, b.position_e)
    without = np.array(recording.pseudorange)
    noise[:, 4], without[:, 4] = 1e12, without[:, 4] + 1e4  # not trusted at all
    wrong = replace(recording, pseudorange=without)
    c = replay(wrong, receiver, initial=start, noise_variance=noise)
    assert np.abs(c.position_e - a.position_e).max() < 5.0
    for bad, said in (
        (noise[:3], "`noise_variance` must be of shape"),
        (0.0 * noise, "at least 1e-08, got 0 in column 0 at"),
        (-noise, "at least 1e-08, got -6.25 in column 0"),
    ):
        with pytest.raises(ValueError, match=said):
            replay(recording, receiver, initial=start, noise_variance=bad)


def with_uneven_samples(even):
    """A recording whose samples are means of some, and where these end."""
    rng, count = np.random.default_rng(3), len(even.imu_time)
    ends = np.union1d(np.flatnonzero(rng.random(count) < 0.6), count - 1)
    lengths = np.diff(ends, prepend=-1)[:, None]
    means = {
        name: np.add.reduceat(getattr(even, name), np.append(0, ends[:-1] + 1)) / lengths
        for name in ("specific_force_b", "angular_rate_b")
    }
    return replace(even, imu_time=even.imu_time[ends], **means), ends


def test_samples_of_uneven_length_are_replayed_as_even_ones(flight, truth):
    receiver, even = RECEIVERS["tactical"], recorded(flight, truth)
    uneven, ends = with_uneven_samples(even)
    between = ~np.isin(truth[0] - 1, ends)
    assert between.sum() > 10
    assert len(uneven.imu_time) == len(ends) + between.sum()
    want, found = (replay(each, receiver, initial=initial(flight)) for each in (even, uneven))
    np.testing.assert_allclose(found.position_e, want.position_e, atol=0.02)
    np.testing.assert_allclose(found.velocity_e, want.velocity_e, atol=0.02)


def small(**changes):
    arrays = {
        "imu_time": TIMES,
        "gnss_time": [0.5, 1.0],
        **dict.fromkeys(("specific_force_b", "angular_rate_b"), np.zeros((10, 3))),
        **dict.fromkeys(("pseudorange", "range_rate"), np.full((2, 4), 2e7)),
        **dict.fromkeys(("satellite_position_e", "satellite_velocity_e"), np.ones((2, 4, 3))),
    }
    return Recording(**arrays | changes)


TIMES = np.arange(1, 11) * 0.1
NOTHING = {
    "gnss_time": [],
    **dict.fromkeys(("pseudorange", "range_rate"), np.ones((0, 4))),
    **dict.fromkeys(("satellite_position_e", "satellite_velocity_e"), np.ones((0, 4, 3))),
}
NOT_A_NUMBER = np.where(np.arange(10)[:, None] == 4, np.nan, np.zeros((10, 3)))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"pseudorange": np.ones(2)}, r"`pseudorange` must have shape \(K, n\), got \(2,\)"),
        ({"specific_force_b": np.zeros((9, 3))}, r"has shape \(9, 3\), but N is 10"),
        ({"range_rate": np.zeros((2, 5))}, r"`range_rate` has shape \(2, 5\), but n is 4"),
        ({"specific_force_b": NOT_A_NUMBER}, "`specific_force_b` must be finite"),
        ({"gnss_time": [0.5, np.nan]}, "`gnss_time` must be finite"),
        ({"imu_time": TIMES[[0, 1, 3, 2, *range(4, 10)]]}, "increase from above 0, .* at index 3"),
        ({"imu_time": TIMES - 0.1}, "`imu_time` must increase from above 0, got 0.0 at index 0"),
        ({"gnss_time": [1.0, 0.5]}, "`gnss_time` must increase from above 0, got 0.5 at index 1"),
        (NOTHING, "at least one sample and one epoch"),
        ({"gnss_time": [0.5, 1.06]}, "half a sample of the epoch at 1.06 s; .* ends at 1.0 s"),
        ({"gnss_time": [1.02, 1.04]}, "the epochs at 1.02 and 1.04 s share a sample"),
        ({"angular_rate_b": np.full((10, 3), 7.0)}, "turns by 1.21 rad .*are the rates in rad/s"),
    ],
)
def test_a_recording_that_cannot_be_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        small(**changes)


def test_samples_are_split_at_epochs_and_a_recording_is_frozen():
    uneven = np.array([0.1, 0.2, 0.4, 0.5, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4])
    unmeasured = np.full((2, 4), np.nan)
    recording = small(imu_time=uneven, gnss_time=[0.31, 1.04], pseudorange=unmeasured)
    np.testing.assert_array_equal(recording.epoch_samples(), [3, 8])
    assert recording.imu_time[[2, 7]].tolist() == [0.31, 1.04]
    assert recording.specific_force_b.shape == (12, 3)
    # as `np.arange` and the times of a file differ
    recording = small(gnss_time=[0.5 + 1e-9, 1.0 - 1e-9])
    np.testing.assert_array_equal(recording.epoch_samples(), [5, 10])
    assert recording.imu_time.tolist() == TIMES.tolist()
    force = np.zeros((10, 3))
    recording = small(specific_force_b=force)
    force[:] = 1.0
    assert not np.any(recording.specific_force_b)
    with pytest.raises(ValueError, match="read-only"):
        recording.specific_force_b[0, 0] = 1.0
