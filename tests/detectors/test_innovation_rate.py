"""The innovation-rate test against the printed filter, its false alarms, weights and guard."""

import math

import numpy as np
import pytest
import scipy.linalg
import scipy.stats

from spoofgym.detectors import InnovationRate

from .support import belief, context, drawn, epoch

B, N, K = 2, 4, 60


def at(k, receivers, interval=1.0):
    return {"time": np.full(receivers, k * interval), "interval": np.full(receivers, interval)}


def printed_filter(samples, intervals, alpha, noise):
    """Four states of the paper, one channel: rate and its variance after every sample."""
    F = np.array([[0, 1, 0, 0], [0, -alpha, 1, 0], [0, 0, 0, 0], [0, 0, 0, 0]], dtype=float)
    h = np.array([1.0, 0.0, 0.0, -1.0])
    x, P, out = np.zeros(4), np.eye(4), []
    for z, dt in zip(samples, intervals, strict=True):
        Phi = scipy.linalg.expm(F * dt)
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
    S = np.array([belief(rng, B, N) for _ in range(K)])
    z = np.array([drawn(rng, S[k]) for k in range(K)])
    detector = InnovationRate(false_alarm=0.01, correlation_per_s=alpha, noise=noise)
    detector.bind(context(B, N))
    verdicts = [
        detector.judge(epoch(z[k], S[k])._replace(interval=np.full(B, intervals[k])))
        for k in range(K)
    ]
    quantile = scipy.stats.norm.isf((1.0 - 0.99 ** (1.0 / N)) / 2.0)
    for b in range(B):
        for j in range(N):
            rate, variance = printed_filter(
                z[:, b, j] / np.sqrt(S[:, b, j, j]), intervals, alpha, noise
            )
            size = [verdict.statistic[b, j] for verdict in verdicts]
            threshold = [verdict.threshold[b, j] for verdict in verdicts]
            np.testing.assert_allclose(size, np.abs(rate), rtol=1e-7, atol=1e-10)
            np.testing.assert_allclose(threshold, quantile * np.sqrt(variance), rtol=1e-7)
    assert all(verdict.weights is None for verdict in verdicts)


def quiet(detector, epochs, receivers=1, channels=8):
    """Thresholds of one channel over epochs without innovation."""
    detector.bind(context(receivers, channels))
    nothing, S = (
        np.zeros((receivers, 2 * channels)),
        np.tile(np.eye(2 * channels), (receivers, 1, 1)),
    )
    return np.array(
        [
            detector.judge(epoch(nothing, S)._replace(**at(k, receivers))).threshold[0, 0]
            for k in range(epochs)
        ]
    )


@pytest.mark.parametrize(("alpha", "noise"), [(0.5, 1e-9), (0.9, 1e-8)])
def test_the_printed_threshold_is_that_of_330_samples(alpha, noise):
    # 8 satellites and 4e-6 an epoch: z = 5.026; the prototype of the notes found 326 to 334
    thresholds = quiet(InnovationRate(correlation_per_s=alpha, noise=noise), 400)
    assert np.argmax(thresholds < 0.0029517) + 1 == pytest.approx(330, abs=5)


def test_the_variance_of_the_rate_is_that_of_a_slope():
    z = scipy.stats.norm.isf((1.0 - (1.0 - 4e-6) ** 0.125) / 2.0)
    variance = (quiet(InnovationRate(noise=1e-9), 746) / z) ** 2
    n = np.arange(1, 747)
    assert z == pytest.approx(5.0263, abs=1e-3)
    assert (variance * n**3.0)[349:].min() > 12.0
    assert (variance * n**3.0)[349:].max() < 13.0


@pytest.mark.parametrize("epochs", [20, 150])
def test_where_the_belief_is_right_alarms_are_as_rare_as_stated(epochs):
    """And rarer at first, when the filter still allows for a level that is not there."""
    receivers, channels, alpha = 4000, 2, 0.05
    rng = np.random.default_rng(epochs)
    detector = InnovationRate(false_alarm=alpha)
    detector.bind(context(receivers, channels))
    S = np.tile(np.eye(2 * channels), (receivers, 1, 1))
    first = epoch(np.zeros((receivers, 2 * channels)), S)
    for k in range(epochs):
        z = rng.standard_normal((receivers, 2 * channels))
        alarms = detector.judge(first._replace(innovation=z, **at(k, receivers))).alarm
    low, high = scipy.stats.binom.ppf([1e-4, 1.0 - 1e-4], receivers, alpha)
    count = alarms.any(axis=1).sum()
    assert 0 < count <= high
    assert epochs == 20 or low <= count


def run(detector, innovations, visible=None, interval=1.0):
    """Verdicts on (K, n) innovations of one receiver whose belief is the identity."""
    channels = innovations.shape[1]
    detector.bind(context(1, channels))
    S = np.eye(2 * channels)[None]
    verdicts = []
    for k, row in enumerate(innovations):
        both = np.concatenate([row, np.zeros(channels)])[None]
        seen = epoch(both, S, None if visible is None else visible[k : k + 1])
        verdicts.append(detector.judge(seen._replace(**at(k, 1, interval))))
    return verdicts


def stepped(size, channels=6, epochs=500, onset=200, seed=3):
    z = np.random.default_rng(seed).standard_normal((epochs, channels))
    z[onset:, 0] += size
    return z


def test_a_step_is_seen_in_both_directions_and_a_constant_deviation_is_none():
    for sign in (1.0, -1.0):
        alarms = np.array([v.alarm[0] for v in run(InnovationRate(), sign * stepped(10.0))])
        assert not alarms[:200].any()
        assert 0 < np.argmax(alarms[200:, 0]) < 20
        assert not alarms[:, 1:].any()
    z = np.random.default_rng(1).standard_normal((300, 6)) + np.array([0, 1, -2, 4, -8, 12.0])
    assert not any(verdict.alarm.any() for verdict in run(InnovationRate(), z))


@pytest.mark.nojit
def test_the_filter_begins_at_its_start_and_with_a_satellite_and_is_judged_once_settled():
    def same(verdicts, others, channels=slice(None)):
        for one, other in zip(verdicts, others, strict=True):
            np.testing.assert_array_equal(one.statistic[:, channels], other.statistic[:, channels])
            np.testing.assert_array_equal(one.threshold[:, channels], other.threshold[:, channels])

    early = run(InnovationRate(threshold=1e-4, weight_scale=1.0, settled_s=100.0), stepped(0.0))
    assert not np.array([verdict.alarm for verdict in early[:100]]).any()
    assert all((verdict.weights == 1.0).all() for verdict in early[:100])
    assert np.array([verdict.alarm for verdict in early[100:]]).any()
    z, visible = stepped(3.0), np.ones((500, 6), dtype=bool)
    late = run(InnovationRate(start_s=50.0), z)
    assert all(not verdict.statistic.any() for verdict in late[:50])
    same(late[50:], run(InnovationRate(), z[50:]))
    visible[240:260, 0] = False
    same(run(InnovationRate(), z, visible)[260:], run(InnovationRate(), z[260:]), 0)


def test_weights_are_those_of_the_statistic():
    guardless = {"max_exclusion_s": None, "min_satellites": 0}
    z = stepped(10.0)
    verdicts = run(InnovationRate(weight_scale=0.8, **guardless), z)
    watched = run(InnovationRate(), z)
    kinds = set()
    for verdict, same in zip(verdicts, watched, strict=True):
        np.testing.assert_array_equal(verdict.statistic, same.statistic)
        size, reject = verdict.statistic, 0.8 * verdict.threshold
        accept = 0.5 * reject
        slope = accept / np.maximum(size, 1e-300) * ((reject - size) / (reject - accept)) ** 2
        want = np.where(size <= accept, 1.0, np.where(size > reject, 0.0, slope))
        np.testing.assert_allclose(verdict.weights[:, :6], want, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(verdict.weights[:, 6:], 1.0)
        kinds |= {math.ceil(weight) + (weight == 1.0) for weight in verdict.weights[0]}
    assert kinds == {0, 1, 2}  # none, some and all of the weight came up


def test_with_a_memory_span_it_stays_quick():
    delays = []
    for memory_s in (None, 50.0):
        for onset in (200, 1200):
            z = np.random.default_rng(5).standard_normal((onset + 100, 8))
            z[onset:] += 4.0
            alarms = np.array([v.alarm[0] for v in run(InnovationRate(memory_s=memory_s), z)])
            assert not alarms[:onset].any()
            delays.append(np.argmax(alarms[onset:], axis=0).mean())
    blind_early, blind_late, early, late = delays
    assert blind_late > 2.0 * blind_early
    assert late < 1.5 * early


def zero_spans(verdicts, channel):
    """Lengths of the stretches in which a channel had no weight."""
    out = np.array([verdict.weights[0, channel] == 0.0 for verdict in verdicts])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], out.astype(int), [0]])))
    return edges[1::2] - edges[::2]


def test_no_satellite_is_locked_out_for_good():
    z = stepped(40.0, channels=7)
    free = {"weight_scale": 1.0, "min_satellites": 0}
    guarded = zero_spans(run(InnovationRate(max_exclusion_s=60.0, **free), z), 0)
    unguarded = zero_spans(run(InnovationRate(max_exclusion_s=None, **free), z), 0)
    assert unguarded.max() > 100
    assert guarded.max() == 60


@pytest.mark.nojit
def test_as_many_satellites_as_needed_keep_a_weight():
    z = stepped(0.0, channels=6)
    z[200:, :4] += np.array([40.0, 30.0, -20.0, 25.0])
    free = {"weight_scale": 1.0, "max_exclusion_s": None}
    for least in (0, 4, 6):
        verdicts = run(InnovationRate(min_satellites=least, **free), z)[220:260]
        used = np.array([(verdict.weights[0, :6] > 0.0) for verdict in verdicts])
        assert (used.sum(axis=1) == max(least, 2)).all()
        if least == 4:  # the two that are let in are the least suspicious ones
            np.testing.assert_array_equal(used[:, 2], True)
        assert all(verdict.alarm[0, :4].all() for verdict in verdicts)
