"""What both PettingZoo forms of the duel share: agents, spaces, seeds, information, bad input."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray

from ..core.registry import check_keywords
from ..envs.options import (
    action_space,
    checked_action,
    checked_seed,
    domain_option,
    observation_space,
    warn_unknown,
)
from ..simulation.monitors import Monitor
from ..simulation.tight import TightlyCoupledSetup
from .duel import Duel, DuelStep, duel_setup
from .world import with_world

SPOOFER, DETECTOR = "spoofer_0", "detector_0"
AGENTS = (SPOOFER, DETECTOR)
_DEFAULT = with_world({})
_WORLD = {
    name: parameter.replace(default=_DEFAULT.get(name, parameter.default))
    for name, parameter in inspect.signature(TightlyCoupledSetup).parameters.items()
    if name != "detector"
}
_AGENT = {
    name: parameter
    for name, parameter in inspect.signature(duel_setup).parameters.items()
    if name != "settings"
}
_GAME = {
    name: parameter
    for name, parameter in inspect.signature(Duel).parameters.items()
    if name not in ("receivers", "setup", "threads")
}
SETUP = (*_WORLD, *_AGENT)
SETTINGS = (*SETUP, *_GAME)
"""All settings of a duel."""
OPTIONS = ("domain",)
"""Options that a reset knows."""
FORMS = ("env", "parallel_env")
"""Forms of the duel, by their `decision_delay`."""


def duel_signature() -> inspect.Signature:
    settings = {**_WORLD, **_AGENT, **_GAME}
    del settings["decision_delay"]
    nothing = inspect.Parameter("render_mode", inspect.Parameter.KEYWORD_ONLY, default=None)
    return inspect.Signature([*settings.values(), nothing])


def refuse_to_draw(whose: str, render_mode: object) -> None:
    if render_mode is not None:
        raise ValueError(
            f"`render_mode` must be None, there is nothing to render in {whose}: of the duel only "
            f"SpooferView draws its episodes; got {render_mode!r}"
        )


class Rules:
    """One duel of one receiver, as both forms need it. `decision_delay`: which of the two games it
    is; `render_mode`: there is nothing to render; `settings`: of `duel_setup` and `Duel`;
    `observation_names`, `action_names`: name of every element, by agent."""

    def __init__(
        self, decision_delay: int, /, *, render_mode: None = None, **settings: Any
    ) -> None:
        form = f"duel_v0.{FORMS[decision_delay]}"
        refuse_to_draw(form, render_mode)
        if "decision_delay" in settings:
            raise TypeError(
                f"{form} takes no `decision_delay`: it is 0 in duel_v0.env and 1 in "
                "duel_v0.parallel_env, which are two games"
            )
        valid = [name for name in SETTINGS if name != "decision_delay"]
        check_keywords(form, settings, [*valid, "render_mode"])
        self.duel = make_duel(1, decision_delay=decision_delay, threads=1, **settings)
        core, agent = self.duel.core, self.duel.agent
        self.observation_names = {SPOOFER: core.observation_names, DETECTOR: agent.observer.names}
        self.action_names = {SPOOFER: core.action_names, DETECTOR: agent.action_names}
        self.observation_spaces: dict[str, spaces.Space[Any]] = {
            SPOOFER: observation_space(core),
            DETECTOR: spaces.Box(agent.observer.low, agent.observer.high, dtype=np.float32),
        }
        self.action_spaces: dict[str, spaces.Space[Any]] = {
            SPOOFER: action_space(core),
            DETECTOR: spaces.Box(-1.0, 1.0, (len(agent.action_names),), dtype=np.float32),
        }
        self._rng: np.random.Generator | None = None

    def begin(self, seed: int | None, options: dict[str, Any] | None) -> None:
        warn_unknown(options, OPTIONS)
        given = domain_option(options)
        seed = checked_seed(seed)
        if seed is not None or self._rng is None:
            self._rng = seeding.np_random(seed)[0]
        self.duel.reset([self._rng], given=given)

    def checked(self, agent: str, action: Any) -> NDArray[np.float64]:
        names = self.action_names[agent]
        try:
            return checked_action(action, (len(names),), names)[None]
        except (TypeError, ValueError) as error:
            raise ValueError(f"{agent}: {error}") from error

    def observe(self) -> dict[str, NDArray[np.float32]]:
        return {
            SPOOFER: self.duel.observe_spoofer()[0],
            DETECTOR: self.duel.observe_detector()[0],
        }

    def reset_infos(self) -> dict[str, dict[str, Any]]:
        """Information of a reset; nature's choice is hidden from the detector."""
        both = {"time_s": self.duel.time_s()[0].item(), "decision_delay": self.duel.decision_delay}
        own = {**both, "attacked": bool(self.duel.attacked[0]), **self._due()}
        return {SPOOFER: own, DETECTOR: dict(both)}

    def _due(self) -> dict[str, bool]:
        """Whether the spoofer's next action is a decision, where it acts without one, too."""
        late = self.duel.decision_delay == 1
        return {"decides": self.decides} if late and self.duel.setup.repeat > 1 else {}

    @property
    def decides(self) -> bool:
        return bool(self.duel.deciding[0])

    def infos(self, turn: DuelStep) -> dict[str, dict[str, Any]]:
        """Information after an epoch; the detector gets nothing that it can't see itself."""
        all_: dict[str, Any] = {name: array.item() for name, array in turn.info.items()}
        all_["decision_delay"] = self.duel.decision_delay
        own = ("time_s", "alarm", "statistic", "threshold", "decision_delay")
        return {SPOOFER: {**all_, **self._due()}, DETECTOR: {name: all_[name] for name in own}}


def make_duel(
    receivers: int,
    *,
    threads: int | None = None,
    monitors: Sequence[Monitor] = (),
    **settings: Any,
) -> Duel:
    """Duel from settings that fit into JSON; `monitors` look at its epochs besides."""
    check_keywords("the duel", settings, SETTINGS)
    shared = {name: settings.pop(name) for name in SETUP if name in settings}
    setup: Any = duel_setup(**shared).altered(monitors=monitors)
    return Duel(receivers, setup, threads=threads, **settings)
