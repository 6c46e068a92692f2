"""Another detector, and more terms, for an environment that has not begun."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..detectors import Detector, make_detector
from .ends import AtAlarm
from .plant_env import PlantEnv, PlantVectorEnv
from .plant_game import PlantGame
from .presets import WatchSpec, make_watch
from .spoof_env import SpoofEnv
from .terms import EndSpec, make_terms
from .vector_env import SpoofVectorEnv


def compose(
    env: Any,
    *,
    detector: str | Mapping[str, Any] | Detector | None = None,
    watch: WatchSpec = (),
    end: EndSpec = (),
) -> None:
    """Set the detector, and add to what watches and to what ends an episode."""
    inner = _composable(env)
    if inner.begun:
        raise RuntimeError("the game has begun: compose the environment before reset()")
    changes: dict[str, Any] = {}
    made = None
    if detector is not None:
        if inner.given_detector is not None:
            raise ValueError(
                f"two detectors are set at once: {inner.given_detector!r} and {detector!r}; "
                "one alone can be in the loop, others watch"
            )
        made = make_detector(detector)
    if watch:
        changes["watch"] = (*inner.game.settings["watch"], *make_watch(watch))
    if end:
        present = inner.game.settings["end"]
        if present is None:
            present = (AtAlarm(),) if inner.game.end_at_alarm else ()
        changes["end"] = (*present, *make_terms("end", end))
    before = inner.game
    inner.adopt(_altered(before, made, changes))
    before.close()
    if detector is not None:
        inner.given_detector = detector


def _altered(game: Any, detector: Detector | None, changes: dict[str, Any]) -> Any:
    """A new game of the same kind, not begun yet."""
    if isinstance(game, PlantGame):
        return game.altered(detector, **changes)
    setup = game.setup if detector is None else game.setup.altered(detector=detector)
    new = game.altered(setup, **changes)
    new.listeners = game.listeners
    return new


def _composable(env: Any) -> Any:
    """Environment inside all wrappers, whose game can be made anew."""
    inner = getattr(env, "unwrapped", env)
    if isinstance(inner, PlantEnv | PlantVectorEnv):
        return inner
    return composed(env)


def composed(env: Any) -> SpoofEnv | SpoofVectorEnv:
    """Environment inside all wrappers."""
    inner = getattr(env, "unwrapped", env)
    if not isinstance(inner, SpoofEnv | SpoofVectorEnv):
        raise TypeError(
            "this wrapper needs a SpoofEnv or a SpoofVectorEnv, wrapped or not, got "
            f"{inner!r}; `gymnasium.make_vec` makes one by its default vectorization mode"
        )
    return inner
