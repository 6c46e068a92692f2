"""Speed of two trees of spoofgym beside each other: in alternate rounds of one run.

The clock of a processor swings, and other work takes its share.  What is compared are the two
times of one round, taken right after one another; of their ratios the median counts.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.progress import Progress
from rich.table import Table

from .frozen_probe import SPEEDS

if TYPE_CHECKING:
    from .frozen import Child

ENGINE = "engine 256"
THREADS = f"{ENGINE}, 2 threads"
"""Whose ratio says what a second thread brings."""
TREES = ("old", "new")


def measure(
    old: Callable[[], Child],
    new: Callable[[], Child],
    speeds: Sequence[str],
    rounds: int,
    progress: Progress,
) -> dict[str, dict[str, float]]:
    """Times and ratios of `speeds` in both trees. Whole episodes are played in processes of their
    own, as what they warm up ahead would take time from what is measured after them."""
    probes = {whole: (old(), new()) for whole in {SPEEDS[what].whole for what in speeds}}
    running = [probe for pair in probes.values() for probe in pair]
    task = progress.add_task("speed", total=(rounds + 1) * len(speeds))
    taken: dict[str, list[list[dict[str, float]]]] = {what: [] for what in speeds}
    try:
        for probe in running:  # while they wait, threads of theirs would compute
            probe.signal(signal.SIGSTOP)
        for k in range(-1, rounds):  # the first round warms up
            for what in speeds:
                progress.update(task, description=what)
                pair = probes[SPEEDS[what].whole]
                times: list[dict[str, Any]] = [{}, {}]
                for tree in (0, 1) if k % 2 else (1, 0):
                    pair[tree].signal(signal.SIGCONT)
                    times[tree] = pair[tree].ask(do="speed", what=what)
                    pair[tree].signal(signal.SIGSTOP)
                    if "error" in times[tree]:
                        raise RuntimeError(f"{pair[tree].tree}: {times[tree]['traceback']}")
                if k >= 0:
                    taken[what].append(times)
                progress.advance(task)
    finally:
        for probe in running:  # so that they can end
            probe.signal(signal.SIGCONT)
    return summary(taken)


def summary(taken: dict[str, list[list[dict[str, float]]]]) -> dict[str, dict[str, float]]:
    """By measurement: microseconds a receiver-step of both trees, and how many times as fast.
    `taken`: by measurement, of every round the seconds a step of the old and of the new tree, by
    clock.  The ratios are medians over the rounds with their quartiles.  What a second thread
    brings is the ratio of the least times by the clock with one thread and with two."""
    result: dict[str, dict[str, float]] = {}
    for what, rounds in taken.items():
        receivers = SPEEDS[what].batch or 1
        result[what] = {"receivers": receivers, "rounds": len(rounds)}
        for clock in ("cpu", "wall"):
            times = np.array([[tree[clock] for tree in pair] for pair in rounds])
            quartiles = np.percentile(times[:, 0] / times[:, 1], [25, 50, 75])
            for name, value in zip(("low", "ratio", "high"), quartiles, strict=True):
                result[what][f"{clock}_{name}"] = float(value)
            for k, tree in enumerate(TREES):
                for name, time in (("us", np.median(times[:, k])), ("least_us", times[:, k].min())):
                    result[what][f"{tree}_{clock}_{name}"] = 1e6 * float(time) / receivers
    if ENGINE in result and THREADS in result:
        for tree in TREES:
            one, two = (result[what][f"{tree}_wall_least_us"] for what in (ENGINE, THREADS))
            result[THREADS][f"{tree}_over_one_thread"] = one / two
    return result


def speed_table(speed: dict[str, dict[str, float]]) -> Table:
    """Both trees and their ratio; of several threads by both clocks. How many processors were used
    shows whether other work had left one to the second thread."""
    table = Table(
        *("", "time", "old µs", "new µs", "times as fast", "quartiles", "of the least", "steps/s"),
        *("over one thread", "processors used"),
        title=f"a step of a receiver; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors",
    )
    for what, row in speed.items():
        for clock in ("cpu", "wall") if SPEEDS[what].clock == "wall" else ("cpu",):
            least = [row[f"{tree}_{clock}_least_us"] for tree in TREES]
            cells = [
                *(f"{row[f'{tree}_{clock}_us']:.3f}" for tree in TREES),
                f"{row[f'{clock}_ratio']:.2f}",
                f"{row[f'{clock}_low']:.2f} to {row[f'{clock}_high']:.2f}",
                f"{least[0] / least[1]:.2f}",
            ]
            if clock == "wall":
                used = (row[f"{tree}_cpu_us"] / row[f"{tree}_wall_us"] for tree in TREES)
                scaled = [row.get(f"{tree}_over_one_thread") for tree in TREES]
                cells += [
                    " -> ".join(f"{1e6 / row[f'{tree}_wall_us']:,.0f}" for tree in TREES),
                    " -> ".join(f"{each:.2f}" for each in scaled if each),
                    " -> ".join(f"{each:.2f}" for each in used),
                ]
            table.add_row(what, clock, *cells)
    return table
