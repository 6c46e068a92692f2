"""Pools of spoofers: what they may do, and what is said of those that do something else."""

import numpy as np
import pytest

from spoofgym import duel_v0
from spoofgym.spoofers import Spoofer

from .support import BRIEF, QUIET


class Odd(Spoofer):
    """Does the same thing for ever."""

    knowledge = "blind"

    def __init__(self, action):
        self.action = action

    def act(self, observation):
        return self.action


class Single(Spoofer):
    """Pushes by numbers of single precision."""

    knowledge = "blind"

    def act(self, observation):
        return np.full((len(observation), 2), 0.1, dtype=np.float32)


class Double(Spoofer):
    """Pushes by a number that single precision does not have."""

    knowledge = "blind"

    def act(self, observation):
        return np.full((len(observation), 2), 0.1)


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.zeros(2), r"must have shape \(3, 2\) \(north_.*, east_.*\), got \(2,\)"),
        (np.zeros((3, 1)), r"must have shape \(3, 2\) .*, got \(3, 1\)"),
        (np.zeros((3, 3)), r"must have shape \(3, 2\) .*, got \(3, 3\)"),
        (None, r"must have shape \(3, 2\) .*, got \(\)"),
        ("east", "could not convert"),
        (np.array([[0.0, 0.0], [np.nan, 0.0], [0.0, 0.0]]), "'north_.*' of receiver 1 is nan"),
        (np.full((3, 2), 2.0), r"finite and in \[-1, 1\]; 'north_.*' of receiver 0 is 2.0"),
    ],
)
def test_a_spoofer_that_breaks_the_contract_is_named(action, message, delay):
    envs = duel_v0.DetectorVectorView(3, Odd(action), **BRIEF, decision_delay=delay)
    with pytest.raises(ValueError, match=f"the spoofer 'Odd' of the pool: .*{message}"):
        one_epoch(envs)


def one_epoch(envs):
    envs.reset(seed=1)
    envs.step(np.tile(QUIET, (3, 1)))


def test_a_spoofer_starts_again_only_where_an_episode_does():
    envs = duel_v0.DetectorVectorView(3, "ramp", **BRIEF, autoreset_mode="disabled")
    envs.reset(seed=1)
    memory = envs.core.pool._spoofers[0].memory
    for _ in range(2):
        envs.step(np.tile(QUIET, (3, 1)))
    assert memory["step"].tolist() == [3.0, 3.0, 3.0]  # the coming epoch has been commanded, too
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    assert memory["step"].tolist() == [3.0, 1.0, 3.0]


def test_every_spoofer_commands_in_double_precision_whoever_acts_first():
    commands = {}
    for name, pool in (("alone", [Double()]), ("pair", [Single(), Double()])):
        envs = duel_v0.DetectorVectorView(8, pool, **BRIEF)
        envs.reset(seed=2)
        game = envs.core
        commands[name] = game.pool.act(game.duel.core.snapshot(), np.arange(8))
        opponents = np.array(envs.opponents)
    assert set(opponents) == {"Single", "Double"}
    mine = opponents == "Double"
    np.testing.assert_array_equal(commands["pair"][mine], commands["alone"][mine])
    assert (commands["pair"][~mine] == np.float32(0.1)).all()
