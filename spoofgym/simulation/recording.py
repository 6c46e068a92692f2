"""An episode of the engine as a recording that `spoofgym.receiver.replay` takes."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np

from ..core.declared import check_number
from ..receiver import NavState, PositionRecording, Recording
from ..truth._kernels import CHUNK, CONSTANT_ROWS, advance_biases, sense
from ..truth.noise import BLOCK, deviates, pad_count
from .domain import FloatArray
from .loose import LooselyCoupledSetup
from .simulator import run_serially
from .tight import TightlyCoupledSetup, TightlyCoupledSimulator

RANGES = "pseudorange", "range_rate"  # fields of an epoch that a recording keeps


def record_run(
    setup: TightlyCoupledSetup,
    rng: np.random.Generator,
    *,
    epochs: int | None = None,
    command: Callable[[int], FloatArray | None] | None = None,
) -> tuple[NavState, Recording, FloatArray]:
    """Run one receiver from time zero, and keep all that it measures.

    Parameters
    ----------
    setup : TightlyCoupledSetup
        World, victim, attack and timeline.  Its detector is not called, since a recording has no
        place for weights.
    rng : Generator
        Of the receiver, as `Engine.reset` takes it.
    epochs : int, optional
        How many; up to the end of the command phase by default.
    command : callable, optional
        ``command(step)`` gives the (1, a) action of each step after the onset; the target is not
        attacked by default.

    Returns
    -------
    initial : NavState
        Navigation solution at time zero.
    recording : Recording
        Measurements.
    position_e : ndarray
        (K, 3) estimated after every epoch, ECEF [m].
    """
    with_ranges = copy.copy(setup)
    with_ranges.fields = setup.fields.union(RANGES)
    victim = with_ranges.simulator(1, run_serially)
    victim.start_episodes([rng])
    onset = int(victim.ages[0])
    count = onset + setup.steps if epochs is None else epochs
    check_number("epochs", count, least=1, most=setup.world.epochs - 1, whole=True)
    buffers, clock = victim.buffers, victim.buffers.fields["clock"][0]
    initial = NavState(
        position_e=buffers.position_e[0],
        velocity_e=buffers.velocity_e[0],
        C_eb=buffers.fields["C_eb"][0],
        clock_bias_m=float(clock[0]),
        clock_drift_mps=float(clock[1]),
    )
    parts = []
    for k in range(count):
        samples = _next_samples(victim)
        if command is None or k < onset:
            epoch = victim.advance()
        else:
            epoch = victim.predict(command(k - onset))
        seen, measured = epoch.visible[0], (buffers.seen[name][0] for name in RANGES)
        sky = setup.world.satellites[int(victim.epochs[0])]
        ranges = [np.where(seen, each, np.nan) for each in measured]
        victim.update(None)
        parts.append((samples, *ranges, sky, buffers.position_e[0].copy()))
    imu_samples, pseudorange, range_rate, satellites, position_e = map(
        list, zip(*parts, strict=True)
    )
    end = setup.world.epoch_end[count]
    imu, sky = np.concatenate(imu_samples), np.array(satellites)
    recording = Recording(
        imu_time=setup.world.imu_time[1 : end + 1],
        specific_force_b=imu[:, :3],
        angular_rate_b=imu[:, 3:],
        gnss_time=setup.world.epoch_time[1 : count + 1],
        pseudorange=pseudorange,
        range_rate=range_rate,
        satellite_position_e=sky[:, :, :3],
        satellite_velocity_e=sky[:, :, 3:6],
    )
    return initial, recording, np.array(position_e)


def record_loose_run(
    setup: LooselyCoupledSetup,
    rng: np.random.Generator,
    *,
    epochs: int | None = None,
    command: Callable[[int], FloatArray | None] | None = None,
) -> tuple[NavState, PositionRecording, FloatArray]:
    """Run one loosely coupled receiver from where its episode starts, and keep what it measures:
    inertial samples and positions since then. Arguments and values are those of `record_run`."""
    victim = setup.simulator(1, run_serially)
    victim.start_episodes([rng])
    filters, onset = victim.victims, int(victim.ages[0])
    count = onset + setup.steps if epochs is None else epochs
    check_number("epochs", count, least=1, most=setup.length, whole=True)
    start = (getattr(filters.state, name)[0] for name in ("position_e", "velocity_e", "C_eb"))
    initial = NavState(**dict(zip(("position_e", "velocity_e", "C_eb"), start, strict=True)))
    parts = []
    for k in range(count):
        victim.predict(None if command is None or k < onset else command(k - onset))
        measured = filters.samples[0].copy(), filters.fix_e[0].copy()
        victim.update(None)
        parts.append((*measured, victim.position[0].copy()))
    samples, fixes, position_e = map(np.array, zip(*parts, strict=True))
    imu, step = samples.reshape(-1, 6), setup.world.imu_interval_s
    recording = PositionRecording(
        imu_time=step * np.arange(1, len(imu) + 1),
        specific_force_b=imu[:, :3],
        angular_rate_b=imu[:, 3:],
        gnss_time=setup.interval_s * np.arange(1, count + 1),
        position_e=fixes,
    )
    return initial, recording, position_e


def _next_samples(victim: TightlyCoupledSimulator) -> FloatArray:
    """(count, 6) what a single receiver's inertial sensors will measure up to its next epoch."""
    world, sensors, k = victim.setup.world, victim.sensors, int(victim.epochs[0])
    first, end = world.epoch_end[k : k + 2].tolist()
    samples, dt = np.empty(pad_count(6 * world.most_samples)), np.empty(world.most_samples)
    count, parts = end - first, sensors.fields.data.copy()
    key0, key1 = sensors.words["imu"][0]
    deviates(key0, key1, np.uint64(k + 1), len(samples), 6 * count, samples)
    truth, active, constants = np.empty(8 * CHUNK), np.ones(1), sensors.constants.data
    if sensors.in_run.rows:
        noise, constants = np.empty(BLOCK), np.empty(CONSTANT_ROWS)
        wandering = sensors.in_run.data.copy(), 0, sensors.constants.data, 0
        advance_biases(*wandering, key0, key1, np.uint64(k + 1), noise, constants)
    given = parts, 0, constants, 0
    sense(world.run, np.array([first]), count, *given, samples, dt, truth, active)
    return samples[: 6 * count].reshape(6, -1).T.copy()
