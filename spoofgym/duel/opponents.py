"""Pools of frozen opponents for the views of one agent: detectors, and spoofers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..detectors import Calibrated, Detector, detector_in_world
from ..detectors.learned import PolicyDetector
from ..detectors.pool import PooledDetector, draw_members, normalize_weights
from ..envs.context import apply_pace, warn_of_headings
from ..envs.observer import Observer
from ..envs.options import checked_action
from ..envs.spoofer_binding import bound_spoofer
from ..envs.terms.action import CommandMap, Decisions
from ..envs.terms.observation import Snapshot
from ..simulation.setup import Setup
from ..spoofers import Spoofer, make_spoofer
from ..spoofers.build import SpooferSpec

FloatArray = NDArray[np.float64]
DetectorSpec = str | Mapping[str, Any] | Detector


def list_opponents(pool: Any, kind: type) -> list[Any]:
    """Opponents as a list, where a single one may stand for itself."""
    if isinstance(pool, str | Mapping | kind):
        return [pool]
    if not isinstance(pool, Sequence):
        raise TypeError(f"`pool` must be an opponent or a list of opponents, got {pool!r}")
    return list(pool)


def label_opponent(spec: Any) -> str:
    if isinstance(spec, Mapping):
        return ", ".join(
            str(value) if name == "name" else f"{name}={value}" for name, value in spec.items()
        )
    if isinstance(spec, str):
        return spec
    return str(getattr(spec, "label", None) or type(spec).__name__)


def make_opponent(spec: DetectorSpec, quiet_epochs: int = 0) -> Detector:
    """Detector of a pool, at the default rate of false alarms where it requests no thresholds; a
    policy without `quiet_epochs` of its own gets these."""
    made = detector_in_world(spec)
    inner: Any = made.detector if isinstance(made, Calibrated) else made
    policy = getattr(inner, "judge_by", inner)
    if isinstance(policy, PolicyDetector) and policy.quiet_epochs is None:
        policy.quiet_epochs = quiet_epochs
    return made


def pooled_detector(
    pool: Sequence[DetectorSpec] | DetectorSpec, weights: Sequence[float] | None, live: int
) -> PooledDetector:
    """Detectors of which one is drawn for every episode, by `weights`."""
    return PooledDetector(
        [make_opponent(spec, live) for spec in list_opponents(pool, Detector)], weights
    )


class SpooferPool:
    """Spoofers of which one, `opponent` (B,), commands a receiver for a whole episode.

    Every one that has a receiver is called once a decision, its own or the world's, for all of
    them, with what its knowledge allows; each receiver takes the command of its own.
    """

    def __init__(
        self,
        pool: Sequence[SpooferSpec] | SpooferSpec,
        weights: Sequence[float] | None,
        setup: Setup,
        receivers: int,
    ) -> None:
        specs = list_opponents(pool, Spoofer)
        self.labels = tuple(label_opponent(spec) for spec in specs)
        self._chances = normalize_weights(len(specs), weights)
        self._observers: dict[tuple[str, bool], Observer] = {}
        self._seeing: list[tuple[str, bool]] = []
        self._commands: list[CommandMap] = []
        self._decisions: list[Decisions] = []
        self._spoofers = [self._bind_spoofer(spec, setup, receivers) for spec in specs]
        warn_of_headings(self._spoofers, setup)
        self._shape = receivers, len(setup.action_names)
        self.opponent = np.zeros(receivers, dtype=np.int64)

    def _bind_spoofer(self, spec: SpooferSpec, setup: Setup, receivers: int) -> Spoofer:
        made = make_spoofer(spec)
        context, observer, commands = bound_spoofer(made, setup, receivers)
        own, late = apply_pace(setup, made), setup.repeat > 1
        if commands.setpoint_mps is not None and late:
            raise ValueError(
                f"the spoofer {label_opponent(spec)!r} acts by set-points, which the acceleration "
                "follows at every epoch: it can't be in a pool with a `decision_interval_s`"
            )
        self._commands.append(commands)
        # those of different commands differ in what they see of their own
        key = made.knowledge, commands.along_target
        self._seeing.append(key)
        self._observers.setdefault(key, observer)
        made.bind(context)
        made.reset()
        # where the world has decisions, the duel makes epochs of them
        pace = setup.copy_with(pace=(None, "hold")) if late else own
        self._decisions.append(Decisions(pace, receivers, len(commands.names)))
        return made

    def start_episodes(self, rows: NDArray[np.intp], keys: NDArray[np.uint64]) -> None:
        """Draw the opponents of new episodes.  `keys` (b, 2) keys of the episodes."""
        self.opponent[rows] = draw_members(keys, self._chances)
        mask = np.zeros(len(self.opponent), dtype=np.bool_)
        mask[rows] = True
        for spoofer, decisions in zip(self._spoofers, self._decisions, strict=True):
            spoofer.reset(mask)
            decisions.forget(rows)

    def act(self, snapshot: Snapshot, rows: NDArray[np.intp]) -> FloatArray:
        """Let the spoofers of some receivers decide; those of the others do nothing. Returns (B, a)
        float64, 0 for the others."""
        command = np.zeros(self._shape)
        seen: dict[tuple[str, bool], NDArray[np.float32]] = {}
        for k in np.unique(self.opponent[rows]):
            own, decisions = rows[self.opponent[rows] == k], self._decisions[k]
            due = own[decisions.due(snapshot.step[own])]
            if len(due):
                key = self._seeing[k]
                if key not in seen:
                    seen[key] = self._observers[key].observe(snapshot)
                decisions.take(self._decide(k, seen[key], due), due)
            self._commands[k].aim(snapshot.simulator.heading)
            taken = decisions.action(snapshot.step)
            command[own] = self._commands[k].command(taken, snapshot.simulator.commanded_rate)[own]
        return command

    def _decide(self, k: int, seen: NDArray[np.float32], rows: NDArray[np.intp]) -> FloatArray:
        """Action of a spoofer for all receivers; its memory goes on for some of them."""
        spoofer, names = self._spoofers[k], self._commands[k].names
        before = {name: np.array(array) for name, array in spoofer.memory.items()}
        action = spoofer.act(seen)
        for name, array in before.items():
            array[rows] = spoofer.memory[name][rows]
            spoofer.memory[name] = array
        try:
            return checked_action(action, (self._shape[0], len(names)), names)
        except (TypeError, ValueError) as error:
            raise ValueError(f"the spoofer {self.labels[k]!r} of the pool: {error}") from error
