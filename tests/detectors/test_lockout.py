"""Nobody is locked out for good, and not everybody at once."""

import numpy as np
import pytest

from spoofgym.detectors import Ewma, JointChart, Shewhart

from .support import context, epoch

N = 6
S = np.tile(np.diag(np.repeat([4.0, 1.0], N)), (1, 1, 1))


def weights(detector, offsets, epochs):
    """(K, N) weights of the pseudoranges while every innovation stays at its offset [m]."""
    detector.bind(context(1, N))
    z = np.concatenate([offsets, np.zeros(N)])[None]
    return np.array([detector.judge(epoch(z, S)).weights[0, :N] for _ in range(epochs)])


def offset(ratio, detector):
    """Innovation at which a settled chart stands at a part of its threshold [m]."""
    detector.bind(context(1, N))
    for _ in range(200):
        verdict = detector.judge(epoch(np.zeros((1, 2 * N)), S))
    return ratio * float(verdict.threshold[0, 0])


KINDS = [
    Ewma(max_exclusion_s=10.0, min_satellites=0),
    JointChart(max_exclusion_s=10.0, min_satellites=0),
    Shewhart(weight_scale=0.3, max_exclusion_s=10.0, min_satellites=0),
]


@pytest.mark.parametrize("detector", KINDS, ids=lambda d: type(d).__name__)
def test_an_exclusion_without_an_alarm_ends_after_the_maximum_time(detector):
    offsets = np.zeros(N)
    offsets[2] = offset(0.7, detector)  # beyond m T = 0.3 T, and no alarm
    found = weights(detector, offsets, 120)
    out = np.flatnonzero(found[:, 2] == 0.0)
    assert len(out) == 20  # 10 s
    assert np.all(np.diff(out) == 1)
    assert np.all(found[out[-1] + 1 :, 2] == 1.0)
    assert np.all(np.delete(found, 2, axis=1) == 1.0)


@pytest.mark.parametrize("detector", KINDS, ids=lambda d: type(d).__name__)
def test_an_exclusion_with_an_alarm_lasts_as_long_as_the_alarm(detector):
    offsets = np.zeros(N)
    offsets[2] = offset(3.0, detector)
    found = weights(detector, offsets, 120)
    assert np.all(found[1:, 2] == 0.0)


@pytest.mark.parametrize("kind", [Ewma, JointChart])
def test_the_satellites_that_deviate_least_are_kept(kind):
    detector = kind(max_exclusion_s=None, min_satellites=4)
    ratios = np.array([6.0, 3.0, 8.0, 4.0, 5.0, 7.0])
    found = weights(detector, ratios * offset(1.0, detector), 60)[-1]
    np.testing.assert_array_equal(found == 1.0, ratios <= 6.0)


def test_no_more_are_readmitted_than_there_are_and_without_limits_none():
    detector = JointChart(min_satellites=32)
    found = weights(detector, np.full(N, offset(3.0, detector)), 5)
    np.testing.assert_array_equal(found, 1.0)
    for detector in (Ewma(), JointChart(max_exclusion_s=None, min_satellites=0)):
        found = weights(detector, np.full(N, offset(0.7, detector)), 400)
        assert np.all(found[20:] == 0.0)


@pytest.mark.parametrize(
    ("settings", "remembers"),
    [
        ({}, False),
        ({"max_exclusion_s": 10.0}, True),
        ({"min_satellites": 4}, True),
        ({"min_satellites": 4, "weight_scale": None}, False),  # without weights
    ],
)
def test_exclusions_are_counted_where_they_are_limited(settings, remembers):
    detector = Ewma(**settings)
    detector.bind(context(3, N))
    assert ("excluded" in detector.memory) == remembers
