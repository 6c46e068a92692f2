"""Bringing a spoofer and an environment together, and saying where they do not fit."""

from __future__ import annotations

import dataclasses
import inspect
import json
import shlex
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from numbers import Real
from typing import Any

from ..core.settings import describe, format_card_diff, get_kind
from ..detectors.calibrated import resolve_thresholds
from ..policies.card import SpooferCard
from ..simulation.monitors import Monitor, PastPositions, needed_monitors
from ..simulation.setup import Setup
from ..spoofers import (
    ScriptedSpoofer,
    Spoofer,
    SpooferContext,
    make_spoofer,
)
from ..spoofers.base import TARGET, has_heading
from ..spoofers.build import card_behind
from ..spoofers.learned import refuse_changes
from .core import SpoofCore
from .factory import VICTIMS, composable, find_environment, list_parameters, make_setup
from .observer import Observer
from .terms import make_terms
from .terms.action import ActionTerm, CommandMap, default_action
from .terms.observation import REPORTED, default_terms

SETUPS: dict[str, type[Setup]] = {kind.env_id: kind for kind in VICTIMS.values()}
"""Kinds of victims by the environments that have their defaults."""
OF_OFFSETS = ("control", "basis", "channels")
SHAPING = (
    *("scenario", "attack", *OF_OFFSETS, "timeline", "domain", "target_heading_deg"),
    *("decision_interval_s", "between"),
)
"""Settings of a world on which it depends what a spoofer observes and how it acts."""


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
    >>> envs = gym.make_vec("spoofgym/Zhong2025-v0", num_envs=4)
    >>> observation, info = envs.reset(seed=1)
    >>> attach({"name": "ramp", "rate_mps": 0.2}, envs).act(observation).shape
    (4, 1)
    >>> envs.close()
    """
    made = make_spoofer(spoofer)
    core: SpoofCore = composable(env, unset=False).core
    context = spoofer_context(core.setup, core.receivers, core.observer, core.commands)
    card = card_behind(made)
    if card is not None:
        refuse_changes(env, repr(card.name))
        found = misfits = card.diff_context(context)
        if not transfer:
            made_for = setup_of_card(card)
            with suppress(ValueError):  # without a calibration there is no such environment, either
                resolve_thresholds(
                    made_for.detector, made_for
                )  # which looks its thresholds up by a rate
            found = misfits + format_card_diff(_settings(made_for), _settings(core.setup))
        if found:
            hint = f" ({suggest_settings(card, core.setup)})" if misfits else ""
            hint += "" if transfer else " (`transfer=True` allows for other settings alone)"
            raise ValueError(
                f"{card.name!r} was made for another environment{hint}:\n  " + "\n  ".join(found)
            )
    if apply_pace(core.setup, made).repeat != core.setup.repeat:
        raise ValueError(
            f"{type(made).__name__} decides every {made.decision_interval_s:g} s, and this "
            f"environment asks it every {core.setup.interval_s:g} s: make it with "
            f"decision_interval_s={made.decision_interval_s:g}, between={made.between!r}"
        )
    _check_heading(made, core)
    made.bind(context)
    made.reset()
    if not core.commands.along_target:
        warn_of_headings([made], core.setup)
    return made


def _check_heading(spoofer: Spoofer, core: SpoofCore) -> None:
    if not (core.commands.along_target and isinstance(spoofer, ScriptedSpoofer)):
        return
    target, own = core.setup.target_heading_deg, spoofer.heading_deg
    if isinstance(own, str) or (isinstance(target, Real) and (own - target) % 360.0 == 0.0):
        return
    drawn = "drawn for every episode" if isinstance(target, str) else f"{target:g}"
    raise ValueError(
        f"{type(spoofer).__name__} has `heading_deg` = {own:g}, but the environment's actions are "
        f"along the target direction, which is {drawn}: give it heading_deg='{TARGET}', or the "
        "environment an action of two dimensions, such as action={'name': 'rate-setpoint', "
        "'dimensions': 2}"
    )


def warn_of_headings(spoofers: Iterable[Spoofer], setup: Setup) -> None:
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


def make_command_map(spoofer: Spoofer, setup: Setup) -> CommandMap:
    """How the actions of a spoofer command an attack that nothing else stands before. A policy acts
    as in the environment that it was made in, all others by the attack's own elements."""
    given = spoofer.action_terms
    terms: Sequence[ActionTerm]
    terms = default_action(setup) if given is None else make_terms("action", given)
    return CommandMap(terms, setup)


def monitors_for(spoofers: Iterable[Spoofer], setup: Setup) -> list[Monitor]:
    known = dict.fromkeys(spoofer.knowledge for spoofer in spoofers)
    return needed_monitors(term for each in known for term in default_terms(setup, each))


def apply_pace(setup: Setup, spoofer: Spoofer) -> Setup:
    """The same world, in which decisions are due as a spoofer takes them."""
    every, between = spoofer.decision_interval_s, spoofer.between
    if every is None and between == "hold":
        return setup
    name = spoofer.label or type(spoofer).__name__
    try:
        own = setup.copy_with(pace=(every, between))
    except (TypeError, ValueError) as error:
        given = f"decision_interval_s={every!r} and between={between!r}"
        raise ValueError(f"{name} decides by {given}: {error}") from error
    if setup.repeat == 1:
        return own
    if (own.repeat, own.between) != (setup.repeat, setup.between):
        raise ValueError(
            f"{name} decides every {every:g} s ({between} between), but this world every "
            f"{setup.decision_interval_s:g} s ({setup.between} between); without a "
            "`decision_interval_s` of its own any spoofer can decide as it does"
        )
    return setup


def get_tuning_range(spoofer: Spoofer, setup: Setup) -> tuple[float, float]:
    return type(spoofer).tuning_range(spoofer_context(apply_pace(setup, spoofer)))


def bound_spoofer(
    spoofer: Spoofer, setup: Setup, receivers: int
) -> tuple[SpooferContext, Observer, CommandMap]:
    """What a spoofer is given that commands the attack itself, what it observes, its commands. It
    decides at its own pace."""
    setup = apply_pace(setup, spoofer)
    if REPORTED in spoofer.knowledge and not any(
        isinstance(monitor, PastPositions) for monitor in setup.monitors
    ):
        raise ValueError(
            f"{type(spoofer).__name__} knows what the victim reports ({spoofer.knowledge}), which "
            "only environments with such a `knowledge` let it observe"
        )
    commands = make_command_map(spoofer, setup)
    terms = default_terms(setup, spoofer.knowledge, along_target=commands.along_target)
    observer = Observer(terms, setup)
    context = spoofer_context(setup, receivers, observer, commands)
    card = card_behind(spoofer)
    found = [] if card is None else card.diff_context(context)
    if card is not None and found:
        raise ValueError(
            f"{card.name!r} does not fit this attack: {'; '.join(found)}; "
            f"{suggest_settings(card, setup)}"
        )
    return context, observer, commands


def spoofer_context(
    setup: Setup,
    receivers: int = 1,
    observer: Observer | None = None,
    commands: CommandMap | None = None,
) -> SpooferContext:
    """What a spoofer knows of an attack, of what it observes by an `observer`, and its `commands`.
    By default it commands every element of the attack, as it is."""
    attack = setup.attack
    setpoint = None if commands is None else commands.setpoint_mps
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
        action_names=setup.action_names if commands is None else commands.names,
    )
    if attack.kind == "offsets":
        by_rate = attack.control == "rate"
        unit = {"control": "setpoint", "setpoint_mps": attack.unit_scale}
        context = context._replace(**unit if by_rate else {})
    elif setpoint is not None:
        # an attack by rate takes the set-point at once: it is the unit of its rates
        changed = {"control": "setpoint", "setpoint_mps": setpoint}
        by_rate = attack.control == "rate"
        context = context._replace(**{"rate_limit_mps": setpoint} if by_rate else changed)
    if observer is None:
        return context
    return context._replace(
        observation_names=observer.names,
        observation_low=tuple(observer.low.tolist()),
        observation_high=tuple(observer.high.tolist()),
    )


def suggest_settings(card: SpooferCard, setup: Setup) -> str:
    """What to add to a world that a policy does not fit, as options of the command line."""
    try:
        made_for = setup_of_card(card)
    except ValueError as error:
        return str(error)
    if type(made_for) is not type(setup):
        return f"it was trained in {card.env_id}"
    settings = find_card_settings(card)[1]
    own, here = _settings(made_for), _settings(setup)
    names = [name for name in SHAPING if own.get(name) != here.get(name)]
    if "scenario" in names:  # with which all else has the victim's defaults, wherever it is given
        here = {**_settings(make_setup(type(setup), {"detector": "never"})), "scenario": None}
        names = [name for name in SHAPING if own.get(name) != here.get(name)]
    if {*names} & {*OF_OFFSETS}:  # which make the attack
        names = [name for name in names if name != "attack" or name in settings]
    usual = {name: each.default for name, each in list_parameters(type(setup)).items()}
    given = {name: json.dumps(describe({**usual, **settings}[name])) for name in names}
    options = " ".join(f"--set {name}={shlex.quote(value)}" for name, value in given.items())
    return f"trained in another world, add {options}" if options else "trained for other actions"


def find_card_settings(card: SpooferCard) -> tuple[type[Setup], dict[str, Any]]:
    """Victim of a card, and all settings: its own on top of those of its environment."""
    try:
        kind, settings = find_environment(card.env_id)
    except ValueError as error:
        raise ValueError(f"card of {card.name!r}: `env_id`: {error}") from error
    return kind, {**settings, **card.env_kwargs}


def setup_of_card(card: SpooferCard) -> Setup:
    kind, settings = find_card_settings(card)
    valid = list_parameters(kind)
    unknown = [name for name in card.env_kwargs if name not in valid]
    if unknown:
        raise ValueError(
            f"card of {card.name!r}: `env_kwargs` has {', '.join(map(repr, unknown))}; valid: "
            f"{', '.join(valid)}"
        )
    try:
        return make_setup(kind, settings)
    except (TypeError, ValueError) as error:
        raise ValueError(f"card of {card.name!r}: `env_kwargs`: {error}") from error


def _settings(setup: Setup) -> dict[str, Any]:
    found = {}
    for name, parameter in inspect.signature(type(setup)).parameters.items():
        # not every victim keeps a setting as it was given
        given = (setup.raw_settings or {}).get(name, parameter.default)
        found[name] = _describe_part(getattr(setup, name, given))
    return found


def _describe_part(part: Any) -> Any:
    """A part of the setup by its settings; a class of the user, by its name."""
    if part is None or isinstance(part, str):
        return part
    if isinstance(part, Real):
        return float(part)
    return describe(part) if dataclasses.is_dataclass(part) else get_kind(type(part))
