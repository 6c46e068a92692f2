"""Observations of a list of terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..simulation.domain import FloatArray
from ..simulation.engine import Engine
from ..simulation.setup import Setup
from ..spoofers.base import LEVELS, REPORTED
from ._kernels import COMMAND_COLUMN, clip_columns, observe
from .terms.observation import (
    DynamicTerm,
    ObservationTerm,
    Snapshot,
    holds_for_call,
    split_knowledge,
)


class Observer:
    """Observations of a list of terms.

    Parameters
    ----------
    terms : sequence of ObservationTerm
        In the order of the observation.
    setup : Setup
        World, attack and detector.

    Attributes
    ----------
    names : tuple of str
        (o,) name of every element.
    low, high : ndarray
        (o,) float32 bounds.
    latent_names : tuple of str
        Elements that may hold an error of the victim's estimate.
    knowledge : str
        The highest level that any term takes, and ``+reported`` where one takes that.
    table : ndarray
        (K, o) float32 at every epoch, within the bounds; 0 where a dynamic term writes later.
    command, per_rate : tuple of float, ndarray
        Last elements of the rules of `_kernels.observe`, and (a,) factor on the rate of every axis.
    dynamic : bool
        Whether there are terms that depend on what has happened, apart from the own command.
    """

    def __init__(self, terms: Sequence[ObservationTerm], setup: Setup) -> None:
        if not terms:
            raise ValueError("an observation needs at least one term")
        self.setup = setup
        self._parts: list[tuple[DynamicTerm, slice]] = []
        names: list[str] = []
        latent: list[str] = []
        low: list[float] = []
        high: list[float] = []
        tables: list[tuple[slice, FloatArray]] = []
        self.command: tuple[float, ...] = (-1.0, 0.0, 0.0, 0.0, -1.0, -1.0)
        self.per_rate = np.zeros(len(setup.action_names))
        for term in terms:
            own = term.names(setup)
            part = slice(len(names), len(names) + len(own))
            least, most = term.bounds(setup)
            names.extend(own)
            latent.extend(own if getattr(term, "latent", True) else ())
            low.extend([least] * len(own))
            high.extend([most] * len(own))
            table = term.table(setup) if hasattr(term, "table") else None
            if table is not None:
                tables.append((part, np.clip(table, least, most)))
                continue
            if holds_for_call(term, "factors"):
                per_displacement, self.per_rate, *axes = cast("Any", term).factors(setup)
                self.command = (float(part.start), per_displacement, least, most, *axes)
            else:
                self._parts.append((cast("DynamicTerm", term), part))
        # zeros that nothing is written to take no memory
        self.table = np.zeros((len(setup.epoch_time), len(names)), dtype=np.float32)
        for part, values in tables:
            self.table[:, part] = values
        self._rules = np.array([0.0] * COMMAND_COLUMN + list(self.command))
        self.names = tuple(names)
        self.latent_names = tuple(latent)
        if len(set(names)) < len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise ValueError(f"two terms write the same observation: {', '.join(twice)}")
        self.low = np.array(low, dtype=np.float32)
        self.high = np.array(high, dtype=np.float32)
        self.dynamic = bool(self._parts)
        own_parts = [part for _, part in self._parts]
        self._clipped = (
            min((part.start for part in own_parts), default=0),
            max((part.stop for part in own_parts), default=0),
        )
        levels, reported = zip(*(split_knowledge(term.knowledge) for term in terms), strict=True)
        self.knowledge = LEVELS[max(levels)] + (f"+{REPORTED}" if any(reported) else "")

    def observe(self, snapshot: Snapshot) -> NDArray[np.float32]:
        """Observe the episodes: (B, o) float32, a new array within the bounds."""
        epochs, _, displacement, rate, direction = snapshot.simulator.step_arrays()
        out = np.empty((len(epochs), len(self.names)), dtype=np.float32)
        everyone = 0, len(out)
        fixed = self._rules, self.per_rate, self.table, epochs
        observe(*fixed, displacement, rate, direction, out, *everyone)
        if self.dynamic:
            self.complete(snapshot, out)
        return out

    def complete(self, snapshot: Snapshot, out: NDArray[np.float32]) -> None:
        """Write the terms that the kernel does not; `out` (B, o)."""
        for term, part in self._parts:
            term(snapshot, out[:, part])
        # all else lies within the bounds
        clip_columns(out, self.low, self.high, *self._clipped)

    def __call__(self, engine: Engine, step: int) -> NDArray[np.float32]:
        """(B, o) of receivers that have all had `step` commands since the attack started."""
        steps = np.full(engine.receivers, step, dtype=np.int64)
        return self.observe(Snapshot(self.setup, engine.simulator, steps))
