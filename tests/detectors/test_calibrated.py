"""A detector at a rate: what is asked, what is scaled, and what is left alone."""

import dataclasses

import numpy as np
import pytest

from spoofgym.detectors import (
    Calibrated,
    Cusum,
    Ewma,
    JointChart,
    Never,
    SnapshotChi2,
    calibrated,
    detector_in_world,
    make_detector,
)
from spoofgym.detectors.calibrated import describe_identity
from spoofgym.receiver.epoch import Epoch
from spoofgym.simulation import SnapshotSetup
from spoofgym.testing import check_detector
from spoofgym.testing.detector import list_scripts

from .support import stacked

RATE = {"false_alarms_per_hour": 0.2}


def judged(detector):
    script = list_scripts("satellites")[0]
    detector.bind(script.context)
    rows = np.arange(script.context.receivers)
    nothing = dict.fromkeys(Epoch._fields)
    return stacked(
        [
            detector.judge(Epoch(**nothing | script.epoch(number, rows, detector.needs)))
            for number in range(len(script.epochs))
        ]
    )


@pytest.mark.parametrize("name", ["ewma", "snapshot-chi2"])
def test_the_alarm_is_scaled_and_the_weights_stay(name):
    plain = judged(make_detector(name))
    ratios = plain.statistic / plain.threshold
    scale = float(np.quantile(ratios[ratios > 0.0], 0.7))
    scaled = judged(make_detector({"name": name, "threshold_scale": scale}))
    assert scaled.alarm.any()
    np.testing.assert_array_equal(plain.statistic, scaled.statistic)
    np.testing.assert_array_equal(scale * plain.threshold, scaled.threshold)
    np.testing.assert_array_equal(scaled.alarm, scaled.statistic > scaled.threshold)
    np.testing.assert_array_equal(plain.weights, scaled.weights)


def test_a_state_takes_the_factor_itself_and_weighs_without_it():
    chart = JointChart(weight_scale=None)
    scaled = judged(Calibrated(chart, 0.4))
    for one, other in zip(scaled, judged(dataclasses.replace(chart, alarm_scale=0.4)), strict=True):
        np.testing.assert_array_equal(one, other)
    never = judged(JointChart(alarm_scale=1e9))
    assert not never.alarm.any()
    assert (never.weights < 1.0).any()


@pytest.mark.parametrize(
    "detector",
    [
        Calibrated(JointChart(), 1.1),
        Calibrated(Cusum(), 2.0, rescaled=True, rescale=(2.0, 1.5, 3.0, 1.0)),
        make_detector({"name": "pool", "members": ["ewma", "cusum"], "threshold_scale": 1.2}),
    ],
)
def test_the_wrapper_keeps_the_contract(detector):
    check_detector(detector)


def test_a_rate_can_be_asked_for_by_name_and_a_pool_asks_its_members():
    found = make_detector({"name": "ewma", "smoothing": 0.2, **RATE})
    assert found == Calibrated(Ewma(smoothing=0.2), false_alarms_per_hour=0.2)
    assert not found.resolved
    assert (found.scope, found.paper) == ("channel", "zhong2025")
    assert make_detector({"name": "ewma", "thresholds": "nominal"}) == Ewma()
    standard = make_detector({"name": "ewma", "thresholds": "calibrated"})
    assert standard.false_alarms_per_hour == 0.2
    assert make_detector({"name": "never", **RATE}) == Never()
    own = {"name": "cusum", "threshold_scale": 3.0}
    pool = make_detector({"name": "pool", "members": ["ewma", own, "never"], **RATE})
    ewma = Calibrated(Ewma(), false_alarms_per_hour=0.2)
    assert [*pool.judges] == [ewma, Calibrated(Cusum(), 3.0), Never()]
    assert make_detector({"name": "pool", "members": pool.members}).members == pool.members
    with pytest.raises(TypeError, match="a pool calibrates its members"):
        Calibrated(pool, 1.0)


def test_an_object_plays_as_it_is_and_identities_are_resolved_settings(monkeypatch):
    assert describe_identity(Ewma()) == describe_identity(Ewma(smoothing=0.1))
    assert describe_identity(Ewma()) != describe_identity(Ewma(smoothing=0.2))
    assert describe_identity(JointChart(alarm_scale=3.0)) == describe_identity(JointChart())
    assert describe_identity(Cusum(bias_window_s=5)) == describe_identity(Cusum(bias_window_s=5.0))
    monkeypatch.setattr(calibrated, "DEFAULT_RATE", 0.3)
    for given in (Ewma(), Calibrated(Ewma(), 1.7)):
        for make in (make_detector, detector_in_world):
            assert make(given) == given
        assert make_detector(given) is not given
    assert make_detector("ewma") == Ewma()
    assert detector_in_world("ewma") == Calibrated(Ewma(), false_alarms_per_hour=0.3)
    assert detector_in_world({"name": "ewma", "thresholds": "nominal"}) == Ewma()
    pool = detector_in_world({"name": "pool", "members": ["ewma", SnapshotChi2()]})
    # what was nominal is so when it is made again from its settings
    again = detector_in_world({"name": "pool", "members": pool.members})
    for each in (pool, again):
        assert [type(judge) for judge in each.judges] == [Calibrated, SnapshotChi2]


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"thresholds": "usual"}, "`thresholds` must be 'nominal', 'calibrated' or 'rescaled', go"),
        ({"thresholds": "rescaled", **RATE}, "'rescaled' is for detectors with a drift term"),
        ({"thresholds": "nominal", **RATE}, "has `thresholds` 'nominal' and `false_ala"),
        ({"threshold_scale": 1.0, **RATE}, "a factor of your own, and `false_alarms_per_hour`"),
        ({"calibration": "no-such-file.json"}, "no-such-file.json"),
    ],
)
def test_bad_requests(asked, message):
    with pytest.raises((ValueError, OSError), match=message):
        make_detector({"name": "ewma", **asked}).look_up(SnapshotSetup())


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"detector": "ewma", "scale": 1.0}, "a Detector that is not calibrated, got 'ewma'"),
        ({"detector": Calibrated(Ewma(), 1.0), "scale": 1.0}, "not calibrated, got Calibrated"),
        ({"detector": Ewma()}, "needs `scale` or `false_alarms_per_hour`"),
        ({"detector": Cusum(), "rescaled": True, "scale": 1.0, "rescale": (1.0, 2.0)}, "four fact"),
        ({"detector": Ewma(), **RATE}, r"no threshold for 0.2 false alarms an hour, and no world"),
    ],
)
def test_bad_wrappers(settings, message):
    with pytest.raises((TypeError, ValueError), match=message):
        judged(Calibrated(**settings))
