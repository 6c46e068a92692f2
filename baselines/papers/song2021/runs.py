"""Runs of the robot: recorded once, then judged by any filter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.robot_data_sets import DATA_SETS, RobotDataSet
from spoofgym.core.memory import Memory
from spoofgym.detectors import DetectorContext, make_detector
from spoofgym.receiver.credible import CredibleBatch, CredibleFilter
from spoofgym.simulation import Engine, WheeledRobotSetup

FloatArray = NDArray[np.float64]

INTERVAL_S = 1.0
JUMP_LIMIT_MPS = 1000.0
FILTERS: dict[str, dict[str, Any]] = {
    "EKF": {"name": "never"},
    "RIO": {"name": "rio"},
    "ACNA": {"name": "acna", "variant": "literal"},
    "ACNA, production": {"name": "acna", "variant": "production"},
}
"""Detector of every algorithm of the tables."""


class Recording(NamedTuple):
    """What B robots measured.

    - `first_fix`: (B, 2) north, east [m];
    - `increment`, `fix`: (K, B, 2) dead reckoning and GNSS positions [m];
    - `truth`: (K, 2) [m].
    """

    first_fix: FloatArray
    increment: FloatArray
    fix: FloatArray
    truth: FloatArray

    @property
    def fix_error(self) -> FloatArray:
        """(K, B, 2) error of the GNSS positions, attacks included [m]."""
        return self.fix - self.truth[:, None, :]


class Judged(NamedTuple):
    """What a filter made of it.

    - `error`: (K, B, 2) estimate minus truth [m];
    - `alarm`: (K, B) bool.
    """

    error: FloatArray
    alarm: NDArray[np.bool_]


def generators(seed: int, runs: int, stream: int) -> list[np.random.Generator]:
    """Generators of some runs. `seed`, `runs`, `stream`: of the reproduction; how many; 0 for the
    robots, 1 for the attacks on them."""
    return [
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream, i)))
        for i in range(runs)
    ]


def make_setup(data_set: RobotDataSet, detector: Any, **settings: Any) -> WheeledRobotSetup:
    """Robots that drive a data set from its first second on."""
    return WheeledRobotSetup(
        detector=detector,
        timeline={
            "warmup_s": 0.0,
            "live_s": 0.0,
            "attack_s": data_set.duration_s,
            "time_to_alert_s": 0.0,
        },
        interval_s=INTERVAL_S,
        rate_limit_mps=JUMP_LIMIT_MPS,
        loop={"speed_mps": data_set.speed_mps},
        **settings,
    )


def commands(offsets: FloatArray) -> FloatArray:
    """Actions that move the offset as a data set does.  `offsets`: (K, B, 2) [m].  Returns (K, B,
    2) in [-1, 1]."""
    steps = np.diff(offsets, axis=0, prepend=np.zeros((1, *offsets.shape[1:])))
    return steps / (JUMP_LIMIT_MPS * INTERVAL_S)


def record(
    name: str | RobotDataSet,
    seed: int,
    runs: int,
    offsets: FloatArray | None = None,
    **settings: Any,
) -> Recording:
    """Let robots drive, and keep what they measure. `offsets`: (K, B, 2) another attack than the
    data set's [m]."""
    data_set = DATA_SETS[name] if isinstance(name, str) else name
    setup = make_setup(data_set, "never", **settings)
    engine = Engine(runs, setup)
    engine.reset(generators(seed, runs, 0))
    simulator: Any = engine.simulator
    first = simulator.memory["fix"].copy()
    if offsets is None:
        offsets = data_set.offsets(generators(seed, runs, 1), INTERVAL_S)
    increment, fix = np.empty(offsets.shape), np.empty(offsets.shape)
    for k, action in enumerate(commands(offsets)):
        engine.step(action)
        increment[k], fix[k] = simulator.increment, simulator.memory["fix"]
    return Recording(first, increment, fix, setup.true_position[1 : len(fix) + 1])


def judge(recording: Recording, detector: Any, settings: CredibleFilter | None = None) -> Judged:
    """Filter recorded measurements with a detector in the loop."""
    count, runs, _ = recording.fix.shape
    batch = CredibleBatch(settings or CredibleFilter(), Memory(runs), INTERVAL_S)
    bound = make_detector(detector)
    variance = np.full(2, batch.settings.noise_variance)
    bound.bind(DetectorContext(runs, 0, INTERVAL_S, variance, ()))
    batch.start_episodes(recording.first_fix)
    error, alarm = np.empty(recording.fix.shape), np.empty((count, runs), dtype=np.bool_)
    for k in range(count):
        time = np.full(runs, (k + 1) * INTERVAL_S)
        epoch = batch.predict(time, recording.increment[k], recording.fix[k])
        verdict = bound.judge(epoch)
        batch.update(verdict.weights)
        error[k] = batch.memory["position"][:, :2] - recording.truth[k]
        alarm[k] = verdict.alarm[:, 0]
    return Judged(error, alarm)


def ramp_offsets(rate_mps: float, begin_s: float, seconds: Sequence[int], runs: int) -> FloatArray:
    """Steady ramps in north and east, without chance. Returns (K, B, 2) [m]."""
    size = rate_mps * np.maximum(np.asarray(seconds, dtype=np.float64) - begin_s, 0.0)
    return np.tile(size[:, None, None], (1, runs, 2))
