"""The project's own golden run: a short flight, what its receiver measured, what it estimated.

``python -m tests.golden.own`` writes it anew.  That is a change of behaviour, which needs a new
version of the environment's id, and a line in the changelog.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from spoofgym.detectors import Never
from spoofgym.receiver import NavState, Recording, Solution, TightlyCoupled, replay
from spoofgym.simulation import TightlyCoupledSetup, Timeline
from spoofgym.simulation.recording import record_run
from spoofgym.truth.manoeuvres import Climb, Straight, Turn, fly
from spoofgym.truth.scenario import Scenario

FILE = Path(__file__).with_name("own_run.npz")
GRADE = "tactical"
SEED = 20261121


def setup() -> TightlyCoupledSetup:
    flight = fly(
        [Straight(3.0), Turn(20.0, bank_deg=20.0, ramp_s=3.0), Climb(20.0), Straight(3.0)],
        latitude_deg=-33.9,
        longitude_deg=151.2,
        height_m=800.0,
        speed_mps=70.0,
        heading_deg=330.0,
        rate_hz=50.0,
        name="own",
    )
    scenario = Scenario(flight=flight, errors="groves", imu=GRADE, epoch_interval_s=1.0)
    timeline = Timeline(warmup_s=8.0, live_s=0.0, attack_s=8.0, time_to_alert_s=1.0)
    receiver = TightlyCoupled(grade=GRADE)
    return TightlyCoupledSetup(
        scenario=scenario, receiver=receiver, detector=Never(), timeline=timeline
    )


def simulate() -> tuple[NavState, Recording, np.ndarray]:
    action = np.array([[-0.5, 1.0]])
    return record_run(setup(), np.random.default_rng(SEED), command=lambda step: action)


def load() -> tuple[NavState, Recording, dict[str, np.ndarray]]:
    with np.load(FILE) as stored:
        arrays = {name: stored[name] for name in stored.files}
    initial = NavState(
        position_e=arrays["initial_position_e"],
        velocity_e=arrays["initial_velocity_e"],
        C_eb=arrays["initial_C_eb"],
        clock_bias_m=float(arrays["initial_clock"][0]),
        clock_drift_mps=float(arrays["initial_clock"][1]),
    )
    recording = Recording(**{name: arrays[name] for name in Recording.__dataclass_fields__})
    return initial, recording, arrays


def solve(initial: NavState, recording: Recording) -> Solution:
    return replay(recording, TightlyCoupled(grade=GRADE), initial=initial)


def main() -> None:
    initial, recording, _ = simulate()
    solution = solve(initial, recording)
    np.savez_compressed(
        FILE,
        initial_position_e=initial.position_e,
        initial_velocity_e=initial.velocity_e,
        initial_C_eb=initial.C_eb,
        initial_clock=[initial.clock_bias_m, initial.clock_drift_mps],
        **{name: getattr(recording, name) for name in Recording.__dataclass_fields__},
        position_e=solution.position_e,
        velocity_e=solution.velocity_e,
        C_eb=solution.C_eb,
        clock_bias_m=solution.clock_bias_m,
        sd=solution.sd,
    )


if __name__ == "__main__":
    main()
