"""Statistics against closed forms and hand-made arrays."""

import math

import numpy as np
import pytest
from scipy.stats import binom

from spoofgym.bench.runs.record import RunRecord
from spoofgym.bench.scores import statistics
from spoofgym.bench.scores.matrix_game import PayoffMatrix, RunPayoff, checked_payoff

pytestmark = pytest.mark.nojit

Z = 1.959963984540054


def test_wilson_ends_and_middle():
    none, half, every = (statistics.wilson(k, 20) for k in (0, 10, 20))
    assert (none.value, none.low) == (0.0, 0.0)
    assert none.high == pytest.approx(Z**2 / (20 + Z**2))
    assert half.value - half.low == pytest.approx(half.high - half.value)
    assert half.high == pytest.approx(0.5 + 0.5 * Z / np.sqrt(20 + Z**2))
    assert (every.low, every.high) == (pytest.approx(1.0 - none.high), 1.0)
    assert np.isnan(statistics.wilson(0, 0).value)


def test_clopper_pearson_closed_forms_and_tails():
    none, every = statistics.clopper_pearson(0, 30), statistics.clopper_pearson(30, 30)
    assert (none.low, none.high) == (0.0, pytest.approx(1.0 - 0.025 ** (1 / 30)))
    assert (every.low, every.high) == (pytest.approx(0.025 ** (1 / 30)), 1.0)
    # for one event, P(X >= 1) = 1 - (1 - p)^n
    assert statistics.clopper_pearson(1, 30).low == pytest.approx(1.0 - 0.975 ** (1 / 30))
    interval = statistics.clopper_pearson(7, 50)
    assert binom.cdf(7, 50, interval.high) == pytest.approx(0.025)
    assert binom.sf(6, 50, interval.low) == pytest.approx(0.025)


def test_epochs_that_alarm_together_count_as_runs():
    # whole runs alarm or none at all: as many independent epochs as runs, but for R / (R - 1)
    found = statistics.clustered_proportion(np.where(np.arange(100) < 10, 320, 0), 320)
    assert found == pytest.approx(statistics.clopper_pearson(10 * 0.99, 99), rel=1e-6)
    # the same number of alarms spread evenly counts fully
    spread = statistics.clustered_proportion(np.full(100, 32), 320)
    assert spread == pytest.approx(statistics.clopper_pearson(3200, 32000))
    # without a design effect only the runs count
    for each, runs in ((0.0, 100), (320.0, 100), (160.0, 1)):
        found = statistics.clustered_proportion(np.full(runs, each), 320)
        assert found == statistics.clopper_pearson(runs * each / 320, runs)


def width(values, samples):
    found = statistics.bootstrap_mean(values, samples)
    return found.high - found.low


def test_bootstrap_interval_of_a_mean_is_the_normal_one():
    rng = np.random.default_rng(2)
    values = rng.standard_normal(400) + 3.0
    found = statistics.bootstrap_mean(values, statistics.draw_resamples(np.arange(400), 4000))
    spread = Z * values.std() / 20.0
    assert found.value == values.mean()
    assert found.low == pytest.approx(values.mean() - spread, abs=0.1 * spread)
    assert found.high == pytest.approx(values.mean() + spread, abs=0.1 * spread)


def test_runs_that_are_alike_are_drawn_together():
    rng = np.random.default_rng(5)
    clusters = np.repeat(np.arange(40), 25)
    alike = rng.standard_normal(40)[clusters] + 0.5 * rng.standard_normal(1000)
    apart = rng.standard_normal(1000)
    together, plain = (
        statistics.draw_resamples(clusters, 4000),
        statistics.draw_resamples(np.arange(1000), 4000),
    )
    means = alike.reshape(40, 25).mean(axis=1)
    assert width(alike, together) == pytest.approx(2 * Z * means.std() / np.sqrt(40), rel=0.1)
    assert width(alike, plain) < 0.4 * width(alike, together)
    drawn = statistics.draw_resamples(np.arange(1000))
    assert width(apart, together) == pytest.approx(width(apart, drawn), rel=0.35)


def test_the_largest_value_of_a_share_in_every_sample():
    rng = np.random.default_rng(6)
    x = rng.exponential(1.0, 30)
    samples = statistics.draw_resamples(np.arange(30) // 2, 50)
    for share in (0.05, 0.5, 1.0):
        found = statistics.largest_of_share(x, share, samples)
        for row, value in zip(samples.astype(int), found, strict=True):
            drawn = np.sort(np.repeat(x, row))[::-1]
            assert value == drawn[max(math.ceil(share * len(drawn) - 1e-9), 1) - 1]


def test_a_contrast_of_payoffs_is_their_weighted_sum():
    moved = np.array([[[10.0, 40.0]], [[0.0, 20.0]]])  # of two spoofers, in two runs
    sides = (), (), RunPayoff(limit_m=40.0), np.eye(2), np.eye(1)
    counts = np.ones((1, 2), dtype=bool)
    played = PayoffMatrix(*sides, moved, moved > 50.0, counts, np.arange(2), (0, "evaluation"))
    np.testing.assert_allclose(played.values, [[0.625], [0.25]])
    found = played.contrast([[2.0], [-1.0]])
    assert found == (pytest.approx(1.0), pytest.approx(0.5), pytest.approx(1.5))
    with pytest.raises(ValueError, match=r"got nan at \(0, 1\)"):
        checked_payoff([[1.0, np.nan, 2.0], [np.inf, 3.0, 4.0]])


def test_nothing_to_estimate_from_is_unknown():
    assert np.isnan(statistics.bootstrap_mean([], statistics.draw_resamples(np.arange(0))).value)
    assert np.isnan(statistics.percentiles(float("nan"), np.array([1.0, 2.0])).value)
    assert np.isnan(statistics.percentiles(1.0, np.array([np.nan, np.nan])).low)


def test_exceedance_counts_what_lies_above():
    found = statistics.exceedance([0.0, 10.0, 20.0, 30.0], [10.0, 40.0])
    assert [estimate.value for estimate in found] == [0.5, 0.0]
    assert found[0] == statistics.wilson(2, 4)


def test_no_record_of_runs_has_an_infinity():
    head = {"spoofer": "ramp", "detector": "ewma"}
    RunRecord(head, {"peak_ratio": np.array([1.0, np.nan])})
    message = "ramp against ewma: undetected_displacement_m of run 1 is infinite"
    with pytest.raises(ArithmeticError, match=message):
        RunRecord(head, {"undetected_displacement_m": np.array([1.0, -np.inf])})
