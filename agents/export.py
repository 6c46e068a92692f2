"""From a policy of stable-baselines3 to an ONNX file with its card.

The file holds the deterministic action, the mean of the distribution clipped to [-1, 1], and
nothing of the value function.  It is run by onnxruntime and compared with the policy before it is
written.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray
from onnx import numpy_helper
from stable_baselines3.common.distributions import (
    DiagGaussianDistribution,
    StateDependentNoiseDistribution,
)
from stable_baselines3.common.policies import ActorCriticPolicy

from spoofgym._files import write_file
from spoofgym.export import traced
from spoofgym.policies.onnx_model import file_of
from spoofgym.spoofers.base import SpooferContext
from spoofgym.spoofers.card import Card
from spoofgym.spoofers.learned import OnnxPolicy

from .networks import InformedCritic

FloatArray = NDArray[np.float64]
TOLERANCE = 1e-6
"""Largest difference of an action between the policy and its file; times the norm of the last
layer's weights where it exceeds 1, which enlarges what single precision rounds before."""
TRIED = 4096
"""Random observations on which they are compared."""
PREFIX = "policy."
"""Before the names of the policy's parameters in a file."""
OBSERVED, COMMANDED = "observation_factor", "action_factor"
"""Names of the factors that make the amplitude, in a file."""
DIRECTIONS = "directions"
"""Name of what turns the policy's actions into commands of the attack, in a file."""
OWN = "own_"
"""How the names of observations begin that are of the spoofer's own command."""


def seen_by(policy: ActorCriticPolicy) -> int:
    """Elements of an observation that a policy sees; an `InformedCritic` hides the rest from it.

    Parameters
    ----------
    policy : ActorCriticPolicy
        Any.

    Returns
    -------
    int
        From the first one on.
    """
    return policy.seen if isinstance(policy, InformedCritic) else policy.observation_space.shape[0]


class _Actor(torch.nn.Module):
    """Deterministic action of a policy, with the amplitude of `PolicyExporter.content`."""

    def __init__(self, policy: ActorCriticPolicy, directions: FloatArray) -> None:
        super().__init__()
        self.policy = policy
        size = seen_by(policy)
        self.hidden = policy.observation_space.shape[0] - size
        self.register_buffer(OBSERVED, torch.ones(size))
        self.register_buffer(COMMANDED, torch.ones(1))
        self.register_buffer(DIRECTIONS, torch.as_tensor(directions, dtype=torch.float32))

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        policy = self.policy
        scaled = observation * self.get_buffer(OBSERVED)
        if self.hidden:
            scaled = torch.nn.functional.pad(scaled, (0, self.hidden))
        features = policy.pi_features_extractor(scaled)
        mean = policy.action_net(policy.mlp_extractor.forward_actor(features))
        action = torch.clamp(mean, -1.0, 1.0) * self.get_buffer(COMMANDED)
        return torch.clamp(action @ self.get_buffer(DIRECTIONS), -1.0, 1.0)


class PolicyExporter:
    """Writes one policy again and again while it learns: traced once, in some seconds.

    Parameters
    ----------
    policy : ActorCriticPolicy
        Such as the ``policy`` of PPO; its weights are read anew for every file.
    directions : array_like, optional
        (k, a) commands of the attack for each of the policy's k actions; by default they are the
        same.

    Raises
    ------
    TypeError
        When it is no Gaussian policy on a box of observations.
    ValueError
        When the directions do not fit the policy.
    """

    def __init__(self, policy: ActorCriticPolicy, directions: ArrayLike | None = None) -> None:
        _check_policy(policy)
        self.policy = policy
        size = policy.action_space.shape[0]
        given = np.eye(size) if directions is None else directions
        self.directions: FloatArray = np.asarray(given, dtype=np.float64)
        if self.directions.ndim != 2 or len(self.directions) != size:
            raise ValueError(
                f"`directions` must have a row for each of the policy's {size} actions, got shape "
                f"{self.directions.shape}"
            )
        if not np.isfinite(self.directions).all():
            raise ValueError(f"`directions` must be finite, got {self.directions.tolist()}")
        self._model = _trace(policy, self.directions)

    def content(self, names: Sequence[str] = (), amplitude: float = 1.0) -> bytes:
        r"""The policy as it is now.

        With an amplitude s the file follows what the policy :math:`\pi` plans s times as large: its
        own displacement and rate, :math:`o_c`, are divided by s before it sees them.  With the
        directions D the command of the attack is

        .. math:: a = \mathrm{clip}(s \, \pi(o_c / s, o_{rest}) \, D)

        where the policy's actions and what is sent are clipped to [-1, 1].

        Parameters
        ----------
        names : sequence of str
            Name of every observation; those of the own command begin with ``own_``.  Needed where
            the amplitude is not 1.
        amplitude : float
            s, above 0.

        Returns
        -------
        bytes
            Of an ONNX file without external data.
        """
        weights = dict(self.policy.state_dict())
        size = seen_by(self.policy)
        weights[OBSERVED], weights[COMMANDED] = _factors(size, names, amplitude)
        for tensor in self._model.graph.initializer:
            weight = weights.get(tensor.name.removeprefix(PREFIX))
            if weight is not None:
                array = weight.detach().cpu().numpy()
                tensor.CopyFrom(numpy_helper.from_array(array, tensor.name))
        return bytes(self._model.SerializeToString(deterministic=True))

    def write(self, path: str | Path, fields: Mapping[str, Any], amplitude: float = 1.0) -> Card:
        """Compare file and policy, then write the file and last its card.

        Parameters
        ----------
        path : path-like
            ``.../NAME.onnx``; the card becomes ``.../NAME.json``.
        fields : mapping
            Fields of the card but ``name``, ``kind`` and ``file``.
        amplitude : float
            As in `content`.

        Returns
        -------
        Card
            As it was written.

        Raises
        ------
        ValueError
            When the file does not act as the policy does, or the card does not fit; nothing is
            written then.
        """
        path = Path(path)
        if path.suffix != ".onnx":
            raise ValueError(f"`path` must end in .onnx, got {path}")
        observed = fields["observation"]  # where there is none, the card is refused
        content = self.content(observed["names"] if observed else (), amplitude)
        file = file_of(path.name, content)
        card = Card(name=path.stem, kind="onnx-policy", file=file, **fields)
        with tempfile.TemporaryDirectory() as folder:
            _write(Path(folder) / path.name, content, card)
            self._compare(OnnxPolicy(str(Path(folder) / path.name)), amplitude)
        _write(path, content, card)
        return card

    def _compare(self, written: OnnxPolicy, amplitude: float) -> None:
        """Raise unless a file acts as its policy, all over the space of its card."""
        policy = self.policy
        space = written.card.observation
        assert space is not None  # OnnxPolicy has checked it
        low, high = np.array(space.low, dtype=np.float32), np.array(space.high, dtype=np.float32)
        own, seen = policy.observation_space, seen_by(policy)
        if not (np.array_equal(low, own.low[:seen]) and np.array_equal(high, own.high[:seen])):
            raise ValueError(
                f"the policy sees {seen} elements of {own}, but the card of "
                f"{written.card.name!r} has other bounds"
            )
        drawn = np.random.default_rng(0).uniform(low, high, (TRIED, len(low)))
        observation = np.vstack([drawn.astype(np.float32), low, high])
        written.bind(_context(written.card, len(observation)))
        action = written.act(observation)
        factors, factor = (tensor.numpy() for tensor in _factors(len(low), space.names, amplitude))
        padded = np.pad(observation * factors, ((0, 0), (0, own.shape[0] - seen)))
        expected, _ = policy.predict(padded, deterministic=True)
        apart = float(
            np.abs(action - np.clip(factor * expected @ self.directions, -1.0, 1.0)).max()
        )
        gain = amplitude * float(policy.action_net.weight.detach().norm(dim=1).max())
        allowed = TOLERANCE * max(gain, 1.0)
        if not apart <= allowed:
            raise ValueError(
                f"the exported {written.card.name!r} differs from the policy by {apart:.2g}, more "
                f"than {allowed:.2g}"
            )


def export_policy(
    policy: ActorCriticPolicy,
    path: str | Path,
    fields: Mapping[str, Any],
    amplitude: float = 1.0,
    directions: ArrayLike | None = None,
) -> Card:
    """Write a policy and its card once.

    Parameters
    ----------
    policy : ActorCriticPolicy
        As in `PolicyExporter`.
    path : path-like
        ``.../NAME.onnx``.
    fields : mapping
        As in `PolicyExporter.write`.
    amplitude : float
        As in `PolicyExporter.content`.
    directions : array_like, optional
        As in `PolicyExporter`.

    Returns
    -------
    Card
        As it was written.
    """
    return PolicyExporter(policy, directions).write(path, fields, amplitude)


def _write(path: Path, content: bytes, card: Card) -> None:
    """File first: what is interrupted in between does not fit its card, and is refused."""
    write_file(path, content)
    card.save(path.with_suffix(".json"))


def _check_policy(policy: ActorCriticPolicy) -> None:
    kinds = (DiagGaussianDistribution, StateDependentNoiseDistribution)
    gaussian = isinstance(getattr(policy, "action_dist", None), kinds)
    if not isinstance(policy, ActorCriticPolicy) or not gaussian or policy.squash_output:
        raise TypeError(
            "only an actor-critic policy with a Gaussian action, as PPO has it, can be exported, "
            f"got {type(policy).__name__}"
        )
    space = policy.observation_space
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise TypeError(f"a policy must observe a vector, got {space}")


def _trace(policy: ActorCriticPolicy, directions: FloatArray) -> onnx.ModelProto:
    """Graph of the policy; its parameters keep their names."""
    training = policy.training
    policy.set_training_mode(False)
    try:
        content = traced(_Actor(policy, directions), seen_by(policy))
    finally:
        policy.set_training_mode(training)
    return onnx.load_model_from_string(content)


def _factors(
    size: int, names: Sequence[str], amplitude: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Factors on observations and actions that make an amplitude."""
    if not (math.isfinite(amplitude) and amplitude > 0.0):
        raise ValueError(f"`amplitude` must be finite and > 0, got {amplitude}")
    if amplitude != 1.0 and len(names) != size:
        raise ValueError(f"an amplitude needs the {size} names of observations, got {len(names)}")
    own = [1.0 / amplitude if name.startswith(OWN) else 1.0 for name in names] or [1.0] * size
    return torch.tensor(own), torch.tensor([amplitude])


def _context(card: Card, receivers: int) -> SpooferContext:
    """What its own card asks for."""
    assert card.observation is not None
    return SpooferContext(
        receivers=receivers,
        action_names=card.action.names,
        observation_names=card.observation.names,
        observation_low=card.observation.low,
        observation_high=card.observation.high,
        **card.conditions.model_dump(),
    )
