"""Fewer inertial samples: the same flight, the same sensors, the same errors of the receiver."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.receiver import TightlyCoupled
from spoofgym.receiver.strapdown import strapdown_step
from spoofgym.simulation import LooselyCoupledSetup, SnapshotSetup, TightlyCoupledSetup
from spoofgym.truth.manoeuvres import FLIGHTS
from spoofgym.truth.scenario import SCENARIOS, Scenario
from spoofgym.truth.sensors import IMU_GRADES

from ..clean_runs import advance_to, begin, epoch_of, position_error, velocity_error
from ..truth.sensing import run_of, sensed, sensors_of
from .support import SHORT

RATES = (50.0, 20.0, 10.0)
ODD = {"imu_rate_hz": 20, "epoch_interval_s": 0.13}


def test_the_receiver_s_mechanization_goes_back_along_the_flight():
    rate = 10.0
    world = Scenario(imu_rate_hz=rate).world()
    dt = np.diff(world.imu_time)
    assert dt == pytest.approx(1.0 / rate)
    C, v, r = tuple(world.C_eb[0].ravel()), tuple(world.velocity_e[0]), tuple(world.position_e[0])
    found = [(C, v, r)]
    for i, sample in enumerate(world.run[:6].T.tolist()):
        C, v, r = strapdown_step(C, v, r, tuple(sample[:3]), tuple(sample[3:]), dt[i])
        found.append((C, v, r))
    C, v, r = (np.array([found[k][part] for k in world.epoch_end]) for part in range(3))
    np.testing.assert_allclose(r, world.position_e, rtol=0, atol=2e-7)
    np.testing.assert_allclose(v, world.velocity_e, rtol=0, atol=1e-9)
    np.testing.assert_allclose(C.reshape(-1, 3, 3), world.C_eb, rtol=0, atol=2e-12)


@pytest.mark.parametrize("rate", [50.0, 10.0])
def test_the_flight_is_the_same_to_millimetres(rate):
    own, world = Scenario().world(), Scenario(imu_rate_hz=rate).world()
    for name in ("epoch_time", "visible", "C_eb", "velocity_e"):
        np.testing.assert_array_equal(getattr(world, name), getattr(own, name))
    apart = np.linalg.norm(world.position_e - own.position_e, axis=1).max()
    # the error of a trapezoid: change of the acceleration by dt^2 / 12
    assert 1e-6 < apart < 0.25 / rate**2
    assert (own.decimation, world.decimation) == (1, 100 / rate)


@pytest.mark.parametrize("grade", IMU_GRADES)
def test_increments_are_rounded_before_they_are_summed_up(grade):
    """A sum of quantized samples is what the smaller level makes of the sum."""
    each = 5
    setup = TightlyCoupledSetup(scenario=Scenario(imu=grade, imu_rate_hz=100 / each))
    own, levels = IMU_GRADES[grade].noise, setup.combinations[0].grade.noise
    np.testing.assert_array_equal(levels, own / [1, 1, each, each])
    samples = np.random.default_rng(3).normal(0.02, 3.0, (6, 200)) * np.repeat(own[2:], 3)[:, None]
    longer = samples.reshape(6, -1, each).mean(axis=-1)

    def quantized(truth, level):
        run = run_of(truth, np.full(truth.shape[1], 0.01))
        return sensed(sensors_of(imu_noise=[0.0, 0.0, *level]), run, np.zeros_like(truth))

    longer = quantized(longer, levels[2:])
    summed = quantized(samples, own[2:]).reshape(6, -1, each).mean(axis=-1)
    np.testing.assert_allclose(longer, summed, rtol=0, atol=1e-9 * own[2])


@pytest.mark.parametrize(
    ("kind", "settings", "said"),
    [
        (TightlyCoupledSetup, {"imu_rate_hz": 30}, "0.5 s: 100, 50, 20, 10, 4, 2; got 30"),
        (TightlyCoupledSetup, {"scenario": ODD}, "epochs of 0.13 s: 100, 7.69231; got 20"),
        (LooselyCoupledSetup, {"imu_rate_hz": 50}, "160, 80, 40, 20, 10; got 50"),
        (SnapshotSetup, {"imu_rate_hz": 20}, "imu_rate_hz"),  # which has no such sensors
    ],
)
def test_rates_that_fit_no_sample_are_refused(kind, settings, said):
    with pytest.raises((ValueError, TypeError), match=said):
        kind(**settings)


def test_a_flight_that_turns_too_far_in_a_sample_is_refused():
    car = FLIGHTS["car"]()
    spin = np.arange(len(car.time)) * car.step * np.radians(120.0)
    turn = np.zeros((len(spin), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(spin)
    turn[:, 1, 0], turn[:, 0, 1], turn[:, 2, 2] = np.sin(spin), -np.sin(spin), 1.0
    flight = replace(car, C_eb=car.C_eb @ turn)
    assert Scenario(flight=flight, imu_rate_hz=4).world().decimation == 25
    with pytest.raises(ValueError, match=r"at most 57.2958 deg in a sample, got 6[0-9.]+ deg"):
        Scenario(flight=flight, imu_rate_hz=2).world()


@pytest.mark.parametrize("rate", [None, 20])
def test_the_keyword_is_the_scenario_s_setting(rate):
    setup = TightlyCoupledSetup(scenario="trolley", imu_rate_hz=rate)
    assert setup.scenario == replace(SCENARIOS["trolley"](), imu_rate_hz=rate)
    assert setup.name == ("trolley" if rate is None else "trolley@20Hz")
    assert setup.title.startswith(f"{setup.name}: ")


def test_every_victim_environment_and_duel_take_it():
    loose = LooselyCoupledSetup(imu_rate_hz=20)
    assert (loose.name, loose.world.samples) == ("shadmehri2025@20Hz", 2)
    small = {"timeline": SHORT["tightly-coupled"]["timeline"], "imu_rate_hz": 20}
    one = gym.make("spoofgym/Zhong2025-v0", **small)
    duel = duel_v0.env(scenario="zhong2025", **small)
    for core in (one.unwrapped.core, duel.unwrapped.duel.core):
        assert (core.setup.name, core.setup.world.most_samples) == ("zhong2025@20Hz", 10)
    one.reset(seed=3)
    duel.reset(seed=3)


def statistics(name, rate, receivers, seconds):
    """(3, B) mean squared errors of position and velocity and NIS, over the last quarter."""
    scenario = replace(SCENARIOS[name](), imu_rate_hz=rate)
    victim = TightlyCoupled(grade=scenario.imu)
    simulator = begin(scenario, victim, receivers, seconds)
    advance_to(simulator, 0.75 * seconds)
    found = []
    while epoch_of(simulator) < seconds / scenario.epoch_interval_s:
        epoch = simulator.advance()
        z, S = epoch.innovation, epoch.innovation_cov
        nis = (z * np.linalg.solve(S, z[..., None])[..., 0]).sum(axis=1)
        simulator.update(None)
        errors = (position_error(simulator), velocity_error(simulator))
        found.append([*((error**2).sum(axis=1) for error in errors), nis])
    return np.mean(found, axis=0)


LONG = [
    pytest.param(name, rate, 1024, 300.0, marks=pytest.mark.nightly)
    for name in ("zhong2025", "trolley-tactical", "zhong2025-consumer")
    for rate in RATES
]


@pytest.mark.parametrize(
    ("name", "rate", "receivers", "seconds"), [("zhong2025-tactical", 20.0, 96, 100.0), *LONG]
)
def test_errors_are_those_of_the_flight_s_own_rate(name, rate, receivers, seconds):
    """Means agree within their errors; GNSS errors are the same, and so the bound is tight."""
    own, other = (statistics(name, each, receivers, seconds) for each in (None, rate))
    error = own.std(axis=1, ddof=1) / np.sqrt(receivers)
    apart = np.abs(other.mean(axis=1) - own.mean(axis=1)) / error
    assert (apart < [0.2, 4.0, 0.2]).all(), apart
