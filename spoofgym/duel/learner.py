"""Receivers of the side that learns, of any environment of the package."""

from __future__ import annotations

import copy
import inspect
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self

import gymnasium as gym

from ..core.declared import check_word
from ..core.registry import refuse_overrides
from ..core.settings import describe
from ..detectors import Detector
from ..detectors.build import spec_of_judge
from ..detectors.pool import normalize_weights
from ..envs.core import SpoofCore
from ..envs.factory import CORE, DEFAULT_ID, DEFAULT_VICTIM, choose_env_id, make_core, select_victim
from ..envs.terms import describe_terms
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


OF_THE_CALL = (
    "autoreset_mode",
    "epoch",
    "infos",
    "num_envs",
    "prefetch",
    "render_mode",
    "threads",
    "vectorization_mode",
    "victim",  # which the id names
)
"""Arguments of `gymnasium.make` and `make_vec` that change nothing of what is simulated."""


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
        usual = choose_env_id(own_settings(settings))
        name = _task_id(task, side) if task is not None else env_id or usual
        setup, view, merged = _look_up(name)
        if env_id is None and task is None and not (pool is None and side == SPOOFER):
            merged = {}  # the world is that of the duel
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
        all_ = with_world({**merged, **own_settings(settings)}, paced=side == SPOOFER)
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
        """The id, where it is the package's and has no pool; else one of the victim's defaults."""
        ours = self.pool is None and self.env_id.startswith("spoofgym/")
        return self.env_id if ours else self.setup.env_id

    def card_kwargs(self) -> dict[str, Any]:
        """Settings of `card_id` as a card has them, with its own: a pool is one detector."""
        if self.pool is None or self.side == DETECTOR:
            return dict(self.settings)
        members = [self.pool] if isinstance(self.pool, str | Mapping) else list(self.pool)
        normalize_weights(len(members), self.weights)
        met: Any = members[0]
        if len(members) > 1:
            met = {"name": "pool", "members": members}
            met |= {} if self.weights is None else {"weights": list(self.weights)}
        return {**self.settings, "detector": met}


def describe_environment(inner: Any) -> tuple[str, dict[str, Any]]:
    """Id and settings of an environment of the spoofer's side, JSON-able, as a card has them."""
    env_id, given = getattr(inner, "env_id", None), getattr(inner, "env_kwargs", None)
    if env_id is None:
        spec = getattr(inner, "spec", None)
        if spec is None:
            raise ValueError("`env` must be made by `gymnasium.make`, `make_vec` or `SpoofVecEnv`")
        settings = dict(spec.kwargs)
        pool, weights = settings.pop("pool", None), settings.pop("weights", None)
        made = LearnersSide.of(spec.id, None, SPOOFER, pool, weights, settings)
        env_id, given = made.card_id, made.card_kwargs()
    below = gym.spec(env_id).kwargs  # of which None is another one
    own = {name: x for name, x in dict(given or {}).items() if x is not None or name in below}
    own = {name: value for name, value in own.items() if name not in OF_THE_CALL}
    if inner.core.commands.base is not None:  # which a wrapper may have set
        own["action"] = describe_terms("action", inner.core.settings["action"])
    judge = _find_own_detector(inner, own.get("detector"))
    if judge is not None:
        own["detector"] = spec_of_judge(judge)
        if "<locals>" in own["detector"]["name"] or own["detector"]["name"].startswith("__main__"):
            raise ValueError(
                f"no card can name the detector {own['detector']['name']!r}: put its class into a "
                "module that can be imported"
            )
    try:
        return env_id, json.loads(json.dumps({k: describe(x) for k, x in own.items()}))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"the settings of the environment can't be written into a card ({error}): give its "
            "parts by name and settings"
        ) from error


def _find_own_detector(inner: Any, setting: Any) -> Detector | None:
    """Detector that a wrapper has set, outside of the loop or within, or that is given as an
    object; None where the settings name it."""
    outside: Detector | None = getattr(inner, "outside_detector", None)
    if outside is not None:
        return outside
    stale = getattr(inner, "wrapped", False) and not hasattr(inner, "env_kwargs")
    if not stale and (setting is None or isinstance(setting, str | Mapping)):
        return None
    found: Detector = inner.core.setup.detector
    return found


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
    if spec.entry_point != gym.spec(DEFAULT_ID).entry_point and view not in VIEWS:
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
