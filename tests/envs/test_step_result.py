"""A step: compiled code has the bits of the terms that it replaces, by few calls of Python."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import spoofgym
from spoofgym.envs import SpoofCore
from spoofgym.envs.terms.observation import OwnCommand, TargetMotion, Time
from spoofgym.envs.terms.reward import (
    AlarmedEpochs,
    AlarmPenalty,
    DisplacementGain,
    Retraction,
    compute_shares,
)
from spoofgym.envs.terms.termination import AtAlarm, AtDisplacement
from spoofgym.simulation import TightlyCoupledSetup

from .support import victim

ID = "spoofgym/Zhong2025-v0"
SHORT = {"warmup_s": 20.0, "live_s": 10.0, "attack_s": 20.0, "time_to_alert_s": 2.0}
TERMS = [AlarmPenalty(0.7), DisplacementGain(0.3), Retraction(1.7), AlarmedEpochs(0.1)]
NERVOUS = {"name": "ewma", "false_alarm": 0.1}
"""A detector that alarms within seconds of an attack at full acceleration."""
PLAIN = {"timeline": SHORT, "prefetch": False, "action": "full-command"}


@dataclass(frozen=True)
class Own:
    """A term that compiled code knows nothing of, worth another."""

    term: Any

    @property
    def name(self):
        return self.term.name

    def __call__(self, outcome):
        return self.term(outcome)


@dataclass(frozen=True)
class Nowhere(AtDisplacement):
    """An end that never comes, for which a step hands out its arrays."""

    name = "nowhere"

    def __call__(self, state):
        return state.displacement >= np.inf


@dataclass(frozen=True)
class Backwards(OwnCommand):
    """Inherits factors that are not its own."""

    def __call__(self, snapshot, out):
        super().__call__(snapshot, out)
        out *= -1.0


@dataclass(frozen=True)
class Doubled(DisplacementGain):
    """Inherits a share that is not its own."""

    def __call__(self, outcome):
        return 2.0 * super().__call__(outcome)


def played(**settings):
    envs = gym.make_vec(ID, num_envs=3, **{**PLAIN, **settings})
    envs.reset(seed=4)
    rng, found, before = np.random.default_rng(1), [], []
    for _ in range(60):
        seen, reward, terminated, truncated, info = envs.step(rng.uniform(0.5, 1.0, (3, 2)))
        arrays = [seen, reward, terminated, truncated, *info.values()]
        for k, array in enumerate(arrays):  # what is handed out shares nothing
            assert not any(np.shares_memory(array, other) for other in arrays[:k] + before)
        before = arrays
        if "alarm" in info:  # else all of them start again
            found.append({"seen": seen, "reward": reward, "over": terminated | truncated, **info})
    envs.close()
    return found


def test_compiled_rewards_are_those_of_the_terms_and_their_sum():
    settings = {"detector": NERVOUS, "end_at_alarm": False}
    steps = played(reward=TERMS, **settings)
    own = played(reward=[Own(term) for term in TERMS], **settings)
    for term in TERMS:
        assert any(step[f"reward_{term.name}"].any() for step in steps)
    for step, other in zip(steps, own, strict=True):
        for name, array in step.items():
            np.testing.assert_array_equal(array, other[name], err_msg=name, strict=True)
        total = np.zeros(3)
        for term in TERMS:
            total += step[f"reward_{term.name}"]
        np.testing.assert_array_equal(step["reward"], total)


@pytest.mark.parametrize(
    "settings",
    [
        {"target_heading_deg": "worst"},
        {"knowledge": "oracle", "reward": TERMS, "detector": NERVOUS},
        {"domain": {"start_s": (0.0, 10.0)}, "target_heading_deg": "random"},
    ],
    ids=str,
)
def test_a_step_that_is_scored_at_once_has_the_bits_of_one_scored_apart(settings):
    ends = None, [AtAlarm(), Nowhere(1.0)]
    plain, apart = (gym.make(ID, timeline=SHORT, end=end, **settings) for end in ends)
    seed, rng = 4, np.random.default_rng(1)
    for _ in range(60):
        if seed is not None:
            plain.reset(seed=seed)
            apart.reset(seed=seed)
        action = rng.uniform(0.5, 1.0, plain.action_space.shape)
        mine, theirs = plain.step(action), apart.step(action)
        np.testing.assert_array_equal(mine[0], theirs[0], strict=True)
        assert mine[1:4] == theirs[1:4]
        assert not theirs[4].pop("end_nowhere")
        assert mine[4] == theirs[4]
        assert [*map(type, mine[4].values())] == [*map(type, theirs[4].values())]
        seed = 5 if mine[2] else None


def test_only_what_stands_beside_its_own_call_is_believed():
    expected = [[0, 0, -0.7, 0], [0.3, 0, 0, 0], [0, 1.7, 0, 0], [0, 0, 0, -0.1]]
    np.testing.assert_array_equal(compute_shares(TERMS), expected)
    assert compute_shares([*TERMS, Doubled()]) is None
    setup = TightlyCoupledSetup(timeline=SHORT, detector="never")
    seen = [Backwards(1.0, 1.0)]
    core = SpoofCore(2, setup, observation=seen, action="full-command", reward=[])
    core.reset(np.random.default_rng(0).spawn(2))
    for _ in range(3):
        _, seen = core.step(np.ones((2, 2)))
    moved = core.engine.simulator.attack.memory["displacement"]
    assert (moved > 0.0).all()
    np.testing.assert_array_equal(seen[:, :2], -moved.astype(np.float32))


@pytest.mark.parametrize(
    ("domain", "steps"),
    [(None, 40), ({"start_s": (10.0, 10.0), "turned_deg": (0.0, 360.0), "worlds": 2}, 3)],
    ids=["one", "two"],
)
def test_motion_and_time_are_tabled_to_the_bit_where_no_start_is_drawn(domain, steps):
    setup = TightlyCoupledSetup(timeline=SHORT, detector="never", domain=domain)
    terms = Time(), TargetMotion(least_change=0.0)
    core = SpoofCore(3, setup, observation=terms, reward=[], end_at_alarm=False)
    given = None if domain is None else {"world": [0, 1, 1]}
    core.reset(np.random.default_rng(0).spawn(3), given=given)
    assert setup.onsets is not None
    for _ in range(steps):
        _, seen = core.step(np.zeros((3, 1)))
        for term in terms:
            names = term.names(setup)
            first = core.observation_names.index(names[0])
            out = np.zeros((3, len(names)), dtype=np.float32)
            term(core.snapshot(), out)
            out = np.clip(out, *term.bounds(setup))
            np.testing.assert_array_equal(seen[:, first : first + len(names)], out)
    drawn = TightlyCoupledSetup(timeline=SHORT, detector="never", domain={"start_s": (0.0, 10.0)})
    assert drawn.onsets is Time().table(drawn) is TargetMotion().table(drawn) is None


ROOT = Path(spoofgym.__file__).parent
ELSEWHERE = ("attacks", "detectors", "envs/terms")
"""What has a contract of its own, and calls what it likes; kernels are no Python."""
MOST_CALLS = 18


def calls_of(work):
    """Python functions of the package that are called, in order; not what terms and kernels do."""
    found = []
    outside = []

    def profile(frame, event, _):
        path = Path(frame.f_code.co_filename)
        if not path.is_relative_to(ROOT):
            return
        name = path.relative_to(ROOT).as_posix()
        if event == "call" and name.startswith(ELSEWHERE):
            outside.append(id(frame))
        elif event == "call" and not outside and not path.stem.endswith("_kernels"):
            found.append(f"{name}:{frame.f_code.co_qualname}")
        elif event == "return" and outside and outside[-1] == id(frame):
            outside.pop()

    sys.setprofile(profile)
    try:
        work()
    finally:
        sys.setprofile(None)
    return found


def test_a_step_takes_few_calls():
    """Of the single environment, in its steady state, without a defence."""
    for watch, most in ((None, MOST_CALLS), ("ewma", np.inf)):
        env = victim("Zhong2025", detector="never", watch=watch).unwrapped
        env.reset(seed=1)
        action = np.zeros(env.action_space.shape, dtype=np.float32)
        for _ in range(3):  # compiles, and makes what is made once
            env.step(action)
        calls = calls_of(lambda env=env, action=action: env.step(action))
        assert calls[0] == "envs/env.py:CoreEnv.step"
        assert any(call.endswith("TightlyCoupledSimulator.step") for call in calls)
        assert len(calls) <= most, "\n".join(calls)
        assert not any(call.startswith(ELSEWHERE) for call in calls)
        assert any("PassiveInfo" in call for call in calls) == bool(watch)  # so they are counted
