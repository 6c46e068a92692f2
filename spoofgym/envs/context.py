"""What a spoofer is given of an environment once, and whether it fits."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from numbers import Real

from ..simulation.setup import Setup
from ..spoofers import ScriptedSpoofer, Spoofer, SpooferContext
from ..spoofers.base import TARGET, has_heading
from ..spoofers.residual import BoundBase
from .observer import Observer
from .terms.action import CommandMap


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


def check_fit(spoofer: Spoofer, commands: CommandMap, setup: Setup) -> None:
    """Refuse a spoofer whose pace or heading is not that of an environment."""
    if apply_pace(setup, spoofer).repeat != setup.repeat:
        raise ValueError(
            f"{type(spoofer).__name__} decides every {spoofer.decision_interval_s:g} s, and this "
            f"environment asks it every {setup.interval_s:g} s: make it with "
            f"decision_interval_s={spoofer.decision_interval_s:g}, between={spoofer.between!r}"
        )
    _check_heading(spoofer, commands, setup)


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
            "`decision_interval_s` of the world each spoofer keeps its own"
        )
    return setup


def _check_heading(spoofer: Spoofer, commands: CommandMap, setup: Setup) -> None:
    if not (commands.along_target and isinstance(spoofer, ScriptedSpoofer)):
        return
    target, own = setup.target_heading_deg, spoofer.heading_deg
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
            f"these push along a fixed heading: {', '.join(fixed)}; with heading_deg='{TARGET}' a "
            "scripted spoofer follows the target direction",
            UserWarning,
            stacklevel=3,
        )


def bind_base(
    setup: Setup, receivers: int, observer: Observer, commands: CommandMap
) -> BoundBase | None:
    """The base that the actions of an environment correct, ready for its receivers."""
    if commands.base is None:
        return None
    check_fit(commands.base.spoofer, commands, setup)
    if not commands.along_target:
        warn_of_headings([commands.base.spoofer], setup)
    return commands.base.bind(spoofer_context(setup, receivers, observer, commands))
