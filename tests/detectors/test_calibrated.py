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
    PooledDetector,
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

RATE = {"false_alarms_per_hour": 0.2}


def verdicts(detector):
    """Verdicts on the epochs of a script."""
    script = list_scripts("satellites")[0]
    detector.bind(script.context)
    rows = np.arange(script.context.receivers)
    found = []
    for number in range(len(script.epochs)):
        fields = {name: None for name in Epoch._fields}
        fields |= script.epoch(number, rows, detector.needs)
        found.append(detector.judge(Epoch(**fields)))
    return found


@pytest.mark.parametrize("name", ["ewma", "snapshot-chi2", "cusum"])
def test_the_alarm_is_scaled_and_the_weights_stay(name):
    plain = verdicts(make_detector(name))
    ratios = np.concatenate([(v.statistic / v.threshold).ravel() for v in plain])
    scale = float(np.quantile(ratios[ratios > 0.0], 0.7))
    scaled = verdicts(make_detector({"name": name, "threshold_scale": scale}))
    assert any(v.alarm.any() for v in scaled)
    for one, other in zip(plain, scaled, strict=True):
        np.testing.assert_array_equal(one.statistic, other.statistic)
        np.testing.assert_array_equal(scale * one.threshold, other.threshold)
        np.testing.assert_array_equal(other.alarm, other.statistic > other.threshold)
        if one.weights is not None:
            np.testing.assert_array_equal(one.weights, other.weights)


def test_a_state_takes_the_factor_itself():
    chart = JointChart(weight_scale=None)
    scaled = verdicts(Calibrated(chart, 0.4))
    own = verdicts(dataclasses.replace(chart, alarm_scale=0.4))
    for one, other in zip(scaled, own, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


def test_weights_of_a_chart_go_by_the_threshold_without_the_factor():
    never = verdicts(JointChart(alarm_scale=1e9))
    assert not any(v.alarm.any() for v in never)
    assert any((v.weights < 1.0).any() for v in never)


@pytest.mark.parametrize(
    "detector",
    [
        Calibrated(Ewma(), 1.3),
        Calibrated(SnapshotChi2(), 0.2),
        Calibrated(JointChart(), 1.1),
        Calibrated(Cusum(), 2.0, rescaled=True, rescale=(2.0, 1.5, 3.0, 1.0)),
        make_detector({"name": "pool", "members": ["ewma", "cusum"], "threshold_scale": 1.2}),
    ],
)
def test_the_wrapper_keeps_the_contract(detector):
    check_detector(detector)


def test_a_rate_can_be_asked_for_by_name():
    found = make_detector({"name": "ewma", "smoothing": 0.2, **RATE})
    assert found == Calibrated(Ewma(smoothing=0.2), false_alarms_per_hour=0.2)
    assert not found.resolved
    assert (found.scope, found.paper) == ("channel", "zhong2025")
    assert make_detector({"name": "ewma", "thresholds": "nominal"}) == Ewma()
    standard = make_detector({"name": "ewma", "thresholds": "calibrated"})
    assert standard.false_alarms_per_hour == 0.2
    assert make_detector({"name": "never", **RATE}) == Never()


def test_an_object_plays_as_it_is(monkeypatch):
    monkeypatch.setattr(calibrated, "DEFAULT_RATE", 0.3)
    assert detector_in_world(Ewma()) == Ewma()
    mine = Calibrated(Ewma(), 1.7)
    assert detector_in_world(mine) == mine
    named = detector_in_world("ewma")
    assert named == Calibrated(Ewma(), false_alarms_per_hour=0.3)
    assert make_detector("ewma") == Ewma()
    assert detector_in_world({"name": "ewma", "thresholds": "nominal"}) == Ewma()
    pool = detector_in_world({"name": "pool", "members": ["ewma", SnapshotChi2()]})
    assert [type(judge) for judge in pool.judges] == [Calibrated, SnapshotChi2]
    # what was nominal is so when it is made again from its settings
    again = detector_in_world({"name": "pool", "members": pool.members})
    assert [type(judge) for judge in again.judges] == [Calibrated, SnapshotChi2]


def test_a_pool_calibrates_its_members():
    own = {"name": "cusum", "threshold_scale": 3.0}
    pool = make_detector({"name": "pool", "members": ["ewma", own, "never"], **RATE})
    assert isinstance(pool, PooledDetector)
    ewma, cusum, never = pool.judges
    assert ewma == Calibrated(Ewma(), false_alarms_per_hour=0.2)
    assert cusum == Calibrated(Cusum(), 3.0)
    assert never == Never()
    assert make_detector({"name": "pool", "members": pool.members}).members == pool.members
    with pytest.raises(TypeError, match="a pool calibrates its members"):
        Calibrated(pool, 1.0)


def test_identities_are_resolved_settings():
    assert describe_identity(Ewma()) == describe_identity(Ewma(smoothing=0.1))
    assert describe_identity(Ewma()) != describe_identity(Ewma(smoothing=0.2))
    assert describe_identity(JointChart(alarm_scale=3.0)) == describe_identity(JointChart())
    assert describe_identity(Cusum(bias_window_s=5)) == describe_identity(Cusum(bias_window_s=5.0))


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"threshold_scale": 0.0}, "`scale` must be a number above 0 or None, got 0.0"),
        ({"thresholds": "usual"}, "`thresholds` must be 'nominal', 'calibrated' or 'rescaled', go"),
        ({"thresholds": "rescaled", **RATE}, "'rescaled' is for detectors with a drift term"),
        ({"thresholds": "nominal", **RATE}, "has `thresholds` 'nominal' and `false_ala"),
        ({"threshold_scale": 1.0, **RATE}, "a factor of your own, and for `false_alarms_per_hour`"),
        ({"threshold_scale": 1.0, "calibration": "a.json"}, "of your own, and for `calibration`"),
        ({"threshold_scale": 1.0, "thresholds": "rescaled"}, "of your own, and for `thresholds`"),
        ({"calibration": "no-such-file.json"}, "no-such-file.json"),
    ],
)
def test_bad_requests(asked, message):
    with pytest.raises((ValueError, OSError), match=message):
        make_detector({"name": "ewma", **asked}).look_up(SnapshotSetup())


def test_bad_wrappers():
    with pytest.raises(TypeError, match="must be a Detector that is not calibrated, got 'ewma'"):
        Calibrated("ewma", 1.0)
    with pytest.raises(TypeError, match="must be a Detector that is not calibrated, got Calibra"):
        Calibrated(Calibrated(Ewma(), 1.0), 1.0)
    with pytest.raises(ValueError, match="needs `scale` or `false_alarms_per_hour`"):
        Calibrated(Ewma())
    with pytest.raises(ValueError, match="`rescale` must be four factors above 0, got"):
        Calibrated(Cusum(), 1.0, rescaled=True, rescale=(1.0, 2.0))
    with pytest.raises(
        ValueError, match=r"Ewma has no threshold for 0.2 false alarms an hour, and no wor"
    ):
        verdicts(Calibrated(Ewma(), false_alarms_per_hour=0.2))
