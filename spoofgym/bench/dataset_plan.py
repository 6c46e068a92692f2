"""What a data set to train a detector on is to be made of."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from .._describe import describe, digest_of, outside_sources
from .._registry import check_choice, check_finite, whole_number
from ..detectors import Detector, Never
from ..detectors.calibrated import factors_of
from ..detectors.learned.agent import DetectorAgent
from ..detectors.learned.observer import make_detector_terms, written_terms
from ..simulators.base import Simulator, run_serially
from ..simulators.calibration import inner_detectors
from ..simulators.clean_runs import weighs
from ..simulators.monitors import PassiveDetectors
from ..simulators.setup import Setup
from ..simulators.splits import SPLITS
from .specs import Spec, make_judge, spec_of_judge
from .training_attacks import FAMILIES, HELD_OUT, TrainingAttacks, check_not_held_out
from .versions import versions

PARTS = {"train": "dataset-train", "validation": "dataset-validation", "test": "dataset-test"}
"""Splits of a data set, and what `simulators.splits` calls them."""
TERMS: tuple[Any, ...] = (
    "innovation",
    "innovation-sd",
    "in-view",
    "line-of-sight",
    "chi-square",
    {"name": "classic", "detector": {"name": "solution-separation"}},
    {"name": "classic", "detector": {"name": "aime", "signals": "range_rate"}},
    {"name": "classic", "detector": {"name": "sequential-chi2", "signals": "range_rate"}},
    {"name": "classic", "detector": {"name": "cumulative-bank", "signals": "range_rate"}},
)
"""What is observed by default.  The time since switch-on is not: attacks of a data set all start at
the same, which a detector must not rely on."""
RUNS = {"train": 768, "validation": 256, "test": 256}
LARGEST = float(np.finfo(np.float16).max)


@dataclass(frozen=True)
class Plan:
    """What a data set is to be made of.

    Parameters
    ----------
    setup : Setup
        World, victim, attack and timeline; its detector does not matter.
    length_m : float
        Alert limit, which attacks are drawn around [m].
    detector : str, dict or Detector, optional
        Whose statistic the family ``"feedback"`` sees; passive.  None leaves that family out.
    terms : sequence
        What is observed, as `spoofgym.detectors.learned.observer.make_detector_terms` takes it.
    families : sequence of str, optional
        Some of `FAMILIES`; by default all that can be made.
    optima : sequence of sequence of float
        Rates of blind optima at their knots [m/s]; none leaves that family out.
    spoofers : sequence of dict
        Further spoofers by name and settings, such as ``{"name": "mine.onnx"}``.
    runs : mapping
        Runs of the splits ``"train"``, ``"validation"`` and ``"test"``.
    entropy : int
        Seed of the random number generators.
    shard : int
        Runs of a file.
    task : str, optional
        Task whose world it is.

    Raises
    ------
    ValueError
        Where a value makes no sense, a family can't be made, or the detector de-weights.
    """

    setup: Setup
    length_m: float
    detector: Any = None
    terms: Sequence[Any] = TERMS
    families: Sequence[str] | None = None
    optima: Sequence[Sequence[float]] = ()
    spoofers: Sequence[Spec] = ()
    runs: Mapping[str, int] = field(default_factory=lambda: dict(RUNS))
    entropy: int = 0
    shard: int = 64
    task: str | None = None

    def __post_init__(self) -> None:
        check_finite("length_m", self.length_m, "> 0")
        for name, least in (("entropy", 0), ("shard", 1)):
            whole_number(f"`{name}`", getattr(self, name), least)
        for part, runs in self.runs.items():
            check_choice("split of a data set", part, PARTS)
            whole_number(f"`runs[{part!r}]`", runs, 1)
        if self.setup.repeat > 1:
            raise ValueError(
                "attacks of a data set decide at every epoch: leave out `decision_interval_s`"
            )
        check_not_held_out(self.setup.attack, self.task)
        missing = {"feedback": self.detector is None, "blind-optimum": not self.optima}
        for name in self.families or ():
            check_choice("family of attacks", name, FAMILIES)
            if missing.get(name):
                needs = "a detector" if name == "feedback" else "curves that a search has found"
                raise ValueError(f"the family {name!r} needs {needs}, and none is given")
        if self.families is None:
            found = tuple(name for name in FAMILIES if not missing.get(name))
            object.__setattr__(self, "families", found)
        # whatever its thresholds, which may still be to be calibrated
        if any(weighs(self.setup, each) for each in inner_detectors(self.judge)):
            raise ValueError(
                "the detector that feedback sees must be passive, since the receiver that learns "
                f"has another one in its place, but {self.detector!r} de-weights"
            )
        self.attacks  # noqa: B018  # or what is wrong with a spoofer

    @cached_property
    def judge(self) -> Detector:
        """Detector in the loop."""
        return Never() if self.detector is None else make_judge(self.detector)

    @cached_property
    def world(self) -> Setup:
        """With that detector, and what observes."""
        watcher = DetectorAgent(weighs=False, exclusion_s=None, terms=self.terms)
        return self.setup.altered(detector=self.judge, monitors=[PassiveDetectors([watcher])])

    @cached_property
    def attacks(self) -> TrainingAttacks:
        """Who attacks."""
        named = self.families or ()
        return TrainingAttacks(self.world, self.length_m, named, self.optima, self.spoofers)

    @cached_property
    def config(self) -> dict[str, Any]:
        """Everything that the data depend on, JSON-able."""
        setup = self.setup
        simulator: Simulator = self.world.simulator(1, run_serially)
        seen = watcher_of(simulator).observer
        if np.abs([seen.low, seen.high]).max() > LARGEST:
            raise ValueError(f"observations must lie within {LARGEST:g}, to be kept as float16")
        return {
            "task": self.task,
            "world": setup.conditions.settings,
            "attack": describe(setup.attack),
            "detector": None if self.detector is None else spec_of_judge(self.judge),
            "threshold": factors_of(self.world.detector),
            "length_m": float(self.length_m),
            "interval_s": setup.interval_s,
            "epochs": {
                "live": setup.live,
                "steps": setup.steps,
                "hold": setup.hold,
                "all": setup.live + setup.steps + setup.hold,
            },
            "terms": list(written_terms(make_detector_terms(self.terms))),
            "observation": {
                "names": list(seen.names),
                "low": seen.low.tolist(),
                "high": seen.high.tolist(),
            },
            "families": list(self.attacks.families),
            "held_out": list(HELD_OUT),
            "optima": describe(self.optima),
            "spoofers": describe(self.spoofers),
            "files": outside_sources(*self.spoofers, self.judge),
            "skies": setup.domain.pairs(),
            "runs": dict(self.runs),
            "entropy": self.entropy,
            "splits": {part: SPLITS[PARTS[part]] for part in self.runs},
            "shard": self.shard,
            "versions": versions(),
        }

    @cached_property
    def digest(self) -> str:
        """Digest of `config`."""
        return digest_of(json.loads(json.dumps(self.config)))


def watcher_of(simulator: Simulator) -> DetectorAgent:
    (found,) = simulator.monitor(PassiveDetectors).detectors
    assert isinstance(found, DetectorAgent)  # of `Plan.world`
    return found
