"""Receivers whose episodes end within a decision: they stand still, while the others go on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .engine import Batch, Engine, run_serially


class Kept:
    """What is kept of receivers until the decision is over.

    The engine runs all of its receivers in step.  Those whose episodes are over are put aside as
    they stand at their own end, and put back when the others have come to the next decision.

    `engine`: the receivers, and their twins.
    """

    def __init__(self, engine: Engine) -> None:
        self._batches = [engine.batch] if engine.twin is None else [engine.batch, engine.twin]
        self._copies: list[Batch] = []
        self._aside: NDArray[np.bool_] = np.zeros(engine.receivers, dtype=np.bool_)

    def put_aside(self, rows: NDArray[np.intp]) -> None:
        """Keep some receivers as they are."""
        if not len(rows):
            return
        if not self._copies:  # few games ever need them
            self._copies = [Batch(b.setup, b.receivers, run_serially) for b in self._batches]
        for copy, batch in zip(self._copies, self._batches, strict=True):
            copy.copy_rows(rows, batch, rows)
        self._aside[rows] = True

    def put_back(self) -> None:
        """Let all that have been put aside stand as they stood then."""
        rows = np.flatnonzero(self._aside)
        if not len(rows):
            return
        for copy, batch in zip(self._copies, self._batches, strict=True):
            batch.copy_rows(rows, copy, rows)
        self._aside[:] = False
