"""Receivers of the side that learns, of any environment of the package."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self

import gymnasium as gym

from ..core.declared import check_word
from ..core.registry import refuse_overrides
from ..detectors.pool import normalize_weights
from ..envs.core import SpoofCore
from ..envs.factory import CORE, DEFAULT_VICTIM, make_core, select_victim
from ..envs.spoofer_binding import ENV_ID, find_env_id
from ..simulation.setup import Setup
from ..simulation.tight import TightlyCoupledSetup
from ..tasks import DETECTOR_TASKS, get_detector_task, get_task
from .duel import SETTINGS, default_opponent, own_settings, with_world
from .views import DetectorCore, SpooferSide, SpooferView, check_view_settings

SPOOFER, DETECTOR = "spoofer", "detector"
VIEWS, RAMP = ("SpooferView", "DetectorView"), "ramp"
"""Views of one side of the duel, and the default opponent of the detector's view."""
SPOOFERS_OWN = frozenset(CORE).difference(SETTINGS)
"""Settings of an id for a spoofer's reward and view, which a duel does not have."""
SCENARIO = inspect.signature(TightlyCoupledSetup).parameters["scenario"].default
"""Scenario of an environment that is named and sets none, with a pool, too."""


class LearnersSide(NamedTuple):
    """What an environment is made from: its id, the victim, the opponents and all settings."""

    env_id: str
    side: str
    setup: type[Setup]
    pool: Any
    weights: Sequence[float] | None
    settings: dict[str, Any]

    @classmethod
    def of(
        cls,
        env_id: str | None,
        task: str | None,
        side: str,
        pool: Any,
        weights: Sequence[float] | None,
        settings: Mapping[str, Any],
    ) -> Self:
        """Look the id up, and put its settings below those that are given."""
        check_word("side", side, (SPOOFER, DETECTOR))
        if task is not None and env_id is not None:
            refuse_overrides(f"task {task}", ["`env_id`"])
        name = _task_id(task, side) if task is not None else env_id or ENV_ID
        setup, view, merged = _look_up(name)
        if view == "DetectorView":
            side = DETECTOR
        own = merged.pop("pool", None), merged.pop("weights", None)
        if pool is None and (side == SPOOFER or view == "DetectorView"):
            pool, weights = own[0], own[1] if weights is None else weights
        if pool is None and side == DETECTOR:
            pool = RAMP
        elif pool is None and view == "SpooferView":
            pool = default_opponent({**merged, **own_settings(settings)})
        _check_opponents(name, side, setup, pool, weights, settings.get("detector"))
        if pool is None:
            return cls(name, side, setup, pool, weights, {**merged, **settings})
        merged.pop("detector", None)  # of the id; the pool or the learner replaces it
        if side == DETECTOR:  # its payoff is that of the duel
            merged = {name: x for name, x in merged.items() if name not in SPOOFERS_OWN}
        if env_id is not None and view not in VIEWS:
            merged.setdefault("scenario", SCENARIO)
        all_ = with_world({**merged, **own_settings(settings)})
        return cls(name, side, setup, pool, weights, all_)

    def core(
        self, num_envs: int, threads: int | None, prefetch: bool, whose: str
    ) -> SpoofCore | DetectorCore:
        if self.side == DETECTOR:
            return DetectorCore(num_envs, self.pool, self.weights, threads=threads, **self.settings)
        further: dict[str, Any] = {"threads": threads, "prefetch": prefetch}
        if self.pool is None:
            return make_core(self.setup, num_envs, self.settings, whose=whose, **further)
        check_view_settings(SpooferView, self.settings, self.pool)
        return SpooferSide(num_envs, self.pool, self.weights, {**self.settings, **further}).core

    @property
    def card_id(self) -> str:
        return find_env_id(self.setup)

    def card_kwargs(self) -> dict[str, Any]:
        """Settings of `card_id` as a card has them: a pool is one detector."""
        if self.pool is None or self.side == DETECTOR:
            return dict(self.settings)
        members = [self.pool] if isinstance(self.pool, str | Mapping) else list(self.pool)
        normalize_weights(len(members), self.weights)
        met: Any = members[0]
        if len(members) > 1:
            met = {"name": "pool", "members": members}
            met |= {} if self.weights is None else {"weights": list(self.weights)}
        return {**self.settings, "detector": met}


def _task_id(key: str, side: str) -> str:
    if key not in DETECTOR_TASKS:
        return get_task(key).env_id
    if side != DETECTOR:
        raise ValueError(f"task {key} is for detectors: it needs `side` {DETECTOR!r}, got {side!r}")
    return get_detector_task(key).env_id


def _look_up(env_id: str) -> tuple[type[Setup], str, dict[str, Any]]:
    if env_id not in gym.registry:
        valid = sorted(name for name in gym.registry if name.startswith("spoofgym/"))
        raise ValueError(f"unknown environment {env_id!r}; valid: {', '.join(valid)}")
    spec = gym.spec(env_id)
    view = str(spec.entry_point).rpartition(":")[2]
    if spec.entry_point != gym.spec(ENV_ID).entry_point and view not in VIEWS:
        raise ValueError(f"{env_id} is no environment of a spoofer or a detector")
    settings = copy.deepcopy(dict(spec.kwargs))
    return select_victim(settings.pop("victim", DEFAULT_VICTIM)), view, settings


def _check_opponents(
    env_id: str, side: str, setup: type[Setup], pool: Any, weights: Any, detector: Any
) -> None:
    if side == DETECTOR and detector is not None:
        raise ValueError("the detector is the learner: `detector` can't be given as well")
    if weights is not None and pool is None:
        raise ValueError("`weights` needs a `pool`")
    if setup is not TightlyCoupledSetup and pool is not None:
        raise ValueError(
            "only the tightly coupled receiver has a duel, with pools and a detector's side; "
            f"{env_id} has none"
        )
