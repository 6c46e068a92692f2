"""Statistics against closed forms and hand-made arrays."""

from __future__ import annotations

import numpy as np
import pytest

from spoofgym.bench.metrics import (
    bootstrap_mean,
    clopper_pearson,
    clustered_proportion,
    exceedance,
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
    found = bootstrap_mean(values, resamples(400, rng, 4000))
    spread = Z * values.std() / 20.0
    assert found.value == values.mean()
    assert found.low == pytest.approx(values.mean() - spread, abs=0.1 * spread)
    assert found.high == pytest.approx(values.mean() + spread, abs=0.1 * spread)


def test_paired_differences_are_narrower_than_both() -> None:
    rng = np.random.default_rng(4)
    common = 10.0 * rng.standard_normal(200)
    one, other = common, common + 1.0 + 0.1 * rng.standard_normal(200)
    samples = resamples(200, rng)
    gap = bootstrap_mean(other - one, samples)
    assert gap.low > 0.9
    assert gap.high < 1.1
    assert bootstrap_mean(one, samples).high - bootstrap_mean(one, samples).low > 1.0


def test_nothing_to_estimate_from_is_unknown() -> None:
    assert np.isnan(percentiles(float("nan"), np.array([1.0, 2.0])).value)
    assert np.isnan(percentiles(1.0, np.array([np.nan, np.nan])).low)


def test_exceedance_counts_what_lies_above() -> None:
    found = exceedance([0.0, 10.0, 20.0, 30.0], [10.0, 40.0])
    assert [estimate.value for estimate in found] == [0.5, 0.0]
    assert found[0] == wilson(2, 4)
