"""What a campaign runs: detectors x spoofers x paired seeds, in one scenario."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import math
import uuid
import warnings
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from .._describe import outside_sources
from .._registry import whole_number
from ..attacks import ATTACKS, Attack, make_attack
from ..detectors import DETECTORS, Detector
from ..envs.attach import spoofer_context as spoofer_context
from ..envs.attach import warn_of_headings
from ..envs.domain import Domain
from ..envs.observer import Observer
from ..envs.presets import default_terms, make_setup
from ..envs.setup import Setup, Timeline
from ..sim.scenario import Scenario, make_scenario
from ..spoofers import Spoofer, SpooferContext
from .budget import BUDGET, MARGIN
from .entries import (
    DEFAULT_DETECTORS,
    DEFAULT_SPOOFERS,
    Entry,
    build_spoofer,
    check_labels,
    detector_entry,
    oracle_labels,
    refuse_oracles,
    spoofer_entry,
)
from .shipped import fitting
from .specs import describe, digest_of, make, spec_of

FORMAT = 4
"""Of the results; those of another one are not scored."""
SPLITS = {"training": 0, "calibration": 1, "evaluation": 2, "bootstrap": 3}
"""First element of the spawn keys; runs of different splits share no noise."""


def seed_sequences(
    entropy: int, split: str, scenario: str, runs: int, first: int = 0
) -> list[np.random.SeedSequence]:
    """Seeds of the runs of a split; the first ones are the same for any number of runs.

    `entropy`: of the campaign, at least 0; `first`: run to start with.
    """
    key = zlib.crc32(scenario.encode())
    return [
        np.random.SeedSequence(entropy, spawn_key=(SPLITS[split], key, run))
        for run in range(first, runs)
    ]


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """How a spoofer's setting is searched for.

    Parameters
    ----------
    runs : int
        Training runs.
    sift_runs : int
        How many of them are enough to find the neighbourhood.
    values : int
        Log-spaced values over the whole range that are sifted.
    refined : int
        Log-spaced values around a peak within the budget, tried on all training runs.
    budget : float
        How much more often than without attack an alarm may come, as a part of the runs.
    margin : float
        Distance that a choice keeps from the budget, in standard errors of that excess.
    """

    runs: int = 1024
    sift_runs: int = 64
    values: int = 20
    refined: int = 5
    budget: float = BUDGET
    margin: float = MARGIN

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, least in (("runs", 2), ("sift_runs", 1), ("values", 3), ("refined", 2)):
            count = whole_number(f"`tuning.{name}`", getattr(self, name), least)
            object.__setattr__(self, name, count)
        if not 0.0 <= self.budget < 1.0:
            raise ValueError(f"`tuning.budget` must be in [0, 1), got {self.budget}")
        if not (math.isfinite(self.margin) and self.margin >= 0.0):
            raise ValueError(f"`tuning.margin` must be finite and >= 0, got {self.margin}")


@dataclass(frozen=True, kw_only=True)
class Suite:
    """What a campaign runs.

    Parameters
    ----------
    scenario : str, mapping or Scenario
        As `make_scenario` takes it.
    receiver : str or mapping
        A name, or settings of the victim.
    attack : str, mapping or Attack
        As `make_attack` takes it.
    timeline : mapping or Timeline
        Phases of a run.
    domain : mapping or Domain, optional
        What differs from run to run beside the noise.
    target_heading_deg, decision_interval_s, between : optional
        As in `SpoofEnv`; the score counts any direction.
    detectors : sequence
        As `detector_entry` takes them.
    spoofers : sequence, optional
        As `spoofer_entry` takes them; ``none`` is always among them.  By default
        `DEFAULT_SPOOFERS` and the shipped spoofers that were made for such attacks.
    runs : int
        Evaluation runs of every cell, the same for all.
    entropy : int
        All chance follows from it.
    tuning : Tuning
        Search for the settings that are ``"tuned"``.
    alert_limit_m : float
        Undetected displacement of which tables tell how often it is exceeded; by default the
        horizontal alert limit of an approach with vertical guidance.
    notes : sequence of str
        Where the scenario comes from, for the report.
    allow_oracles : bool
        Whether detectors may play that are told the attack; the report then says which ones are.
    """

    scenario: str | Mapping[str, Any] | Scenario = "zhong2025"
    receiver: str | Mapping[str, Any] = field(default_factory=dict)
    attack: str | Mapping[str, Any] | Attack = "false-position"
    timeline: Mapping[str, float] | Timeline = field(default_factory=Timeline)
    domain: Mapping[str, Any] | Domain | None = None
    target_heading_deg: float | str = 90.0
    decision_interval_s: float | None = None
    between: str = "hold"
    detectors: Sequence[str | Mapping[str, Any] | Detector] = DEFAULT_DETECTORS
    spoofers: Sequence[str | Mapping[str, Any] | Spoofer] | None = None
    runs: int = 200
    entropy: int = 0
    tuning: Tuning = field(default_factory=Tuning)
    alert_limit_m: float = 40.0
    notes: Sequence[str] = ()
    allow_oracles: bool = False

    def __post_init__(self) -> None:
        """Check names and settings; no receiver is simulated yet."""
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
        return tuple(detector_entry(spec) for spec in self.detectors)

    @property
    def _oracle_notes(self) -> tuple[str, ...]:
        """Which detectors are none; a line each."""
        labels = oracle_labels(self.detector_entries)
        return tuple(f"{label} is an oracle: it is told the attack" for label in labels)

    @cached_property
    def spoofer_entries(self) -> tuple[Entry, ...]:
        """Spoofers in their order, ``none`` first."""
        specs = self.spoofers
        if specs is None:
            specs = (*DEFAULT_SPOOFERS, *self._shipped[0])
        entries = [spoofer_entry(spec) for spec in specs]
        none = spoofer_entry("none")
        return (none, *(entry for entry in entries if entry != none))

    @cached_property
    def _shipped(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Shipped spoofers that fit, and why others do not."""
        return fitting(self._context)

    def _context(self, knowledge: str) -> SpooferContext:
        """What a spoofer with such knowledge at run time would be told."""
        observer = Observer(default_terms(self._setup, knowledge), self._setup)
        return spoofer_context(self._setup, 1, observer)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Which shipped spoofers do not fit, and why, by default; a line each."""
        return self._shipped[1] if self.spoofers is None else ()

    def check_fit(self) -> None:
        """Raise where a spoofer does not fit the attack, before anything is played.

        Spoofers that ignore a target direction that is drawn are warned of.
        """
        bound = []
        for entry in self.spoofer_entries:
            spec = entry.spec
            if entry.tuned:
                kind = type(build_spoofer(entry.with_value(1.0)))
                low, _ = kind.tuning_range(spoofer_context(self._setup))
                spec = entry.with_value(low)
            bound.append(make_bound_spoofer(spec, self._setup, 1)[0])
        warn_of_headings(bound, self._setup)

    @cached_property
    def world(self) -> Scenario:
        """The scenario."""
        return make_scenario(self.scenario)

    @cached_property
    def _setup(self) -> Setup:
        timeline = self.timeline
        return make_setup(
            scenario=self.world,
            receiver=self.receiver,
            attack=make_attack(
                self.attack if not isinstance(self.attack, Mapping) else dict(self.attack)
            ),
            detector="never",
            timeline=timeline,
            domain=self.domain,
            target_heading_deg=self.target_heading_deg,
            decision_interval_s=self.decision_interval_s,
            between=self.between,
        )

    def setup(self, detector: Entry) -> Setup:
        """What all receivers share, with one of the detectors.

        World and all else are shared.
        """
        setup = copy.copy(self._setup)
        setup.detector = make("detector", DETECTORS, Detector, detector.spec)
        return setup

    def generators(self, split: str, runs: int, first: int = 0) -> list[np.random.Generator]:
        """Sources of chance of the runs of a split, from `first` on."""
        seeds = seed_sequences(self.entropy, split, self.world.name, runs, first)
        return [np.random.Generator(np.random.PCG64(seed)) for seed in seeds]

    @cached_property
    def config(self) -> dict[str, Any]:
        """Everything that the results depend on, JSON-able.

        What comes from outside of spoofgym is there by digests of its sources.  Where one can't be
        read, a number of this suite alone is in its place, so that no other one takes up its
        results; this is warned of.
        """
        setup = self._setup
        judges = [make("detector", DETECTORS, Detector, e.spec) for e in self.detector_entries]
        players = [build_spoofer(entry.untuned) for entry in self.spoofer_entries]
        world = (self.world, setup.receiver, setup.attack, setup.timeline, setup.domain)
        outside = outside_sources(*judges, *players, *world)
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
            "scenario": describe(self.world),
            "receiver": describe(setup.receiver),
            "attack": spec_of("attack", ATTACKS, setup.attack),
            "timeline": describe(setup.timeline),
            "domain": describe(setup.domain),
            "target_heading_deg": self.target_heading_deg,
            "decision_interval_s": self.decision_interval_s,
            "between": self.between,
            "detectors": [dataclasses.asdict(entry) for entry in self.detector_entries],
            "spoofers": [dataclasses.asdict(entry) for entry in self.spoofer_entries],
            "runs": self.runs,
            "entropy": self.entropy,
            "splits": dict(SPLITS),
            "tuning": dataclasses.asdict(self.tuning),
            "alert_limit_m": float(self.alert_limit_m),
            "notes": [*self.notes, *self._oracle_notes, *self.left_out, *unknown],
        }

    @cached_property
    def digest(self) -> str:
        """Digest of `config`."""
        return digest_of(self.config)


def make_bound_spoofer(spec: Any, setup: Setup, receivers: int) -> tuple[Spoofer, Observer]:
    """Spoofer that is ready for a batch, and what it observes."""
    spoofer = build_spoofer(spec)
    observer = Observer(default_terms(setup, spoofer.knowledge), setup)
    spoofer.bind(spoofer_context(setup, receivers, observer))
    spoofer.reset()
    return spoofer, observer


def versions() -> dict[str, str]:
    """What results depend on besides the settings."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    packages = {name: version(name) for name in ("numba", "numpy", "scipy")}
    return {"spoofgym": __version__, "sources": digest.hexdigest()[:16], **packages}
