"""An episode of the engine as a recording that `spoofgym.receiver.replay` takes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..receiver import NavState, Recording
from .base import run_serially
from .tightly_coupled import TightlyCoupledSetup

FloatArray = NDArray[np.float64]


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
        World, victim, attack and timeline.  Its detector is not asked, since a recording has no
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
    count = setup.onset + setup.steps if epochs is None else epochs
    if not 1 <= count < setup.world.epochs:
        raise ValueError(f"`epochs` must be 1 to {setup.world.epochs - 1}, got {count}")
    victim = setup.simulator(1, run_serially)
    victim.begin([rng])
    state, measured = victim.buffers.state, victim.buffers.measured
    initial = NavState(
        position_e=state.position_e[0],
        velocity_e=state.velocity_e[0],
        C_eb=state.C_eb[0],
        clock_bias_m=float(state.clock[0, 0]),
        clock_drift_mps=float(state.clock[0, 1]),
    )
    kept = []
    for k in range(count):
        if command is None or k < setup.onset:
            victim.advance()
        else:
            victim.predict(command(k - setup.onset))
        seen, samples = measured.visible[0], victim.buffers.measured_samples(0)
        ranges = [np.where(seen, m[0], np.nan) for m in (measured.pseudorange, measured.range_rate)]
        satellites = measured.satellite_position[0].copy(), measured.satellite_velocity[0].copy()
        victim.update(None)
        kept.append((samples, *ranges, *satellites, state.position_e[0].copy()))
    imu_samples, pseudorange, range_rate, *motion, position_e = map(list, zip(*kept, strict=True))
    end = setup.world.epoch_end[count]
    imu = np.concatenate(imu_samples)
    recording = Recording(
        imu_time=setup.world.imu_time[1 : end + 1],
        specific_force_b=imu[:, :3],
        angular_rate_b=imu[:, 3:],
        gnss_time=setup.world.epoch_time[1 : count + 1],
        pseudorange=pseudorange,
        range_rate=range_rate,
        satellite_position_e=motion[0],
        satellite_velocity_e=motion[1],
    )
    return initial, recording, np.array(position_e)
