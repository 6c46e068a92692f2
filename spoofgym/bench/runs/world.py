"""Env id + settings: setup, seeds, conditions."""

from __future__ import annotations

import dataclasses
import math
import uuid
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ...attacks import ATTACKS, Attack
from ...core.registry import check_choice, settings_of, spec_of, whole_number
from ...core.settings import describe, outside_sources
from ...detectors import Calibrated, Detector, OperatingPoint, PooledDetector, detector_in_world
from ...detectors.calibrated import resolve
from ...envs.factory import make_setup
from ...envs.spoofer_binding import ENV_ID, SETUPS, monitors_for, tuning_range_of, warn_of_headings
from ...envs.spoofer_binding import spoofer_context as spoofer_context
from ...simulation import LooselyCoupledSetup, SnapshotSetup, TightlyCoupledSetup, WheeledRobotSetup
from ...simulation import loose as loosely_coupled
from ...simulation import robot as wheeled_robot
from ...simulation.domain import Domain
from ...simulation.monitors import Monitor
from ...simulation.setup import SPLITS as SPLITS
from ...simulation.setup import Setup, Timeline, generators_of
from ...simulation.setup import seed_sequences as seed_sequences
from ...simulation.simulator import run_serially
from ...spoofers import Scaled, Spoofer
from ...truth.scenario import Scenario
from ..experiments.versions import campaign_digest, versions
from ..search.attack_suite import NAME, VERSION, Member, fitting_members, suite_digest
from ..search.settings import Selection
from ..search.settings import Tuning as Tuning
from .play import make_bound_spoofer
from .players import (
    DEFAULT_DETECTORS,
    DEFAULT_SPOOFERS,
    Entry,
    build_spoofer,
    check_labels,
    detector_entry,
    fitted,
    fitting,
    oracle_labels,
    refuse_oracles,
    spoofer_entry,
)


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
LOOSE = loosely_coupled.DEFAULT_DETECTOR
DEFAULTS: dict[type[Setup], tuple[dict[str, Any], ...]] = {
    TightlyCoupledSetup: DEFAULT_DETECTORS,
    LooselyCoupledSetup: (LOOSE,),
    SnapshotSetup: ({"name": "raim"}, {"name": "srv-raim"}),
    WheeledRobotSetup: ({"name": "rio"}, wheeled_robot.DEFAULT_DETECTOR),
}
VICTIMS = {env_id: Victim(setup, DEFAULTS[setup]) for env_id, setup in SETUPS.items()}
"""By environment."""


FORMAT = 5
"""Of the results; those of another one are not scored."""
ALERT_LIMITS_M = (5.0, 10.0, 20.0, 40.0, 80.0, 160.0, 320.0, 556.0)
"""Alert limits of a campaign besides its own; 40 m is the horizontal one of an approach with
vertical guidance, 556 m that of a non-precision approach (`icao-annex10`)."""
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
"""Settings of a victim that a suite has by name."""


@dataclass(frozen=True, kw_only=True)
class Suite:
    """What a campaign runs.

    Parameters
    ----------
    env : str
        Environment whose victim it is, in `VICTIMS`.
    scenario, receiver, attack, timeline, domain : optional
        Settings of the victim, as its environment takes them; an attack and a scenario only where
        it has them.
    target_heading_deg, decision_interval_s, between : optional
        The same; the score counts any direction.
    settings : mapping
        Further settings of the victim.
    detectors : sequence, optional
        As `detector_entry` takes them; by default those that suit the victim.
    spoofers : sequence, optional
        As `spoofer_entry` takes them; ``none`` is always among them.  By default
        `DEFAULT_SPOOFERS` and the shipped spoofers that were made for such attacks.
    runs : int
        Evaluation runs of every cell, the same for all.
    entropy : int
        Seed of the random number generators.
    tuning : Tuning
        Search for the settings that are ``"tuned"``.
    alert_limit_m : float
        Undetected displacement of which tables show how often it is exceeded; by default the
        horizontal alert limit of an approach with vertical guidance.
    notes : sequence of str
        Where the scenario comes from, for the report.
    allow_oracles : bool
        Whether detectors may play that know the attack; the report then says which ones do.
    selection : Selection, optional
        Search for the worst attack of the attack suite, by which detectors are protected; None for
        none.
    """

    env: str = ENV_ID
    scenario: str | Mapping[str, Any] | Scenario | None = None
    receiver: str | Mapping[str, Any] | None = None
    attack: str | Mapping[str, Any] | Attack | None = None
    timeline: Mapping[str, float] | Timeline | None = None
    domain: Mapping[str, Any] | Domain | None = None
    target_heading_deg: float | str | None = None
    decision_interval_s: float | None = None
    between: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    detectors: Sequence[str | Mapping[str, Any] | Detector] | None = None
    spoofers: Sequence[str | Mapping[str, Any] | Spoofer] | None = None
    runs: int = 200
    entropy: int = 0
    tuning: Tuning = field(default_factory=Tuning)
    alert_limit_m: float = 40.0
    notes: Sequence[str] = ()
    allow_oracles: bool = False
    selection: Selection | None = None

    def __post_init__(self) -> None:
        check_choice("environment of the benchmark", self.env, VICTIMS)
        valid = [name for name in settings_of(VICTIMS[self.env].setup) if name != "detector"]
        for name in self.given:
            if name in self.settings and getattr(self, name, None) is not None:
                raise ValueError(f"`settings` has {name!r}, which is given by name, too")
            if name not in valid:
                raise ValueError(
                    f"{self.env} has no setting {name!r}, got {self.given[name]!r}; valid: "
                    f"{', '.join(valid)}"
                )
        for name, least in (("runs", 2), ("entropy", 0)):
            object.__setattr__(self, name, whole_number(f"`{name}`", getattr(self, name), least))
        if not (math.isfinite(self.alert_limit_m) and self.alert_limit_m > 0.0):
            raise ValueError(f"`alert_limit_m` must be finite and > 0, got {self.alert_limit_m}")
        for entries in (self.detector_entries, self.spoofer_entries):
            check_labels(entries)
        if not self.detector_entries:
            raise ValueError("a campaign needs at least one detector")
        if not self.allow_oracles:
            refuse_oracles(self.detector_entries)

    @cached_property
    def detector_entries(self) -> tuple[Entry, ...]:
        """Detectors in their order."""
        specs = VICTIMS[self.env].detectors if self.detectors is None else self.detectors
        return tuple(detector_entry(spec) for spec in specs)

    @property
    def alert_limits_m(self) -> list[float]:
        """Alert limits by which detectors are compared."""
        return sorted({*ALERT_LIMITS_M, float(self.alert_limit_m)})

    @property
    def given(self) -> dict[str, Any]:
        """Settings of the victim that are not its defaults."""
        own = {name: getattr(self, name) for name in WORLD}
        return {**{name: x for name, x in own.items() if x is not None}, **self.settings}

    @property
    def _oracle_notes(self) -> tuple[str, ...]:
        """Which detectors are none; a line each."""
        labels = oracle_labels(self.detector_entries)
        return tuple(f"{label} is an oracle: it knows the attack" for label in labels)

    @cached_property
    def spoofer_entries(self) -> tuple[Entry, ...]:
        """Spoofers in their order, ``none`` first."""
        specs = self.spoofers
        if specs is None:
            specs = (*DEFAULT_SPOOFERS, *map(fitted, self._shipped[0]))
        entries = [spoofer_entry(spec) for spec in specs]
        none = spoofer_entry("none")
        return (none, *(entry for entry in entries if entry != none))

    @cached_property
    def _shipped(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Shipped spoofers that fit, and why others do not."""
        return fitting(self.env, self._setup)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Which shipped spoofers do not fit, and why, by default; a line each."""
        return self._shipped[1] if self.spoofers is None else ()

    def check_fit(self) -> None:
        """Raise where a detector or a spoofer does not fit, before anything is played. Spoofers
        that ignore a target direction that is drawn are warned of."""
        for entry in self.detector_entries:
            try:
                self.setup(entry).simulator(1, run_serially)
            except (TypeError, ValueError) as error:
                raise ValueError(
                    f"detector {entry.label} does not fit {self._setup.whose} ({self.env}): {error}"
                ) from error
        bound = []
        for entry in self.spoofer_entries:
            spec = entry.spec
            if entry.searched:
                if not entry.tuned:
                    raise ValueError(
                        f"{entry.label}: a blind optimum is looked for under the alarm budget, so "
                        "that its amplitude must be tuned: give it amplitude=tuned, or rates_mps"
                    )
                spec = {**spec, "rates_mps": [0.0, 1e-3]}
                entry = replace(entry, spec=spec)
            if entry.tuned:
                low, _ = tuning_range_of(build_spoofer(entry.with_value(1.0)), self._setup)
                spec = entry.with_value(low)
            setup = self._setup.altered(monitors=self.watched_for([entry]))
            spoofer = make_bound_spoofer(spec, setup, 1)[0]
            bound.append(spoofer.spoofer if isinstance(spoofer, Scaled) else spoofer)
        warn_of_headings(bound, self._setup)

    @cached_property
    def _setup(self) -> Setup:
        return make_setup(VICTIMS[self.env].setup, {"detector": "never", **self.given})

    def setup(self, detector: Entry, spoofers: Sequence[Entry] | None = None) -> Setup:
        """What all receivers share, with one of the detectors; world and all else are the same.
        `spoofers`: who plays, all of the suite's by default; what they observe is watched."""
        watched = self._watched if spoofers is None else self.watched_for(spoofers)
        return self._setup.altered(detector=detector_in_world(detector.spec), monitors=watched)

    @cached_property
    def _watched(self) -> list[Monitor]:
        return self.watched_for(self.spoofer_entries)

    def watched_for(self, spoofers: Iterable[Entry]) -> list[Monitor]:
        """What has to look at the victim's epochs, for spoofers to observe what they know."""
        return monitors_for((build_spoofer(each.untuned) for each in spoofers), self._setup)

    def generators(self, split: str, runs: int, first: int = 0) -> list[np.random.Generator]:
        """Generators of the runs of a split, from `first` on."""
        seeds = seed_sequences(self.entropy, split, self._setup.name, runs, first)
        return generators_of(seeds)

    @cached_property
    def world(self) -> Setup:
        """What all receivers share, without a defence: the world of a calibration."""
        return self._setup

    def points(self, detector: Entry) -> list[OperatingPoint]:
        """Where a detector works that asks for a rate, or the members of a pool; else nothing."""
        judge = detector_in_world(detector.spec)
        resolve(judge, self._setup)
        parts = judge.judges if isinstance(judge, PooledDetector) else (judge,)
        found = [part.point for part in parts if isinstance(part, Calibrated)]
        return [point for point in found if point is not None]

    @cached_property
    def captions(self) -> tuple[str, ...]:
        """Where the detectors work that ask for a rate: per hour and per run; a line each."""
        found = {entry.label: self.points(entry) for entry in self.detector_entries}
        return tuple(
            f"{label}: {'; '.join(sorted({str(point) for point in points}))}"
            for label, points in found.items()
            if points
        )

    def _calibrations(self) -> dict[str, Any]:
        """Scales of the detectors that ask for a rate, for `config`, and who never alarms."""
        found = {entry.label: self.points(entry) for entry in self.detector_entries}
        named = {label: [p._asdict() for p in points] for label, points in found.items() if points}
        never = [e.label for e in self.detector_entries if not detector_in_world(e.spec).calibrates]
        return {"calibrations": named, "never_alarm": never}

    @cached_property
    def config(self) -> dict[str, Any]:
        """Everything that the results depend on, JSON-able. What comes from outside of spoofgym is
        there by digests of its sources. Where one can't be read, a number of this suite alone is in
        its place, so that no other one takes up its results; this is warned of."""
        setup = self._setup
        judges = [detector_in_world(entry.spec) for entry in self.detector_entries]
        players = [build_spoofer(entry.untuned) for entry in self.spoofer_entries]
        parts = [getattr(setup, name) for name in WORLD if hasattr(setup, name)]
        outside = outside_sources(*judges, *players, *parts, *self.given.values())
        unknown = [
            f"the source of {name} can't be read: its results are never taken up again"
            for name, digest in outside.items()
            if digest is None
        ]
        for line in unknown:
            warnings.warn(line, UserWarning, stacklevel=2)
        return {
            "format": FORMAT,
            "versions": versions(),
            "outside": {name: d or f"unknown, {uuid.uuid4().hex}" for name, d in outside.items()},
            "env": self.env,
            **self._described(),
            "timeline": describe(setup.timeline),
            "domain": describe(setup.domain),
            "target_heading_deg": setup.target_heading_deg,
            "decision_interval_s": setup.decision_interval_s,
            "between": setup.between,
            "detectors": [dataclasses.asdict(entry) for entry in self.detector_entries],
            "spoofers": [dataclasses.asdict(entry) for entry in self.spoofer_entries],
            **self._calibrations(),
            "runs": self.runs,
            "entropy": self.entropy,
            "splits": dict(SPLITS),
            "tuning": dataclasses.asdict(self.tuning),
            "attack_suite": self._attack_suite(),
            "alert_limit_m": float(self.alert_limit_m),
            "alert_limits_m": list(ALERT_LIMITS_M),
            "notes": [
                *self.notes,
                *self.captions,
                *self._oracle_notes,
                *self.left_out,
                *unknown,
            ],
        }

    @cached_property
    def members(self) -> tuple[Member, ...]:
        """Attacks of the attack suite that fit the victim."""
        return fitting_members(self._setup, spoofer_context(self._setup))

    def _attack_suite(self) -> dict[str, Any] | None:
        """Name, version and search of the attack suite; None where it is not played."""
        if self.selection is None:
            return None
        named = {"name": NAME, "version": VERSION, "digest": suite_digest(self.members)}
        return {**named, **dataclasses.asdict(self.selection)}

    def _described(self) -> dict[str, Any]:
        """Scenario, receiver and attack, or what the victim has in their place; JSON-able."""
        setup = self._setup
        if isinstance(setup, TightlyCoupledSetup):
            return {
                "scenario": {**describe(setup.scenario), "name": setup.name},
                "receiver": describe(setup.receiver),
                "attack": spec_of("attack", ATTACKS, setup.attack),
            }
        every = {**settings_of(type(setup)), **self.given}
        limits = {"control": setup.attack.control, "rate_limit_mps": setup.attack.rate_limit_mps}
        return {
            "scenario": {"name": setup.name},
            "attack": limits,
            "settings": {k: describe(value) for k, value in every.items() if k != "detector"},
        }

    @cached_property
    def digest(self) -> str:
        """Digest of `config`; ONNX files count by their content, wherever they are."""
        return campaign_digest(self.config)
