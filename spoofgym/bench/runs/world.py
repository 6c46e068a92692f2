"""Env id + settings: setup, seeds, conditions."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ...attacks import ATTACKS
from ...core.declared import setting, settings_record
from ...core.registry import build_spec, check_choice, inspect_settings, refuse_overrides
from ...core.settings import describe
from ...detectors import Detector, OperatingPoint
from ...detectors.calibrated import calibrated_parts, resolve_thresholds
from ...envs.factory import make_setup
from ...envs.spoofer_binding import (
    ENV_ID,
    SETUPS,
    get_tuning_range,
    monitors_for,
    spoofer_context,
    warn_of_headings,
)
from ...simulation import LooselyCoupledSetup, SnapshotSetup, TightlyCoupledSetup, WheeledRobotSetup
from ...simulation import loose as loosely_coupled
from ...simulation import robot as wheeled_robot
from ...simulation.monitors import Monitor
from ...simulation.setup import Setup, make_generators, seed_sequences
from ...simulation.simulator import run_serially
from ...spoofers import Scaled, SpooferContext, make_spoofer
from ...tasks import get_task
from .play import make_bound_spoofer
from .players import DEFAULT_DETECTORS, PlayerSpec


class Victim(NamedTuple):
    """Kind of victim, and its detectors in a campaign by default."""

    setup: type[Setup]
    detectors: tuple[dict[str, Any], ...]


CONTROLS = ({"name": "never"}, {"name": "lottery"})
"""Negative controls, which every table of the benchmark has."""
SKIES = 32
HEADLINE_DOMAIN = {
    "start_s": [0.0, None],
    "turned_deg": [0.0, 360.0],
    "constellation_time_s": [0.0, 86_400.0],
    "worlds": SKIES,
    "turn_on": "drawn",
}
"""What is drawn for every run of a headline: the onset, where the flight heads, the sky, one of
`SKIES`, and the turn-on constants of the inertial sensors.  Which way an attack pushes is fixed, so
that its angle to the flight is drawn, too."""
DEFAULTS: dict[type[Setup], tuple[dict[str, Any], ...]] = {
    TightlyCoupledSetup: DEFAULT_DETECTORS,
    LooselyCoupledSetup: (loosely_coupled.DEFAULT_DETECTOR,),
    SnapshotSetup: ({"name": "raim"}, {"name": "srv-raim"}),
    WheeledRobotSetup: ({"name": "rio"}, wheeled_robot.DEFAULT_DETECTOR),
}
VICTIMS = {env_id: Victim(setup, DEFAULTS[setup]) for env_id, setup in SETUPS.items()}
"""By environment."""
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


@settings_record(frozen=True)
class World:
    """Where detectors and spoofers meet."""

    env: str = setting(default=ENV_ID, help="Environment of the victim, in `VICTIMS`.")
    settings: Mapping[str, Any] = setting(
        default_factory=dict, help="Settings of the victim that are not its defaults."
    )

    def __post_init__(self) -> None:
        check_choice("environment of the benchmark", self.env, VICTIMS)
        valid = [name for name in inspect_settings(VICTIMS[self.env].setup) if name != "detector"]
        for name, value in self.settings.items():
            if name not in valid:
                raise ValueError(
                    f"{self.env} has no setting {name!r}, got {value!r}; valid: {', '.join(valid)}"
                )

    @classmethod
    def of(cls, task: str | None = None, /, **named: Any) -> World:
        """World of a task, which decides it, or of settings: ``env``, those of `WORLD` by name, and
        further ones as ``settings``; None is as if it were not there."""
        if task is not None:
            refuse_overrides(f"task {task}", (f"`{name}`" for name in named))
            return cls(settings=get_task(task).world_kwargs)
        env, further = named.pop("env", ENV_ID), named.pop("settings", {})
        own = {name: value for name, value in named.items() if value is not None}
        for name in further:
            if name in own:
                raise ValueError(f"`settings` has {name!r}, which is given by name, too")
        return cls(env, {**own, **further})

    @cached_property
    def setup(self) -> Setup:
        """What all receivers share, without a defence."""
        return make_setup(VICTIMS[self.env].setup, {"detector": "never", **self.settings})

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
        return make_generators(seed_sequences(entropy, split, self.setup.name, runs, first))

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
            "env": self.env,
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
        every = {**inspect_settings(type(setup)), **self.settings}
        limits = {"control": setup.attack.control, "rate_limit_mps": setup.attack.rate_limit_mps}
        return {
            "scenario": {"name": setup.name},
            "attack": limits,
            "settings": {k: describe(value) for k, value in every.items() if k != "detector"},
        }
