"""Decisions over several epochs, target directions, and displacement from a clean twin."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import spoofgym  # noqa: F401  (registers the ids)

ID = "spoofgym/TightlyCoupled-v0"
SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}


def make(**kwargs):
    return gym.make(ID, **{"timeline": SHORT, "knowledge": "oracle", **kwargs}).unwrapped


def test_a_decision_that_is_held_is_the_same_command_at_every_epoch():
    slow, quick = make(decision_interval_s=2.0), make()
    slow.reset(seed=5)
    quick.reset(seed=5)
    rng = np.random.default_rng(0)
    over = False
    while not over:
        action = rng.uniform(-1.0, 1.0, 2)
        seen, reward, over, _, info = slow.step(action)
        parts = [quick.step(action) for _ in range(4)]
        assert reward == pytest.approx(sum(part[1] for part in parts), abs=1e-9)
        np.testing.assert_array_equal(seen, parts[-1][0])
        assert over == parts[-1][2]
        assert info["cost"] == max(part[4]["cost"] for part in parts)
    assert slow.game.step_count[0] == 40


def test_between_decisions_the_command_moves_along_a_line():
    env = make(
        decision_interval_s=2.0,
        between="linear",
        detector="never",
        attack={"name": "false-position", "control": "rate"},
    )
    env.reset(seed=5)
    rates = []
    inner = env.game.engine.step

    def watched(action):
        verdict = inner(action)
        rates.append(env.game.engine.batch.attack.memory["rate"][0, 1])
        return verdict

    env.game.engine.step = watched
    for east in (0.4, -0.4):
        env.step(np.array([0.0, east]))
    np.testing.assert_allclose(rates, 5.0 * np.array([0.1, 0.2, 0.3, 0.4, 0.2, 0.0, -0.2, -0.4]))
    env.reset(seed=6)
    env.step(np.array([0.0, 1.0]))
    assert rates[8] == pytest.approx(1.25)  # from zero again


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"decision_interval_s": 0.7}, "must be a multiple of the interval between epochs, 0.5 s"),
        ({"decision_interval_s": 0.0}, "`decision_interval_s` must be finite and > 0"),
        ({"decision_interval_s": 3.0}, "attack window of 20 s must hold a whole number"),
        ({"between": "spline"}, "unknown between 'spline'; valid: hold, linear"),
        ({"target_heading_deg": "east"}, "unknown target_heading_deg 'east'; valid: random, worst"),
    ],
)
def test_a_wrong_decision_says_what_is_valid(settings, message):
    with pytest.raises(ValueError, match=message):
        make(**settings)


@pytest.mark.parametrize("detector", ["ewma", "never"])
def test_a_twin_is_the_run_without_attack_bit_for_bit(detector):
    env, clean = make(twin=True, detector=detector), make(detector=detector)
    env.reset(seed=11)
    clean.reset(seed=11)
    rng = np.random.default_rng(0)
    for _ in range(25):
        _, _, over, _, _ = env.step(rng.uniform(-1.0, 1.0, 2))
        clean.step(np.zeros(2))
        ours, theirs = env.game.engine.twin.buffers, clean.game.engine.batch.buffers
        np.testing.assert_array_equal(ours.floats, theirs.floats)
        if over:
            break


def test_with_a_twin_displacement_is_what_the_attack_has_induced_and_nothing_else():
    env = make(twin=True, detector="never", target_heading_deg="worst")
    env.reset(seed=2)
    for _ in range(10):
        _, reward, _, _, info = env.step(np.zeros(2))
        assert reward == info["displacement_m"] == 0.0
    total = 0.0
    for _ in range(20):
        _, reward, _, _, info = env.step(np.array([1.0, 0.0]))
        total += reward
    batch, twin = env.game.engine.batch, env.game.engine.twin
    apart = batch.buffers.state.position_e - twin.buffers.state.position_e
    north, east, _ = apart[0] @ env.game.setup.world.C_en[batch.onset[0]]
    assert info["displacement_m"] == pytest.approx(np.hypot(north, east), rel=1e-9)
    assert total == pytest.approx(info["undetected_displacement_m"])
    assert total > 1.0


def test_the_next_episode_has_a_twin_of_its_own():
    envs = gym.make_vec(
        ID, num_envs=3, autoreset_mode="same_step", timeline=SHORT, detector="ewma", twin=True
    )
    envs.reset(seed=4)
    rng = np.random.default_rng(1)
    ends = 0
    for _ in range(85):
        _, _, over, _, _ = envs.step(rng.uniform(-1.0, 1.0, (3, 2)))
        ends += over.sum()
        for row in np.flatnonzero(over):
            engine = envs.unwrapped.game.engine
            ours, theirs = engine.batch.buffers.state, engine.twin.buffers.state
            np.testing.assert_array_equal(ours.position_e[row], theirs.position_e[row])
    assert ends > 5


def test_a_drawn_direction_is_observed_and_rewarded():
    env = make(target_heading_deg="random", twin=True, detector="never")
    pushed = []
    for seed in range(4):
        observation, _ = env.reset(seed=seed)
        names = env.observation_names
        toward = np.array(
            [observation[names.index(f"target_direction_{a}")] for a in ("north", "east")]
        )
        for _ in range(30):
            _, _, _, _, info = env.step(toward)
        along = info["displacement_m"]
        env.reset(seed=seed)
        for _ in range(30):
            _, _, _, _, info = env.step(np.array([-toward[1], toward[0]]))
        pushed.append(along)
        assert abs(info["displacement_m"]) < 0.2 * along
    assert min(pushed) > 1.0


def test_the_cost_is_the_first_alarm():
    env = make(end_at_alarm=False, detector={"name": "snapshot-chi2", "false_alarm": 0.2})
    env.reset(seed=0)
    costs = [env.step(np.ones(2))[4]["cost"] for _ in range(40)]
    assert sum(costs) == 1.0
