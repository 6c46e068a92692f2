"""Pools of frozen opponents for the views of one agent: detectors, and spoofers."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..detectors import Detector, make_detector
from ..detectors.pool import PooledDetector, checked_weights, drawn
from ..envs.observer import Observer
from ..envs.options import checked_action
from ..envs.spoofer_binding import card_behind, spoofer_context, warn_of_headings
from ..envs.terms.base import Snapshot
from ..envs.terms.observation import default_terms
from ..simulators.setup import Setup
from ..spoofers import SUFFIX, Spoofer, make_spoofer
from .agent import PolicyDetector
from .onnx_detector import OnnxDetector

FloatArray = NDArray[np.float64]
DetectorSpec = str | Mapping[str, Any] | Detector
SpooferSpec = str | Mapping[str, Any] | Spoofer


def members_of(pool: Any, kind: type) -> list[Any]:
    """Opponents as a list, where a single one may stand for itself."""
    if isinstance(pool, str | Mapping | kind):
        return [pool]
    if not isinstance(pool, Sequence):
        raise TypeError(f"`pool` must be an opponent or a list of opponents, got {pool!r}")
    return list(pool)


def label_of(spec: Any) -> str:
    """Short name of an opponent."""
    if isinstance(spec, Mapping):
        return ", ".join(
            str(value) if name == "name" else f"{name}={value}" for name, value in spec.items()
        )
    return spec if isinstance(spec, str) else type(spec).__name__


def make_opponent(spec: DetectorSpec) -> Detector:
    """Detector of a pool."""
    settings: dict[str, Any] = dict(spec) if isinstance(spec, Mapping) else {"name": spec}
    name = settings.pop("name", None)
    if not (isinstance(name, str) and name.endswith(SUFFIX)):
        return make_detector(dict(spec) if isinstance(spec, Mapping) else spec)
    policy = OnnxDetector(name)
    card = policy.card
    threshold = settings.pop("threshold", card.threshold)
    if settings:
        raise ValueError(
            f"the detector policy {name} has no setting {', '.join(map(repr, settings))}; valid: "
            "threshold"
        )
    if threshold is None:
        raise ValueError(
            f"{name} has no threshold on its card: calibrate it by spoofgym.duel_v0.calibrate, "
            "and give it as `threshold`"
        )
    return PolicyDetector(
        statistic=card.statistic,
        weighs=card.weighs,
        exclusion_s=card.exclusion_s,
        policy=policy,
        threshold=threshold,
        decision_delay=card.decision_delay,
    )


def pooled_detector(
    pool: Sequence[DetectorSpec] | DetectorSpec, weights: Sequence[float] | None, live: int
) -> PooledDetector:
    """Detectors of which one is drawn for every episode.

    `weights`: probability of each; all alike by default.
    """
    made = [make_opponent(spec) for spec in members_of(pool, Detector)]
    members = [
        dataclasses.replace(one, quiet_epochs=live) if isinstance(one, PolicyDetector) else one
        for one in made
    ]
    return PooledDetector(members, weights)


class SpooferPool:
    """Spoofers of which one commands a receiver for a whole episode.

    Every spoofer that has a receiver at present is called once a decision, with the observations
    that its knowledge allows, for all receivers; each receiver takes the command of its own.

    `weights`: probability of each; all alike by default; `opponent` (B,) index of the spoofer of
    every receiver.
    """

    def __init__(
        self,
        pool: Sequence[SpooferSpec] | SpooferSpec,
        weights: Sequence[float] | None,
        setup: Setup,
        receivers: int,
    ) -> None:
        specs = members_of(pool, Spoofer)
        self.labels = tuple(label_of(spec) for spec in specs)
        self._chances = checked_weights(len(specs), weights)
        self._observers: dict[str, Observer] = {}
        self._spoofers = [self._made(spec, setup, receivers) for spec in specs]
        warn_of_headings(self._spoofers, setup)
        self._action_names = setup.action_names
        self._shape = receivers, len(self._action_names)
        self.opponent = np.zeros(receivers, dtype=np.int64)

    def _made(self, spec: SpooferSpec, setup: Setup, receivers: int) -> Spoofer:
        made = make_spoofer(dict(spec) if isinstance(spec, Mapping) else spec)
        observer = self._observers.setdefault(
            made.knowledge, Observer(default_terms(setup, made.knowledge), setup)
        )
        context = spoofer_context(setup, receivers, observer)
        card = card_behind(spec, made)
        found = [] if card is None else card.differences(context)
        if found:
            raise ValueError(
                f"the spoofer {label_of(spec)!r} does not fit this duel on "
                f"{setup.name!r}:\n  " + "\n  ".join(found)
            )
        made.bind(context)
        made.reset()
        return made

    def begin(self, rows: NDArray[np.intp], keys: NDArray[np.uint64]) -> None:
        """Draw the opponents of new episodes.  `keys` (b, 2) keys of the episodes."""
        self.opponent[rows] = drawn(keys, self._chances)
        mask = np.zeros(len(self.opponent), dtype=np.bool_)
        mask[rows] = True
        for spoofer in self._spoofers:
            spoofer.reset(mask)

    def act(self, snapshot: Snapshot, rows: NDArray[np.intp]) -> FloatArray:
        """Let the spoofers of some receivers decide; those of the others do nothing.

        Returns (B, a) float64, 0 for the others.
        """
        command = np.zeros(self._shape)
        seen: dict[str, NDArray[np.float32]] = {}
        for k in np.unique(self.opponent[rows]):
            spoofer = self._spoofers[k]
            if spoofer.knowledge not in seen:
                seen[spoofer.knowledge] = self._observers[spoofer.knowledge].observe(snapshot)
            before = {name: np.array(array) for name, array in spoofer.memory.items()}
            action = self._checked(k, spoofer.act(seen[spoofer.knowledge]))
            for name, array in before.items():
                array[rows] = spoofer.memory[name][rows]
                spoofer.memory[name] = array
            own = rows[self.opponent[rows] == k]
            command[own] = action[own]
        return command

    def _checked(self, k: int, action: Any) -> FloatArray:
        """Action of a spoofer for all receivers, as the duel takes it."""
        try:
            return checked_action(action, self._shape, self._action_names)
        except (TypeError, ValueError) as error:
            raise ValueError(f"the spoofer {self.labels[k]!r} of the pool: {error}") from error
