"""Data sets to train a detector on: labelled episodes of one world, from its switch-on on.

Every run is played twice, with the same noise: attacked, and not.  Both are episodes, which
record what a learned detector observes at each epoch, whether an attack is on, and how far it has
moved the solution.  Runs of the splits of a data set share no noise with each other, nor with those
of a campaign, a calibration or a search (`simulation.setup`).

A data set is a folder of results, as other experiments have it; its files, in ``cells``, have some
runs each, and are `.npz` files.

>>> from spoofgym.bench.experiments import Store, run_experiment
>>> from spoofgym.bench.experiments.dataset import Plan, load_dataset
>>> run_experiment(Plan(setup, length_m=20.0), Store("data"))  # doctest: +SKIP
>>> load_dataset("data").episodes("train").observation.shape  # doctest: +SKIP
"""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...calibration.clean_runs import check_stopped, map_ordered
from ...calibration.thresholds import inner_detectors
from ...core.declared import setting, settings_record
from ...core.registry import Spec, check_choice, whole_number
from ...core.settings import compute_digest, describe, outside_sources
from ...detectors import Detector, Never, detector_in_world
from ...detectors.build import spec_of_judge
from ...detectors.calibrated import list_factors
from ...detectors.learned import DetectorAgent
from ...detectors.observation import make_detector_terms, written_terms
from ...simulation.engine import Engine
from ...simulation.monitors import PassiveDetectors
from ...simulation.setup import SPLITS, Setup, make_generators, seeds_of_runs
from ...simulation.simulator import Simulator, run_serially, weighs
from ..runs.play import FloatArray, horizontal, list_attack_epochs, to_local
from .runner import Context, Experiment
from .store import Cell, Reader, Result, Store
from .training_attacks import FAMILIES, HELD_OUT, Attackers, TrainingAttacks, check_not_held_out

__all__ = ["Dataset", "Episodes", "Plan", "load_dataset"]

PARTS = {"train": "dataset-train", "validation": "dataset-validation", "test": "dataset-test"}
"""Splits of a data set, and what `simulation.setup` calls them."""
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
"""What is observed by default.  The time since switch-on is not: where the world draws no ages
(`Domain.age_s`), attacks all start at the same, which a detector must not rely on."""
RUNS = {"train": 768, "validation": 256, "test": 256}
LARGEST = float(np.finfo(np.float16).max)


ATTACK_STREAM = 0xA7
"""Last element of the spawn key from which the attack of a run is drawn, apart from its noise."""
TOGETHER = 4
"""Files that threads share in one call."""


class Episodes(NamedTuple):
    """Labelled episodes, up to L epochs each, from switch-on to the end of the time to alert.

    Where the world draws ages, L is that of the oldest; all arrays are 0 after the end of an
    episode.

    Attributes
    ----------
    observation : ndarray
        (E, L, o) float16, what a learned detector observes; the rounding is to 11 bits.
    attack : ndarray
        (E, L) bool, whether an attack is on.
    displacement_m : ndarray
        (E, L) float32, horizontal distance of the solution from that of the clean twin [m].
    clean : ndarray
        (E,) bool, whether the episode is without an attack.
    family : ndarray
        (E,) number of the attack's family in the settings' ``families``; -1 where it is clean.
    setting : ndarray
        (E,) str, the attack's name and settings as JSON; "" where it is clean.
    run : ndarray
        (E,) run of the split; the two episodes of a run are twins.
    world : ndarray
        (E,) which of the settings' ``skies``.
    onset_s : ndarray
        (E,) time of the flight at which the attack starts, or would [s].
    epochs : ndarray
        (E,) epochs that the episode has.
    """

    observation: NDArray[np.float16]
    attack: NDArray[np.bool_]
    displacement_m: NDArray[np.float32]
    clean: NDArray[np.bool_]
    family: NDArray[np.int16]
    setting: NDArray[np.str_]
    run: NDArray[np.int64]
    world: NDArray[np.int64]
    onset_s: FloatArray
    epochs: NDArray[np.int64]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(E, L) bool, which epochs are of the episode."""
        return np.asarray(np.arange(self.attack.shape[1]) < self.epochs[:, None])


@settings_record(frozen=True)
class Plan(Experiment):
    """What a data set is to be made of.

    Raises
    ------
    ValueError
        Where a value makes no sense, a family can't be made, or the detector de-weights.
    """

    name: ClassVar[str] = "dataset"
    setup: Setup = setting(help="World, victim, attack, timeline; the setup's detector is ignored.")
    length_m: float = setting(
        above=0.0, unit="m", help="Alert limit, which attacks are drawn around."
    )
    detector: Any = setting(
        default=None,
        help='Its statistic is what the family ``"feedback"`` sees; passive. None leaves that '
        "family out.",
    )
    terms: Sequence[Any] = setting(
        default=TERMS,
        help="What is observed, as `spoofgym.detectors.observation.make_detector_terms` takes it.",
    )
    families: Sequence[str] | None = setting(
        default=None, help="Some of `FAMILIES`; by default all that can be made."
    )
    optima: Sequence[Sequence[float]] = setting(
        default=(),
        unit="m/s",
        help="Rates of optimized open-loop attacks at their knots; none leaves that family out.",
    )
    spoofers: Sequence[Spec] = setting(
        default=(), help='Further spoofers by name and settings, such as ``{"name": "mine.onnx"}``.'
    )
    runs: Mapping[str, int] = setting(
        default_factory=lambda: dict(RUNS),
        help='Runs of the splits ``"train"``, ``"validation"`` and ``"test"``.',
    )
    entropy: int = setting(default=0, least=0, help="Seed of the random number generators.")
    shard: int = setting(default=64, least=1, help="Runs of a file.")
    task: str | None = setting(default=None, help="Task that the world belongs to.")

    def __post_init__(self) -> None:
        for part, runs in self.runs.items():
            check_choice("split of a data set", part, PARTS)
            whole_number(f"`runs[{part!r}]`", runs, 1)
        if self.setup.repeat > 1:
            raise ValueError(
                "attacks of a data set decide at every epoch: leave out `decision_interval_s`"
            )
        check_not_held_out(self.setup.attack, self.task)
        missing = {"feedback": self.detector is None, "open-loop": not self.optima}
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
                "the detector that feedback sees must be passive, since the learned detector takes "
                f"its place, but {self.detector!r} de-weights"
            )
        self.attacks  # noqa: B018  # or what is wrong with a spoofer

    @cached_property
    def judge(self) -> Detector:
        return Never() if self.detector is None else detector_in_world(self.detector)

    @cached_property
    def world(self) -> Setup:
        """With that detector, and what observes."""
        watcher = DetectorAgent(weighs=False, exclusion_s=None, terms=self.terms)
        return self.setup.copy_with(detector=self.judge, monitors=[PassiveDetectors([watcher])])

    @cached_property
    def attacks(self) -> TrainingAttacks:
        named = self.families or ()
        return TrainingAttacks(self.world, self.length_m, named, self.optima, self.spoofers)

    @cached_property
    def config(self) -> dict[str, Any]:
        """Everything that the data depend on, JSON-able."""
        setup = self.setup
        simulator: Simulator = self.world.simulator(1, run_serially)
        seen = find_agent(simulator).observer
        if np.abs([seen.low, seen.high]).max() > LARGEST:
            raise ValueError(f"observations must lie within {LARGEST:g}, to be stored as float16")
        return {
            "task": self.task,
            "world": setup.conditions.settings,
            "attack": describe(setup.attack),
            "detector": None if self.detector is None else spec_of_judge(self.judge),
            "threshold": list_factors(self.world.detector),
            "length_m": float(self.length_m),
            "interval_s": setup.interval_s,
            "epochs": {
                **{name: getattr(setup, name) for name in ("live", "steps", "hold")},
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
        }

    def cells(self) -> Iterator[Cell]:
        return list_cells(self.runs, self.shard)

    def run_group(
        self, cells: Sequence[Cell], results: Reader, context: Context
    ) -> Iterator[Result]:
        played = map_ordered(
            lambda cell, stopped: self.play(*parse_cell(cell), stopped), cells, context.threads
        )
        for cell, episodes in zip(cells, played, strict=True):
            context.tick(cell.work)
            yield Result(episodes._asdict(), deflated=True)

    def play(
        self, part: str, numbers: Sequence[int], stopped: threading.Event | None = None
    ) -> Episodes:
        """Play runs of a split, attacked and not: two episodes each, the clean one first.
        `stopped`: set where another thread has failed."""
        setup, runs = self.world, len(numbers)
        seeds = seeds_of_runs(self.entropy, PARTS[part], setup.name, numbers)
        own = [
            np.random.SeedSequence(s.entropy, spawn_key=(*s.spawn_key, ATTACK_STREAM))
            for s in seeds
        ]
        drawn = [self.attacks.draw(rng) for rng in make_generators(own)]
        engine = Engine(runs, setup, threads=1)
        attacked, twin = engine.simulator, setup.simulator(runs, run_serially)
        epochs, everyone = setup.steps + setup.hold, np.arange(runs)
        names = len(_get_observation(attacked)[0])
        seen = np.zeros((runs, 2, setup.live + epochs, names), dtype=np.float16)
        attacked.switch_on(make_generators(seeds))
        live, gone = attacked.ages - setup.filter_only, 0
        for some, rows, count in attacked.ageing(setup.filter_only):
            for k in range(gone, gone + count):
                some.live_epochs(1)
                young = live[rows] > k
                seen[rows[young], :, k] = _get_observation(some)[young, None]
                check_stopped(stopped)
            gone += count
        twin.copy_rows(everyone, attacked, everyone)
        specs = [spec for _, spec in drawn]
        attackers = Attackers(specs, engine)
        apart = np.zeros((epochs, *attacked.position.shape))
        for k in range(epochs):
            attacked.step(attackers.command(k))
            twin.step(attacked=False)
            apart[k] = attacked.position - twin.position
            for which, each in enumerate((twin, attacked)):
                seen[everyone, which, live + k] = _get_observation(each)
            check_stopped(stopped)
        induced = horizontal(to_local(apart, setup.C_en[list_attack_epochs(setup, attacked.onset)]))
        displacement = np.zeros((runs, 2, setup.live + epochs), dtype=np.float32)
        attack = np.zeros(displacement.shape, dtype=np.bool_)
        window = everyone[:, None], 1, live[:, None] + np.arange(epochs)
        displacement[window], attack[window] = induced.T, True
        onset = np.repeat(attacked.onset, 2)
        return Episodes(
            observation=seen.reshape(2 * runs, *seen.shape[2:]),
            attack=attack.reshape(2 * runs, -1),
            displacement_m=displacement.reshape(2 * runs, -1),
            clean=np.tile([True, False], runs),
            family=np.array([[-1, which] for which, _ in drawn], dtype=np.int16).ravel(),
            setting=np.array([["", json.dumps(spec)] for spec in specs]).ravel(),
            run=np.repeat(np.asarray(numbers), 2).astype(np.int64),
            world=onset // setup.epochs_each,
            onset_s=setup.epoch_time[onset],
            epochs=np.repeat(live + epochs, 2),
        )

    def report(self, results: Reader) -> dict[str, Any]:
        """What was written: of each split, runs, episodes, clean ones, attacks by family, files."""
        splits, families = {}, self.attacks.families
        for part, runs in self.runs.items():
            keys = [cell.key for cell in self.cells() if parse_cell(cell)[0] == part]
            found = np.concatenate([results[key].arrays["family"] for key in keys])
            attacks = np.bincount(found[found >= 0], minlength=len(families)).tolist()
            splits[part] = {
                "runs": runs,
                "episodes": len(found),
                "clean": int((found < 0).sum()),
                "bytes": sum(results.store.build_path(key).stat().st_size for key in keys),
                "families": dict(zip(families, attacks, strict=True)),
                "shards": len(keys),
            }
        return {
            "digest": compute_digest(results.store.config),
            "task": self.task,
            "observations": len(self.config["observation"]["names"]),
            "epochs": self.config["epochs"],
            "splits": splits,
        }


def list_cells(runs: Mapping[str, int], shard: int) -> Iterator[Cell]:
    for part, count in runs.items():
        for number, first in enumerate(range(0, count, shard)):
            last = min(first + shard, count)
            group = f"{part} runs, part {number // TOGETHER + 1}"
            identity = {"split": part, "runs": [first, last]}
            yield Cell(f"{part}-{number:04d}", identity, float(last - first), group=group)


def parse_cell(cell: Cell) -> tuple[str, range]:
    """Split of a cell, and numbers of its runs."""
    assert cell.identity is not None
    return cell.identity["split"], range(*cell.identity["runs"])


def find_agent(simulator: Simulator) -> DetectorAgent:
    (found,) = simulator.monitor(PassiveDetectors).detectors
    assert isinstance(found, DetectorAgent)  # of `Plan.world`
    return found


def _get_observation(simulator: Simulator) -> NDArray[np.float32]:
    """(B, o) what is observed now."""
    return find_agent(simulator).memory["observation"]


@dataclass(frozen=True)
class Dataset:
    """A data set on disk; its files are read, and checked, when they are requested.

    Attributes
    ----------
    store : Store
        Its folder.
    config : dict
        All settings of the data: world, epochs, observation, families, seeds.
    """

    store: Store
    config: dict[str, Any]

    @property
    def digest(self) -> str:
        """Digest of the settings, and of the code that has made the data."""
        return compute_digest(self.store.config)

    @property
    def names(self) -> tuple[str, ...]:
        """Name of every element of an observation."""
        return tuple(self.config["observation"]["names"])

    def episodes(self, part: str) -> Episodes:
        """All episodes of a split.

        Parameters
        ----------
        part : str
            ``"train"``, ``"validation"`` or ``"test"``.

        Returns
        -------
        Episodes
            In the order of their runs.

        Raises
        ------
        ValueError
            Where there is no such split, or a file is missing, damaged, or of another data set.
        """
        return Episodes(*map(np.concatenate, zip(*self._files(part), strict=True)))

    def _files(self, part: str) -> Iterator[Episodes]:
        check_choice("split of this data set", part, self.config["runs"])
        for cell in list_cells(self.config["runs"], self.config["shard"]):
            if parse_cell(cell)[0] == part:
                found = self.store.get(cell)
                if found is None:
                    raise ValueError(
                        f"{self.store.build_path(cell.key)} is missing: `spoofgym dataset` "
                        "with the same options makes it"
                    )
                yield Episodes(**found.arrays)


def load_dataset(folder: str | os.PathLike[str]) -> Dataset:
    """A data set that `spoofgym dataset` has written.

    Parameters
    ----------
    folder : path-like
        Where it is.

    Returns
    -------
    Dataset
        Nothing but its settings has been read.

    Raises
    ------
    ValueError
        If the data set is absent, or of another format.
    """
    store = Store(folder)
    return Dataset(store, store.reopen(Plan.name))
