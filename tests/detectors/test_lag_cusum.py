"""The lagged CUSUM against a plain one, its run length, and biases."""

import math

import numpy as np
import pytest

from spoofgym.detectors import LagCusum

from .support import belief, context, drawn, epoch, run_length

B, N = 2, 3


def plain(values, lag, baseline, drift):
    """Larger of the two sums after every value of one series."""
    above = below = 0.0
    out = []
    for k, value in enumerate(values):
        older = values[: max(k - lag, math.ceil(k / 2))][-baseline:]
        if len(older):
            change, least = value - np.mean(older), max(drift, 5.0 / math.sqrt(len(older)))
            above = max(0.0, above + change - least)
            below = max(0.0, below - change - least)
        out.append(max(above, below))
    return np.array(out)


@pytest.mark.parametrize(
    ("signals", "lag", "baseline"),
    [("pseudorange", 10, 30), ("range_rate", 1, 1), ("both", 25, 8), ("both", 500, 500)],
)
def test_the_sums_are_plain_ones(signals, lag, baseline):
    rng = np.random.default_rng(0)
    epochs = 120
    S = np.array([belief(rng, B, N) for _ in range(epochs)])
    z = 3.0 * np.array([drawn(rng, S[k]) for k in range(epochs)])
    visible = np.ones((epochs, B, N), dtype=bool)
    visible[50:53, 1, 0] = False
    detector = LagCusum(drift=0.7, threshold=4.0, lag=lag, baseline=baseline, signals=signals)
    detector.bind(context(B, N))
    verdicts = [detector.judge(epoch(z[k], S[k], visible[k])) for k in range(epochs)]
    normalized = z / np.sqrt(np.diagonal(S, axis1=2, axis2=3))
    rows = {"pseudorange": [0], "range_rate": [N], "both": [0, N]}[signals]
    for b in range(B):
        for j in range(N):
            parts = [slice(0, 50), slice(53, epochs)] if (b, j) == (1, 0) else [slice(0, epochs)]
            for part in parts:
                want = np.max(
                    [plain(normalized[part, b, row + j], lag, baseline, 0.7) for row in rows],
                    axis=0,
                )
                got = np.array([verdict.statistic[b, j] for verdict in verdicts[part]])
                np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-9)
    assert any(verdict.alarm.any() for verdict in verdicts)
    for verdict in verdicts:
        np.testing.assert_array_equal(verdict.alarm, verdict.statistic > 4.0)


def test_the_default_threshold_has_the_false_alarms_of_the_paper():
    assert 16.0 / run_length(0.5, 13.3) == pytest.approx(4e-6, rel=0.1)


def test_a_bias_is_no_change_and_a_change_is_found():
    z = np.random.default_rng(2).standard_normal((900, 6))
    z += np.array([0.0, 3.0, -30.0, 0.5, 1.0, -0.7])
    z[600:, 1] -= 4.0
    detector = LagCusum()
    detector.bind(context(1, 6))
    S = np.eye(12)[None]
    alarms = np.array(
        [detector.judge(epoch(np.concatenate([row, 0 * row])[None], S)).alarm[0] for row in z]
    )
    assert not alarms[:600].any()
    assert not alarms[:, [0, 2, 3, 4, 5]].any()
    assert 2 <= np.argmax(alarms[600:, 1]) <= 8
