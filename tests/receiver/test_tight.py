"""Settings of the receiver and of what it begins with: checked at birth, in their units."""

import math

import numpy as np
import pytest

from spoofgym.receiver import NavState, NoiseModel, TightlyCoupled
from spoofgym.receiver.kalman import COVARIANCE_UPDATES
from spoofgym.receiver.tight import CONVENTIONS, FILTER_GRADES, TUNINGS

DEG = math.pi / 180.0
MICRO_G = 9.80665e-6


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"pseudorange_sd": math.nan}, "`noise.pseudorange_sd` must be a number above 0, got nan"),
        ({"range_rate_sd": 0.0}, "`noise.range_rate_sd` must be a number above 0, got 0"),
        ({"clock_phase_psd": -1.0}, "`noise.clock_phase_psd` must be a number of at least 0"),
        ({"clock_frequency_psd": math.inf}, "`noise.clock_frequency_psd` must be a number of at"),
        (
            {"inertial": FILTER_GRADES["aviation"]._replace(gyro_noise_psd=-1.0)},
            "`noise.inertial.gyro_noise_psd` must be a number of at least 0, got -1",
        ),
    ],
)
def test_an_assumed_noise_is_checked(settings, said):
    with pytest.raises(ValueError, match=said):
        TightlyCoupled(noise=NoiseModel(**settings))


def test_every_setting_that_is_valid_is_taken():
    for grade in FILTER_GRADES:
        for tuning in TUNINGS:
            for update, code in COVARIANCE_UPDATES.items():
                if tuning == "augmented" and update != "unweighted":
                    continue
                for conventions in CONVENTIONS:
                    receiver = TightlyCoupled(
                        grade=grade,
                        tuning=tuning,
                        covariance_update=update,
                        conventions=conventions,
                    )
                    assert receiver.covariance_code == code
                    assert receiver.orthonormalize == (conventions == "orthonormal")
    assert TightlyCoupled(noise=NoiseModel(clock_phase_psd=0.0, clock_frequency_psd=0.0))


def test_the_papers_assume_more_noise_than_there_is():
    assert TightlyCoupled().noise_model == NoiseModel(2.5, 0.1, 1.0, 1.0)
    own = NoiseModel(1.0, 0.02, 0.0, 0.0)
    assert TightlyCoupled(noise=own).noise_model is own


def test_the_covariance_at_time_zero_is_in_si_units():
    P = TightlyCoupled(grade="tactical").initial_covariance()
    sd = np.sqrt(np.diag(P))
    np.testing.assert_array_equal(P, np.diag(np.diag(P)))
    np.testing.assert_allclose(sd[:3], 1.0 * DEG)
    np.testing.assert_allclose(sd[3:6], 0.1)
    np.testing.assert_allclose(sd[6:9], 10.0)
    np.testing.assert_allclose(sd[9:12], 1000.0 * MICRO_G)
    np.testing.assert_allclose(sd[12:15], 10.0 * DEG / 3600.0)
    np.testing.assert_allclose(sd[15:], [10.0, 0.1])


def test_the_process_noise_is_in_si_units():
    psd = TightlyCoupled(grade="aviation").noise_psd()
    np.testing.assert_allclose(psd[:3], (0.004 * DEG / 60.0) ** 2)
    np.testing.assert_allclose(psd[3:6], (40.0 * MICRO_G) ** 2)
    np.testing.assert_array_equal(psd[6:9], 0.0)
    np.testing.assert_allclose(psd[9:12], 3e-9)
    np.testing.assert_allclose(psd[12:15], 2e-16)
    np.testing.assert_array_equal(psd[15:], [1.0, 1.0])
    clock = NoiseModel(clock_phase_psd=0.3, clock_frequency_psd=0.4)
    np.testing.assert_array_equal(TightlyCoupled().noise_psd(clock)[15:], [0.3, 0.4])
    np.testing.assert_array_equal(TightlyCoupled(noise=clock).noise_psd()[15:], [0.3, 0.4])


def state(**changes):
    given = {
        "position_e": [6.4e6, 0, 0],
        "velocity_e": [0, 0, 0],
        "C_eb": np.eye(3),
        "clock_bias_m": 1,
        "clock_drift_mps": 2,
    }
    return NavState(**given | changes)


def test_a_solution_holds_arrays_of_its_own():
    C = np.eye(3)
    solution = state(C_eb=C)
    C[:] = 0.0
    np.testing.assert_array_equal(solution.C_eb, np.eye(3))
    assert solution.position_e.dtype == np.float64
    assert isinstance(solution.clock_bias_m, float)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"position_e": [0.0, 1.0]}, r"`position_e` must be finite and of shape \(3,\)"),
        ({"velocity_e": [0.0, math.nan, 0.0]}, r"`velocity_e` must be finite and of shape"),
        ({"C_eb": np.ones(9)}, r"`C_eb` must be finite and of shape \(3, 3\)"),
        ({"clock_bias_m": math.inf}, "`clock_bias_m` must be finite, got inf"),
        ({"clock_drift_mps": math.nan}, "`clock_drift_mps` must be finite, got nan"),
    ],
)
def test_a_solution_that_cannot_be_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        state(**changes)
