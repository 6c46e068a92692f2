"""The innovation-rate test against the printed filter, its weights and guard; and its oracles."""

import math

import numpy as np
import pytest
import scipy.linalg
import scipy.stats

from spoofgym.detectors import InnovationRate, OracleRamp, OracleStep

from .support import belief, context, drawn, judge_all, normalized, padded

B, N, K = 2, 4, 60
FREE = {"max_exclusion_s": None, "min_satellites": 0}


def printed_filter(samples, intervals, alpha, noise):
    """Four states of the paper, one channel: rate and its variance after every sample."""
    F = np.array([[0, 1, 0, 0], [0, -alpha, 1, 0], [0, 0, 0, 0], [0, 0, 0, 0]], dtype=float)
    h = np.array([1.0, 0.0, 0.0, -1.0])
    x, P, out = np.zeros(4), np.eye(4), []
    transitions = {dt: scipy.linalg.expm(F * dt) for dt in set(intervals)}
    for z, dt in zip(samples, intervals, strict=True):
        Phi = transitions[dt]
        x, P = Phi @ x, Phi @ P @ Phi.T + np.diag([0.0, noise * dt, 0.0, 0.0])
        gain = P @ h / (h @ P @ h + 1.0)
        x = x + gain * (z - h @ x)
        P = P - np.outer(gain, h @ P)
        out.append((x[1], P[1, 1]))
    return np.array(out).T


@pytest.mark.parametrize(("alpha", "noise"), [(0.5, 1e-9), (0.9, 1e-2)])
def test_three_states_are_the_printed_four(alpha, noise):
    rng = np.random.default_rng(0)
    intervals = rng.choice([0.5, 1.0, 3.0], K)
    S = belief(rng, N, K, B)
    z = drawn(rng, S)
    detector = InnovationRate(false_alarm=0.01, correlation_per_s=alpha, noise=noise)
    found = judge_all(detector, z, S, interval=intervals)
    quantile = scipy.stats.norm.isf((1.0 - 0.99 ** (1.0 / N)) / 2.0)
    u = normalized(z, S)
    for b, j in np.ndindex(B, N):
        rate, variance = printed_filter(u[:, b, j], intervals, alpha, noise)
        size, threshold = found.statistic[:, b, j], found.threshold[:, b, j]
        np.testing.assert_allclose(size, np.abs(rate), rtol=1e-7, atol=1e-10)
        np.testing.assert_allclose(threshold, quantile * np.sqrt(variance), rtol=1e-7)
    assert found.weights is None


@pytest.mark.parametrize(("alpha", "noise"), [(0.5, 1e-9), (0.9, 1e-8), (0.7, 1e-9)])
def test_the_printed_threshold_is_that_of_330_samples_and_the_variance_that_of_a_slope(
    alpha, noise
):
    detector = InnovationRate(correlation_per_s=alpha, noise=noise)
    thresholds = judge_all(detector, np.zeros((746, 1, 16)), interval=1.0).threshold[:, 0, 0]
    # 8 satellites and 4e-6 an epoch: z = 5.026; the prototype of the notes found 326 to 334
    assert np.argmax(thresholds < 0.0029517) + 1 == pytest.approx(330, abs=5)
    if alpha == 0.7:
        z = scipy.stats.norm.isf((1.0 - (1.0 - 4e-6) ** 0.125) / 2.0)
        assert z == pytest.approx(5.0263, abs=1e-3)
        cubed = ((thresholds / z) ** 2 * np.arange(1, 747) ** 3.0)[349:]
        assert 12.0 < cubed.min() < cubed.max() < 13.0


def stepped(size, channels=6, epochs=500, onset=200, seed=3):
    z = np.random.default_rng(seed).standard_normal((epochs, channels))
    z[onset:, 0] += size
    return z


def run(detector, z, visible=True):
    return judge_all(detector, padded(z), None, visible, 1.0)


@pytest.mark.nojit
def test_the_filter_begins_at_its_start_and_with_a_satellite_and_is_judged_once_settled():
    def same(found, other, channels=slice(None)):
        for one, two in ((found.statistic, other.statistic), (found.threshold, other.threshold)):
            np.testing.assert_array_equal(one[-len(two) :, :, channels], two[:, :, channels])

    z, visible = stepped(3.0, epochs=300), np.ones((300, 1, 6), dtype=bool)
    early = run(InnovationRate(threshold=1e-4, weight_scale=1.0, settled_s=100.0), z[:150])
    assert not early.alarm[:100].any()
    assert (early.weights[:100] == 1.0).all()
    assert early.alarm[100:].any()
    late = run(InnovationRate(start_s=50.0), z)
    assert not late.statistic[:50].any()
    same(late, run(InnovationRate(), z[50:]))
    visible[240:260, :, 0] = False
    same(run(InnovationRate(), z, visible), run(InnovationRate(), z[260:]), 0)


def test_weights_are_those_of_the_statistic():
    z = stepped(10.0)
    found = run(InnovationRate(weight_scale=0.8, **FREE), z)
    np.testing.assert_array_equal(found.statistic, run(InnovationRate(), z).statistic)
    size, reject = found.statistic, 0.8 * found.threshold
    accept = 0.5 * reject
    slope = accept / np.maximum(size, 1e-300) * ((reject - size) / (reject - accept)) ** 2
    want = np.where(size <= accept, 1.0, np.where(size > reject, 0.0, slope))
    np.testing.assert_allclose(found.weights[..., :6], want, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(found.weights[..., 6:], 1.0)
    kinds = {math.ceil(weight) + (weight == 1.0) for weight in found.weights.ravel()}
    assert kinds == {0, 1, 2}  # none, some and all of the weight came up


def test_with_a_memory_span_it_stays_quick():
    delays = []
    for memory_s in (None, 50.0):
        for onset in (200, 1200):
            z = stepped(0.0, 8, onset + 100, seed=5)
            z[onset:] += 4.0
            alarms = run(InnovationRate(memory_s=memory_s), z).alarm[:, 0]
            assert not alarms[:onset].any()
            delays.append(np.argmax(alarms[onset:], axis=0).mean())
    blind_early, blind_late, early, late = delays
    assert blind_late > 2.0 * blind_early
    assert late < 1.5 * early


def test_no_satellite_is_locked_out_for_good():
    longest = []
    for limit in (60.0, None):
        detector = InnovationRate(weight_scale=1.0, min_satellites=0, max_exclusion_s=limit)
        out = run(detector, stepped(40.0, channels=7)).weights[:, 0, 0] == 0.0
        edges = np.flatnonzero(np.diff(out.astype(int), prepend=0, append=0))
        longest.append((edges[1::2] - edges[::2]).max())
    assert longest[0] == 60
    assert longest[1] > 100


@pytest.mark.nojit
def test_as_many_satellites_as_needed_keep_a_weight():
    z = stepped(0.0, epochs=260)
    z[200:, :4] += np.array([40.0, 30.0, -20.0, 25.0])
    for least in (0, 4, 6):
        settings = {"weight_scale": 1.0, "max_exclusion_s": None, "min_satellites": least}
        found = run(InnovationRate(**settings), z)
        used = found.weights[220:, 0, :6] > 0.0
        assert (used.sum(axis=1) == max(least, 2)).all()
        assert least != 4 or used[:, 2].all()  # the least suspicious ones are let in
        assert found.alarm[220:, 0, :4].all()


ONSET = 150
SIZES = {OracleStep: {"size_m": 20.0}, OracleRamp: {"rate_mps": 0.3}}


def oracle(kind, channels=("G01",), **settings):
    return kind(onset_s=float(ONSET), channels=channels, **SIZES[kind], **settings)


def judged(detector, z):
    return judge_all(detector, padded(z), 4.0 * np.eye(2 * N), interval=1.0)


@pytest.mark.nojit
@pytest.mark.parametrize("kind", SIZES)
def test_an_oracle_adds_what_it_is_told_once_more_whether_it_is_there_or_not(kind):
    clean = 2.0 * np.random.default_rng(0).standard_normal((300, N))
    alarms = judged(oracle(kind), clean).alarm[:, 0]
    assert not alarms[:ONSET].any()
    assert alarms[ONSET:, 1].any()
    assert not alarms[:, [0, 2, 3]].any()
    plain = InnovationRate(weight_scale=1.0, **FREE)
    assert not judged(plain, clean).alarm.any()
    since = np.arange(300.0) - ONSET
    offset = np.where(since >= 0.0, 20.0 if kind is OracleStep else 0.3 * since, 0.0)
    once = clean + np.outer(offset, np.eye(N)[1])
    mine = judged(oracle(kind, **FREE), once)
    other = judged(plain, once + np.outer(offset, np.eye(N)[1]))
    np.testing.assert_allclose(mine.statistic, other.statistic, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(mine.alarm, other.alarm)
    # without names every channel is attacked
    assert judged(oracle(kind, None), clean).alarm.any(axis=(0, 1)).all()
    with pytest.raises(ValueError, match="`channels` names S99; the receiver has G00, G01"):
        kind(channels=("S99",)).bind(context(1, N))
