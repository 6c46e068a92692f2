"""After an interrupt within a step or a reset none is stepped on, until a reset makes all whole."""

import re
import threading

import numpy as np
import pytest

from spoofgym.envs import SpoofCore
from spoofgym.envs.core import _DoneRows
from spoofgym.envs.options import HALFWAY
from spoofgym.simulation import TightlyCoupledSetup
from spoofgym.simulation.prefetch import NextEpisodes
from spoofgym.simulation.snapshot import SnapshotSimulator
from spoofgym.simulation.tight import TightlyCoupledSimulator

from .players import make

TIMELINE = {"warmup_s": 8.0, "live_s": 3.0, "attack_s": 6.0, "time_to_alert_s": 1.0}
BRIEF = {"scenario": "trolley", "timeline": TIMELINE, "domain": {"turn_on": "drawn"}}
TIGHT = "spoofgym/Zhong2025-v0"
FORMS = {
    "single": lambda: make(TIGHT, "single", timeline=TIMELINE).unwrapped,
    "small": lambda: make("spoofgym/Snapshot-v0", "single").unwrapped,
    "detector's view": lambda: make("spoofgym/DetectorView-v0", "single", **BRIEF).unwrapped,
    "same_step": lambda: make(TIGHT, "same_step", 17, timeline=TIMELINE, threads=2),
    "disabled": lambda: make(TIGHT, "disabled", 17, timeline=TIMELINE, threads=2),
    "SB3": lambda: make(TIGHT, "SB3", 17, timeline=TIMELINE, threads=2),
    "AEC duel": lambda: make("", "AEC duel", **BRIEF),
    "parallel duel": lambda: make("", "parallel duel", **BRIEF),
}


def act(env):
    if hasattr(env, "agent_selection"):
        env.step(np.zeros(env.action_space(env.agent_selection).shape))
        return env.observe(env.agent_selection)
    if hasattr(env, "possible_agents"):
        zeros = {agent: np.zeros(env.action_space(agent).shape) for agent in env.possible_agents}
        return env.step(zeros)[0][env.possible_agents[0]]
    batch = (env.num_envs,) if hasattr(env, "step_async") else ()  # of stable-baselines3
    return env.step(np.zeros((*batch, *env.action_space.shape)))[0]


def restart(env):
    if hasattr(env, "step_async"):
        env.seed(5)
        env.reset()
    else:
        env.reset(seed=5)


def interrupt_once(patch, owner, name):
    """Interrupt the main thread's next call of a method at its end."""
    original = getattr(owner, name)

    def interrupted(self, *args, **kwargs):
        if threading.current_thread() is not threading.main_thread():
            return original(self, *args, **kwargs)
        patch.undo()
        original(self, *args, **kwargs)
        raise KeyboardInterrupt

    patch.setattr(owner, name, interrupted)


@pytest.mark.parametrize("within", ["step", "reset"])
@pytest.mark.parametrize("form", FORMS)
def test_an_interrupted_environment_refuses_to_go_on_until_reset(form, within, monkeypatch):
    env, fresh = FORMS[form](), FORMS[form]()
    restart(env)
    act(env)
    simulator = SnapshotSimulator if form == "small" else TightlyCoupledSimulator
    half = "predict" if form == "small" else "_first_half"
    interrupt_once(monkeypatch, simulator, {"step": half, "reset": "start_episodes"}[within])
    if form == "AEC duel" and within == "step":
        act(env)  # the detector's half; the next is the spoofer's
    go_on = act if within == "step" else restart
    with pytest.raises(KeyboardInterrupt):
        go_on(env)
    for _ in range(2):
        with pytest.raises(RuntimeError, match=re.escape(HALFWAY)):
            act(env)
    restart(env)
    restart(fresh)
    for _ in range(4):
        assert np.array_equal(act(env), act(fresh))
    env.close()
    fresh.close()


def test_some_receivers_are_not_enough_for_the_reset_after_an_interrupt(monkeypatch):
    env = FORMS["disabled"]()
    env.reset(seed=5)
    interrupt_once(monkeypatch, TightlyCoupledSimulator, "step")
    with pytest.raises(KeyboardInterrupt):
        act(env)
    with pytest.raises(ValueError, match="must be that of all receivers"):
        env.reset(options={"reset_mask": np.arange(17) < 3})
    env.reset()
    with pytest.raises(ValueError, match="start_s"):  # leaves the episodes as they were
        env.reset(options={"domain": {"start_s": -1.0}})
    act(env)
    env.close()


@pytest.mark.parametrize("name", ["copy_rows", "_slots", "find_prepared"])
def test_next_episodes_whose_books_an_interrupt_broke_are_thrown_away(name, monkeypatch):
    setup = TightlyCoupledSetup(timeline=TIMELINE)
    ahead, plain = (SpoofCore(9, setup, threads=1, prefetch=on) for on in (True, False))
    given = [np.random.default_rng(seed) for seed in range(9)]
    ahead.reset(given)
    owner = TightlyCoupledSimulator if name == "copy_rows" else NextEpisodes
    interrupt_once(monkeypatch, owner, name)
    with pytest.raises(KeyboardInterrupt):
        ahead.reset(given)
    rewards = []
    for core in (ahead, plain):
        given = [np.random.default_rng(seed) for seed in range(9)]
        for _ in range(4):
            core.reset(given)
        rewards.append([core.step(np.full((9, 1), 0.3))[0].reward for _ in range(3)])
    assert np.array_equal(*rewards)
    ahead.close()


def test_an_interrupted_decision_of_several_epochs_leaves_nothing_behind(monkeypatch):
    settings = {"timeline": TIMELINE, "decision_interval_s": 2.0, "threads": 1}
    settings |= {"action": "full-command", "detector": {"name": "ewma", "false_alarm": 0.5}}
    env, fresh = (make(TIGHT, "same_step", 9, **settings) for _ in range(2))

    def played(env, seed):
        env.reset(seed=seed)
        return [env.step(np.full((9, 2), 0.5))[0] for _ in range(3)]

    interrupt_once(monkeypatch, _DoneRows, "keep")
    with pytest.raises(KeyboardInterrupt):
        played(env, 5)
    assert np.array_equal(played(env, 7), played(fresh, 7))
