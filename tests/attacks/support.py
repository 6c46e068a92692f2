"""Attacks without a receiver: one command an epoch, and what it writes."""

from functools import cache

import numpy as np
import pytest

from spoofgym.attacks import AttackContext
from spoofgym.earth.wgs84 import range_and_rate
from spoofgym.truth.scenario import Scenario

from ..lazily import Lazily

ONSET = 30


@cache
def default_world():
    return Scenario().world()


WORLD = Lazily(default_world)


def begin(attack, world, receivers=1, onset=ONSET):
    attack.bind(AttackContext(receivers, world))
    rows = np.arange(receivers)
    keys = np.stack([rows + 1, rows + 7], axis=1).astype(np.uint64)
    attack.start_episodes(rows, keys, np.full(receivers, onset))


def offsets(attack, actions, receivers=1, onset=ONSET, world=None, watch=""):
    """(K, B, n) offsets of ranges and of range rates after each of some commands (a,), or None; or
    (K, B, ...) what the attack remembers by a name."""
    world = world or default_world()
    begin(attack, world, receivers, onset)
    epochs, found = np.full(receivers, onset), []
    for action in actions:
        given = None if action is None else np.tile(np.array(action, dtype=float), (receivers, 1))
        written = np.full((2, receivers, world.channels), np.nan)
        attack.command(given, epochs, *written, 0, receivers)
        epochs = epochs + 1
        found.append(attack.memory[watch].copy() if watch else written)
    return np.array(found) if watch else np.array(found).swapaxes(0, 1)


def check_displaced(world, k, d_range, d_rate, shift, speed, delay=0.0, change=0.0):
    """Offsets (n,) at epoch k have to be those of an antenna displaced by `shift` that moves by
    `speed` more, ECEF, and of a delay that changes."""
    r, v, seen = world.position_e[k], world.velocity_e[k], world.visible[k]
    for s in np.flatnonzero(seen):
        satellite = world.satellites[k, s, :3], world.satellites[k, s, 3:6]
        there = range_and_rate(*satellite, r + shift, v + speed)
        here = range_and_rate(*satellite, r, v)
        assert d_range[s] == pytest.approx(there[0] - here[0] + delay, abs=3e-8)
        assert d_rate[s] == pytest.approx(there[1] - here[1] + change, abs=1e-9)
