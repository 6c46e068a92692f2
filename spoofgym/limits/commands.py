"""What an attack adds to the measurements, as a linear function of its commands.

The commands are rates of the attack's axes, one vector for every decision; the last one is held
over the time to alert, as the environment does.  An attack that is commanded by acceleration comes
to the rate of a decision at the end of it, along a line.  The columns are found by commanding the
attack itself, one unit at a time, so that any attack has them: its geometry, satellites that rise
and set, a capture that comes late.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..attacks import Attack, AttackContext
from ..simulators.tightly_coupled import TightlyCoupledSetup

FloatArray = NDArray[np.float64]
SMALL = 0.1
"""Part of the limit of the rate that a unit command is tried with."""
LINEAR_TO = 0.02
"""How far the response to commands may be from the sum of those to its parts, as a part of it."""


class Commands(NamedTuple):
    """Offsets of the measurements by command, over the K epochs of attack and time to alert.

    Attributes
    ----------
    offsets : ndarray
        (K, m, J) by unit command of 1 m/s; J = decisions x axes, the axes of a decision together;
        or hat functions x axes.
    idle : ndarray
        (K, m) of an attack that is commanded nothing.
    axes : int
        Elements of a command.
    heading : ndarray or None
        (axes, 2) north and east of each axis, where it moves a position.
    rate_limit_mps : float
        Of a command, as the size of the vector where `together`.
    change_limit_mps : float
        Of the difference between the commands of neighbouring decisions; infinite for an attack
        that is commanded by rate.
    together : bool
        Whether the limits hold for the vector of a decision, not for each of its elements.
    hats : ndarray or None
        (decisions, Q) hat functions that the commands are of, or None for single decisions.
    """

    offsets: FloatArray
    idle: FloatArray
    axes: int
    heading: FloatArray | None
    rate_limit_mps: float
    change_limit_mps: float
    together: bool
    hats: FloatArray | None = None

    @property
    def decisions(self) -> int:
        """Number of decisions."""
        return int(self.offsets.shape[2]) // self.axes if self.hats is None else len(self.hats)

    @property
    def rates(self) -> FloatArray:
        """(decisions, axes, J) rate of each axis by unit command."""
        hats = np.eye(self.decisions) if self.hats is None else self.hats
        each = np.einsum("dq,ab->daqb", hats, np.eye(self.axes))
        return np.asarray(each.reshape(len(hats), self.axes, -1))

    def in_hats(self, count: int) -> Commands:
        """Commands whose rates are sums of hat functions, where there are more decisions."""
        if self.hats is not None or self.decisions <= count:
            return self
        hats = hat_functions(self.decisions, count)
        epochs, m = self.offsets.shape[:2]
        each = self.offsets.reshape(epochs, m, self.decisions, self.axes)
        offsets = np.einsum("kmda,dq->kmqa", each, hats).reshape(epochs, m, -1)
        return self._replace(offsets=offsets, hats=hats)


def hat_functions(decisions: int, count: int) -> FloatArray:
    """(decisions, Q) piecewise linear functions that are 1 at one of Q equally spaced decisions."""
    if decisions <= count:
        return np.eye(decisions)
    places = np.linspace(0.0, decisions - 1.0, count)
    t = np.arange(decisions)[:, None]
    width = places[1] - places[0]
    return np.asarray(np.clip(1.0 - np.abs(t - places) / width, 0.0, None))


def bare(attack: Attack, decision_s: float) -> Attack:
    """The attack with perfect equipment but for the capture, and any rate by the next decision.
    Errors of tracking and of the spoofer's clock add divergence from clean measurements, and so do
    other errors than the authentic ones, whatever the commands are."""
    perfect: Any = {"tracking": None, "spoofer_clock": None, "errors": "inherited"}
    quick = attack.rate_limit_mps / decision_s
    return replace(attack, acceleration_limit_mps2=quick, **perfect)


def unit_commands(setup: TightlyCoupledSetup, onset: int) -> Commands:
    """Offsets by command of an episode.

    Parameters
    ----------
    setup : TightlyCoupledSetup
        World, attack, timeline and decisions.
    onset : int
        Epoch of the world after which the attack starts, `LinearRun.onset`.

    Returns
    -------
    Commands
        Of every decision by itself.

    Raises
    ------
    ValueError
        When the offsets are not linear in the commands.
    """
    repeat, decision_s = setup.repeat, setup.repeat * setup.interval_s
    attack, by_rate = bare(setup.attack, decision_s), setup.attack.control == "rate"
    axes, decisions = len(attack.action_names(setup.world)), setup.steps // repeat
    count = axes * decisions
    size = SMALL * np.eye(count).reshape(count, decisions, axes)
    tried = np.concatenate([size, np.zeros((1, decisions, axes)), _some(decisions, axes)])
    found = _offsets(setup, attack, onset, tried)
    idle = found[:, :, count]
    offsets = (found[:, :, :count] - idle[:, :, None]) / (SMALL * attack.rate_limit_mps)
    _check_linear(attack, offsets, idle, found[:, :, count + 1 :], tried[count + 1 :])
    names = attack.action_names(setup.world)
    places = {"north": (1.0, 0.0), "east": (0.0, 1.0), "down": (0.0, 0.0)}
    words = [name.rsplit("_", 1)[0] for name in names]
    heading = np.array([places[word] for word in words]) if set(words) <= set(places) else None
    return Commands(
        offsets,
        idle,
        axes,
        heading,
        attack.rate_limit_mps,
        math.inf if by_rate else setup.attack.acceleration_limit_mps2 * decision_s,
        heading is not None,
    )


def _some(decisions: int, axes: int) -> FloatArray:
    """(2, decisions, axes) commands to try linearity with: one forward, one that changes."""
    t = np.linspace(0.0, 1.0, decisions)[:, None]
    turned = np.cos(2.0 * np.pi * t + np.arange(axes)) + 1.0
    return 0.25 * np.stack([np.ones((decisions, axes)), turned])


def _offsets(
    setup: TightlyCoupledSetup, attack: Attack, onset: int, rates: FloatArray
) -> FloatArray:
    """(K, m, R) offsets of R sequences of rates (R, decisions, axes), 1 the limit; 0 unseen."""
    count, world = len(rates), setup.world
    by_rate = attack.control == "rate"
    actions = rates if by_rate else np.diff(rates, axis=1, prepend=0.0)
    attack.bind(AttackContext(count, world))
    at = np.full(count, onset)
    attack.begin(np.arange(count), np.zeros((count, 2), dtype=np.uint64), at.copy())
    d_range, d_rate = np.zeros((2, count, world.channels))
    out = np.empty((setup.steps + setup.hold, 2 * world.channels, count))
    before = np.zeros(actions[:, 0].shape)
    for k in range(len(out)):
        command = None
        if k < setup.steps:
            decision, epoch = divmod(k, setup.repeat)
            action = actions[:, decision]
            command = np.ascontiguousarray(
                setup.command(before, action, epoch) if by_rate else action
            )
            if epoch == setup.repeat - 1:
                before = action
        attack.command(command, at, d_range, d_rate, 0, count)
        at = at + 1
        seen = np.tile(world.visible[at[0]], 2)
        out[k] = np.concatenate([d_range, d_rate], axis=1).T * seen[:, None]
    return out


def _check_linear(
    attack: Attack, offsets: FloatArray, idle: FloatArray, found: FloatArray, tried: FloatArray
) -> None:
    """Compare what commands do with the sum of their parts."""
    commands = tried.reshape(len(tried), -1).T * attack.rate_limit_mps
    expected = offsets @ commands + idle[:, :, None]
    n = offsets.shape[1] // 2
    for rows in (slice(0, n), slice(n, None)):
        size = np.abs(found[:, rows] - idle[:, rows, None]).max()
        wrong = np.abs(expected[:, rows] - found[:, rows]).max()
        if wrong > LINEAR_TO * max(size, 1e-9):
            raise ValueError(
                f"what {attack.label!r} adds to the measurements is not linear in its commands: "
                f"{100.0 * wrong / max(size, 1e-9):.1f} % off, at most {100.0 * LINEAR_TO:g} % is "
                "taken for linear; no limit is known for it"
            )
