"""A pool of frozen opponents: one is drawn for every episode, and the batch stays one batch."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..core.declared import setting, settings_record
from ..core.memory import Memory
from ..core.settings import list_written
from ..receiver.epoch import Epoch
from .base import (
    BoolArray,
    Detector,
    DetectorContext,
    FloatArray,
    IntArray,
    Verdict,
    check_needs,
    find_name,
    judge_epoch,
)
from .build import make_detector, spec_with_thresholds
from .calibrated import unwrap

NATURE, OPPONENT = 1, 2
"""What is drawn for an episode: whether it is attacked, and by which opponent."""


def uniforms(keys: NDArray[np.uint64], purpose: int) -> FloatArray:
    """(b,) numbers, uniform in [0, 1), that depend on the purpose and on the keys (b, 2) of the
    episodes, of the source "domain", alone."""
    words = [
        np.random.SeedSequence([int(k0), int(k1), purpose]).generate_state(1, np.uint64)[0]
        for k0, k1 in keys
    ]
    # the upper 53 bits, which a float holds exactly
    return np.array([int(word) >> 11 for word in words], dtype=np.float64) * 2.0**-53


def normalize_weights(members: int, weights: Sequence[float] | None) -> FloatArray:
    """(K,) probabilities of the opponents; all alike by default."""
    if members < 1:
        raise ValueError("`pool` must have at least one opponent, got none")
    try:
        given = np.ones(members) if weights is None else np.array(weights, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"`weights` must be numbers, got {weights!r}") from error
    if given.shape != (members,):
        raise ValueError(
            f"`weights` must have one number for each of the {members} opponents, got {weights!r}"
        )
    if not (np.isfinite(given).all() and (given >= 0.0).all() and given.sum() > 0.0):
        raise ValueError(f"`weights` must be finite, >= 0, and not all 0, got {weights!r}")
    chances: FloatArray = given / given.sum()
    return chances


def draw_members(keys: NDArray[np.uint64], weights: FloatArray) -> IntArray:
    """(b,) indices into a pool by the keys (b, 2) of episodes, and weights (K,)."""
    found = np.searchsorted(np.cumsum(weights), uniforms(keys, OPPONENT), side="right")
    # rounding of the sum must not lead beyond the last one that can be drawn
    return np.array(np.minimum(found, np.flatnonzero(weights)[-1]), dtype=np.int64)


class JointMemory(Memory):
    """A memory that others go along with: they are reset and moved together."""

    def __init__(self, receivers: int = 0, parts: Sequence[Memory] = ()) -> None:
        super().__init__(receivers)
        self.parts = tuple(parts)

    def reset(self, mask: BoolArray | None = None) -> None:
        super().reset(mask)
        for part in self.parts:
            part.reset(mask)

    def copy_rows(self, to: NDArray[np.intp], other: Memory, rows: NDArray[np.intp]) -> None:
        super().copy_rows(to, other, rows)
        theirs: Any = other
        for mine, part in zip(self.parts, theirs.parts, strict=True):
            mine.copy_rows(to, part, rows)


def _describe_member(member: Any, detector: Detector) -> Any:
    """Name and all settings of a detector that has a name; what was given of any other."""
    name = find_name(type(unwrap(detector)))
    if name is None:
        return member

    def describe_settings(each: Any) -> dict[str, Any]:
        written = list_written(each, (field.name for field in dataclasses.fields(each)))
        return {"name": name, **{key: getattr(each, key) for key in written}}

    return spec_with_thresholds(detector, describe_settings)


@settings_record
class PooledDetector(Detector):
    """A hidden pool: one of its detectors, drawn for every episode, judges it from start to end.

    The draw depends on the key of the episode alone, so that paired runs have the same opponent.
    Where tests of channels and of whole receivers meet in one pool, the statistic is the largest
    ratio of statistic and threshold of a receiver.

    Notes
    -----
    Training against a mixture of frozen opponents is what `lanctot2017` calls an oracle's response.
    """

    members: Sequence[str | Mapping[str, Any] | Detector] = setting(
        default=("snapshot-chi2", "ewma"),
        help="Detectors as `make_detector` takes them; objects are copied.",
    )
    weights: Sequence[float] | None = setting(
        default=None, help="Probability of each member; equal by default."
    )

    paper: ClassVar[str] = "lanctot2017"
    measures: ClassVar[str] = "any"

    def __post_init__(self) -> None:
        if isinstance(self.members, str | Mapping) or not isinstance(self.members, Sequence):
            raise TypeError(f"`members` must be a list of detectors, got {self.members!r}")
        self._chances = normalize_weights(len(self.members), self.weights)
        self.judges = tuple(make_detector(each) for each in self.members)  # type: ignore[misc]
        self.members = tuple(map(_describe_member, self.members, self.judges))
        if any(judge.judges for judge in self.judges):
            raise ValueError("a pool can't be one of the detectors of a pool; list its detectors")
        measures = {judge.measures for judge in self.judges} - {"any"}
        if len(measures) > 1:
            raise ValueError(
                "the detectors of a pool must measure the same, got "
                + ", ".join(f"{type(judge).__name__} ({judge.measures})" for judge in self.judges)
            )
        scopes = {judge.scope for judge in self.judges}
        self._alike = len(scopes) == 1
        # these differ from pool to pool, so that they are the object's, not the class's
        self.measures = measures.pop() if measures else "any"  # type: ignore[misc]
        self.scope = scopes.pop() if self._alike else "receiver"  # type: ignore[misc]
        self.needs = frozenset().union(*map(check_needs, self.judges))  # type: ignore[misc]
        self.oracle = any(judge.oracle for judge in self.judges)  # type: ignore[misc]
        self.from_start = any(judge.from_start for judge in self.judges)
        self.needs_model = any(judge.needs_model for judge in self.judges)

    def bind(self, context: DetectorContext) -> None:
        super().bind(context)
        for judge in self.judges:
            judge.bind(context)
        self.silent_epochs = max(judge.silent_epochs for judge in self.judges)
        self.memory_epochs = max(judge.memory_epochs for judge in self.judges)
        self.memory = JointMemory(context.receivers, [judge.memory for judge in self.judges])
        self.memory.declare("opponent", np.zeros(context.receivers, dtype=np.int64))

    def draw(self, keys: NDArray[np.uint64]) -> None:
        """Draw the opponent of every receiver for new episodes, by their keys (B, 2)."""
        self.memory["opponent"] = draw_members(keys, self._chances)

    def watch(self, epoch: Epoch) -> None:
        for judge in self.judges:
            if judge.from_start:
                judge.watch(epoch)

    def judge(self, epoch: Epoch) -> Verdict:
        merged: Verdict | None = None
        opponent = self.memory["opponent"]
        for k in np.unique(opponent):
            rows = np.flatnonzero(opponent == k)
            verdict = judge_epoch(self.judges[k], epoch, rows)
            weights = verdict.weights
            weights = np.ones(epoch.innovation.shape) if weights is None else weights
            if self._alike:
                verdict = verdict._replace(weights=weights)
            else:
                ratio = (verdict.statistic / verdict.threshold).max(axis=1, keepdims=True)
                alarm = np.asarray(verdict.alarm.any(axis=1, keepdims=True))
                verdict = Verdict(ratio, np.ones_like(ratio), alarm, weights)
            if merged is None:
                copies: list[Any] = [None if part is None else np.array(part) for part in verdict]
                merged = Verdict(*copies)
                continue
            for whole, part in zip(merged, verdict, strict=True):
                if whole is not None and part is not None:
                    whole[rows] = part[rows]
        if merged is None:
            raise ValueError("there is no receiver to judge")
        return merged
