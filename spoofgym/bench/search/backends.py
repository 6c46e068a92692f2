"""What plays the candidates of an open-loop attack: response replay, or the engine itself.

A backend plays sampled curves of `steps` values on `runs` that count, which are silent without an
attack, within `limits`: the largest rate, and its largest change between two values, which may be
infinite [m/s].  `sums` says that a play is cheap: no detector judges it.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...detectors import Detector
from ...limits.linear import get_rate_limits
from ...limits.response import LinearReplay, NotReplayable, check_replayable
from ...simulation.setup import Setup
from ...simulation.simulator import weighs
from ...spoofers.base import direction, has_heading, list_axes
from ..runs.play import FloatArray, Runs, WarmStart, induced_error
from ..runs.record import mask_valid_runs

Rows = NDArray[np.intp]
EAST_DEG = 90.0  # heading of scripted spoofers by default


def compute_unit_commands(setup: Setup, heading_deg: float | str, target: FloatArray) -> FloatArray:
    """(R, a) or (1, a) unit commands of spoofers with a heading, as `ScriptedSpoofer` has it.
    `target` (R,) target directions of the runs [rad]."""
    names = setup.action_names
    if not (isinstance(heading_deg, str) and has_heading(names)):
        return direction(names, 0.0 if isinstance(heading_deg, str) else heading_deg)[None]
    parts = {"north": np.cos(target), "east": np.sin(target)}
    return np.stack([parts.get(axis, np.zeros(len(target))) for axis in list_axes(names)], axis=1)


def find_obstacle(setup: Setup, judge: Detector, whose: str) -> str:
    """Why response replay does not hold for a detector in a world; "" where it does. `whose`: what
    the detector is called."""
    try:
        check_replayable(judge)
    except NotReplayable as error:
        return str(error)
    return f"{whose} takes weight off measurements" if weighs(setup, judge) else ""


class ReplayBackend:
    """One of the detectors of a replay, against attacks along a heading."""

    def __init__(
        self, replay: LinearReplay, number: int, heading_deg: float | str = EAST_DEG
    ) -> None:
        self.replay, self.number, self.sums = replay, number, replay.sums(number)
        if not isinstance(heading_deg, str):
            self.replay = replay = copy.copy(replay)
            replay.heading = np.full(replay.runs, math.radians(heading_deg))
        self.steps, self.limits = replay.steps, replay.limits
        clean = replay.play(number, np.zeros((1, self.steps)))
        counts = mask_valid_runs(replay.warmup_alarm[number], clean.first_alarm[0])
        self.rows = np.flatnonzero(counts)
        self.runs = len(self.rows)

    def play(self, curves: FloatArray, rows: Rows) -> tuple[FloatArray, FloatArray]:
        found = self.replay.play(self.number, curves, rows=self.rows[rows])
        return found.peak, found.error[: self.replay.attack_epochs].max(axis=0).mean(axis=1)


class MixedBackend:
    """Several backends, each of which plays its share of the runs: a pool of their detectors."""

    sums = False

    def __init__(self, backends: Sequence[ReplayBackend], weights: Sequence[float]) -> None:
        self.backends, self.steps, self.limits = backends, backends[0].steps, backends[0].limits
        self.runs = min(each.runs for each in backends)
        ends = np.round(np.cumsum(weights) / np.sum(weights) * self.runs).astype(int)
        self._owner = np.searchsorted(ends, np.arange(self.runs), side="right")

    def play(self, curves: FloatArray, rows: Rows) -> tuple[FloatArray, FloatArray]:
        peak, reach = np.zeros((len(curves), len(rows))), np.zeros(len(curves))
        for k, backend in enumerate(self.backends):
            mine = self._owner[rows] == k
            if mine.any():
                peak[:, mine], farthest = backend.play(curves, rows[mine])
                reach += farthest * mine.mean()
        return peak, reach


class EngineBackend:
    """A detector on the engine, which also plays those that take weight off measurements."""

    sums = False

    def __init__(self, start: WarmStart, clean: Runs, heading_deg: float | str = EAST_DEG) -> None:
        self.heading_deg = heading_deg
        rows = np.flatnonzero(mask_valid_runs(start.warmup_alarm, clean.first_alarm))
        self.start, self.clean = start.take(rows), clean.take(rows)
        setup, self.runs = start.setup, len(rows)
        self.steps, self.limits = setup.steps // setup.repeat, get_rate_limits(setup)

    def play(self, curves: FloatArray, rows: Rows) -> tuple[FloatArray, FloatArray]:
        setup, runs = self.start.setup, len(rows)
        everyone = np.tile(rows, len(curves))
        engine, (limit, most) = self.start.take(everyone).engine(), self.limits
        aim = compute_unit_commands(setup, self.heading_deg, engine.simulator.heading)
        change = np.diff(curves, axis=1, prepend=0.0) / most
        actions = np.pad(curves / limit if math.isinf(most) else change, ((0, 0), (1, 0)))
        peak = np.zeros(len(everyone))
        position = np.empty((setup.steps + setup.hold, *engine.simulator.position.shape))
        for k in range(len(position)):
            command = None
            if k < setup.steps:
                decision, epoch = divmod(k, setup.repeat)
                size = setup.command(actions[:, decision], actions[:, decision + 1], epoch)
                command = np.ascontiguousarray(np.repeat(size, runs)[:, None] * aim)
            engine.step(command)
            position[k] = engine.simulator.position
            np.maximum(peak, engine.simulator.ratio(), out=peak)
        twin = self.clean.take(everyone)
        error = induced_error(setup, twin._replace(position=position), twin)[: setup.steps]
        shape = len(curves), runs
        return peak.reshape(shape), error.max(axis=0).reshape(shape).mean(axis=1)


Backend = ReplayBackend | MixedBackend | EngineBackend
