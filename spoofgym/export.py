"""Torch or SB3 model to ONNX and card.

From a model to an ONNX file with its card.

>>> import spoofgym.export
>>> card = spoofgym.export.onnx(model, env, "mine.onnx")  # doctest: +SKIP

The file is self-contained and is run by onnxruntime, on any machine and by any detector's side: the
deterministic action, with the normalization of observations folded in, and nothing of the value
function.  It is compared with the model before it is written.  This package is the one that needs
torch; install it with the extra ``train``.
"""

from __future__ import annotations

import logging
import os
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from .core.extras import name_extra

try:
    import torch
except ImportError as error:
    raise name_extra("spoofgym.export", error) from error

from .bench.experiments.identity import versions
from .core.declared import check_number
from .core.files import write_file
from .core.registry import check_choice
from .detectors.learned import DetectorAgent, action_names, detector_card
from .detectors.observation import DetectorObserver
from .duel.learner import describe_environment
from .duel.views import write_card
from .envs.context import spoofer_context
from .policies import card as cards
from .policies.contract import NotFinite
from .policies.load import OnnxDetector, card_path
from .policies.onnx_file import NEXT, checked_path, describe_file
from .policies.trial import trust
from .simulation.setup import SPLITS
from .spoofers.learned import (
    Normalization,
    OnnxPolicy,
    get_normalization,
    inner_env,
    make_function,
    name_own_wrappers,
    refuse_changes,
    refuse_missing_statistics,
    refuse_state,
)
from .spoofers.residual import change_file
from .spoofers.scaled import own_columns

__all__ = ["detector", "onnx", "trace_module"]


def check_training(training: Any, name: str) -> None:
    if training is None:
        return
    if not isinstance(training, Mapping):
        raise ValueError(f"`training` must be a mapping, got {training!r}")
    for _, split in sorted(cards.parse_seeds(training, name)):
        check_choice("split", split, SPLITS)


def checked_states(state: Any) -> dict[str, int]:
    if state is None:
        return {}
    if not isinstance(state, Mapping):
        raise ValueError(f"`state` must be sizes by name, such as {{'hidden': 32}}, got {state!r}")
    for name, size in state.items():
        with one_line(f"state {name!r} of size {size!r}"):
            cards.State(name=name, size=size)
        if name in ("observation", "action"):  # the first input and output of a file
            raise ValueError(f"a state can't have the name {name!r}, which the file has already")
    return {str(name): int(size) for name, size in state.items()}


@contextmanager
def write_trial(path: Path) -> Iterator[Path]:
    """Path of a trial in a folder of its own; what is wrong with it is said of `path`."""
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / path.name
        try:
            yield trial
        except ValueError as error:
            if folder not in str(error):
                raise
            kind = NotFinite if isinstance(error, NotFinite) else ValueError
            raise kind(str(error).replace(folder, str(path.parent))) from error


@contextmanager
def one_line(what: str) -> Iterator[None]:
    try:
        yield
    except ValidationError as error:
        raise ValueError(f"{what}: {cards.format_error(error)}") from error


GAUSSIANS = (
    "DiagGaussianDistribution",
    "SquashedDiagGaussianDistribution",
    "StateDependentNoiseDistribution",
)
"""Distributions of stable-baselines3 whose mean is the deterministic action."""


class Actor(torch.nn.Module):
    """Deterministic action of a model, of observations that nothing has normalized, scaled as
    `Scaled` does it; `own`: elements of the `size` that are the spoofer's own commands."""

    def __init__(
        self, model: Any, found: Normalization | None, amplitude: float, size: int, own: list[int]
    ) -> None:
        super().__init__()
        self.mean = _extract_mean(model)
        self.clip = None if found is None else found.clip
        if found is not None:
            # in single precision the difference comes first, as in the model's own
            self.register_buffer("center", torch.as_tensor(found.mean, dtype=torch.float64))
            self.register_buffer("scale", torch.as_tensor(found.scale, dtype=torch.float64))
        self.amplitude = float(amplitude)
        divisor = torch.ones(size)
        divisor[own] = self.amplitude
        self.register_buffer("divisor", divisor)

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        seen = observation / self.get_buffer("divisor")
        if self.clip is not None:
            apart = seen.double() - self.get_buffer("center")
            seen = torch.clamp(apart / self.get_buffer("scale"), -self.clip, self.clip).float()
        action = torch.clamp(self.mean(seen), -1.0, 1.0)
        return torch.clamp(action * self.amplitude, -1.0, 1.0)


class _ActorCritic(torch.nn.Module):
    """Mean action of PPO and A2C."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy, self.squashed = policy, bool(policy.squash_output)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        features = self.policy.extract_features(seen, self.policy.pi_features_extractor)
        mean = self.policy.action_net(self.policy.mlp_extractor.forward_actor(features))
        return torch.tanh(mean) if self.squashed else mean


class _Squashed(torch.nn.Module):
    """Mean action of SAC."""

    def __init__(self, actor: Any) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        features = self.actor.extract_features(seen, self.actor.features_extractor)
        return torch.tanh(self.actor.mu(self.actor.latent_pi(features)))


def _extract_mean(model: Any) -> torch.nn.Module:
    policy = getattr(model, "policy", model)
    refuse_state(policy)
    if hasattr(policy, "mlp_extractor") and hasattr(policy, "action_net"):
        kind = type(getattr(policy, "action_dist", None)).__name__
        if kind not in GAUSSIANS:
            raise TypeError(
                "only a policy with a Gaussian action can be exported, got "
                f"{type(policy).__name__} with {kind}"
            )
        return _ActorCritic(policy)
    actor = getattr(policy, "actor", None)
    if isinstance(actor, torch.nn.Module):
        return _Squashed(actor) if hasattr(actor, "latent_pi") else actor
    if isinstance(policy, torch.nn.Module):
        return policy
    raise TypeError(
        "a model of stable-baselines3, its policy or a torch module can be exported, got "
        f"{type(model).__name__}"
    )


TOLERANCE = 1e-5  # largest difference of an action between the model and its file
TRIED = 1024  # random observations on which they are compared


@contextmanager
def evaluating(module: torch.nn.Module) -> Iterator[None]:
    """Put a module into its mode of evaluation, and its parts into their own modes again."""
    modes = {part: part.training for part in module.modules()}
    module.train(False)
    try:
        yield
    finally:
        for part, training_mode in modes.items():
            part.training = training_mode


def trace_module(
    module: torch.nn.Module, size: int, state: Mapping[str, int] | None = None
) -> bytes:
    """ONNX file of a module of (B, o) observations, of any batch; its weights are its own.

    Parameters
    ----------
    module : torch.nn.Module
        In the mode in which it is to be traced.
    size : int
        o.
    state : mapping, optional
        Size of each state by name, which the module takes and returns after the rest.

    Returns
    -------
    bytes
        Without external data, and without a word of this machine.
    """
    states = dict(state or {})
    batch = {0: torch.export.Dim("batch")}
    example = (torch.zeros(2, size), *(torch.zeros(2, length) for length in states.values()))
    log = logging.getLogger("torch.onnx")
    level = log.level
    log.setLevel(logging.ERROR)  # it misses torchvision
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch about torch
            program = torch.onnx.export(
                module,
                example,
                dynamo=True,
                verbose=False,
                optimize=False,  # which would fold weights away; onnxruntime optimises by itself
                input_names=["observation", *states],
                output_names=["action", *(f"{NEXT}{name}" for name in states)],
                dynamic_shapes=(batch, tuple(batch for _ in states)) if states else (batch,),
            )
    except ModuleNotFoundError as error:  # onnxscript
        raise name_extra("spoofgym.export", error) from error
    except (torch.onnx.errors.OnnxExporterError, RuntimeError) as error:
        first = str(error).strip().partition("\n")[0]
        raise ValueError(f"torch can't export this network: {first}") from error
    finally:
        log.setLevel(level)
    model: Any = program.model_proto  # as `dynamo` returns it
    graph = model.graph
    # the remarks of the exporter hold paths of this machine
    for part in (model, graph, *graph.node, *graph.input, *graph.output, *graph.initializer):
        part.ClearField("doc_string")
        part.ClearField("metadata_props")
    graph.ClearField("value_info")
    content = bytes(model.SerializeToString(deterministic=True))
    trust(content)
    return content


def library_versions() -> dict[str, str]:
    found = {}
    for name in ("torch", "stable-baselines3", "onnx"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


EPOCHS = 4  # epochs in a row on which a recurrent one is compared
CHANNELS = 12  # slots of a receiver by default


def detector(
    module: Any,
    path: str | Path,
    *,
    name: str | None = None,
    terms: Any = None,
    state: Mapping[str, int] | None = None,
    statistic: str = "receiver",
    weighs: bool = False,
    exclusion_s: float | None = None,
    quiet_epochs: int = 0,
    channels: int = CHANNELS,
    interval_s: float = 0.5,
    threshold: float | None = None,
    training: Mapping[str, Any] | None = None,
) -> cards.DetectorCard:
    """Write a learned detector and its card, from a torch module with or without a state.

    Parameters
    ----------
    module : torch.nn.Module
        Of (B, o) observations, and (B, s) of each state in its order.  It returns (B, a) actions,
        which are cut to [-1, 1], and with states a tuple of actions and the next states.  The
        statistic is (a + 1) / 2, of the receiver or of every slot; with `weighs` the weights of the
        slots follow.
    path : str or Path
        ``.../NAME.onnx``; the card becomes ``.../NAME.json``.
    name : str, optional
        Of the detector; by default that of the file.
    terms : sequence, optional
        What it observes, in this order, as `make_detector_terms` takes it; by default what an agent
        of the duel does.
    state : mapping, optional
        Size of each state by name, such as ``{"hidden": 32}``; 0 at the start of an episode.
    statistic : {"receiver", "channel"}
        One statistic, or one for every slot.
    weighs : bool
        Whether it weighs satellites in the filter; by default it is passive.
    exclusion_s : float, optional
        Allowance of exclusion in an episode [s]; none by default.
    quiet_epochs : int
        Epochs after it is switched on in which it is not called.
    channels : int
        Slots of the receiver.
    interval_s : float
        Time between epochs that it was trained on [s].
    threshold : float, optional
        Of the statistic, in (0, 1]; by default none, and worlds look theirs up by a rate of false
        alarms, which ``spoofgym calibrate --detector NAME.onnx`` finds.
    training : mapping, optional
        How it was made, JSON-able; ``"decided_on"`` as in `onnx`.

    Returns
    -------
    DetectorCard
        As it was written.

    Raises
    ------
    TypeError
        When `module` is no torch module.
    ValueError
        When it does not take or return what it should, or the file does not act as the module
        does; nothing is written then.
    """
    path = checked_path(path)
    if not isinstance(module, torch.nn.Module):
        raise TypeError(f"`module` must be a torch module, got {type(module).__name__}")
    states = checked_states(state)
    check_training(training, path.stem)
    agent = DetectorAgent(statistic, weighs, exclusion_s, terms=terms)
    observer = DetectorObserver(agent.observed_terms, channels)
    size = len(observer.names)
    judge = _Judge(module)
    with evaluating(judge):
        _check_sizes(judge, size, len(action_names(statistic, weighs, channels)), states)
        content = trace_module(judge, size, states)
        with write_trial(path) as trial:
            trial.write_bytes(content)
            with one_line(f"card of {path}"):
                card = detector_card(
                    agent,
                    channels,
                    trial,
                    name=path.stem if name is None else name,
                    interval_s=interval_s,
                    quiet_epochs=quiet_epochs,
                    state=states,
                    threshold=threshold,
                    training={"versions": library_versions(), **(training or {})},
                )
            _write(trial, content, card)
            _compare_sequences(judge, OnnxDetector(trial), observer)
    _write(path, content, card)
    return card


class _Judge(torch.nn.Module):
    """A module whose actions are cut, with its states side by side."""

    def __init__(self, module: torch.nn.Module) -> None:
        super().__init__()
        self.module = module

    def forward(self, observation: torch.Tensor, *states: torch.Tensor) -> Any:
        if not states:
            return torch.clamp(self.module(observation), -1.0, 1.0)
        action, *after = self.module(observation, *states)
        return (torch.clamp(action, -1.0, 1.0), *after)


def _check_sizes(
    module: torch.nn.Module, observed: int, decided: int, states: Mapping[str, int]
) -> None:
    """Run a module once, and compare what it returns with what is wanted of it."""
    given = [torch.zeros(2, size) for size in (observed, *states.values())]
    form = ", ".join(f"(B, {size})" for size in (observed, *states.values()))
    wanted = ", ".join(f"(B, {size})" for size in (decided, *states.values()))
    try:
        with torch.no_grad():
            found = module(*given)
    except (RuntimeError, TypeError, ValueError) as error:
        first = str(error).strip().partition("\n")[0]
        raise ValueError(
            f"the module can't be run with {form}, to return {wanted}: {first}"
        ) from error
    parts = list(found) if states else [found]
    shapes = [tuple(getattr(part, "shape", ())) for part in parts]
    if shapes != [(2, size) for size in (decided, *states.values())]:
        raise ValueError(
            f"the module must return {wanted} for action and states, got "
            f"{', '.join(map(str, shapes))} for a batch of 2"
        )


def _compare_sequences(judge: _Judge, policy: OnnxDetector, observer: DetectorObserver) -> None:
    rng = np.random.default_rng(0)
    states = [np.zeros((TRIED, each.size), np.float32) for each in policy.card.state]
    for k in range(EPOCHS):
        drawn = rng.uniform(observer.low, observer.high, (TRIED, len(observer.low)))
        seen = ((0.1 if k % 2 else 1.0) * drawn).astype(np.float32)
        with torch.no_grad():
            found = judge(*(torch.from_numpy(array) for array in (seen, *states)))
        wanted = [part.numpy() for part in (found if states else (found,))]
        action, states = policy.model.step(seen, states)
        for what, mine, theirs in zip(
            ("action", *(each.name for each in policy.card.state)),
            (action, *states),
            wanted,
            strict=True,
        ):
            apart = float((np.abs(mine - theirs) / np.maximum(np.abs(theirs), 1.0)).max())
            if not apart <= TOLERANCE:
                raise ValueError(
                    f"the exported file differs from the module by {apart:.2g} in {what}, more "
                    f"than {TOLERANCE:g}; does it draw random numbers, depend on the batch, or let "
                    "rounding grow, as weights of too large a learning rate do?"
                )


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
    SpooferCard or DetectorCard
        As it was written, the latter where a detector learned (``side="detector"``).

    Raises
    ------
    TypeError
        When the model is something else, or its policy has no deterministic action of a network.
    ValueError
        When it is recurrent, lacks the statistics that it has learned with, its environment can't
        be written down, or normalizes otherwise than the model's own, or the file does not act as
        the model does; nothing is written then.
    """
    path = checked_path(path)
    check_training(training, path.stem)
    check_number("amplitude", amplitude, above=0.0)
    env = model.get_env() if env is None and hasattr(model, "get_env") else env
    inner = inner_env(env)
    if inner is None:
        raise TypeError(
            f"`env` must be an environment of spoofgym, wrapped or not, in this process, got "
            f"{env!r}; for one in another process (SubprocVecEnv), give one with the same settings"
        )
    refuse_changes(env, "this policy", normalized=True)
    normalization = _normalization_around(model, env)
    if normalization is None:
        refuse_missing_statistics(model)
    low, high = inner.core.bounds
    judges = hasattr(inner.core, "duel")
    if judges and amplitude != 1.0:
        raise ValueError(f"a detector has no commands to scale: `amplitude` = {amplitude:g}")
    if amplitude != 1.0 and inner.core.commands.base is not None:
        raise ValueError(
            f"`amplitude` = {amplitude:g} would scale the correction alone: give the base of "
            "the environment its `amplitude`, and let the policy learn with that"
        )
    own = [] if judges else own_columns(inner.core.observer.names)
    actor = Actor(model, normalization or get_normalization(model), amplitude, len(low), own)
    with evaluating(actor):
        _check_sizes(actor, len(low), len(inner.core.action_names), {})
        content = trace_module(actor, len(low))
    details = {**_describe_training(model), "amplitude": amplitude, **(training or {})}
    with write_trial(path) as trial:
        card: cards.Card
        if judges:
            trial.write_bytes(content)
            card = write_card(trial, inner, name=path.stem, training=details)
            act = OnnxDetector(trial).model.act
        else:
            card = _make_card(inner, path, content, details, designed_on, name_own_wrappers(env))
            _write(trial, content, card)
            act = OnnxPolicy(str(trial)).model.act
        _compare(model, normalization, act, low, high, amplitude, own)
    _write(path, content, card)
    return card


def _describe_training(model: Any) -> dict[str, Any]:
    details: dict[str, Any] = {"algorithm": type(model).__name__}
    for key, name in (("steps", "num_timesteps"), ("seed", "seed")):
        value = getattr(model, name, None)
        if isinstance(value, int | np.integer):
            details[key] = int(value)
    return details


def _make_card(
    inner: Any,
    path: Path,
    content: bytes,
    training: Mapping[str, Any],
    designed_on: str | None,
    wrappers: Sequence[str],
) -> cards.SpooferCard:
    core = inner.core
    if core.settings["observation"] is not None:
        raise ValueError(
            "a spoofer in a file observes what its `knowledge` gives: train it without the "
            f"`observation` of this environment, {core.settings['observation']!r}"
        )
    env_id, env_kwargs = describe_environment(inner)
    if "action" in env_kwargs:  # a base is looked for beside the card
        env_kwargs["action"] = change_file(
            env_kwargs["action"],
            lambda file: os.path.relpath(file, path.parent) if Path(file).is_file() else file,
        )
    context = spoofer_context(core.setup, 1, core.observer, core.commands)
    detector = env_kwargs.get("detector", "the default detector")
    name = detector["name"] if isinstance(detector, Mapping) else detector
    own = f" in {', '.join(wrappers)}" if wrappers else ""
    met = designed_on or f"{name}{own} and its world, by training"
    if wrappers:
        training = {"wrappers": [*wrappers], **training}
    with one_line(f"card of {path}"):
        return cards.SpooferCard(
            name=path.stem,
            kind="onnx-policy",
            env_id=env_id,
            env_kwargs=env_kwargs,
            **cards.describe_context(context),
            knowledge=cards.Knowledge(run_time=core.settings["knowledge"], design_time=met),
            training=dict(training),
            versions=versions() | library_versions(),
            file=describe_file(path.name, content),
        )


def _normalization_around(model: Any, env: Any) -> Normalization | None:
    """That of a `VecNormalize` around an environment, which a model does not have itself."""
    while env is not None and not getattr(env, "norm_obs", False):
        env = getattr(env, "venv", None)
    found, own = Normalization.of(env), get_normalization(model)
    if found is None or own is None:
        return found
    same = np.array_equal(own.mean, found.mean) and np.array_equal(own.scale, found.scale)
    if not (same and own.clip == found.clip):
        raise ValueError(
            "`env` normalizes observations differently from the model's own environment: leave "
            "`env` out, or give the one that it was trained in"
        )
    return None


def _compare(
    model: Any,
    normalization: Normalization | None,
    act: Any,
    low: Any,
    high: Any,
    amplitude: float,
    own: list[int],
) -> None:
    drawn = np.random.default_rng(0).uniform(low, high, (TRIED, len(low)))
    seen = np.vstack([drawn, 0.1 * drawn]).astype(np.float32)
    planned = seen.copy()
    planned[:, own] /= np.float32(amplitude)
    planned = planned if normalization is None else normalization(planned)
    wanted = np.clip(np.asarray(make_function(model)(planned), dtype=np.float64), -1.0, 1.0)
    wanted = np.clip(amplitude * wanted, -1.0, 1.0)
    apart = float(np.abs(act(seen) - wanted).max())
    allowed = TOLERANCE * max(amplitude, 1.0)
    if not apart <= allowed:
        raise ValueError(
            f"the exported file differs from the model by {apart:.2g}, more than {allowed:.2g}; "
            "does it draw random numbers, or depend on the batch?"
        )


def _write(path: Path, content: bytes, card: cards.Card) -> None:
    """File first: what is interrupted in between does not fit its card, and is refused."""
    write_file(path, content)
    card.save(card_path(path))
