"""What a step costs on this machine, part by part: ``python -m benchmarks.perf``, ``make perf``.

Beside it stands the floor of its arithmetic.
B receivers of `ENV` have epochs of 1 s (100 inertial samples), the ``ewma`` detector in the loop
and the default observations; episodes do not end at an alarm.  All is measured in alternate rounds
and the least counts: processor time on one thread, time that has passed on several.
"""

from __future__ import annotations

import copy
import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
import typer
from llvmlite import binding

from spoofgym import __version__
from spoofgym.attacks._kernels import Commanded
from spoofgym.bench.report.table import Table
from spoofgym.cli import clear_errors
from spoofgym.cli.app import print_json, print_lines, progress
from spoofgym.cli.options import Json
from spoofgym.core.lanes import LaneFields
from spoofgym.core.progress import NullProgress, ProgressCallback
from spoofgym.core.simd import LANES
from spoofgym.envs.core import SpoofCore
from spoofgym.truth.noise import pad_count

from . import _perf_kernels as kernels

Titled = tuple[str, Sequence[str], Sequence[Sequence[str]]]
ENV = "spoofgym/Zhong2025-v0"
SETTINGS: dict[str, Any] = {
    "scenario": {"name": "zhong2025", "epoch_interval_s": 1.0},
    "detector": {"name": "ewma", "thresholds": "nominal"},
    "end_at_alarm": False,
}
COMMAND = 0.5
"""Along every axis, throughout: an attack without a command has nothing to compute."""
RECEIVERS, THREADS = (1, 16, 64, 256, 1024), (1, 2)
ROUNDS, QUICK_ROUNDS = 7, 2
PIECE_S = 0.005
"""Shortest time of one measurement of a part."""
EPISODES = 2
"""Episodes of one measurement with warm-ups; one more comes before."""
FLOOR, ATTACK, JUDGE, COVARIANCE_S = "floor", "attack", "detector", "all of S, where it is wanted"
KERNELS = {
    "noise of the inertial sensors": kernels.NOISE,
    "sensing and quantization": kernels.SENSE,
    "mechanization": kernels.MECHANIZE,
    "transition and covariance": kernels.PROPAGATE,
    "GNSS noise and measurement": kernels.MEASURE,
    "innovation and its variance": kernels.INNOVATE,
    "update": kernels.UPDATE,
    COVARIANCE_S: kernels.COVARIANCE_S,
    FLOOR: kernels.FLOOR,
}
PARTS = (*KERNELS, ATTACK, JUDGE)
ENGINE, STEP, EPISODE = "engine step", "env step", "env step with warm-ups"
DERIVED = (
    ("parts_us", "parts of an engine step, together", ".2f"),
    ("step_over_floor", "engine step / floor", ".2f"),
    ("env_steps_per_s", "env steps per second, with warm-ups", ",.0f"),
)
TOTAL = "all of these"
app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
VECTORS = {"avx512f": "AVX-512", "avx2": "AVX2", "sse4.2": "SSE4.2", "neon": "NEON"}


class Rig:
    """B receivers on some threads, and what of theirs is measured."""

    def __init__(self, receivers: int, threads: int) -> None:
        self.receivers, self.threads = receivers, threads
        self.clock = time.thread_time if threads == 1 else time.perf_counter
        self.env = _make(receivers, threads, False)
        # what warms up behind, where it may, would disturb the other measurements
        self.whole = self.env if threads == 1 else _make(receivers, threads, True)
        self.core, self.engine = self.env.core, self.env.core.engine
        self.steps: int = self.core.setup.steps
        self.action = np.full(self.env.action_space.shape, COMMAND, dtype=np.float32)
        self.command = np.full((receivers, len(self.core.setup.action_names)), COMMAND)
        groups = -(-receivers // LANES)
        bounds = [LANES * (groups * k // threads) for k in range(threads)] + [receivers]
        self._ends = list(pairwise(bounds))
        self._pool = ThreadPoolExecutor(threads)
        self._counts = dict.fromkeys(PARTS, 1)
        self.env.reset(seed=0)
        _repeat(self.steps // 2, self.env.step, self.action)
        simulator, setup = self.engine.simulator, self.core.setup
        world, victim = setup.world, setup.receiver
        sizes = pad_count(6 * world.most_samples), pad_count(2 * world.channels)
        rules = victim.covariance_code, victim.min_satellites, victim.orthonormalize, *sizes
        # parts leave the receivers as they like, and so have copies
        buffers, sensors = simulator.buffers, simulator.sensors
        filters = buffers.fields, buffers.assumed
        self._kept = *filters, sensors.fields, sensors.constants, sensors.words
        self.fields, self._kept = copy.deepcopy(self._kept), copy.deepcopy(self._kept)
        rows = kernels.work_rows(world.channels, *sizes)
        self._works = [self.fields[0].scratch(rows) for _ in range(threads)]
        truth = world.run, world.epoch_time, world.epoch_end, world.satellites
        lanes = tuple(each.data for each in self.fields)
        self._given = int(simulator.epochs[0]) + 1, lanes, truth, np.array(rules, dtype=np.int64)
        self._apart: dict[str, tuple[Callable[..., object], tuple[Any, ...]]] = {
            ATTACK: (kernels.repeat_attack, (self._attack_arguments(),)),
            JUDGE: (kernels.repeat_judge, self._judge_arguments()),
        }

    def _attack_arguments(self) -> tuple[Any, ...]:
        """What `false_position` takes, as in the attack of that name."""
        simulator, world = self.engine.simulator, self.core.setup.world
        attack, sensors = simulator.attack, simulator.sensors
        moved = attack.memory["displacement"], attack.memory["rate"]
        commanded = Commanded(self.command, False, attack.kernel_settings, *moved)
        truth = sensors.epoch, world.epoch_truth, attack.mask
        offsets = sensors.range_offset, sensors.rate_offset
        return commanded, attack.axes_e, attack.memory["target_error"], *truth, *offsets

    def _judge_arguments(self) -> tuple[tuple[Any, ...], ...]:
        """What `judge_channels` takes, as in the detector ``ewma``."""
        simulator = self.engine.simulator
        epoch, memory = simulator.epoch, simulator.detector.memory
        given = epoch.innovation, epoch.innovation_variance, epoch.visible
        settings = map(float, simulator.detector.kernel_settings)
        shapes = epoch.visible.shape, epoch.visible.shape, epoch.innovation.shape
        charts = memory["average"], memory["decay"]
        return (*given, *settings), charts, tuple(map(np.empty, shapes))

    def close(self) -> None:
        """End all threads."""
        self.core.close()
        self.whole.core.close()
        self._pool.shutdown()

    def run_part(self, name: str, rounds: int) -> None:
        """Do a part of an epoch so often, in all receivers."""
        calls: list[Any] = [(KERNELS.get(name), rounds, *self._given, work) for work in self._works]
        kernel: Callable[..., object] = kernels.repeat
        if name in self._apart:
            kernel, given = self._apart[name]
            calls = [(rounds, *given)] * self.threads
        jobs = [(*call, *ends) for call, ends in zip(calls, self._ends, strict=True)]
        if self.threads == 1:
            kernel(*jobs[0])
        else:
            list(self._pool.map(kernel, *zip(*jobs, strict=True)))

    def _seconds(self, work: Callable[..., object], *given: object) -> float:
        began = self.clock()
        work(*given)
        return self.clock() - began

    def part_seconds(self, name: str) -> float:
        """Of a part of an epoch, repeated until it can be measured."""
        while True:
            for mine, kept in zip(self.fields, self._kept, strict=True):
                mine.data[...] = kept.data
            passed = self._seconds(self.run_part, name, self._counts[name])
            if passed >= PIECE_S:
                return passed / self._counts[name]
            self._counts[name] *= 2

    def step_seconds(self, step: Callable[[Any], object], command: Any) -> float:
        """Of a step; the last one of an episode, with its time to alert, does not count."""
        self.env.reset(seed=0)
        return self._seconds(_repeat, self.steps - 1, step, command) / (self.steps - 1)

    def _episodes(self, count: int) -> None:
        for _ in range(count):
            _repeat(self.steps, self.whole.step, self.action)
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
        return {
            **{name: partial(self.part_seconds, name) for name in PARTS},
            ENGINE: partial(self.step_seconds, self.engine.step, self.command),
            STEP: partial(self.step_seconds, self.env.step, self.action),
            EPISODE: self.episode_seconds,
        }


def _repeat(count: int, work: Callable[..., object], *given: object) -> None:
    for _ in range(count):
        work(*given)


def _make(receivers: int, threads: int, prefetch: bool) -> Any:
    import gymnasium as gym

    if receivers == 1:
        return gym.make(ENV, **SETTINGS).unwrapped
    settings = {**SETTINGS, "threads": threads, "prefetch": prefetch}
    return gym.make_vec(ENV, num_envs=receivers, **settings).unwrapped


def measure(
    receivers: Sequence[int] = RECEIVERS,
    threads: Sequence[int] = THREADS,
    *,
    rounds: int = ROUNDS,
    progress: ProgressCallback | None = None,
) -> dict[str, Any]:
    """Microseconds per receiver-epoch by part, and bytes per receiver; `progress` runs to 1.

    So many receivers are measured on so many threads where each of these has a group of them.
    """
    shown = progress or NullProgress()
    chosen = [(b, t) for t in threads for b in receivers if -(-b // LANES) >= t]
    if not chosen:
        raise ValueError(
            f"no batch of {list(receivers)} receivers has a group of {LANES} for each of "
            f"{min(threads)} threads"
        )
    rigs: list[Rig] = []
    try:
        rigs.extend(Rig(b, t) for b, t in chosen)
        found: list[dict[str, float]] = [{} for _ in rigs]
        work = rounds * sum(b for b, _ in chosen)
        for _ in range(rounds):
            for rig, least in zip(rigs, found, strict=True):
                measurements = rig.measurements()
                for name, seconds in measurements.items():
                    us = 1e6 * seconds() / rig.receivers
                    least[name] = min(us, least.get(name, us))
                    shown.advance(rig.receivers / work / len(measurements), name)
        memory = {str(rig.receivers): bytes_by_owner(rig.core) for rig in rigs}
    finally:
        for rig in rigs:
            rig.close()
    runs = [_run(b, t, us) for (b, t), us in zip(chosen, found, strict=True)]
    return {"machine": machine(), "rounds": rounds, "runs": runs, "bytes_per_receiver": memory}


def _run(receivers: int, threads: int, us: Mapping[str, float]) -> dict[str, Any]:
    """Result of one batch, with what follows from its times."""
    return {
        "receivers": receivers,
        "threads": threads,
        "us": {name: round(each, 4) for name, each in us.items()},
        "parts_us": round(sum(us[name] for name in set(PARTS) - {COVARIANCE_S, FLOOR}), 4),
        "step_over_floor": round(us[ENGINE] / us[FLOOR], 3),
        "env_steps_per_s": round(1e6 / us[EPISODE]),
    }


def bytes_by_owner(core: SpoofCore) -> dict[str, float]:
    """Bytes per receiver of the arrays that a step reads or writes, by what they belong to.

    All of an array counts, also what a batch keeps once for all its receivers; what batches share
    (the world, scratch memory) does not.
    """
    simulator: Any = core.engine.simulator
    buffers, sensors = simulator.buffers, simulator.sensors
    owners = {
        "filter": (buffers.fields, buffers.assumed),
        "epoch": (buffers.seen_floats, buffers.visible, buffers.coasting),
        "sensors": (sensors.fields, sensors.constants),
        "keys of the noise": sensors.words,
        "offsets of the attack": (sensors.range_offset, sensors.rate_offset, sensors.authentic),
        "attack": simulator.attack.memory,
        "verdict, with weights": simulator.verdict,
        "detector": simulator.detector.memory,
        "episode": (simulator.memory, sensors.epoch),
    }
    found = {name: sum(_bytes(owner)) / core.receivers for name, owner in owners.items()}
    score = core.score.raw.nbytes / core.receivers
    return {**found, TOTAL: sum(found.values()), "score of the episode": score}


def _bytes(owner: Any) -> Iterator[int]:
    """Sizes of all arrays of an owner."""
    if isinstance(owner, np.ndarray | LaneFields):
        yield (owner.data if isinstance(owner, LaneFields) else owner).nbytes
        return
    for each in owner.values() if isinstance(owner, Mapping) else owner:
        yield from _bytes(each)


def machine() -> dict[str, Any]:
    """What it is measured on."""
    features = binding.get_host_cpu_features()
    return {
        "processors": len(
            getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))(0)
        ),
        "processor": os.environ.get("NUMBA_CPU_NAME") or binding.get_host_cpu_name(),
        "vectors": next((name for key, name in VECTORS.items() if features.get(key)), "none"),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "numba", "llvmlite")},
        "spoofgym": __version__,
    }


def tables(found: Mapping[str, Any]) -> Iterator[Titled]:
    """What was measured, as tables: title, head and rows."""
    for threads in sorted({run["threads"] for run in found["runs"]}):
        runs = [run for run in found["runs"] if run["threads"] == threads]
        rows = [(name, *(f"{run['us'][name]:.2f}" for run in runs)) for name in runs[0]["us"]]
        for key, text, form in DERIVED:
            rows.append((text, *(f"{run[key]:{form}}" for run in runs)))
        what = "1 thread, processor time" if threads == 1 else f"{threads} threads, time passed"
        head = ("part", *(f"B = {run['receivers']}" for run in runs))
        yield f"microseconds per receiver-epoch, {what}", head, rows
    memory = found["bytes_per_receiver"]
    rows = [
        (name, *(f"{each[name]:.0f}" for each in memory.values()))
        for name in next(iter(memory.values()))
    ]
    yield "bytes per receiver", ("arrays", *(f"B = {b}" for b in memory)), rows


@app.command()
@clear_errors
def main(
    receivers: Annotated[
        list[int] | None,
        typer.Option(
            min=1, max=65536, help="Receivers of a batch; repeatable. Default: 1 16 64 256 1024."
        ),
    ] = None,
    threads: Annotated[
        list[int] | None,
        typer.Option(min=1, max=1024, help="Threads of the engine; repeatable. Default: 1 2."),
    ] = None,
    quick: Annotated[bool, typer.Option(help="Measure in two rounds instead of seven.")] = False,
    markdown: Annotated[bool, typer.Option(help="Print the tables as Markdown.")] = False,
    as_json: Json = False,
) -> None:
    """Measure what a step costs on this machine, part by part, beside the floor of its arithmetic.

    Microseconds per receiver-epoch with 100 inertial samples, 12 satellites and the detector ewma.
    The floor is the same arithmetic for one group of receivers that stays in the nearest cache.
    """
    rounds = QUICK_ROUNDS if quick else ROUNDS
    with progress(1.0) as bar:
        found = measure(receivers or RECEIVERS, threads or THREADS, rounds=rounds, progress=bar)
    if as_json:
        print_json(found)
        return
    print_lines([", ".join(f"{name} {value}" for name, value in found["machine"].items())])
    for title, head, rows in tables(found):
        table = Table.of_texts(*head)
        if markdown:
            print_lines(["", f"{title}:", "", table.markdown(rows)])
        else:
            table.print(title, rows)


if __name__ == "__main__":
    app()
