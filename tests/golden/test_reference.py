"""The receiver against golden runs of the reference software, epoch by epoch."""

import numpy as np
import pytest

from spoofgym.receiver import TightlyCoupled, least_squares_fix, replay
from spoofgym.receiver.strapdown import strapdown_step

from . import reference


@pytest.fixture(params=sorted(reference.RUNS))
def grade(request):
    return request.param


@pytest.fixture
def run(grade, data_folder):
    return reference.load(data_folder, grade)


@pytest.mark.parametrize("covariance_update", ["unweighted", "plain", "general"])
def test_every_epoch_of_the_replay_is_the_reference(run, grade, covariance_update):
    receiver = TightlyCoupled(grade=grade, covariance_update=covariance_update)
    solution = replay(reference.recording(run), receiver, initial=reference.initial(run))
    want = run["kf_post"]
    for name, expected, absolute in (
        ("time", want[:, 0], 1e-9),
        ("position_e", want[:, 2:5], 1e-7),
        ("velocity_e", want[:, 5:8], 1e-9),
        ("C_eb", want[:, 8:17].reshape(-1, 3, 3).transpose(0, 2, 1), 1e-10),
        ("accel_bias_b", want[:, 17:20], 1e-9),
        ("gyro_bias_b", want[:, 20:23], 1e-12),
        ("clock_bias_m", want[:, 23], 1e-7),
        ("clock_drift_mps", want[:, 24], 1e-8),
    ):
        mine = getattr(solution, name)
        np.testing.assert_allclose(mine, expected, rtol=0, atol=absolute, err_msg=name)
    np.testing.assert_allclose(solution.sd, run["kf_sd"], rtol=1e-9)
    assert not solution.coasting.any()


def test_the_fix_at_time_zero_is_the_reference(run):
    first = run["gnss_meas"][run["gnss_meas"][:, 9] == 1]
    fix = least_squares_fix(first[:, 1], first[:, 2], first[:, 3:6], first[:, 6:9])
    want = run["ls0"][0]
    np.testing.assert_allclose(fix.position_e, want[:3], rtol=0, atol=1e-6)
    np.testing.assert_allclose(fix.velocity_e, want[3:6], rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        [fix.clock_bias_m, fix.clock_drift_mps], want[6:8], rtol=0, atol=1e-6
    )


def test_single_samples_between_two_epochs_are_the_reference(run):
    time, prior = run["profile_used"][:, 0], run["ins_prior"]
    samples = run["imu_true_meas"][:, 6:]
    for i in range(98):  # before the first epoch, so that no bias is estimated yet
        C, v, r = strapdown_step(
            tuple(prior[i, 6:].reshape(3, 3).T.ravel()),
            tuple(prior[i, 3:6]),
            tuple(prior[i, :3]),
            tuple(samples[i + 1, :3]),
            tuple(samples[i + 1, 3:]),
            time[i + 2] - time[i + 1],
        )
        np.testing.assert_allclose(r, prior[i + 1, :3], rtol=0, atol=2e-9)
        np.testing.assert_allclose(v, prior[i + 1, 3:6], rtol=0, atol=1e-12)
        want = prior[i + 1, 6:].reshape(3, 3).T
        np.testing.assert_allclose(np.reshape(C, (3, 3)), want, rtol=0, atol=2e-15)
