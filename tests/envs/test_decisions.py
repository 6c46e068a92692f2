"""Decisions over several epochs, target directions, and displacement from a clean twin."""

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.envs.terms import TERMS

from .support import ID, LIVE, STEPS, VICTIMS, AlarmAt, victim

FULL = {"action": "full-command"}
SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}


def make(**kwargs):
    given = {"timeline": SHORT, "knowledge": "oracle", **FULL, **kwargs}
    return gym.make(ID, **given).unwrapped


@pytest.fixture(params=VICTIMS)
def kind(request):
    return request.param


def pushed(env, east):
    action = np.zeros(env.action_space.shape)
    action[..., 1] = east
    return action


@pytest.mark.parametrize("end_at_alarm", [True, False])
def test_a_decision_that_is_held_is_the_same_command_at_every_epoch(kind, end_at_alarm):
    settings = {"detector": AlarmAt(LIVE + 14), "reward": [*TERMS["reward"]]}
    settings["end_at_alarm"] = end_at_alarm
    interval_s = round(3.0 * VICTIMS[kind], 6)
    slow, quick = victim(kind, decision_interval_s=interval_s, **settings), victim(kind, **settings)
    assert slow.unwrapped.core.episode_steps == STEPS // 3
    slow.reset(seed=5)
    quick.reset(seed=5)
    rng, over, costs = np.random.default_rng(0), False, []
    while not over:
        action = rng.uniform(-0.3, 0.3, slow.action_space.shape)
        seen, reward, over, _, info = slow.step(action)
        parts = [quick.step(action)]
        while len(parts) < 3 and not parts[-1][2]:
            parts.append(quick.step(action))
        assert reward == pytest.approx(sum(part[1] for part in parts), abs=1e-9)
        assert reward == sum(value for name, value in info.items() if "reward_" in name)
        np.testing.assert_array_equal(seen, parts[-1][0])
        assert over == parts[-1][2]
        costs.append(info["cost"])
        assert info["cost"] == max(part[4]["cost"] for part in parts)
    assert costs == [0.0] * 4 + [1.0] + [0.0] * (0 if end_at_alarm else 5)
    steps = [env.unwrapped.core.score.step_count[0] for env in (slow, quick)]
    assert steps[0] == steps[1]


def test_a_limit_of_steps_counts_decisions():
    env = make(decision_interval_s=5.0, end={"name": "at-steps", "steps": 3}, detector="never")
    env.reset(seed=3)
    assert [env.step(np.ones(2))[3] for _ in range(3)] == [False, False, True]
    assert env.core.score.step_count[0] == 30


def test_between_decisions_a_rate_moves_along_a_line(kind):
    attack = {"attack": {"name": "false-position", "control": "rate"}}
    settings = {"decision_interval_s": round(3.0 * VICTIMS[kind], 6), "between": "linear"}
    settings |= attack if kind == "Zhong2025" else {}
    env = victim(kind, detector="never", **settings).unwrapped
    env.reset(seed=5)
    simulator, moved = env.core.engine.simulator, []
    limit = np.broadcast_to(env.core.setup.attack.rate_limit_mps, len(env.action_names))[1]
    for east in (0.4, -0.4):
        env.step(pushed(env, east))
        moved.append(simulator.commanded_displacement[0, 1])
        assert simulator.commanded_rate[0, 1] == pytest.approx(limit * east)
    # by thirds: 0.4 (1 + 2 + 3) / 3, then 0.4 - 0.8 / 3, 0.4 - 1.6 / 3 and -0.4
    np.testing.assert_allclose(moved, limit * VICTIMS[kind] * np.array([0.8, 0.4]))
    env.reset(seed=6)
    env.step(pushed(env, 1.0))  # from zero again
    moved = simulator.commanded_displacement[0, 1]
    assert moved == pytest.approx(2.0 * limit * VICTIMS[kind])


def test_with_a_twin_displacement_is_what_the_attack_has_induced_and_nothing_else(kind):
    env = victim(kind, twin=True, detector="never", target_heading_deg="worst").unwrapped
    env.reset(seed=2)
    total = 0.0
    for k in range(STEPS - 1):
        _, reward, _, _, info = env.step(pushed(env, 1.0 if k >= 5 else 0.0))
        assert k >= 5 or reward == info["displacement_m"] == 0.0
        total += reward
    simulator, twin = env.core.engine.simulator, env.core.engine.twin
    north, east = (simulator.error_n() - twin.error_n())[0, :2]
    assert info["displacement_m"] == pytest.approx(np.hypot(north, east), rel=1e-9)
    assert total == pytest.approx(info["undetected_displacement_m"])
    assert total > 1.0


COARSE = {
    "detector": "snapshot-chi2",
    "attack": {"name": "false-position", "acceleration_limit_mps2": 5.0, "rate_limit_mps": 50.0},
}
"""An attack that raises alarms within seconds."""
EARLY = {"end": {"name": "at-displacement", "limit_m": 0.3}, "detector": "never"}
"""Ends an episode within a decision."""


def last_step(env, seed, push=1.0):
    env.reset(seed=seed)
    while True:
        observation, _, terminated, truncated, info = env.step(np.array([0.0, push]))
        if terminated or truncated:
            return observation, info


def test_those_that_end_with_the_flight_wait_there_for_the_others():
    """Receivers whose episodes began at different times, all of them as late as they can."""
    late = make(detector="never").core.setup
    start_s = 0.5 * late._starts(late.epochs_each, "")[1]
    settings = {"domain": {"start_s": [start_s, start_s]}, "timeline": SHORT, **EARLY, **FULL}
    settings |= {"decision_interval_s": 5.0, "twin": True, "knowledge": "blind"}
    envs = gym.make_vec(ID, num_envs=3, autoreset_mode="same_step", **settings)
    core = envs.unwrapped.core
    simulator, epoch, reached = core.engine.simulator, core._epoch, []

    def watched(*given):
        epoch(*given)
        reached.append(int((simulator.epochs - simulator.memory["first"]).max()))

    core._epoch = watched
    envs.reset(seed=7)
    since, lengths = np.zeros(3, dtype=int), set()
    for _ in range(30):
        seen, _, terminated, truncated, _ = envs.step(np.outer([1.0, 0.001, 0.3], [0.0, 1.0]))
        assert np.isfinite(seen).all()
        since += 1
        over = terminated | truncated
        lengths |= {(int(row), int(since[row])) for row in np.flatnonzero(over)}
        since[over] = 0
    # every episode of a receiver has the same start and push, and so the same length
    assert lengths == {(0, 1), (1, 4), (2, 2)}
    assert max(reached) <= late.length  # the world has no epoch after that
    envs.close()


@pytest.mark.parametrize("settings", [{**EARLY, "twin": True}, EARLY, COARSE], ids=str)
def test_an_episode_that_ends_within_a_decision_is_told_as_it_stood_at_its_end(settings):
    """Also in a batch, where it waits for the others."""
    given = {"timeline": SHORT, "knowledge": "oracle", "decision_interval_s": 5.0, **FULL}
    given |= {"watch": "snapshot-chi2", **settings}
    envs = gym.make_vec(ID, num_envs=3, autoreset_mode="same_step", **given).unwrapped
    slow, quick = gym.make(ID, **given).unwrapped, make(watch="snapshot-chi2", **settings)
    envs.reset(seed=7)
    pushes, told = np.array([0.6, 1.0, 0.3]), set()
    while len(told) < 3:
        _, _, terminated, truncated, info = envs.step(np.outer(pushes, [0.0, 1.0]))
        over = {*np.flatnonzero(terminated | truncated).tolist()}
        for row in over - told:
            last = {name: values[row] for name, values in info["final_info"].items()}
            exact, expected = last_step(quick, 7 + row, pushes[row])
            alone = last_step(slow, 7 + row, pushes[row])
            for seen, found in ((info["final_obs"][row], last), alone):
                np.testing.assert_array_equal(seen, exact)
                for name in (name for name in expected if not name.startswith("reward")):
                    assert found[name] == expected[name], name
            assert slow.core.score.step_count == quick.core.score.step_count
            for env in (slow, quick) if "twin" in settings else ():  # through the time to alert
                assert env.core.engine.twin.epochs[0] == env.core.engine.simulator.epochs[0]
        told |= over
        for row in over if "twin" in settings else ():
            engine = envs.core.engine  # the next episode has a twin of its own
            ours, theirs = engine.simulator.buffers, engine.twin.buffers
            np.testing.assert_array_equal(ours.position_e[row], theirs.position_e[row])
    envs.close()
