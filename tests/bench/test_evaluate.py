"""Scores of any spoofer without a campaign: by the same rule, paired, and refused where it must."""

import json

import numpy as np
import pytest

import spoofgym
from spoofgym.bench.experiments.campaign import run_campaign, summarize
from spoofgym.bench.experiments.evaluate import Evaluator, evaluate, get_rule
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.runs.record import MEASURES
from spoofgym.bench.search.amplitude import EXACT, UPPER_LIMIT, Tuning
from spoofgym.spoofers import make_spoofer
from spoofgym.tasks import TASKS

from .support import RAMP, WORLD

RUNS, FIT = 60, 80
SIZES = {"runs": RUNS, "fit_runs": FIT}


@pytest.fixture(scope="module")
def judge():
    return Evaluator(**WORLD, **SIZES)


@pytest.fixture(scope="module")
def ramp(judge):
    return judge.score("ramp")


@pytest.fixture(scope="module")
def half(judge):
    return judge.score(constant(0.05), amplitude=None)


def constant(size=0.1):
    return lambda seen: np.full((len(seen), 1), size)


def test_a_score_is_that_of_a_campaign(ramp, tmp_path):
    world = {key: value for key, value in WORLD.items() if key != "detector"}
    tuning = Tuning(runs=FIT, sift_runs=FIT // 16)
    suite = Suite(**world, detectors=[WORLD["detector"]], spoofers=[RAMP], runs=RUNS, tuning=tuning)
    folder = run_campaign(suite, tmp_path / "campaign")
    (wanted,) = (c for c in summarize(folder)["cells"] if c["spoofer"] == "ramp(tuned)")
    assert ramp.stealthy_displacement_m.as_json() == wanted["stealthy_displacement_m"]
    assert (ramp.alarm_rate.as_json(), ramp.counted) == (wanted["alarm_rate"], wanted["counted"])
    assert ramp.value == folder.search(ramp.detector, "ramp(tuned)").value
    assert ramp.value != ramp.budget  # a setting was found, not copied


def test_a_function_is_fitted_to_the_budget_and_commands_along_the_target(judge, ramp):
    fitted = judge.score(constant(), label="mine")
    assert (fitted.setting, ramp.setting) == ("amplitude", "rate_mps")
    assert fitted.knowledge == "blind"
    # a set-point along the target direction is a ramp of that rate to the east
    assert 0.1 * fitted.value == pytest.approx(ramp.value, rel=0.1)
    assert fitted.ratio_to(ramp).value == pytest.approx(1.0, abs=0.1)
    assert fitted.keeps_budget
    assert "mine (blind, amplitude" in str(fitted)
    quiet = judge.score(constant(1e-4), largest_amplitude=1e5)
    assert quiet.value == pytest.approx(1000.0 * fitted.value, rel=0.05)
    assert quiet.ratio_to(fitted).value == pytest.approx(1.0, abs=0.05)
    assert quiet.keeps_budget
    assert judge.score(constant(1e-4)).value == 10.0  # the largest one that is tried


def test_ratios_are_paired_and_have_an_interval_of_oracles_only_where_asked_for(judge, half):
    ratio = half.ratio_to(judge.score(constant(), amplitude=1.0))
    assert ratio.low <= ratio.value <= ratio.high
    assert ratio.value == pytest.approx(0.5, abs=0.05)
    assert ratio.high - ratio.low < 0.05
    # runs of another number, seed or world are others, though all of them count
    few = {**WORLD, "runs": 8, "fit_runs": FIT}
    score, *others = (
        Evaluator(**{**few, **more}).score(constant(0.05), amplitude=None)
        for more in ({}, {"entropy": 1}, {"scenario": "groves"})
    )
    assert all(one.counts.all() for one in (score, *others))
    assert score.ratio_to(score).value == pytest.approx(1.0)
    for one in (half, *others):
        with pytest.raises(ValueError, match="world, their number and `entropy` must be the same"):
            one.ratio_to(score)
    oracle = judge.score("feedback", amplitude=0.5)
    assert (half.oracle, oracle.oracle) == (False, True)
    with pytest.raises(ValueError, match=r"\(oracle\).*`oracles=True`"):
        half.ratio_to(oracle)
    assert oracle.ratio_to(oracle).value == pytest.approx(1.0)
    both = half.ratio_to(oracle, oracles=True).value * oracle.ratio_to(half, oracles=True).value
    assert both == pytest.approx(1.0)


def test_amplitudes_are_fitted_exactly_but_in_the_first_suite(ramp, bars):
    exact, upper = (evaluate("ramp", **WORLD, **SIZES, **x) for x in ({}, {"rule": UPPER_LIMIT}))
    assert all(0.3 < sum(done) / total < 3.0 for total, done in bars)
    assert len(bars) == 2
    assert exact.at_budget["budget"] == 0.05
    estimate = exact.stealthy_displacement_m
    assert estimate.as_json() == exact.at_budget[MEASURES[0]]
    assert estimate.low < estimate.value < estimate.high
    assert estimate.value == pytest.approx(exact.displacement_m[exact.counts].mean(), rel=0.02)
    assert exact.keeps_budget
    assert 0.0 < exact.alarm_rate.value <= 0.05
    assert exact.at_budget["amplitude"]["value"] == pytest.approx(exact.value, rel=1e-3)
    assert exact.at_budget["undetected_total_m"]["value"] > 0.0
    assert upper == ramp
    assert upper.at_budget is None
    rules = {key: get_rule(key) for key in (None, *TASKS)}
    assert rules.pop(None) == EXACT
    assert rules == {key: EXACT if key[0] == "S" else UPPER_LIMIT for key in TASKS}


def test_a_score_is_json_and_the_same_again_and_says_where_it_alarms_too_often(judge):
    score = judge.score(make_spoofer("ramp"), amplitude=0.3)
    data = json.loads(json.dumps(score.as_dict(), allow_nan=False))
    assert (data["value"], data["runs"]) == (0.3, RUNS)
    assert evaluate(make_spoofer("ramp"), **WORLD, **SIZES, amplitude=0.3) == score
    assert spoofgym.evaluate is evaluate
    found = judge.score(constant(1.0), amplitude=None)
    assert found.alarm_rate.value > 0.5
    assert not found.keeps_budget
    assert "over the budget of 5 %" in str(found)
    assert found.fit_within_budget is None


def test_whether_a_spoofer_fits_is_told_before_anything_is_played(judge, monkeypatch):
    monkeypatch.setattr("spoofgym.bench.experiments.evaluate.Panel", None)
    for fits in ("ramp", {"name": "step"}, "open-loop"):
        judge.check(fits)
    with pytest.raises(ValueError, match="does not fit this attack"):
        judge.check("hidden-pool-ppo")
    with pytest.raises(ValueError, match="unknown spoofer 'nobody'"):
        judge.check("nobody")


@pytest.mark.parametrize(
    ("policy", "settings", "message"),
    [
        (3, {}, "a policy must be a model of stable-baselines3"),
        ("C:/models/a.ZIP", {}, "C:/models/a.ZIP is a pickled file, which is never opened"),
        (constant(np.nan), {}, "returned NaN for receiver 0"),
        (constant(), {"amplitude": "large"}, "`amplitude` must be 'fitted', a number"),
        ("ramp", {"knowledge": "blind"}, "are for models"),
        ("ramp", {"largest_amplitude": 1e4}, "`largest_amplitude` is for models"),
        (constant(), {"largest_amplitude": 1e-3}, "above 0.001, got 0.001"),
        (constant(), {"largest_amplitude": 1e4, "amplitude": 1.0}, "is for `amplitude='fitted'`"),
        (make_spoofer({"name": "step", "amplitude": 0.5}), {}, "has the amplitude 0.5 already"),
    ],
)
def test_what_is_no_spoofer_is_refused(judge, policy, settings, message):
    with pytest.raises((ValueError, TypeError), match=message):
        judge.score(policy, **settings)


@pytest.mark.usefixtures("default_rate")
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"env": "T3"}, "unknown environment 'T3'"),
        ({"task": "T3", "scenario": "trolley"}, "`scenario` can't be given with task"),
        ({**WORLD, "runs": 1}, "`runs` must be a whole number of at least 2, got 1"),
        ({**WORLD, "fit_runs": 58}, "`fit_runs` must be .* at least 59, got 58"),
        ({**WORLD, "detector": "ewma"}, "there is no calibration of ewma .* `spoofgym calibrate"),
    ],
)
def test_worlds_are_checked_before_anything_is_played(settings, message):
    with pytest.raises((ValueError, TypeError), match=message):
        Evaluator(**settings)


def test_what_the_victim_reports_is_seen_by_a_policy_that_knows_it(judge, half):
    seen = []

    def follow(observation):
        seen.append(observation[:, -3:-1].copy())  # north and east, in parts of their scale
        return constant(0.05)(observation)

    known = judge.score(follow, amplitude=None, knowledge="blind+reported")
    assert (known.knowledge, len(seen)) == ("blind+reported", 60)  # one a command, of all runs
    assert np.array_equal(known.displacement_m, half.displacement_m)  # it does not use them
    assert np.ptp(seen[-1][:, 1]) > 0.0
    assert not np.array_equal(seen[-1], seen[0])
