"""Bringing a spoofer and an environment together, and saying where they do not fit."""

from __future__ import annotations

import dataclasses
import inspect
import warnings
from collections.abc import Iterable, Mapping
from numbers import Real
from typing import Any

from .._describe import describe, unlike
from ..simulators.setup import Setup
from ..simulators.tightly_coupled import TightlyCoupledSetup
from ..spoofers import (
    Card,
    ScriptedSpoofer,
    Spoofer,
    SpooferContext,
    card_of,
    make_spoofer,
    shipped,
)
from ..spoofers.aim import TARGET, has_heading
from .core import SpoofCore
from .factory import composable, make_setup, settings_of
from .observer import Observer
from .options import action_space, observation_space

ENV_ID = "spoofgym/TightlyCoupled-v0"
"""Environment that cards are compared with."""
SETUP = tuple(inspect.signature(TightlyCoupledSetup).parameters)
"""Settings that make the world, the victim, the attack, the detector and the decisions."""


def attach(
    spoofer: Spoofer | Mapping[str, Any] | str, env: Any, *, transfer: bool = False
) -> Spoofer:
    """Spoofer that is ready to command the receivers of an environment.

    One that has a card, a learned or a shipped one, is compared with the environment first.

    Parameters
    ----------
    spoofer : Spoofer, str or mapping
        What `make_spoofer` takes; an object is copied.
    env : SpoofEnv, SpoofVectorEnv or SpoofVecEnv
        Wrapped or not.
    transfer : bool
        Whether the spoofer may meet another scenario, receiver, detector or target than the one
        that it was made for.  Names and bounds of what it observes and commands, and the
        attack's limits, have to be the same in any case.

    Returns
    -------
    Spoofer
        Bound and reset; ``act`` takes (B, o) and returns (B, a), for a single environment too.

    Raises
    ------
    ValueError
        When the environment is not what the card says; lists all differences.
    TypeError
        When `env` is something else.

    Examples
    --------
    >>> import gymnasium as gym
    >>> from spoofgym.envs import attach
    >>> envs = gym.make_vec("spoofgym/TightlyCoupled-v0", num_envs=4)
    >>> observation, info = envs.reset(seed=1)
    >>> attach({"name": "ramp", "rate_mps": 0.2}, envs).act(observation).shape
    (4, 2)
    >>> envs.close()
    """
    made = make_spoofer(dict(spoofer) if isinstance(spoofer, Mapping) else spoofer)
    core: SpoofCore = composable(env, unset=False).core
    context = spoofer_context(core.setup, core.receivers, core.observer)
    context = context._replace(action_names=core.action_names)
    card = card_behind(spoofer, made)
    if card is not None:
        found = _wrapped(env, core, card) + card.differences(context)
        if not transfer:
            found += unlike(_settings(setup_of_card(card)), _settings(core.setup))
        if found:
            hint = "" if transfer else " (`transfer=True` allows for other settings alone)"
            raise ValueError(
                f"{card.name!r} was made for another environment{hint}:\n  " + "\n  ".join(found)
            )
    made.bind(context)
    made.reset()
    warn_of_headings([made], core.setup)
    return made


def warn_of_headings(spoofers: Iterable[Spoofer], setup: Setup) -> None:
    """Warn of spoofers that push along a fixed heading where the target direction is drawn."""
    commands = setup.action_names
    if setup.target_heading_deg != "random" or not has_heading(commands):
        return
    fixed = [
        f"{type(each).__name__} (heading_deg={each.heading_deg:g})"
        for each in spoofers
        if isinstance(each, ScriptedSpoofer) and each.heading_deg != TARGET
    ]
    if fixed:
        warnings.warn(
            "the target direction is drawn for every episode (target_heading_deg='random'), but "
            f"along a fixed heading push {', '.join(fixed)}; with heading_deg='{TARGET}' a "
            "scripted spoofer follows the target direction",
            UserWarning,
            stacklevel=3,
        )


def spoofer_context(
    setup: Setup, receivers: int = 1, observer: Observer | None = None
) -> SpooferContext:
    """What a spoofer knows of an attack, and of what it observes by an `observer`."""
    attack = setup.attack
    if not isinstance(attack.rate_limit_mps, Real):
        raise ValueError(
            f"a spoofer needs one limit of the rate for all axes, got {attack.rate_limit_mps}"
        )
    context = SpooferContext(
        receivers=receivers,
        # of its decisions: a ramp that is held for n epochs must not get to n times its rate
        interval_s=setup.interval_s * setup.repeat,
        steps=setup.steps // setup.repeat,
        control=attack.control,
        acceleration_limit_mps2=attack.acceleration_limit_mps2,
        rate_limit_mps=float(attack.rate_limit_mps),
        action_names=setup.action_names,
    )
    if observer is None:
        return context
    return context._replace(
        observation_names=observer.names,
        observation_low=tuple(observer.low.tolist()),
        observation_high=tuple(observer.high.tolist()),
    )


def setup_of_card(card: Card) -> TightlyCoupledSetup:
    """World, victim, attack, detector and timeline that a spoofer was made for."""
    if card.env_id != ENV_ID:
        raise ValueError(f"card of {card.name!r}: `env_id` must be {ENV_ID}, got {card.env_id!r}")
    valid = settings_of(TightlyCoupledSetup)
    unknown = [name for name in card.env_kwargs if name not in valid]
    if unknown:
        raise ValueError(
            f"card of {card.name!r}: `env_kwargs` has {', '.join(map(repr, unknown))}; valid: "
            f"{', '.join(valid)}"
        )
    try:
        return make_setup(TightlyCoupledSetup, card.env_kwargs)
    except (TypeError, ValueError) as error:
        raise ValueError(f"card of {card.name!r}: `env_kwargs`: {error}") from error


def card_behind(spec: Spoofer | Mapping[str, Any] | str, made: Spoofer) -> Card | None:
    """Card of a spoofer, if it has one."""
    name = spec.get("name") if isinstance(spec, Mapping) else spec
    if isinstance(name, str) and name in shipped():
        return card_of(name)
    return getattr(made, "card", None)


def _wrapped(env: Any, core: SpoofCore, card: Card) -> list[str]:
    """Which spaces a wrapper has changed."""
    found = []
    for word, inner in (("observation", observation_space(core)), ("action", action_space(core))):
        if word == "observation" and card.observation is None:
            continue
        single = f"single_{word}_space"
        outer = getattr(env, single if hasattr(env, single) else f"{word}_space")
        if outer != inner:
            found.append(f"{word}: a wrapper changes the space from {inner} to {outer}")
    return found


def _settings(setup: Setup) -> dict[str, Any]:
    """Everything that decides what a spoofer meets, JSON-able."""
    return {name: _described(getattr(setup, name)) for name in SETUP}


def _described(part: Any) -> Any:
    """A part of the setup by its settings; a class of the user, by its name."""
    if part is None or isinstance(part, str):
        return part
    if isinstance(part, Real):
        return float(part)
    return describe(part) if dataclasses.is_dataclass(part) else type(part).__qualname__
