"""Biases of the inertial sensors that wander during a run: in the world, and in its recordings."""

from dataclasses import replace

import numpy as np
import pytest

from spoofgym.core.settings import describe
from spoofgym.receiver import ImplausibleWarning, replay
from spoofgym.receiver.matching import Motion, matched_sensors
from spoofgym.simulation import LooselyCoupledSetup, TightlyCoupledSetup
from spoofgym.simulation.recording import record_run
from spoofgym.simulation.simulator import run_serially
from spoofgym.truth.scenario import Scenario, make_scenario
from spoofgym.truth.sensors import IMU_GRADES

SHORT = {"warmup_s": 10.0, "live_s": 5.0, "attack_s": 20.0, "time_to_alert_s": 1.0}
WANDERING = {"imu_rate_hz": 20.0, "in_run": "wandering"}


def begun(receivers, first=0, domain=None, **scenario):
    setup = TightlyCoupledSetup(
        scenario={**WANDERING, **scenario}, detector="never", timeline=SHORT, domain=domain
    )
    simulator = setup.simulator(receivers, run_serially)
    simulator.start_episodes([np.random.default_rng(first + row) for row in range(receivers)])
    return simulator


@pytest.fixture
def restless(monkeypatch):
    """Tactical sensors whose biases forget themselves within seconds."""
    monkeypatch.setitem(IMU_GRADES, "tactical", IMU_GRADES["tactical"]._replace(in_run_s=5.0))


def test_biases_are_stationary_and_forget_themselves_as_the_grade_says(restless):
    runs, grade = 400, IMU_GRADES["tactical"]
    simulator, seen = begun(runs, imu="tactical"), []
    for _ in range(4):
        seen.append(simulator.sensors.in_run["bias"] / np.repeat(grade.in_run, 3))
        simulator.run_filter_only(5)
    x, lag = np.array(seen), np.exp(-2.5 / 5.0)
    slack = 5.0 / np.sqrt(6 * runs)  # of five standard deviations
    assert np.abs(x.mean(axis=(1, 2))).max() < slack
    np.testing.assert_allclose((x**2).mean(axis=(1, 2)), 1.0, atol=1.5 * slack)
    for k in (1, 2, 3):
        np.testing.assert_allclose((x[k:] * x[:-k]).mean(), lag**k, atol=1.5 * slack)
    across = np.corrcoef(x[-1].T) - np.eye(6)
    assert np.abs(across).max() < 5.0 / np.sqrt(runs)


def test_a_receiver_is_the_same_in_any_batch_and_any_stretch():
    domain = {"imu": ["aviation", "tactical"], "turn_on": "drawn"}
    whole, part = begun(11, domain=domain), begun(1, 9, domain=domain)
    whole.run_filter_only(12)
    for count in (1, 4, 7):
        part.run_filter_only(count)
    for field in ("position_e", "C_eb", "accel_bias_b", "packed_covariance"):
        assert whole.buffers.fields[field][9].tobytes() == part.buffers.fields[field].tobytes()
    assert whole.sensors.in_run["bias"][9].tobytes() == part.sensors.in_run["bias"].tobytes()
    sds = np.array([IMU_GRADES[name].in_run for name in domain["imu"]])
    biases, grades = np.abs(whole.sensors.in_run["bias"]), whole.memory["combination"] % 2
    assert (biases < 5.0 * np.repeat(sds[grades], 3, axis=1)).all()
    whole.copy_rows(np.array([0]), part, np.array([0]))
    assert whole.sensors.in_run["bias"][0].tobytes() == part.sensors.in_run["bias"].tobytes()


def test_the_samples_have_the_wandering_biases_in_them_and_a_recording_has_them_too(monkeypatch):
    still = IMU_GRADES["tactical"]
    monkeypatch.setitem(IMU_GRADES, "tactical", still._replace(accel_in_run_ug=1e5, in_run_s=2.0))
    setup = begun(1, imu="tactical").setup
    initial, recording, position_e = record_run(setup, np.random.default_rng(3), epochs=20)
    constant = TightlyCoupledSetup(
        scenario=replace(setup.scenario, in_run="constant"), detector="never", timeline=SHORT
    )
    _, without, _ = record_run(constant, np.random.default_rng(3), epochs=20)
    apart = recording.specific_force_b - without.specific_force_b
    # the same over the ten samples of an interval, but for quantization
    level = still.noise[2] * 5 * 20.0
    assert np.ptp(apart.reshape(20, 10, 3), axis=1).max() <= 2.1 * level
    assert apart.reshape(20, 10, 3).mean(axis=1).std() > 0.3
    assert np.ptp(recording.angular_rate_b - without.angular_rate_b) < 1.0
    with pytest.warns(ImplausibleWarning, match="epochs are flagged"):  # 1 m/s^2 that wanders
        solution = replay(recording, setup.receiver, initial=initial)
    np.testing.assert_array_equal(solution.position_e, position_e)


def test_a_matched_receiver_takes_the_process_for_a_random_walk():
    for grade, sheet in IMU_GRADES.items():
        off, on = (matched_sensors(grade, Motion(2.0, 3.0), each) for each in (False, True))
        accel, gyro = sheet.in_run**2
        np.testing.assert_allclose(on.accel_bias_psd - off.accel_bias_psd, 2.0 * accel / 1000.0)
        np.testing.assert_allclose(on.gyro_bias_psd - off.gyro_bias_psd, 2.0 * gyro / 1000.0)
        np.testing.assert_allclose(on.accel_bias_sd**2 - off.accel_bias_sd**2, accel)
        np.testing.assert_allclose(on.gyro_bias_sd**2 - off.gyro_bias_sd**2, gyro)
    matched = {"receiver": "matched", "scenario": {**WANDERING, "imu": "tactical"}}
    noise = TightlyCoupledSetup(**matched, detector="never", timeline=SHORT).combinations[0].noise
    assert noise.inertial.gyro_bias_psd >= 2.0 * IMU_GRADES["tactical"].in_run[1] ** 2 / 1000.0


def test_it_is_a_world_of_its_own_and_what_cannot_wander_is_refused():
    assert "in_run" not in describe(Scenario())
    assert describe(Scenario(in_run="wandering"))["in_run"] == "wandering"
    assert make_scenario({"name": "trolley", "in_run": "constant"}).in_run == "constant"
    simulator = begun(2, in_run="constant")
    assert not simulator.sensors.in_run.rows
    assert not simulator.sensors.in_run.data.size
    with pytest.raises(ValueError, match=r"`in_run` must be .*wandering.*'walking'"):
        Scenario(in_run="walking")
    with pytest.raises((TypeError, ValueError), match="scenario"):
        LooselyCoupledSetup(scenario={"in_run": "wandering"})
