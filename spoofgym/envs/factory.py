"""From an environment's settings to its core, and another detector or more terms before a reset."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Collection, Mapping
from typing import Any, TypeVar

import gymnasium as gym

from ..core.registry import check_choice, check_keywords
from ..detectors import detector_in_world
from ..detectors.build import DetectorSpec
from ..simulation.loose import LooselyCoupledSetup
from ..simulation.robot import WheeledRobotSetup
from ..simulation.setup import Setup
from ..simulation.snapshot import SnapshotSetup
from ..simulation.tight import TightlyCoupledSetup
from .core import EpochSpec, SpoofCore, WatchSpec, make_watch, merge_epoch_specs
from .terms import EndSpec, describe_terms, make_terms
from .terms.action import Residual
from .terms.termination import AtAlarm

S = TypeVar("S", bound=Setup)
DEFAULT_VICTIM = "tightly-coupled"
DEFAULT_ID = "spoofgym/TightlyCoupled-v0"
"""Environment where none is named."""
NEVER = "never"
"""Detector of an environment that gets its own by a wrapper."""
VICTIMS: dict[str, type[Setup]] = {
    DEFAULT_VICTIM: TightlyCoupledSetup,
    "loosely-coupled": LooselyCoupledSetup,
    "snapshot": SnapshotSetup,
    "wheeled-robot": WheeledRobotSetup,
}
"""Kinds of victims by name."""
PASTS, POOLED_FROM_S = 256, 300.0
"""Pasts that episodes share by default where receivers may be older than this at the onset [s]."""
_OWN = ("self", "receivers", "setup", "threads", "prefetch")
CORE = {
    name: parameter.replace(kind=parameter.KEYWORD_ONLY)
    for name, parameter in inspect.signature(SpoofCore.__init__).parameters.items()
    if name not in _OWN
}
"""Settings of an environment that are no settings of its victim."""


def select_victim(name: str) -> type[Setup]:
    check_choice("victim", name, VICTIMS)
    return VICTIMS[name]


def choose_env_id(given: Collection[str]) -> str:
    """Environment where none is named: the default one, or where a scenario is among the settings
    that are given the one of the victim's defaults."""
    return TightlyCoupledSetup.env_id if "scenario" in given else DEFAULT_ID


def find_environment(env_id: str) -> tuple[type[Setup], dict[str, Any]]:
    """Victim and settings of a registered environment of a spoofer against one detector."""
    plain = gym.spec(DEFAULT_ID).entry_point
    known = {name: spec for name, spec in gym.registry.items() if spec.entry_point == plain}
    check_choice("environment", env_id, known)
    settings = copy.deepcopy(dict(known[env_id].kwargs))
    return select_victim(settings.pop("victim", DEFAULT_VICTIM)), settings


def list_parameters(setup_type: type[Setup]) -> dict[str, inspect.Parameter]:
    own = inspect.signature(setup_type).parameters
    return {**own, **CORE}


def expand_signature(env: type[Any]) -> inspect.Signature:
    """Arguments of an environment's class, with all settings in place of ``**settings``."""
    own = inspect.signature(env.__init__)
    named = [p for p in own.parameters.values() if p.kind is not p.VAR_KEYWORD and p.name != "self"]
    every = list_parameters(VICTIMS[DEFAULT_VICTIM])
    return own.replace(parameters=[*named, *every.values()])


def make_setup(setup_type: type[S], settings: Mapping[str, Any]) -> S:
    """Setup from those settings that are the victim's; None means its default."""
    own = inspect.signature(setup_type).parameters
    chosen = {name: settings[name] for name in own if settings.get(name) is not None}
    setup = setup_type(**chosen)
    setup.raw_settings = chosen
    return setup


def make_core(
    setup_type: type[Setup],
    receivers: int,
    settings: Mapping[str, Any],
    *,
    threads: int | None = None,
    prefetch: bool = False,
    whose: str = "the environment",
) -> SpoofCore:
    """Core from settings that fit into JSON; an unknown one is a TypeError with the valid ones."""
    check_keywords(whose, settings, list_parameters(setup_type))
    setup = make_setup(setup_type, settings)
    chosen = {name: settings[name] for name in CORE if settings.get(name) is not None}
    chosen["warm_pool"] = _count_pasts(setup, settings.get("warm_pool"))
    return SpoofCore(receivers, setup, threads=threads, prefetch=prefetch, **chosen)


def _count_pasts(setup: Setup, given: int | None) -> int | None:
    """How many pasts the episodes of an environment share; None where each has its own."""
    if given is None:
        drawn = setup.domain.age_s is not None
        return PASTS if drawn and setup.onset * setup.interval_s > POOLED_FROM_S else None
    return given or None


def compose(
    env: Any,
    *,
    detector: DetectorSpec | None = None,
    false_alarms_per_hour: float | None = None,
    watch: WatchSpec = (),
    end: EndSpec = (),
    epoch: EpochSpec = False,
    base: Any = None,
    scale: float | None = None,
) -> None:
    """Set the detector, at a rate of false alarms, add passive detectors, end terms and fields of
    logged epochs, or a base that actions correct, of an environment not reset yet. A detector that
    its id brings is replaced, and so is ``"never"``."""
    inner = composable(env)
    if inner.is_started:
        raise RuntimeError("an episode has started: compose the environment before reset()")
    changes: dict[str, Any] = {}
    before: SpoofCore = inner.core
    setup = before.setup
    if detector is not None:
        if not brings_detector(inner):
            raise ValueError(
                f"two detectors are set at once: {inner.detector_setting!r} and {detector!r}; "
                "only one can be in the loop; give others by `watch`"
            )
        setup = setup.copy_with(detector=detector_in_world(detector, false_alarms_per_hour))
    if watch:
        changes["watch"] = (*before.settings["watch"], *make_watch(watch))
    if end:
        present = before.settings["end"]
        if present is None:
            present = (AtAlarm(),) if before.end_at_alarm else ()
        changes["end"] = (*present, *make_terms("end", end))
    if epoch is not False:
        changes["epoch"] = merge_epoch_specs(before.settings["epoch"], epoch, setup)
    if base is not None:
        present = before.settings["action"]
        own = None if present is None else describe_terms("action", present)
        changes["action"] = Residual(base, scale, own)
    core = before.copy_with(setup, **changes)
    core.listeners = before.listeners
    inner.adopt(core)
    before.close()
    if detector is not None:
        inner.detector_setting, inner.wrapped = detector, True


def brings_detector(inner: Any) -> bool:
    """Whether the detector of an environment is its id's, or ``"never"``, and no argument or
    wrapper has set another one."""
    present = inner.detector_setting
    if present is None or inner.wrapped:
        return present is None
    spec = getattr(inner, "spec", None)
    known = None if spec is None else gym.registry.get(spec.id)
    brought = None if known is None else known.kwargs.get("detector")
    return present in (NEVER, {"name": NEVER}) or bool(present == brought)


def composable(env: Any, *, unset: bool = True) -> Any:
    """Environment of the spoofer's side inside all wrappers; a TypeError without one.
    `unset`: only one whose detector can be set: not a view of the duel, which has a pool of
    them."""
    inner = getattr(env, "unwrapped", env)
    is_ours = isinstance(getattr(inner, "core", None), SpoofCore)
    if not is_ours or (unset and not hasattr(inner, "detector_setting")):
        raise TypeError(
            f"`env` must be a SpoofEnv, a SpoofVectorEnv or a SpoofVecEnv, wrapped or not, got "
            f"{env!r}; `gymnasium.make_vec` makes one by its default vectorization mode"
        )
    return inner
