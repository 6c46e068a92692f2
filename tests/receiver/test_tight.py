"""Settings of the receiver and of what it begins with, in their units."""

import math

import numpy as np
import pytest

from spoofgym.receiver import NavState, NoiseModel, TightlyCoupled
from spoofgym.receiver.kalman import COVARIANCE_UPDATES
from spoofgym.receiver.tight import FILTER_GRADES

DEG = math.pi / 180.0
MICRO_G = 9.80665e-6


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"pseudorange_sd": math.nan}, "`noise.pseudorange_sd` must be a number above 0, got nan"),
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


def test_what_a_receiver_assumes_is_in_si_units():
    assert TightlyCoupled().noise_model == NoiseModel(2.5, 0.1, 1.0, 1.0)  # more than there is
    own = NoiseModel(1.0, 0.02, 0.0, 0.0)
    assert TightlyCoupled(noise=own).noise_model is own
    for update, code in COVARIANCE_UPDATES.items():
        receiver = TightlyCoupled(covariance_update=update, conventions="orthonormal")
        assert (receiver.covariance_code, receiver.orthonormalize) == (code, True)
    assert not TightlyCoupled().orthonormalize
    P = TightlyCoupled(grade="tactical").initial_covariance()
    sd = [1.0 * DEG, 0.1, 10.0, 1000.0 * MICRO_G, 10.0 * DEG / 3600.0]
    np.testing.assert_array_equal(P, np.diag(np.diag(P)))
    np.testing.assert_allclose(np.sqrt(np.diag(P)), [*np.repeat(sd, 3), 10.0, 0.1])
    psd = TightlyCoupled(grade="aviation").noise_psd()
    want = [(0.004 * DEG / 60.0) ** 2, (40.0 * MICRO_G) ** 2, 0.0, 3e-9, 2e-16]
    np.testing.assert_allclose(psd, [*np.repeat(want, 3), 1.0, 1.0])
    clock = NoiseModel(clock_phase_psd=0.3, clock_frequency_psd=0.4)
    np.testing.assert_array_equal(TightlyCoupled().noise_psd(clock)[15:], [0.3, 0.4])
    np.testing.assert_array_equal(TightlyCoupled(noise=clock).noise_psd()[15:], [0.3, 0.4])


def state(**changes):
    vectors = {"position_e": [6.4e6, 0, 0], "velocity_e": [0, 0, 0], "C_eb": np.eye(3)}
    return NavState(**{**vectors, "clock_bias_m": 1, "clock_drift_mps": 2, **changes})


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
        ({"C_eb": np.ones(9)}, r"`C_eb` must be finite and of shape \(3, 3\)"),
        ({"clock_bias_m": math.inf}, "`clock_bias_m` must be finite, got inf"),
    ],
)
def test_a_solution_that_cannot_be_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        state(**changes)
