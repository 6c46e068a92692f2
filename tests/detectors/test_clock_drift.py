"""What innovations have in common, and nothing else."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import ClockDrift

from .support import belief, context, drawn, epoch

B, N = 3, 5
DESIGN = {
    "pseudorange": np.eye(2)[np.repeat([0, 1], N)][:, :1],
    "range_rate": np.eye(2)[np.repeat([0, 1], N)][:, 1:],
    "both": np.eye(2)[np.repeat([0, 1], N)],
}
ROWS = {"pseudorange": slice(0, N), "range_rate": slice(N, 2 * N), "both": slice(0, 2 * N)}


@pytest.mark.parametrize("signals", DESIGN)
def test_it_is_the_quadratic_form_of_the_least_squares_estimate(signals):
    rng = np.random.default_rng(0)
    S = belief(rng, B, N)
    z = 2.0 * drawn(rng, S)
    detector = ClockDrift(signals=signals, window_s=0.5, false_alarm=0.01)
    detector.bind(context(B, N))
    found = detector.judge(epoch(z, S))
    rows = ROWS[signals]
    A = DESIGN[signals][rows]
    for b in range(B):
        weight = np.linalg.inv(S[b, rows, rows])
        information = A.T @ weight @ A
        estimate = np.linalg.solve(information, A.T @ weight @ z[b, rows])
        want = estimate @ information @ estimate
        np.testing.assert_allclose(found.statistic[b, 0], want, rtol=1e-9)
    np.testing.assert_allclose(found.threshold, scipy.stats.chi2.isf(0.01, A.shape[1]))


def test_the_average_gains_by_its_window():
    """A constant common offset of one standard deviation of the estimate: q grows to W."""
    S = np.tile(np.eye(2 * N), (B, 1, 1))
    z = np.zeros((B, 2 * N))
    z[:, N:] = 1.0 / np.sqrt(N)
    detector = ClockDrift(signals="range_rate", window_s=5.0)
    detector.bind(context(B, N))
    found = [float(detector.judge(epoch(z, S)).statistic[0, 0]) for _ in range(15)]
    np.testing.assert_allclose(found, np.minimum(np.arange(1, 16), 10))


def test_what_cancels_over_the_satellites_is_not_the_clocks():
    S = np.tile(np.eye(2 * N), (B, 1, 1))
    z = np.zeros((B, 2 * N))
    z[:, 0], z[:, 1] = 50.0, -50.0
    detector = ClockDrift()
    detector.bind(context(B, N))
    assert not detector.judge(epoch(z, S)).statistic.any()
