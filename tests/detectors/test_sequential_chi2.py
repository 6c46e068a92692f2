"""Sums of squares over all history and over a window."""

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import SequentialChi2

from .support import belief, context, drawn, epoch

B, N, K = 3, 4, 30


@pytest.mark.parametrize("window", [None, 1, 7, 1000])
@pytest.mark.parametrize(("signals", "rows"), [("pseudorange", slice(0, N)), ("both", slice(None))])
def test_sums_and_degrees_are_those_of_the_epochs(window, signals, rows):
    rng = np.random.default_rng(0)
    detector = SequentialChi2(
        false_alarm=0.01, window_s=None if window is None else 0.5 * window, signals=signals
    )
    detector.bind(context(B, N))
    squares, degrees = [], []
    for _ in range(K):
        S = belief(rng, B, N)
        visible = rng.uniform(size=(B, N)) < 0.8
        seen = epoch(drawn(rng, S), S, visible)
        found = detector.judge(seen)
        squares.append(
            [
                z[rows] @ np.linalg.solve(C[rows, rows], z[rows])
                for z, C in zip(seen.innovation, seen.innovation_cov, strict=True)
            ]
        )
        degrees.append(visible.sum(axis=1) * (2 if signals == "both" else 1))
        last = slice(None) if window is None else slice(-window, None)
        np.testing.assert_allclose(found.statistic[:, 0], np.sum(squares[last], axis=0))
        d = np.maximum(np.sum(degrees[last], axis=0), 1)
        np.testing.assert_allclose(found.threshold[:, 0], scipy.stats.chi2.isf(0.01, d), rtol=1e-9)
        np.testing.assert_array_equal(found.alarm, found.statistic > found.threshold)
