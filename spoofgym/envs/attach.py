"""Bringing a spoofer and an environment together, and saying where they do not fit."""

from __future__ import annotations

import dataclasses
import inspect
import warnings
from collections.abc import Iterable, Mapping
from numbers import Real
from typing import Any

from .._describe import describe, unlike
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
from .game import Game
from .observer import Observer
from .presets import make_setup
from .setup import Setup
from .spaces import action_space, observation_space
from .spoof_env import SpoofEnv

ENV_ID = "spoofgym/TightlyCoupled-v0"
"""Environment that cards are compared with."""
SETUP = tuple(inspect.signature(make_setup).parameters)
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
    game = game_of(env)
    context = spoofer_context(game.setup, game.receivers, game.observer)
    context = context._replace(action_names=game.action_names)
    card = card_behind(spoofer, made)
    if card is not None:
        found = _wrapped(env, game, card) + card.differences(context)
        if not transfer:
            found += _other_settings(card, game)
        if found:
            hint = "" if transfer else " (`transfer=True` allows for other settings alone)"
            raise ValueError(
                f"{card.name!r} was made for another environment{hint}:\n  " + "\n  ".join(found)
            )
    made.bind(context)
    made.reset()
    warn_of_headings([made], game.setup)
    return made


def warn_of_headings(spoofers: Iterable[Spoofer], setup: Setup) -> None:
    """Warn of spoofers that push along a fixed heading where the target direction is drawn."""
    commands = setup.attack.action_names(setup.world)
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
    """What a spoofer is told of an attack.

    `observer`: what it observes; by default it does not know.
    """
    attack = setup.attack
    context = SpooferContext(
        receivers=receivers,
        # of its decisions: a ramp that is held for n epochs must not get to n times its rate
        interval_s=setup.scenario.epoch_interval_s * setup.repeat,
        steps=setup.steps // setup.repeat,
        control=attack.control,
        acceleration_limit_mps2=attack.acceleration_limit_mps2,
        rate_limit_mps=attack.rate_limit_mps,
        action_names=attack.action_names(setup.world),
    )
    if observer is None:
        return context
    return context._replace(
        observation_names=observer.names,
        observation_low=tuple(observer.low.tolist()),
        observation_high=tuple(observer.high.tolist()),
    )


def game_of(env: Any) -> Game:
    """Game behind an environment."""
    game = getattr(getattr(env, "unwrapped", env), "game", None)
    if not isinstance(game, Game):
        raise TypeError(
            "`env` must be a SpoofEnv, a SpoofVectorEnv or a SpoofVecEnv, wrapped or not, got "
            f"{env!r}; `gymnasium.make_vec` makes one by its default vectorization mode"
        )
    return game


def setup_of_card(card: Card) -> Setup:
    """World, victim, attack, detector and timeline that a spoofer was made for."""
    if card.env_id != ENV_ID:
        raise ValueError(f"card of {card.name!r}: `env_id` must be {ENV_ID}, got {card.env_id!r}")
    valid = inspect.signature(SpoofEnv).parameters
    unknown = [name for name in card.env_kwargs if name not in valid]
    if unknown:
        raise ValueError(
            f"card of {card.name!r}: `env_kwargs` has {', '.join(map(repr, unknown))}; valid: "
            f"{', '.join(valid)}"
        )
    try:
        return make_setup(**{k: value for k, value in card.env_kwargs.items() if k in SETUP})
    except (TypeError, ValueError) as error:
        raise ValueError(f"card of {card.name!r}: `env_kwargs`: {error}") from error


def card_behind(spec: Spoofer | Mapping[str, Any] | str, made: Spoofer) -> Card | None:
    """Card of a spoofer, if it has one."""
    name = spec.get("name") if isinstance(spec, Mapping) else spec
    if isinstance(name, str) and name in shipped():
        return card_of(name)
    card: Card | None = getattr(made, "card", None)
    return card


def _wrapped(env: Any, game: Game, card: Card) -> list[str]:
    """Which spaces a wrapper has changed."""
    found = []
    for word, inner in (("observation", observation_space(game)), ("action", action_space(game))):
        if word == "observation" and card.observation is None:
            continue
        single = f"single_{word}_space"
        outer = getattr(env, single if hasattr(env, single) else f"{word}_space")
        if outer != inner:
            found.append(f"{word}: a wrapper changes the space from {inner} to {outer}")
    return found


def _other_settings(card: Card, game: Game) -> list[str]:
    """Where the environment is another one than that of a card."""
    return unlike(_settings(setup_of_card(card)), _settings(game.setup))


def _settings(setup: Setup) -> dict[str, Any]:
    """Everything that decides what a spoofer meets, JSON-able."""
    return {name: _told(getattr(setup, name)) for name in SETUP}


def _told(part: Any) -> Any:
    """A part of the setup by its settings; a class of the user, by its name."""
    if part is None or isinstance(part, str):
        return part
    if isinstance(part, Real):
        return float(part)
    return describe(part) if dataclasses.is_dataclass(part) else type(part).__qualname__
