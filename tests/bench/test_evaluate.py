"""Scores of any spoofer without a campaign: by the same rule, paired, and refused where it must."""

from __future__ import annotations

import json

import numpy as np
import pytest

import spoofgym
from spoofgym.bench.experiments.campaign import run_campaign, summarize
from spoofgym.bench.experiments.evaluate import Evaluator, evaluate
from spoofgym.bench.experiments.suite import Suite
from spoofgym.bench.search.amplitude import Tuning
from spoofgym.policies.contract import NotFinite
from spoofgym.spoofers import make_spoofer

WORLD = {
    "scenario": "trolley",
    "receiver": "matched",
    "timeline": {"warmup_s": 40.0, "live_s": 5.0, "attack_s": 30.0, "time_to_alert_s": 2.0},
    "detector": {"name": "snapshot-chi2", "signals": "range_rate", "thresholds": "nominal"},
}
RUNS, FIT = 60, 80


@pytest.fixture(scope="module")
def judge() -> Evaluator:
    return Evaluator(**WORLD, runs=RUNS, fit_runs=FIT)


def constant(size: float = 0.1):
    def push(seen):
        return np.full((len(seen), 1), size)

    return push


def test_a_score_is_that_of_a_campaign(judge, tmp_path):
    world = {key: value for key, value in WORLD.items() if key != "detector"}
    suite = Suite(
        **world,
        detectors=[WORLD["detector"]],
        spoofers=[{"name": "ramp", "rate_mps": "tuned"}],
        runs=RUNS,
        tuning=Tuning(runs=FIT, sift_runs=FIT // 16),
    )
    folder = run_campaign(suite, tmp_path / "campaign")
    cells = {cell["spoofer"]: cell for cell in summarize(folder)["cells"]}
    found = judge.score("ramp")
    wanted = cells["ramp(tuned)"]
    assert found.stealthy_displacement_m.as_json() == wanted["stealthy_displacement_m"]
    assert found.alarm_rate.as_json() == wanted["alarm_rate"]
    assert found.counted == wanted["counted"]
    assert found.value == folder.search(found.detector, "ramp(tuned)").value
    assert found.value != found.budget  # a setting was found, not copied


def test_a_function_is_fitted_to_the_budget_and_commands_along_the_target(judge):
    fitted = judge.score(constant(), label="mine")
    ramp = judge.score("ramp")
    assert (fitted.setting, ramp.setting) == ("amplitude", "rate_mps")
    assert fitted.knowledge == "blind"
    # a set-point along the target direction is a ramp of that rate to the east
    assert 0.1 * fitted.value == pytest.approx(ramp.value, rel=0.1)
    assert fitted.ratio_to(ramp).value == pytest.approx(1.0, abs=0.1)
    assert fitted.keeps_budget
    assert "mine (blind, amplitude" in str(fitted)


def test_a_quiet_function_gets_as_far_as_a_loud_one_where_its_amplitude_may_be_large(judge):
    loud = judge.score(constant(0.5))
    quiet = judge.score(constant(1e-4), largest_amplitude=1e5)
    assert quiet.value == pytest.approx(5000.0 * loud.value, rel=0.05)
    assert quiet.ratio_to(loud).value == pytest.approx(1.0, abs=0.05)
    assert quiet.keeps_budget
    usual = judge.score(constant(1e-4))
    assert usual.value == 10.0  # the largest one that is tried
    assert usual.ratio_to(loud).value < 0.1


def test_what_alarms_too_often_is_no_score(judge):
    found = judge.score(constant(1.0), amplitude=None)
    assert found.alarm_rate.value > 0.5
    assert not found.keeps_budget
    assert "over the budget of 5 %" in str(found)
    assert found.fit_within_budget is None


def test_ratios_are_paired_and_have_an_interval(judge):
    half, whole = (
        judge.score(constant(0.05), amplitude=None),
        judge.score(constant(), amplitude=1.0),
    )
    ratio = half.ratio_to(whole)
    assert ratio.low <= ratio.value <= ratio.high
    assert ratio.value == pytest.approx(0.5, abs=0.05)
    assert ratio.high - ratio.low < 0.05
    other = Evaluator(**WORLD, runs=RUNS // 2, fit_runs=FIT).score(constant(), amplitude=1.0)
    with pytest.raises(ValueError, match="have not played the same runs"):
        half.ratio_to(other)


def test_runs_of_another_seed_or_world_are_not_the_same_ones_though_all_count():
    few = {"runs": 8, "fit_runs": FIT}
    score, other, elsewhere = (
        Evaluator(**{**WORLD, **few, **more}).score(constant(0.05), amplitude=None)
        for more in ({}, {"entropy": 1}, {"scenario": "groves"})
    )
    assert score.counts.all()
    assert score.ratio_to(score).value == pytest.approx(1.0)
    for one in (other, elsewhere):
        assert one.counts.all()
        with pytest.raises(ValueError, match="world, their number and `entropy` must be the same"):
            one.ratio_to(score)


def test_whether_a_spoofer_fits_is_told_before_anything_is_played(judge, monkeypatch):
    monkeypatch.setattr("spoofgym.bench.experiments.evaluate.Panel", None)
    for fits in ("ramp", {"name": "step"}, "blind-optimum"):
        judge.check(fits)
    with pytest.raises(ValueError, match="does not fit this attack"):
        judge.check("hidden-pool-ppo")
    with pytest.raises(ValueError, match="unknown spoofer 'nobody'"):
        judge.check("nobody")


def test_an_oracle_is_compared_with_others_only_where_that_is_asked_for(judge):
    blind = judge.score(constant(0.05), amplitude=None)
    oracle = judge.score("feedback", amplitude=0.5)
    assert (blind.oracle, oracle.oracle) == (False, True)
    for one, other in ((blind, oracle), (oracle, blind)):
        with pytest.raises(ValueError, match=r"\(oracle\).*`oracles=True`"):
            one.ratio_to(other)
    assert oracle.ratio_to(oracle).value == pytest.approx(1.0)
    both = blind.ratio_to(oracle, oracles=True).value * oracle.ratio_to(blind, oracles=True).value
    assert both == pytest.approx(1.0)


def test_a_score_is_json_and_the_same_again(judge):
    score = judge.score(make_spoofer("ramp"), amplitude=0.3)
    data = json.loads(json.dumps(score.as_dict(), allow_nan=False))
    assert data["value"] == 0.3
    assert data["runs"] == RUNS
    again = evaluate(make_spoofer("ramp"), **WORLD, runs=RUNS, fit_runs=FIT, amplitude=0.3)
    assert again == score
    assert spoofgym.evaluate is evaluate


def test_the_policy_is_asked_and_not_copied(judge):
    class Counting:
        def __init__(self):
            self.calls = 0

        def __call__(self, seen):
            self.calls += 1
            return np.zeros((len(seen), 1))

    policy = Counting()
    judge.score(policy, amplitude=None)
    assert policy.calls == 60  # one a command, of all runs together


@pytest.mark.parametrize(
    ("policy", "settings", "error", "message"),
    [
        (3, {}, TypeError, "a policy must be a model of stable-baselines3"),
        ("model.zip", {}, ValueError, "model.zip is a pickled file, which is never opened"),
        ("a.PKL", {}, ValueError, "a.PKL is a pickled file"),
        ("C:/models/a.zip", {}, ValueError, "C:/models/a.zip is a pickled file"),
        ("nobody", {}, ValueError, "unknown spoofer 'nobody'; valid: "),
        ("nobody.onnx", {}, ValueError, "there is no ONNX file nobody.onnx"),
        (
            lambda seen: np.full((len(seen), 1), np.nan),
            {},
            NotFinite,
            "returned NaN for receiver 0",
        ),
        (
            lambda seen: np.full((len(seen), 1), np.inf),
            {},
            NotFinite,
            "returned inf for receiver 0",
        ),
        (lambda seen: np.zeros((len(seen), 3)), {}, ValueError, r"not \(\d+, 1\)"),
        (constant(), {"amplitude": "large"}, ValueError, "`amplitude` must be 'fitted', a number"),
        (
            constant(),
            {"amplitude": -1.0},
            ValueError,
            "`amplitude` must be a number above 0, got -1",
        ),
        (constant(), {"knowledge": "psychic"}, ValueError, "psychic"),
        ("ramp", {"knowledge": "blind"}, ValueError, "are for models"),
        ("ramp", {"largest_amplitude": 1e4}, ValueError, "`largest_amplitude` is for models"),
        (
            constant(),
            {"largest_amplitude": 1e-3},
            ValueError,
            "above 0.001, got 0.001",
        ),
        (constant(), {"largest_amplitude": np.inf}, ValueError, "a number above 0.001, got inf"),
        (
            constant(),
            {"largest_amplitude": 1e4, "amplitude": 1.0},
            ValueError,
            "`largest_amplitude` is for `amplitude='fitted'`, got 1.0",
        ),
        (
            make_spoofer({"name": "step", "amplitude": 0.5}),
            {},
            ValueError,
            "amplitude already, 0.5",
        ),
    ],
)
def test_what_is_no_spoofer_is_refused(judge, policy, settings, error, message):
    with pytest.raises(error, match=message):
        judge.score(policy, **settings)


@pytest.mark.usefixtures("default_rate")
def test_a_detector_that_is_not_calibrated_here_says_how_that_is_done():
    with pytest.raises(ValueError, match=r"there is no calibration of ewma .* `spoofgym calibrate"):
        Evaluator(**{**WORLD, "detector": "ewma"})


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({}, ValueError, "needs a task, or a `detector` and its world"),
        ({"task": "T9"}, ValueError, "unknown task 'T9'"),
        (
            {"task": "T3", "scenario": "trolley"},
            ValueError,
            "`scenario` can't be given with task",
        ),
        ({**WORLD, "skenario": "trolley"}, TypeError, "did you mean 'scenario'"),
        ({**WORLD, "runs": 1}, ValueError, "`runs` must be a whole number of at least 2, got 1"),
        ({**WORLD, "fit_runs": 58}, ValueError, "`fit_runs` must be .* at least 59, got 58"),
    ],
)
def test_worlds_are_checked_before_anything_is_played(settings, error, message):
    with pytest.raises(error, match=message):
        Evaluator(**settings)


def test_what_the_victim_reports_is_seen_and_changes_no_bit_of_the_others(judge):
    before = judge.score({"name": "ramp", "rate_mps": 0.1})
    seen = []

    def follow(observation):
        seen.append(observation.copy())
        return np.full((len(observation), 1), 0.1)

    known = judge.score(follow, amplitude=None, knowledge="blind+reported")
    assert known.knowledge == "blind+reported"
    blind = judge.score(constant(), amplitude=None)
    assert np.array_equal(known.displacement_m, blind.displacement_m)  # it does not use them
    assert np.array_equal(known.counts, blind.counts)
    again = judge.score({"name": "ramp", "rate_mps": 0.1})
    assert np.array_equal(again.displacement_m, before.displacement_m)
    late = seen[-1][:, -3:-1]  # north and east, in parts of their scale, 30 s into the attack
    start = seen[0][:, -3:-1]
    assert np.ptp(late[:, 1]) > 0.0
    assert not np.array_equal(late, start)
    fitted = judge.fit(follow, knowledge="blind+reported")
    assert fitted.within_budget
