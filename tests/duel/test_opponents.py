"""Pools of spoofers: what they may do, and what is said of those that do something else."""

import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.spoofers import Spoofer

from .support import BRIEF, QUIET


class Odd(Spoofer):
    knowledge = "blind"

    def __init__(self, action):
        self.action = action

    def act(self, observation):
        return self.action


def steps(envs, count=1, seed=None):
    if seed is not None:
        envs.reset(seed=seed)
    for _ in range(count):
        envs.step(np.tile(QUIET, (envs.num_envs, 1)).astype(np.float32))


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(2), r"must have shape \(3, 2\) \(north_.*, east_.*\), got \(2,\)"),
        (None, r"must have shape \(3, 2\) .*, got \(\)"),
        ("east", "could not convert"),
        (np.full((3, 2), np.nan), "'north_.*' of receiver 0 is nan"),
    ],
)
def test_a_spoofer_that_breaks_the_contract_is_named(action, message):
    for delay in (0, 1):
        envs = duel_v0.DetectorVectorView(3, Odd(action), **BRIEF, decision_delay=delay)
        with pytest.raises(ValueError, match=f"the spoofer 'Odd' of the pool: .*{message}"):
            steps(envs, 1, seed=1)


def test_receivers_begin_again_with_their_episodes_and_decide_at_times_of_their_own():
    envs = duel_v0.DetectorVectorView(3, "ramp", **BRIEF, autoreset_mode="disabled")
    envs.reset(seed=1)
    memory = envs.core.pool._spoofers[0].memory
    steps(envs, 2)
    assert memory["step"].tolist() == [3.0, 3.0, 3.0]  # the coming epoch has been commanded, too
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    assert memory["step"].tolist() == [3.0, 1.0, 3.0]
    envs = duel_v0.DetectorVectorView(
        2, Sweep("linear", 1.5), **BRIEF, autoreset_mode="disabled", attack_probability=1.0
    )
    envs.reset(seed=1)
    steps(envs, 2)
    envs.reset(options={"reset_mask": np.array([False, True])})
    assert envs.core.duel.snapshot().step.tolist() == [2, 0]  # of a duel's observers, too
    simulator, moved = envs.core.duel.core.engine.simulator, []
    for _ in range(7):
        steps(envs)
        moved.append(simulator.commanded_displacement.copy())
    moved = np.array(moved)
    np.testing.assert_array_equal(moved[:-2, 0], moved[2:, 1])


def test_every_spoofer_commands_in_double_precision_whoever_acts_first():
    commands = {}
    single, double = Odd(np.full((8, 2), 0.1, dtype=np.float32)), Even(np.full((8, 2), 0.1))
    for name, pool in (("alone", [double]), ("pair", [single, double])):
        envs = duel_v0.DetectorVectorView(8, pool, **BRIEF)
        envs.reset(seed=2)
        commands[name] = envs.core.pool.act(envs.core.duel.snapshot(), np.arange(8))
    mine = np.array(envs.opponents) == "Even"
    assert {*mine} == {True, False}
    np.testing.assert_array_equal(commands["pair"][mine], commands["alone"][mine])
    assert (commands["pair"][~mine] == np.float32(0.1)).all()


class Even(Odd):
    """Another name."""


class Sweep(Spoofer):
    knowledge = "blind"

    def __init__(self, between="hold", decision_interval_s=None):
        self.between, self.decision_interval_s = between, decision_interval_s

    def act(self, observation):
        return np.tile(np.cos(7.0 * observation[:, -1:].astype(np.float64)), (1, 2))


@pytest.mark.parametrize(("between", "delay"), [("hold", 0), ("linear", 1)])
def test_a_spoofer_that_decides_seldom_does_so_in_a_pool(between, delay):
    """Beside one that decides at every epoch, and for receivers of different ages."""
    pace = {"decision_interval_s": 1.5, "between": between}
    one_start = {**BRIEF, "domain": {**BRIEF["domain"], "start_s": [0.0, 0.0]}}
    moved = {}
    for name, pool, world in (
        ("own", [Sweep(**pace), Sweep()], {}),
        ("world", [Sweep(), Sweep()], pace),
    ):
        envs = duel_v0.DetectorVectorView(6, pool, **one_start, **world, decision_delay=delay)
        envs.reset(seed=3)
        opponents, found = np.array(envs.core.pool.opponent), []
        for _ in range(20):
            steps(envs)
            found.append(envs.core.duel.core.engine.simulator.commanded_displacement.copy())
        moved[name] = np.array(found)
        envs.close()
    late = opponents == 0
    assert set(late) == {True, False}
    np.testing.assert_array_equal(moved["own"][:, late], moved["world"][:, late])
    assert (moved["own"][-1, ~late] != moved["world"][-1, ~late]).any()


class Told(Spoofer):
    knowledge = "blind+reported"
    seen = ()

    def act(self, observation):
        type(self).seen = np.array(observation), self.context.observation_names
        return np.zeros((len(observation), 2))


def test_a_spoofer_of_a_pool_may_know_what_the_victim_reports():
    view = duel_v0.DetectorVectorView(2, [Told()], **BRIEF)
    view.reset(seed=4)
    steps(view, 12)  # until some reports have arrived
    seen, names = Told.seen
    reported = [k for k, name in enumerate(names) if name.startswith("reported_position")]
    assert len(reported) == 2
    assert seen[:, reported].all()
