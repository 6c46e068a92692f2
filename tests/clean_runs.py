"""Clean runs of many receivers, and their errors as the filter defines them."""

from __future__ import annotations

import numpy as np

from spoofgym.attacks import FalsePosition
from spoofgym.detectors import Never
from spoofgym.envs import Engine, Setup, Timeline
from spoofgym.envs.engine import Batch
from spoofgym.receiver import TightlyCoupled
from spoofgym.sim.scenario import Scenario

OBSERVED = np.array([3, 4, 5, 6, 7, 8, 15, 16])
"""Velocity, position and clock: the states that GNSS sees."""


def begin(
    scenario: Scenario, receiver: TightlyCoupled, receivers: int, seconds: float, seed: int = 7
) -> Batch:
    """Receivers at time zero, in a world whose episode lasts for so long."""
    timeline = Timeline(warmup_s=0.0, live_s=0.0, attack_s=seconds, time_to_alert_s=0.0)
    setup = Setup(scenario, receiver, FalsePosition(), Never(), timeline)
    engine = Engine(receivers, setup, threads=1)
    engine.reset([np.random.default_rng([seed, run]) for run in range(receivers)])
    return engine.batch


def epoch_of(batch: Batch) -> int:
    return int(batch.epochs[0])


def advance_to(batch: Batch, time_s: float) -> None:
    """Run up to a time, its update included."""
    epoch = round(time_s / batch.setup.scenario.epoch_interval_s)
    batch.quiet_epochs(epoch - epoch_of(batch))


def position_error(batch: Batch) -> np.ndarray:
    """(B, 3) estimate minus truth, ECEF [m]."""
    return batch.buffers.state.position_e - batch.setup.world.position_e[epoch_of(batch)]


def velocity_error(batch: Batch) -> np.ndarray:
    """(B, 3) estimate minus truth, ECEF [m/s]."""
    return batch.buffers.state.velocity_e - batch.setup.world.velocity_e[epoch_of(batch)]


def attitude_error(batch: Batch) -> np.ndarray:
    """(B, 3) rotation vector of the estimate against the truth, ECEF axes [rad]."""
    true_C_eb = batch.setup.world.C_eb[epoch_of(batch)]
    turn = np.einsum("bij,kj->bik", batch.buffers.state.C_eb, true_C_eb)
    skew = 0.5 * (turn - turn.transpose(0, 2, 1))
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


def state_error(batch: Batch) -> np.ndarray:
    """(B, 17) errors with the signs of `error_model`.

    A bias is what an accelerometer or a gyro adds in straight flight at the present specific force:
    errors of scale act on it as on a bias.  What they make of a rotation is no bias.
    """
    state, sensors, world = batch.buffers.state, batch.sensors.state, batch.setup.world
    first, last = world.epoch_end[epoch_of(batch) - 1 : epoch_of(batch) + 1]
    force = world.run[:3, first:last].mean(axis=1)
    accel_bias = sensors.accel_bias + (sensors.accel_matrix - np.eye(3)) @ force
    gyro_bias = sensors.gyro_bias + sensors.g_dependence @ force
    return np.hstack(
        [
            attitude_error(batch),
            velocity_error(batch),
            position_error(batch),
            accel_bias - state.accel_bias_b,
            gyro_bias - state.gyro_bias_b,
            sensors.clock - state.clock,
        ]
    )


def normalized_error_squared(batch: Batch, states: np.ndarray) -> np.ndarray:
    """(B,) e' P^-1 e of some states."""
    error = state_error(batch)[:, states]
    covariance = batch.buffers.state.covariance[:, states[:, None], states]
    return np.einsum("bi,bi->b", error, np.linalg.solve(covariance, error[..., None])[..., 0])
