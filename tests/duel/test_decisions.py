"""Spoofers that decide every n-th epoch, against detectors that decide on every one."""

import pickle
from copy import deepcopy

import numpy as np
import pytest

from spoofgym import duel_v0

from ..envs.players import assert_same
from .support import ALARM, FORMS, PAPERS, QUIET, SHORT, wary

(aec, aec_epochs), (parallel, parallel_epochs) = FORMS
STRONG = {"name": "false-position", "acceleration_limit_mps2": 1.0}
EVERY = 3
SLOW = {
    **PAPERS,
    "decision_interval_s": 1.5,
    "attack": STRONG,
    "attack_probability": 1.0,
    "threshold": 1.0,
}
QUICK = {**SLOW, "decision_interval_s": None}
EPOCHS, HOLD = 30, 4
DECISIONS = np.random.default_rng(7).uniform(-1.0, 1.0, ((EPOCHS + HOLD) // EVERY + 1, 2))


def trusting(k, _=None):
    """Weights of epoch k, so that it matters which epoch a decision is applied to."""
    return np.r_[-1.0, np.random.default_rng(k).uniform(0.0, 1.0, 12)]


@pytest.mark.parametrize("between", ["hold", "linear"])
def test_in_the_aec_form_the_detector_has_the_turns_between(between):
    before, given = np.zeros(2), []  # the command of every epoch
    for decision in DECISIONS:
        for part in (1 / 3, 2 / 3, 1.0):
            given.append(decision if between == "hold" else before + part * (decision - before))
        before = decision
    turns, own, paid, last = aec_epochs(
        aec(**SLOW, between=between), 4, lambda epoch: DECISIONS[epoch // EVERY], trusting
    )
    _, expected, each, same = aec_epochs(aec(**QUICK), 4, lambda epoch: given[epoch], trusting)
    assert turns == (["spoofer_0", *["detector_0"] * EVERY] * (len(DECISIONS)))[: len(turns)]
    assert turns.count("detector_0") == EPOCHS + HOLD
    if between == "hold":
        np.testing.assert_array_equal(own, expected)
    np.testing.assert_allclose(own, expected, rtol=0, atol=1e-9)
    cuts = np.arange(0, len(each), EVERY)
    np.testing.assert_allclose(paid, np.add.reduceat(each, cuts), rtol=0, atol=1e-9)
    assert last["undetected_displacement_m"] == pytest.approx(same["undetected_displacement_m"])
    assert paid.sum() == pytest.approx(last["undetected_displacement_m"])
    assert last["undetected_displacement_m"] > 1.0


def test_an_alarm_between_two_decisions_ends_the_episode():
    duel = aec(**{**SLOW, "threshold": 0.5})
    duel.reset(seed=2)
    duel.step(np.ones(2))
    duel.step(QUIET)
    assert duel.agent_selection == "detector_0"
    duel.step(ALARM)
    assert all(duel.terminations.values())
    for _ in duel.agent_iter():
        assert duel.last()[2]
        duel.step(None)
    assert not duel.agents


def test_in_the_parallel_form_actions_between_are_not_looked_at():
    noise = np.random.default_rng(1)

    def push(epoch):
        return noise.uniform(-1.0, 1.0, 2) if epoch % EVERY else DECISIONS[epoch // EVERY]

    due, own, *_ = parallel_epochs(parallel(**SLOW), 4, push, trusting)
    never, expected, *_ = parallel_epochs(
        parallel(**QUICK), 4, lambda k: DECISIONS[k // EVERY], trusting
    )
    np.testing.assert_array_equal(own, expected)
    assert due == [k % EVERY == 0 for k in range(EPOCHS + HOLD)]
    assert set(never) == {None}


@pytest.mark.parametrize(
    ("delay", "pace", "live_s"),
    [
        (0, {"decision_interval_s": 1.5, "between": "linear"}, 10.0),
        (1, {"decision_interval_s": 1.5, "between": "hold"}, 10.0),
        (0, {}, 10.0),
        (1, {}, 10.0),
        (1, {}, 0.0),
    ],
)
def test_the_spoofers_view_of_a_policy_is_the_duel_with_a_step_a_decision(delay, pace, live_s):
    every = EVERY if pace else 1
    timeline = {**SHORT, "live_s": live_s}
    world = {**PAPERS, "timeline": timeline, "action": "full-command", "attack": STRONG, **pace}
    policy = duel_v0.FunctionPolicy(wary)
    opponent = duel_v0.PolicyDetector(policy=policy, threshold=0.2, decision_delay=delay)
    view = duel_v0.SpooferView(opponent, **world)
    make, run = FORMS[delay]
    duel, detected = make(**world, threshold=0.2, attack_probability=1.0), set()
    decisions = np.abs(np.tile(DECISIONS, (EVERY, 1)))
    for size in (0.002, 0.8):
        view.reset(seed=3)
        over, expected, total = False, [], 0.0
        while not over:
            _, reward, over, _, info = view.step(size * decisions[len(expected)])
            total += reward
            expected.append(info["displacement_m"])
        detected.add(info["detected"])
        _, own, _, last = run(
            duel,
            3,
            lambda k, s=size: s * decisions[k // every],
            lambda k, seen: wary(seen[None])[0],
        )
        ends = own[every - 1 :: every][: len(expected)]
        np.testing.assert_array_equal(ends, expected[: len(ends)])
        assert last["undetected_displacement_m"] == info["undetected_displacement_m"]
        assert total == pytest.approx(last["undetected_displacement_m"])
    assert detected == {False, True} or not live_s


@pytest.mark.parametrize("delay", [0, 1])
def test_a_scripted_spoofer_of_the_detectors_view_knows_how_seldom_it_decides(delay):
    view = duel_v0.DetectorView(
        {"name": "ramp", "rate_mps": 0.9}, decision_delay=delay, timeline=SHORT, **SLOW
    )
    view.reset(seed=5)
    steps, over = 0, False
    while not over:
        _, _, over, _, _ = view.step(QUIET)
        steps += 1
    memory = view.core.duel.core.engine.simulator.attack.memory
    # 0.9 m/s at 0.6 m/s^2, held for the 1.5 s of the first decision
    np.testing.assert_allclose(memory["rate"][0], [0.0, 0.9], atol=1e-12)
    assert steps == EPOCHS + HOLD


def test_after_the_last_command_the_rate_is_held():
    attack = {"name": "false-position", "control": "rate"}
    env = parallel(attack=attack, attack_probability=1.0, threshold=1.0)
    env.reset(seed=2)
    memory, rates = env.duel.core.engine.simulator.commands, []
    while env.agents:
        push = np.array([0.3, 0.5]) * (len(rates) < EPOCHS)
        env.step({"spoofer_0": push, "detector_0": QUIET})
        rates.append(memory["rate"][0].copy())
    assert rates[-1].all()
    np.testing.assert_array_equal(rates, np.tile(rates[0], (EPOCHS + HOLD, 1)))


def test_an_exclusion_that_is_refused_uses_up_nothing():
    agent = parallel(exclusion_s=0.9).duel.agent
    visible, interval = np.ones((1, 12), dtype=bool), np.array([0.5])
    for wanted, given, used in ((0.0, 0.0, 0.5), (0.0, 1.0, 0.5), (0.5, 0.5, 0.75)):
        action = np.r_[-1.0, np.full(12, 2.0 * wanted - 1.0)][None]
        weights = agent.verdict(action, np.ones(1), visible, interval).weights
        np.testing.assert_array_equal(weights, np.full((1, 24), given))
        assert agent.memory["excluded_s"][0] == used


def told(duel, count):
    actions, found = {"spoofer_0": np.ones(2), "detector_0": QUIET}, []
    for _ in range(count):
        if hasattr(duel, "agent_selection"):
            duel.step(actions[duel.agent_selection])
            seen = [*map(duel.observe, duel.possible_agents)]
            found.append(deepcopy([seen, duel.rewards, duel.infos]))
        else:
            found.append(duel.step(actions))
    return found


@pytest.mark.parametrize("make", [aec, parallel])
@pytest.mark.parametrize(
    "settings",
    [
        {**SLOW, "between": "linear"},
        {
            "domain": {"start_s": (0.0, 30.0), "turned_deg": (0.0, 360.0), "worlds": 2},
            "target_heading_deg": "random",
        },
        {"attack": "tracking-1m"},
    ],
)
def test_a_duel_is_told_by_its_seed_and_goes_on_from_a_pickle(make, settings):
    duel = make(**settings).unwrapped
    duel.reset(seed=6)
    first, copy = told(duel, 6), pickle.loads(pickle.dumps(duel))
    assert_same(told(duel, 12), told(copy, 12))
    duel.reset(seed=6)
    assert_same(first, told(duel, 6))


def test_a_calibration_holds_however_often_a_spoofer_decides():
    """A clean episode has no attack, however seldom it is commanded."""
    settings = {**PAPERS, "false_alarm": 0.5, "runs": 2, "timeline": SHORT}
    policy = duel_v0.FunctionPolicy(wary, "wary")
    quick = duel_v0.calibrate_policy(policy, **settings)
    assert duel_v0.calibrate_policy(policy, **settings, decision_interval_s=1.5) == quick
