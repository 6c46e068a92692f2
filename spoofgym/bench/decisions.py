"""A spoofer in front of an engine: what it decides, and what is commanded from epoch to epoch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..envs.decisions import Decisions
from ..envs.observer import Observer
from ..envs.spoofer_binding import bound_spoofer, paced
from ..envs.terms.action import CommandMap
from ..simulators.engine import Engine
from ..simulators.setup import Setup
from ..spoofers import Spoofer
from .entries import build_spoofer

FloatArray = NDArray[np.float64]


def make_bound_spoofer(
    spec: Any, setup: Setup, receivers: int
) -> tuple[Spoofer, Observer, CommandMap]:
    """Spoofer that is ready for a batch, what it observes, and what its actions command."""
    spoofer = build_spoofer(spec)
    context, observer, commands = bound_spoofer(spoofer, setup, receivers)
    spoofer.bind(context)
    spoofer.reset()
    return spoofer, observer, commands


class Attacker:
    """Spoofer that commands all receivers of an engine, which are at their onset.

    - `engine`: its simulator leaves all measurements alone where the spoofer transmits nothing;
    - `spoofer`: bound; it decides at its own pace.
    """

    def __init__(self, spec: Any, engine: Engine) -> None:
        self._spec, self.engine = spec, engine
        made = make_bound_spoofer(spec, engine.setup, engine.receivers)
        self.spoofer, self._observer, self._commands = made
        setup, size = paced(engine.setup, self.spoofer), len(self._commands.names)
        self._decisions = Decisions(setup, engine.receivers, size)
        self._commands.aim(engine.simulator.heading)
        if not self.spoofer.transmits:
            engine.simulator.clean = np.ones(engine.receivers, dtype=np.bool_)

    def command(self, epoch: int) -> FloatArray | None:
        """Command (B, a) of an epoch, counted from the onset on; None after the last one."""
        if epoch >= self.engine.setup.steps:
            return None
        return self._commands.command(self.action(epoch), self.engine.simulator.commanded_rate)

    def action(self, epoch: int) -> FloatArray:
        """Action (B, k) of an epoch, on the way from one decision to the next. Asks the spoofer
        where a decision is due."""
        if self._decisions.due(epoch):
            self._decisions.take(self.decide(epoch))
        return self._decisions.action(epoch)

    def decide(self, epoch: int) -> FloatArray:
        """Action of the spoofer, checked: (B, k) float64, C-contiguous."""
        receivers, word = self.engine.receivers, type(self.spoofer).__name__
        seen = self._observer(self.engine, epoch)
        action = np.ascontiguousarray(self.spoofer.act(seen), dtype=np.float64)
        names = self.spoofer.context.action_names
        if action.shape != (receivers, len(names)):
            raise ValueError(
                f"{word} must return actions of shape {(receivers, len(names))} "
                f"({', '.join(names)}), got {action.shape}"
            )
        if not (np.abs(action) <= 1.0).all():
            worst = action.flat[int(np.argmin(np.abs(action) <= 1.0))]
            raise ValueError(f"{word} must return actions within [-1, 1], got {worst}")
        return action

    def go_on_with(self, engine: Engine, rows: NDArray[np.intp]) -> None:
        """Command an engine of some of the receivers from now on."""
        spoofer, _, self._commands = make_bound_spoofer(self._spec, engine.setup, len(rows))
        self._commands.aim(engine.simulator.heading)
        spoofer.memory.copy_rows(np.arange(len(rows)), self.spoofer.memory, rows)
        self.engine, self.spoofer = engine, spoofer
        self._decisions = self._decisions.of(rows)
