"""Spoofer from a file or a model in memory."""

from __future__ import annotations

import os
import sys
import warnings
from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..core.registry import check_choice
from ..policies.card import SPOOFER, Space, SpooferCard, diff_spaces
from ..policies.contract import NotFinite, clip_action
from ..policies.load import load_policy
from ..policies.zoo import resolve_path
from .base import KNOWLEDGE, FloatArray, Spoofer, SpooferContext
from .residual import BoundBase, change_file


class LearnedSpoofer(Spoofer):
    """A policy without memory, added to the base attack of its context, if there is one."""

    _base: BoundBase | None = None

    def bind(self, context: SpooferContext) -> None:
        super().bind(context)
        self._base = None if context.base is None else context.base.bind(context)
        if self._base is not None:
            self.memory = self._base.spoofer.memory

    def reset(self, mask: NDArray[np.bool_] | None = None) -> None:
        super().reset(mask)
        if self._base is not None:
            self._base.spoofer.reset(mask)

    def act(self, observation: NDArray[np.float32]) -> FloatArray:
        """Command the coming epoch: (B, a) in [-1, 1]."""
        if np.ndim(observation) != 2:
            raise ValueError(
                f"observations must be (B, o), not {np.shape(observation)}: a single environment "
                "plays act(observation[None])[0]"
            )
        given = self._decide(observation)
        return given if self._base is None else self._base.add(observation, given)

    @abstractmethod
    def _decide(self, observation: NDArray[np.float32]) -> FloatArray:
        """What the policy itself says: (B, a) in [-1, 1]."""


@settings_record
class OnnxPolicy(LearnedSpoofer):
    """Acts as a network in an ONNX file does; the card of the same name is in the same folder.

    Attributes
    ----------
    card : SpooferCard
        What it fits, what it knows, how it was made.
    knowledge, label, designed_on, decision_interval_s, between : optional
        Of the card.
    """

    file: str = setting(help="Name of a shipped one, or path of an ``.onnx`` file.")
    sha256: str | None = setting(
        default=None, help="Digest that the file must have; by default the card's."
    )

    knowledge = "of its card"

    def __post_init__(self) -> None:
        self.file = os.fspath(self.file)
        self.card, self.model = load_policy(self.file, SpooferCard, self.sha256)
        card = self.card
        self.sha256 = self.model.sha256
        self.knowledge = card.knowledge.run_time
        self.designed_on = card.knowledge.design_time
        self.label = card.name
        folder = resolve_path(self.file, SPOOFER).parent
        self.action_terms = change_file(
            card.env_kwargs.get("action"),
            lambda file: os.fspath(folder / file) if (folder / file).is_file() else file,
        )
        self.decision_interval_s = card.env_kwargs.get("decision_interval_s")
        self.between = card.env_kwargs.get("between", "hold")

    def bind(self, context: SpooferContext) -> None:
        found = self.card.diff_context(context)
        if found:
            raise ValueError(f"{self.file} does not fit this attack: {'; '.join(found)}")
        super().bind(context)

    def _decide(self, observation: NDArray[np.float32]) -> FloatArray:
        return self.model.act(observation)


Function = Callable[[NDArray[np.float32]], Any]  # (B, o) observations in, (B, a) actions out
FORMS = (
    "a model of stable-baselines3, a torch module, a function of (B, o) observations that returns "
    "(B, a) actions, a Spoofer, its name, or the path of an .onnx file"
)


class ModelPolicy(LearnedSpoofer):
    """A spoofer that takes the deterministic action of a model.

    The model is neither copied nor changed, except that a network is put in evaluation mode.
    Settings are as in `Spoofer`; with `observation`, the space that the model was trained on, any
    other space is refused.
    """

    def __init__(
        self,
        model: Any,
        *,
        knowledge: str = "blind",
        action: Any = None,
        observation: Space | None = None,
        decision_interval_s: float | None = None,
        between: str = "hold",
        label: str | None = None,
    ) -> None:
        check_choice("knowledge", knowledge, KNOWLEDGE)
        self.model, self.knowledge, self.action_terms = model, knowledge, action
        self.observation = observation
        self.decision_interval_s, self.between = decision_interval_s, between
        self.label = label or get_model_name(model)
        self._function = make_function(model)

    def bind(self, context: SpooferContext) -> None:
        if self.observation is not None:
            size = len(context.action_names)
            same = Space(names=context.action_names, low=(-1.0,) * size, high=(1.0,) * size)
            found = diff_spaces(self.observation, same, context)
            if found:
                lines = "; ".join(found).replace("on the card", "where it was trained")
                raise ValueError(f"{self.label} does not fit this attack: {lines}")
        super().bind(context)

    def _decide(self, observation: NDArray[np.float32]) -> FloatArray:
        names = self.context.action_names
        given = self._function(observation), len(observation), len(names)
        return clip_action(*given, str(self.label), names)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        twin.__dict__.pop("context", None)
        twin.__dict__.pop("memory", None)
        twin.__dict__.pop("_base", None)
        return twin


def get_model_name(model: Any) -> str:
    return str(getattr(model, "__name__", None) or type(model).__name__)


def make_function(model: Any) -> Function:
    """Function of observations behind a model. `model`: of stable-baselines3, with the
    `VecNormalize` that it was trained in folded in; with ``predict``, as libraries have it; a torch
    module; or a function. A TypeError says what else it is."""
    policy = getattr(model, "policy", None)
    if policy is not None and hasattr(policy, "obs_to_tensor"):
        return _of_stable_baselines(model, policy)
    if hasattr(model, "obs_to_tensor"):
        return _of_stable_baselines(None, model)
    if hasattr(model, "predict"):
        return lambda seen: model.predict(seen, deterministic=True)[0]
    torch: Any = sys.modules.get("torch")
    if torch is not None and isinstance(model, torch.nn.Module):
        return _of_module(torch, model)
    if not callable(model):
        raise TypeError(f"a policy must be {FORMS}, got {model!r}")
    return lambda seen: model(seen)


def refuse_state(policy: Any) -> None:
    if hasattr(policy, "lstm_actor"):
        raise ValueError(
            f"{type(policy).__name__} is recurrent: it needs its state from step to step, which "
            "neither `evaluate` nor an ONNX file of a spoofer keeps"
        )


def finite(policy: Any) -> bool:
    return all(bool(weight.isfinite().all()) for weight in policy.parameters())


class Normalization(NamedTuple):
    """What a `VecNormalize` does with observations: (o,) mean and scale, and where it clips."""

    mean: FloatArray
    scale: FloatArray
    clip: float

    @classmethod
    def of(cls, envs: Any) -> Self | None:
        """That of a `VecNormalize`, as it is now; None where it leaves observations alone."""
        if not getattr(envs, "norm_obs", False):
            return None
        mean = np.asarray(envs.obs_rms.mean, dtype=np.float64).copy()
        scale = np.sqrt(np.asarray(envs.obs_rms.var, dtype=np.float64) + envs.epsilon)
        return cls(mean, scale, float(envs.clip_obs))

    def __call__(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        scaled = (seen - self.mean) / self.scale
        return np.asarray(np.clip(scaled, -self.clip, self.clip), dtype=np.float32)


def get_normalization(model: Any) -> Normalization | None:
    found = model.get_vec_normalize_env() if hasattr(model, "get_vec_normalize_env") else None
    return Normalization.of(found)


def _of_stable_baselines(model: Any, policy: Any) -> Function:
    """Deterministic action of a policy, without what `predict` repeats at every call."""
    refuse_state(policy)
    torch: Any = sys.modules["torch"]
    space = policy.action_space
    if not all(np.allclose(getattr(space, x, np.nan), y) for x, y in (("low", -1), ("high", 1))):
        raise ValueError(f"actions must be a Box within -1 and 1, but the model's are {space}")

    def act(seen: NDArray[np.float32]) -> Any:
        wanted = policy.observation_space.shape
        if seen.shape[1:] != wanted:
            raise ValueError(
                f"the model observes {wanted[0]} elements, but there are {seen.shape[1]}: say what "
                "it knows by knowledge="
            )
        if policy.training:
            policy.set_training_mode(False)
        now = get_normalization(model)
        if now is not None:
            seen = now(seen)
        with torch.no_grad():
            given = torch.as_tensor(seen, device=policy.device)
            try:
                return policy._predict(given, deterministic=True).cpu().numpy()
            except ValueError as error:  # of a distribution whose mean is no number
                if finite(policy):
                    raise
                name = get_model_name(policy if model is None else model)
                raise NotFinite(f"{name} has weights that are not finite") from error

    return act


def _of_module(torch: Any, module: Any) -> Function:
    def act(seen: NDArray[np.float32]) -> Any:
        training = module.training
        if training:
            module.eval()
        try:
            with torch.no_grad():
                answer = module(torch.as_tensor(seen))
        except RuntimeError as error:
            first = str(error).strip().partition("\n")[0]
            raise ValueError(
                f"{get_model_name(module)} can't be run with {seen.shape[1]} observations: {first}"
            ) from error
        finally:
            if training:
                module.train()
        if not isinstance(answer, torch.Tensor):
            raise ValueError(
                f"{get_model_name(module)} must return actions, a tensor, got "
                f"{type(answer).__name__}; a network with a state needs a "
                "function or an ONNX file around it"
            )
        return answer.detach().cpu().numpy()

    return act


LIBRARIES = ("gymnasium", "stable_baselines3", "sb3_contrib", "spoofgym")
"""Packages whose wrappers are known."""
CHANGES = ("observation", "action")
"""What a wrapper may change of a policy."""


def inner_env(env: Any) -> Any:
    """Environment with a core inside all wrappers; None without one. Of several that run in
    this process side by side it is the first one."""
    while env is not None and getattr(env, "core", None) is None:
        several = getattr(env, "envs", None) or [None]
        env = getattr(env, "venv", None) or getattr(env, "env", None) or several[0]
    return env


def list_wrappers(env: Any) -> list[Any]:
    """Wrappers around an environment with a core, the outermost first; of several environments that
    run in this process side by side those of the first."""
    found = []
    while env is not None and "core" not in vars(env):
        own = vars(env)
        below = [own[name] for name in ("venv", "env") if own.get(name) is not None]
        found.append(env)
        env = (below or own.get("envs") or [None])[0]
    return found


def name_own_wrappers(env: Any) -> list[str]:
    """``"module:Class"`` of the wrappers of an environment that are the user's own."""
    kinds = [type(each) for each in list_wrappers(env)]
    return [
        f"{kind.__module__}:{kind.__qualname__}"
        for kind in kinds
        if kind.__module__.partition(".")[0] not in LIBRARIES
    ]


def refuse_changes(env: Any, whose: str, *, normalized: bool = False) -> None:
    """Raise where a wrapper changes what a policy observes or how it acts, since it plays without.
    `normalized`: whether a `VecNormalize` goes with the policy."""
    for each in list_wrappers(env):
        kind, own = type(each), vars(each)
        changed = [
            word for word in CHANGES if _changes(each, own.get("venv", own.get("env")), word)
        ]
        if getattr(each, "norm_obs", False) and kind.__name__ == "VecNormalize" and not normalized:
            changed.append("observation")
        if changed:
            raise ValueError(
                f"the wrapper {kind.__module__}:{kind.__qualname__} changes every {changed[0]}, "
                f"and {whose} is played without it: give an environment without this wrapper"
            )


def _changes(wrapper: Any, below: Any, word: str) -> bool:
    """Whether a wrapper has Gymnasium's method that changes an observation or an action, or another
    space of them than what is below."""
    if any(callable(getattr(type(wrapper), name, None)) for name in (word, f"{word}s")):
        return True
    single = f"single_{word}_space"
    name = single if hasattr(below, single) else f"{word}_space"
    return below is not None and getattr(wrapper, name, None) != getattr(below, name, None)


def refuse_missing_statistics(model: Any) -> None:
    """Raise where a model has learned behind a `VecNormalize` whose statistics it does not have.

    Stable-baselines3 saves neither; what is left is the last observation as it was before.
    """
    envs = model.get_vec_normalize_env() if hasattr(model, "get_vec_normalize_env") else None
    if envs is None and hasattr(model, "train_freq"):
        missing = False  # off-policy models keep such an observation whatever they learned behind
    elif envs is None:
        now, before = (getattr(model, f"_last_{name}", None) for name in ("obs", "original_obs"))
        missing = before is not None and not (now is not None and np.array_equal(now, before))
    else:
        learned = getattr(model, "num_timesteps", 0) > 0
        missing = learned and bool(envs.norm_obs) and envs.obs_rms.count < 1.0
    if missing:
        raise ValueError(
            f"this {type(model).__name__} was trained with a VecNormalize, whose statistics are "
            "missing: without them it observes other values than in training. Save them by "
            "`VecNormalize.save`, and load the model with env=VecNormalize.load(FILE, envs)"
        )


def read_training_env(model: Any) -> Mapping[str, Any]:
    """Arguments of `ModelPolicy` by a model's own environment; warns of a model of
    stable-baselines3 whose environment can't be read, refuses one without its `VecNormalize`."""
    if not hasattr(model, "get_env"):
        return {}
    env = model.get_env()
    found = describe_env(env)
    refuse_missing_statistics(model)
    if found:
        refuse_changes(env, f"this {type(model).__name__}", normalized=True)
    else:
        warnings.warn(
            f"this {type(model).__name__} has no environment that can be read, so that it is "
            "played without normalization, by the attack's own actions and at every decision of "
            "the world: load it with env=, or score the file that `spoofgym.export.onnx` writes",
            UserWarning,
            stacklevel=4,
        )
    return found


def describe_env(env: Any) -> Mapping[str, Any]:
    """Arguments of `ModelPolicy` by an environment with a core of the spoofer's side, in
    wrappers."""
    inner = inner_env(env)
    settings = None if inner is None else getattr(inner.core, "settings", None)
    if inner is None or settings is None:
        return {}
    core = inner.core
    low, high = core.bounds
    space = Space(names=core.observation_names, low=tuple(low.tolist()), high=tuple(high.tolist()))
    return {
        "knowledge": settings["knowledge"],
        "action": settings["action"],
        "observation": space,
        "decision_interval_s": core.setup.decision_interval_s,
        "between": core.setup.between,
    }
