"""The attack that a policy's actions are added to, so that it starts from the best one known."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..policies.card import SpooferCard
from .base import TARGET_NAMES, FloatArray, ScriptedSpoofer, Spoofer, SpooferContext
from .profile import ActionCurves
from .scaled import Scaled

SHARE = 0.4
"""Scale of corrections, as a part of the largest action of a base over an episode."""
SUFFIX = "_correction"
"""What the name of an action's element ends in that is added to a base."""


def change_file(action: Any, change: Callable[[str], str]) -> Any:
    """Action terms as a card has them, with another path of the file of the base that they
    correct, if there is one."""

    def change_term(term: Any) -> Any:
        base = term.get("spoofer") if isinstance(term, Mapping) else None
        if not isinstance(base, Mapping) or "file" not in base:
            return term
        return {**term, "spoofer": {**base, "file": change(base["file"])}}

    return [change_term(each) for each in action] if isinstance(action, list) else action


def check_base(spoofer: Spoofer) -> None:
    """Refuse a spoofer that no card can name, or that corrects a base itself."""
    inner = spoofer.spoofer if isinstance(spoofer, Scaled) else spoofer
    if hasattr(inner, "model") and not hasattr(inner, "card"):
        raise ValueError(
            f"the model {spoofer.label!r} in memory can't be a base, which cards have to name: "
            "write it by `spoofgym.export.onnx`, and give the file"
        )
    terms = spoofer.action_terms
    for each in terms if isinstance(terms, list) else [terms]:
        if isinstance(each, Mapping) and each.get("name") == "residual":
            base = each.get("spoofer")
            raise ValueError(
                f"the base {spoofer.label!r} corrects a base itself, and a policy corrects only "
                f"one: take {base!r} itself as the base"
            )


class BaseAttack(NamedTuple):
    """A spoofer that is not bound yet, and what a correction of 1 adds to its actions; None for
    `SHARE` of the largest that it takes."""

    spoofer: Spoofer
    scale: float | None

    def bind(self, context: SpooferContext) -> BoundBase:
        """The base for the receivers of a policy's context, whose actions are corrections."""
        names = tuple(name.removesuffix(SUFFIX) for name in context.action_names)
        own = context._replace(action_names=names, base=None)
        seen, card = context.observation_names, getattr(self.spoofer, "card", None)
        columns = slice(None)
        if isinstance(card, SpooferCard):
            assert card.observation is not None  # as of every policy
            own, columns = _narrow(own, card.observation.names, seen, card.name)
            if found := card.diff_context(own):
                raise ValueError(f"the base {card.name!r} does not fit: {'; '.join(found)}")
        scale = self.scale
        if scale is None:
            scale = SHARE * self._find_largest(own)
        made = copy.deepcopy(self.spoofer)  # several parts of a batch may have one each
        made.bind(own)
        made.reset()
        return BoundBase(made, columns, scale)

    def _find_largest(self, context: SpooferContext) -> float:
        """Largest action over an episode; a base that looks at more than a direction has none that
        is known beforehand."""
        plain = self.spoofer.spoofer if isinstance(self.spoofer, Scaled) else self.spoofer
        planned = isinstance(plain, ScriptedSpoofer | ActionCurves)
        if not (planned and plain.knowledge.startswith("blind")):
            raise ValueError(
                f"`scale` must be given with the base {self.spoofer.label or self.spoofer!r}, "
                "whose actions depend on what it sees"
            )
        made = copy.deepcopy(self.spoofer)
        made.bind(context._replace(receivers=1))
        made.reset()
        seen = np.zeros((1, len(context.observation_names)), dtype=np.float32)
        if TARGET_NAMES[0] in context.observation_names:
            seen[0, context.observation_names.index(TARGET_NAMES[0])] = 1.0
        largest = max(float(np.abs(made.act(seen)).max()) for _ in range(context.steps))
        if not largest > 0.0:
            raise ValueError(
                f"`scale` must be given with the base {self.spoofer!r}, which commands nothing"
            )
        return largest


def _narrow(
    context: SpooferContext, wanted: tuple[str, ...], seen: tuple[str, ...], name: str
) -> tuple[SpooferContext, Any]:
    """What a base observes of a policy's elements, and their columns."""
    lacking = [each for each in wanted if each not in seen]
    if lacking:
        raise ValueError(
            f"the base {name!r} observes {', '.join(lacking)}, which the policy does not: give the "
            "environment the base's `knowledge`, or more"
        )
    columns = [seen.index(each) for each in wanted]
    low, high = context.observation_low, context.observation_high
    narrowed = context._replace(
        observation_names=wanted,
        observation_low=tuple(low[k] for k in columns) if low else (),
        observation_high=tuple(high[k] for k in columns) if high else (),
    )
    return narrowed, columns


class BoundBase(NamedTuple):
    """A base that is ready for B receivers, the elements that it observes, and its scale."""

    spoofer: Spoofer
    columns: Any
    scale: float

    def add(self, observation: NDArray[np.float32], correction: FloatArray) -> FloatArray:
        """Action (B, k) in [-1, 1] of observations (B, o) and corrections (B, k) in [-1, 1]."""
        given = np.ascontiguousarray(observation[:, self.columns])
        action = self.spoofer.act(given) + self.scale * correction
        return np.ascontiguousarray(np.clip(action, -1.0, 1.0))
