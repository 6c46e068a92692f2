"""Scores against closed forms and hand-made arrays."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spoofgym.bench.cells import Cell
from spoofgym.bench.metrics import (
    bootstrap_mean,
    clopper_pearson,
    clustered_proportion,
    counts_of,
    exceedance,
    percentiles,
    resamples,
    restricted_mean_delay,
    undetected_displacement,
    wilson,
)
from spoofgym.bench.summary import score_cell

pytestmark = pytest.mark.nojit

Z = 1.959963984540054


def test_undetected_displacement_by_hand() -> None:
    # five epochs of errors, two epochs to alert
    error = np.array([[1.0, 3.0, 2.0, 5.0, 4.0]]).T
    for first_alarm, expected in [
        (0, 5.0),
        (7, 5.0),
        (6, 3.0),
        (5, 3.0),
        (4, 1.0),
        (3, 0.0),
        (1, 0.0),
    ]:
        assert undetected_displacement(error, [first_alarm], 2)[0] == expected


def test_what_comes_after_the_alarm_may_be_unknown() -> None:
    error = np.array([[1.0, 2.0, np.nan, np.nan]]).T
    assert undetected_displacement(error, [3], 1)[0] == 1.0


@given(
    error=st.lists(st.floats(0.0, 100.0), min_size=1, max_size=12),
    alarms=st.lists(st.booleans(), min_size=15, max_size=15),
    hold=st.integers(0, 3),
)
def test_undetected_displacement_is_what_its_definition_says(
    error: list[float], alarms: list[bool], hold: int
) -> None:
    alarm = np.array(alarms[: len(error) + hold])
    first = int(alarm.argmax()) + 1 if alarm.any() else 0
    # the largest error at k with no alarm in epochs 1 to k + hold
    expected = max([0.0] + [e for k, e in enumerate(error, start=1) if not alarm[: k + hold].any()])
    assert undetected_displacement(np.array(error)[:, None], [first], hold)[0] == expected


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


def test_restricted_mean_by_hand() -> None:
    # detected at 1 and 3, one run no longer watched at 2: S = 1, 2/3 from 1 on, 0 from 3 on
    found = restricted_mean_delay([1.0, 2.0, 3.0], [True, False, True], 4.0)
    assert found == pytest.approx(1.0 + 2.0 * 2.0 / 3.0)


def test_restricted_mean_without_early_losses_is_the_mean_of_the_cut_delays() -> None:
    rng = np.random.default_rng(3)
    delay = rng.exponential(10.0, 50).round(1)
    found = restricted_mean_delay(np.minimum(delay, 8.0), delay < 8.0, 8.0)
    assert found == pytest.approx(np.minimum(delay, 8.0).mean())


def test_restricted_mean_of_exponential_delays() -> None:
    rng = np.random.default_rng(1)
    delay, lost = rng.exponential(10.0, 20_000), rng.exponential(25.0, 20_000)
    found = restricted_mean_delay(np.minimum(delay, lost), delay <= lost, 15.0)
    assert found == pytest.approx(10.0 * (1.0 - np.exp(-1.5)), rel=0.02)


def test_weights_are_repetitions() -> None:
    delay, seen = np.array([2.0, 2.0, 5.0, 1.0]), np.array([True, False, True, True])
    rows = np.array([0, 0, 1, 3, 3, 3, 2])
    weights = counts_of(rows[None, :4])[0] + np.bincount(rows[4:], minlength=4)
    repeated = restricted_mean_delay(delay[rows], seen[rows], 6.0)
    assert restricted_mean_delay(delay, seen, 6.0, weights) == pytest.approx(repeated)
    assert np.isnan(restricted_mean_delay(delay, seen, 6.0, np.zeros(4)))


def test_counts_of_samples() -> None:
    samples = resamples(7, np.random.default_rng(0), 5)
    expected = [[(row == run).sum() for run in range(7)] for row in samples]
    np.testing.assert_array_equal(counts_of(samples), expected)


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


def test_a_run_with_an_alarm_in_the_warm_up_counts_for_no_bound_of_the_delay() -> None:
    head = {"detector": "ewma", "spoofer": "step", "interval_s": 1.0, "steps": 80, "hold": 20}
    head |= dict.fromkeys(("spoofer_settings", "tuned_within_budget", "knowledge", "attack"))
    first, warm = np.array([10, 10, 10, 90, 90]), np.array([False, False, False, True, True])
    records = {"first_alarm": first, "warmup_alarm": warm}
    records |= dict.fromkeys(("undetected_displacement_m", "largest_error_m"), np.zeros(5))
    samples = resamples(5, np.random.default_rng(1), 200)
    score = score_cell(Cell(head, records, {}), samples, counts_of(samples))
    assert score["delay_s"] == {"value": 10.0, "low": 10.0, "high": 10.0}
    assert (score["delay_runs"], score["delay_excluded"]) == (3, 2)
