"""False alarms where the filter's belief is right, by every test of innovations.

Of every receiver one verdict counts, the last one, so that verdicts are independent draws.
"""

import math

import numpy as np
import pytest

from spoofgym.detectors import Cusum, LagCusum, make_detector
from tests.nightly import heavy

from .support import belief, context, epoch, likely

ALPHA = 0.02
EXACT = [
    ({"name": "ewma"}, 1),
    ({"name": "ewma", "smoothing": 0.6}, 4),
    ({"name": "ewma", "weight_scale": None}, 30),
    ({"name": "shewhart"}, 1),
    ({"name": "fma", "window_s": 5.0}, 12),
    ({"name": "fma", "window_s": 5.0, "shape": "ramp"}, 12),
    ({"name": "snapshot-chi2"}, 1),
    ({"name": "sequential-chi2", "window_s": 3.0, "signals": "both"}, 9),
    ({"name": "windowed-chi2", "window": 7}, 9),
    ({"name": "aime", "windows_s": [4.0], "signals": "both"}, 9),
    ({"name": "clock-drift"}, 22),
]
WITHOUT_GAPS = [
    ({"name": "snapshot-chi2", "bias_window_s": 5.0}, 12),
    ({"name": "innovation-rate"}, 300),
]
BOUNDED = [
    ({"name": "glr-step", "window": 20, "baseline": 40}, 60),
    ({"name": "glr-ramp", "window": 20, "baseline": 40}, 60),
    ({"name": "cumulative-bank", "windows_s": [2.0, 8.0, 20.0]}, 44),
    ({"name": "innovation-rate"}, 20),  # which still allows for a level that is not there
    ({"name": "aime", "windows_s": [2.0, 5.0]}, 12),
    ({"name": "shewhart", "signals": "both"}, 1),
    ({"name": "joint-chart", "weight_scale": None}, 30),  # whose alarms can end
]


CASES = [*EXACT, *WITHOUT_GAPS, *BOUNDED]
DAILY = [*EXACT[::5], *WITHOUT_GAPS, *BOUNDED[:3]]
"""Of the others test_statistics.py compares statistic and threshold."""


@pytest.mark.parametrize("case", heavy(CASES, *[c for c in CASES if c not in DAILY]), ids=str)
def test_after_white_innovations_alarms_are_as_rare_as_stated(case):
    (spec, epochs), receivers, channels, rng = case, 4000, 2, np.random.default_rng(1)
    detector = make_detector({**spec, "false_alarm": ALPHA})
    detector.bind(context(receivers, channels))
    S = belief(rng, channels, receivers)
    factor, visible = np.linalg.cholesky(S), np.ones((receivers, channels), dtype=bool)
    for k in range(epochs):
        if case in EXACT:
            visible[:, 1] = rng.uniform(size=receivers) < 0.8
        white = rng.standard_normal((receivers, 2 * channels, 1))
        seen = epoch((factor @ white)[:, :, 0], S, visible.copy())
        alarm = detector.judge(seen._replace(time=np.full(receivers, 0.5 * k))).alarm
    low, high = likely(receivers, ALPHA)
    shared = spec["name"] in ("glr-step", "glr-ramp", "innovation-rate")  # by the satellites
    count = (alarm.any(axis=1) if shared else alarm[:, 0]).sum()
    assert (1 if case in BOUNDED else low) <= count <= high


def run_length(drift, threshold):
    """Mean epochs until a cumulative sum exceeds its threshold without a change, siegmund1985."""
    exponent = 2.0 * drift * (threshold + 1.166)
    return (math.exp(exponent) - exponent - 1.0) / (2.0 * drift * drift)


def test_false_alarms_of_cumulative_sums_are_as_far_apart_as_stated():
    receivers, epochs, limit = 800, 500, 4.0
    rng = np.random.default_rng(1)
    detector = Cusum(limit=limit)
    detector.bind(context(receivers, 1))
    blank = epoch(np.zeros((receivers, 2)), np.eye(2))
    alarms = 0
    for _ in range(epochs):
        z = rng.standard_normal((receivers, 2))
        alarm = detector.judge(blank._replace(innovation=z)).alarm[:, 0]
        alarms += alarm.sum()
        detector.reset(alarm)
    expected = receivers * epochs / (0.5 * run_length(0.5, limit))
    # four standard deviations of a count, and the 1 % that the formula is good for
    assert alarms == pytest.approx(expected, abs=4.0 * math.sqrt(expected), rel=0.01)
    # defaults are those of eight satellites
    assert run_length(0.5, Cusum().limit) / 16.0 == pytest.approx(1e5, rel=0.05)
    assert 16.0 / run_length(0.5, LagCusum().threshold) == pytest.approx(4e-6, rel=0.1)
