"""What every attack has to keep, tried on the truth of the default scenario."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..attacks import Attack, AttackContext, Offsets, make_attack
from ..truth.run import GroundTruth
from ..truth.scenario import Scenario
from .contract import (
    ContractTrial,
    Record,
    check_described,
    first_difference,
    require_contract,
    run_trial,
    same_bits,
)

FloatArray = NDArray[np.float64]
ONSET = 60
STARTS = np.array([ONSET, ONSET + 1, ONSET + 15, ONSET + 40, ONSET + 140])
"""Epochs that the receivers are at first; each is in an episode of its own."""
COMMANDS = 30
ROUNDING = 1e-9
CLOSURE_M = 1e-5
"""Largest difference of a counterfeit range and the integral of its rate over an epoch [m]."""


def check_attack(attack: Attack | Mapping[str, Any] | str) -> None:
    """Check that an attack keeps its contract.

    It is bound to the default scenario and commanded, and has to show that

    - its label says whether range rates follow, its actions have names, and its settings fit into
      JSON;
    - before any command it changes nothing, exactly; it never touches a satellite that is not
      captured;
    - offsets are the commanded motion, within the limits of rate and acceleration, and without a
      command they keep their rate;
    - range rates are the derivative of the ranges where they are coherent, and untouched else;
    - receivers and slices of a batch do not affect one another, it draws no random numbers, and it
      remembers in its `memory` alone, as in `check_detector`.

    Imperfect equipment is checked twice: with it switched off, all of this; with it on, all but the
    clean start and the derivative, since errors, a clock or a wrong target position change
    measurements without a command (`idle_is_clean` says so), and noise has no derivative.

    Parameters
    ----------
    attack : Attack, str or mapping
        What `make_attack` takes.  The object itself is left as it is.

    Raises
    ------
    AssertionError
        Says what was expected, what came, and how to mend it.

    Examples
    --------
    >>> from spoofgym.testing import check_attack
    >>> check_attack({"name": "false-position", "control": "rate"})
    """
    unbound = make_attack(attack)
    world = copy.deepcopy(Scenario().world())
    truth = _fingerprint(world)
    perfect = unbound.equipment.perfect
    if not perfect:
        own = ("tracking", "spoofer_clock", "capture")
        ideal: dict[str, Any] = {**dict.fromkeys(own), "errors": "inherited", "threat": ""}
        check_attack(dataclasses.replace(unbound, **ideal))
    axes = _check_declarations(unbound, world)
    _check_start(unbound, world, axes)
    if unbound.idle_is_clean:
        _check_idle(unbound, world, axes)
    trial = _AttackTrial(unbound, world, _actions(axes))
    steps = [SimpleNamespace(**record) for record in run_trial(trial)]
    _check_motion(unbound, steps, trial.actions)
    _check_channels(unbound, world, steps)
    _check_slices(trial, steps)
    _check_limits(unbound, world, axes)
    if perfect and unbound.is_smooth:
        _check_rates(unbound, world, axes)
    require_contract(
        _fingerprint(world) == truth,
        "the attack has changed the arrays of the `GroundTruth`, which all "
        "receivers share; copy them",
    )


def _start_episodes(
    bound: Attack, whose: NDArray[np.intp], rows: NDArray[np.intp] | None = None
) -> None:
    """Start an episode in all rows, or in some; their keys follow from `whose`."""
    where = np.arange(len(whose)) if rows is None else rows
    keys = np.stack([whose, whose + 1], axis=1).astype(np.uint64)[where]
    bound.start_episodes(where, keys, np.full(len(where), ONSET))


class _AttackTrial(ContractTrial[Attack]):
    """An attack that is given one action an epoch."""

    word, call = "attack", "command"

    def __init__(
        self,
        unbound: Attack,
        world: GroundTruth,
        actions: Sequence[FloatArray | None],
        starts: NDArray[np.int64] = STARTS,
    ) -> None:
        self.unbound, self.world, self.actions, self.starts = unbound, world, actions, starts
        self.receivers, self.turns = len(starts), len(actions)

    def bind(self, rows: NDArray[np.intp]) -> Attack:
        bound = copy.deepcopy(self.unbound)
        bound.bind(AttackContext(len(rows), self.world))
        _start_episodes(bound, rows)
        return bound

    def reset(self, bound: Attack, mask: NDArray[np.bool_] | None) -> None:
        super().reset(bound, mask)
        rows = np.arange(self.receivers)
        _start_episodes(bound, rows, rows if mask is None else rows[mask])

    def command(
        self, bound: Attack, number: int, rows: NDArray[np.intp], slices: Sequence[tuple[int, int]]
    ) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """Offsets of ranges and range rates, NaN where nothing was written, and the action."""
        given = self.actions[number]
        own = None if given is None else np.ascontiguousarray(given[rows])
        action = None if own is None else own.copy()
        epochs = self.starts[rows] + number
        before = epochs.copy()
        d_range = np.full((len(rows), self.world.channels), np.nan)
        d_rate = d_range.copy()
        for lo, hi in slices:
            bound.command(action, epochs, d_range, d_rate, lo, hi)
        require_contract(
            same_bits(before, epochs) and same_bits(action, own),
            "`command` must not write to `action` or `epochs`; copy them first",
        )
        return d_range, d_rate, action

    def turn(self, bound: Attack, number: int, rows: NDArray[np.intp], spoil: bool) -> Record:
        """Offsets (B, n) [m], [m/s]; displacement and rate (B, a) of the memory; the epoch's length
        (B,) [s]; and what is visible (B, n)."""
        d_range, d_rate, action = self.command(bound, number, rows, [(0, len(rows))])
        for name, array in (("d_range", d_range), ("d_rate", d_rate)):
            require_contract(
                bool(np.isfinite(array).all()),
                f"`command` must write a finite number into every element of `{name}`, for the "
                "receivers lo to hi; 0.0 where there is nothing to change",
            )
        if spoil and action is not None:
            action[:] = 1.0 - action
        after = self.starts[rows] + number + 1
        return {
            "d_range": d_range,
            "d_rate": d_rate,
            "displacement": bound.memory["displacement"].copy(),
            "rate": bound.memory["rate"].copy(),
            "interval": self.world.epoch_time[after] - self.world.epoch_time[after - 1],
            "visible": self.world.visible[after],
        }

    def steps(self) -> list[SimpleNamespace]:
        everyone = np.arange(self.receivers)
        records = self.play(self.bind(everyone), everyone, range(self.turns))
        return [SimpleNamespace(**record) for record in records]


def _actions(axes: int) -> list[FloatArray | None]:
    rng = np.random.default_rng(3)
    actions: list[FloatArray | None] = [
        rng.uniform(-1.5, 1.5, (len(STARTS), axes)) for _ in range(COMMANDS)
    ]
    for k in range(COMMANDS // 3, COMMANDS // 2):
        actions[k] = None
    return actions


def _fingerprint(world: GroundTruth) -> tuple[bytes, ...]:
    arrays = (world.epoch_time, world.satellites, world.visible, world.position_e)
    return tuple(array.tobytes() for array in arrays)


def _check_declarations(attack: Attack, world: GroundTruth) -> int:
    check_described(attack, "attack")
    require_contract(
        isinstance(attack.label, str) and bool(attack.label),
        f"`label` must name the threat, got {attack.label!r}",
    )
    require_contract(
        ("pseudorange-only" in attack.label) != attack.coherent,
        "`label` must say 'pseudorange-only' where the range rates do not follow, and only there; "
        f"got {attack.label!r} with coherent={attack.coherent}",
    )
    captured = attack.select_channels(world)
    named = np.array([bool(name) for name in world.satellite_ids])
    require_contract(
        captured.shape == (world.channels,) and captured.dtype == np.bool_,
        f"`select_channels` must return ({world.channels},) bool, got "
        f"{captured.shape} {captured.dtype}",
    )
    require_contract(
        not (captured & ~named).any(),
        "`select_channels` must not name an empty slot, whose id is ''",
    )
    names = attack.action_names(world)
    require_contract(
        isinstance(names, tuple)
        and len(names) > 0
        and all(isinstance(name, str) and name for name in names)
        and len(set(names)) == len(names),
        f"`action_names` must be a tuple of different names, one an element, got {names!r}",
    )
    return len(names)


def _check_start(attack: Attack, world: GroundTruth, axes: int) -> None:
    bound = copy.deepcopy(attack)
    for receivers in (len(STARTS), 1):
        bound.bind(AttackContext(receivers, world))
        _start_episodes(bound, np.arange(receivers))
        for name in ("displacement", "rate"):
            array = bound.memory.get(name)
            require_contract(
                array is not None and array.shape == (receivers, axes) and not array.any(),
                f"after `bind` the memory must hold {name!r}, zeros of shape {(receivers, axes)}, "
                f"got {array!r}; call `super().bind(context)` first",
            )


def _check_idle(attack: Attack, world: GroundTruth, axes: int) -> None:
    for word, action in (("an action of zeros", np.zeros((len(STARTS), axes))), ("None", None)):
        for step in _AttackTrial(attack, world, [action] * 5).steps():
            require_contract(
                not step.d_range.any() and not step.d_rate.any(),
                f"before any command {word} must leave the measurements as they are, exactly: a "
                "run without attack has to be the clean run, bit for bit; got "
                f"{np.abs(step.d_range).max():g} m and {np.abs(step.d_rate).max():g} m/s",
            )


def _check_motion(
    attack: Attack, steps: Sequence[SimpleNamespace], actions: Sequence[FloatArray | None]
) -> None:
    displacement = np.zeros_like(steps[0].displacement)
    rate = np.zeros_like(displacement)
    by_rate = attack.control != "acceleration"
    for step, action in zip(steps, actions, strict=True):
        tau = step.interval[:, None]
        require_contract(
            not attack.one_sided or bool((step.displacement >= 0.0).all()),
            "offsets of an attack with `one_sided` must not fall below 0, got "
            f"{step.displacement.min():g} m",
        )
        require_contract(
            action is not None or attack.one_sided or same_bits(step.rate, rate),
            "without a command (None) the rate must stay as it is, got a change at "
            f"{first_difference(step.rate, rate)}",
        )
        first = step.rate if by_rate else rate
        moved = displacement + 0.5 * (first + step.rate) * tau
        error = np.abs(step.displacement - moved).max()
        require_contract(
            bool(error <= ROUNDING * (1.0 + np.abs(moved).max())),
            "the displacement must follow from the rate, D+ = D + "
            f"{'v+ tau' if by_rate else '(v + v+) tau / 2'}, got {error:g} m off it; the range "
            "rate of a counterfeit signal is the derivative of its range",
        )
        displacement, rate = step.displacement, step.rate


def _size(attack: Attack, vector: FloatArray) -> float:
    """Largest size of a vector, or of an element, whichever the limits apply to."""
    if isinstance(attack, Offsets):
        return float(max(map(attack.measure_size, vector)))
    if attack.limits_size:
        return float(np.linalg.norm(vector, axis=-1).max())
    return float(np.abs(vector).max())


def _check_limits(attack: Attack, world: GroundTruth, axes: int) -> None:
    acceleration, limit = attack.acceleration_limit_mps2, attack.rate_limit_mps
    by_rate, start = attack.control != "acceleration", np.array([ONSET])
    follows = isinstance(attack, Offsets)
    sign = np.where(np.arange(axes) % 2 == 0, 1.0, -1.0)[None, :]
    epochs = min(world.epochs - ONSET - 2, 400)
    for size in (1.0, 3.0):
        rate = np.zeros((1, axes))
        for step in _AttackTrial(attack, world, [size * sign] * epochs, start).steps():
            found = _size(attack, step.rate)
            require_contract(
                found <= limit * (1.0 + ROUNDING),
                f"the rate must not exceed `rate_limit_mps` = {limit:g}, got {found:g} after "
                f"actions of {size:g}; actions beyond 1 are cut to 1",
            )
            change = _size(attack, step.rate - rate) / float(step.interval[0])
            require_contract(
                (by_rate and not follows) or change <= acceleration * (1.0 + ROUNDING),
                f"the rate must not change by more than `acceleration_limit_mps2` = "
                f"{acceleration:g}, got {change:g} m/s^2 after actions of {size:g}",
            )
            rate = step.rate
    # well below the limits an action is obeyed to the letter
    action = (0.3 if attack.one_sided else -0.3) / np.sqrt(axes) * sign
    step = _AttackTrial(_at_once(attack), world, [action], start).steps()[0]
    unit = attack.action_scales(world) if isinstance(attack, Offsets) else attack.unit_scale
    per = {"rate": 1.0, "acceleration": step.interval[0], "offset": 1.0 / step.interval[0]}
    want = unit * action * per[attack.control]
    require_contract(
        not _size(attack, want) < limit or bool(np.allclose(step.rate, want, ROUNDING, 0.0)),
        f"an action of {action[0, 0]:g} must command {np.ravel(unit)[0]:g} times as much "
        f"({attack.control}), hence a rate of {want[0, 0]:g} m/s, got {step.rate[0, 0]:g}",
    )


def _at_once(attack: Attack) -> Attack:
    """The attack; one that follows wanted rates, with an acceleration that does not limit it."""
    free = attack.rate_limit_mps * 1e3
    follows = isinstance(attack, Offsets)
    return dataclasses.replace(attack, acceleration_limit_mps2=free) if follows else attack


def _check_channels(attack: Attack, world: GroundTruth, steps: Sequence[SimpleNamespace]) -> None:
    captured = attack.select_channels(world)
    for step in steps:
        require_contract(
            not step.d_range[:, ~captured].any() and not step.d_rate[:, ~captured].any(),
            "offsets must be 0 for satellites that are not captured",
        )
        require_contract(
            attack.coherent or not step.d_rate.any(),
            "with coherent=False the range rates must be left alone, got "
            f"{np.abs(step.d_rate).max():g} m/s",
        )
    require_contract(
        attack.capture is not None or bool(np.any([step.d_range for step in steps])),
        "commands must change at least one pseudorange, got none changed",
    )


def _check_rates(attack: Attack, world: GroundTruth, axes: int) -> None:
    if not attack.coherent:
        return
    captured = attack.select_channels(world)
    action = np.full((len(STARTS), axes), 0.5 / np.sqrt(axes))
    actions: list[FloatArray | None] = [action] * COMMANDS
    if attack.control == "offset":  # at a rate that stays
        actions = [action * (k + 1) / COMMANDS for k in range(COMMANDS)]
    for before, step in pairwise(_AttackTrial(_at_once(attack), world, actions).steps()):
        change = step.d_range - before.d_range
        mean_rate = 0.5 * (before.d_rate + step.d_rate)
        error = np.abs(change - mean_rate * step.interval[:, None])
        error = error[captured & before.visible & step.visible]
        require_contract(
            bool((error <= CLOSURE_M).all()),
            "with coherent=True the range rate must be the derivative of the range, else the code "
            "drifts away from the carrier; over one epoch they differ by "
            f"{error.max(initial=0.0):g} m",
        )


def _check_slices(trial: _AttackTrial, steps: Sequence[SimpleNamespace]) -> None:
    everyone = np.arange(trial.receivers)
    bound = trial.bind(everyone)
    for number, step in enumerate(steps):
        slices = [(2, trial.receivers), (0, 2)]
        d_range, d_rate, _ = trial.command(bound, number, everyone, slices)
        require_contract(
            same_bits(d_range, step.d_range) and same_bits(d_rate, step.d_rate),
            "`command` must do the same for receivers lo to hi as for all, since threads share a "
            f"batch; command {number} differs at {first_difference(d_range, step.d_range)}",
        )
    before = copy.deepcopy(bound.memory)
    d_range, d_rate, _ = trial.command(bound, 0, everyone, [(1, 3)])
    others = np.array([0, 3, 4])
    require_contract(
        bool(np.isnan(d_range[others]).all() and np.isnan(d_rate[others]).all())
        and all(same_bits(before[name][others], bound.memory[name][others]) for name in before),
        "`command` must leave receivers outside lo to hi alone, since another thread works on them",
    )
