"""The credible Kalman filter: its gain, its weights, and fixes that are missing."""

import numpy as np
import pytest

from spoofgym.core.memory import Memory
from spoofgym.receiver.credible import CredibleBatch, CredibleFilter

pytestmark = pytest.mark.nojit


def batch(receivers=2, interval_s=1.0, **settings):
    made = CredibleBatch(CredibleFilter(**settings), Memory(receivers), interval_s)
    made.start_episodes(np.zeros((receivers, 2)))
    return made


def run(made, fixes, increment=0.0, weights=None):
    """Filter (K, B, 2) fixes; returns (K, B, 2) estimates."""
    out = []
    for k, fix in enumerate(np.asarray(fixes, dtype=float)):
        step = np.full(fix.shape, increment)
        made.predict(np.full(len(fix), k + 1.0), step, fix)
        made.update(weights)
        out.append(made.memory["position"][:, :2].copy())
    return np.array(out)


@pytest.mark.parametrize(("interval_s", "drift"), [(0.5, 0.04), (1.0, 0.0)])
def test_the_gain_settles_where_it_is_told(interval_s, drift):
    made = batch(interval_s=interval_s, gain=0.16, drift_rate_mps=drift)
    run(made, np.zeros((60, 2, 2)))
    before = made.memory["position"][0, 0]
    made.predict(np.full(2, 61.0), np.zeros((2, 2)), np.ones((2, 2)))
    made.update(None)
    assert made.memory["position"][0, 0] - before == pytest.approx(0.16, rel=1e-6)


def test_a_ramp_leads_the_estimate_by_rate_over_gain():
    fixes = np.tile(0.5 * np.arange(1.0, 201.0)[:, None, None], (1, 1, 2))
    lag = fixes - run(batch(1), fixes)
    # after the update: a rate of 0.5 m a fix leads by rate / K before it, times 1 - K
    assert lag[-1, 0, 0] == pytest.approx(0.5 / 0.16 * 0.84, rel=1e-6)


def test_with_weight_zero_dead_reckoning_goes_on_alone():
    rng = np.random.default_rng(0)
    found = run(batch(), rng.normal(50.0, 1.0, (10, 2, 2)), 0.3, np.zeros((2, 2)))
    np.testing.assert_allclose(found[:, 0, 0], 0.3 * np.arange(1, 11))


def test_half_a_weight_moves_half_as_far():
    fixes = np.full((1, 2, 2), 8.0)
    whole, half = run(batch(), fixes), run(batch(), fixes, weights=np.full((2, 2), 0.5))
    np.testing.assert_allclose(half, 0.5 * whole)


def test_the_variance_after_an_outage_grows_with_its_square_and_sets_the_position_anew():
    made = batch(1, drift_rate_mps=0.04)
    run(made, np.zeros((50, 1, 2)))
    settled = made.memory["covariance"][0, 0, 0]
    run(made, np.full((100, 1, 2), 9.0), weights=np.zeros((1, 2)))
    q = made.settings.process_noise(1.0)
    assert made.memory["outage"][0] == 100.0
    assert made.memory["covariance"][0, 0, 0] == pytest.approx(settled + 100 * q + 16.0, rel=1e-9)
    assert run(made, np.full((1, 1, 2), 4.0))[0, 0, 0] == pytest.approx(4.0, abs=0.25)
    assert made.memory["outage"][0] == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_missing_fix_is_no_fix(bad):
    made = batch()
    fixes = np.full((3, 2, 2), 5.0)
    fixes[1, 0] = bad
    estimates = []
    for k, fix in enumerate(fixes):
        epoch = made.predict(np.full(2, k + 1.0), np.full((2, 2), 0.1), fix)
        for name, array in epoch._asdict().items():
            if name != "cn0_dbhz":
                assert np.isfinite(array).all(), name
        if k == 1:
            assert not epoch.design[0].any()
            assert epoch.design[1].any()
            np.testing.assert_array_equal(epoch.innovation_cov[0], np.eye(2))
            np.testing.assert_array_equal(epoch.innovation[0], 0.0)
            np.testing.assert_array_equal(made.memory["interrupted"], [1.0, 0.0])
        before = epoch.predicted_position[0].copy()
        made.update(None)
        estimates.append((before, made.memory["position"][0].copy()))
    np.testing.assert_array_equal(*estimates[1])
    np.testing.assert_array_equal(made.memory["interrupted"], 0.0)


def test_the_epoch_is_read_only_and_consistent():
    made = batch()
    epoch = made.predict(np.ones(2), np.full((2, 2), 0.5), np.full((2, 2), 3.0))
    np.testing.assert_allclose(epoch.innovation, 2.5)
    np.testing.assert_allclose(
        epoch.innovation_cov, epoch.predicted_cov + made.settings.noise_variance * np.eye(2)
    )
    np.testing.assert_array_equal(epoch.gnss_position, [[3.0, 3.0, 0.0]] * 2)
    np.testing.assert_array_equal(epoch.auxiliary_position, [[0.5, 0.5, 0.0]] * 2)
    for name, array in epoch._asdict().items():
        if name != "cn0_dbhz":
            assert not array.flags.writeable, name


def test_the_belief_holds_in_a_world_as_it_assumes():
    rng = np.random.default_rng(1)
    runs = 400
    made = batch(runs, drift_rate_mps=0.0)
    q, R = made.settings.process_noise(1.0), made.settings.noise_variance
    truth = rng.normal(0.0, np.sqrt(R), (runs, 2))
    squares = []
    for k in range(60):
        truth += rng.normal(0.0, np.sqrt(q), truth.shape)
        fix = truth + rng.normal(0.0, np.sqrt(R), truth.shape)
        epoch = made.predict(np.full(runs, k + 1.0), np.zeros((runs, 2)), fix)
        squares.append((epoch.innovation**2 / epoch.innovation_cov[:, [0, 1], [0, 1]]).mean())
        made.update(None)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.03)


def test_the_drift_rate_must_leave_room_for_the_gain():
    with pytest.raises(
        ValueError, match=r"`drift_rate_mps` must be at most 0\.178.* a gain of 0\.16"
    ):
        batch(drift_rate_mps=1.0)
