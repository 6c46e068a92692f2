"""Played on the processor and by numba's simulator of a device, with the same pasts and keys.

Run in a process of its own, since numba reads ``NUMBA_ENABLE_CUDASIM`` when it is imported.
"""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import torch

from spoofgym.bench.experiments.calibration import calibrate
from spoofgym.cuda import CudaVectorEnv
from spoofgym.detectors.base import YoungMemoryWarning
from spoofgym.envs.factory import make_core, select_victim
from spoofgym.simulation.engine import seed_pasts
from spoofgym.simulation.tight import AFTER_ONSET
from spoofgym.truth.noise import threefry
from spoofgym.truth.sensors import SOURCES

RECEIVERS, PASTS, STEPS = 2, 3, 8


class Processor:
    """The same episodes in a core of the library."""

    def __init__(self, settings: dict[str, Any], seed: np.ndarray) -> None:
        kind = select_victim("tightly-coupled")
        self.core = make_core(kind, RECEIVERS, {**settings, "warm_pool": 0}, threads=1)
        self.pool = self.core.setup.simulator(PASTS, lambda work, b: work(0, b))
        self.pool.warm_up(seed_pasts(np.arange(PASTS)))
        self.core.engine.simulator.warm_up(seed_pasts(np.arange(RECEIVERS)))
        self.seed, self.number = seed, np.zeros(RECEIVERS, dtype=np.int64)

    def start(self, rows: np.ndarray) -> None:
        self.number[rows] += 1
        simulator = self.core.engine.simulator
        for b in rows.tolist():
            drawn = threefry(np.uint64(self.number[b]), np.uint64(b), *self.seed)
            word = tuple(map(np.uint64, drawn))
            row, past = np.array([b]), np.array([int(word[0] % np.uint64(PASTS))])
            simulator.copy_rows(row, self.pool, past)
            for name in AFTER_ONSET:
                key = threefry(np.uint64(SOURCES.index(name)), np.uint64(0), *word)
                simulator.sensors.words.put(name, row, np.array([key], dtype=np.uint64))
        self.core.score.reset(rows)
        self.core._decisions.forget(rows)
        self.core.commands.aim(self.core.heading_rad)
        self.core.set_origin(rows)


def compare(settings: dict[str, Any]) -> dict[str, int]:
    """Play both, and count what has been compared; an AssertionError where a bit differs."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", YoungMemoryWarning)
        device = CudaVectorEnv(RECEIVERS, pasts=PASTS, infos="all", **settings)
        device.reset(seed=5)
        seed = device._rows["seed"].numpy().view(np.uint64)
        cpu = Processor(settings, seed)
    flight = device._flight.tensors
    count = compare_lasting(flight, cpu.pool)
    same("warmup_alarm", flight["alarmed"], cpu.pool.memory["warmup_alarm"])
    every = np.arange(RECEIVERS)
    cpu.start(every)
    same("first observation", device.reset(seed=5)[0], cpu.core.observe())
    rng, ends = np.random.default_rng(3), 0
    for _ in range(STEPS):
        action = rng.uniform(-1.0, 1.0, (RECEIVERS, len(device.action_names)))
        result, last = cpu.core.step(action)
        seen, reward, terminated, _, info = device.step(torch.from_numpy(action))
        same("reward", reward, result.reward)
        same("terminated", terminated, result.terminated)
        same("final_obs", info.pop("final_obs"), last)
        assert set(info) == set(result.info), set(info) ^ set(result.info)
        for name, array in result.info.items():
            same(name, info[name], array)
            count += array.size
        if result.terminated.any():
            ends += 1
            cpu.start(np.flatnonzero(result.terminated))
        same("observation", seen, cpu.core.observe())
        count += last.size
    count += compare_lasting(device._arrays, cpu.core.engine.simulator)
    device.close()
    return {"numbers": count, "resets": ends}


def compare_calibrations(settings: dict[str, Any], detectors: list[Any]) -> dict[str, int]:
    """Thresholds of a few clean runs, found on both; what is in their files is equal."""
    setup = make_core(select_victim("tightly-coupled"), 1, settings).setup
    found = []
    with TemporaryDirectory() as folder:
        for device in ("cpu", "cuda"):
            home = Path(folder) / device
            how = {"runs": 4, "false_alarms_per_hour": 1200.0, "folder": home, "device": device}
            calibrate(setup, detectors, strict=False, **how)
            found.append({path.name: path.read_text() for path in home.rglob("*.json")})
    assert found[0] == found[1]
    return {"calibrations": len(found[0])}


def same(name: str, found: torch.Tensor, wanted: np.ndarray) -> None:
    np.testing.assert_array_equal(found.numpy(), wanted, err_msg=name)


def compare_lasting(tensors: Any, simulator: Any) -> int:
    """State, covariance, sensors and keys of all receivers."""
    found = {
        "x": simulator.buffers.fields.gather(),
        "sensors": simulator.sensors.fields.gather(),
        "in_run": simulator.sensors.in_run.gather(),
        "signals": simulator.sensors.signals.gather(),
        "epochs": simulator.sensors.epoch,
        "weights": simulator.weights,
    }
    for name, array in found.items():
        same(name, tensors[name], array)
    return sum(array.size for array in found.values())


if __name__ == "__main__":
    for case in json.loads(sys.argv[1]):
        judges = case.pop("calibrated", None)
        found = compare(case) if judges is None else compare_calibrations(case, judges)
        print(json.dumps(found), flush=True)
