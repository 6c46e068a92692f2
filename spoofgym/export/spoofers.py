"""Spoofers, and policies of a duel's detector, from a model to a file with its card."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from .._describe import describe
from .._files import write_file
from .._registry import check_finite
from ..bench.versions import versions
from ..detectors.learned.card import OnnxDetector, card_path
from ..duel.card import write_card
from ..envs.spoofer_binding import spoofer_context
from ..policies.onnx_file import checked_path, file_of
from ..spoofers.card import Card, Knowledge, fields_of
from ..spoofers.learned import OnnxPolicy
from ..spoofers.model import Normalization, function_of, inner_env, normalization_of
from ..spoofers.scaled import own_columns
from .asked import check_training, one_line, trial_of
from .networks import Actor
from .tracing import TOLERANCE, TRIED, evaluating, library_versions, traced

OF_THE_CALL = (
    "autoreset_mode",
    "infos",
    "num_envs",
    "prefetch",
    "render_mode",
    "threads",
    "vectorization_mode",
)
"""Arguments of `gymnasium.make` and `make_vec` that change nothing of what is simulated."""


def onnx(
    model: Any,
    env: Any = None,
    path: str | Path = "spoofer.onnx",
    *,
    amplitude: float = 1.0,
    training: Mapping[str, Any] | None = None,
    designed_on: str | None = None,
) -> Any:
    """Write a spoofer, or a detector policy, and its card.

    Parameters
    ----------
    model : object
        A model of stable-baselines3 with a Gaussian or deterministic policy, such as PPO, A2C, SAC,
        TD3 and DDPG; its policy alone; or a torch module of (B, o) observations that returns (B, a)
        actions, which are cut to [-1, 1].
    env : SpoofVecEnv, SpoofEnv or SpoofVectorEnv, optional
        Where it was trained, wrapped or not; by default the environment that the model has.  A
        `VecNormalize` around it is folded in: that of a model of stable-baselines3 is its own, and
        a torch module or a policy alone has learned behind the one that is given.
    path : str or Path
        ``.../NAME.onnx``; the card becomes ``.../NAME.json``.
    amplitude : float
        Factor on all commands, above 0, as `spoofgym.evaluate` fits it.
    training : mapping, optional
        How it was made, JSON-able: further fields beside what a model says of itself. Games of
        populations read ``"decided_on"``, such as ``[[0, "training"]]``: entropy and split of the
        runs that it was trained, fitted or chosen on, and refuse to score it on them.
    designed_on : str, optional
        What it was optimised on; by default the detector of the environment, by training.

    Returns
    -------
    Card or DetectorCard
        As it was written, the latter where a detector learned (``side="detector"``).

    Raises
    ------
    TypeError
        When the model is something else, or its policy has no deterministic action of a network.
    ValueError
        When it is recurrent, its environment can't be written down, or normalizes otherwise than
        the model's own, or the file does not act as the model does; nothing is written then.
    """
    path = checked_path(path)
    check_training(training, path.stem)
    check_finite("amplitude", amplitude, "> 0")
    env = model.get_env() if env is None and hasattr(model, "get_env") else env
    inner = inner_env(env)
    if inner is None:
        raise TypeError(f"`env` must be an environment of spoofgym, wrapped or not, got {env!r}")
    normalization = _normalization_around(model, env)
    low, high = inner.core.bounds
    judges = hasattr(inner.core, "duel")
    if judges and amplitude != 1.0:
        raise ValueError(f"a detector has no commands to scale: `amplitude` = {amplitude:g}")
    own = [] if judges else own_columns(inner.core.observer.names)
    actor = Actor(model, normalization or normalization_of(model), amplitude, len(low), own)
    with evaluating(actor):
        _check_sizes(actor, len(low), len(inner.core.action_names))
        content = traced(actor, len(low))
    details = {**_training_of(model), "amplitude": amplitude, **(training or {})}
    if judges:
        return _write_detector(model, normalization, inner, path, content, details)
    card = _card_of(inner, path, content, details, designed_on)
    with trial_of(path) as trial:
        _write(trial, content, card)
        _compare(model, normalization, OnnxPolicy(str(trial)).model.act, low, high, amplitude, own)
    _write(path, content, card)
    return card


def _check_sizes(actor: torch.nn.Module, observed: int, commanded: int) -> None:
    """Raise unless a network takes the observations of an environment and returns its actions."""
    try:
        with torch.no_grad():
            found = actor(torch.zeros(2, observed))
    except RuntimeError as error:
        first = str(error).strip().partition("\n")[0]
        raise ValueError(f"the model can't be run with {observed} observations: {first}") from error
    if tuple(found.shape) != (2, commanded):
        raise ValueError(
            f"the model must return actions of shape (B, {commanded}), got {tuple(found.shape)} "
            "for 2 observations"
        )


def _training_of(model: Any) -> dict[str, Any]:
    details: dict[str, Any] = {"algorithm": type(model).__name__}
    for key, name in (("steps", "num_timesteps"), ("seed", "seed")):
        value = getattr(model, name, None)
        if isinstance(value, int | np.integer):
            details[key] = int(value)
    return details


def _card_of(
    inner: Any, path: Path, content: bytes, training: Mapping[str, Any], designed_on: str | None
) -> Card:
    core = inner.core
    if core.settings["observation"] is not None:
        raise ValueError(
            "a spoofer in a file observes what its `knowledge` gives; the environment has an "
            f"`observation` of its own: {core.settings['observation']!r}"
        )
    env_id, env_kwargs = _named(inner)
    context = spoofer_context(core.setup, 1, core.observer, core.commands)
    met = designed_on or f"{_label(env_kwargs)} and its world, by training"
    with one_line(f"card of {path}"):
        return Card(
            name=path.stem,
            kind="onnx-policy",
            env_id=env_id,
            env_kwargs=env_kwargs,
            **fields_of(context),
            knowledge=Knowledge(run_time=core.settings["knowledge"], design_time=met),
            training=dict(training),
            versions=versions() | library_versions(),
            file=file_of(path.name, content),
        )


def _named(inner: Any) -> tuple[str, dict[str, Any]]:
    """Id and settings of an environment, JSON-able."""
    env_id, given = getattr(inner, "env_id", None), getattr(inner, "env_kwargs", None)
    if env_id is None:
        spec = getattr(inner, "spec", None)
        if spec is None:
            raise ValueError("`env` must be made by `gymnasium.make`, `make_vec` or `SpoofVecEnv`")
        env_id, given = spec.id, spec.kwargs
        if env_id.startswith("spoofgym/Bench"):
            env_id = "spoofgym/TightlyCoupled-v0"
    own = {name: value for name, value in dict(given or {}).items() if value is not None}
    own = {name: value for name, value in own.items() if name not in OF_THE_CALL}
    try:
        return env_id, json.loads(json.dumps({k: describe(x) for k, x in own.items()}))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"the settings of the environment can't be written into a card ({error}): give its "
            "parts by name and settings"
        ) from error


def _label(env_kwargs: Mapping[str, Any]) -> str:
    """Short name of the detector that was met."""
    met = env_kwargs.get("detector", "the default detector")
    return str(met["name"]) if isinstance(met, Mapping) else str(met)


def _normalization_around(model: Any, env: Any) -> Normalization | None:
    """That of a `VecNormalize` around an environment, which a model does not have itself."""
    while env is not None and not getattr(env, "norm_obs", False):
        env = getattr(env, "venv", None)
    found, own = Normalization.of(env), normalization_of(model)
    if found is None or own is None:
        return found
    same = np.array_equal(own.mean, found.mean) and np.array_equal(own.scale, found.scale)
    if not (same and own.clip == found.clip):
        raise ValueError(
            "`env` normalizes observations otherwise than the model's own environment: leave `env` "
            "out, or give the one that it has learned in"
        )
    return None


def _write_detector(
    model: Any,
    normalization: Normalization | None,
    inner: Any,
    path: Path,
    content: bytes,
    training: dict[str, Any],
) -> Any:
    """Write a detector policy, once a trial of it acts as the model does."""
    low, high = inner.core.bounds
    with trial_of(path) as trial:
        trial.write_bytes(content)
        write_card(trial, inner, name=path.stem, training=training)
        _compare(model, normalization, OnnxDetector(trial).model.act, low, high, 1.0, [])
    write_file(path, content)
    card_path(path).unlink(missing_ok=True)
    return write_card(path, inner, name=path.stem, training=training)


def _compare(
    model: Any,
    normalization: Normalization | None,
    act: Any,
    low: Any,
    high: Any,
    amplitude: float,
    own: list[int],
) -> None:
    """Raise unless a file acts as its model, all over the space of its card."""
    drawn = np.random.default_rng(0).uniform(low, high, (TRIED, len(low)))
    seen = np.vstack([drawn, 0.1 * drawn]).astype(np.float32)
    planned = seen.copy()
    planned[:, own] /= np.float32(amplitude)
    planned = planned if normalization is None else normalization(planned)
    wanted = np.clip(np.asarray(function_of(model)(planned), dtype=np.float64), -1.0, 1.0)
    wanted = np.clip(amplitude * wanted, -1.0, 1.0)
    apart = float(np.abs(act(seen) - wanted).max())
    allowed = TOLERANCE * max(amplitude, 1.0)
    if not apart <= allowed:
        raise ValueError(
            f"the exported file differs from the model by {apart:.2g}, more than {allowed:.2g}; "
            "does it draw random numbers, or depend on the batch?"
        )


def _write(path: Path, content: bytes, card: Card) -> None:
    """File first: what is interrupted in between does not fit its card, and is refused."""
    write_file(path, content)
    card.save(path.with_suffix(".json"))
