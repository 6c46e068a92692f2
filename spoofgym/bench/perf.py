"""What a step costs on this machine, part by part, beside the floor of its arithmetic.

B receivers of `ENV` have epochs of 1 s (100 inertial samples), the ``ewma`` detector in the loop
and the default observations; episodes do not end at an alarm.  All is measured in alternate rounds
and the least counts: processor time on one thread, time that has passed on several.
"""

from __future__ import annotations

import copy
import os
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from importlib.metadata import version
from typing import Any

import numba
import numpy as np
from llvmlite import binding

from .. import __version__
from .._lanes import LaneFields
from .._simd import LANES
from ..envs.core import SpoofCore
from ..sim.noise import padded
from . import _perf_kernels as kernels
from .campaign import Progress, Silent

Table = tuple[str, Sequence[str], Sequence[Sequence[str]]]
ENV = "spoofgym/TightlyCoupled-v0"
SETTINGS: dict[str, Any] = {
    "scenario": {"name": "zhong2025", "epoch_interval_s": 1.0},
    "detector": "ewma",
    "end_at_alarm": False,
}
RECEIVERS, THREADS = (1, 16, 64, 256, 1024), (1, 2)
ROUNDS, QUICK_ROUNDS = 7, 2
PIECE_S = 0.005
"""Shortest time of one measurement of a part."""
EPISODES = 2
"""Episodes of one measurement with warm-ups; one more comes before."""
KERNELS = {
    "noise of the inertial sensors": kernels.NOISE,
    "sensing and quantization": kernels.SENSE,
    "mechanization": kernels.MECHANIZE,
    "transition and covariance": kernels.PROPAGATE,
    "GNSS noise and measurement": kernels.MEASURE,
    "innovation and its variance": kernels.INNOVATE,
    "innovation covariance S, where wanted": kernels.COVARIANCE_S,
    "update": kernels.UPDATE,
    "floor": kernels.FLOOR,
}
NOT_IN_STEP = {"innovation covariance S, where wanted", "floor"}
FLOOR, ATTACK, JUDGE = "floor", "attack", "detector"
ENGINE, STEP, EPISODE = "engine step", "env step", "env step with warm-ups"
ROWS = {
    "sum_us": "all parts of an engine step",
    "step_over_floor": "engine step / floor",
    "env_steps_per_s": "env steps per second, with warm-ups",
}
TOTAL = "all of these"
VECTORS = {"avx512f": "AVX-512", "avx2": "AVX2", "sse4.2": "SSE4.2", "neon": "NEON"}


class Rig:
    """B receivers on some threads, and what of theirs is measured."""

    def __init__(self, receivers: int, threads: int) -> None:
        self.receivers, self.threads = receivers, threads
        self.clock = time.thread_time if threads == 1 else time.perf_counter
        self.env = _make(receivers, threads, False)
        self.whole = self.env if threads == 1 else _make(receivers, threads, True)
        self.core, self.engine = self.env.core, self.env.core.engine
        self.steps = self.core.setup.steps
        self.action = np.zeros(self.env.action_space.shape, dtype=np.float32)
        self.command = np.zeros((receivers, len(self.env.action_names)))
        groups = -(-receivers // LANES)
        self.ends = list(pairwise(groups * k // threads for k in range(threads + 1)))
        self._pool = ThreadPoolExecutor(threads)
        self.repeats = dict.fromkeys((*KERNELS, ATTACK, JUDGE), 1)
        self.env.reset(seed=0)
        self._times(self.steps // 2, self.env.step, self.action)
        simulator, setup = self.engine.simulator, self.core.setup
        world, victim = setup.world, setup.receiver
        sizes = padded(6 * world.most_samples), padded(2 * world.channels)
        rules = victim.covariance_code, victim.min_satellites, victim.orthonormalize, *sizes
        kept = simulator.buffers.fields, simulator.sensors.fields
        # copies, since parts leave the receivers as they like
        self._kept, (receiver, sensors) = copy.deepcopy(kept), copy.deepcopy(kept)
        self._changed = receiver, sensors
        rows = kernels.work_rows(world.channels, *sizes)
        self._works = [receiver.scratch(rows) for _ in range(threads)]
        self._lanes = receiver.data, sensors.data, simulator.sensors.words.data
        self._truth = world.run, world.epoch_time, world.epoch_end, world.satellites
        self._rules, self._epoch = np.array(rules, dtype=np.int64), int(simulator.epochs[0])

    def close(self) -> None:
        """End all threads."""
        self.core.close()
        self.whole.core.close()
        self._pool.shutdown()

    def _share(self, work: Callable[[int, int, int], object]) -> None:
        """Let each thread do its groups: ``work(thread, lo, hi)``."""
        if self.threads == 1:
            work(0, *self.ends[0])
            return
        jobs = [self._pool.submit(work, k, *ends) for k, ends in enumerate(self.ends)]
        for job in jobs:
            job.result()

    def run_part(self, part: int, rounds: int) -> None:
        """Do a part of an epoch so often, in all receivers."""
        given = part, rounds, self._epoch, *self._lanes, *self._truth, self._rules
        self._share(lambda k, lo, hi: kernels.repeat(*given, self._works[k], lo, hi))

    def _attack(self, rounds: int) -> None:
        attack, sensors = self.engine.simulator.attack, self.engine.simulator.sensors
        given = self.command, sensors.epoch, sensors.range_offset, sensors.rate_offset

        def command(_: int, lo: int, hi: int) -> None:
            for _ in range(rounds):
                attack.command(*given, LANES * lo, min(LANES * hi, self.receivers))

        self._share(command)

    def _times(self, count: int, work: Callable[..., object], *given: object) -> None:
        for _ in range(count):
            work(*given)

    def _seconds(self, work: Callable[..., object], *given: object) -> float:
        began = self.clock()
        work(*given)
        return self.clock() - began

    def part_seconds(self, name: str) -> float:
        """Of a part of an epoch, repeated until it can be measured."""
        work: Callable[[int], object] = {
            ATTACK: self._attack,
            JUDGE: lambda rounds: self._times(rounds, self.engine.judge),
        }.get(name) or partial(self.run_part, KERNELS[name])
        while True:
            for mine, kept in zip(self._changed, self._kept, strict=True):
                mine.data[...] = kept.data
            if (passed := self._seconds(work, self.repeats[name])) >= PIECE_S:
                return passed / self.repeats[name]
            self.repeats[name] *= 2

    def step_seconds(self, step: Callable[[Any], object], command: Any) -> float:
        """Of a step; the last one of an episode, with its time to alert, does not count."""
        self.env.reset(seed=0)
        return self._seconds(self._times, self.steps - 1, step, command) / (self.steps - 1)

    def _episodes(self, count: int) -> None:
        for _ in range(count):
            self._times(self.steps, self.whole.step, self.action)
            # one more step starts the next episodes of a vector environment
            self.whole.reset() if self.receivers == 1 else self.whole.step(self.action)

    def episode_seconds(self) -> float:
        """Of a step, with its share of the warm-up and of the time to alert."""
        self.whole.reset(seed=0)
        self._episodes(1)
        passed = self._seconds(self._episodes, EPISODES)
        self.whole.core.close()  # ends what goes on behind; it starts again when it is needed
        return passed / (EPISODES * self.steps)

    def measurements(self) -> dict[str, Callable[[], float]]:
        """What a round measures, by name [s]."""
        parts = {name: partial(self.part_seconds, name) for name in self.repeats}
        return {
            **parts,
            ENGINE: partial(self.step_seconds, self.engine.step, self.command),
            STEP: partial(self.step_seconds, self.env.step, self.action),
            EPISODE: self.episode_seconds,
        }


def _make(receivers: int, threads: int, prefetch: bool) -> Any:
    import gymnasium as gym

    if receivers == 1:
        return gym.make(ENV, **SETTINGS).unwrapped
    sizes = {"num_envs": receivers, "threads": threads, "prefetch": prefetch}
    return gym.make_vec(ENV, **sizes, **SETTINGS).unwrapped


def measure(
    receivers: Sequence[int] = RECEIVERS,
    threads: Sequence[int] = THREADS,
    *,
    rounds: int = ROUNDS,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Cost by part of so many receivers on so many threads, where these have a group each.

    Microseconds per receiver-epoch, the least of all rounds, and bytes per receiver.
    """
    shown = progress or Silent()
    chosen = [(b, t) for t in threads for b in receivers if _useful(b, t)]
    rigs: list[Rig] = []
    least: list[dict[str, float]] = [{} for _ in chosen]
    try:
        for b, t in chosen:
            rigs.append(Rig(b, t))
        for _ in range(rounds):
            for rig, found in zip(rigs, least, strict=True):
                for name, seconds in rig.measurements().items():
                    us = 1e6 * seconds() / rig.receivers
                    found[name] = min(us, found.get(name, us))
                    shown.advance(work_of(rig.receivers), f"{name}, {rig.receivers}")
        memory = {str(rig.receivers): bytes_by_owner(rig.core) for rig in rigs}
    finally:
        for rig in rigs:
            rig.close()
    runs = [
        {
            "receivers": b,
            "threads": t,
            "us": {name: round(us, 4) for name, us in found.items()},
            "sum_us": round(sum(found[k] for k in rigs[0].repeats if k not in NOT_IN_STEP), 4),
            "step_over_floor": round(found[ENGINE] / found[FLOOR], 3),
            "env_steps_per_s": round(1e6 / found[EPISODE]),
        }
        for (b, t), found in zip(chosen, least, strict=True)
    ]
    return {"machine": machine(), "rounds": rounds, "runs": runs, "bytes_per_receiver": memory}


def work_of(receivers: int) -> float:
    """Work of one measurement, roughly, for a progress bar."""
    return receivers + 32.0


def expected_work(receivers: Iterable[int], threads: Iterable[int], rounds: int) -> float:
    """Work of all measurements, roughly."""
    each = rounds * (len(KERNELS) + len({ATTACK, JUDGE, ENGINE, STEP, EPISODE}))
    return sum(each * work_of(b) for t in threads for b in receivers if _useful(b, t))


def _useful(receivers: int, threads: int) -> bool:
    """Whether every thread has a group."""
    return -(-receivers // LANES) >= threads


def bytes_by_owner(core: SpoofCore) -> dict[str, float]:
    """Bytes per receiver of the arrays that a step reads or writes, by what they belong to.

    All of an array counts; what all receivers share (the world, scratch memory) does not.
    """
    simulator: Any = core.engine.simulator
    buffers, sensors = simulator.buffers, simulator.sensors
    owners = {
        "filter": buffers.fields,
        "epoch": (buffers.seen_floats, buffers.visible, buffers.coasting),
        "sensors": sensors.fields,
        "keys of the noise": sensors.words,
        "offsets of the attack": (sensors.range_offset, sensors.rate_offset, sensors.authentic),
        "attack": simulator.attack.memory,
        "verdict, with weights": simulator.verdict,
        "detector": simulator.detector.memory,
        "episode": (simulator.memory, sensors.epoch),
    }
    found = {name: sum(_bytes(owner)) / core.receivers for name, owner in owners.items()}
    apart = {"score of the episode": sum(_bytes(core.score.raw)) / core.receivers}
    return {**found, TOTAL: sum(found.values()), **apart}


def _bytes(owner: object) -> Iterator[int]:
    """Sizes of all arrays of an owner."""
    if isinstance(owner, np.ndarray):
        yield owner.nbytes
    elif isinstance(owner, Mapping | tuple):
        for each in owner.values() if isinstance(owner, Mapping) else owner:
            yield from _bytes(each)
    elif isinstance(owner, LaneFields):
        yield owner.data.nbytes


def machine() -> dict[str, Any]:
    """What it is measured on."""
    try:
        usable = len(os.sched_getaffinity(0))
    except AttributeError:
        usable = os.cpu_count() or 1
    kind, features = numba.config.CPU_NAME, binding.get_host_cpu_features()
    return {
        "processors": usable,
        "processor": kind or binding.get_host_cpu_name(),
        "vectors": next((name for key, name in VECTORS.items() if features.get(key)), "none"),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "numba", "llvmlite")},
        "spoofgym": __version__,
    }


def tables(found: Mapping[str, Any]) -> list[Table]:
    """What was measured, as tables: title, head and rows."""
    made: list[Table] = []
    for threads in sorted({run["threads"] for run in found["runs"]}):
        runs = [run for run in found["runs"] if run["threads"] == threads]
        rows = [(name, *(f"{run['us'][name]:.2f}" for run in runs)) for name in runs[0]["us"]]
        rows += [(text, *(f"{run[key]:.4g}" for run in runs)) for key, text in ROWS.items()]
        what = "1 thread, processor time" if threads == 1 else f"{threads} threads, time passed"
        head = ("part", *(f"B = {run['receivers']}" for run in runs))
        made.append((f"microseconds per receiver-epoch, {what}", head, rows))
    memory = found["bytes_per_receiver"]
    names = next(iter(memory.values()))
    rows = [(name, *(f"{each[name]:.0f}" for each in memory.values())) for name in names]
    made.append(("bytes per receiver", ("arrays", *(f"B = {b}" for b in memory)), rows))
    return made
