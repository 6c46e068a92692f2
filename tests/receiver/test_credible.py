"""The credible Kalman filter: its gain, its weights, and fixes that are missing."""

import numpy as np
import pytest

from spoofgym.core.memory import Memory
from spoofgym.receiver.credible import CredibleBatch, CredibleFilter

pytestmark = pytest.mark.nojit


def begun(receivers=2, interval_s=1.0, **settings):
    made = CredibleBatch(CredibleFilter(**settings), Memory(receivers), interval_s)
    made.start_episodes(np.zeros((receivers, 2)))
    return made


def run(made, fixes, increment=0.0, weight=1.0):
    """Filter (K, 2, 2) fixes; returns (K, 2, 2) estimates."""
    out = []
    for k, fix in enumerate(np.asarray(fixes, dtype=float)):
        made.predict(np.full(2, k + 1.0), np.full((2, 2), increment), fix)
        made.update(np.full((2, 2), weight))
        out.append(made.memory["position"][:, :2].copy())
    return np.array(out)


@pytest.mark.parametrize(("interval_s", "drift"), [(0.5, 0.04), (1.0, 0.0)])
def test_the_gain_settles_where_it_is_told(interval_s, drift):
    made = begun(interval_s=interval_s, gain=0.16, drift_rate_mps=drift)
    fixes = np.zeros((61, 2, 2))
    fixes[-1] = 1.0
    assert run(made, fixes)[-1, 0, 0] == pytest.approx(0.16, rel=1e-6)


def test_a_ramp_leads_by_rate_over_gain_and_half_a_weight_moves_half_as_far():
    fixes = np.tile(0.5 * np.arange(1.0, 201.0)[:, None, None], (1, 2, 2))
    lag = fixes - run(begun(), fixes)
    # after the update: a rate of 0.5 m a fix leads by rate / K before it, times 1 - K
    assert lag[-1, 0, 0] == pytest.approx(0.5 / 0.16 * 0.84, rel=1e-6)
    fixes = np.random.default_rng(0).normal(50.0, 1.0, (10, 2, 2))
    found = run(begun(), fixes, 0.3, 0.0)
    np.testing.assert_allclose(found[:, 0, 0], 0.3 * np.arange(1, 11))
    np.testing.assert_allclose(run(begun(), fixes[:1], 0.0, 0.5), 0.5 * run(begun(), fixes[:1]))


def test_the_variance_after_an_outage_grows_with_its_square_and_sets_the_position_anew():
    made = begun(drift_rate_mps=0.04)
    run(made, np.zeros((50, 2, 2)))
    settled = made.memory["covariance"][0, 0, 0]
    run(made, np.full((100, 2, 2), 9.0), weight=0.0)
    q = made.settings.process_noise(1.0)
    assert made.memory["outage"][0] == 100.0
    assert made.memory["covariance"][0, 0, 0] == pytest.approx(settled + 100 * q + 16.0, rel=1e-9)
    assert run(made, np.full((1, 2, 2), 4.0))[0, 0, 0] == pytest.approx(4.0, abs=0.25)
    assert made.memory["outage"][0] == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_missing_fix_is_no_fix(bad):
    made, fixes = begun(), np.full((3, 2, 2), 5.0)
    fixes[1, 0] = bad
    for k, fix in enumerate(fixes):
        epoch = made.predict(np.full(2, k + 1.0), np.full((2, 2), 0.1), fix)
        for name, array in epoch._asdict().items():
            assert name in ("cn0_dbhz", "weights") or np.isfinite(array).all(), name
        if k == 1:
            assert not epoch.design[0].any()
            assert epoch.design[1].any()
            np.testing.assert_array_equal(epoch.innovation_cov[0], np.eye(2))
            np.testing.assert_array_equal(epoch.innovation[0], 0.0)
            np.testing.assert_array_equal(made.memory["interrupted"], [1.0, 0.0])
        before = epoch.predicted_position[0].copy()
        made.update(None)
        same = (made.memory["position"][0] == before).all()
        assert same == (k == 1)
    np.testing.assert_array_equal(made.memory["interrupted"], 0.0)


def test_the_epoch_is_read_only_and_consistent():
    made = begun()
    epoch = made.predict(np.ones(2), np.full((2, 2), 0.5), np.full((2, 2), 3.0))
    np.testing.assert_allclose(epoch.innovation, 2.5)
    S = epoch.predicted_cov + made.settings.noise_variance * np.eye(2)
    np.testing.assert_allclose(epoch.innovation_cov, S)
    np.testing.assert_array_equal(epoch.gnss_position, [[3.0, 3.0, 0.0]] * 2)
    np.testing.assert_array_equal(epoch.auxiliary_position, [[0.5, 0.5, 0.0]] * 2)
    assert not any(array.flags.writeable for array in epoch if array is not None)


def test_the_drift_rate_must_leave_room_for_the_gain():
    with pytest.raises(ValueError, match=r"must be at most 0\.178.* a gain of 0\.16"):
        begun(drift_rate_mps=1.0)
