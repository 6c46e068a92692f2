"""What must be the same to the last bit, on one machine."""

import numpy as np
import pytest

from spoofgym.detectors import Ewma, Never
from spoofgym.receiver import TightlyCoupled, replay
from spoofgym.simulation import Engine, TightlyCoupledSetup
from spoofgym.simulation.recording import record_run
from spoofgym.simulation.simulator import Simulator
from spoofgym.simulation.tight import TightlyCoupledSimulator

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


@pytest.mark.parametrize(
    ("knowledge", "end_at_alarm", "live_s"),
    [("tracking", True, 10.0), ("oracle", False, 10.0), ("oracle", True, 0.0)],
)
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


def everything(simulator, rows=slice(None)):
    """All that there is of some receivers, by name."""
    buffers, sensors = simulator.buffers, simulator.sensors
    plain = ("time", "interval", "position_e", "velocity_e", "visible", "coasting")
    arrays = {
        **{name: buffers.fields[name] for name in buffers.fields.shapes},
        **{name: buffers.assumed[name] for name in buffers.assumed.shapes},
        **{f"sensor {name}": sensors.fields[name] for name in sensors.fields.shapes},
        **{f"sensor {name}": sensors.constants[name] for name in sensors.constants.shapes},
        **{f"signal {name}": sensors.signals[name] for name in sensors.signals.shapes},
        **{f"seen {name}": array for name, array in buffers.seen.items()},
        **{f"plain {name}": getattr(buffers, name) for name in plain},
        "epoch": sensors.epoch,
    }
    return {name: np.array(array)[rows] for name, array in arrays.items()}


def check_same(mine, theirs):
    assert list(mine) == list(theirs)
    for name in mine:
        assert mine[name].tobytes() == theirs[name].tobytes(), name


def played(setup, rows, threads=1):
    """Receivers by their numbers after 20 steps under attack; every third begins again at half."""
    rows, axes = np.asarray(rows), len(setup.action_names)
    engine = Engine(len(rows), setup, threads=threads)
    engine.reset([np.random.default_rng([9, number]) for number in rows])
    for k in range(20):
        if k == 10 and not (rows % 3).all():
            again = np.flatnonzero(rows % 3 == 0)
            engine.reset([np.random.default_rng([10, number]) for number in rows[again]], again)
        engine.step(np.full((len(rows), axes), 0.1 * (k % 3)))
    return {**everything(engine.simulator), "weights": engine.simulator.weights.copy()}


ALL_DRAWN = {
    "start_s": (0.0, 60.0),
    "worlds": 2,
    "turned_deg": (0.0, 360.0),
    "imu": ("aviation", "tactical", "consumer"),
    "errors": ("zhong2025", "trolley", "groves"),
}
SETTINGS = {
    "default": {},
    "trolley": {"scenario": {"errors": "trolley"}},
    "general": {
        "receiver": {
            "covariance_update": "general",
            "conventions": "orthonormal",
            "min_satellites": 9,
        },
        "attack": "per-channel",
        "domain": {**ALL_DRAWN, "constellation_time_s": (0.0, 86_400.0)},
    },
    "plain": {"receiver": {"covariance_update": "plain"}, "domain": ALL_DRAWN},
    "airborne": {
        "scenario": {"name": "aviation-actual", "imu_rate_hz": 20},
        "attack": {"name": "false-position", "errors": "quiet"},
        "domain": {
            "start_s": (0.0, 60.0),
            "events": {"clock_step": 0.5, "satellite_loss": 0.5, "front": 0.5},
        },
    },
}


@pytest.fixture(scope="module", params=SETTINGS)
def many(request):
    """A setting, and 129 receivers of it."""
    setup = TightlyCoupledSetup(timeline=SHORT, detector="ewma", **SETTINGS[request.param])
    setup.fields = setup.has
    whole = played(setup, range(129))
    assert (whole["weights"] < 0.99).any()
    assert len(set(whole["epoch"])) > (20 if "domain" in SETTINGS[request.param] else 1)
    if request.param == "general":
        assert 10 < whole["plain coasting"].sum() < 119
    return setup, whole


@pytest.mark.parametrize(
    ("receivers", "threads"),
    [(1, 1), (7, 1), (8, 1), (9, 1), (17, 1), (17, 2), (70, 2), (129, 2), (129, 3)],
)
def test_a_receiver_is_the_same_in_any_batch_and_with_any_threads(many, receivers, threads):
    setup, whole = many
    mine = played(setup, range(receivers), threads)
    assert mine["seen innovation_cov"].any()
    check_same(mine, {name: array[:receivers] for name, array in whole.items()})


def test_every_one_of_a_batch_is_the_single_receiver(many):
    setup, whole = many
    for number in (1, 7, 8, 40, 127, 128):
        check_same(
            played(setup, [number]),
            {name: array[number : number + 1] for name, array in whole.items()},
        )


def test_zero_command_is_the_clean_run():
    receivers = 3
    setup = TightlyCoupledSetup(timeline=SHORT)
    setup.fields = setup.has

    def run(action, attacked):
        engine = Engine(receivers, setup, threads=1)
        engine.reset([np.random.default_rng(i) for i in range(receivers)])
        for _ in range(20):
            if attacked:
                engine.step(action)
            else:
                engine.simulator.advance()
                engine.update(engine.judge())
        return everything(engine.simulator)

    check_same(run(np.zeros((receivers, 2)), True), run(None, False))


def test_an_attack_meets_the_same_noise():
    """Measured samples and white noise of ranges do not depend on what the attack does."""
    setup = TightlyCoupledSetup(timeline=SHORT, detector=Never())
    setup.fields = frozenset({"pseudorange"})

    def run(size):
        engine = Engine(2, setup, threads=1)
        engine.reset([np.random.default_rng(i) for i in range(2)])
        residuals, deltas, ranges = [], [], []
        for _ in range(20):
            engine.predict(np.full((2, 2), size))
            simulator = engine.simulator
            residual = simulator.sensors.fields["residual"]
            correction = np.repeat(simulator.epoch.interval[:, None], 6, axis=1) * np.hstack(
                [simulator.buffers.fields[name] for name in ("accel_bias_b", "gyro_bias_b")]
            )
            deltas.append(simulator.buffers.fields["imu_delta"] + correction)
            residuals.append(residual.copy())
            offset = simulator.sensors.range_offset
            ranges.append(simulator.epoch.pseudorange - offset * simulator.epoch.visible)
            engine.update(engine.judge())
        return np.array(residuals), np.array(deltas), np.array(ranges), np.abs(offset).max()

    clean, attacked = run(0.0), run(0.7)
    assert attacked[3] > 1.0
    np.testing.assert_array_equal(clean[0], attacked[0])
    # increments less the biases that are estimated otherwise under attack
    np.testing.assert_allclose(clean[1], attacked[1], rtol=0, atol=1e-13)
    # the offset is added after the noise: only the rounding of that sum may differ
    np.testing.assert_allclose(clean[2], attacked[2], rtol=0, atol=1e-8)


STEPS = {
    "displacement": {"attack": "false-position"},
    "rate": {"attack": {"name": "false-position", "control": "rate"}},
    "code alone": {"attack": "pseudorange-only"},
    "channels": {"attack": {"name": "per-channel", "channels": "S1*"}},
    "channels at a rate": {"attack": {"name": "per-channel", "control": "rate"}},
    "equipment": {"attack": "tracking-1m"},
    "chart without weights": {"detector": {"name": "ewma", "weight_scale": None}},
    "another detector": {"detector": "cusum"},
    "general": SETTINGS["general"],
}


@pytest.mark.parametrize(("name", "receivers"), [("displacement", 1), *((n, 11) for n in STEPS)])
def test_a_step_is_its_two_halves_with_the_judge_between(name, receivers):
    """One call of the kernel, where nothing in Python comes between, gives the bits of three."""
    settings = {"timeline": SHORT, "detector": {"name": "ewma"}, **STEPS[name]}
    whole, halves = (Engine(receivers, TightlyCoupledSetup(**settings)) for _ in range(2))
    for engine in (whole, halves):
        engine.reset([np.random.default_rng([5, number]) for number in range(receivers)])
    rng, axes = np.random.default_rng(6), len(whole.setup.action_names)
    for k in range(12):
        command = None if k == 7 else rng.uniform(-1.0, 1.0, (receivers, axes))
        verdict = whole.step(command)
        halves.predict(command)
        other = halves.judge()
        halves.update(other)
        for mine, theirs in zip(verdict, other, strict=True):
            np.testing.assert_array_equal(mine, theirs)
        np.testing.assert_array_equal(whole.simulator.weights, halves.simulator.weights)
        check_same(everything(whole.simulator), everything(halves.simulator))
        for part in ("attack", "detector"):
            memories = [getattr(engine.simulator, part).memory for engine in (whole, halves)]
            for field in memories[0]:
                np.testing.assert_array_equal(memories[0][field], memories[1][field])


@pytest.mark.parametrize(
    ("name", "receivers", "holding"),
    [
        ("displacement", 1, False),
        ("displacement", 40, True),
        ("never", 9, True),
        *((name, 9, holding) for name in STEPS for holding in (False, True)),
    ],
)
def test_live_epochs_are_the_stepwise_run(name, receivers, holding):
    """One compiled call for many epochs with the detector gives the bits of a call for each."""
    detector = {"name": "ewma", "thresholds": "nominal", "false_alarm": 0.2}
    settings = {"timeline": SHORT, "detector": detector, **STEPS.get(name, {"detector": "never"})}
    fused, stepwise = (Engine(receivers, TightlyCoupledSetup(**settings)) for _ in range(2))
    for engine in (fused, stepwise):
        engine.reset([np.random.default_rng([5, number]) for number in range(receivers)])
        axes = len(engine.setup.action_names)
        engine.step(np.full((receivers, axes), 0.3) if holding else np.zeros((receivers, axes)))
    found = []
    for count in (1, 5, 12, 3):
        alarms = fused.simulator.live_epochs(count, holding=holding)
        expected = Simulator.live_epochs(stepwise.simulator, count, holding=holding)
        np.testing.assert_array_equal(alarms, expected)
        found.append(alarms)
        check_same(everything(fused.simulator), everything(stepwise.simulator))
        for mine, theirs in zip(fused.simulator.verdict, stepwise.simulator.verdict, strict=True):
            np.testing.assert_array_equal(mine, theirs)
    if settings["detector"] is detector and receivers == 40:
        assert 0 < np.concatenate(found).sum() < 21 * 40
    assert fused.simulator.live_epochs(0, holding=holding).shape == (0, receivers)


def test_an_unsound_verdict_of_live_epochs_is_named_as_that_of_a_step():
    setup = TightlyCoupledSetup(timeline=SHORT, detector={"name": "ewma", "thresholds": "nominal"})
    messages = []
    for live_epochs in (TightlyCoupledSimulator.live_epochs, Simulator.live_epochs):
        engine = Engine(9, setup)
        engine.reset([np.random.default_rng(number) for number in range(9)])
        engine.simulator.live_epochs(2)
        engine.simulator.detector.memory["decay"][4] = np.nan
        with pytest.raises(ValueError, match="receiver 4 of 9") as caught:
            live_epochs(engine.simulator, 6)
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


def test_the_quiet_stretch_is_the_stepwise_run():
    """One compiled call for many epochs gives the bits of three calls an epoch."""
    setup = TightlyCoupledSetup(timeline=SHORT)
    fused = Engine(5, setup, threads=1).simulator
    stepwise = Engine(5, setup, threads=1).simulator
    for simulator in (fused, stepwise):
        simulator.start_episodes([np.random.default_rng(i) for i in range(5)])
    fused.run_filter_only(30)
    for _ in range(30):
        stepwise.advance()
        stepwise.update(None)
    mine, theirs = everything(fused), everything(stepwise)
    for name in ("seen innovation", "seen innovation_variance", "plain time", "plain interval"):
        del mine[name], theirs[name]  # shown only where somebody may look
    del mine["plain visible"], theirs["plain visible"]
    check_same(mine, theirs)


@pytest.mark.parametrize(("attacked", "grade"), [(False, "aviation"), (True, "consumer")])
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
    np.testing.assert_array_equal(solution.position_e[-1], engine.simulator.buffers.position_e[0])
    np.testing.assert_array_equal(
        solution.sd[-1], np.sqrt(np.diagonal(engine.simulator.buffers.covariance[0]))
    )


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
                    sensors.fields["satellite_bias"][row].copy(),
                    sensors.keys[:, row].copy(),
                )
            done |= terminated
        assert done.all()
        return biases

    for early, late in zip(second(Ewma(false_alarm=0.2)), second(Never()), strict=True):
        np.testing.assert_array_equal(early[0], late[0])
        np.testing.assert_array_equal(early[1], late[1])
