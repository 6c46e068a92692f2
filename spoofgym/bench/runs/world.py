"""Env id + settings: setup, seeds, conditions."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from ...attacks import ATTACKS
from ...core.declared import setting, settings_record
from ...core.registry import build_spec, inspect_settings, refuse_overrides
from ...core.settings import describe
from ...detectors import Detector, OperatingPoint
from ...detectors.calibrated import calibrated_parts, resolve_thresholds
from ...duel.learner import describe_environment
from ...envs.context import spoofer_context, warn_of_headings
from ...envs.factory import DEFAULT_ID, choose_env_id, find_environment, make_setup
from ...envs.spoofer_binding import find_card_settings, get_tuning_range, monitors_for
from ...simulation import LooselyCoupledSetup, SnapshotSetup, TightlyCoupledSetup, WheeledRobotSetup
from ...simulation import loose as loosely_coupled
from ...simulation import robot as wheeled_robot
from ...simulation.monitors import Monitor
from ...simulation.setup import Setup, make_generators, seeds_of_runs
from ...simulation.simulator import run_serially
from ...spoofers import Scaled, Spoofer, SpooferContext, make_spoofer
from ...spoofers.build import card_behind
from ...spoofers.learned import inner_env
from ...tasks import get_task
from .play import make_bound_spoofer
from .players import DEFAULT_DETECTORS, PlayerSpec, specify_policy

CONTROLS = ({"name": "never"}, {"name": "lottery"})
"""Negative controls, which every table of the benchmark has."""
DEFAULTS: dict[type[Setup], tuple[dict[str, Any], ...]] = {
    TightlyCoupledSetup: DEFAULT_DETECTORS,
    LooselyCoupledSetup: (loosely_coupled.DEFAULT_DETECTOR,),
    SnapshotSetup: ({"name": "raim"}, {"name": "srv-raim"}),
    WheeledRobotSetup: ({"name": "rio"}, wheeled_robot.DEFAULT_DETECTOR),
}
"""Detectors of a victim in a campaign."""
PLAIN_ID = TightlyCoupledSetup.env_id
"""Environment of a world that is given by settings alone."""
WORLD = (
    "scenario",
    "receiver",
    "attack",
    "timeline",
    "domain",
    "target_heading_deg",
    "decision_interval_s",
    "between",
)
"""Settings of a victim that a world has by name."""


def read_training_world(policy: Any) -> dict[str, Any]:
    """Arguments of `World.of`, and the detector, of the environment that a policy was trained in;
    nothing where it has none."""
    card = None
    if isinstance(policy, str | os.PathLike):
        card = card_behind(make_spoofer(os.fspath(policy)))
    elif isinstance(policy, Mapping | Spoofer):
        card = card_behind(specify_policy(policy).build())
    if card is not None:
        find_card_settings(card)  # or what is wrong with it
        env, settings = card.env_id, card.env_kwargs
    elif (inner := inner_env(policy.get_env() if hasattr(policy, "get_env") else None)) is None:
        return {}
    else:
        env, settings = describe_environment(inner)
    valid = inspect_settings(find_environment(env)[0])
    own = {name: value for name, value in settings.items() if name in valid}
    detector = {"detector": own.pop("detector")} if "detector" in own else {}
    return {"env": env, "settings": own, **detector}


@settings_record(frozen=True)
class World:
    """Where detectors and spoofers meet."""

    env: str = setting(default=PLAIN_ID, help="Environment, whose settings are below those given.")
    settings: Mapping[str, Any] = setting(
        default_factory=dict, help="Settings of the victim that are not its environment's."
    )

    def __post_init__(self) -> None:
        valid = [name for name in inspect_settings(self.kind) if name != "detector"]
        for name, value in self.settings.items():
            if name not in valid:
                raise ValueError(
                    f"{self.env} has no setting {name!r}, got {value!r}; valid: {', '.join(valid)}"
                )

    @classmethod
    def of(cls, task: str | None = None, /, **named: Any) -> World:
        """World of a task, which decides it, or of settings: ``env``, those of `WORLD` by name, and
        further ones as ``settings``; None is as if it were not there, but in ``settings``. Without
        ``env`` it is the default one, or with a scenario one of the victim's defaults."""
        if task is not None:
            refuse_overrides(f"task {task}", (f"`{name}`" for name in named))
            return cls(settings=get_task(task).world_kwargs)
        further = named.pop("settings", {})
        own = {name: value for name, value in named.items() if value is not None}
        env = own.pop("env", choose_env_id({**own, **further}))
        for name in further:
            if name in own:
                raise ValueError(f"`settings` has {name!r}, which is given by name, too")
        return cls(env, {**own, **further})

    @cached_property
    def _environment(self) -> tuple[type[Setup], dict[str, Any]]:
        return find_environment(self.env)

    @property
    def kind(self) -> type[Setup]:
        """Of the victim."""
        return self._environment[0]

    @property
    def title(self) -> str:
        """Environment, and the names of the settings that differ from its own."""
        own = self._environment[1]
        other = [name for name, x in self.settings.items() if x != own.get(name)]
        return f"{self.env} with {', '.join(other)}" if other else self.env

    @cached_property
    def all_settings(self) -> dict[str, Any]:
        """Settings of the victim that are not its defaults."""
        valid = inspect_settings(self.kind)
        own = {name: x for name, x in self._environment[1].items() if name in valid}
        return {**own, **self.settings, "detector": "never"}

    @property
    def detector(self) -> Any:
        """The one that the environment has."""
        valid = {**inspect_settings(self.kind), **self._environment[1]}
        return valid["detector"]

    @property
    def default_detectors(self) -> tuple[Any, ...]:
        """Those of a campaign: the environment's own, or those that suit the victim."""
        own = self._environment[1].get("detector")
        if own is None:
            return DEFAULTS[self.kind]
        return ({key: x for key, x in own.items() if key != "false_alarms_per_hour"},)

    @cached_property
    def setup(self) -> Setup:
        """What all receivers share, without a defence."""
        return make_setup(self.kind, self.all_settings)

    @cached_property
    def context(self) -> SpooferContext:
        """What spoofers are bound to, without a defence."""
        return spoofer_context(self.setup)

    def copy_with(self, **settings: Any) -> World:
        return replace(self, settings={**self.settings, **settings})

    def build_setup(self, detector: PlayerSpec, spoofers: Iterable[PlayerSpec] = ()) -> Setup:
        """What all receivers share, with a detector; what the spoofers observe is watched."""
        watched = self.watched_for(spoofers)
        return self.setup.copy_with(detector=detector.build(), monitors=watched)

    def watched_for(self, spoofers: Iterable[PlayerSpec]) -> list[Monitor]:
        """What has to look at the victim's epochs, for spoofers to observe what they know."""
        return monitors_for((each.build() for each in spoofers), self.setup)

    def generators(
        self, entropy: int, split: str, runs: int, first: int = 0
    ) -> list[np.random.Generator]:
        """Generators of the runs of a split, from `first` on."""
        return make_generators(seeds_of_runs(entropy, split, self.setup.name, range(first, runs)))

    def judge(self, detector: PlayerSpec) -> Detector:
        judge: Detector = detector.build()
        resolve_thresholds(judge, self.setup)
        return judge

    def points(self, detector: PlayerSpec) -> list[OperatingPoint]:
        """Operating points of a detector that requests a rate, or of a pool's members, if any."""
        parts = calibrated_parts(self.judge(detector))
        return [part.point for part in parts if part.point is not None]

    def check_fit(
        self, detectors: Iterable[PlayerSpec], spoofers: Sequence[PlayerSpec] = ()
    ) -> None:
        """Raise where a detector or a spoofer does not fit, before anything is played. Spoofers
        that ignore a target direction that is drawn are warned of."""
        for entry in detectors:
            try:
                self.build_setup(entry, spoofers).simulator(1, run_serially)
            except (TypeError, ValueError) as error:
                raise ValueError(f"detector {entry.label} in {self.env}: {error}") from error
        bound = []
        for entry in spoofers:
            spec = entry.fixed_spec
            if entry.needs_search:
                if not entry.tuned:
                    raise ValueError(
                        f"{entry.label}: an open-loop attack is looked for under the alarm budget, "
                        "so that its amplitude must be tuned: give it amplitude=tuned, or rates_mps"
                    )
                entry = replace(entry, spec={**entry.spec, "rates_mps": [0.0, 1e-3]})
            if entry.tuned:
                low, _ = get_tuning_range(make_spoofer(entry.with_value(1.0)), self.setup)
                spec = entry.with_value(low)
            setup = self.setup.copy_with(monitors=self.watched_for([entry]))
            spoofer = make_bound_spoofer(spec, setup, 1)[0]
            bound.append(spoofer.spoofer if isinstance(spoofer, Scaled) else spoofer)
        warn_of_headings(bound, self.setup)

    @property
    def parts(self) -> list[Any]:
        """What may come from outside of spoofgym."""
        own = [getattr(self.setup, name) for name in WORLD if hasattr(self.setup, name)]
        return [*own, *self.settings.values()]

    @cached_property
    def config(self) -> dict[str, Any]:
        return {
            # all settings are there, so that it says which victim, however the world was named
            "env": DEFAULT_ID if self.kind is TightlyCoupledSetup else self.kind.env_id,
            **self._describe_victim(),
            "timeline": describe(self.setup.timeline),
            "domain": describe(self.setup.domain),
            "target_heading_deg": self.setup.target_heading_deg,
            "decision_interval_s": self.setup.decision_interval_s,
            "between": self.setup.between,
        }

    def _describe_victim(self) -> dict[str, Any]:
        """Scenario, receiver and attack, or what the victim has in their place."""
        setup = self.setup
        if isinstance(setup, TightlyCoupledSetup):
            return {
                "scenario": {**describe(setup.scenario), "name": setup.name},
                "receiver": describe(setup.receiver),
                "attack": build_spec("attack", ATTACKS, setup.attack),
            }
        every = {**inspect_settings(type(setup)), **self.all_settings}
        limits = {"control": setup.attack.control, "rate_limit_mps": setup.attack.rate_limit_mps}
        return {
            "scenario": {"name": setup.name},
            "attack": limits,
            "settings": {k: describe(value) for k, value in every.items() if k != "detector"},
        }
