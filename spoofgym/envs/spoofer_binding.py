"""Bringing a spoofer and an environment together, and saying where they do not fit."""

from __future__ import annotations

import dataclasses
import inspect
import json
import shlex
from collections.abc import Iterable, Sequence
from contextlib import suppress
from numbers import Real
from pathlib import Path
from typing import Any

from ..core.settings import describe, format_card_diff, get_kind
from ..detectors.calibrated import Calibrated, resolve_thresholds
from ..policies.card import SpooferCard
from ..simulation.monitors import Monitor, PastPositions, needed_monitors
from ..simulation.setup import Setup
from ..spoofers import Spoofer, SpooferContext, make_spoofer
from ..spoofers.base import REPORTED
from ..spoofers.build import SpooferSpec, card_behind
from ..spoofers.learned import LearnedSpoofer, refuse_changes
from ..spoofers.residual import change_file
from .context import apply_pace, check_fit, spoofer_context, warn_of_headings
from .core import SpoofCore
from .factory import VICTIMS, composable, find_environment, list_parameters, make_setup
from .observer import Observer
from .terms import describe_terms, make_terms
from .terms.action import ActionTerm, CommandMap, default_action
from .terms.observation import default_terms

SETUPS: dict[str, type[Setup]] = {kind.env_id: kind for kind in VICTIMS.values()}
"""Kinds of victims by the environments that have their defaults."""
OF_OFFSETS = ("control", "basis", "channels")
WORLD = ("scenario", "attack", *OF_OFFSETS, "timeline", "domain", "target_heading_deg")
SHAPING = (*WORLD, "decision_interval_s", "between")
"""Settings of a world on which it depends what a spoofer observes and how it acts."""


class MisfitError(ValueError):
    """A policy does not fit an attack. `options`: of the command line, that make the world which it
    was made for; "" where none do."""

    def __init__(self, message: str, options: str = "") -> None:
        super().__init__(message)
        self.options = options


def attach(spoofer: SpooferSpec, env: Any, *, transfer: bool = False) -> Spoofer:
    """Spoofer that is ready to command the receivers of an environment.

    One that has a card, a learned or a shipped one, is compared with the environment first.

    Parameters
    ----------
    spoofer : Spoofer, str or mapping
        What `make_spoofer` takes; an object is copied.
    env : SpoofEnv, SpoofVectorEnv or SpoofVecEnv, or a duel of both agents
        Wrapped or not.
    transfer : bool
        Whether the spoofer may meet another scenario, receiver, detector or target than the one
        that it was made for.  Names and bounds of what it observes and commands, and the
        attack's limits, have to be the same in any case.  In a duel the detector is the other
        agent, whichever that is.

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
    duel = getattr(getattr(env, "unwrapped", env), "duel", None)  # of the forms for PettingZoo
    core: SpoofCore = (composable(env, unset=False) if duel is None else duel).core
    context = spoofer_context(core.setup, core.receivers, core.observer, core.commands)
    card = card_behind(made)
    if card is not None:
        if duel is None:
            refuse_changes(env, repr(card.name))
        found = misfits = card.diff_context(context) + _diff_bases(card, core)
        if not transfer:
            made_for = setup_of_card(card)
            with suppress(ValueError):  # without a calibration there is no such environment, either
                resolve_thresholds(
                    made_for.detector, made_for
                )  # which looks its thresholds up by a rate
            own, here = _settings(made_for), _settings(core.setup)
            if duel is not None:
                here["detector"] = own["detector"]
            found = misfits + format_card_diff(own, here)
        if found:
            hint = f" ({suggest_settings(card, core.setup)[0]})" if misfits else ""
            hint += "" if transfer else " (`transfer=True` allows for other settings alone)"
            raise ValueError(
                f"{card.name!r} was made for another environment{hint}:\n  " + "\n  ".join(found)
            )
    elif core.commands.base is not None and not isinstance(made, LearnedSpoofer):
        raise ValueError(
            f"actions here are corrections of the base {core.commands.base.spoofer!r}, and "
            f"{made!r} commands an attack of its own: attach it to the environment without the base"
        )
    check_fit(made, core.commands, core.setup)
    made.bind(context)
    made.reset()
    if not core.commands.along_target:
        warn_of_headings([made], core.setup)
    return made


def _diff_bases(card: SpooferCard, core: SpoofCore) -> list[str]:
    """Where the base that a policy corrects differs from that of an environment."""
    if core.commands.base is None:
        return []
    found = card.env_kwargs.get("action"), describe_terms("action", core.settings["action"])
    # by its digest a file is the same wherever it lies
    own, here = ({"action": change_file(each, lambda file: Path(file).name)} for each in found)
    return format_card_diff(own, here)


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


def get_tuning_range(spoofer: Spoofer, setup: Setup) -> tuple[float, float]:
    return type(spoofer).tuning_range(spoofer_context(_apply_pace(setup, spoofer)))


def bound_spoofer(
    spoofer: Spoofer, setup: Setup, receivers: int
) -> tuple[SpooferContext, Observer, CommandMap]:
    """What a spoofer is given that commands the attack itself, what it observes, its commands. It
    decides at its own pace."""
    setup = _apply_pace(setup, spoofer)
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
    context = spoofer_context(setup, receivers, observer, commands)._replace(base=commands.base)
    card = card_behind(spoofer)
    if card is not None and (found := card.diff_context(context)):
        raise _misfit(card, "; ".join(found), setup)
    return context, observer, commands


def _apply_pace(setup: Setup, spoofer: Spoofer) -> Setup:
    """World in which a spoofer decides at its own pace; its card says what is missing for it."""
    try:
        return apply_pace(setup, spoofer)
    except ValueError as error:
        card = card_behind(spoofer)
        raise error if card is None else _misfit(card, str(error), setup) from error


def _misfit(card: SpooferCard, found: str, setup: Setup) -> MisfitError:
    added, options = suggest_settings(card, setup)
    return MisfitError(f"{card.name!r} does not fit this attack: {found}; {added}", options)


def suggest_settings(card: SpooferCard, setup: Setup) -> tuple[str, str]:
    """What to add to a world that a policy does not fit, in words, and as options."""
    try:
        made_for = setup_of_card(card)
    except ValueError as error:
        return str(error), ""
    if type(made_for) is not type(setup):
        return f"it was trained in {card.env_id}", ""
    settings = find_card_settings(card)[1]
    own, here = _settings(made_for), _settings(setup)
    names = [name for name in SHAPING if own.get(name) != here.get(name)]
    if "scenario" in names:
        # with which all else has the victim's defaults, wherever it is given, and the policy its
        # own pace
        here = {**_settings(make_setup(type(setup), {"detector": "never"})), "scenario": None}
        names = [name for name in (*WORLD, "receiver") if own.get(name) != here.get(name)]
    if {*names} & {*OF_OFFSETS}:  # which make the attack
        names = [name for name in names if name != "attack" or name in settings]
    usual = {name: each.default for name, each in list_parameters(type(setup)).items()}
    given = {name: json.dumps(describe({**usual, **settings}[name])) for name in names}
    options = " ".join(f"--set {name}={shlex.quote(value)}" for name, value in given.items())
    text = f"trained in another world, add {options}" if options else "trained for other actions"
    return text, options


def find_card_settings(card: SpooferCard) -> tuple[type[Setup], dict[str, Any]]:
    """Victim of a card, and all settings: its own on top of those of its environment."""
    try:
        kind, settings = find_environment(card.env_id)
    except ValueError as error:
        raise ValueError(f"card of {card.name!r}: `env_id`: {error}") from error
    valid = list_parameters(kind)
    unknown = [name for name in card.env_kwargs if name not in valid]
    if unknown:
        raise ValueError(
            f"card of {card.name!r}: `env_kwargs` has {', '.join(map(repr, unknown))}; valid: "
            f"{', '.join(valid)}"
        )
    return kind, {**settings, **card.env_kwargs}


def setup_of_card(card: SpooferCard) -> Setup:
    kind, settings = find_card_settings(card)
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
    if isinstance(part, Calibrated):  # beside a plain detector, whose thresholds alone differ
        own = describe(part)
        return {**own.pop("detector"), **{name: own[name] for name in own if name != "kind"}}
    return describe(part) if dataclasses.is_dataclass(part) else get_kind(type(part))
