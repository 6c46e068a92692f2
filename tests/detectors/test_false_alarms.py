"""False alarms where the filter's belief is right, by every test of innovations.

Of every receiver one verdict counts, the last one, so that verdicts are independent draws.
"""

import math
from functools import cache

import numpy as np
import pytest

from spoofgym.detectors import (
    CumulativeBank,
    Cusum,
    DetectorContext,
    Ewma,
    FiniteMovingAverage,
    GlrRamp,
    GlrStep,
    InnovationRate,
    LagCusum,
    Never,
    SnapshotChi2,
    WindowedChi2,
    make_detector,
)
from spoofgym.simulation import Engine, TightlyCoupledSetup

from .support import belief, context, epoch, likely

ALPHA = 0.02
EXACT = {
    "ewma at first": (Ewma(false_alarm=ALPHA), 1),
    "ewma later": (Ewma(false_alarm=ALPHA, smoothing=0.6), 4),
    "fma step": (FiniteMovingAverage(false_alarm=ALPHA, window_s=5.0), 12),
    "fma ramp": (FiniteMovingAverage(false_alarm=ALPHA, window_s=5.0, shape="ramp"), 12),
    "pseudoranges": (SnapshotChi2(false_alarm=ALPHA, signals="pseudorange"), 1),
    "range rates": (SnapshotChi2(false_alarm=ALPHA, signals="range_rate"), 1),
    "both": (SnapshotChi2(false_alarm=ALPHA), 1),
    "window": (WindowedChi2(false_alarm=ALPHA, window=7), 9),
}
SHARED = {
    "glr step": (GlrStep(false_alarm=ALPHA, window=20, baseline=40), 60),
    "glr ramp": (GlrRamp(false_alarm=ALPHA, window=20, baseline=40), 60),
    "bank": (CumulativeBank(ALPHA, (2.0, 8.0, 20.0)), 44),
    "rate at first": (InnovationRate(false_alarm=ALPHA), 20),
    "rate later": (InnovationRate(false_alarm=ALPHA), 300),
}


@pytest.mark.parametrize("name", [*EXACT, *SHARED])
def test_after_white_innovations_alarms_are_as_rare_as_stated(name):
    """Or rarer where satellites share them out, and while a filter allows for more than there is.

    Each receiver believes something else; satellites but the first come and go where each verdict
    is of one epoch or window.
    """
    receivers, channels, rng = 4000, 2, np.random.default_rng(1)
    detector, epochs = {**EXACT, **SHARED}[name]
    detector.bind(context(receivers, channels))
    S = belief(rng, channels, receivers)
    factor, visible = np.linalg.cholesky(S), np.ones((receivers, channels), dtype=bool)
    for k in range(epochs):
        if name in EXACT:
            visible[:, 1] = rng.uniform(size=receivers) < 0.8
        white = rng.standard_normal((receivers, 2 * channels, 1))
        seen = epoch((factor @ white)[:, :, 0], S, visible.copy())
        alarm = detector.judge(seen._replace(time=np.full(receivers, 0.5 * k))).alarm
    low, high = likely(receivers, ALPHA)
    count = alarm[:, 0].sum() if name in EXACT else alarm.any(axis=1).sum()
    assert (low if name in EXACT or name == "rate later" else 1) <= count <= high


def run_length(drift, threshold):
    """Mean epochs until a cumulative sum exceeds its threshold without a change, siegmund1985."""
    exponent = 2.0 * drift * (threshold + 1.166)
    return (math.exp(exponent) - exponent - 1.0) / (2.0 * drift * drift)


def test_false_alarms_of_cumulative_sums_are_as_far_apart_as_stated():
    """Restarted at each of them; their number is that of a renewal process."""
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


# --- in the engine: white noise, no biases, tuning "matched" -------------------------------------

RECEIVERS, EPOCHS, ALPHA_RUN = 1000, 100, 0.05
PASSIVE = {
    "snapshot-chi2": {},
    "snapshot-chi2, calibrated": {"name": "snapshot-chi2", "bias_window_s": 10.0},
    "sequential-chi2": {},
    "sequential-chi2, 15 s": {"name": "sequential-chi2", "window_s": 15.0},
    "sequential-chi2, both": {"name": "sequential-chi2", "signals": "both", "window_s": 15.0},
    "aime": {"windows_s": [10.0]},
    "aime, both": {"name": "aime", "signals": "both", "windows_s": [25.0]},
    "clock-drift": {},
    "clock-drift, range rates": {"name": "clock-drift", "signals": "range_rate"},
    "shewhart": {},
    "shewhart, range rates": {"name": "shewhart", "signals": "range_rate"},
    "ewma": {"weight_scale": None},
}
BOUNDED = {
    "aime, shared": {"name": "aime", "windows_s": [5.0, 25.0, 45.0]},
    "shewhart, both": {"name": "shewhart", "signals": "both"},
    "joint-chart": {"weight_scale": None},
}


@cache
def last_alarms():
    """Alarms of the last epoch, by label; of the first satellite where every one is judged."""
    phases = {"warmup_s": 60.0, "live_s": 0.0, "attack_s": 0.5 * EPOCHS, "time_to_alert_s": 0.0}
    setup = TightlyCoupledSetup(
        scenario="zhong2025-white",
        receiver={"tuning": "matched"},
        detector=Never(),
        timeline=phases,
    )
    setup.fields = setup.has
    engine = Engine(RECEIVERS, setup, threads=1)
    engine.reset([np.random.default_rng([7, i]) for i in range(RECEIVERS)])
    detectors = {
        label: make_detector({"name": label, "false_alarm": ALPHA_RUN, **spec})
        for label, spec in {**PASSIVE, **BOUNDED}.items()
    }
    told = DetectorContext(
        RECEIVERS,
        setup.world.channels,
        setup.interval_s,
        setup.combinations[0].noise_variance.copy(),
        setup.world.satellite_ids,
    )
    for detector in detectors.values():
        detector.bind(told)
    for _ in range(EPOCHS):
        now = engine.predict(None)
        found = {label: detector.judge(now) for label, detector in detectors.items()}
        engine.update(engine.judge())
    return {label: int(verdict.alarm[:, 0].sum()) for label, verdict in found.items()}


@pytest.mark.parametrize("label", [*PASSIVE, *BOUNDED])
def test_in_a_clean_run_alarms_are_as_rare_as_stated(label):
    low, high = likely(RECEIVERS, ALPHA_RUN)
    assert (low if label in PASSIVE else 1) <= last_alarms()[label] <= high
