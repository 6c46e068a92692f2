"""A policy that imitates an open-loop profile, for learning to begin at."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy

from spoofgym.sb3 import SpoofVecEnv
from spoofgym.spoofers import Profile
from spoofgym.spoofers.aim import direction as unit_command
from spoofgym.spoofers.profile import sampled

FloatArray = NDArray[np.float64]
UPDATES, BATCH, RATE = 3000, 1024, 2e-3
"""Steps of the regression, samples of each, and its learning rate, which falls to nothing."""
DISTURBANCE = 0.1
"""Standard deviation of what is added to the commands, so that a policy learns to come back."""


def check_imitable(envs: SpoofVecEnv, profile: Profile, direction: FloatArray) -> None:
    """Raise where a profile can't be imitated by commands along a direction.

    Parameters
    ----------
    envs, profile, direction
        As in `demonstrations`.

    Raises
    ------
    ValueError
        When the attack is commanded by rate, or the profile leaves the direction.
    """
    control = envs.core.setup.attack.control
    if control != "acceleration":
        raise ValueError(
            f"a profile is imitated by commands of acceleration, got control = {control!r}"
        )
    if profile.cross_rates_mps:
        raise ValueError(
            "a profile is imitated along a straight line, got `cross_rates_mps` = "
            f"{profile.cross_rates_mps}"
        )
    if not np.allclose(unit_command(envs.action_names, profile.heading_deg), direction):
        raise ValueError(
            f"the profile has `heading_deg` = {profile.heading_deg:g}, but the commands are along "
            f"{np.asarray(direction).tolist()} of {', '.join(envs.action_names)}"
        )


def demonstrations(
    envs: SpoofVecEnv, profile: Profile, direction: FloatArray, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What a profile does from where disturbed commands have led.

    Parameters
    ----------
    envs : SpoofVecEnv
        Runs for as long as one episode without an alarm; after an alarm a receiver begins its next
        one, and so does the profile there.  Its attack is commanded by acceleration.
    profile : Profile
        Along the direction, without a curve across.
    direction : ndarray
        (a,) unit command.
    seed : int
        Of the disturbance.

    Returns
    -------
    observations : ndarray
        (N, o) what the receivers observe.
    commands : ndarray
        (N, 1) along the direction, in [-1, 1].

    Raises
    ------
    ValueError
        As `check_imitable`.
    """
    check_imitable(envs, profile, direction)
    setup = envs.core.setup
    attack = setup.attack
    rng = np.random.default_rng(seed)
    decisions = setup.steps // setup.repeat
    rates = sampled(profile.rates_mps, decisions)
    most = attack.acceleration_limit_mps2 * setup.interval_s * setup.repeat
    own = [envs.observation_names.index(name) for name in _rates(envs)]
    seen, told = [], []
    observation = envs.reset()
    for _ in range(decisions):
        wanted = rates[envs.core.step_count // setup.repeat]
        rate = observation[:, own] @ direction * setup.rate_scale_mps
        command = np.clip((wanted - rate) / most, -1.0, 1.0)[:, None]
        seen.append(observation)
        told.append(command.astype(np.float32))
        disturbed = command + DISTURBANCE * rng.standard_normal(command.shape)
        observation, _, _, _ = envs.step(np.clip(disturbed, -1.0, 1.0) * direction)
    return np.concatenate(seen), np.concatenate(told)


def _rates(envs: SpoofVecEnv) -> list[str]:
    """Names of the own rates, in the order of the commands."""
    return [f"own_rate_{name.rsplit('_', 1)[0]}" for name in envs.action_names]


def imitate(
    policy: ActorCriticPolicy,
    observations: NDArray[np.float32],
    commands: NDArray[np.float32],
    seed: int,
) -> float:
    """Fit a policy's mean action to commands, by least squares.

    Parameters
    ----------
    policy : ActorCriticPolicy
        Its action network is changed, and nothing of the value function.
    observations, commands : ndarray
        (N, o) and (N, a).
    seed : int
        Of the order of the samples.

    Returns
    -------
    float
        Root of the mean squared difference at the end.
    """
    parts = (policy.mlp_extractor.policy_net, policy.action_net)
    weights = [weight for part in parts for weight in part.parameters()]
    optimizer = torch.optim.Adam(weights, lr=RATE)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.01, UPDATES)
    chance = torch.Generator().manual_seed(seed)
    seen, told = torch.as_tensor(observations), torch.as_tensor(commands)

    def loss_on(rows: torch.Tensor) -> torch.Tensor:
        features = policy.pi_features_extractor(seen[rows])
        mean = policy.action_net(policy.mlp_extractor.forward_actor(features))
        return ((mean - told[rows]) ** 2).mean()

    for _ in range(UPDATES):
        rows = torch.randint(len(seen), (BATCH,), generator=chance)
        optimizer.zero_grad()
        loss_on(rows).backward()
        optimizer.step()
        schedule.step()
    with torch.no_grad():
        return float(loss_on(torch.arange(len(seen))).sqrt())
