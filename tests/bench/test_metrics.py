"""Statistics against closed forms and hand-made arrays."""

from __future__ import annotations

import math

import numpy as np
import pytest

from spoofgym.bench.scores.statistics import (
    bootstrap_mean,
    clopper_pearson,
    clustered_proportion,
    draw_resamples,
    exceedance,
    largest_of_share,
    percentiles,
    resamples,
    wilson,
)

pytestmark = pytest.mark.nojit

Z = 1.959963984540054


def test_wilson_ends_and_middle() -> None:
    none = wilson(0, 20)
    assert (none.value, none.low) == (0.0, 0.0)
    assert none.high == pytest.approx(Z**2 / (20 + Z**2))
    half = wilson(10, 20)
    assert half.value - half.low == pytest.approx(half.high - half.value)
    assert half.high == pytest.approx(0.5 + 0.5 * Z / np.sqrt(20 + Z**2))
    every = wilson(20, 20)
    assert (every.low, every.high) == (pytest.approx(1.0 - none.high), 1.0)
    assert np.isnan(wilson(0, 0).value)


def test_clopper_pearson_closed_forms() -> None:
    none = clopper_pearson(0, 30)
    assert (none.low, none.high) == (0.0, pytest.approx(1.0 - 0.025 ** (1 / 30)))
    every = clopper_pearson(30, 30)
    assert (every.low, every.high) == (pytest.approx(0.025 ** (1 / 30)), 1.0)
    # for one event, P(X >= 1) = 1 - (1 - p)^n
    assert clopper_pearson(1, 30).low == pytest.approx(1.0 - 0.975 ** (1 / 30))


def test_clopper_pearson_holds_its_tails() -> None:
    from scipy.stats import binom

    k, n = 7, 50
    interval = clopper_pearson(k, n)
    assert binom.cdf(k, n, interval.high) == pytest.approx(0.025)
    assert binom.sf(k - 1, n, interval.low) == pytest.approx(0.025)


def test_epochs_that_alarm_together_count_as_runs() -> None:
    # whole runs alarm or none at all: as many independent epochs as runs, but for R / (R - 1)
    events = np.where(np.arange(100) < 10, 320, 0)
    found = clustered_proportion(events, 320)
    by_runs = clopper_pearson(10 * 0.99, 99)
    assert found == pytest.approx(by_runs, rel=1e-6)
    # the same number of alarms spread evenly counts fully
    spread = clustered_proportion(np.full(100, 32), 320)
    assert spread == pytest.approx(clopper_pearson(3200, 32000))
    assert clustered_proportion(np.zeros(100), 320).high == clopper_pearson(0, 100).high


def test_bootstrap_interval_of_a_mean_is_the_normal_one() -> None:
    rng = np.random.default_rng(2)
    values = rng.standard_normal(400) + 3.0
    found = bootstrap_mean(values, resamples(np.arange(400), rng, 4000))
    spread = Z * values.std() / 20.0
    assert found.value == values.mean()
    assert found.low == pytest.approx(values.mean() - spread, abs=0.1 * spread)
    assert found.high == pytest.approx(values.mean() + spread, abs=0.1 * spread)


def test_paired_differences_are_narrower_than_both() -> None:
    rng = np.random.default_rng(4)
    common = 10.0 * rng.standard_normal(200)
    one, other = common, common + 1.0 + 0.1 * rng.standard_normal(200)
    samples = resamples(np.arange(200), rng)
    gap = bootstrap_mean(other - one, samples)
    assert gap.low > 0.9
    assert gap.high < 1.1
    assert bootstrap_mean(one, samples).high - bootstrap_mean(one, samples).low > 1.0


def test_runs_that_are_alike_are_drawn_together() -> None:
    """The spread of a mean over 40 clusters, and the plain one where nothing is alike."""
    rng = np.random.default_rng(5)
    clusters = np.repeat(np.arange(40), 25)
    alike = rng.standard_normal(40)[clusters] + 0.5 * rng.standard_normal(1000)
    apart = rng.standard_normal(1000)
    samples = resamples(clusters, rng, 4000)
    means = alike.reshape(40, 25).mean(axis=1)
    found = bootstrap_mean(alike, samples)
    assert found.high - found.low == pytest.approx(2 * Z * means.std() / np.sqrt(40), rel=0.1)
    plain = bootstrap_mean(alike, resamples(np.arange(1000), rng, 4000))
    assert plain.high - plain.low < 0.4 * (found.high - found.low)
    found, plain = (
        bootstrap_mean(apart, each) for each in (samples, draw_resamples(np.arange(1000)))
    )
    assert found.high - found.low == pytest.approx(plain.high - plain.low, rel=0.35)


def test_the_largest_value_of_a_share_in_every_sample() -> None:
    """Against every sample written out."""
    rng = np.random.default_rng(6)
    x = rng.exponential(1.0, 30)
    samples = resamples(np.arange(30) // 2, rng, 50)
    for share in (0.05, 0.5, 1.0):
        found = largest_of_share(x, share, samples)
        for row, value in zip(samples.astype(int), found, strict=True):
            drawn = np.sort(np.repeat(x, row))[::-1]
            assert value == drawn[max(math.ceil(share * len(drawn) - 1e-9), 1) - 1]


def test_nothing_to_estimate_from_is_unknown() -> None:
    assert np.isnan(bootstrap_mean([], draw_resamples(np.arange(0))).value)
    assert np.isnan(percentiles(float("nan"), np.array([1.0, 2.0])).value)
    assert np.isnan(percentiles(1.0, np.array([np.nan, np.nan])).low)


def test_exceedance_counts_what_lies_above() -> None:
    found = exceedance([0.0, 10.0, 20.0, 30.0], [10.0, 40.0])
    assert [estimate.value for estimate in found] == [0.5, 0.0]
    assert found[0] == wilson(2, 4)
