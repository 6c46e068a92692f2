"""A policy that imitates a profile moves the victim as the profile does."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

# ruff: noqa: E402 - the packages of the laboratory may be missing
torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy

from agents import imitation
from agents.imitation import demonstrations, imitate
from agents.networks import MlpShape
from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers import Profile
from spoofgym.spoofers.profile import sampled

EAST = np.array([0.0, 1.0])
ENV = {
    "timeline": {"warmup_s": 6.0, "live_s": 3.0, "attack_s": 20.0},
    "knowledge": "blind",
    "action": "full-command",
}
PROFILE = Profile(heading_deg=90.0, rates_mps=(0.0, 0.3, 0.1, 0.4))
ACCELERATION = {"name": "false-position", "acceleration_limit_mps2": 0.2, "rate_limit_mps": 1.0}


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def make_envs(num_envs: int, **kwargs: object) -> SpoofVecEnv:
    given = {"attack": ACCELERATION, **ENV, **kwargs}
    return SpoofVecEnv(num_envs, threads=1, prefetch=False, seed=0, **given)


@pytest.fixture
def envs() -> Iterator[SpoofVecEnv]:
    made = make_envs(4)
    yield made
    made.close()


def columns(envs: SpoofVecEnv, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) rate to the east [m/s], and time since the onset as a part of the window."""
    names = envs.observation_names
    rate = observations[:, names.index("own_rate_east")] * envs.core.setup.rate_scale_mps
    return rate, observations[:, names.index("time_since_onset")]


@pytest.mark.parametrize("epochs", [1, 4])
def test_commands_lead_to_the_rates_of_the_profile(epochs: int) -> None:
    """Whatever a disturbed receiver has come to, its command leads back to the curve."""
    envs = make_envs(4, decision_interval_s=0.5 * epochs)
    setup = envs.core.setup
    assert setup.repeat == epochs
    decisions = setup.steps // epochs
    observations, commands = demonstrations(envs, PROFILE, EAST, seed=0)
    envs.close()
    assert (len(observations), commands.shape) == (4 * decisions, (4 * decisions, 1))
    rate, part = columns(envs, observations)
    rows = np.round(part * decisions).astype(int)
    assert (np.bincount(rows, minlength=decisions) == 4).all()
    most = ACCELERATION["acceleration_limit_mps2"] * setup.interval_s * epochs
    free = np.abs(commands[:, 0]) < 1.0
    wanted = sampled(PROFILE.rates_mps, decisions)[rows]
    assert free.mean() > 0.9
    np.testing.assert_allclose((rate + most * commands[:, 0])[free], wanted[free], atol=1e-6)
    later = rows > 0
    assert 0.2 * most * imitation.DISTURBANCE < (rate[later] - wanted[later]).std()


def test_the_same_seed_makes_the_same_demonstrations() -> None:
    found = []
    for seed in (0, 0, 1):
        envs = make_envs(2)
        found.append(demonstrations(envs, PROFILE, EAST, seed))
        envs.close()
    assert all(map(np.array_equal, found[0], found[1]))
    assert not np.array_equal(found[0][1], found[2][1])


def test_the_profile_begins_anew_where_an_alarm_has_ended_an_episode() -> None:
    """Commands fit the time that a receiver observes, not that of the others."""
    detector = {"name": "snapshot-chi2", "false_alarm": 0.9}
    envs = make_envs(6, detector=detector)
    setup = envs.core.setup
    observations, commands = demonstrations(envs, PROFILE, EAST, seed=0)
    rate, part = columns(envs, observations)
    envs.close()
    rows = np.round(part * setup.steps).astype(int)
    assert (rows == 0).sum() > 6  # some have begun a second episode
    most = ACCELERATION["acceleration_limit_mps2"] * setup.interval_s
    wanted = sampled(PROFILE.rates_mps, setup.steps)[rows]
    expected = np.clip((wanted - rate) / most, -1.0, 1.0)
    np.testing.assert_allclose(commands[:, 0], expected, atol=1e-5)


def test_the_imitating_policy_moves_the_victim_as_far(
    envs: SpoofVecEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(imitation, "UPDATES", 1500)
    torch.manual_seed(0)
    policy = ActorCriticPolicy(
        envs.observation_space,
        spaces.Box(-1.0, 1.0, (1,), np.float32),
        lambda _: 3e-4,
        **MlpShape().policy_kwargs(),
    )
    value = [weight.clone() for weight in policy.value_net.parameters()]
    apart = imitate(policy, *demonstrations(envs, PROFILE, EAST, seed=0), seed=0)
    assert apart < 0.05
    assert all(map(torch.equal, value, policy.value_net.parameters()))
    setup, tau = envs.core.setup, envs.core.setup.interval_s
    ends = np.concatenate([[0.0], sampled(PROFILE.rates_mps, setup.steps)])
    wanted = float(((ends[1:] + ends[:-1]) / 2.0 * tau).sum())
    observation, reached, before = envs.reset(), np.zeros(4), np.zeros(4)
    most = ACCELERATION["acceleration_limit_mps2"] * tau
    for _ in range(setup.steps):
        command, _ = policy.predict(observation, deterministic=True)
        after = before + most * command[:, 0]
        reached, before = reached + (before + after) / 2.0 * tau, after
        observation, _, _, _ = envs.step(command * EAST)
    np.testing.assert_allclose(reached, wanted, rtol=0.03)
    assert envs.core.step_count.max() == 0  # the episodes are over, none by an alarm


@pytest.mark.parametrize(
    ("env", "profile", "message"),
    [
        (
            {"attack": {"name": "false-position", "control": "rate"}},
            PROFILE,
            "imitated by commands of acceleration, got control = 'rate'",
        ),
        (
            {},
            Profile(heading_deg=90.0, cross_rates_mps=(0.0, 0.1)),
            r"along a straight line, got `cross_rates_mps` = \(0\.0, 0\.1\)",
        ),
        (
            {},
            Profile(heading_deg=0.0),
            r"the profile has `heading_deg` = 0, but the commands are along \[0\.0, 1\.0\]",
        ),
    ],
)
def test_what_cannot_be_imitated_is_told(
    env: dict[str, object], profile: Profile, message: str
) -> None:
    envs = make_envs(1, **env)
    with pytest.raises(ValueError, match=message):
        demonstrations(envs, profile, EAST, seed=0)
    envs.close()
