"""Attacks without a receiver: one command an epoch, and what it writes."""

from __future__ import annotations

import numpy as np

from spoofgym.attacks import AttackContext

ONSET = 30


def begin(attack, world, receivers=1, onset=ONSET):
    """Bind an attack, and begin an episode with a key of its own in every receiver."""
    attack.bind(AttackContext(receivers, world))
    rows = np.arange(receivers)
    keys = np.stack([rows + 1, rows + 7], axis=1).astype(np.uint64)
    attack.start_episodes(rows, keys, np.full(receivers, onset))


def offsets(attack, world, actions, receivers=1, onset=ONSET):
    """(K, B, n) offsets of ranges and of range rates after each of some commands (a,), or None."""
    begin(attack, world, receivers, onset)
    epochs = np.full(receivers, onset)
    ranges, rates = [], []
    for action in actions:
        given = None if action is None else np.tile(np.array(action, dtype=float), (receivers, 1))
        d_range, d_rate = np.empty((2, receivers, world.channels))
        attack.command(given, epochs, d_range, d_rate, 0, receivers)
        epochs = epochs + 1
        ranges.append(d_range)
        rates.append(d_rate)
    return np.array(ranges), np.array(rates)
