"""What every spoofer has to keep, tried in front of receivers of the default scenario."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..attacks import Attack
from ..core.registry import is_number
from ..envs.context import apply_pace
from ..envs.observer import Observer
from ..envs.spoofer_binding import bound_spoofer, setup_of_card
from ..envs.terms.action import CommandMap, Decisions
from ..simulation import Engine, Setup, TightlyCoupledSetup, Timeline
from ..spoofers import KNOWLEDGE, Spoofer, SpooferContext, make_spoofer
from ..spoofers.base import TARGET, FloatArray
from ..spoofers.build import card_behind
from .contract import (
    ContractTrial,
    Record,
    check_memory,
    explain_read_only,
    refuse_global_random,
    require_contract,
    require_fresh,
    run_trial,
)

Observation = NDArray[np.float32]
RECEIVERS = 5
TIMELINE = Timeline(warmup_s=3.0, live_s=1.0, attack_s=12.0, time_to_alert_s=0.0)
COMMANDS = 24  # as many are tried of an episode
LONGEST_S = 60.0  # of decisions; the default scenario has no room for longer ones


def check_spoofer(
    spoofer: Spoofer | dict[str, Any] | str,
    *,
    attack: Attack | Mapping[str, Any] | str | None = None,
) -> None:
    """Check that a spoofer keeps its contract.

    It commands the attack against receivers of the default scenario, or of the one on its
    card, and has to show that

    - it states its knowledge, and its tunable setting, if any, has a range;
    - actions have the right shape and type, are finite, and lie within -1 and 1;
    - it neither writes to an observation nor stores it, nor writes to an array that it returned;
    - receivers do not affect one another, it draws no random numbers, and it remembers in its
      `memory` alone, as in `check_detector`.

    Parameters
    ----------
    spoofer : Spoofer, str or dict
        What `make_spoofer` takes.  The object itself is left as it is.
    attack : Attack, str or mapping, optional
        What it commands: by default that of its card, or else a false position.

    Raises
    ------
    AssertionError
        Says what was expected, what came, and how to mend it.

    Examples
    --------
    >>> from spoofgym.testing import check_spoofer
    >>> check_spoofer({"name": "ramp", "rate_mps": 0.2}, attack="per-channel")
    """
    unbound = make_spoofer(spoofer)
    _check_declarations(unbound)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        setup = _setup(unbound, attack)
        context, observer, commands = bound_spoofer(unbound, setup, RECEIVERS)
        _check_tuning(unbound, context)
        observations = _perform(unbound, setup, observer, context, commands)
        run_trial(_SpooferTrial(unbound, context, observations))


def _setup(spoofer: Spoofer, attack: Attack | Mapping[str, Any] | str | None) -> Setup:
    """Where a spoofer is tried: at the time on its card, or else after a short warm-up; the window
    decides which elements of the target's motion are observed."""
    card = card_behind(spoofer)
    if card is None:
        attack = "false-position" if attack is None else attack
        follows = getattr(spoofer, "heading_deg", None) == TARGET
        return TightlyCoupledSetup(
            attack=attack,
            timeline=replace(TIMELINE, attack_s=_window_s(spoofer)),
            detector={"name": "ewma", "thresholds": "nominal"},
            target_heading_deg="random" if follows else 90.0,
        )
    if attack is not None:
        card = card.model_copy(update={"env_kwargs": {**card.env_kwargs, "attack": attack}})
    own = setup_of_card(card)
    if not isinstance(own, TightlyCoupledSetup):
        raise ValueError(
            f"only spoofers of the tightly coupled receiver can be checked; the card of "
            f"{card.name!r} is of {card.env_id}"
        )
    return own


def _window_s(spoofer: Spoofer) -> float:
    every = spoofer.decision_interval_s
    if every is None or not (is_number(every) and 0.0 < every < LONGEST_S):
        return TIMELINE.attack_s  # or an error where it is used
    return every * max(math.ceil(TIMELINE.attack_s / every), 2)


def _check_declarations(spoofer: Spoofer) -> None:
    kind = type(spoofer).__name__
    knowledge = getattr(spoofer, "knowledge", None)
    require_contract(
        knowledge in KNOWLEDGE,
        f"`{kind}.knowledge` must be one of {', '.join(map(repr, KNOWLEDGE))}, got {knowledge!r}",
    )
    tunable = spoofer.tunable
    require_contract(
        tunable is None or isinstance(getattr(spoofer, tunable, None), int | float),
        f"`{kind}.tunable` must name a setting that is a number, or be None, got {tunable!r}",
    )


def _check_tuning(spoofer: Spoofer, context: SpooferContext) -> None:
    if spoofer.tunable is None:
        return
    low, high = type(spoofer).tuning_range(context)
    require_contract(
        0.0 < low < high < np.inf,
        f"`tuning_range` must return two numbers, 0 < low < high, got {low} and {high}",
    )


def _bind(spoofer: Spoofer, context: SpooferContext) -> Spoofer:
    bound = copy.deepcopy(spoofer)
    bound.bind(context)
    check_memory(bound, context.receivers, "spoofer")
    return bound


def _perform(
    spoofer: Spoofer,
    setup: Setup,
    observer: Observer,
    context: SpooferContext,
    commands: CommandMap,
) -> list[Observation]:
    engine = Engine(RECEIVERS, setup, threads=1)
    engine.reset([np.random.default_rng(seed) for seed in range(RECEIVERS)])
    commands.aim(engine.simulator.heading)
    decisions = Decisions(apply_pace(setup, spoofer), RECEIVERS, len(commands.names))
    observations: list[Observation] = []
    with refuse_global_random("spoofer"):
        bound = _bind(spoofer, context)
        for k in range(setup.steps):
            if decisions.due(k):
                if len(observations) == COMMANDS:
                    break
                seen = observer(engine, k)
                observations.append(seen.copy())
                decisions.take(_act(bound, seen, len(observations) - 1))
            action = decisions.action(k)
            engine.step(commands.command(action, engine.simulator.commanded_rate))
    return observations


def _act(spoofer: Spoofer, observation: Observation, number: int) -> FloatArray:
    seen = observation.view()
    seen.flags.writeable = False
    with explain_read_only("spoofer", "observation"):
        action: object = spoofer.act(seen)
    context = spoofer.context
    shape = (context.receivers, len(context.action_names))
    if not isinstance(action, np.ndarray):
        raise AssertionError(f"`act` must return an array, got {type(action).__name__}")
    require_contract(
        action.shape == shape and action.dtype == np.float64 and action.flags.c_contiguous,
        f"`act` must return a C-contiguous float64 array of shape {shape}, one row a receiver and "
        f"one column for each of {', '.join(context.action_names)}; got {action.dtype} of shape "
        f"{action.shape}",
    )
    require_contract(
        bool((np.abs(action) <= 1.0).all()),
        f"actions must be finite and within [-1, 1], got {np.abs(action).max():g} at command "
        f"{number}; `np.clip(action, -1.0, 1.0)`",
    )
    owners = {"the observation": observation}
    owners |= {f"`memory[{name!r}]`": array for name, array in spoofer.memory.items()}
    require_fresh("the action", action, owners, "the next command")
    return action.copy()


class _SpooferTrial(ContractTrial[Spoofer]):
    """A spoofer that is shown one observation an epoch."""

    word, call = "spoofer", "act"

    def __init__(
        self, unbound: Spoofer, context: SpooferContext, observations: Sequence[Observation]
    ) -> None:
        self.unbound, self.context, self.observations = unbound, context, observations
        self.receivers, self.turns = context.receivers, len(observations)

    def bind(self, rows: NDArray[np.intp]) -> Spoofer:
        return _bind(self.unbound, self.context._replace(receivers=len(rows)))

    def reset(self, bound: Spoofer, mask: NDArray[np.bool_] | None) -> None:
        bound.reset(mask)

    def turn(self, bound: Spoofer, number: int, rows: NDArray[np.intp], spoil: bool) -> Record:
        own = np.ascontiguousarray(self.observations[number][rows])
        action = _act(bound, own, number)
        if spoil:
            own[:] = np.nan
        return {"action": action}
