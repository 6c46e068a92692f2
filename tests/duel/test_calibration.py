"""Thresholds: quantiles of clean runs, and those that follow the false alarms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom

from spoofgym import duel_v0
from spoofgym.calibration.clean_runs import Player
from spoofgym.detectors.calibration_file import Calibration, list_stored_ranks
from spoofgym.detectors.learned import PolicyDetector
from spoofgym.duel.duel import make_duel
from spoofgym.duel.payoff import FixedThreshold, RunningThreshold
from spoofgym.policies.contract import PolicyContext
from spoofgym.simulation.setup import make_generators, seeds_of_runs

from .support import ALARM, BRIEF, parallel, wary

SETTINGS = {**BRIEF, "runs": 60, "false_alarm": 0.1, "receivers": 30}


def calibration(maxima):
    world = {"world": {}, "detector": {"name": "x"}, "entropy": 0, "seed_name": "x"}
    ranks = list_stored_ranks(len(maxima), 60.0)
    return Calibration.from_maxima(maxima, maxima, ranks=ranks, window_s=60.0, **world)


def threshold_of(found):
    return found.point(per_run=SETTINGS["false_alarm"]).scale


@pytest.mark.parametrize(("alpha", "n"), [(0.05, 200), (0.1, 59), (0.3, 40)])
def test_an_interval_of_order_statistics_covers_the_quantile_and_no_narrower_one_does(alpha, n):
    low, high = map(round, calibration(np.arange(1.0, n + 1)).interval(alpha, 0.9))
    above = binom(n, alpha).cdf  # of the runs above the quantile
    assert above(n - low - 1) < 0.95 <= above(n - low)
    assert above(n - high) < 0.05 <= above(n - high + 1)


def test_the_threshold_does_not_depend_on_the_batch_and_few_runs_tell_no_upper_end():
    first = duel_v0.calibrate_policy(wary, **SETTINGS)
    assert first == duel_v0.calibrate_policy(wary, **{**SETTINGS, "receivers": 17})
    low, high = first.interval(0.1)
    assert low < threshold_of(first) < high
    late = duel_v0.calibrate_policy(wary, **SETTINGS, decision_delay=1)
    assert late.world != first.world
    assert threshold_of(late) != threshold_of(first)
    assert calibration(np.arange(1.0, 20.0)).interval(0.05) == (pytest.approx(16.0), np.inf)


@pytest.mark.parametrize("delay", [0, 1])
def test_clean_runs_are_those_of_the_duel(delay):
    """A frozen policy as a detector says what it says as an agent, epoch by epoch."""
    settings = {**BRIEF, "action": "full-command"}
    duel = make_duel(6, decision_delay=delay, attack_probability=0.0, **settings)
    duel.threshold = FixedThreshold(np.inf, 6)
    policy = duel_v0.FunctionPolicy(wary)
    setup, agent = duel.setup, duel.agent
    policy.bind(PolicyContext(6, 0.5, agent.observer.names, (), (), agent.action_names))
    duel.reset(make_generators(seeds_of_runs(0, "calibration", setup.name, range(6))))
    largest, idle = np.zeros(6), np.zeros((6, 2))
    for _ in range(duel.epochs):
        if delay:
            action = policy.decide(duel.observe_detector())
            duel.arrive(idle)
        else:
            duel.arrive(idle)
            action = policy.decide(duel.observe_detector())
        largest = np.maximum(largest, duel.decide(action).info["statistic"])
    settings = {"policy": policy, "decision_delay": delay, "quiet_epochs": setup.live}
    judge = PolicyDetector(agent.statistic, agent.weighs, agent.exclusion_s, **settings)
    found = Player(setup, threads=1).play([judge], range(6), in_loop=True)
    np.testing.assert_array_equal(found.judged[:, 0], largest)


def test_alarming_at_once_does_not_pay():
    def always(observation):
        return np.tile(ALARM, (len(observation), 1))

    found = duel_v0.calibrate_policy(always, **SETTINGS)
    assert threshold_of(found) == 1.0  # the quantile of what it says: it can't exceed it
    env = parallel(threshold=found, attack_probability=1.0)
    env.reset(seed=2)
    total = 0.0
    while env.agents:
        _, rewards, *_, infos = env.step({"spoofer_0": np.array([0, 1.0]), "detector_0": ALARM})
        assert not infos["detector_0"]["alarm"]
        total += rewards["detector_0"]
    assert total <= 0.0
    assert env.duel.score.step_count[0] == env.duel.epochs


@pytest.mark.parametrize("habit", ["always", "never", "half", "turning"])
def test_a_running_threshold_bounds_the_false_alarms_of_any_detector(habit):
    alpha, n = 0.05, 3000
    rule, rng, false = RunningThreshold(alpha, 2), np.random.default_rng(0), np.zeros(2)
    for k in range(n):
        statistic = {
            "always": np.ones(2),
            "never": np.zeros(2),
            "half": rng.random(2),
            "turning": np.full(2, float(k % 400 < 200)),
        }[habit]
        alarm = statistic > rule.values
        false += alarm
        rule.learn(alarm, np.ones(2, dtype=bool))
    bound = alpha + (1.0 + rule.GAIN - rule.FIRST) / (rule.GAIN * n)
    assert (false / n <= bound).all()
    if habit in ("always", "half"):
        assert (false / n > alpha - 0.01).all()


def test_a_running_threshold_follows_the_clean_episodes_that_are_played():
    def played(attack_probability, seeds):
        env = parallel(attack_probability=attack_probability)
        for seed in seeds:
            env.reset(seed=seed)
            while env.agents:
                *_, infos = env.step({"spoofer_0": np.zeros(2), "detector_0": ALARM})
            yield infos["detector_0"]["threshold"]

    # what says 1 alarms in the second; a seed begins anew
    found = list(played(0.0, [7, None, None, None, 7]))
    np.testing.assert_allclose(found, [1.0, 0.995, 1.09, 1.085, 1.0])
    assert list(played(1.0, [7, None])) == [1.0, 1.0]  # nothing is learned from attacked ones


def test_an_agent_of_random_actions_plays_whole_episodes():
    env, lengths = parallel(), []
    for seed in [0, 1, 2, *[None] * 12]:
        env.reset(seed=seed)
        if seed == 0:
            for name in env.agents:
                env.action_space(name).seed(seed)
        lengths.append(0)
        while env.agents:
            env.step({name: env.action_space(name).sample() for name in env.agents})
            lengths[-1] += 1
    assert lengths[:3] == [env.duel.epochs] * 3
    assert np.mean(lengths) > 0.5 * env.duel.epochs


def test_calibrations_are_stored_by_the_frozen_detector(tmp_path):
    policy, other = (duel_v0.FunctionPolicy(wary, name=f"wary-{k}") for k in (1, 2))
    first = duel_v0.calibrate_policy(policy, **SETTINGS, store=tmp_path)
    (path,) = tmp_path.iterdir()
    assert duel_v0.Calibration.load(path) == first
    # what is there is taken as it is, if it is that of these runs
    later = replace(first, window_s=2.0 * first.window_s).save(path)
    assert duel_v0.calibrate_policy(policy, **SETTINGS, store=tmp_path) == later
    replace(first, entropy=7).save(path)
    with pytest.raises(ValueError, match=r"must have .* runs of seed 0, got .* of 7"):
        duel_v0.calibrate_policy(policy, **SETTINGS, store=tmp_path)
    replace(first, world={**first.world, "decision_delay": 99}).save(path)
    with pytest.raises(ValueError, match=r"something else than policy in .*: world decision_delay"):
        duel_v0.calibrate_policy(policy, **SETTINGS, store=tmp_path)
    first.save(path)
    for numbers in ({}, {"runs": np.int64(SETTINGS["runs"]), "seed": np.int64(0)}):
        again = duel_v0.calibrate_policy(other, **{**SETTINGS, **numbers}, store=tmp_path)
        assert again.largest == first.largest
        assert len(list(tmp_path.iterdir())) == 2
    with pytest.raises(ValueError, match="no digest to store"):
        duel_v0.calibrate_policy(wary, **SETTINGS, store=tmp_path)
    path.write_text("{}")
    with pytest.raises(ValueError, match="is no calibration"):
        duel_v0.calibrate_policy(policy, **SETTINGS, store=tmp_path)


@pytest.mark.parametrize(
    ("policy", "settings", "message"),
    [
        (lambda o: np.zeros((len(o), 2)), {}, r"actions of shape \(30, 2\), not \(30, 13\)"),
        (lambda o: np.full((len(o), 13), np.nan), {}, "NaN for receiver 0"),
        ("ewma", {}, "a detector policy is an instance of"),
        (wary, {"runs": 18, "false_alarm": 0.05}, "`runs` must be at least 19 for `false_alarm`"),
        (wary, {"false_alarm": "x"}, "`false_alarm` must be a number above 0 and below 1, got 'x'"),
        (wary, {"runs": 19.5}, "`runs` must be a whole number .*got 19.5"),
        (wary, {"receivers": 0}, "`receivers` must be a whole number of at least 1, got 0"),
    ],
)
def test_bad_policies_and_requests(policy, settings, message):
    with pytest.raises((ValueError, TypeError), match=message):
        duel_v0.calibrate_policy(policy, **{**SETTINGS, **settings})
