"""The worst attack of the suite: chosen on its own runs, kept by run, scored by formula."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from spoofgym.bench.runs.record import MEASURES, Aim, Protection, Winner, compute_upper_quantile
from spoofgym.bench.scores.campaign import compare_controls, estimate_reach, score_protection
from spoofgym.bench.scores.detector import FamilyScore
from spoofgym.bench.scores.exceeded import estimate_exceeded
from spoofgym.bench.scores.statistics import draw_resamples, interval
from spoofgym.bench.search.attack_suite import list_aims

FIRST, TOTAL = MEASURES[0], "undetected_total_m"


def winner(spoofer, aims, first, total=None):
    moved = {FIRST: first} if total is None else {FIRST: first, TOTAL: total}
    return Winner("a", spoofer, "rate_mps", 0.5, {"name": "ramp"}, tuple(aims), moved)


def protected(label, displacement, counts=None):
    x = np.asarray(displacement, dtype=np.float64)
    best = winner("ramp(tuned)", list_aims([FIRST, TOTAL], [10.0], skies=True), x, x + 2.0)
    kept = np.ones(len(x), dtype=np.bool_) if counts is None else np.asarray(counts)
    return Protection({"detector": label}, (best,), kept, np.arange(len(x)) % 20, np.array([3, 4]))


def of_winners(*winners, sky=None):
    count = len(winners[0].displacement[FIRST])
    under = np.zeros(count, dtype=np.int64) if sky is None else sky
    return Protection({"detector": "x"}, winners, np.ones(count, dtype=np.bool_), under, None)


def test_the_scores_are_what_the_runs_say_and_worst_skies_that_hold_less_have_no_figure():
    x = np.arange(200.0)
    counts = np.arange(200) % 2 == 0
    found = score_protection(protected("ewma", x, counts), [10.0])
    assert found["counted"] == 100
    by_aim = {(r["measure"], r["share"], r["worst_skies"]): r for r in found["exceeded"]}
    for share in (0.5, 0.05):
        wanted = compute_upper_quantile(x[counts], share)
        assert by_aim[FIRST, share, False]["value"] == wanted
        assert by_aim[TOTAL, share, False]["value"] == wanted + 2.0
    under = counts & np.isin(np.arange(200) % 20, (3, 4))
    worst = by_aim[FIRST, 0.5, True]
    assert (worst["value"], worst["runs"]) == (compute_upper_quantile(x[under], 0.5), under.sum())
    few_skies = by_aim[FIRST, 0.05, True]
    assert compute_upper_quantile(x[under], 0.05) < compute_upper_quantile(x[counts], 0.05)
    assert few_skies["value"] is None
    for row in found["exceeded"]:
        assert row is few_skies or row["low"] <= row["value"] <= row["high"]
        assert (row["letter"], row["setting"], row["at"]) == ("a", "rate_mps", 0.5)
    p_hmi = {row["measure"]: row["value"] for row in found["p_hmi"]}
    assert p_hmi[FIRST] == pytest.approx((x[counts] > 10.0).mean(), abs=1e-6)
    assert p_hmi[TOTAL] == pytest.approx((x[counts] > 8.0).mean(), abs=1e-6)
    assert p_hmi[FIRST] < p_hmi[TOTAL]
    chosen = np.isin(np.arange(200) % 20, (3, 4))
    for less, kept in ((1.0, False), (1e-3, True)):
        x = np.where(chosen, 50.0 - less, 50.0)
        found = score_protection(protected("ewma", x), [])["exceeded"]
        values = [row["value"] for row in found if row["worst_skies"]]
        assert values == ([50.0 - less] * 2 if kept else [None] * 2)


def test_the_worst_of_all_winners_counts_at_every_limit():
    near, far = np.r_[np.full(40, 15.0), np.zeros(60)], np.r_[np.full(90, 50.0), np.zeros(10)]
    low, high = (Aim(FIRST, limit_m=limit) for limit in (10.0, 40.0))
    found = score_protection(
        of_winners(winner("far", [high], far), winner("near", [low], near)), [10.0, 40.0]
    )
    rows = [(p["alert_limit_m"], p["value"], p["spoofer"]) for p in found["p_hmi"]]
    assert rows == [(10.0, 0.9, "far"), (40.0, 0.9, "far")]
    # what is exceeded in a share of the runs counts at the limits, too
    moved, none = np.r_[np.full(10, 50.0), np.zeros(90)], np.zeros(100)
    found = score_protection(
        of_winners(winner("limit", [high], none), winner("share", [Aim(FIRST, 0.05)], moved)),
        [40.0],
    )
    assert found["exceeded"][0]["value"] == 50.0
    assert found["p_hmi"][0]["value"] == pytest.approx(0.1)
    # and by the total error another attack may be the worst
    same, zero, big = np.full(50, 30.0), np.zeros(50), np.full(50, 60.0)
    limits = [Aim(FIRST, limit_m=limit) for limit in (20.0, 40.0)]
    off = winner("off", [Aim(TOTAL, 0.5)], zero, big)
    found = score_protection(of_winners(winner("near", limits, same, same), off), [20.0, 40.0])
    rows = [(r["measure"], r["alert_limit_m"], r["value"], r["spoofer"]) for r in found["p_hmi"]]
    assert rows == [
        (FIRST, 20.0, 1.0, "near"),
        (FIRST, 40.0, 0.0, "near"),
        (TOTAL, 20.0, 1.0, "near"),
        (TOTAL, 40.0, 1.0, "off"),
    ]


def test_a_hazard_lies_beyond_the_limit_and_the_surer_of_two_attacks_is_chosen():
    at, beyond = (
        FamilyScore("ramps", False, 10.0, protected("x", np.full(40, x))) for x in (10.0, 10.5)
    )
    assert (at.p_hmi.value, at.resample_hmi().max()) == (0.0, 0.0)
    assert (beyond.p_hmi.value, beyond.resample_hmi().min()) == (1.0, 1.0)
    aim = Aim(FIRST, limit_m=10.0)
    sure, rash = np.full(20, 19.0), np.r_[np.full(19, 400.0), 11.0]
    assert aim.worth(sure) > aim.worth(rash)
    assert aim.worth(np.r_[rash[:-1], 9.0]) < aim.worth(rash)
    # where none does, the one that comes nearest
    assert aim.worth(np.full(20, 9.9)) > aim.worth(np.full(20, 2.0)) > aim.worth(np.zeros(20))


def test_what_is_exceeded_in_few_runs_is_no_less_than_in_many():
    sure, rash = np.full(100, 30.0), np.r_[np.full(4, 400.0), np.full(96, 10.0)]
    winners = (
        winner(name, [Aim(FIRST, share)], x)
        for name, share, x in (("sure", 0.5, sure), ("rash", 0.05, rash))
    )
    protection = of_winners(*winners, sky=np.arange(100) % 20)
    found = score_protection(protection, [])["exceeded"]
    rows = [(row["share"], row["value"], row["low"], row["spoofer"]) for row in found]
    assert rows == [(0.5, 30.0, 30.0, "sure"), (0.05, 30.0, 30.0, "sure")]
    none = protected("never", np.zeros(100))
    few = compare_controls([], [none, protection], {"never": "any", "x": "0.2"})[-1]
    assert (few["score"], few["difference_m"]["value"]) == ("protection 5 %", 30.0)


def test_the_interval_of_an_exceeded_displacement_is_that_of_its_resamples():
    x = np.random.default_rng(3).exponential(10.0, 400)
    attacks = of_winners(winner("x", [Aim(FIRST, 0.5)], x))
    found = estimate_exceeded(Aim(FIRST, 0.5), (attacks, draw_resamples(np.arange(400))))
    assert found.value == compute_upper_quantile(x, 0.5)
    # the median of an exponential, and the spread of its order statistic
    spread = 1.96 * 10.0 / np.sqrt(400)
    assert found.low == pytest.approx(found.value - spread, abs=0.5 * spread)
    assert found.high == pytest.approx(found.value + spread, abs=0.5 * spread)
    none = protected("x", x, np.zeros(400, dtype=np.bool_))
    assert np.isnan(estimate_exceeded(Aim(FIRST, 0.5), (none, np.zeros((9, 0)))).value)


@pytest.mark.parametrize(("runs", "bounded"), [(71, False), (72, True)])
def test_few_runs_have_no_upper_end_of_what_a_twentieth_exceeds(runs, bounded):
    """All 71 lie below the 95 % quantile with a chance of 0.95^71 = 2.6 %; of 72, of 2.5 %."""
    x = np.random.default_rng(3).exponential(10.0, runs)
    attacks, samples = (
        of_winners(winner("x", [Aim(FIRST, 0.05)], x)),
        draw_resamples(np.arange(runs)),
    )
    found = estimate_exceeded(Aim(FIRST, 0.05), (attacks, samples))
    assert found.low < found.value
    assert np.isfinite(found.high) == bounded
    assert interval(found.as_json()).endswith("or more)") != bounded
    alone = estimate_reach(x, 0.05, samples)  # of one attack, as a campaign has it
    assert (alone.value, np.isfinite(alone.high)) == (found.value, bounded)


def at_values(values, alarm_amplitude, share):
    """One attack that moves 100 m at the value 1, and hardly anything where it alarms."""
    played = []
    for value in values:
        moved = np.where(alarm_amplitude > value, 100.0 * value, 3.0 * value)
        each = winner("curve", [Aim(FIRST, share)], moved)
        spec = {"name": "curve", "amplitude": value}
        played.append(replace(each, setting="amplitude", value=value, spec=spec))
    return of_winners(*played, sky=np.arange(len(alarm_amplitude)) % SKIES)


def draw_alarm_amplitudes(rng):
    """(192,) logarithm of alarm amplitudes, alike under a sky; a standard normal."""
    sky, noise = rng.standard_normal(SKIES), rng.standard_normal((6, SKIES))
    return (0.3 * sky + np.sqrt(0.91) * noise).ravel()


SKIES, SPREAD = 32, 0.3


def test_an_interval_has_a_width_where_the_whole_displacement_at_one_value_is_exceeded():
    alarms = np.exp(SPREAD * draw_alarm_amplitudes(np.random.default_rng(2)))
    for share, values in ((0.5, [0.85, 0.95, 1.06]), (0.05, [1.3, 1.45, 1.6, 1.8])):
        row = score_protection(at_values(values, alarms, share), [])["exceeded"][0]
        assert row["value"] in [100.0 * value for value in values]
        assert row["value"] + 1.0 < row["high"] < 1.2 * row["value"]


@pytest.mark.parametrize("share", [0.5, 0.05])
def test_intervals_hold_what_the_best_setting_between_played_ones_would_exceed(share):
    """Nominally 95 %; at least 50 of 60 sets of runs: of a bootstrap that knows all alarm
    amplitudes it is 92 to 94 %, and 49 and fewer of 60 have a probability of 1 % at 92 %."""
    rng, held, aim = np.random.default_rng(5), 0, Aim(FIRST, share)
    truth = 100.0 * np.exp(SPREAD * norm.ppf(1.0 - share))
    for _ in range(60):
        alarms = np.exp(SPREAD * draw_alarm_amplitudes(rng))
        values = 0.01 * truth * 1.12 ** (np.arange(-2.0, 3.0) + rng.random())
        found = at_values(values.tolist(), alarms, share)
        each = estimate_exceeded(aim, (found, draw_resamples(found.sky, 200)))
        held += each.low <= truth <= each.high
    assert held >= 50


def test_nothing_is_taken_between_values_that_get_no_farther():
    # nor where all runs notice the larger value, which says nothing of those below it
    for values, moved in (([0.5, 1.0, 2.0], 200.0), ([1.0, 10.0], 100.0)):
        found = at_values(values, np.full(64, 9.0), 0.5)
        each = estimate_exceeded(Aim(FIRST, 0.5), (found, draw_resamples(found.sky, 50)))
        assert each == (moved, moved, moved)


def test_intervals_are_wider_where_runs_under_a_sky_are_alike():
    rng = np.random.default_rng(7)
    sky = np.arange(200) % 20
    alike, counts = 5.0 * sky, sky < 9
    apart, few = rng.permutation(alike), alike.copy()
    few[counts] = rng.permutation(alike[counts])

    def width(x, kept=None):
        row = score_protection(protected("ewma", x, kept), [10.0])["exceeded"][0]
        assert (row["share"], row["worst_skies"]) == (0.5, False)
        return row["high"] - row["low"]

    assert width(alike) > 2.0 * width(apart)
    assert width(alike, counts) > 2.0 * width(few, counts)
    never, worse = protected("never", np.zeros(200)), protected("worse", alike)
    rows = compare_controls([], [never, worse], {"never": "any", "worse": "0.2"})
    gap = next(row for row in rows if row["detector"] == "worse")["difference_m"]
    assert gap["high"] - gap["low"] == pytest.approx(width(alike), rel=1e-6)


def test_it_comes_back_as_it_was_written():
    made = protected("ewma", [1.0, 2.5, 3.0], [True, False, True])
    arrays, record = made.parts()
    again = Protection.from_parts(arrays, json.loads(json.dumps(record, allow_nan=False)))
    assert again.parts()[1] == record
    assert {*again.parts()[0]} == {*arrays}
    assert again.winner(Aim(FIRST, 0.5)) is not None
    np.testing.assert_array_equal(again.counts, made.counts)


def test_detectors_are_compared_over_the_runs_that_count_for_both_and_not_by_millimetres():
    rng = np.random.default_rng(1)
    x = rng.exponential(10.0, 300)
    drawn = rng.random(300) > 0.05
    footings = {"never": "any", "lottery": "0.2", "worse": "0.2", "mine": "0.3", "as-is": "nominal"}
    played = [
        protected("never", x),
        protected("lottery", np.where(drawn, x, 0.0), drawn),
        protected("worse", x + 5.0),
        *(protected(label, x + 9.0) for label in ("mine", "as-is")),
    ]
    rows = compare_controls([], played, footings)
    found = {(r["detector"], r["control"], r["score"]): r for r in rows}
    for score in ("protection 50 %", "protection 5 %"):
        # what chance takes out counts for neither
        same = found["lottery", "never", score]["difference_m"]
        assert same == {"value": 0.0, "low": 0.0, "high": 0.0}
        assert found["worse", "never", score]["above"]
        assert found["worse", "lottery", score]["difference_m"]["value"] == pytest.approx(5.0)
        assert ("mine", "never", score) in found
        # never at different rates, and never as published
        assert ("mine", "lottery", score) not in found
        assert ("as-is", "never", score) not in found
    none = protected("never", np.full(200, 500.0))
    for less, below in ((1e-5, False), (1.0, True)):
        other = protected("x", np.full(200, 500.0 - less))
        rows = compare_controls([], [none, other], {"never": "any", "x": "0.2"})
        rows = [row for row in rows if row["detector"] == "x"]
        assert [row["below"] for row in rows] == [below, below]
        assert all(row["difference_m"]["high"] < 0.0 for row in rows)
