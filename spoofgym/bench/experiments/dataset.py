"""Episodes to train detectors on.

Attacks that a detector learns from: families, and what is drawn of each for every episode.

They are drawn so that some are hard to see: where an attack would get to by the end of its window
is log-uniform, from an eighth of the alert limit to five times that.  The families that the tasks
for detectors hold out (`HELD_OUT`) are not among them.

Data sets to train a detector on: labelled episodes of one world, from its switch-on on.

Every run is played twice, with the same noise: attacked, and not.  Both are episodes, in which is
kept what a learned detector observes at each epoch, whether an attack is on, and how far it has
moved the solution.  Runs of the splits of a data set share no noise with each other, nor with those
of a campaign, a calibration or a search (`simulation.setup`).

A data set is a folder: shards, each an ``.npz`` file of some runs, and `MANIFEST`, which is written
last.  A process that was killed goes on from the shards that are whole, and comes to the same
bytes.

>>> from spoofgym.bench.experiments.dataset import Plan, load, write
>>> write("data", Plan(setup, length_m=20.0))  # doctest: +SKIP
>>> load("data").episodes("train").observation.shape  # doctest: +SKIP
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...attacks import Meaconer
from ...attacks.equipment import QUIET, CounterfeitErrors
from ...calibration.clean_runs import Stopped, in_order, weighs
from ...calibration.thresholds import inner_detectors
from ...core.files import remove_stale_parts, write_file
from ...core.progress import NullProgress, ProgressCallback
from ...core.registry import Spec, check_choice, check_finite, whole_number
from ...core.settings import describe, digest_of, outside_sources
from ...detectors import Detector, Never, detector_in_world
from ...detectors.build import spec_of_judge
from ...detectors.calibrated import factors_of
from ...detectors.learned import DetectorAgent
from ...detectors.observation import make_detector_terms, written_terms
from ...envs.decisions import Decisions
from ...envs.observer import Observer
from ...envs.options import checked_action
from ...envs.spoofer_binding import bound_spoofer, commands_of, monitors_for, paced, spoofer_context
from ...envs.terms.action import CommandMap
from ...envs.terms.observation import default_terms
from ...simulation.engine import Engine, available_threads
from ...simulation.monitors import PassiveDetectors
from ...simulation.setup import SPLITS, Setup, generators_of, seeds_of_runs
from ...simulation.simulator import Simulator, run_serially
from ...spoofers import Spoofer, SpooferContext, make_spoofer
from ...spoofers.aim import has_heading
from ...spoofers.scaled import AMPLITUDE
from ..runs.play import epochs_of, horizontal, to_local
from ..search.attack_suite import KNOTS, SHAPES
from .dataset_files import (
    FORMAT,
    KIND,
    MANIFEST,
    Dataset,
    Episodes,
    digest_in,
    load,
    packed,
    read_manifest,
    whole,
)
from .identity import versions

__all__ = ["Dataset", "Episodes", "Plan", "load", "make_room", "play", "write"]


HELD_OUT = (
    "quiet",
    "inherited, in the world of T5",
    "subset of channels",
    "meaconer",
    "onset in a turn",
    "onset at a satellite switch",
    "onset after a chance alarm",
)
"""Families of the tasks for detectors, which no training data have; onsets in a data set are drawn
as the world draws them."""
QUIET_TASKS = ("T5",)
"""Tasks whose own counterfeit is quieter than nature; there the plain one is held out."""
REACH = (0.125, 5.0)
"""Range of the displacement at the end of a window, in alert limits; log-uniform."""
AMPLITUDES = (0.25, 2.0)
"""Range of the factor on spoofers that are given, or were found by a search; log-uniform."""
POWERS = (0.3, 4.0)
"""Range of the power of time in a profile that is none of the attack suite's."""
LAST_PARTS = (0.1, 0.6)
"""Range of the part of the window in which a dash takes place."""


class TrainingAttacks:
    """Families of attacks in one world.

    `setup`: victim and attack, with the detector in the loop; `reach_m`: what `REACH` is in parts
    of: an alert limit; `families`: some of `FAMILIES`; `optima`: rates of blind optima at their
    knots, for the family of that name [m/s]; `spoofers`: names and settings of further spoofers,
    each a family of its own, as `make_spoofer` takes them; an ONNX file, too.
    """

    def __init__(
        self,
        setup: Setup,
        reach_m: float,
        families: Sequence[str],
        optima: Sequence[Sequence[float]] = (),
        spoofers: Sequence[Spec] = (),
    ) -> None:
        for spec in spoofers:
            made = make_spoofer(spec)
            if not made.transmits:
                raise ValueError(f"the spoofer {spec['name']!r} transmits nothing: it is no attack")
            watched = setup.altered(monitors=monitors_for([made], setup))
            made.bind(bound_spoofer(made, watched, 1)[0])  # or what does not fit
        self._context = spoofer_context(setup)
        self._reach_m, self._optima, self._spoofers = reach_m, list(optima), list(spoofers)
        self._makers: dict[str, Callable[[np.random.Generator, float], Spec]] = {
            name: getattr(self, f"_{name.replace('-', '_')}") for name in families
        }
        self.families = (*families, *(label_of(spec) for spec in spoofers))

    def draw(self, rng: np.random.Generator) -> tuple[int, Spec]:
        """Family, by its number, and settings of one attack; all families are as likely."""
        family = int(rng.integers(len(self.families)))
        own = family - len(self._makers)
        if own >= 0:
            return family, {**self._spoofers[own], AMPLITUDE: rounded(log_uniform(rng, AMPLITUDES))}
        goal_m = self._reach_m * log_uniform(rng, REACH)
        spec = self._makers[self.families[family]](rng, goal_m)
        if has_heading(self._context.action_names):
            spec["heading_deg"] = rounded(rng.uniform(0.0, 360.0))
        return family, spec

    @property
    def _window_s(self) -> float:
        return self._context.steps * self._context.interval_s

    def _rate(self, rate: float) -> float:
        """A rate that the attack allows."""
        return rounded(min(rate, self._context.largest_rate[1]))

    def _ramp(self, rng: np.random.Generator, goal_m: float) -> Spec:
        return {"name": "ramp", "rate_mps": self._rate(goal_m / self._window_s)}

    def _accelerating_ramp(self, rng: np.random.Generator, goal_m: float) -> Spec:
        wanted = 2.0 * goal_m / self._window_s**2
        if self._context.control != "rate":
            wanted = min(wanted, self._context.acceleration_limit_mps2)
        return {"name": "accelerating-ramp", "acceleration_mps2": rounded(wanted)}

    def _profile(self, rng: np.random.Generator, goal_m: float) -> Spec:
        """A shape of the attack suite, or a power of the time."""
        time, shapes = np.linspace(0.0, 1.0, KNOTS), list(SHAPES.values())
        which, power = int(rng.integers(2 * len(shapes))), rng.uniform(*POWERS)
        shape = shapes[which](time) if which < len(shapes) else time**power
        return self._curve("profile", shape, goal_m)

    def _blind_optimum(self, rng: np.random.Generator, goal_m: float) -> Spec:
        rates = self._optima[int(rng.integers(len(self._optima)))]
        return self._curve("blind-optimum", np.asarray(rates, dtype=np.float64), goal_m)

    def _curve(self, name: str, shape: FloatArray, goal_m: float) -> Spec:
        rates = (
            shape
            * goal_m
            / (float(np.trapezoid(shape, dx=1.0 / (len(shape) - 1))) * self._window_s)
        )
        return {"name": name, "rates_mps": [self._rate(float(rate)) for rate in rates]}

    def _dash(self, rng: np.random.Generator, goal_m: float) -> Spec:
        last_s = self._window_s * rng.uniform(*LAST_PARTS)
        return {"name": "dash", "rate_mps": self._rate(goal_m / last_s), "last_s": rounded(last_s)}

    def _feedback(self, rng: np.random.Generator, goal_m: float) -> Spec:
        """By the detector in the loop; how carefully is drawn, too."""
        growth, full = rng.uniform(0.0, 6.0), rng.uniform(0.2, 0.7)
        return {
            "name": "feedback",
            "rate_mps": self._rate(2.0 * goal_m / (self._window_s * (1.0 + growth))),
            "growth": rounded(growth),
            "full_ratio": rounded(full),
            "zero_ratio": rounded(full + rng.uniform(0.2, 0.6)),
            "back": rounded(rng.uniform(-1.0, 0.0)),
        }


def check_not_held_out(attack: Any, task: str | None) -> None:
    """Raise where all that an attack does belongs to a family that is held out."""
    errors = getattr(attack, "errors", "inherited")
    # however they are blended in, errors of the counterfeits' own may be smaller than real ones
    quiet = isinstance(errors, CounterfeitErrors)
    found = {
        "quiet": quiet and not (task in QUIET_TASKS and errors == QUIET),
        "inherited": not quiet and task in QUIET_TASKS,
        "subset of channels": getattr(attack, "channels", "all") != "all",
        "meaconer": isinstance(attack, Meaconer),
    }
    if named := [name for name, held in found.items() if held]:
        raise ValueError(
            f"the attack belongs to what the tasks for detectors have held out ({named[0]}): a "
            "detector that has learned from it could not be compared there"
        )


FAMILIES = {
    "ramp": "ramps",
    "accelerating-ramp": "ramps that accelerate",
    "profile": "the attack suite's profiles, and powers of the time",
    "dash": "dashes",
    "blind-optimum": "curves that a search has found against the detectors of this world",
    "feedback": "feedback from the statistic of the detector in the loop",
}
"""Families by name."""


def label_of(spec: Spec) -> str:
    return str(make_spoofer(spec).label or spec["name"])


def log_uniform(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    """A number whose logarithm is uniform."""
    return math.exp(rng.uniform(math.log(bounds[0]), math.log(bounds[1])))


def rounded(value: float) -> float:
    """Six digits, so that a setting can be read."""
    return float(f"{value:.6g}")


class Attackers:
    """Spoofers each of which commands one receiver of an engine, which are at their onset. `specs`:
    one a receiver; `observers` are kept from one engine to the next."""

    def __init__(
        self, specs: Sequence[Spec], engine: Engine, observers: dict[Any, Observer]
    ) -> None:
        setup = engine.setup
        self._engine, self._observers = engine, observers
        self._members: list[tuple[Spoofer, CommandMap, Decisions, Any]] = []
        for row, spec in enumerate(specs):
            spoofer = make_spoofer(spec)
            commands = commands_of(spoofer, setup)
            seen = spoofer.knowledge, commands.along_target
            if seen not in observers:
                terms = default_terms(setup, seen[0], along_target=seen[1])
                observers[seen] = Observer(terms, setup)
            own = paced(setup, spoofer)
            context: SpooferContext = spoofer_context(own, 1, observers[seen], commands)
            spoofer.bind(context)
            spoofer.reset()
            commands.aim(engine.simulator.heading[row : row + 1])
            decisions = Decisions(own, 1, len(commands.names))
            self._members.append((spoofer, commands, decisions, seen))

    def command(self, epoch: int) -> FloatArray:
        """Command (B, a) of an epoch, counted from the onset on."""
        engine = self._engine
        wanted = {seen for _, _, decisions, seen in self._members if decisions.due(epoch)}
        seen_by = {seen: self._observers[seen](engine, epoch) for seen in wanted}
        rate = engine.simulator.commanded_rate
        out = np.zeros((engine.receivers, len(engine.setup.action_names)))
        for row, (spoofer, commands, decisions, seen) in enumerate(self._members):
            own = slice(row, row + 1)
            if decisions.due(epoch):
                shape = 1, len(commands.names)
                action = checked_action(spoofer.act(seen_by[seen][own]), shape, commands.names)
                decisions.take(action)
            out[own] = commands.command(decisions.action(epoch), rate[own])
        return out


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
        What is observed, as `spoofgym.detectors.observation.make_detector_terms` takes it.
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
        return Never() if self.detector is None else detector_in_world(self.detector)

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


FloatArray = NDArray[np.float64]

ATTACK_STREAM = 0xA7
"""Last element of the spawn key from which the attack of a run is drawn, apart from its noise."""


def write(
    folder: str | os.PathLike[str],
    plan: Plan,
    *,
    threads: int | None = None,
    progress: ProgressCallback | None = None,
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
    progress : ProgressCallback, optional
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
    path, progress = Path(folder), progress or NullProgress()
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
        episodes = None if content is None else whole(content, plan.digest)
        if episodes is None:
            episodes = play(plan, part, numbers, observers, stopped)
            content = packed(episodes, plan.digest)
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
    digests = {file: digest_in(file.read_bytes()) for file in own}
    # a damaged shard is written again, in a folder that is a data set by something else in it
    known = (path / MANIFEST).is_file() or digest in digests.values()
    other = [file for file, its in digests.items() if its not in (digest, None if known else "")]
    if (path / MANIFEST).is_file() and read_manifest(path).get("digest") != digest:
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


def _observed(simulator: Simulator) -> NDArray[np.float32]:
    """(B, o) what is observed now."""
    return watcher_of(simulator).memory["observation"]


def _check(stopped: threading.Event | None) -> None:
    if stopped is not None and stopped.is_set():
        raise Stopped
