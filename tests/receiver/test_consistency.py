"""A matched receiver believes in the errors that it has, by chi-squares over independent runs.

Inertial sensors have the same biases and errors of scale in every run, as in the reference: for
states that GNSS does not see, the mean over runs has to stay below the upper bound, and above what
an overcautious filter would give.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from spoofgym.receiver import NoiseModel, TightlyCoupled
from spoofgym.receiver.kalman import normalized_innovation_squared
from spoofgym.receiver.matching import WINDOW_S, Motion, compute_motion, inflation, matched_sensors
from spoofgym.receiver.tight import FILTER_GRADES
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


def bounds(degrees, comparisons):
    """Chi-square bounds of a mean square, of which a whole test exceeds one in 1000 times."""
    tail = 0.5 * 1e-3 / comparisons
    return stats.chi2.ppf([tail, 1.0 - tail], degrees) / degrees


def matched(grade):
    return TightlyCoupled(grade=grade, tuning="matched")


def mean_errors(scenario, receiver, times, *groups):
    """Mean normalized error squared by degree of freedom, (groups, times)."""
    simulator = begin(scenario, receiver, RUNS, times[-1])
    rows = []
    for time in times:
        advance_to(simulator, time)
        rows.append([normalized_error_squared(simulator, g).mean() / len(g) for g in groups])
    return np.transpose(rows)


def mean_innovations(scenario, receiver, epochs):
    """Mean normalized innovation squared of ranges and of range rates, and satellites counted."""
    simulator = begin(scenario, receiver, RUNS, 300.0)
    advance_to(simulator, 200.0)
    n, total, satellites = simulator.setup.world.channels, np.zeros(2), 0
    for _ in range(epochs):
        epoch = simulator.advance()
        for half in range(2):
            rows = half * n, half * n + n
            q = normalized_innovation_squared(epoch.innovation, epoch.innovation_cov, *rows)
            total[half] += q.sum()
        satellites += int(epoch.visible.sum())
        simulator.update(None)
    return *(total / satellites), satellites


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
    times = np.array(FLIGHTS[flight])
    scenario = Scenario(flight=flight, errors="white", imu=grade)
    seen, every = mean_errors(scenario, matched(grade), times, OBSERVED, EVERYTHING)
    low, high = bounds(RUNS * len(OBSERVED), len(times))
    assert ((low < seen) & (seen < high)).all(), seen
    known = every[times <= LAST_KNOWN_HEADING_S] if grade == "consumer" else every
    assert (known < bounds(RUNS * len(EVERYTHING), len(times))[1]).all(), every
    assert (every > 0.5).all(), every  # no more than twice the variance of the errors


@pytest.mark.parametrize("grade", heavy(GRADES, "tactical"))
def test_innovations_are_those_of_their_covariance_where_noise_is_white(grade):
    scenario = Scenario(errors="white", imu=grade)
    ranges, rates, satellites = mean_innovations(scenario, matched(grade), 100)
    low, high = bounds(satellites, 2)
    assert low < ranges < high
    # errors of scale are entered as noise at their worst all the time, which for consumer sensors
    # shows in the velocity
    assert (0.8 if grade == "consumer" else low) < rates < high


@pytest.mark.parametrize(
    "case",
    heavy(
        [("zhong2025", "aviation"), ("groves", "aviation"), *[("trolley", g) for g in GRADES]],
        *[("groves", "aviation"), ("trolley", "tactical"), ("trolley", "consumer")],
    ),
    ids=str,
)
def test_position_ends_at_the_spread_of_the_errors(case):
    errors, grade = case
    times = np.array((20.0, 60.0, 110.0, 200.0, 300.0, 400.0))
    groups = POSITION_AND_CLOCK, VELOCITY_AND_DRIFT
    scenario = Scenario(errors=errors, imu=grade)
    position, motion = mean_errors(scenario, matched(grade), times, *groups)
    low, high = bounds(RUNS * 4, len(times))
    assert (motion > (0.7 if grade == "consumer" else low)).all(), motion
    assert (motion < high).all(), motion
    if errors == "trolley":
        assert (position < high).all(), position
        assert position[-1] > low, position
    else:  # of constant biases
        # after k of N epochs the variance is too large by N / k: cautious, and right in the end
        worst = position * times[-1] / times
        assert ((low < worst) & (worst < high)).all(), worst


@pytest.mark.parametrize(("alpha", "epochs"), [(0.0, 5), (0.9, 1), (0.9, 7), (0.986, 700)])
def test_inflation_is_the_variance_of_a_mean(alpha, epochs):
    k = np.arange(epochs)
    correlation = alpha ** np.abs(k[:, None] - k)
    assert inflation(alpha, epochs) == pytest.approx(correlation.sum() / epochs)


def test_noise_in_a_world_of_biases_matched_and_by_the_book():
    setup = begin(Scenario(errors="groves"), matched("aviation"), 1, 100.0).setup
    n, found = setup.world.channels, setup.combinations[0]
    epochs = setup.onset + setup.steps + setup.hold + 1
    np.testing.assert_allclose(found.noise_variance[:n], 1.0 + epochs * found.bias_sd**2)
    np.testing.assert_allclose(found.noise_variance[n:], 0.02**2)
    assert found.noise[2:4] == (0.0, 0.0)
    receiver = TightlyCoupled(tuning="paper")
    setup = begin(Scenario(errors="groves"), receiver, 1, 100.0).setup
    assert setup.combinations[0].noise == NoiseModel()
    assert receiver.sensors(setup.combinations[0].noise) == FILTER_GRADES["aviation"]


def test_the_motion_of_a_steady_turn_and_of_one_step_of_force():
    samples, dt = np.zeros((6, 10000)), 0.01
    samples[5] = 0.02
    samples[0, 5000:] = 3.0

    def motion(length):
        time = np.arange(length + 1) * dt
        end = np.array([0, length])
        return compute_motion(
            SimpleNamespace(imu_time=time, run=samples[:, :length], epoch_end=end), 1
        )

    assert motion(10000).turning == pytest.approx(0.02**2 * WINDOW_S)
    assert motion(10000).forcing == pytest.approx(3.0**2 / WINDOW_S)
    assert motion(150) == Motion(0.0, 0.0)


@pytest.mark.parametrize("grade", GRADES)
def test_without_manoeuvres_the_sensors_are_those_of_the_data_sheet(grade):
    sheet, sensors = IMU_GRADES[grade], matched_sensors(grade, Motion())
    assert sensors.accel_noise_psd == pytest.approx(sheet.noise[0] ** 2)
    assert sensors.gyro_noise_psd == pytest.approx(sheet.noise[1] ** 2)
    assert sensors.accel_bias_psd == sensors.gyro_bias_psd == 0.0
    assert sensors.accel_bias_sd > np.sqrt(np.mean(sheet.accel_bias**2))


@pytest.mark.parametrize("errors", ["white", "groves"])
def test_belief_and_innovations(errors):
    """Innovations by their believed deviations after 200 s at 2 Hz, the beliefs, and NIS a run."""
    runs, epochs = 64, 40
    batch = begin(Scenario(errors=errors), TightlyCoupled(), runs, 300.0)
    batch.run_filter_only(400)
    ratios, nis = [], np.zeros(runs)
    for _ in range(epochs):
        epoch = batch.advance()
        seen = np.tile(epoch.visible[0], 2)
        belief = np.sqrt(epoch.innovation_variance)
        ratios.append((epoch.innovation / belief)[:, seen])
        z, S = epoch.innovation[:, seen], epoch.innovation_cov[:, seen][:, :, seen]
        nis += np.einsum("bi,bi->b", z, np.linalg.solve(S, z[..., None])[..., 0])
        batch.update(None)
    nis /= seen.sum() * epochs
    ranges, rates = (np.sqrt((x**2).mean()) for x in np.split(np.array(ratios), 2, axis=-1))
    range_sd, rate_sd = np.split(belief[0, seen], 2)
    np.testing.assert_allclose(range_sd, 2.7, atol=0.05)
    np.testing.assert_allclose(rate_sd, 0.715, atol=0.005)
    assert rates == pytest.approx(0.03, abs=0.005)
    if errors == "white":
        assert ranges == pytest.approx(0.4, abs=0.05)
        assert nis.mean() == pytest.approx(0.09, abs=0.01)
    else:
        # four of the eight satellites are redundant, so that 64 runs have 256 independent residuals
        # and their root mean square a standard error of 4.4 %; 3 m of biases give 0.95
        assert ranges == pytest.approx(0.95, abs=0.95 * 4.0 * 0.044)
        # 0.23 to 1.6 over draws of the biases
        assert 0.23 < np.median(nis) < 1.6
        assert nis.max() > 2.0 * nis.min()
