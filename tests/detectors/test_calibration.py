"""Order statistics of clean runs, the file that keeps them, and what they refuse to say."""

import json
import math
import os

import numpy as np
import pytest

from spoofgym.detectors.calibration_file import (
    STANDARD_RATES,
    Calibration,
    compute_min_runs,
    compute_rank,
    hourly_rate,
    list_stored_ranks,
    round_digits_up,
    run_probability,
)

WINDOW_S = 160.0


def calibration(maxima, *, before=0.0, bisected=False, window_s=WINDOW_S):
    """Of a made-up detector, from the maxima of its runs."""
    runs = len(maxima)
    ranks = list_stored_ranks(runs, window_s)
    order = np.sort(maxima)[::-1]
    return Calibration(
        world={"kind": "none"},
        detector={"name": "toy"},
        window_s=window_s,
        runs=runs,
        entropy=0,
        seed_name="none",
        ranks=tuple(ranks),
        largest=tuple(round_digits_up(order[np.array(ranks) - 1]).tolist()),
        before=((1, before), (runs, before)),
        witnesses=((0, 0.0, float(maxima[0])),),
        bisected=bisected,
    )


def test_a_rate_an_hour_is_a_probability_for_a_run():
    assert run_probability(0.2, WINDOW_S) == pytest.approx(1.0 - math.exp(-0.2 * 160 / 3600))
    assert hourly_rate(run_probability(0.002, 77.0), 77.0) == pytest.approx(0.002)
    assert hourly_rate(1.0, 77.0) == math.inf


@pytest.mark.parametrize("p", [0.001, 0.00885, 0.05, 0.3])
def test_the_rank_is_the_lowest_that_keeps_the_probability(p):
    for n in (compute_min_runs(p), compute_min_runs(p) + 1, 2000, 54_321):
        rank = compute_rank(p, n)
        # a new run among n that are like it exceeds the order statistic of this rank so often
        assert rank / (n + 1) <= p + 1e-9 < (rank + 1) / (n + 1)
    assert compute_rank(p, compute_min_runs(p) - 1) < 1 <= compute_rank(p, compute_min_runs(p))


def test_a_new_run_exceeds_the_scale_with_the_stated_probability():
    rng, n, trials = np.random.default_rng(3), 400, 500
    p = run_probability(2.0, WINDOW_S)
    exceeded = 0.0
    for _ in range(trials):
        scale = calibration(rng.random(n)).point(2.0).scale
        exceeded += 1.0 - scale
    assert exceeded / trials == pytest.approx(compute_rank(p, n) / (n + 1), rel=0.05)
    assert exceeded / trials < p


def test_a_thinned_file_never_exceeds_a_rate():
    maxima = np.random.default_rng(4).permutation(50_000) + 1.0
    found = calibration(maxima)
    assert len(found.ranks) < 1000
    for rate in np.geomspace(0.001, 100.0, 200).tolist():
        point = found.point(rate)
        exact = compute_rank(point.per_run, found.runs)
        assert exact / 1.011 - 1 <= point.rank <= exact
        assert (maxima > point.scale).sum() <= exact - 1
        assert not point.extrapolated
    for rate in STANDARD_RATES:
        exact = compute_rank(run_probability(rate, WINDOW_S), found.runs)
        assert found.point(rate).rank == exact


def test_written_scales_are_never_below_the_maxima():
    values = np.random.default_rng(5).lognormal(size=5000) * 10.0 ** np.arange(-5, 5).repeat(500)
    up = round_digits_up(values)
    assert (up >= values).all()
    np.testing.assert_allclose(up, values, rtol=1.1e-11)
    assert round_digits_up(np.zeros(3)).tolist() == [0.0, 0.0, 0.0]
    assert json.loads(json.dumps(up.tolist())) == up.tolist()


def test_a_tail_is_fitted_beyond_the_largest_alone_and_marked():
    rng = np.random.default_rng(6)
    found = calibration(rng.exponential(size=4000) + 2.0)
    inside, beyond = found.point(0.01), found.point(0.001)
    assert (inside.extrapolated, inside.rank) == (False, 1)
    assert (beyond.extrapolated, beyond.rank) == (True, 0)
    assert "fitted tail" in str(beyond)
    # an exponential tail: its quantile is known
    assert beyond.scale == pytest.approx(2.0 - math.log(beyond.per_run), rel=0.25)
    assert beyond.scale >= found.largest[0]


def test_a_tail_is_refused_past_a_tenth_of_a_run():
    found = calibration(np.random.default_rng(7).exponential(size=1000) + 1.0)
    least = hourly_rate(1.0 / 10_000, WINDOW_S)
    assert found.point(least * 1.001).extrapolated
    with pytest.raises(ValueError, match=r"for which 1000 clean runs are too few: it takes at lea"):
        found.point(least * 0.999)
    few = calibration(np.arange(1.0, 100.0))
    with pytest.raises(ValueError, match=r"99 clean runs are too few: .* at least 113, or 500 for"):
        few.point(0.2)


def test_a_state_has_no_tail():
    found = calibration(np.arange(1.0, 2001.0), bisected=True)
    with pytest.raises(ValueError, match=r"too few: it takes at least 11250$"):
        found.point(0.002)


def test_a_rate_is_a_number_above_0():
    with pytest.raises(ValueError, match="`false_alarms_per_hour` must be a number above 0, got 0"):
        calibration(np.arange(1.0, 500.0)).point(0.0)


def test_a_rate_above_what_a_run_can_show():
    found = calibration(np.arange(1.0, 500.0))
    most = hourly_rate(499.0 / 500.0, WINDOW_S)
    assert 1.0 <= found.point(0.999999 * most).scale < 7.0  # ranks are thinned there
    with pytest.raises(
        ValueError, match=r"must be at most 139\.\d* for 499 runs of 160 s: a run h"
    ):
        found.point(1.01 * most)


def test_an_atom_at_zero_is_refused():
    maxima = np.r_[np.zeros(1990), np.arange(1.0, 11.0)]
    found = calibration(maxima)
    assert found.point(0.05).scale > 0.0
    with pytest.raises(
        ValueError, match=r"toy is degenerate: its largest value is 0 in 99\.5 % of "
    ):
        found.point(0.2)


def test_alarms_before_the_attack_are_counted():
    found = calibration(np.linspace(1.0, 2.0, 500), before=1.5)
    assert found.point(2.0).warmup_alarms == 0.0
    assert found.point(100.0).warmup_alarms == 1.0


def test_files(tmp_path):
    made = calibration(np.arange(1.0, 3000.0))
    saved = made.save(tmp_path / "folder" / "toy.json")
    assert Calibration.load(saved.path) == made
    assert [path.name for path in saved.path.parent.iterdir()] == ["toy.json"]
    text = saved.path.read_text()
    for k, (bad, message) in enumerate(
        [
            ("{}", "is no calibration: it has no 'format'"),
            (text.replace('"format":1', '"format":2'), "its format is 2, this version reads 1"),
            (text.replace('"runs":2999', '"runs":29'), "are not in order"),
            (text[:-20], "is no calibration"),
            (text.replace('"largest":[2999.0', '"largest":[-1.0'), "are not in order"),
        ]
    ):
        path = tmp_path / "bad.json"
        path.unlink(missing_ok=True)
        path.write_text(bad)
        os.utime(path, (k, k))
        with pytest.raises(ValueError, match=message):
            Calibration.load(path)
