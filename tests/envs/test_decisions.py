"""Decisions over several epochs, target directions, and displacement from a clean twin."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import spoofgym  # noqa: F401  (registers the ids)

ID = "spoofgym/TightlyCoupled-v0"
FULL = {"action": "full-command"}
SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}


def make(**kwargs):
    given = {"timeline": SHORT, "knowledge": "oracle", **FULL, **kwargs}
    return gym.make(ID, **given).unwrapped


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
    assert slow.core.score.step_count[0] == 40


def test_between_decisions_the_command_moves_along_a_line():
    env = make(
        decision_interval_s=2.0,
        between="linear",
        detector="never",
        attack={"name": "false-position", "control": "rate"},
    )
    env.reset(seed=5)
    rates = []
    inner = env.core.engine.step

    def watched(action, sequel):
        verdict = inner(action, sequel)
        rates.append(env.core.engine.simulator.attack.memory["rate"][0, 1])
        return verdict

    env.core.engine.step = watched
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
        ours, theirs = env.core.engine.twin.buffers, clean.core.engine.simulator.buffers
        np.testing.assert_array_equal(ours.fields.data, theirs.fields.data)
        np.testing.assert_array_equal(ours.seen_floats, theirs.seen_floats)
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
    batch, twin = env.core.engine.simulator, env.core.engine.twin
    apart = batch.buffers.position_e - twin.buffers.position_e
    north, east, _ = apart[0] @ env.core.setup.world.C_en[batch.epochs[0]]
    assert info["displacement_m"] == pytest.approx(np.hypot(north, east), rel=1e-9)
    assert total == pytest.approx(info["undetected_displacement_m"])
    assert total > 1.0


def test_the_next_episode_has_a_twin_of_its_own():
    envs = gym.make_vec(
        ID,
        num_envs=3,
        autoreset_mode="same_step",
        timeline=SHORT,
        detector="ewma",
        twin=True,
        **FULL,
    )
    envs.reset(seed=4)
    rng = np.random.default_rng(1)
    ends = 0
    for _ in range(85):
        _, _, over, _, _ = envs.step(rng.uniform(-1.0, 1.0, (3, 2)))
        ends += over.sum()
        for row in np.flatnonzero(over):
            engine = envs.unwrapped.core.engine
            ours, theirs = engine.simulator.buffers, engine.twin.buffers
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


@pytest.mark.parametrize("twin", [False, True])
def test_an_episode_that_ends_within_a_decision_is_told_as_it_stood_at_its_end(twin):
    slow, quick = make(decision_interval_s=5.0, twin=twin, **EARLY), make(twin=twin, **EARLY)
    for seed in range(3):
        seen, info = last_step(slow, seed)
        exact, expected = last_step(quick, seed)
        for env in (slow, quick) if twin else ():  # both have run the time to alert
            assert env.core.engine.twin.epochs[0] == env.core.engine.simulator.epochs[0]
        count = slow.core.score.step_count[0]
        assert count == quick.core.score.step_count[0]
        assert count % 10
        np.testing.assert_array_equal(seen, exact)
        for name in (name for name in expected if not name.startswith("reward")):
            assert info[name] == expected[name], name


def test_an_alarm_within_a_decision_is_told_at_its_own_time():
    slow, quick = make(decision_interval_s=5.0, **COARSE), make(**COARSE)
    for seed in range(3):
        seen, info = last_step(slow, seed)
        exact, expected = last_step(quick, seed)
        assert expected["detected"]
        assert info["time_s"] == expected["time_s"]
        np.testing.assert_array_equal(seen, exact)


def test_the_first_alarm_costs_at_whichever_epoch_of_a_decision_it_comes():
    settings = {"end_at_alarm": False, **COARSE}
    slow, quick = make(decision_interval_s=5.0, **settings), make(**settings)
    slow.reset(seed=3)
    quick.reset(seed=3)
    costs = np.array([quick.step(np.ones(2))[4]["cost"] for _ in range(40)])
    assert costs.argmax() % 10 != 9  # not at the last epoch of a decision
    assert costs.sum() == 1.0
    found = [slow.step(np.ones(2))[4]["cost"] for _ in range(4)]
    np.testing.assert_array_equal(found, costs.reshape(4, 10).max(axis=1))


def test_in_a_batch_those_that_end_wait_for_the_others():
    settings = {"decision_interval_s": 5.0, "watch": "snapshot-chi2", "twin": True, **EARLY, **FULL}
    envs = gym.make_vec(
        ID,
        num_envs=3,
        autoreset_mode="same_step",
        timeline=SHORT,
        knowledge="oracle",
        **settings,
    )
    envs.reset(seed=7)
    pushes = np.array([[0.0, 0.6], [0.0, 1.0], [0.0, 0.3]])
    alone = make(**settings)
    told = {}
    while len(told) < 3:
        _, _, terminated, truncated, info = envs.step(pushes)
        for row in np.flatnonzero(terminated | truncated):
            if row not in told:
                last = info["final_info"]
                told[int(row)] = info["final_obs"][row], {k: last[k][row] for k in last}
    for row, (seen, final) in told.items():
        exact, expected = last_step(alone, 7 + row, pushes[row, 1])
        np.testing.assert_array_equal(seen, exact)
        for name, value in expected.items():
            assert final[name] == value, name
    envs.close()


@pytest.mark.parametrize("mode", ["next_step", "same_step"])
def test_those_that_end_with_the_flight_wait_there_for_the_others(mode):
    """Receivers whose episodes began at different times, all of them as late as they can."""
    late = make(detector="never").core.setup
    start_s = 0.5 * late._starts(late.epochs_each, "")[1]
    settings = {"domain": {"start_s": [start_s, start_s]}, "timeline": SHORT, **EARLY}
    settings = {**settings, **FULL, "decision_interval_s": 5.0, "twin": True, "knowledge": "blind"}
    envs = gym.make_vec(ID, num_envs=3, autoreset_mode=mode, **settings)
    core = envs.unwrapped.core
    simulator, epoch, reached = core.engine.simulator, core._epoch, []

    def watched(*given):
        epoch(*given)
        reached.append(int((simulator.epochs - simulator.memory["first"]).max()))

    core._epoch = watched
    envs.reset(seed=7)
    pushes = np.array([[0.0, 1.0], [0.0, 0.001], [0.0, 0.3]])
    lengths: dict[int, list[int]] = {0: [], 1: [], 2: []}
    since = np.zeros(3, dtype=int)
    for _ in range(30):
        seen, _, terminated, truncated, _ = envs.step(pushes)
        assert np.isfinite(seen).all()
        over = terminated | truncated
        since += 1
        for row in np.flatnonzero(over):
            lengths[int(row)].append(int(since[row]))
        since[over] = 0 if mode == "same_step" else -1
    # every episode of a receiver has the same start and push, and so the same length
    assert [set(found) for found in lengths.values()] == [{1}, {4}, {2}]
    assert max(reached) <= late.length  # the world has no epoch after that
    envs.close()


@pytest.mark.parametrize(
    "reward",
    [
        ["alarmed-epochs"],
        ["displacement-gain", "retraction", "alarmed-epochs"],
        ["effort-penalty", "alarmed-epochs"],
        ["terminal-displacement", "effort-penalty"],
    ],
)
@pytest.mark.parametrize("end_at_alarm", [False, True])
def test_the_reward_of_a_decision_is_the_sum_of_those_of_its_epochs(reward, end_at_alarm):
    settings = {
        "reward": [{"name": name} for name in reward],
        "end_at_alarm": end_at_alarm,
        **COARSE,
    }
    slow, quick = make(decision_interval_s=5.0, **settings), make(**settings)
    totals = []
    for env in (slow, quick):
        env.reset(seed=3)
        total, over = 0.0, False
        while not over:
            _, gained, terminated, truncated, info = env.step(np.array([0.5, 1.0]))
            assert gained == sum(value for name, value in info.items() if "reward_" in name)
            over = terminated or truncated
            total += gained
        totals.append(total)
    assert totals[0] == pytest.approx(totals[1], abs=1e-9)
    assert totals[1] != 0.0


def test_a_number_of_commands_is_one_of_decisions():
    end = {"name": "at-steps", "steps": 3}
    env = make(decision_interval_s=5.0, end=end, detector="never")
    env.reset(seed=0)
    ends = [env.step(np.zeros(2))[3] for _ in range(3)]
    assert ends == [False, False, True]
    assert env.core.score.step_count[0] == 30
