"""The kernel of the inertial sensors, called by itself: one receiver, or eight side by side."""

import numpy as np

from spoofgym.core.compile import njit
from spoofgym.core.lanes import LaneFields, first_rows
from spoofgym.core.simd import LANES, load
from spoofgym.truth._kernels import CHUNK, IMU_KEY, sense
from spoofgym.truth.noise import deviates
from spoofgym.truth.sensors import CONSTANTS, sensor_shapes

from ..lanes import in_all_lanes

SHAPES = {**sensor_shapes(4), **CONSTANTS}
FIXED = first_rows(SHAPES)["accel_bias"]
"""First row of the constants, here behind the other quantities."""
PERFECT = {"accel_matrix": np.eye(3), "gyro_matrix": np.eye(3)}


@njit
def sense_group(run, first, count, sensors, samples, dt, active, truth):
    sense(run, first, count, sensors, 0, sensors, FIXED, samples, dt, truth, active)


@njit
def draw_group(run, first, count, keys, epoch, sensors, constants, samples, dt, active, truth):
    k0, k1 = load(keys, IMU_KEY), load(keys, IMU_KEY + 1)
    deviates(k0, k1, load(epoch, 0), samples.shape[0], 6 * count, samples)
    sense(run, first, count, sensors, 0, constants, 0, samples, dt, truth, active)


def run_of(truth, lengths):
    """(8, N) what a world has of its samples."""
    return np.vstack([truth, lengths, np.asarray(lengths) ** -0.5])


def sensors_of(receivers=1, **values):
    fields = LaneFields(receivers, SHAPES)
    for name, value in {**PERFECT, **values}.items():
        fields[name] = value
    return fields


def modelled(errors, truth):
    """(6, N) samples of true ones without noise and quantization, by the errors of sensors."""
    force = errors["accel_bias"][:, None] + errors["accel_matrix"] @ truth[:3]
    rate = errors["gyro_bias"][:, None] + errors["gyro_matrix"] @ truth[3:]
    return np.vstack([force, rate + errors["g_dependence"] @ truth[:3]])


def sensed(fields, run, deviates, first=0):
    """(6, N) measured by a single receiver; what is carried on stays in its fields.

    `deviates` (6, N) of its noise.
    """
    count = deviates.shape[1]
    samples, dt = deviates.ravel().copy(), np.full(count, np.nan)
    starts, truth = np.array([first]), np.empty(8 * CHUNK)
    with np.errstate(divide="ignore"):  # of which compiled code says nothing
        sense_group(run, starts, count, fields.data, samples, dt, np.ones(1), truth)
    np.testing.assert_array_equal(dt, run[6, first : first + count])
    return samples.reshape(6, count)


def sensed_by_eight(fields, run, deviates, first, active):
    """(8, 6, N) measured by eight receivers, each as it measures alone.

    `deviates` (8, 6, N); `first`, `active` (8,).
    """
    count = deviates.shape[2]
    samples = deviates.reshape(LANES, -1).T.copy()
    dt, kept = np.full((count, LANES), np.nan), np.array([active], dtype=float)
    truth = np.empty((8 * CHUNK, LANES))

    def kernel(starts, sensors, samples, dt, kept, truth):
        starts = starts[0] if starts.ndim == 2 else starts
        sense_group(run, starts, count, sensors, samples, dt, kept, truth)

    in_all_lanes(kernel, first[None], fields.data, samples, dt, kept, truth, scratch=1)
    return samples.T.reshape(LANES, 6, count)
