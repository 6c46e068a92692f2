"""Observations of a list of terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from .engine import Engine
from .observations import KNOWLEDGE, DynamicTerm, ObservationTerm
from .setup import Setup
from .snapshot import Snapshot

FloatArray = NDArray[np.float64]


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
    knowledge : str
        The highest level that any term takes.
    """

    def __init__(self, terms: Sequence[ObservationTerm], setup: Setup) -> None:
        if not terms:
            raise ValueError("an observation needs at least one term")
        self.setup = setup
        self._parts: list[tuple[DynamicTerm, slice]] = []
        names: list[str] = []
        low: list[float] = []
        high: list[float] = []
        tables: list[FloatArray] = []
        for term in terms:
            own = term.names(setup)
            part = slice(len(names), len(names) + len(own))
            least, most = term.bounds(setup)
            names.extend(own)
            low.extend([least] * len(own))
            high.extend([most] * len(own))
            if hasattr(term, "table"):
                tables.append(np.clip(term.table(setup), least, most))
            else:
                self._parts.append((cast("DynamicTerm", term), part))
                tables.append(np.zeros((setup.world.epochs, len(own))))
        self._table = np.hstack(tables).astype(np.float32)
        self.names = tuple(names)
        if len(set(names)) < len(names):
            twice = sorted({name for name in names if names.count(name) > 1})
            raise ValueError(f"two terms write the same observation: {', '.join(twice)}")
        self.low = np.array(low, dtype=np.float32)
        self.high = np.array(high, dtype=np.float32)
        self._bounds = np.zeros((2, 0, len(names)), dtype=np.float32)
        self.knowledge = KNOWLEDGE[max(KNOWLEDGE.index(term.knowledge) for term in terms)]

    def observe(self, snapshot: Snapshot) -> NDArray[np.float32]:
        """Observe the game.

        Parameters
        ----------
        snapshot : Snapshot
            The game.

        Returns
        -------
        ndarray
            (B, o) float32, a new array within the bounds.
        """
        out = self._table.take(snapshot.batch.epochs, axis=0)
        for term, part in self._parts:
            term(snapshot, out[:, part])
        if self._parts:
            if self._bounds.shape[1] != len(out):
                self._bounds = np.repeat(np.array([self.low, self.high])[:, None], len(out), axis=1)
            # min and max, since np.clip costs three times as much on small arrays, and of equal
            # shapes, since a part or a row is a short loop each; the table lies within the bounds
            np.maximum(out, self._bounds[0], out=out)
            np.minimum(out, self._bounds[1], out=out)
        return out

    def __call__(self, engine: Engine, step: int) -> NDArray[np.float32]:
        """Observe receivers that are all at the same step.

        Parameters
        ----------
        engine : Engine
            The receivers.
        step : int
            Commands given since the attack began.

        Returns
        -------
        ndarray
            (B, o) float32.
        """
        steps = np.full(engine.receivers, step, dtype=np.int64)
        return self.observe(Snapshot(self.setup, engine.batch, steps))
