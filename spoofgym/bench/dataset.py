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
import json
import os
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._files import remove_stale_parts, write_file
from ..envs.observer import Observer
from ..simulators.base import Simulator, run_serially
from ..simulators.clean_runs import Progress, Silent, Stopped, in_order
from ..simulators.engine import Engine, available_threads
from ..simulators.splits import generators_of, seeds_of_runs
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
from .dataset_plan import PARTS, Plan, watcher_of
from .run import epochs_of, horizontal, to_local
from .specs import Spec
from .training_attacks import Attackers

__all__ = ["Dataset", "Episodes", "Plan", "load", "make_room", "play", "write"]

FloatArray = NDArray[np.float64]

ATTACK_STREAM = 0xA7
"""Last element of the spawn key from which the attack of a run is drawn, apart from its noise."""


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
