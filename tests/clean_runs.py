"""Clean runs of many receivers, and their errors as the filter defines them."""

import numpy as np

from spoofgym.detectors import Never
from spoofgym.receiver import TightlyCoupled
from spoofgym.simulation import Engine, TightlyCoupledSetup, Timeline
from spoofgym.simulation.tight import TightlyCoupledSimulator
from spoofgym.truth.scenario import Scenario

OBSERVED = np.array([3, 4, 5, 6, 7, 8, 15, 16])
"""Velocity, position and clock: the states that GNSS sees."""


def begin(
    scenario: Scenario, receiver: TightlyCoupled, receivers: int, seconds: float, seed: int = 7
) -> TightlyCoupledSimulator:
    """Receivers at time zero, in a world whose episode lasts for so long."""
    timeline = Timeline(warmup_s=0.0, live_s=0.0, attack_s=seconds, time_to_alert_s=0.0)
    setup = TightlyCoupledSetup(
        scenario=scenario, receiver=receiver, detector=Never(), timeline=timeline
    )
    setup.fields = setup.has
    engine = Engine(receivers, setup, threads=1)
    engine.reset([np.random.default_rng([seed, run]) for run in range(receivers)])
    simulator: TightlyCoupledSimulator = engine.simulator
    return simulator


def epoch_of(simulator: TightlyCoupledSimulator) -> int:
    return int(simulator.epochs[0])


def advance_to(simulator: TightlyCoupledSimulator, time_s: float) -> None:
    epoch = round(time_s / simulator.setup.scenario.epoch_interval_s)
    simulator.run_filter_only(epoch - epoch_of(simulator))


def position_error(simulator: TightlyCoupledSimulator) -> np.ndarray:
    """(B, 3) estimate minus truth, ECEF [m]."""
    return simulator.buffers.position_e - simulator.setup.world.position_e[epoch_of(simulator)]


def velocity_error(simulator: TightlyCoupledSimulator) -> np.ndarray:
    """(B, 3) estimate minus truth, ECEF [m/s]."""
    return simulator.buffers.velocity_e - simulator.setup.world.velocity_e[epoch_of(simulator)]


def attitude_error(simulator: TightlyCoupledSimulator) -> np.ndarray:
    """(B, 3) rotation vector of the estimate against the truth, ECEF axes [rad]."""
    true_C_eb = simulator.setup.world.C_eb[epoch_of(simulator)]
    turn = np.einsum("bij,kj->bik", simulator.buffers.fields["C_eb"], true_C_eb)
    skew = 0.5 * (turn - turn.transpose(0, 2, 1))
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


def state_error(simulator: TightlyCoupledSimulator) -> np.ndarray:
    """(B, 17) errors with the signs of `receiver.states`.

    A bias is what an accelerometer or a gyro adds in straight flight at the present specific force:
    errors of scale act on it as on a bias.  What they make of a rotation is no bias.
    """
    state, sensors = simulator.buffers.fields, simulator.sensors.constants
    world = simulator.setup.world
    first, last = world.epoch_end[epoch_of(simulator) - 1 : epoch_of(simulator) + 1]
    force = world.run[:3, first:last].mean(axis=1)
    accel_bias = sensors["accel_bias"] + (sensors["accel_matrix"] - np.eye(3)) @ force
    gyro_bias = sensors["gyro_bias"] + sensors["g_dependence"] @ force
    return np.hstack(
        [
            attitude_error(simulator),
            velocity_error(simulator),
            position_error(simulator),
            accel_bias - state["accel_bias_b"],
            gyro_bias - state["gyro_bias_b"],
            simulator.sensors.fields["clock"] - state["clock"],
        ]
    )


def normalized_error_squared(simulator: TightlyCoupledSimulator, states: np.ndarray) -> np.ndarray:
    """(B,) e' P^-1 e of some states."""
    error = state_error(simulator)[:, states]
    covariance = simulator.buffers.covariance[:, states[:, None], states]
    return np.einsum("bi,bi->b", error, np.linalg.solve(covariance, error[..., None])[..., 0])
