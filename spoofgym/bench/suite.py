"""What a campaign runs: detectors x spoofers x paired seeds, in one scenario."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..attacks import ATTACKS, Attack, make_attack
from ..detectors import DETECTORS, Detector
from ..envs.observations import Observer, terms_of
from ..envs.presets import make_setup
from ..envs.setup import Setup, Timeline
from ..sim.scenario import Scenario, make_scenario
from ..spoofers import SPOOFERS, Spoofer, SpooferContext
from .specs import Spec, describe, digest_of, label_of, make, spec_of

SPLITS = {"training": 0, "calibration": 1, "evaluation": 2, "bootstrap": 3}
"""First element of the spawn keys; runs of different splits share no noise."""
TUNED = "tuned"
"""Value of a spoofer's setting that is to be searched for."""
DEFAULT_DETECTORS: tuple[Spec, ...] = ({"name": "snapshot-chi2"}, {"name": "ewma"})
DEFAULT_SPOOFERS: tuple[Spec, ...] = (
    {"name": "none"},
    {"name": "step"},
    {"name": "ramp", "rate_mps": TUNED},
    {"name": "accelerating-ramp", "acceleration_mps2": TUNED},
)


def seed_sequences(
    entropy: int, split: str, scenario: str, runs: int
) -> list[np.random.SeedSequence]:
    """Seeds of the runs of a split; the first ones are the same for any number of runs.

    Parameters
    ----------
    entropy : int
        Of the campaign, at least 0.
    split : str
        One of `SPLITS`.
    scenario : str
        Its name; other scenarios have other noise.
    runs : int
        Number of runs.

    Returns
    -------
    list of SeedSequence
        One for each run, fresh.
    """
    key = zlib.crc32(scenario.encode())
    return [
        np.random.SeedSequence(entropy, spawn_key=(SPLITS[split], key, run)) for run in range(runs)
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
        Log-spaced values in the neighbourhood, tried on all training runs.
    budget : float
        How much more often than without attack an alarm may come, as a part of the runs.
    """

    runs: int = 128
    sift_runs: int = 32
    values: int = 20
    refined: int = 5
    budget: float = 0.05

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, least in (("runs", 2), ("sift_runs", 1), ("values", 3), ("refined", 2)):
            _check_count(f"tuning.{name}", getattr(self, name), least)
        if not 0.0 <= self.budget < 1.0:
            raise ValueError(f"`tuning.budget` must be in [0, 1), got {self.budget}")


def _check_count(name: str, value: Any, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ValueError(f"`{name}` must be a whole number of at least {least}, got {value!r}")


@dataclass(frozen=True)
class Entry:
    """A detector or a spoofer of a campaign.

    Parameters
    ----------
    label : str
        Short name in results.
    spec : dict
        Name and all settings.
    """

    label: str
    spec: Spec

    @property
    def tuned(self) -> str | None:
        """Setting that is to be searched for."""
        return next((key for key, value in self.spec.items() if value == TUNED), None)

    def with_value(self, value: float) -> Spec:
        """Settings with the tuned one at a value.

        Parameters
        ----------
        value : float
            Of the tuned setting.

        Returns
        -------
        dict
            For `make_spoofer`.
        """
        return {**self.spec, str(self.tuned): value}


def detector_entry(spec: str | Mapping[str, Any] | Detector) -> Entry:
    """Detector of a campaign.

    Parameters
    ----------
    spec : str, mapping or Detector
        As `make_detector` takes it; the name may be ``module:Class``.

    Returns
    -------
    Entry
        With all its settings.
    """
    detector: Detector = make("detector", DETECTORS, Detector, spec)
    full = spec_of("detector", DETECTORS, detector)
    return Entry(label_of(full, _default("detector", DETECTORS, type(detector))), full)


def spoofer_entry(spec: str | Mapping[str, Any] | Spoofer) -> Entry:
    """Spoofer of a campaign.

    Parameters
    ----------
    spec : str, mapping or Spoofer
        As `make_spoofer` takes it; the name may be ``module:Class``, and the tunable setting may
        be ``"tuned"``.

    Returns
    -------
    Entry
        With all its settings.

    Raises
    ------
    ValueError
        When another setting than the tunable one is to be tuned.
    """
    settings: Any = dict(spec) if isinstance(spec, Mapping) else spec
    tuned = (
        [key for key, value in settings.items() if value == TUNED] if settings is not spec else []
    )
    for key in tuned:
        del settings[key]
    spoofer: Spoofer = make("spoofer", SPOOFERS, Spoofer, settings)
    for key in tuned:
        if key != spoofer.tunable:
            raise ValueError(
                f"`{key}` of spoofer {settings['name']!r} can't be tuned; tunable: "
                f"{spoofer.tunable or 'nothing'}"
            )
    full = {**spec_of("spoofer", SPOOFERS, spoofer), **dict.fromkeys(tuned, TUNED)}
    return Entry(label_of(full, _default("spoofer", SPOOFERS, type(spoofer))), full)


def _default(word: str, kinds: Mapping[str, type[Any]], kind: type[Any]) -> Spec | None:
    """Settings of a kind by default; None where some have none."""
    try:
        return spec_of(word, kinds, kind())
    except TypeError:
        return None


@dataclass(frozen=True, kw_only=True)
class Suite:
    """What a campaign runs.

    Parameters
    ----------
    scenario : str, mapping or Scenario
        As `make_scenario` takes it.
    receiver : mapping
        Settings of the victim.
    attack : str, mapping or Attack
        As `make_attack` takes it.
    timeline : mapping or Timeline
        Phases of a run.
    detectors : sequence
        As `detector_entry` takes them.
    spoofers : sequence
        As `spoofer_entry` takes them; ``none`` is always among them.
    runs : int
        Evaluation runs of every cell, the same for all.
    entropy : int
        All chance follows from it.
    tuning : Tuning
        Search for the settings that are ``"tuned"``.
    notes : sequence of str
        Where the scenario comes from, for the report.
    """

    scenario: str | Mapping[str, Any] | Scenario = "zhong2025"
    receiver: Mapping[str, Any] = field(default_factory=dict)
    attack: str | Mapping[str, Any] | Attack = "false-position"
    timeline: Mapping[str, float] | Timeline = field(default_factory=Timeline)
    detectors: Sequence[str | Mapping[str, Any] | Detector] = DEFAULT_DETECTORS
    spoofers: Sequence[str | Mapping[str, Any] | Spoofer] = DEFAULT_SPOOFERS
    runs: int = 200
    entropy: int = 0
    tuning: Tuning = field(default_factory=Tuning)
    notes: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Check names and settings; nothing is simulated yet."""
        _check_count("runs", self.runs, 2)
        _check_count("entropy", self.entropy, 0)
        for entries in (self.detector_entries, self.spoofer_entries):
            labels = [entry.label for entry in entries]
            twice = sorted({label for label in labels if labels.count(label) > 1})
            if twice:
                raise ValueError(f"listed twice: {', '.join(twice)}")
        if not self.detector_entries:
            raise ValueError("a campaign needs at least one detector")

    @cached_property
    def detector_entries(self) -> tuple[Entry, ...]:
        """Detectors in their order."""
        return tuple(detector_entry(spec) for spec in self.detectors)

    @cached_property
    def spoofer_entries(self) -> tuple[Entry, ...]:
        """Spoofers in their order, ``none`` first."""
        entries = [spoofer_entry(spec) for spec in self.spoofers]
        none = spoofer_entry("none")
        return (none, *(entry for entry in entries if entry != none))

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
        )

    def setup(self, detector: Entry) -> Setup:
        """What all receivers share, with one of the detectors.

        Parameters
        ----------
        detector : Entry
            Which one.

        Returns
        -------
        Setup
            World and all else are shared with the other ones.
        """
        setup = copy.copy(self._setup)
        setup.detector = make("detector", DETECTORS, Detector, detector.spec)
        return setup

    def generators(self, split: str, runs: int) -> list[np.random.Generator]:
        """Sources of chance of the runs of a split.

        Parameters
        ----------
        split : str
            One of `SPLITS`.
        runs : int
            Number of runs.

        Returns
        -------
        list of Generator
            Fresh ones.
        """
        seeds = seed_sequences(self.entropy, split, self.world.name, runs)
        return [np.random.Generator(np.random.PCG64(seed)) for seed in seeds]

    @cached_property
    def config(self) -> dict[str, Any]:
        """Everything that the results depend on, JSON-able."""
        setup = self._setup
        return {
            "format": 1,
            "versions": versions(),
            "scenario": describe(self.world),
            "receiver": describe(setup.receiver),
            "attack": spec_of("attack", ATTACKS, setup.attack),
            "timeline": describe(setup.timeline),
            "detectors": [dataclasses.asdict(entry) for entry in self.detector_entries],
            "spoofers": [dataclasses.asdict(entry) for entry in self.spoofer_entries],
            "runs": self.runs,
            "entropy": self.entropy,
            "splits": dict(SPLITS),
            "tuning": dataclasses.asdict(self.tuning),
            "notes": list(self.notes),
        }

    @cached_property
    def digest(self) -> str:
        """Digest of `config`."""
        return digest_of(self.config)


def make_bound_spoofer(spec: Any, setup: Setup, receivers: int) -> tuple[Spoofer, Observer]:
    """Spoofer that is ready for a batch, and what it observes.

    Parameters
    ----------
    spec : str, dict or Spoofer
        As `make_spoofer` takes it; the name may be ``module:Class``.
    setup : Setup
        World and attack.
    receivers : int
        B.

    Returns
    -------
    spoofer : Spoofer
        Bound and reset.
    observer : Observer
        All that its level of knowledge allows.
    """
    spoofer: Spoofer = make("spoofer", SPOOFERS, Spoofer, spec)
    observer = Observer(terms_of(spoofer.knowledge), setup)
    spoofer.bind(spoofer_context(setup, receivers, observer.names))
    spoofer.reset()
    return spoofer, observer


def spoofer_context(
    setup: Setup, receivers: int = 1, observation_names: tuple[str, ...] = ()
) -> SpooferContext:
    """What a spoofer is told of an attack.

    Parameters
    ----------
    setup : Setup
        World and attack.
    receivers : int
        B.
    observation_names : tuple of str
        Of its observer.

    Returns
    -------
    SpooferContext
        For `Spoofer.bind`.
    """
    attack = setup.attack
    return SpooferContext(
        receivers=receivers,
        interval_s=setup.scenario.epoch_interval_s,
        steps=setup.steps,
        control=attack.control,
        acceleration_limit_mps2=attack.acceleration_limit_mps2,
        rate_limit_mps=attack.rate_limit_mps,
        action_names=attack.action_names(setup.world),
        observation_names=observation_names,
    )


def versions() -> dict[str, str]:
    """What results depend on besides the settings.

    Returns
    -------
    dict
        Versions of spoofgym, of the packages that compute, and a digest of spoofgym's sources.
    """
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    packages = {name: version(name) for name in ("numba", "numpy", "scipy")}
    return {"spoofgym": __version__, "sources": digest.hexdigest()[:16], **packages}
