from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from spoofgym.envs import SpoofCore
from spoofgym.envs.terms.observation import OwnCommand, TargetMotion, Time
from spoofgym.envs.terms.reward import (
    AlarmedEpochs,
    AlarmPenalty,
    DisplacementGain,
    Outcome,
    Retraction,
    RewardTerm,
    shares_of,
)
from spoofgym.envs.terms.termination import AtAlarm, AtDisplacement, EpochState
from spoofgym.simulation import TightlyCoupledSetup

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
    def name(self) -> str:
        return self.term.name

    def __call__(self, outcome: Outcome) -> Any:
        return self.term(outcome)


@dataclass(frozen=True)
class Nowhere(AtDisplacement):
    """An end that nobody comes to, for which a step hands out its arrays."""

    name = "nowhere"

    def __call__(self, standing: EpochState) -> Any:
        return standing.displacement >= np.inf


@dataclass(frozen=True)
class Backwards(OwnCommand):
    """Inherits factors that are not its own."""

    def __call__(self, snapshot: Any, out: Any) -> None:
        super().__call__(snapshot, out)
        out *= -1.0


@dataclass(frozen=True)
class Doubled(DisplacementGain):
    """Inherits a share that is not its own."""

    def __call__(self, outcome: Outcome) -> Any:
        return 2.0 * super().__call__(outcome)


def played(**settings: Any) -> list[dict[str, Any]]:
    """Rewards, ends and infos of all steps of a vector environment, with alarms and resets."""
    envs = gym.make_vec("spoofgym/TightlyCoupled-v0", num_envs=3, **{**PLAIN, **settings})
    envs.reset(seed=4)
    rng, found = np.random.default_rng(1), []
    for _ in range(60):
        seen, reward, terminated, truncated, info = envs.step(rng.uniform(0.5, 1.0, (3, 2)))
        if "alarm" in info:  # else all of them start again
            found.append({"seen": seen, "reward": reward, "over": terminated | truncated, **info})
    envs.close()
    return found


def assert_same(mine: list[dict[str, Any]], theirs: list[dict[str, Any]]) -> None:
    for a, b in zip(mine, theirs, strict=True):
        for name, array in a.items():
            np.testing.assert_array_equal(array, b[name], err_msg=name, strict=True)


def test_compiled_rewards_are_those_of_the_terms() -> None:
    steps = played(reward=TERMS, detector=NERVOUS, end_at_alarm=False)
    for term in TERMS:
        assert any(step[f"reward_{term.name}"].any() for step in steps)
    own = [Own(term) for term in TERMS]
    assert_same(steps, played(reward=own, detector=NERVOUS, end_at_alarm=False))
    for step in steps:
        total = np.zeros(3)
        for term in TERMS:
            total += step[f"reward_{term.name}"]
        np.testing.assert_array_equal(step["reward"], total)


COMPOSITIONS: list[dict[str, Any]] = [
    {},
    {"twin": True},
    {"target_heading_deg": "worst"},
    {"knowledge": "oracle", "detector": NERVOUS},
    {"knowledge": "blind", "attack": "meaconer"},
    {"observation": [Time(), OwnCommand(30.0)], "reward": TERMS, "detector": NERVOUS},
    {"domain": {"start_s": (0.0, 10.0)}, "target_heading_deg": "random"},
]


def alone(**settings: Any) -> list[tuple[Any, ...]]:
    """All that a single environment returns in some episodes."""
    env = gym.make("spoofgym/TightlyCoupled-v0", timeline=SHORT, **settings)
    rng, found = np.random.default_rng(1), []
    env.reset(seed=4)
    for _ in range(60):
        found.append(env.step(rng.uniform(0.5, 1.0, len(env.unwrapped.action_names))))
        if found[-1][2] or found[-1][3]:
            env.reset()
    env.close()
    return found


@pytest.mark.parametrize("settings", COMPOSITIONS, ids=str)
def test_a_single_step_without_arrays_has_the_bits_of_one_with_them(
    settings: dict[str, Any],
) -> None:
    # the observations of the plain one are kept over all further steps
    plain, arrays = alone(**settings), alone(**settings, end=[AtAlarm(), Nowhere(1.0)])
    for mine, theirs in zip(plain, arrays, strict=True):
        np.testing.assert_array_equal(mine[0], theirs[0], strict=True)
        assert mine[1:4] == theirs[1:4]
        told = {name: value for name, value in theirs[4].items() if name != "end_nowhere"}
        assert mine[4] == told
        assert list(map(type, mine[4].values())) == list(map(type, told.values()))


def test_masked_rows_are_masked_arrays() -> None:
    envs, chosen = (
        gym.make_vec("spoofgym/TightlyCoupled-v0", num_envs=3, infos=infos, **PLAIN)
        for infos in ("all", ("time_s", "cost", "alarm", "reward_alarm"))
    )
    envs.reset(seed=2)
    chosen.reset(seed=2)
    whole = envs.step(np.ones((3, 2)))[4]
    some = chosen.step(np.ones((3, 2)))[4]
    assert {"_" + name for name in whole if name[0] != "_"} == {n for n in whole if n[0] == "_"}
    for name, array in some.items():
        np.testing.assert_array_equal(array, whole[name], strict=True)
    envs.close()
    chosen.close()


def test_a_step_hands_out_arrays_that_share_nothing() -> None:
    envs = gym.make_vec("spoofgym/TightlyCoupled-v0", num_envs=2, **PLAIN)
    envs.reset(seed=0)
    arrays = [
        array
        for _ in range(2)
        for part in (envs.step(np.zeros((2, 2))),)
        for array in (*part[:4], *part[4].values())
    ]
    envs.close()
    for i, a in enumerate(arrays):
        assert not any(np.shares_memory(a, b) for b in arrays[:i])


def test_only_a_share_beside_its_own_call_is_believed() -> None:
    shares = shares_of(TERMS)
    assert shares is not None
    np.testing.assert_array_equal(
        shares, [[0, 0, -0.7, 0], [0.3, 0, 0, 0], [0, 1.7, 0, 0], [0, 0, 0, -0.1]]
    )
    other: list[RewardTerm] = [*TERMS, Doubled()]
    assert shares_of(other) is None


def test_only_factors_beside_their_own_call_are_believed() -> None:
    setup = TightlyCoupledSetup(timeline=SHORT, detector="never")
    seen = [Backwards(1.0, 1.0)]
    core = SpoofCore(
        2, setup, observation=seen, action="full-command", reward=[], end_at_alarm=False
    )
    core.reset(np.random.default_rng(0).spawn(2))
    for _ in range(3):
        _, seen = core.step(np.ones((2, 2)))
    moved = core.engine.simulator.attack.memory["displacement"]
    assert (moved > 0.0).all()
    np.testing.assert_array_equal(seen[:, :2], -moved.astype(np.float32))


TWO_WORLDS = {"start_s": (10.0, 10.0), "turned_deg": (0.0, 360.0), "worlds": 2}


@pytest.mark.parametrize(("domain", "steps"), [(None, 40), (TWO_WORLDS, 3)], ids=["one", "two"])
def test_motion_and_time_are_tabled_to_the_bit(domain: Any, steps: int) -> None:
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


def test_nothing_is_tabled_where_the_start_is_drawn() -> None:
    setup = TightlyCoupledSetup(timeline=SHORT, detector="never", domain={"start_s": (0.0, 10.0)})
    assert setup.onsets is None
    assert Time().table(setup) is None
    assert TargetMotion().table(setup) is None
