"""A matched receiver believes in the errors that it has.

Normalized errors and innovations squared are sums of squares over independent runs, and are
compared with the quantiles of chi-square for that many degrees of freedom.  The inertial sensors
have the same biases and errors of scale in every run, as in the reference, so that for the states
that GNSS does not see the mean over runs is no sample of chi-square: there it has to stay below
the upper bound, and above what an overcautious filter would give.
"""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from spoofgym.receiver import NoiseModel, TightlyCoupled, replay
from spoofgym.receiver.kalman import normalized_innovation_squared
from spoofgym.receiver.matching import WINDOW_S, Motion, compute_motion, inflation, matched_sensors
from spoofgym.receiver.tight import FILTER_GRADES
from spoofgym.simulation.recording import record_run
from spoofgym.truth.scenario import Scenario
from spoofgym.truth.sensors import IMU_GRADES
from tests.nightly import heavy

from ..clean_runs import OBSERVED, advance_to, begin, normalized_error_squared

RUNS = 64
GRADES = sorted(IMU_GRADES)
EVERYTHING = np.arange(17)
VELOCITY_AND_DRIFT = np.array([3, 4, 5, 16])
POSITION_AND_CLOCK = np.array([6, 7, 8, 15])
FLIGHTS = {
    "zhong2025": (20.0, 60.0, 82.0, 110.0, 150.0, 200.0, 230.0, 250.0, 300.0, 350.0),
    "car": (5.0, 10.0, 20.0, 30.0, 40.0, 50.0, 58.0),
}
"""Times [s] in, between and after the manoeuvres."""
LAST_KNOWN_HEADING_S = 250.0
"""The reference's transition matrix takes the specific force of one sample, whose noise a consumer
sensor's filter mistakes for manoeuvres that tell the heading: in the straight end of the flight its
attitude is less certain than it believes."""
FALSE_ALARM = 1e-3
"""Of a whole test, shared by its comparisons."""


def bounds(degrees, comparisons):
    """Two-sided chi-square bounds of a mean square over `degrees` of freedom."""
    tail = 0.5 * FALSE_ALARM / comparisons
    return stats.chi2.ppf([tail, 1.0 - tail], degrees) / degrees


def matched(grade):
    return TightlyCoupled(grade=grade, tuning="matched")


def mean_errors(scenario, receiver, times, *groups):
    """Mean normalized error squared by degree of freedom, (times, groups)."""
    simulator = begin(scenario, receiver, RUNS, times[-1])
    rows = []
    for time in times:
        advance_to(simulator, time)
        rows.append([normalized_error_squared(simulator, g).mean() / len(g) for g in groups])
    return np.array(rows)


@pytest.mark.parametrize(
    "case",
    heavy(
        [(flight, grade) for flight in FLIGHTS for grade in GRADES],
        *[("zhong2025", "tactical"), ("zhong2025", "consumer"), ("car", "aviation")],
    ),
    ids=str,
)
def test_errors_are_those_of_the_covariance_where_noise_is_white(case):
    flight, grade = case
    times = FLIGHTS[flight]
    scenario = Scenario(flight=flight, errors="white", imu=grade)
    seen, every = mean_errors(scenario, matched(grade), times, OBSERVED, EVERYTHING).T
    low, high = bounds(RUNS * len(OBSERVED), len(times))
    assert (seen > low).all(), seen
    assert (seen < high).all(), seen
    known = every[np.array(times) <= LAST_KNOWN_HEADING_S] if grade == "consumer" else every
    _, high = bounds(RUNS * len(EVERYTHING), len(times))
    assert (known < high).all(), every
    assert (every > 0.5).all(), every  # no more than twice the variance of the errors


@pytest.mark.parametrize("grade", heavy(GRADES, "tactical"))
def test_innovations_are_those_of_their_covariance_where_noise_is_white(grade):
    epochs = 100
    simulator = begin(Scenario(errors="white", imu=grade), matched(grade), RUNS, 300.0)
    advance_to(simulator, 200.0)
    n = simulator.setup.world.channels
    ranges, rates, satellites = 0.0, 0.0, 0
    for _ in range(epochs):
        epoch = simulator.advance()
        ranges += normalized_innovation_squared(epoch.innovation, epoch.innovation_cov, 0, n).sum()
        rates += normalized_innovation_squared(
            epoch.innovation, epoch.innovation_cov, n, 2 * n
        ).sum()
        satellites += int(epoch.visible.sum())
        simulator.update(None)
    low, high = bounds(satellites, 2)
    assert low < ranges / satellites < high
    assert rates / satellites < high
    # errors of scale are entered as noise at their worst all the time, which for consumer sensors
    # shows in the velocity
    assert rates / satellites > (0.8 if grade == "consumer" else low)


@pytest.mark.parametrize("errors", heavy(["zhong2025", "groves"], "groves"))
def test_position_ends_at_the_spread_that_constant_biases_give_it(errors):
    times = np.array((20.0, 60.0, 110.0, 200.0, 300.0, 400.0))
    scenario, groups = Scenario(errors=errors), (POSITION_AND_CLOCK, VELOCITY_AND_DRIFT)
    position, motion = mean_errors(scenario, matched("aviation"), times, *groups).T
    low, high = bounds(RUNS * 4, len(times))
    assert (motion > low).all(), motion
    assert (motion < high).all(), motion
    # after k of N epochs the variance is too large by N / k: cautious, and right in the end
    worst = position * times[-1] / times
    assert (worst > low).all(), worst
    assert (worst < high).all(), worst


@pytest.mark.parametrize("grade", heavy(GRADES, "tactical", "consumer"))
def test_position_ends_at_the_spread_of_the_errors_on_the_trolley(grade):
    times = np.array((20.0, 60.0, 110.0, 200.0, 300.0, 400.0))
    scenario, groups = (
        Scenario(errors="trolley", imu=grade),
        (POSITION_AND_CLOCK, VELOCITY_AND_DRIFT),
    )
    position, motion = mean_errors(scenario, matched(grade), times, *groups).T
    low, high = bounds(RUNS * 4, len(times))
    assert (motion > (0.7 if grade == "consumer" else low)).all(), motion
    assert (motion < high).all(), motion
    assert (position < high).all(), position
    assert position[-1] > low, position


def test_range_rates_keep_their_power_among_correlated_errors():
    simulator = begin(Scenario(errors="trolley"), matched("aviation"), RUNS, 300.0)
    advance_to(simulator, 200.0)
    n = simulator.setup.world.channels
    rates, satellites = 0.0, 0
    for _ in range(40):
        epoch = simulator.advance()
        rates += normalized_innovation_squared(
            epoch.innovation, epoch.innovation_cov, n, 2 * n
        ).sum()
        satellites += int(epoch.visible.sum())
        simulator.update(None)
    low, high = bounds(satellites, 1)
    assert low < rates / satellites < high


@pytest.mark.parametrize(("alpha", "epochs"), [(0.0, 5), (0.9, 1), (0.9, 7), (0.986, 700)])
def test_inflation_is_the_variance_of_a_mean(alpha, epochs):
    k = np.arange(epochs)
    correlation = alpha ** np.abs(k[:, None] - k)
    assert inflation(alpha, epochs) == pytest.approx(correlation.sum() / epochs)


def test_taking_constant_biases_for_white_noise_is_what_the_inflation_prevents():
    sensors = matched_sensors("aviation", Motion(0.006, 0.5))
    naive = TightlyCoupled(noise=NoiseModel(2.0**0.5, 0.02, 0.0, 0.0, sensors))
    position = mean_errors(Scenario(errors="zhong2025"), naive, (200.0,), POSITION_AND_CLOCK)
    assert position[0, 0] > 10.0


def test_noise_of_pseudoranges_is_white_variance_and_biases_times_the_epochs():
    setup = begin(Scenario(errors="groves"), matched("aviation"), 1, 100.0).setup
    n = setup.world.channels
    epochs = setup.onset + setup.steps + setup.hold + 1
    np.testing.assert_allclose(
        setup.combinations[0].noise_variance[:n], 1.0 + epochs * setup.combinations[0].bias_sd ** 2
    )
    np.testing.assert_allclose(setup.combinations[0].noise_variance[n:], 0.02**2)
    assert setup.combinations[0].noise[2:4] == (0.0, 0.0)


def run_of(force, rate, dt=0.01):
    """World of given samples (3, N), as far as `compute_motion` looks."""
    samples = np.vstack([force, rate])
    time = np.arange(samples.shape[1] + 1) * dt
    return SimpleNamespace(imu_time=time, run=samples, epoch_end=np.array([0, samples.shape[1]]))


def test_compute_motion_a_steady_turn_and_of_one_step_of_force():
    force, rate = np.zeros((3, 10000)), np.zeros((3, 10000))
    rate[2] = 0.02
    force[0, 5000:] = 3.0
    motion = compute_motion(run_of(force, rate), 1)
    assert motion.turning == pytest.approx(0.02**2 * WINDOW_S)
    assert motion.forcing == pytest.approx(3.0**2 / WINDOW_S)
    assert compute_motion(run_of(force[:, :150], rate[:, :150]), 1) == Motion(0.0, 0.0)


@pytest.mark.parametrize("grade", GRADES)
def test_without_manoeuvres_the_sensors_are_those_of_the_data_sheet(grade):
    sheet, sensors = IMU_GRADES[grade], matched_sensors(grade, Motion())
    assert sensors.accel_noise_psd == pytest.approx(sheet.noise[0] ** 2)
    assert sensors.gyro_noise_psd == pytest.approx(sheet.noise[1] ** 2)
    assert sensors.accel_bias_psd == sensors.gyro_bias_psd == 0.0
    assert sensors.accel_bias_sd > np.sqrt(np.mean(sheet.accel_bias**2))


def test_the_papers_tuning_is_the_books_in_any_world():
    receiver = TightlyCoupled(tuning="paper")
    setup = begin(Scenario(errors="groves"), receiver, 1, 100.0).setup
    assert setup.combinations[0].noise == NoiseModel()
    assert receiver.sensors(setup.combinations[0].noise) == FILTER_GRADES["aviation"]


def test_a_matched_run_replays_to_the_same_bits():
    receiver = matched("tactical")
    setup = begin(Scenario(errors="groves", imu="tactical"), receiver, 1, 100.0).setup
    initial, recording, position_e = record_run(setup, np.random.default_rng(3), epochs=30)
    told = dataclasses.replace(receiver, noise=setup.combinations[0].noise)
    variance = np.tile(setup.combinations[0].noise_variance, (30, 1))
    solution = replay(recording, told, initial=initial, noise_variance=variance)
    np.testing.assert_array_equal(solution.position_e, position_e)
