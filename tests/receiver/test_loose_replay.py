"""Recorded positions, and velocities, through the loosely coupled receiver of the engine."""

from dataclasses import replace

import numpy as np
import pytest

from spoofgym.calibration.log import bind_to_log
from spoofgym.earth.wgs84 import dcm_e_from_n, ecef_to_geodetic
from spoofgym.limits.linear import respond
from spoofgym.limits.log_replay import LogReplay
from spoofgym.receiver import (
    ImplausibleWarning,
    InnovationLog,
    LooselyCoupled,
    NavState,
    PositionRecording,
    TightlyCoupled,
    replay,
)
from spoofgym.receiver.epoch import FILTER
from spoofgym.simulation import LooselyCoupledSetup
from spoofgym.simulation.recording import record_loose_run
from spoofgym.truth.flight import inverse_kinematics
from spoofgym.truth.manoeuvres import Climb, Straight, Turn, fly

from ..envs.support import SHORT
from .test_replay import with_uneven_samples

ATTACK = np.array([[0.4, -0.8]])
STEP = 0.02
NOISE = np.repeat([1.5, 2.0, 0.1], [2, 1, 3])  # of positions and velocities, east, north, up
RECEIVER = LooselyCoupled(
    horizontal_sd_m=1.5,
    vertical_sd_m=2.0,
    gyro_noise_deg_per_rth=0.1,
    accel_noise_ug_per_rthz=100.0,
)


@pytest.mark.parametrize("tuning", [None, {"window": 20}])
def test_an_exported_episode_replays_to_the_engines_solution(tuning):
    receiver = {"self_tuning": tuning}
    setup = LooselyCoupledSetup(timeline=SHORT, detector="never", receiver=receiver)
    initial, recording, position_e = record_loose_run(
        setup, np.random.default_rng(5), command=lambda k: ATTACK
    )
    solution = replay(recording, setup.receiver, initial=initial)
    # lengths of samples are differences of times
    np.testing.assert_allclose(solution.position_e, position_e, rtol=0, atol=1e-7)
    assert not solution.flag.any()
    assert solution.measured[:, :3].all()
    assert not solution.measured[:, 3:].any()
    assert np.isnan(solution.clock_bias_m).all()
    assert solution.sd.shape == (len(position_e), 15)
    with pytest.raises(
        ValueError, match=r"takes a Recording, .* TightlyCoupled and PositionRecord"
    ):
        replay(recording, TightlyCoupled(), initial=initial)


@pytest.fixture(scope="module")
def flight():
    manoeuvres = [Straight(8.0), Turn(60.0), Climb(80.0), Straight(60.0), Turn(-90.0)]
    place = {"latitude_deg": 48.0, "longitude_deg": 11.0, "height_m": 500.0}
    motion = {"speed_mps": 80.0, "heading_deg": 30.0, "rate_hz": 1.0 / STEP}
    return inverse_kinematics(fly(manoeuvres, **place, **motion))


@pytest.fixture(scope="module")
def recording(flight):
    """Positions and velocities twice a second, with gaps of either."""
    rng, ends = np.random.default_rng(0), np.arange(25, len(flight.time), 25)
    count = len(flight.time) - 1
    latitude, longitude, _ = ecef_to_geodetic(flight.position_e[ends])
    axes = dcm_e_from_n(latitude, longitude)[:, :, [1, 0, 2]] * [1.0, 1.0, -1.0]
    errors = NOISE * rng.standard_normal((len(ends), 6))
    position = flight.position_e[ends] + np.einsum("kij,kj->ki", axes, errors[:, :3])
    velocity = flight.velocity_e[ends] + np.einsum("kij,kj->ki", axes, errors[:, 3:])
    position[50:54, 1] = velocity[52:58] = np.nan
    return PositionRecording(
        imu_time=flight.time[1:],
        specific_force_b=flight.specific_force_b + 5e-3 * rng.standard_normal((count, 3)),
        angular_rate_b=flight.angular_rate_b + 2e-4 * rng.standard_normal((count, 3)),
        gnss_time=flight.time[ends],
        position_e=position,
        velocity_e=velocity,
    )


def off(flight, solution):
    rows = np.searchsorted(flight.time, solution.time - 1e-6)
    names = "position_e", "velocity_e"
    return [np.linalg.norm(getattr(solution, x) - getattr(flight, x)[rows], axis=1) for x in names]


def test_velocities_improve_the_solution_and_innovations_fit(flight, recording):
    noise = {"noise_variance": NOISE**2}
    without = replay(replace(recording, velocity_e=None), RECEIVER)
    solution = replay(recording, RECEIVER, **noise, fields=FILTER)
    for found in (without, solution):
        assert not found.flag.any()
    (position, velocity), (_, coarse) = off(flight, solution), off(flight, without)
    half = len(velocity) // 2
    assert np.median(velocity[half:]) < min(0.06, np.median(coarse[half:]))
    assert np.median(position[half:]) < 1.5
    gone = np.flatnonzero(~solution.measured.all(axis=1))
    assert solution.coasting.sum() == 2
    assert len(gone) == 8
    checks = {x.signal: x.nis for x in InnovationLog.from_replay(solution).check_signals()}
    assert checks == pytest.approx({"position": 1.0, "velocity": 1.0}, abs=0.25)
    # velocities that are not trusted at all are as none
    vague = np.append(NOISE[:3] ** 2, [1e12] * 3)
    alone = replay(replace(recording, velocity_e=None), RECEIVER, initial=start(flight))
    blind = replay(recording, RECEIVER, initial=start(flight), noise_variance=vague)
    rows = slice(0, 50)  # later an epoch has a velocity alone
    np.testing.assert_allclose(blind.position_e[rows], alone.position_e[rows], atol=0.01)


def start(flight):
    names = "position_e", "velocity_e", "C_eb"
    return NavState(**{name: getattr(flight, name)[0] for name in names})


def test_samples_of_uneven_length_and_epochs_within_one_are_replayed_as_even_ones(recording):
    uneven, ends = with_uneven_samples(recording)
    assert len(uneven.imu_time) > len(ends) + 50
    want, found = (replay(x, RECEIVER, noise_variance=NOISE**2) for x in (recording, uneven))
    np.testing.assert_allclose(found.position_e, want.position_e, atol=0.1)
    np.testing.assert_allclose(found.velocity_e, want.velocity_e, atol=0.05)


def test_a_log_of_it_says_what_an_attack_does(recording):
    solution = replay(recording, RECEIVER, noise_variance=NOISE**2, fields=FILTER)
    log = InnovationLog.from_replay(solution)
    assert (log.channels, log.signals) == (("east", "north", "up"), ("position", "velocity"))
    attacks = LogReplay(log, "never", attack_s=15.0, time_to_alert_s=1.0, live_s=1.0)
    assert bind_to_log("snapshot-chi2", log)[1].channels == 3
    rate, first = 0.5, int(attacks.starts[2])
    run = attacks.linear_run(2)
    response = respond(run, attacks._build_offsets(run, np.full((attacks.steps, 1), rate))[..., 1:])
    latitude, longitude, _ = ecef_to_geodetic(solution.position_e)
    east = dcm_e_from_n(latitude, longitude)[:, :, 1]
    row = int(np.searchsorted(recording.gnss_time, solution.time[first] - 1e-6))
    moved = rate * np.clip(np.arange(len(recording.gnss_time)) - row + 1, 0, attacks.epochs)
    moved *= log.interval_s
    shift, away = east[0] * moved[:, None], east[0] * rate * (moved > 0)[:, None]
    attacked = replace(
        recording, position_e=recording.position_e + shift, velocity_e=recording.velocity_e + away
    )
    other = replay(attacked, RECEIVER, noise_variance=NOISE**2)
    k = first + attacks.epochs - 1
    found = (other.position_e - solution.position_e)[k] @ east[k]
    assert found == pytest.approx(response.position[-1, 1, 0], rel=0.01)


def at_rest(**changes):
    """A receiver that stands for 20 s at the equator, its first axis up."""
    arrays = {
        "imu_time": 0.02 * np.arange(1, 1001),
        "specific_force_b": np.tile([9.8, 0.0, 0.0], (1000, 1)),
        "angular_rate_b": np.zeros((1000, 3)),
        "gnss_time": np.arange(1.0, 20.0),
        "position_e": np.tile([6378137.0, 0.0, 0.0], (19, 1)),
        "velocity_e": np.tile([0.0, 0.3, 0.0], (19, 1)),
    }
    return PositionRecording(**arrays | changes)


def test_without_motion_no_heading_is_found_and_the_message_says_so():
    with pytest.raises(ValueError, match=r"`initial` is not found .* at 1 m/s, .* at 0.3 m/s"):
        replay(at_rest(), RECEIVER, noise_variance=NOISE**2)
    with pytest.raises(ValueError, match=r"`initial` is not found .* follow one another"):
        replay(at_rest(position_e=np.full((19, 3), np.nan)), RECEIVER, noise_variance=NOISE**2)


PLACE, SPEED, FORCE = "position_e", "velocity_e", "specific_force_b"
REFUSED = {
    "degrees": (PLACE, lambda x: x * 0.0 + [48.0, 11.0, 500.0], "latitude, lon"),
    "radians": (PLACE, lambda x: x * 0.0 + [0.8, 0.2, 500.0], "latitude, lon"),
    "km": (PLACE, lambda x: x / 1e3, r"got \[\d{4}\..*is it in km"),
    "knots": (SPEED, lambda x: x * 3600.0 / 1852.0, "is it in knots"),
    "mg": (FORCE, lambda x: x * 1e3, "is it in mg"),
    "zeros": (PLACE, np.nan_to_num, "An absent position must be NaN"),
    "local": (
        SPEED,
        lambda x: 0.0 * np.nan_to_num(x) + [60.0, 52.0, 0.0],
        "it differs from the motion of the positions",
    ),
    "km/h": (SPEED, lambda x: 3.6 * x, "is it in km/h"),
    "held": (
        PLACE,
        lambda x: np.repeat(x[::8], 8, 0)[: len(x)],
        "are positions held from one solution to the next",
    ),
    "g": (FORCE, lambda x: x / 9.8, "is it in g"),
}


@pytest.mark.parametrize("mistake", REFUSED)
def test_what_cannot_be_is_refused_with_its_cause(recording, mistake):
    name, change, said = REFUSED[mistake]
    wrong = replace(recording, **{name: change(np.asarray(getattr(recording, name)))})
    with pytest.raises(ValueError, match=said):
        replay(wrong, RECEIVER, noise_variance=NOISE**2)


def test_positions_may_be_noisier_than_they_move_from_epoch_to_epoch(recording):
    rng, noise = np.random.default_rng(5), np.repeat([30.0, 0.1], 3)
    position = recording.position_e + noise[:3] * rng.standard_normal(recording.position_e.shape)
    found = replay(replace(recording, position_e=position), RECEIVER, noise_variance=noise**2)
    assert not found.flag.any()


def test_noise_must_fit_and_wrong_rates_are_named(recording):
    for noise, said in (
        (None, "assumes no noise of velocities: give `noise_variance`"),
        (NOISE[:3], r"must be of shape \(6,\) or \(\d+, 6\), got shape \(3,\)"),
        (-NOISE, "must be finite and at least 1e-08, got -"),
    ):
        with pytest.raises(ValueError, match=said):
            replay(recording, RECEIVER, noise_variance=noise)
    with pytest.raises(ValueError, match="takes neither velocities nor"):
        replay(recording, LooselyCoupled(self_tuning={"window": 20}), noise_variance=NOISE)
    rate, force = np.asarray(recording.angular_rate_b), np.asarray(recording.specific_force_b)
    for wrong, said in (
        ({"angular_rate_b": 57.3 * rate}, "in deg/s"),
        ({"angular_rate_b": rate / 57.3}, "turned into rad/s twice"),
        ({"angular_rate_b": -rate}, "opposite sign"),
        ({"specific_force_b": -force}, "sign of gravity"),
    ):
        with pytest.warns(ImplausibleWarning, match=f"{said} .*after the start at"):
            replay(replace(recording, **wrong), RECEIVER, noise_variance=NOISE**2)
