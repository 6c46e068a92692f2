"""The finite moving average: its sums, its rate of false alarms, and what each shape is for."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import FiniteMovingAverage

from .support import belief, context, drawn, epoch

B, N = 3, 4


@pytest.mark.nojit
@pytest.mark.parametrize("signals", ["pseudorange", "range_rate", "both"])
@pytest.mark.parametrize("shape", ["step", "ramp"])
def test_it_is_the_normalized_sum_of_a_window(signals, shape):
    """Satellites that are away count in neither sum."""
    rng = np.random.default_rng(0)
    S = belief(rng, B, N)
    detector = FiniteMovingAverage(false_alarm=0.01, window_s=2.5, shape=shape, signals=signals)
    detector.bind(context(B, N))
    weights = np.arange(1.0, 6.0) if shape == "ramp" else np.ones(5)
    rows = {"pseudorange": [0], "range_rate": [1], "both": [0, 1]}[signals]
    past, shown = [], []
    for k in range(14):
        visible = rng.random((B, N)) < 0.8
        z = drawn(rng, S)
        found = detector.judge(epoch(z, S, visible))
        u = z / np.sqrt(np.einsum("bii->bi", S))
        past.append(np.where(visible[:, None], u.reshape(B, 2, N), 0.0))
        shown.append(visible)
        c = weights[-len(past[-5:]) :, None, None]
        total = np.abs((c[..., None] * np.array(past[-5:])).sum(axis=0))
        squares = (c**2 * np.array(shown[-5:])).sum(axis=0)
        want = np.where(visible, total[:, rows].max(axis=1) / np.sqrt(np.maximum(squares, 1e-9)), 0)
        np.testing.assert_allclose(found.statistic, want, rtol=1e-12, err_msg=str(k))
    quantile = scipy.stats.norm.isf(0.005 / len(rows))
    np.testing.assert_allclose(found.threshold, quantile, rtol=1e-9)
    assert found.weights is None


@pytest.mark.parametrize("shape", ["step", "ramp"])
def test_white_innovations_alarm_as_often_as_it_says(shape):
    receivers, rng = 500, np.random.default_rng(2)
    S = np.tile(np.eye(2 * N), (receivers, 1, 1))
    detector = FiniteMovingAverage(false_alarm=0.02, window_s=5.0, shape=shape)
    detector.bind(context(receivers, N))
    rates = []
    for k in range(200):
        found = detector.judge(epoch(rng.standard_normal((receivers, 2 * N)), S))
        if k % 10 == 9:  # windows that do not overlap
            rates.append(found.alarm.mean())
    assert np.mean(rates) == pytest.approx(0.02, abs=5.0 * np.sqrt(0.02 / (len(rates) * 2000)))


def test_an_old_fault_is_forgotten_with_the_window():
    S = np.tile(np.eye(2 * N), (1, 1, 1))
    detector = FiniteMovingAverage(window_s=3.0)
    detector.bind(context(1, N))
    assert detector.memory_epochs == 6
    z = np.zeros((1, 2 * N))
    z[0, 0] = 100.0
    assert detector.judge(epoch(z, S)).alarm[0, 0]
    sizes = [detector.judge(epoch(0.0 * z, S)).statistic[0, 0] for _ in range(6)]
    np.testing.assert_allclose(sizes, [*(100.0 / np.sqrt(range(2, 7))), 0.0])
