"""Every innovation for itself."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import Shewhart

from .support import belief, context, drawn, epoch

B, N = 4, 5


def judged(z, S, visible=None, **settings):
    chart = Shewhart(**settings)
    chart.bind(context(B, N))
    return chart.judge(epoch(z, S, visible))


@pytest.mark.parametrize("signals", ["pseudorange", "range_rate", "both"])
def test_the_statistic_is_the_innovation_in_standard_deviations(signals):
    rng = np.random.default_rng(0)
    S = belief(rng, B, N)
    z = 3.0 * drawn(rng, S)
    visible = rng.uniform(size=(B, N)) < 0.8
    found = judged(z, S, visible, signals=signals, false_alarm=0.01)
    size = np.abs(z) / np.sqrt(np.diagonal(S, axis1=1, axis2=2))
    parts = {"pseudorange": size[:, :N], "range_rate": size[:, N:]}
    want = parts.get(signals, np.maximum(size[:, :N], size[:, N:]))
    np.testing.assert_allclose(found.statistic, np.where(visible, want, 0.0))
    tests = 2 if signals == "both" else 1
    np.testing.assert_allclose(found.threshold, scipy.stats.norm.isf(0.005 / tests))
    np.testing.assert_array_equal(found.alarm, found.statistic > found.threshold)
    assert found.weights is None


def test_it_weighs_pseudoranges_down_where_it_is_told_to():
    z = np.zeros((B, 2 * N))
    z[:, 0], z[:, 1], z[:, 2] = 1.0, 1.8, 4.0
    z[:, N] = 9.0
    S = np.tile(np.eye(2 * N), (B, 1, 1))
    found = judged(
        z, S, false_alarm=2.0 * scipy.stats.norm.sf(5.0), weight_scale=0.5, min_satellites=0
    )
    # full weight up to 1.25, none from 2.5 on
    want = [1.0, 1.25 / 1.8 * (0.7 / 1.25) ** 2, 0.0, *np.ones(2 * N - 3)]
    np.testing.assert_allclose(found.weights, np.tile(want, (B, 1)))
