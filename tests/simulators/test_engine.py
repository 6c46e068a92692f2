"""What must be the same to the last bit, on one machine."""

import numpy as np
import pytest

from spoofgym.detectors import Ewma, Never
from spoofgym.receiver import TightlyCoupled, replay
from spoofgym.simulators import Engine, TightlyCoupledSetup
from spoofgym.simulators.recording import record_run

from ..envs.support import SHORT, single, vector


def rollout(env, seed, steps, row=None, rng_seed=0):
    """Observations, rewards and ends of one receiver, under actions of the step alone."""
    actions = np.random.default_rng(rng_seed).uniform(-1, 1, (steps, 64, 2))
    observation, _ = env.reset(seed=seed)
    out = [observation if row is None else observation[row]]
    rewards, ends = [], []
    for k in range(steps):
        if row is None:
            observation, reward, terminated, _, _ = env.step(actions[k, 37])
        else:
            observation, reward, terminated, _, _ = env.step(actions[k, : env.num_envs])
            observation, reward, terminated = observation[row], reward[row], terminated[row]
        out.append(observation)
        rewards.append(reward)
        ends.append(bool(terminated))
        if row is None and terminated:
            observation, _ = env.reset()
            out[-1] = observation
    return np.array(out), np.array(rewards), ends


@pytest.mark.parametrize("live_s", [10.0, 0.0])
@pytest.mark.parametrize("knowledge", ["tracking", "oracle"])
@pytest.mark.parametrize("end_at_alarm", [True, False])
def test_row_37_of_64_is_the_single_env_over_an_autoreset(knowledge, end_at_alarm, live_s):
    kwargs = {
        "timeline": {**SHORT, "live_s": live_s},
        "knowledge": knowledge,
        "end_at_alarm": end_at_alarm,
        "detector": {"name": "ewma", "false_alarm": 0.05},  # so that some episodes end early
    }
    simulator = vector(64, autoreset_mode="same_step", threads=2, **kwargs)
    many = rollout(simulator, seed=100, steps=75, row=37)
    one = rollout(single(**kwargs).unwrapped, seed=137, steps=75)
    assert sum(one[2]) >= 2, "the test must go over an autoreset"
    assert one[2] == many[2]
    np.testing.assert_array_equal(one[0], many[0])
    np.testing.assert_array_equal(one[1], many[1])


@pytest.mark.parametrize(
    ("receivers", "threads"),
    [(1, 1), (3, 1), (4, 1), (5, 1), (7, 1), (12, 2), (40, 1), (40, 2), (40, 3)],
)
def test_a_receiver_is_the_same_in_any_batch_and_with_any_threads(receivers, threads):
    setup = TightlyCoupledSetup(timeline=SHORT)
    setup.fields = setup.has

    def final(count, number):
        engine = Engine(count, setup, threads=number)
        engine.reset([np.random.default_rng(i) for i in range(count)])
        for k in range(20):
            engine.step(np.full((count, 2), 0.1 * (k % 3)))
        return engine.simulator.buffers

    few, many = final(receivers, threads), final(64, 1)
    for name in ("position_e", "velocity_e", "C_eb", "covariance", "clock"):
        mine, theirs = getattr(few.state, name), getattr(many.state, name)
        np.testing.assert_array_equal(mine, theirs[:receivers], err_msg=name)
    assert many.measured.innovation_cov.any()
    for name in ("innovation_variance", "innovation_cov"):
        mine, theirs = getattr(few.measured, name), getattr(many.measured, name)
        np.testing.assert_array_equal(mine, theirs[:receivers], err_msg=name)


def test_zero_command_is_the_clean_run():
    setup = TightlyCoupledSetup(timeline=SHORT)

    def run(action, attacked):
        engine = Engine(3, setup, threads=1)
        engine.reset([np.random.default_rng(i) for i in range(3)])
        for _ in range(20):
            if attacked:
                engine.step(action)
            else:
                engine.simulator.advance()
                engine.update(engine.judge())
        return engine.simulator.buffers.floats.copy()

    np.testing.assert_array_equal(run(np.zeros((3, 2)), True), run(None, False))


def test_an_attack_meets_the_same_noise():
    """Measured samples and white noise of ranges do not depend on what the attack does."""
    setup = TightlyCoupledSetup(timeline=SHORT, detector=Never())

    def run(size):
        engine = Engine(2, setup, threads=1)
        engine.reset([np.random.default_rng(i) for i in range(2)])
        samples, ranges = [], []
        for _ in range(20):
            engine.predict(np.full((2, 2), size))
            simulator = engine.simulator
            samples.append(simulator.buffers.samples.copy())
            offset = simulator.sensors.state.range_offset
            ranges.append(simulator.buffers.measured.pseudorange - offset * simulator.epoch.visible)
            engine.update(engine.judge())
        return np.array(samples), np.array(ranges), np.abs(offset).max()

    clean, attacked = run(0.0), run(0.7)
    assert attacked[2] > 1.0
    np.testing.assert_array_equal(clean[0], attacked[0])
    # the offset is added after the noise: only the rounding of that sum may differ
    np.testing.assert_allclose(clean[1], attacked[1], rtol=0, atol=1e-8)


def test_the_quiet_stretch_is_the_stepwise_run():
    """One compiled call for many epochs gives the bits of three calls an epoch."""
    setup = TightlyCoupledSetup(timeline=SHORT)
    fused = Engine(5, setup, threads=1).simulator
    stepwise = Engine(5, setup, threads=1).simulator
    for simulator in (fused, stepwise):
        simulator.begin([np.random.default_rng(i) for i in range(5)])
    fused.quiet_epochs(30)
    for _ in range(30):
        stepwise.advance()
        stepwise.update(None)
    for mine, theirs in zip(fused.buffers.state, stepwise.buffers.state, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_array_equal(
        fused.buffers.measured.innovation, stepwise.buffers.measured.innovation
    )


@pytest.mark.parametrize("attacked", [False, True])
@pytest.mark.parametrize("grade", ["aviation", "consumer"])
def test_an_exported_episode_replays_to_the_same_bits(attacked, grade):
    setup = TightlyCoupledSetup(timeline=SHORT, scenario={"imu": grade}, detector=Never())
    action = np.array([[0.2, -0.9]])
    initial, recording, position_e = record_run(
        setup, np.random.default_rng(3), command=(lambda k: action) if attacked else None
    )
    solution = replay(recording, TightlyCoupled(grade=grade), initial=initial)
    np.testing.assert_array_equal(solution.position_e, position_e)
    engine = Engine(1, setup, threads=1)
    engine.reset([np.random.default_rng(3)])
    for _ in range(setup.steps):
        engine.step(action if attacked else np.zeros((1, 2)))
    np.testing.assert_array_equal(
        solution.position_e[-1], engine.simulator.buffers.state.position_e[0]
    )
    np.testing.assert_array_equal(
        solution.sd[-1], np.sqrt(np.diagonal(engine.simulator.buffers.state.covariance[0]))
    )


def test_episodes_of_one_seed_differ_and_repeat():
    env = single().unwrapped
    first, _ = env.reset(seed=4)
    second, _ = env.reset()
    state = env.core.engine.simulator.buffers.state.position_e.copy()
    env.reset(seed=4)
    env.reset()
    np.testing.assert_array_equal(state, env.core.engine.simulator.buffers.state.position_e)
    env.reset(seed=4)
    assert not np.array_equal(state, env.core.engine.simulator.buffers.state.position_e)
    assert first.shape == second.shape


def test_when_the_last_alarm_came_does_not_matter_for_the_next_episode():
    """The second episode of a receiver is the same, whether the first ended early or late."""

    def second(detector):
        envs = vector(2, autoreset_mode="same_step", detector=detector)
        envs.reset(seed=9)
        done = np.zeros(2, dtype=bool)
        biases = [None, None]
        for _ in range(40):
            _, _, terminated, _, _ = envs.step(np.ones((2, 2)))
            for row in np.flatnonzero(terminated & ~done):
                sensors = envs.core.engine.simulator.sensors
                biases[row] = (
                    sensors.state.satellite_bias[row].copy(),
                    sensors.keys[:, row].copy(),
                )
            done |= terminated
        assert done.all()
        return biases

    for early, late in zip(second(Ewma(false_alarm=0.2)), second(Never()), strict=True):
        np.testing.assert_array_equal(early[0], late[0])
        np.testing.assert_array_equal(early[1], late[1])
