"""False alarms in a clean world whose errors the filter knows, by every test of innovations.

All watch the same run: white noise, no biases, tuning "matched".  One verdict of a receiver counts,
the last one, so that verdicts are independent draws.  `cusum` promises a mean time between alarms
instead, which its own tests try.
"""

from functools import cache

import numpy as np
import pytest
import scipy.stats

from spoofgym.detectors import DetectorContext, Never, make_detector
from spoofgym.simulation import Engine, TightlyCoupledSetup

RECEIVERS, EPOCHS, ALPHA = 1000, 100, 0.05
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


def spec(label, **more):
    return {"name": label, "false_alarm": ALPHA, **PASSIVE.get(label, {}), **more}


@cache
def last_alarms():
    """Alarms of the last epoch, by label; of the first satellite where every one is judged."""
    setup = TightlyCoupledSetup(
        scenario="zhong2025-white",
        receiver={"tuning": "matched"},
        detector=Never(),
        timeline={
            "warmup_s": 60.0,
            "live_s": 0.0,
            "attack_s": 0.5 * EPOCHS,
            "time_to_alert_s": 0.0,
        },
    )
    setup.fields = setup.has
    engine = Engine(RECEIVERS, setup, threads=1)
    engine.reset([np.random.default_rng([7, i]) for i in range(RECEIVERS)])
    specs = {label: spec(label) for label in PASSIVE}
    specs["aime, shared"] = {"name": "aime", "windows_s": [5.0, 25.0, 45.0], "false_alarm": ALPHA}
    specs["shewhart, both"] = {"name": "shewhart", "signals": "both", "false_alarm": ALPHA}
    specs["joint-chart"] = {"name": "joint-chart", "weight_scale": None, "false_alarm": ALPHA}
    detectors = {label: make_detector(given) for label, given in specs.items()}
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
        epoch = engine.predict(None)
        found = {label: detector.judge(epoch) for label, detector in detectors.items()}
        engine.update(engine.judge())
    return {label: int(verdict.alarm[:, 0].sum()) for label, verdict in found.items()}


LOW, HIGH = scipy.stats.binom.ppf([1e-4, 1.0 - 1e-4], RECEIVERS, ALPHA)


@pytest.mark.parametrize("label", PASSIVE)
def test_alarms_are_as_rare_as_stated(label):
    assert LOW <= last_alarms()[label] <= HIGH


@pytest.mark.parametrize("label", ["aime, shared", "shewhart, both", "joint-chart"])
def test_where_a_probability_is_shared_out_or_alarms_can_end_it_is_an_upper_bound(label):
    assert 0 < last_alarms()[label] <= HIGH
