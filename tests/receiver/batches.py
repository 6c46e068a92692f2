"""Batches of receivers that differ in all, in a world made by hand, as engine and replay call them.

Receiver i of any batch is the one of its number: it is at an epoch of its own, between which lie
different numbers of samples, sees satellites of its own, and has sensors of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spoofgym.core.simd import ArrayTable
from spoofgym.earth.wgs84 import geodetic_to_ecef
from spoofgym.envs.scoring import TightlyCoupledSimulator
from spoofgym.receiver import _kernels
from spoofgym.receiver._kernels import MEASURE, PREDICT, SHOW, UPDATE
from spoofgym.receiver.epoch import SEEN, ReceiverBuffers, kernel_table
from spoofgym.receiver.kalman import COVARIANCE_UPDATES
from spoofgym.simulation._kernels import NO_FORM, NOTHING_REMEMBERED
from spoofgym.truth.clock import TCXO, ReceiverClock
from spoofgym.truth.gnss_errors import GnssErrors
from spoofgym.truth.noise import pad_count
from spoofgym.truth.sensors import IMU_GRADES, ImuGrade, SensorBuffers

from .reference import covariance, measured, sky

N, EPOCHS, MOST = 6, 40, 37
"""Channels, epochs, most samples between two: more than two `CHUNK`, and no multiple of it."""
PLACE = geodetic_to_ecef(0.7, 0.3, 9000.0)


@dataclass(frozen=True)
class HandMade:
    run: np.ndarray
    epoch_time: np.ndarray
    epoch_end: np.ndarray
    satellites: np.ndarray


def hand_made():
    """A world whose epochs have 1 to `MOST` samples of 8 to 12 ms, and few satellites at times."""
    rng = np.random.default_rng(0)
    counts = rng.integers(1, MOST + 1, EPOCHS)
    counts[:2] = MOST, 1
    counts[8:16] = 20  # eight receivers in a row with as many samples
    lengths = rng.uniform(0.008, 0.012, counts.sum())
    samples = rng.normal(0.0, 1.0, (6, len(lengths))) * np.repeat([10.0, 0.3], 3)[:, None]
    ends = np.concatenate([[0], np.cumsum(counts)])
    satellites = np.zeros((EPOCHS + 1, N, 8))
    for k in range(EPOCHS + 1):
        satellites[k, :, :3] = PLACE + sky(rng, N) * rng.uniform(2e7, 2.5e7, (N, 1))
    satellites[:, :, 3:6] = rng.normal(0.0, 1e3, (EPOCHS + 1, N, 3))
    visible = rng.uniform(size=(EPOCHS + 1, N)) < rng.uniform(0.2, 1.2, (EPOCHS + 1, 1))
    satellites[:, :, 6] = visible * np.linalg.norm(satellites[:, :, :3] - PLACE, axis=-1)
    satellites[:, :, 7] = visible * rng.normal(0.0, 500.0, (EPOCHS + 1, N))
    time = np.concatenate([[0.0], np.cumsum(lengths)])[ends]
    return HandMade(np.vstack([samples, lengths, lengths**-0.5]), time, ends, satellites)


WORLD = hand_made()
CONSUMER = IMU_GRADES["consumer"]._asdict()
EXACT = ImuGrade(**{**CONSUMER, "accel_quantization": 0.0, "gyro_quantization": 0.0})
GRADES = (*IMU_GRADES.values(), EXACT)
SDS = ["code_sd_m", "range_rate_sd_mps", "signal_in_space_sd_m"]
SDS += ["zenith_iono_sd_m", "zenith_tropo_sd_m", "correlated_sd_m"]


def gnss_errors(*sds, **others):
    return GnssErrors(**dict(zip(SDS, sds, strict=True)), **others)


CONSTANT = ReceiverClock(offset_m=1e4, drift_mps=100.0)
QUIET = gnss_errors(1.0, 0.1, 0.0, 0.0, 0.0, 0.0, clock=CONSTANT)
REALISTIC = gnss_errors(0.5, 0.05, 1.0, 1.0, 0.1, 0.8, correlation_s=35.0, clock=TCXO)


class Batch:
    """Receivers of some numbers, predicted up to an epoch of their own."""

    def __init__(self, numbers, wanted=SEEN, world=WORLD, with_authentic=True, alike=False):
        self.numbers, self.world, count = list(numbers), world, len(numbers)
        self.buffers = ReceiverBuffers(count, N, wanted, alike=alike)
        self.sensors = SensorBuffers(count, N, with_authentic=with_authentic)
        self.weights, self.measured = np.ones((2, count, 2 * N))
        with np.errstate(over="ignore"):  # unsigned words wrap around
            for row, number in enumerate(self.numbers):
                self._fill(row, number)

    @property
    def fields(self):
        return self.buffers.fields

    def _fill(self, row, number):
        rng, rows = np.random.default_rng(number), np.array([row])
        z, R = measured(rng, N)
        u, visible = sky(rng, N), rng.uniform(size=N) < 0.9
        assumed = {"noise_psd": rng.uniform(0.0, 1e-3, 17) ** 2, "noise_variance": R}
        truth = self.world.satellites[number % EPOCHS + 1, :, 6:].T
        values = {
            "C_eb": np.linalg.qr(rng.standard_normal((3, 3)))[0],
            "velocity_e": rng.normal(0.0, 100.0, 3),
            "position_e": PLACE + rng.normal(0.0, 10.0, 3),
            "accel_bias_b": rng.normal(0.0, 1e-3, 3),
            "gyro_bias_b": rng.normal(0.0, 1e-6, 3),
            "clock": rng.normal([1e4, 100.0], [6.0, 0.3]),
            "innovation": z * np.tile(visible, 2),
            "line_of_sight": u * visible[:, None],
            "visible": visible,
        }
        for name, value in values.items():
            self.fields.put(name, rows, value)
        self.measured[row] = rng.normal(truth, 10.0).ravel() + 1e4
        for name, value in assumed.items():
            self.buffers.assumed.put(name, rows, value)
        self.buffers.put_covariance(rows, covariance(rng))
        sensors = self.sensors
        sensors.draw_keys(rows, [np.random.default_rng([number, 1])])
        errors = (QUIET, REALISTIC)[number // 3 % 2]
        sensors.start_episodes(rows, GRADES[number % len(GRADES)], errors, rng.uniform(0.0, 2.0, N))
        sensors.fields.put("residual", rows, rng.normal(0.0, 1e-5, 6))
        if errors.correlated_sd_m > 0.0:
            sensors.fields.put("correlated", rows, rng.normal(0.0, 0.5, N))
        sensors.epoch[row] = number % EPOCHS
        if number % 2:  # attacked
            sensors.range_offset[row] = rng.normal(0.0, 50.0, N)
            sensors.rate_offset[row] = rng.normal(0.0, 1.0, N)
            if len(sensors.authentic):
                sensors.authentic[row] = rng.choice([0.0, 1.0], 2 * N)
        self.weights[row] = rng.uniform(0.0, 1.0, 2 * N) if number % 4 > 1 else 1.0

    def run(self, what, lo=0, hi=None, weights=None, count=1, **settings):
        """Call the engine's kernel, without an attack and a detector of its own.

        What it predicts without measuring has been measured before.
        """
        if what & PREDICT and not what & MEASURE:
            self.fields.put("innovation", slice(lo, hi), self.measured[lo:hi])
        buffers, sensors, world = self.buffers, self.sensors, self.world
        sizes = pad_count(6 * MOST), pad_count(2 * N)
        work = buffers.fields.scratch(_kernels.work_rows(N, *sizes))
        work[:] = np.nan  # so that nothing is read of it that has not been written
        truth = world.run, world.epoch_time, world.epoch_end, world.satellites
        chosen = {"update": "unweighted", "least": 4, "orthonormal": False, **settings}
        rules = np.array([COVARIANCE_UPDATES[chosen.pop("update")], *chosen.values(), *sizes])
        attack = np.zeros(0), *np.zeros((2, EPOCHS + 1, 3)), np.zeros(1, dtype=np.bool_)
        rest = sensors.signals.data, *attack, np.zeros(1, dtype=np.int64), np.zeros(4)
        table = kernel_table(buffers, sensors, *truth, rules, *rest)
        memories = ArrayTable(NOTHING_REMEMBERED)
        weights = self.weights if weights is None else weights
        scratch = memories.entries, np.zeros((1, 1)), weights, work, NO_FORM, True, NO_FORM
        hi = buffers.receivers if hi is None else hi
        kernel = TightlyCoupledSimulator.kernel
        scratch = *kernel.nothing, table.entries, *scratch
        assert not kernel.function(*scratch, what, count, lo, hi)

    def predict(self):
        self.run(PREDICT + SHOW)

    def update(self, weights=None, **settings):
        weights = np.ones_like(self.weights) if weights is None else weights
        self.run(UPDATE, weights=weights, **settings)

    def everything(self, row):
        buffers, sensors, rows = self.buffers, self.sensors, np.array([row])
        plain = ("time", "interval", "position_e", "velocity_e", "visible", "coasting")
        parts = {"": buffers.fields, "assumed ": buffers.assumed}
        parts |= {"sensor ": sensors.fields, "constant ": sensors.constants}
        return {
            **{
                f"{k}{name}": part.get(name, rows)[0]
                for k, part in parts.items()
                for name in part.shapes
            },
            **{f"seen {name}": array[row].copy() for name, array in buffers.seen.items()},
            **{f"plain {name}": np.array(getattr(buffers, name)[row]) for name in plain},
            "epoch": np.array(sensors.epoch[row]),
        }


def check_same(mine, theirs):
    assert list(mine) == list(theirs)
    for name in mine:
        assert mine[name].tobytes() == theirs[name].tobytes(), name
