"""Stored trajectories of every environment: what an id does, and goes on doing.

``python -m tests.golden.trajectories`` plays the cases and writes those that have no file yet.  A
file that is there is never written again: the behaviour of an id does not change, and what would
change it gets a new ``-vN``, which gets a file of its own.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from spoofgym import duel_v0
from spoofgym.detectors import calibrated
from spoofgym.truth.noise import normals, threefry
from spoofgym.truth.robot import episode_keys
from spoofgym.truth.sensors import SOURCES, SensorBuffers

FOLDER = Path(__file__).with_name("trajectories")
RECEIVERS, STEPS, SEED = 2, 40, 20261121
DEFAULT = "spoofgym/TightlyCoupled-v0"
SAME_AS_DEFAULT = "spoofgym/BenchS1-v2"
AGED = (SAME_AS_DEFAULT, "spoofgym/BenchS2-v2", "spoofgym/BenchS3-v2", "spoofgym/Offsets-v0")
FEW = {
    **dict.fromkeys(["BenchS1-v2", "Offsets-v0", "SpooferView-v0"], 10),
    **dict.fromkeys(["BenchD1-v2", "BenchD4-v1", "DetectorView-v0", "duel_v0-parallel"], 16),
}
"""Steps of what takes long, past several episodes of a spoofer; all that are stored are played
nightly."""
Record = dict[str, np.ndarray]


def action_at(step: int, shape: tuple[int, ...]) -> np.ndarray:
    """The same numbers on every machine: multiples of 1/16 in [-0.5, 0.5]."""
    counts = np.arange(np.prod(shape)).reshape(shape)
    return ((7 * (step // 5) + 5 * counts) % 17 - 8).astype(np.float32) / 16


def stacked(rows: list[dict[str, Any]]) -> Record:
    """Arrays of all steps; one in which all episodes begin tells no info, and is zero there."""
    empty = {name: np.zeros_like(value) for row in rows for name, value in row.items()}
    return {name: np.stack([row.get(name, empty[name]) for row in rows]) for name in empty}


def play(name: str, receivers: int = RECEIVERS, steps: int = STEPS) -> Record:
    """Play an id as it is registered, all of a step in one row of every array; every episode with
    a past of its own."""
    own = {"warm_pool": 0} if name.startswith(AGED) else {}
    envs = gym.make_vec(name, num_envs=receivers, **own)
    observation, _ = envs.reset(seed=SEED)
    rows, first = [], observation
    for k in range(steps):
        given = action_at(k, envs.action_space.shape)
        observation, reward, terminated, truncated, info = envs.step(given)
        told = {f"info_{key}": info[key] for key in info if not key.startswith("_")}
        ends = {"terminated": terminated, "truncated": truncated}
        rows.append({"observation": observation, "reward": reward, **ends, **told})
    envs.close()
    return {"first": first, **stacked(rows)}


def numbers(info: dict[str, Any]) -> Record:
    """Entries of an info that are numbers or truth values."""
    return {key: np.asarray(value) for key, value in info.items() if not isinstance(value, str)}


def play_parallel(steps: int = STEPS) -> Record:
    env = duel_v0.parallel_env()
    first, _ = env.reset(seed=SEED)
    rows = []
    for k in range(steps):
        actions = {name: action_at(k, env.action_space(name).shape) for name in env.agents}
        observations, rewards, ends, _, infos = env.step(actions)
        row: dict[str, Any] = {}
        for name in actions:
            row[f"{name}_observation"] = observations[name]
            row[f"{name}_reward"], row[f"{name}_terminated"] = rewards[name], ends[name]
            told = numbers(infos[name]).items()
            row |= {f"{name}_info_{key}": value for key, value in told}
        rows.append(row)
        if not env.agents:
            env.reset()
    named = {f"{name}_first": array for name, array in first.items()}
    return {**named, **stacked(rows)}


def play_aec(steps: int = STEPS) -> Record:
    env = duel_v0.env()
    env.reset(seed=SEED)
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in env.possible_agents}
    for k in range(2 * steps):
        name = env.agent_selection  # a spoofer decides more seldom
        observation, reward, terminated, _, _ = env.last()
        row = {"observation": observation, "reward": reward, "terminated": terminated}
        rows[name].append(row)
        shape = env.action_space(name).shape
        env.step(None if terminated else action_at(k // 2, shape))
        if not env.agents:
            env.reset()
    parts = {name: stacked(row) for name, row in rows.items()}
    return {f"{name}_{key}": array for name, part in parts.items() for key, array in part.items()}


def cases() -> dict[str, Callable[..., Record]]:
    """Everything that is stored, by the names of the files; each takes a number of steps."""
    ids = sorted(name for name in gym.registry if name.startswith("spoofgym/") and name != DEFAULT)
    table: dict[str, Callable[..., Record]] = {
        name.removeprefix("spoofgym/"): partial(play, name) for name in ids
    }
    return {**table, "duel_v0-parallel": play_parallel, "duel_v0-aec": play_aec}


def digest(record: Record) -> str:
    """Digest of all bits of a record, to compare processes of one machine."""
    total = hashlib.sha256()
    for name in sorted(record):
        total.update(name.encode() + np.ascontiguousarray(record[name]).tobytes())
    return total.hexdigest()


def noise_keys(seed: int) -> np.ndarray:
    """(S, 2) keys of all sources of noise in the first and second episode of a receiver."""
    sensors, rngs = SensorBuffers(1, 4), [np.random.default_rng(seed)]
    keys = []
    for _ in range(2):
        sensors.draw_keys(np.array([0]), rngs)
        keys.append(sensors.keys.reshape(len(SOURCES), 2).copy())
    odometry, _ = episode_keys(np.random.SeedSequence(seed).spawn(1)[0])
    return np.concatenate([*keys, odometry.reshape(-1, 2)])


def noise_digest(seeds: range = range(8), epochs: tuple[int, ...] = (0, 1, 1000)) -> str:
    """Digest of keys, random words and deviates, these in units of 1e-9.

    Keys and words are integers, the same on every machine.  The last bits of a deviate may be
    others elsewhere; none of these comes closer to the middle between two units than 4e-15.
    """
    total, out = hashlib.sha256(), np.empty(64)
    for seed in seeds:
        keys = noise_keys(seed)
        total.update(keys.astype("<u8").tobytes())
        for k0, k1 in keys:
            for epoch in epochs:
                words = threefry(np.uint64(5), np.uint64(epoch), k0, k1)
                total.update(np.array([int(word) for word in words], dtype="<u8").tobytes())
                normals(k0, k1, epoch, out)
                total.update(np.rint(out * 1e9).astype("<i8").tobytes())
    return total.hexdigest()


def load(name: str) -> Record:
    with np.load(FOLDER / f"{name}.npz") as stored:
        return {key: stored[key] for key in stored.files}


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    calibrated.DEFAULT_RATE = None  # as in the tests: what is stored has nominal thresholds
    for name, case in cases().items():
        path = FOLDER / f"{name}.npz"
        print(name, "kept" if path.exists() else "written")
        if not path.exists():
            np.savez_compressed(path, **case())
    print(noise_digest()[:16], "noise")


if __name__ == "__main__":
    main()
