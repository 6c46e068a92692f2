"""Data sets to train a detector on: labelled episodes of one world, from its switch-on on.

Every run is played twice, with the same noise: attacked, and not.  Both are episodes, in which is
kept what a learned detector observes at each epoch, whether an attack is on, and how far it has
moved the solution.  Runs of the splits of a data set share no noise with each other, nor with those
of a campaign, a calibration or a search (`simulators.splits`).

A data set is a folder: shards, each an ``.npz`` file of some runs, and `MANIFEST`, which is written
last.  A process that was killed goes on from the shards that are whole, and comes to the same
bytes.

>>> from spoofgym.bench.dataset import Plan, load, write
>>> write("data", Plan(setup, length_m=20.0))  # doctest: +SKIP
>>> load("data").episodes("train").observation.shape  # doctest: +SKIP
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import threading
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._describe import describe, digest_of, outside_sources
from .._files import remove_stale_parts, write_file
from .._registry import check_choice, check_finite, whole_number
from ..detectors import Detector, Never
from ..detectors.learned.agent import DetectorAgent
from ..detectors.learned.observer import make_detector_terms, written_terms
from ..envs.observer import Observer
from ..simulators.base import Simulator, run_serially
from ..simulators.clean_runs import Progress, Silent, Stopped, in_order, weighs
from ..simulators.engine import Engine, available_threads
from ..simulators.monitors import PassiveDetectors
from ..simulators.setup import Setup
from ..simulators.splits import SPLITS, generators_of, seeds_of_runs
from .run import epochs_of, horizontal, to_local
from .specs import Spec, make_judge, spec_of_judge
from .suite import versions
from .training_attacks import FAMILIES, HELD_OUT, Attackers, TrainingAttacks, check_not_held_out

FloatArray = NDArray[np.float64]
KIND, FORMAT = "spoofgym-dataset", 1
"""What a manifest is of; other arrays, or another meaning of one, are another format."""
MANIFEST = "manifest.json"
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
ATTACK_STREAM = 0xA7
"""Last element of the spawn key from which the attack of a run is drawn, apart from its noise."""
LARGEST = float(np.finfo(np.float16).max)


class Episodes(NamedTuple):
    """Labelled episodes, L epochs each, from switch-on to the end of the time to alert.

    Attributes
    ----------
    observation : ndarray
        (E, L, o) float16, what a learned detector observes; the rounding is to 11 bits.
    attack : ndarray
        (E, L) bool, whether an attack is on.
    displacement_m : ndarray
        (E, L) float32, horizontal distance of the solution from that of the clean twin [m].
    clean : ndarray
        (E,) bool, whether nobody attacks.
    family : ndarray
        (E,) number of the attack's family in the manifest's ``families``; -1 where it is clean.
    setting : ndarray
        (E,) str, the attack's name and settings as JSON; "" where it is clean.
    run : ndarray
        (E,) run of the split; the two episodes of a run are twins.
    world : ndarray
        (E,) which of the manifest's ``skies``.
    onset_s : ndarray
        (E,) time of the flight at which the attack starts, or would [s].
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
        """Check the settings."""
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
        if self.detector is not None and weighs(self.setup, self.judge):
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
        seen = _watcher(simulator).observer
        if np.abs([seen.low, seen.high]).max() > LARGEST:
            raise ValueError(f"observations must lie within {LARGEST:g}, to be kept as float16")
        return {
            "task": self.task,
            "world": setup.conditions.settings,
            "attack": describe(setup.attack),
            "detector": None if self.detector is None else spec_of_judge(self.judge),
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


def write(
    folder: str | os.PathLike[str],
    plan: Plan,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Play all runs of a plan, and write them down.

    Parameters
    ----------
    folder : path-like
        Where to; shards of the same plan that are there are kept.
    plan : Plan
        What to play.
    threads : int, optional
        Shards that are played side by side; by default all useful cores.
    progress : Progress, optional
        Shows how far it is, in runs.
    overwrite : bool
        Whether another data set in the folder may be replaced.

    Returns
    -------
    dict
        The manifest.

    Raises
    ------
    ValueError
        Where the folder holds something else.
    """
    path, progress = Path(folder), progress or Silent()
    make_room(path, plan, overwrite=overwrite)
    shards = [
        (part, number, range(start, min(start + plan.shard, runs)))
        for part, runs in plan.runs.items()
        for number, start in enumerate(range(0, runs, plan.shard))
    ]
    observers: dict[Any, Observer] = {}
    found: dict[str, list[dict[str, Any]]] = {part: [] for part in plan.runs}

    def one(shard: tuple[str, int, range], stopped: threading.Event) -> tuple[Any, ...]:
        part, number, numbers = shard
        file = path / f"{part}-{number:04d}.npz"
        content = file.read_bytes() if file.is_file() else None
        episodes = None if content is None else _whole(content, plan.digest)
        if episodes is None:
            episodes = play(plan, part, numbers, observers, stopped)
            content = _packed(episodes, plan.digest)
            write_file(file, content)
        assert content is not None  # read or made
        kept = {name: getattr(episodes, name) for name in ("clean", "family")}
        return part, file.name, hashlib.sha256(content).hexdigest(), len(content), kept

    def take(done: tuple[Any, ...]) -> None:
        part, name, sha256, size, kept = done
        counts = {"episodes": len(kept["clean"]), "clean": int(kept["clean"].sum())}
        attacks = np.bincount(kept["family"][~kept["clean"]], minlength=len(plan.attacks.families))
        line = {"file": name, "sha256": sha256, "bytes": size, **counts}
        found[part].append({**line, "families": attacks.tolist()})
        progress.advance(counts["episodes"] / 2.0, f"{part} runs")

    in_order(one, shards, take, available_threads(10**9) if threads is None else threads)
    manifest = {
        "kind": KIND,
        "format": FORMAT,
        "digest": plan.digest,
        "config": plan.config,
        "shards": found,
    }
    text = json.dumps(manifest, indent=1, allow_nan=False)
    write_file(path / MANIFEST, text.encode())
    return dict(json.loads(text))


def make_room(path: Path, plan: Plan, *, overwrite: bool = False) -> None:
    """Make the folder of a data set; what it holds of another one is refused, or removed.

    Parameters
    ----------
    path : Path
        Folder.
    plan : Plan
        Of the data set.
    overwrite : bool
        Whether another data set may be removed.

    Raises
    ------
    ValueError
        Where the folder holds something else.
    """
    digest = plan.digest  # or what is wrong with the plan, before anything is removed
    path.mkdir(parents=True, exist_ok=True)
    remove_stale_parts(path)
    own = [file for part in PARTS for file in path.glob(f"{part}-[0-9][0-9][0-9][0-9].npz")]
    strange = {item for item in path.iterdir() if not item.name.endswith(".part")}
    strange -= {*own, path / MANIFEST}
    if strange:
        raise ValueError(
            f"{path} holds what is no data set ({', '.join(sorted(x.name for x in strange)[:5])}); "
            "choose another folder"
        )
    other = [file for file in own if _digest_in(file.read_bytes()) not in (digest, None)]
    if (path / MANIFEST).is_file() and _manifest(path).get("digest") != digest:
        other.append(path / MANIFEST)
    if other and not overwrite:
        raise ValueError(
            f"{path} holds another data set ({other[0].name}): choose another folder, or overwrite "
            "it"
        )
    for file in other:
        file.unlink()


def play(
    plan: Plan,
    part: str,
    numbers: Sequence[int],
    observers: dict[Any, Observer] | None = None,
    stopped: threading.Event | None = None,
) -> Episodes:
    """Play some runs of a split, attacked and not.

    Parameters
    ----------
    plan : Plan
        World and attacks.
    part : str
        Split, one of `PARTS`.
    numbers : sequence of int
        Which runs.
    observers : dict, optional
        What spoofers observe by, kept from one call to the next.
    stopped : threading.Event, optional
        Set where another thread has failed.

    Returns
    -------
    Episodes
        Two of every run: the clean one, then the attacked one.
    """
    setup, runs = plan.world, len(numbers)
    seeds = seeds_of_runs(plan.entropy, PARTS[part], setup.name, numbers)
    streams = [
        np.random.SeedSequence(s.entropy, spawn_key=(*s.spawn_key, ATTACK_STREAM)) for s in seeds
    ]
    drawn = [plan.attacks.draw(rng) for rng in generators_of(streams)]
    engine = Engine(runs, setup, threads=1)
    attacked, twin = engine.simulator, setup.simulator(runs, run_serially)
    epochs, everyone = setup.steps + setup.hold, np.arange(runs)
    seen = np.zeros((2, runs, setup.live + epochs, len(_observed(attacked)[0])), dtype=np.float16)
    attacked.begin(generators_of(seeds))
    attacked.quiet_epochs(setup.quiet)
    for k in range(setup.live):
        attacked.live_epochs(1)
        seen[:, :, k] = _observed(attacked)
        _check(stopped)
    twin.copy_rows(everyone, attacked, everyone)
    attackers = Attackers(
        [spec for _, spec in drawn], engine, {} if observers is None else observers
    )
    apart = np.zeros((epochs, *attacked.position.shape))
    for k in range(epochs):
        attacked.step(attackers.command(k) if k < setup.steps else None)
        twin.step(attacked=False)
        apart[k] = attacked.position - twin.position
        seen[0, :, setup.live + k], seen[1, :, setup.live + k] = (
            _observed(twin),
            _observed(attacked),
        )
        _check(stopped)
    induced = horizontal(to_local(apart, setup.C_en[epochs_of(setup, attacked.onset)]))
    return _labelled(plan, seen, induced, drawn, np.asarray(numbers), attacked.onset)


def _labelled(
    plan: Plan,
    seen: NDArray[np.float16],
    induced: FloatArray,
    drawn: Sequence[tuple[int, Spec]],
    numbers: NDArray[np.int64],
    onset: NDArray[np.int64],
) -> Episodes:
    """Episodes of (2, R, L, o) observations; `induced` (K, R) from the onset on [m]."""
    setup = plan.world
    _, runs, length, _ = seen.shape
    displacement = np.zeros((runs, 2, length), dtype=np.float32)
    displacement[:, 1, setup.live :] = induced.T
    attack = np.zeros((runs, 2, length), dtype=np.bool_)
    attack[:, 1, setup.live :] = True
    family = np.array([[-1, which] for which, _ in drawn], dtype=np.int16)
    setting = np.array([["", json.dumps(spec)] for _, spec in drawn])
    twice = np.repeat(onset, 2)
    return Episodes(
        observation=np.ascontiguousarray(seen.swapaxes(0, 1)).reshape(2 * runs, length, -1),
        attack=attack.reshape(2 * runs, length),
        displacement_m=displacement.reshape(2 * runs, length),
        clean=np.tile([True, False], runs),
        family=family.ravel(),
        setting=setting.ravel(),
        run=np.repeat(numbers, 2).astype(np.int64),
        world=twice // setup.epochs_each,
        onset_s=setup.epoch_time[twice],
    )


def _watcher(simulator: Simulator) -> DetectorAgent:
    """Who observes."""
    (found,) = simulator.monitor(PassiveDetectors).detectors
    assert isinstance(found, DetectorAgent)  # of `Plan.world`
    return found


def _observed(simulator: Simulator) -> NDArray[np.float32]:
    """(B, o) what is observed now."""
    return _watcher(simulator).memory["observation"]


def _check(stopped: threading.Event | None) -> None:
    if stopped is not None and stopped.is_set():
        raise Stopped


def _packed(episodes: Episodes, digest: str) -> bytes:
    """A shard; the same bytes for the same episodes."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, digest=np.array(digest), **episodes._asdict())
    return buffer.getvalue()


def _digest_in(content: bytes) -> str | None:
    """Digest of the plan that a shard is of; None where it is damaged."""
    try:
        with np.load(io.BytesIO(content)) as found:
            return str(found["digest"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _whole(content: bytes, digest: str) -> Episodes | None:
    """Episodes of a shard; None where it is damaged, or of another plan."""
    try:
        with np.load(io.BytesIO(content)) as found:
            if str(found["digest"]) != digest:
                return None
            return Episodes(*(found[name] for name in Episodes._fields))
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


def _manifest(path: Path) -> dict[str, Any]:
    """Manifest of a folder, of this format."""
    file = path / MANIFEST
    if not file.is_file():
        raise ValueError(
            f"{path} holds no {MANIFEST}: it is no data set, or one that is not finished, which "
            "`spoofgym dataset` with the same options goes on with"
        )
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, UnicodeDecodeError) as error:
        raise ValueError(f"{file} is damaged: {error}") from error
    if not isinstance(found, dict) or found.get("kind") != KIND:
        raise ValueError(f"{file} is no manifest of a data set")
    if found.get("format") != FORMAT:
        raise ValueError(
            f"{file} has the format {found.get('format')!r}, and this version of spoofgym reads "
            f"{FORMAT}: write the data set again"
        )
    if digest_of(found.get("config")) != found.get("digest"):
        raise ValueError(f"{file} is damaged: its settings do not have its digest")
    return found


@dataclass(frozen=True)
class Dataset:
    """A data set on disk; shards are read, and checked, when they are asked for.

    Attributes
    ----------
    path : Path
        Its folder.
    manifest : dict
        As it was written: ``config`` with all settings, ``digest`` of it, and ``shards``.
    """

    path: Path
    manifest: dict[str, Any]

    @property
    def config(self) -> dict[str, Any]:
        """Settings of the data: world, epochs, observation, families, seeds.

        Returns
        -------
        dict
            Of the manifest.
        """
        return dict(self.manifest["config"])

    @property
    def names(self) -> tuple[str, ...]:
        """Name of every element of an observation.

        Returns
        -------
        tuple of str
            (o,).
        """
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
            Where there is no such split, or a shard is missing, damaged, or does not fit the
            manifest.
        """
        check_choice("split of this data set", part, self.manifest["shards"])
        shards = [self._shard(line) for line in self.manifest["shards"][part]]
        return Episodes(*(np.concatenate(arrays) for arrays in zip(*shards, strict=True)))

    def _shard(self, line: Mapping[str, Any]) -> Episodes:
        file = self.path / line["file"]
        if not file.is_file():
            raise ValueError(f"{file} is missing: write the data set again, which makes that shard")
        content = file.read_bytes()
        if hashlib.sha256(content).hexdigest() != line["sha256"]:
            raise ValueError(
                f"{file} is damaged: its SHA-256 is not that of the manifest; delete it and write "
                "the data set again, which makes that shard"
            )
        found = _whole(content, self.manifest["digest"])
        length = self.config["epochs"]["all"]
        shape = line["episodes"], length, len(self.names)
        if found is None or found.observation.shape != shape:
            raise ValueError(f"{file} does not fit the manifest: it needs observations of {shape}")
        return found


def load(folder: str | os.PathLike[str]) -> Dataset:
    """A data set that `write` has written.

    Parameters
    ----------
    folder : path-like
        Where it is.

    Returns
    -------
    Dataset
        Nothing but its manifest has been read.

    Raises
    ------
    ValueError
        Where there is none, or it is of another format.
    """
    path = Path(folder)
    return Dataset(path, _manifest(path))
