"""What tests of innovations share: rows, whitening, first windows, thresholds and weights."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.detectors import Shewhart, make_detector
from spoofgym.detectors.innovation import (
    chi2_lower_thresholds,
    chi2_thresholds,
    igg3_weight,
    select_rows,
    two_sided_quantile,
    whiten,
)

from .support import belief, context, drawn, epoch, judge_all

B, N = 4, 5
WITH_BIAS_WINDOW = ["aime", "clock-drift", "cusum", "sequential-chi2", "shewhart", "snapshot-chi2"]


@pytest.mark.parametrize("signals", ["pseudorange", "range_rate", "both"])
def test_whitened_rows_are_those_of_the_factor_of_what_is_judged(signals):
    rng = np.random.default_rng(0)
    S = belief(rng, N, B)
    z = drawn(rng, S)
    judged = rng.uniform(size=(B, N)) < 0.7
    first, last = select_rows(signals, N)
    out = np.empty((B, last - first))
    whiten(z, S, judged, first, last, out)
    for b in range(B):
        rows = [r for r in range(first, last) if judged[b, r % N]]
        want = np.zeros(last - first)
        factor = np.linalg.cholesky(S[b][np.ix_(rows, rows)])
        want[np.array(rows) - first] = np.linalg.solve(factor, z[b, rows])
        np.testing.assert_allclose(out[b], want, rtol=1e-10)


def test_a_covariance_that_is_none_is_no_reason_to_be_quiet():
    out = np.empty((1, 2))
    judged = np.ones((1, 2), dtype=bool)
    whiten(np.ones((1, 4)), np.diag([1.0, -1.0, 1.0, 1.0])[None], judged, 0, 2, out)
    np.testing.assert_array_equal(out, np.inf)


def test_the_mean_of_the_first_epochs_is_taken_away_and_no_channel_judged_before():
    window, epochs = 6, 20
    S = np.tile(np.eye(2 * N), (B, 1, 1))
    z = np.random.default_rng(1).standard_normal((epochs, B, 2 * N)) + 7.0
    visible = np.ones((epochs, B, N), dtype=bool)
    visible[:4, :, 1] = False  # rises, and is calibrated later
    visible[8:10, :, 2] = False  # keeps its bias while it is away
    detector = Shewhart(bias_window_s=0.5 * window)
    detector.bind(context(B, N))
    for k in range(epochs):
        out, judged = detector._without_bias(epoch(z[k], S, visible[k]))
        want = visible[k] & (np.array([k, k - 4, k, k, k]) >= window)
        np.testing.assert_array_equal(judged, want)
        assert not out[:, :N][~judged].any()
    scale = np.sqrt(1.0 + 1.0 / window)
    for column, since in ((1, 4), (2, 0), (N, 0)):
        mean = z[since : since + window, :, column].mean(axis=0)
        np.testing.assert_allclose(out[:, column], (z[-1, :, column] - mean) / scale)


@pytest.mark.parametrize("name", WITH_BIAS_WINDOW)
def test_with_a_bias_window_a_constant_bias_is_no_attack_but_a_later_one_is(name):
    rng = np.random.default_rng(2)
    receivers, window = 20, 200
    z = rng.standard_normal((window + 150, receivers, 2 * N))
    z += 2.0 * rng.choice([-1.0, 1.0], size=(receivers, 2 * N))
    z[window + 50 :] += 8.0
    found = judge_all(make_detector({"name": name, "bias_window_s": 0.5 * window}), z)
    alarm = found.alarm.any(axis=2)
    assert not alarm[:window].any()
    assert not found.statistic[:window].any()
    assert np.isfinite(found.threshold).all()
    # the mean of 200 epochs is still off by 0.07, which tests seldom see within 50 epochs
    assert alarm[: window + 50].any(axis=0).mean() <= 0.1
    assert alarm[-1].all()
    if name != "shewhart":  # 2 of 4.4 standard deviations are no snapshot's business
        plain = judge_all(make_detector(name), z[: window + 50])
        assert plain.alarm.any(axis=(0, 2)).mean() > 0.5


@pytest.mark.parametrize("alpha", [1e-9, 1e-3, 0.5, 0.999])
def test_quantiles_are_those_of_the_distributions(alpha):
    degrees = np.arange(1, 200)
    assert two_sided_quantile(alpha) == pytest.approx(scipy.stats.norm.isf(alpha / 2.0), rel=1e-12)
    thresholds = chi2_thresholds(alpha, 199)
    np.testing.assert_allclose(thresholds[1:], scipy.stats.chi2.isf(alpha, degrees), rtol=1e-9)
    assert thresholds[0] == thresholds[1]  # finite where there is nothing to exceed it
    lower = chi2_lower_thresholds(alpha, degrees.astype(float))
    np.testing.assert_allclose(lower, scipy.stats.chi2.ppf(alpha, degrees), rtol=1e-9)


@pytest.mark.nojit
@given(st.floats(0.0, 10.0), st.floats(0.01, 5.0), st.floats(0.01, 5.0))
def test_a_weight_is_that_of_its_definition(size, accept, width):
    reject = accept + width
    weight = igg3_weight(size, accept, reject)
    if size <= accept:
        assert weight == 1.0
    elif size > reject:
        assert weight == 0.0
    else:
        want = accept / size * ((reject - size) / (reject - accept)) ** 2
        assert weight == pytest.approx(want, rel=1e-12)
